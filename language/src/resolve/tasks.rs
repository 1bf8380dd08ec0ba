//! Resolves tasks: their nodes, variables and statements.

use super::cell::MOST;
use super::names::duplicate;
use super::scope::{Entity, Scope, slot};
use super::statements::Thread;
use super::{Resolver, STATEMENT, TAKEOVER, TIMERS};
use crate::ast::{self, Item, TypeName};
use crate::diagnostic::Diagnostic;
use crate::hir::{Task, Timer, Trigger, Variable};
use imrs_protocol::{CommTask, TaskId, TimeId};

impl<'a> Resolver<'a> {
    pub(super) fn declare_tasks(&mut self, file: &'a ast::File) {
        for item in &file.items {
            let Item::Task(task) = item else { continue };
            if let Err(first) = self.tasks.add(&task.name, self.hir.tasks.len()) {
                self.report(duplicate("tasks", &task.name, first));
                self.poison.ports.extend(task.ports.iter().map(|port| port.name.text.as_str()));
                continue;
            }
            if self.hir.tasks.len() >= MOST {
                self.too_many("tasks", task.name.span);
                return;
            }
            self.declare_task(task);
        }
        for (at, task) in self.written.clone().into_iter().enumerate() {
            if let Some(other) = &task.standby_of {
                self.hir.tasks[at].standby_of = self.task(other);
            }
        }
    }

    fn declare_task(&mut self, task: &'a ast::TaskDecl) {
        let id = TaskId::from_index(self.hir.tasks.len());
        let node = self.node(&task.on).unwrap_or_default();
        if let Some(module) = &task.module {
            self.modules.entry(&module.text).or_default().push(id);
        }
        let rate = task.rate.as_ref().and_then(|rate| self.rate(rate));
        if let (Some(rate), None) = (&task.rate, task.is_extern) {
            let span = rate.count.span.to(rate.per.span);
            self.report(
                Diagnostic::error(STATEMENT, span, "a rate of a task that is not `extern`")
                    .label("what it does stands in its body")
                    .help("remove it, or declare the task `extern`"),
            );
        }
        self.hir.tasks.push(Task {
            name: task.name.text.clone(),
            node,
            module: task.module.as_ref().map(|module| module.text.clone()),
            standby_of: None,
            is_extern: task.is_extern.is_some(),
            rate,
            variables: Vec::new(),
            timers: Vec::new(),
            handlers: Vec::new(),
            body: Vec::new(),
            takeover: None,
            captures: Vec::new(),
            span: task.name.span,
        });
        self.written.push(task);
    }

    pub(super) fn behaviours(&mut self) {
        for (at, task) in self.written.clone().into_iter().enumerate() {
            self.behaviour(TaskId::from_index(at), task);
        }
    }

    fn behaviour(&mut self, id: TaskId, task: &'a ast::TaskDecl) {
        if let Some(word) = task.is_extern {
            let first = task.body.first().map(|statement| statement.span);
            if let Some(span) = first.or_else(|| task.handlers.first().map(|handler| handler.span)) {
                let message = format!("`{}` is extern, but has a body", task.name.text);
                self.report(
                    Diagnostic::error(STATEMENT, span, message)
                        .label("a Rust program implements it")
                        .also(word, "declared extern")
                        .help("remove the one or the other"),
                );
            }
            return;
        }
        let scope = self.variables(id, task);
        for handler in &task.handlers {
            self.handler(id, &scope, handler);
        }
        let mut thread = Thread::new(self, id, &scope, None);
        let body = thread.statements(&task.body);
        thread.forget_received();
        let takeover = task.takeover.as_ref().map(|takeover| thread.statements(takeover));
        let captures = thread.captures;
        let declared = &mut self.hir.tasks[id.index()];
        (declared.body, declared.takeover, declared.captures) = (body, takeover, captures);
        self.role(id, task);
        self.timers(id, task, &scope);
    }

