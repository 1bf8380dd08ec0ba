//! Resolves checks: expressions over the variables of all tasks (D45).

use super::expr::{self, Leaves, Typed};
use super::names::{duplicate, unknown};
use super::scope::path;
use super::{Resolver, STATEMENT, TOO_MANY, TYPES};
use crate::ast::{self, CheckKind as Said, Expr as Written, ExprKind, Item, Name, Place};
use crate::diagnostic::Diagnostic;
use crate::hir::{Check, CheckKind, Expr};
use crate::span::Span;
use imrs_protocol::script::{CHECK_DEPTH, Op, Predicate, Term, Type};
use imrs_protocol::{Class, PortId, TaskId, Usage};

impl<'a> Resolver<'a> {
    pub(super) fn checks(&mut self, file: &'a ast::File) {
        for item in &file.items {
            let Item::Check(check) = item else { continue };
            let first = self.hir.checks.iter().find(|other| other.name == check.name.text);
            if let Some(first) = first.map(|first| first.span) {
                self.report(duplicate("checks", &check.name, first));
            }
            let kind = match &check.kind {
                Said::Never(expr) => self.truth(expr).map(CheckKind::Never),
                Said::Always(expr) => self.truth(expr).map(CheckKind::Always),
                Said::Leads { when, then, within } => {
                    let (when, then) = (self.truth(when), self.truth(then));
                    when.zip(then).map(|(when, then)| CheckKind::Leads { when, then, within: *within })
                }
            };
            if let Some(kind) = kind {
                self.hir.checks.push(Check { name: check.name.text.clone(), kind, span: check.name.span });
            }
        }
    }

    fn truth(&mut self, written: &'a Written) -> Option<Expr> {
        let mut leaves = Cell { resolver: self };
        let value = expr::typed(&mut leaves, written)?;
        let value = expr::truth(&mut leaves, value, "a check")?.finish();
        if depth(&value.ops) > CHECK_DEPTH {
            self.report(
                Diagnostic::error(TOO_MANY, value.span, "this is too deep for a check")
                    .label(format!("more than {CHECK_DEPTH} values at a time"))
                    .help("write it as several checks"),
            );
            return None;
        }
        Some(value)
    }
}

/// The most values that the operations keep on the stack at once.
fn depth(ops: &[Op]) -> usize {
    let (mut held, mut most) = (0_usize, 0);
    for op in ops {
        let Op::Term(term) = op else { continue };
        match term {
            Term::Push(_) | Term::Load(_) | Term::Of { .. } | Term::Is(_) => held += 1,
            Term::Int(_) | Term::Real(_) => held = held.saturating_sub(1),
            Term::Negate | Term::NegateReal | Term::Not | Term::ToReal | Term::ToInt => {}
        }
        most = most.max(held);
    }
    most
}

/// The scope of a check's expressions: all names of the cell.
struct Cell<'r, 'a> {
    resolver: &'r mut Resolver<'a>,
}

impl Cell<'_, '_> {
    fn task(&mut self, name: &Name) -> Option<TaskId> {
        let at = self.resolver.tasks.get(&name.text);
        if at.is_none() && !self.resolver.poison.tasks.contains(name.text.as_str()) {
            let found = unknown("task", name, self.resolver.tasks.all());
            self.report(found);
        }
        at.map(TaskId::from_index)
    }

    fn port(&mut self, name: &Name) -> Option<PortId> {
        let at = self.resolver.ports.get(&name.text);
        if at.is_none() && !self.resolver.poison.ports.contains(name.text.as_str()) {
            let found = unknown("port", name, self.resolver.ports.all());
            self.report(found);
        }
        at.filter(|at| !self.resolver.poisoned_ports.contains(at)).map(PortId::from_index)
    }

    /// Resolves `lift.arrived(armR)`: whether a member has arrived at a rendezvous.
    fn arrived(&mut self, port: &Name, task: &Name, span: Span) -> Option<Typed> {
        let (id, task_id) = (self.port(port), self.task(task));
        let (id, task_id) = (id?, task_id?);
        let declared = &self.resolver.hir.ports[id.index()];
        if declared.usage != Usage::Waitfor || declared.usage_of(task_id).is_none() {
            let (message, label) = if declared.usage == Usage::Waitfor {
                (format!("`{}` does not take part in `{}`", task.text, port.text), "never arrives")
            } else {
                (format!("port `{}` is not a waitfor", port.text), "no task arrives there")
            };
            let found = Diagnostic::error(STATEMENT, span, message)
                .label(label)
                .also(declared.span, "the port")
                .help("ask about a `waitfor` port and one of its tasks");
            self.report(found);
            return None;
        }
        Some(is(Predicate::Arrived { port: id, task: task_id }, span))
    }

