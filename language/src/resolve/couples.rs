//! Resolves process classes: which tasks are coupled, and how (D24, D30, D61).

use super::ports::SHORT;
use super::{COUPLE, Resolver, TAKEOVER, TOO_LONG, TWICE};
use crate::ast::{self, CoupleKind as Said, Item, Name};
use crate::diagnostic::Diagnostic;
use crate::hir::{Couple, CoupleKind, Statement, StatementKind};
use crate::span::Span;
use crate::walk;
use imrs_protocol::{PortId, TaskId, Usage};

/// The most bytes of contents in a message that also carries an epoch (D78).
const GUARDED: usize = 11;

impl<'a> Resolver<'a> {
    pub(super) fn couples(&mut self, file: &'a ast::File) {
        for item in &file.items {
            let Item::Couple(couple) = item else { continue };
            if let Some(kind) = self.couple(couple) {
                self.hir.couples.push(Couple { kind, span: couple.span });
            }
        }
        for at in 0..self.hir.tasks.len() {
            self.standby(TaskId::from_index(at));
        }
    }

    fn couple(&mut self, couple: &'a ast::CoupleDecl) -> Option<CoupleKind> {
        match &couple.kind {
            Said::Loose { tasks, over } => {
                let over = self.task(over);
                let tasks = self.members(tasks);
                Some(CoupleKind::Loose { tasks, over: over? })
            }
            Said::Tight(tasks) => Some(CoupleKind::Tight(self.members(tasks))),
            Said::Serial(first, second) => {
                let (a, b) = (self.task(first), self.task(second));
                self.apart(a?, b?, second)?;
                Some(CoupleKind::Serial(a?, b?))
            }
            Said::Work { primary, standby, mutual, lease, takeover, every, via } => {
                self.coupled.push((&standby.text, &primary.text, *mutual));
                let (first, second, port) = (self.task(primary), self.task(standby), self.port(via));
                for (what, length) in [("lease", *lease), ("takeover", *takeover), ("period", *every)] {
                    self.some_time(what, length);
                }
                self.heartbeats_unknown |= first.is_none() || second.is_none() || port.is_none();
                let (first, second, port) = (first?, second?, port?);
                self.apart(first, second, standby)?;
                self.alone(couple.span, [(first, primary), (second, standby)]);
                self.carries_heartbeats(port, first, second, via);
                let (lease, takeover, every, mutual) = (*lease, *takeover, *every, *mutual);
                let (primary, standby, via) = (first, second, port);
                Some(CoupleKind::Work { primary, standby, mutual, lease, takeover, every, via })
            }
        }
    }

    fn members(&mut self, names: &'a [Name]) -> Vec<TaskId> {
        let mut tasks = Vec::new();
        for name in names {
            for task in self.tasks_or_module(name) {
                if tasks.contains(&task) {
                    self.report(
                        Diagnostic::error(TWICE, name.span, format!("`{}` is listed twice", name.text))
                            .label("the second time")
                            .help("remove it once; a module stands for all its tasks"),
                    );
                } else {
                    tasks.push(task);
                }
            }
        }
        tasks
    }

    fn apart(&mut self, a: TaskId, b: TaskId, name: &Name) -> Option<()> {
        if a != b {
            return Some(());
        }
        self.report(
            Diagnostic::error(TWICE, name.span, format!("`{}` is coupled with itself", name.text))
                .label("the same task")
                .help("name the other task"),
        );
        None
    }