    fn variables(&mut self, id: TaskId, task: &'a ast::TaskDecl) -> Scope<'a> {
        let mut scope = Scope::default();
        for decl in &task.variables {
            let record = match &decl.of {
                TypeName::Record(name) => self.record(name),
                TypeName::Plain(..) | TypeName::Timer(_) => None,
            };
            for name in &decl.names {
                let at = self.hir.tasks[id.index()].variables.len();
                let entity = match (&decl.of, record) {
                    (TypeName::Plain(of, _), _) => {
                        self.variable(id, name.text.clone(), *of, name.span);
                        Entity::Plain(slot(at), *of)
                    }
                    (TypeName::Timer(_), _) => {
                        let timers = &mut self.hir.tasks[id.index()].timers;
                        timers.push(Timer { name: name.text.clone(), span: name.span });
                        Entity::Timer(TimeId(u8::try_from(timers.len() - 1).unwrap_or(u8::MAX)))
                    }
                    (TypeName::Record(_), None) => {
                        self.broken_variables.insert((id, &name.text));
                        Entity::Unknown
                    }
                    (TypeName::Record(_), Some(record)) => {
                        for field in self.hir.records[record].fields.clone() {
                            let leaf = format!("{}.{}", name.text, field.name);
                            self.variable(id, leaf, field.of, name.span);
                        }
                        Entity::Record { record, first: slot(at) }
                    }
                };
                if let Err(first) = scope.add(name, entity) {
                    self.report(duplicate("variables", name, first));
                }
            }
        }
        if self.hir.tasks[id.index()].variables.len() > MOST / 2 {
            self.too_many("variables", task.name.span);
        }
        scope
    }

    fn variable(&mut self, id: TaskId, name: String, of: imrs_protocol::script::Type, span: crate::Span) {
        self.hir.tasks[id.index()].variables.push(Variable { name, of, span });
    }

    /// Checks that a standby has a `takeover`, and that no other task has one (D61).
    fn role(&mut self, id: TaskId, task: &'a ast::TaskDecl) {
        let (stands_by, mutual) = self.stands_by(id);
        let declared = &self.hir.tasks[id.index()];
        let found = match (&declared.takeover, stands_by || mutual) {
            (Some(_), false) => Some(
                Diagnostic::error(
                    TAKEOVER,
                    task.name.span,
                    format!("`{}` has a takeover, but stands by for no task", task.name.text),
                )
                .label("nothing ever calls it")
                .help(format!(
                    "add `standby of ..` and `couple work .. -> {} lease .. takeover .. every .. via ..;`",
                    task.name.text
                )),
            ),
            (None, true) => {
                let why = if stands_by { "stands by in" } else { "becomes the standby of" };
                Some(
                    Diagnostic::error(
                        TAKEOVER,
                        task.name.span,
                        format!("`{}` {why} a couple, but has no `takeover`", task.name.text),
                    )
                    .label("what shall it do when it takes over?")
                    .help("add `takeover ..` behind its body"),
                )
            }
            _ => None,
        };
        self.found.extend(found);
    }

    /// Checks that every timer has a handler, and that the communication task has room for all timers.
    fn timers(&mut self, id: TaskId, task: &'a ast::TaskDecl, scope: &Scope<'a>) {
        let declared = &self.hir.tasks[id.index()];
        let handled = |timer: usize| {
            declared.handlers.iter().any(|handler| match handler.trigger {
                Trigger::Expiry(at) | Trigger::Silence { timer: at, .. } => usize::from(at.0) == timer,
                Trigger::Message(_) | Trigger::Fence => false,
            })
        };
        let idle: Vec<_> = declared.timers.iter().enumerate().filter(|&(at, _)| !handled(at)).collect();
        let mut found: Vec<Diagnostic> = Vec::new();
        for (_, timer) in idle.into_iter().filter(|(_, timer)| !scope.is_twice(timer.span)) {
            let message = format!("nothing happens when timer `{}` ends", timer.name);
            found.push(
                Diagnostic::error(TIMERS, timer.span, message)
                    .label("no `on expiry` for it")
                    .help(format!("add `on expiry {} do .. end;`, or remove it", timer.name)),
            );
        }
        if let Some(extra) = declared.timers.get(CommTask::TIMERS) {
            let message = format!("task `{}` has more than {} timers", task.name.text, CommTask::TIMERS);
            found.push(
                Diagnostic::error(TIMERS, extra.span, message)
                    .label("one too many")
                    .help("each `on silence` counts as one"),
            );
        }
        self.found.extend(found);
    }
}
