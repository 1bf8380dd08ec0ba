//! Resolves the arguments, recipients and destinations of statements.

use super::expr::{self, Typed};
use super::names::unknown;
use super::scope::Found;
use super::statements::{Thread, load};
use super::{ARGUMENTS, NOT_LISTED, STATEMENT, TYPES};
use crate::ast::{Expr as Written, ExprKind, Name, Place};
use crate::diagnostic::Diagnostic;
use crate::hir::{Destination, Expr, Field, Recipients};
use crate::span::Span;
use imrs_protocol::script::Type;
use imrs_protocol::{PortId, TaskId, Usage};

impl<'a> Thread<'_, 'a> {
    /// The port that a statement names and the task's usage of it. Reports a port that the task cannot use in statements.
    pub fn own_port(&mut self, name: &'a Name) -> Option<(PortId, Usage)> {
        let port = self.resolver.port(name)?;
        if self.resolver.poisoned_ports.contains(&port.index()) {
            return None;
        }
        let Some(usage) = self.resolver.hir.ports[port.index()].usage_of(self.task) else {
            self.not_declared(port, name);
            return None;
        };
        if self.resolver.heartbeats.contains(&port) {
            let message = format!("port `{}` carries the heartbeats of a couple", name.text);
            self.report(
                Diagnostic::error(STATEMENT, name.span, message)
                    .label("the communication tasks exchange them")
                    .help(format!("publish what the heartbeats carry: `{} := ..`", name.text)),
            );
            return None;
        }
        Some((port, usage))
    }

    /// Reports a port that the task does not declare.
    pub fn not_declared(&mut self, port: PortId, name: &Name) {
        if self.resolver.poison.ports.contains(name.text.as_str()) {
            return;
        }
        let task = &self.resolver.hir.tasks[self.task.index()];
        let declared = &self.resolver.hir.ports[port.index()];
        let message = format!("`{}` has no port `{}`", task.name, name.text);
        let found = Diagnostic::error(NOT_LISTED, name.span, message)
            .label("not declared in this task")
            .also(declared.span, "declared here")
            .help(format!("add `use_port {}(..) usage = {}`", name.text, declared.usage.counterpart()));
        self.report(found);
    }

    /// Splits off the recipients: tasks or modules in front of the arguments. A variable with the name of a task or module
    /// is an argument.
    pub fn recipients(
        &mut self,
        port: PortId,
        written: &'a [Written],
    ) -> Option<(Recipients, &'a [Written])> {
        let mut tasks: Vec<TaskId> = Vec::new();
        let mut named = 0;
        let mut whole = true;
        for argument in written {
            let ExprKind::Path(Place { path, .. }) = &argument.kind else { break };
            let [name] = &path[..] else { break };
            let resolver = &mut *self.resolver;
            let text = name.text.as_str();
            if self.scope.has(text)
                || !(resolver.tasks.get(text).is_some() || resolver.modules.contains_key(text))
            {
                break;
            }
            named += 1;
            let meant = resolver.tasks_or_module(name);
            let declared = &resolver.hir.ports[port.index()];
            let peers: Vec<TaskId> = declared.peers(self.task).collect();
            let there: Vec<TaskId> = meant.into_iter().filter(|task| peers.contains(task)).collect();
            if there.is_empty() {
                let message = format!("`{}` is not at the other end of port `{}`", name.text, declared.name);
                let found = Diagnostic::error(STATEMENT, name.span, message)
                    .label("cannot receive this")
                    .also(declared.user_list.unwrap_or(declared.span), "the tasks that can")
                    .help("name tasks at the other end, or none: then all of them get it");
                self.report(found);
                whole = false;
            }
            tasks.extend(there.into_iter().filter(|task| !tasks.contains(task)).collect::<Vec<_>>());
        }
        let to = if named == 0 { Recipients::All } else { Recipients::These(tasks) };
        whole.then_some((to, written.get(named..).unwrap_or_default()))
    }

    /// The expressions for the fields of a message, one for each field. A record variable among the expressions stands for
    /// all its fields.
    pub fn values(
        &mut self,
        written: &'a [Written],
        fields: &[Field],
        (what, at, declared): (&str, Span, Option<Span>),
    ) -> Option<Vec<Expr>> {
        let mut values: Vec<Option<Typed>> = Vec::new();
        for argument in written {
            match self.whole_record(argument) {
                Some(places) => values.extend(places.into_iter().map(|place| {
                    let load = load(place, argument.span);
                    Some(Typed::new(load.of, load.ops, load.span))
                })),
                None => values.push(expr::typed(self, argument)),
            }
        }
        if values.len() != fields.len() {
            // A value that could not be typed may be a whole record.
            if values.iter().any(Option::is_none) {
                return None;
            }
            self.wrong_count(values.len(), fields, (what, written_span(written, at), declared));
            return None;
        }
        let pairs = values.into_iter().zip(fields);
        let coerced: Vec<Option<Expr>> = pairs
            .map(|(value, field)| {
                let place = format!("`{}` of {what}", field.name);
                expr::coerced(self, value?, field.of, &place).map(Typed::finish)
            })
            .collect();
        coerced.into_iter().collect()
    }

    fn whole_record(&self, written: &Written) -> Option<Vec<Destination>> {
        let ExprKind::Path(place) = &written.kind else { return None };
        match self.scope.place(place, &self.resolver.hir.records) {
            Ok(Found::Whole(places)) => Some(places),
            Ok(Found::One(_) | Found::Timer(_)) | Err(_) => None,
        }
    }

    pub fn wrong_count(
        &mut self,
        given: usize,
        fields: &[Field],
        (what, at, declared): (&str, Span, Option<Span>),
    ) {
        let list: Vec<String> =
            fields.iter().map(|field| format!("{}: {}", field.name, expr::word(field.of))).collect();
        let n = fields.len();
        let has = if n == 1 { String::from("1 value") } else { format!("{n} values") };
        let message = format!("{what} has {has}, not {given}");
        let mut found = Diagnostic::error(ARGUMENTS, at, message)
            .label(format!("{given} given"))
            .help("give one value for each field, or a variable of the whole record");
        if let Some(declared) = declared {
            found = found.also(declared, format!("({})", list.join(", ")));
        }
        self.report(found);
    }

    /// The variables into which the fields of a message are stored: as many variables as fields, each of a type into which
    /// its field fits.
    pub fn destinations(
        &mut self,
        written: &'a [Place],
        fields: &[Field],
        (what, declared): (&str, Span),
    ) -> Option<Vec<Destination>> {
        let mut places: Vec<(Destination, Span)> = Vec::new();
        let mut whole = true;
        for place in written {
            match self.find(place) {
                Some(Found::One(to)) => places.push((to, place.span)),
                Some(Found::Whole(all)) => places.extend(all.into_iter().map(|to| (to, place.span))),
                Some(Found::Timer(_)) => {
                    self.report(
                        Diagnostic::error(TYPES, place.span, "a timer holds no value")
                            .label("a timer")
                            .help("name a variable of another type"),
                    );
                    whole = false;
                }
                None => whole = false,
            }
        }
        if !whole {
            return None;
        }
        if places.len() != fields.len() && !places.is_empty() {
            let at = written.iter().map(|place| place.span).reduce(Span::to).unwrap_or_default();
            self.wrong_count(places.len(), fields, (what, at, Some(declared)));
            return None;
        }
        for ((to, span), field) in places.iter().zip(fields) {
            if !fits(field.of, to.of) {
                let message = format!("`{}` of {what} is {}", field.name, expr::word(field.of));
                let found = Diagnostic::error(TYPES, *span, message)
                    .label(format!("{}: cannot take it", expr::word(to.of)))
                    .also(declared, "declared here")
.help("read it into a variable of that type, and convert it then: `trunc(r)` cuts a real off");
                self.report(found);
                whole = false;
            }
        }
        whole.then(|| places.into_iter().map(|(to, _)| to).collect())
    }

    /// The task of this name, if it is at the other end of the port.
    pub fn peer(&mut self, port: PortId, name: &'a Name) -> Option<TaskId> {
        let task = self.resolver.task(name)?;
        let declared = &self.resolver.hir.ports[port.index()];
        if declared.peers(self.task).any(|peer| peer == task) {
            return Some(task);
        }
        let message = format!("`{}` is not at the other end of port `{}`", name.text, declared.name);
        let found = Diagnostic::error(STATEMENT, name.span, message)
            .label("not there")
            .also(declared.user_list.unwrap_or(declared.span), "the tasks at that end")
            .help("name a task at the other end of the port");
        self.report(found);
        None
    }

    pub fn unknown_variable(&mut self, name: &Name, words: &[&'static str]) {
        let found = unknown("variable", name, self.scope.all().chain(words.iter().copied()));
        self.report(found);
    }
}

/// Whether a variable of this type can take a field of that type. Reading a message copies bits and converts
/// nothing.
fn fits(field: Type, variable: Type) -> bool {
    let kind = |of: Type| match of {
        Type::Bool => 0,
        Type::Int8 | Type::Int16 | Type::Int32 | Type::Word => 1,
        Type::Real => 2,
    };
    kind(field) == kind(variable)
}

fn written_span(written: &[Written], at: Span) -> Span {
    written.iter().map(|argument| argument.span).reduce(Span::to).unwrap_or(at)
}
