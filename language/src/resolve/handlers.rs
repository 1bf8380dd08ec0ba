//! Resolves handlers: their triggers and their variables (D15, D46).

use super::names::duplicate;
use super::scope::{Entity, Scope};
use super::statements::Thread;
use super::{HANDLERS, HIDES, Resolver, STATEMENT, TOO_MANY, TYPES};
use crate::ast::{self, Name};
use crate::diagnostic::Diagnostic;
use crate::hir::{Duration, Handler, Timer, Trigger, Variable};
use imrs_protocol::script::Slot;
use imrs_protocol::{PortId, TaskId, TimeId, Usage};

/// The most handlers of a task.
const MOST_HANDLERS: usize = 64;

impl<'a> Resolver<'a> {
    pub(super) fn handler(&mut self, task: TaskId, scope: &Scope<'a>, written: &'a ast::Handler) {
        if self.hir.tasks[task.index()].handlers.len() >= MOST_HANDLERS {
            return self.report(
                Diagnostic::error(TOO_MANY, written.span, format!("more than {MOST_HANDLERS} handlers"))
                    .label("one too many")
                    .help("split the task"),
            );
        }
        let mut own = scope.clone();
        let mut locals = Vec::new();
        let trigger = match &written.trigger {
            ast::Trigger::Message { query, port, variables } => self
                .message_trigger(task, *query, port)
                .map(|port| self.bind(port, variables, &mut own, &mut locals, written))
                .map(Trigger::Message),
            ast::Trigger::Silence { port, length, when } => {
                self.silence(task, scope, port, *length, when.as_ref())
            }
            ast::Trigger::Expiry(timer) => self.expiry(scope, timer),
            ast::Trigger::Fence => Some(Trigger::Fence),
        };
        if let (None, ast::Trigger::Message { variables, .. }) = (&trigger, &written.trigger) {
            variables.iter().for_each(|name| own.shadow(name, Entity::Unknown));
        }
        let reads = locals.len();
        let mut thread = Thread::new(self, task, &own, Some(locals));
        match trigger {
            Some(Trigger::Message(port)) => thread.may_have_received(port),
            Some(_) | None => thread.received_unknown = trigger.is_none(),
        }
        let body = thread.statements(&written.body);
        let (locals, captures) = (thread.locals.unwrap_or_default(), thread.captures);
        let Some(trigger) = trigger else { return };
        if let Some(first) = self.same_trigger(task, &trigger) {
            return self.report(
                Diagnostic::error(HANDLERS, written.span, "a second handler for the same thing")
                    .label("the second one")
                    .also(first, "the first one")
                    .help("put the statements of both into one"),
            );
        }
        let handler = Handler { trigger, locals, reads, captures, body, span: written.span };
        self.hir.tasks[task.index()].handlers.push(handler);
    }

    fn message_trigger(&mut self, task: TaskId, query: bool, name: &'a Name) -> Option<PortId> {
        let scope = Scope::default();
        let (port, usage) = Thread::new(self, task, &scope, None).own_port(name)?;
        let (said, wanted) = if query { ("query", Usage::Response) } else { ("receive", Usage::Receive) };
        if usage == wanted {
            return Some(port);
        }
        let right = match usage {
            Usage::Response => "write `on query`",
            Usage::Receive => "write `on receive`",
            Usage::Send | Usage::Query | Usage::Reply | Usage::Waitfor => "no message arrives at this end",
        };
        let declared = self.hir.ports[port.index()].span;
        let message = format!("`on {said}` of port `{}`, whose usage here is {usage}", name.text);
        self.report(
            Diagnostic::error(STATEMENT, name.span, message)
                .label(right)
                .also(declared, "the port")
                .help("the `usage` of this end of the port decides which messages arrive"),
        );
        None
    }

    /// Adds the variables of a handler: one for the record, one for each field, or none.
    fn bind(
        &mut self,
        port: PortId,
        names: &'a [Name],
        scope: &mut Scope<'a>,
        locals: &mut Vec<Variable>,
        written: &'a ast::Handler,
    ) -> PortId {
        let declared = self.hir.ports[port.index()].clone();
        let fields = &declared.message;
        let mut known: Vec<&'a Name> = Vec::new();
        for name in names {
            if let Some(first) = known.iter().find(|other| other.text == name.text) {
                self.report(duplicate("variables of a handler", name, first.span));
            }
            known.push(name);
            if let Some(first) = scope.declared(&name.text) {
                self.report(hides(name, first));
            }
        }
        match (names, declared.record) {
            ([], _) => {}
            ([name], Some(record)) => {
                for field in fields {
                    let name = format!("{}.{}", name.text, field.name);
                    locals.push(Variable { name, of: field.of, span: field.span });
                }
                scope.shadow(name, Entity::Record { record, first: Slot::Local(0) });
            }
            (names, _) if names.len() == fields.len() => {
                for (at, (name, field)) in (0..).zip(names.iter().zip(fields)) {
                    locals.push(Variable { name: name.text.clone(), of: field.of, span: name.span });
                    scope.shadow(name, Entity::Plain(Slot::Local(at), field.of));
                }
            }
            (names, _) => {
                let empty = Scope::default();
                let at = names.iter().map(|name| name.span).reduce(crate::Span::to).unwrap_or(written.span);
                let what = format!("a message of `{}`", declared.name);
                let mut thread = Thread::new(self, TaskId(0), &empty, None);
                thread.wrong_count(names.len(), fields, (&what, at, Some(declared.span)));
                names.iter().for_each(|name| scope.shadow(name, Entity::Unknown));
            }
        }
        port
    }

