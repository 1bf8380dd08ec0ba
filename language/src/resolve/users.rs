//! Resolves the users' declarations of ports: `use_port` (R28, C4, C5, C6).

use super::names::duplicate;
use super::ports::{Options, adopted, same_types, span_of, types};
use super::{DISAGREE, MISSING, NO_USE_PORT, NOT_LISTED, OPTION, Resolver, USAGES};
use crate::ast::PortDecl;
use crate::diagnostic::Diagnostic;
use crate::hir::User;
use crate::span::Span;
use imrs_protocol::{Class, PortId, TaskId};

impl<'a> Resolver<'a> {
    pub(super) fn use_ports(&mut self) {
        for (at, task) in self.written.clone().into_iter().enumerate() {
            let mut used: Vec<(PortId, Span)> = Vec::new();
            for decl in task.ports.iter().filter(|port| !port.owner) {
                let options = self.options(decl);
                let Some(port) = self.port(&decl.name) else {
                    self.poison.ports.insert(&decl.name.text);
                    self.guessed_uses.insert(TaskId::from_index(at));
                    continue;
                };
                if let Some(&(_, first)) = used.iter().find(|&&(other, _)| other == port) {
                    self.report(duplicate("ports of a task", &decl.name, first));
                    continue;
                }
                used.push((port, decl.name.span));
                self.use_port(TaskId::from_index(at), port, decl, &options);
            }
        }
        for at in 0..self.hir.ports.len() {
            self.every_member(at);
        }
    }

    fn use_port(&mut self, task: TaskId, id: PortId, decl: &'a PortDecl, options: &Options<'a>) {
        if self.poisoned_ports.contains(&id.index()) {
            return;
        }
        let port = &self.hir.ports[id.index()];
        let name = &self.hir.tasks[task.index()].name;
        if port.owner == task {
            let found =
                Diagnostic::error(NOT_LISTED, decl.name.span, format!("`{name}` owns port `{}`", port.name))
                    .label("cannot use it as well")
                    .also(port.span, "owned here")
                    .help("remove this `use_port`");
            return self.report(found);
        }
        if port.user(task).is_none() {
            if let Some(list) = port.user_list.filter(|_| !self.guessed_users.contains(&id.index())) {
                let message = format!("`{name}` uses port `{}` but is not in its user_list", port.name);
                let found = Diagnostic::error(NOT_LISTED, decl.name.span, message)
                    .label("not listed")
                    .also(list, "the user_list")
                    .help(format!("add `{name}` to the user_list, or remove this"));
                self.report(found);
            }
            let (listed, span) = (decl.name.span, None);
            // The user is added even if the `user_list` does not name it, so that the task's statements on the port are not
            // reported, too.
            let user = User { task, time_out: None, rate: None, retry: None, listed, span };
            self.hir.ports[id.index()].users.push(user);
        }
        self.ends_agree(id, decl, options);
        let retry = options.retry.filter(|n| n.value > 0);
        if let (Some(retry), Class::Status) = (retry, self.hir.ports[id.index()].class) {
            let message = format!("port `{}` is class 1: no answer shows what to send again", decl.name.text);
            let found =
                Diagnostic::error(OPTION, retry.span, message).label("needs an answer that may be missing");
            self.report(found.help("leave `retry` out, or let the owner write `class = 2`"));
        }
        let retry = options.retry.map(|n| self.retry(n));
        let users = &mut self.hir.ports[id.index()].users;
        if let Some(user) = users.iter_mut().find(|user| user.task == task) {
            user.span = Some(decl.name.span);
            user.time_out = options.time_out;
            user.rate = options.rate;
            user.retry = retry;
        }
    }

    /// Checks that usages, formats and classes of the two ends agree (D9, D11).
    fn ends_agree(&mut self, id: PortId, decl: &'a PortDecl, options: &Options<'a>) {
        let port = self.hir.ports[id.index()].clone();
        let wanted = port.usage.counterpart();
        if let Some((usage, span)) = options.usage
            && usage != wanted
        {
            let message = format!("port `{}`: {} and {usage} do not go together", port.name, port.usage);
            self.report(
                Diagnostic::error(USAGES, span, message)
                    .label(format!("must be {wanted}"))
                    .also(port.span, format!("its owner's usage is {}", port.usage))
                    .help(format!("write `usage = {wanted}`")),
            );
        }
        if let Some((class, span)) = options.class
            && class != port.class
        {
            let owners = number(port.class);
            self.report(
                Diagnostic::error(DISAGREE, span, format!("port `{}` is class {owners}", port.name))
                    .label("another class than the owner's")
                    .also(port.span, format!("class {owners} here"))
                    .help("leave it out here: the owner declares it"),
            );
        }
        let message = self.message(decl, options.format);
        let other = message.filter(|message| {
            let records = message.record.zip(port.record).is_some_and(|(a, b)| a != b);
            records || !same_types(&adopted(decl, &message.fields, &port.message), &port.message)
        });
        if let Some(other) = other {
            let message =
                format!("port `{}` carries ({}) at its owner's end", port.name, types(&port.message));
            self.report(
                Diagnostic::error(DISAGREE, decl.name.span, message)
                    .label(format!("({}) here", types(&other.fields)))
                    .also(port.span, "its owner's declaration")
                    .help("let both ends have the same parameters"),
            );
        }
        if let Some(of) = &decl.answer
            && let Some(answer) = self.answer_of(of)
            && !same_types(&answer, &port.answer)
        {
            let message =
                format!("an answer of `{}` is ({}) at its owner's end", port.name, types(&port.answer));
            self.report(
                Diagnostic::error(DISAGREE, span_of(of), message)
                    .label(format!("({}) here", types(&answer)))
                    .also(port.span, "its owner's declaration")
                    .help("leave it out here: the owner declares it"),
            );
        }
    }

    /// Checks that every task in a `user_list` has a `use_port` (C6).
    fn every_member(&mut self, at: usize) {
        if self.poisoned_ports.contains(&at) {
            return;
        }
        let port = &self.hir.ports[at];
        if port.users.is_empty() && port.user_list.is_none() {
            let found = Diagnostic::error(MISSING, port.span, format!("port `{}` has no users", port.name))
                .label("no task is at its other end")
                .help("name them: `user_list = {..}`, and give each a `use_port`");
            return self.report(found);
        }
        for user in port.users.clone() {
            if user.span.is_some() || self.guessed_uses.contains(&user.task) {
                continue;
            }
            let (port, task) = (&self.hir.ports[at], &self.hir.tasks[user.task.index()]);
            let message =
                format!("`{}` is in the user_list of `{}` but does not use it", task.name, port.name);
            let found = Diagnostic::error(NO_USE_PORT, user.listed, message)
                .label(format!("no `use_port {}` there", port.name))
                .also(task.span, format!("`{}`", task.name))
                .help(format!(
                    "add `use_port {}(..) usage = {}` to `{}`, or remove it here",
                    port.name,
                    port.usage.counterpart(),
                    task.name
                ));
            self.report(found);
        }
    }
}

const fn number(class: Class) -> u8 {
    match class {
        Class::Status => 1,
        Class::Command => 2,
    }
}