    /// Resolves `r2.asked(grab)` and `r2.answered(grab)`: whether a task has an outstanding request on a port, or has got
    /// the answer to its last request.
    fn requested(&mut self, task: &Name, word: &Name, port: &Name, span: Span) -> Option<Typed> {
        let (task_id, id) = (self.task(task), self.port(port));
        let (task_id, id) = (task_id?, id?);
        let declared = &self.resolver.hir.ports[id.index()];
        let asks = matches!(declared.usage_of(task_id), Some(Usage::Send | Usage::Query));
        if !asks || declared.class == Class::Status {
            let message = format!("`{}` asks nothing on port `{}`", task.text, port.text);
            let found = Diagnostic::error(STATEMENT, span, message)
                .label("never true")
                .also(declared.span, "the port")
                .help("name a task that sends class-2 messages or queries there");
            self.report(found);
            return None;
        }
        Some(match word.text.to_ascii_lowercase().as_str() {
            "asked" => is(Predicate::Asked { task: task_id, port: id }, span),
            _ => is(Predicate::Answered { task: task_id, port: id }, span),
        })
    }
}

fn is(predicate: Predicate, span: Span) -> Typed {
    Typed::new(Type::Bool, vec![Op::Term(Term::Is(predicate))], span)
}

impl Leaves for Cell<'_, '_> {
    fn report(&mut self, found: Diagnostic) {
        self.resolver.report(found);
    }

    fn place(&mut self, place: &Place) -> Option<Typed> {
        let [name, rest @ ..] = &place.path[..] else { return None };
        let task = self.task(name)?;
        let declared = &self.resolver.hir.tasks[task.index()];
        let wanted = path(rest);
        let at = declared.variables.iter().position(|variable| variable.name == wanted);
        if let Some(at) = at {
            let variable = u16::try_from(at).ok()?;
            let of = declared.variables[at].of;
            return Some(Typed::new(of, vec![Op::Term(Term::Of { task, variable })], place.span));
        }
        if let [word] = rest
            && word.text.eq_ignore_ascii_case("active")
        {
            return Some(is(Predicate::Active(task), place.span));
        }
        if rest.first().is_some_and(|first| {
            self.resolver.broken_variables.iter().any(|(of, name)| *of == task && *name == first.text)
        }) {
            return None;
        }
        let Some(last) = rest.last() else {
            self.report(
                Diagnostic::error(TYPES, place.span, format!("`{}` is a task, not a value", name.text))
                    .label("of what?")
                    .help(format!("name a variable of it, or `{}.active`", name.text)),
            );
            return None;
        };
        let whole =
            declared.variables.iter().any(|variable| variable.name.starts_with(&format!("{wanted}.")));
        let found = if whole {
            Diagnostic::error(TYPES, place.span, format!("`{wanted}` of `{}` is a whole record", name.text))
                .label("not one value")
                .help("name a field of it")
        } else {
            let name = Name { text: wanted, span: rest[0].span.to(last.span) };
            let known =
                declared.variables.iter().map(|v| v.name.as_str()).filter(|name| !name.starts_with('('));
            let what = format!("variable of task `{}` called", declared.name);
            unknown(&what, &name, known.chain(["active"])).label("no such variable")
        };
        self.report(found);
        None
    }

    fn call(&mut self, of: &Place, argument: &Name, span: Span) -> Option<Typed> {
        if let [subject, word] = &of.path[..] {
            match word.text.to_ascii_lowercase().as_str() {
                "arrived" => return self.arrived(subject, argument, span),
                "asked" | "answered" => return self.requested(subject, word, argument, span),
                _ => {
                    let found = unknown("question", word, ["arrived", "asked", "answered"]);
                    self.report(found);
                    return None;
                }
            }
        }
        self.report(
            Diagnostic::error(TYPES, of.span, "no such question")
                .label("`p.arrived(t)`, `t.asked(p)` or `t.answered(p)`")
                .help("name one port and one task"),
        );
        None
    }

    fn compared(&mut self, a: &Written, b: &Written, _: Span) -> Option<Option<Typed>> {
        let words = ["outcome", "sender", "received"];
        let special = [a, b].into_iter().find_map(|written| match &written.kind {
            ExprKind::Path(Place { path, span }) if path.len() == 1 => {
                let name = &path[0];
                let known = words.iter().any(|word| name.text.eq_ignore_ascii_case(word));
                (known && self.resolver.tasks.get(&name.text).is_none()).then(|| (name.text.clone(), *span))
            }
            _ => None,
        });
        let (name, span) = special?;
        self.report(
            Diagnostic::error(TYPES, span, format!("`{name}` means nothing in a check"))
                .label("a keyword of statements")
                .help("keep it in a variable of the task, and look at that"),
        );
        Some(None)
    }
}