    fn silence(
        &mut self,
        task: TaskId,
        scope: &Scope<'a>,
        name: &'a Name,
        length: Duration,
        when: Option<&'a ast::Expr>,
    ) -> Option<Trigger> {
        let empty = Scope::default();
        let found = Thread::new(self, task, &empty, None).own_port(name);
        let mut thread = Thread::new(self, task, scope, None);
        let condition = when.map(|when| thread.condition(when, "`when`"));
        let captured = thread.captures.len();
        let (port, usage) = found?;
        if let (true, Some(when)) = (captured > 0, when) {
            self.report(
                Diagnostic::error(TYPES, when.span, "the condition of a silence looks at variables only")
                    .label("not a variable")
                    .help("keep what it asks in a variable, and name that"),
            );
            return None;
        }
        if !matches!(usage, Usage::Receive | Usage::Response) {
            let declared = self.hir.ports[port.index()].span;
            let message = format!("`on silence` of port `{}`, whose usage here is {usage}", name.text);
            self.report(
                Diagnostic::error(STATEMENT, name.span, message)
                    .label("always silent: no message arrives at this end")
                    .also(declared, "the port")
                    .help("name a port on which this task receives or responds"),
            );
            return None;
        }
        self.some_time("silence", length);
        let when = match condition {
            None => None,
            Some(condition) => Some(condition?),
        };
        let timers = &mut self.hir.tasks[task.index()].timers;
        timers.push(Timer { name: format!("silence of {}", name.text), span: name.span });
        let timer = TimeId(u8::try_from(timers.len() - 1).unwrap_or(u8::MAX));
        Some(Trigger::Silence { port, timer, length, when })
    }

    fn expiry(&mut self, scope: &Scope<'a>, name: &'a Name) -> Option<Trigger> {
        match scope.get(&name.text) {
            Some(Entity::Timer(timer)) => return Some(Trigger::Expiry(timer)),
            Some(Entity::Unknown) => {}
            Some(Entity::Plain(..) | Entity::Record { .. }) => self.report(
                Diagnostic::error(TYPES, name.span, format!("`{}` is not a timer", name.text))
                    .label("never expires")
                    .help(format!("declare a timer: `var {}: timer;`", name.text)),
            ),
            None => {
                let found = super::names::unknown("timer", name, scope.all());
                self.report(found);
            }
        }
        None
    }

    /// The head of an earlier handler of the task with the same trigger.
    fn same_trigger(&self, task: TaskId, trigger: &Trigger) -> Option<crate::Span> {
        let same = |other: &Trigger| match (trigger, other) {
            (Trigger::Message(a), Trigger::Message(b)) => a == b,
            (Trigger::Expiry(a), Trigger::Expiry(b)) => a == b,
            (Trigger::Fence, Trigger::Fence) => true,
            (
                Trigger::Message(_) | Trigger::Expiry(_) | Trigger::Fence | Trigger::Silence { .. },
                Trigger::Message(_) | Trigger::Expiry(_) | Trigger::Fence | Trigger::Silence { .. },
            ) => false,
        };
        let handlers = &self.hir.tasks[task.index()].handlers;
        handlers.iter().find(|handler| same(&handler.trigger)).map(|handler| handler.span)
    }
}

/// The diagnostic for a handler's variable that hides a variable of the task. By contrast, `receive p(x)` assigns to the
/// task's variable.
fn hides(name: &Name, first: crate::Span) -> Diagnostic {
    let message = format!("`{}` hides the task's variable `{}` in this handler", name.text, name.text);
    Diagnostic::warning(HIDES, name.span, message)
        .label("a new variable, which ends with the handler")
        .also(first, "the task's variable, which keeps its value")
        .help("choose another name; to keep the value, assign it in the handler: `kept := came;`")
}