    /// Reports a task that is in two work couples.
    fn alone(&mut self, span: Span, members: [(TaskId, &'a Name); 2]) {
        for (task, name) in members {
            let other = self.hir.couples.iter().find(|couple| match couple.kind {
                CoupleKind::Work { primary, standby, .. } => primary == task || standby == task,
                CoupleKind::Loose { .. } | CoupleKind::Tight(_) | CoupleKind::Serial(..) => false,
            });
            if let Some(other) = other.map(|other| other.span) {
                self.report(
                    Diagnostic::error(COUPLE, name.span, format!("`{}` is in two work couples", name.text))
                        .label("a task holds one lease")
                        .also(other, "the first one")
                        .also(span, "the second one")
                        .help("keep one of them: let a task of its own stand by for the other work"),
                );
            }
        }
    }

    /// Checks that the heartbeats have a port of their own: the standby queries, the primary responds.
    fn carries_heartbeats(&mut self, port: PortId, primary: TaskId, standby: TaskId, via: &Name) {
        if self.poisoned_ports.contains(&port.index()) {
            return;
        }
        let declared = &self.hir.ports[port.index()];
        let fits = declared.users.len() == 1
            && declared.usage_of(primary) == Some(Usage::Response)
            && declared.usage_of(standby) == Some(Usage::Query);
        let (a, b) = (&self.hir.tasks[primary.index()].name, &self.hir.tasks[standby.index()].name);
        let found = if fits {
            self.heartbeats.push(port);
            let bytes: usize = declared.answer.iter().map(|field| field.of.bytes()).sum();
            (bytes > SHORT).then(|| {
                let message =
                    format!("an answer of `{}` is {bytes} bytes; a heartbeat carries {SHORT}", declared.name);
                Diagnostic::error(TOO_LONG, declared.span, message)
                    .label("too long for a heartbeat")
                    .also(via.span, "its couple")
                    .help("publish less, and send the rest through another port")
            })
        } else {
            self.heartbeats_unknown = true;
            let message = format!("port `{}` cannot carry the heartbeats of `{a}` and `{b}`", declared.name);
            Some(
                Diagnostic::error(COUPLE, via.span, message)
                    .label("does not join these two alone")
                    .also(declared.span, "the port")
                    .help(format!("let `{a}` own it with `usage = response  user_list = {{{b}}}`")),
            )
        };
        self.found.extend(found);
    }

    /// Checks that the `standby of` of a task agrees with the `couple work` of the cell.
    fn standby(&mut self, id: TaskId) {
        let task = &self.hir.tasks[id.index()];
        let Some(declared) = self.written.get(id.index()) else { return };
        let couple = self.coupled.iter().find(|&&(standby, ..)| standby == task.name);
        let name = &declared.name;
        let found = match (&declared.standby_of, couple) {
            (None, Some(&(_, primary, _))) => Some(
                Diagnostic::error(
                    TAKEOVER,
                    name.span,
                    format!("`{}` takes over from `{primary}`, but does not declare it", name.text),
                )
                .label("a standby of a couple")
                .help(format!("write `task {} on {} standby of {primary}`", name.text, declared.on.text)),
            ),
            (Some(of), None) => {
                let message =
                    format!("`{}` stands by for `{}`, but no couple declares it", name.text, of.text);
                Some(Diagnostic::error(TAKEOVER, of.span, message).label("without a lease").help(format!(
                    "add `couple work {} -> {} lease .. takeover .. every .. via ..;`",
                    of.text, name.text
                )))
            }
            (Some(of), Some(&(_, primary, _))) if of.text != primary => {
                let message =
                    format!("`{}` stands by for `{}`, its couple declares `{primary}`", name.text, of.text);
                Some(
                    Diagnostic::error(TAKEOVER, of.span, message)
                        .label("another task")
                        .help(format!("write `standby of {primary}`, or change the couple")),
                )
            }
            _ => None,
        };
        self.found.extend(found);
    }

    /// Two flags: whether a task is the standby of a couple, and whether it may become one.
    pub(super) fn stands_by(&self, id: TaskId) -> (bool, bool) {
        let name = &self.hir.tasks[id.index()].name;
        let stands_by = self.coupled.iter().any(|&(standby, ..)| standby == name)
            || self.written.get(id.index()).is_some_and(|task| task.standby_of.is_some());
        let mutual = self.coupled.iter().any(|&(_, primary, mutual)| mutual && primary == name);
        (stands_by, mutual)
    }

    /// Finds the ports that a lease guards (D61): the ports through which a couple commands other tasks. A port on which
    /// the standby sends before it takes over is not guarded.
    pub(super) fn guards(&mut self) {
        for at in 0..self.hir.couples.len() {
            let CoupleKind::Work { primary, standby, via, .. } = self.hir.couples[at].kind else { continue };
            for port in 0..self.hir.ports.len() {
                if via.index() != port && self.acts_alone(port, [primary, standby]) {
                    self.guard(port, at);
                }
            }
        }
    }

    fn acts_alone(&self, at: usize, couple: [TaskId; 2]) -> bool {
        let port = &self.hir.ports[at];
        let mut sends = false;
        let split = port.parties().all(|task| {
            let sender = matches!(port.usage_of(task), Some(Usage::Send | Usage::Query));
            sends |= sender;
            sender == couple.contains(&task)
        });
        let early = &self.hir.tasks[couple[1].index()];
        let handlers = early.handlers.iter().map(|handler| &handler.body);
        let id = PortId::from_index(at);
        split && sends && !handlers.chain([&early.body]).any(|body| sends_on(body, id))
    }

    fn guard(&mut self, at: usize, couple: usize) {
        let port = &mut self.hir.ports[at];
        port.guard = Some(couple);
        let bytes: usize = port.message.iter().map(|field| field.of.bytes()).sum();
        if bytes > GUARDED {
            let message =
                format!("a message of `{}` is {bytes} bytes; under a lease it carries {GUARDED}", port.name);
            let found = Diagnostic::error(TOO_LONG, port.span, message)
                .label("one packet, with the epoch of the active task")
                .also(self.hir.couples[couple].span, "only this couple sends on it")
                .help("send less at a time");
            self.report(found);
        }
    }
}

/// Whether these statements send on a port.
fn sends_on(statements: &[Statement], wanted: PortId) -> bool {
    let mut sends = false;
    walk::each(statements, &mut |statement| {
        sends |= matches!(&statement.kind, StatementKind::Send { port, .. } if *port == wanted);
    });
    sends
}
