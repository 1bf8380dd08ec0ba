//! Resolves the statements of a body or a handler.

use super::expr::{self, Typed};
use super::scope::{Entity, Found, Scope, slot};
use super::{ORDER, Resolver, STATEMENT, TYPES};
use crate::ast::{self, BranchKind, Expr as Written, Place, StatementKind as Said};
use crate::diagnostic::Diagnostic;
use crate::hir::{Branch, Capture, Captured, Destination, Expr, Field, Statement, StatementKind, Variable};
use crate::span::Span;
use imrs_protocol::script::{Slot, Type};
use imrs_protocol::{PortId, Ranked, ServiceOrder, TaskId};

/// Resolves the statements of one thread: of a body with its take-over, or of a handler.
pub(super) struct Thread<'r, 'a> {
    pub resolver: &'r mut Resolver<'a>,
    pub task: TaskId,
    pub scope: &'r Scope<'a>,
    /// The variables of a handler; `None` in a body.
    pub locals: Option<Vec<Variable>>,
    pub captures: Vec<Capture>,
    /// The ports from which the thread may have received its last message.
    pub received: Vec<PortId>,
    /// Whether the thread may have received a message from an unknown port.
    pub received_unknown: bool,
    /// How many loops enclose the current statement.
    loops: usize,
}

impl<'r, 'a> Thread<'r, 'a> {
    pub fn new(
        resolver: &'r mut Resolver<'a>,
        task: TaskId,
        scope: &'r Scope<'a>,
        locals: Option<Vec<Variable>>,
    ) -> Self {
        Self {
            resolver,
            task,
            scope,
            locals,
            captures: Vec::new(),
            received: Vec::new(),
            received_unknown: false,
            loops: 0,
        }
    }

    pub fn forget_received(&mut self) {
        self.received.clear();
    }

    pub fn report(&mut self, found: Diagnostic) {
        self.resolver.report(found);
    }

    pub fn statements(&mut self, written: &'a [ast::Statement]) -> Vec<Statement> {
        written.iter().filter_map(|statement| self.statement(statement)).collect()
    }

    fn statement(&mut self, written: &'a ast::Statement) -> Option<Statement> {
        let span = written.span;
        let kind = self.kind(written);
        // Branches are resolved even if the statement is wrong, because their faults are independent of it.
        let branches = self.branches(written, kind.as_ref());
        Some(Statement { kind: kind?, branches, span })
    }

    fn kind(&mut self, written: &'a ast::Statement) -> Option<StatementKind> {
        let span = written.span;
        Some(match &written.kind {
            Said::Send { verb, port, arguments, into, within } => {
                self.send(*verb, port, arguments, into, *within, span)?
            }
            Said::Receive { port, into, from, within } => {
                self.receive(port.as_ref(), into, from.as_ref(), *within)?
            }
            Said::Reply { response, port, arguments, asker: None, .. } => {
                self.reply(*response, port.as_ref(), arguments, span)?
            }
            Said::Reply { response, port, arguments, asker: Some(asker), ticket } => {
                self.reply_for((*response, port.as_ref()), arguments, (asker, ticket.as_ref()), span)?
            }
            Said::Waitfor { port, arguments, within } => self.waitfor(port, arguments, *within)?,
            Said::Order(names) => self.order(names, span)?,
            Said::Delay(length) => StatementKind::Delay(*length),
            Said::Run { action, arguments, into, range, takes } => {
                self.run(action, arguments, into, range.as_ref(), *takes)?
            }
            Said::Start { timer, length } => {
                StatementKind::Start { timer: self.timer(timer)?, length: *length }
            }
            Said::Stop(timer) => StatementKind::Stop(self.timer(timer)?),
            Said::Atomic(body) => StatementKind::Atomic(self.statements(body)),
            Said::Assign { place, value } => self.assign(place, value)?,
            Said::If { arms, otherwise } => self.conditional(arms, otherwise.as_deref())?,
            Said::Loop(body) => StatementKind::Loop(self.looped(body)),
            Said::While(condition, body) => {
                let condition = self.condition(condition, "`while`");
                let body = self.looped(body);
                StatementKind::While(condition?, body)
            }
            Said::Exit if self.loops == 0 => {
                self.report(
                    Diagnostic::error(STATEMENT, span, "`exit` outside of a loop")
                        .label("there is no loop to leave")
                        .help("put it into a `loop` or `while`; a task is ended by `abort \"why\"`"),
                );
                return None;
            }
            Said::Exit => StatementKind::Exit,
            Said::Skip => StatementKind::Skip,
            Said::Abort(reason) => StatementKind::Abort(reason.clone()),
            Said::Assert(condition) => StatementKind::Assert(self.condition(condition, "`assert`")?),
        })
    }

    /// Resolves a loop's body, whose beginning may answer a message that its end received in the iteration before.
    fn looped(&mut self, body: &'a [ast::Statement]) -> Vec<Statement> {
        let before = self.received.clone();
        let mut later = Vec::new();
        received_in(body, &mut later);
        for name in later {
            match self.resolver.ports.get(&name.text) {
                Some(at) if !self.resolver.poisoned_ports.contains(&at) => {
                    self.may_have_received(PortId::from_index(at));
                }
                Some(_) | None => self.received_unknown = true,
            }
        }
        self.loops += 1;
        let statements = self.statements(body);
        self.loops -= 1;
        before.into_iter().for_each(|port| self.may_have_received(port));
        statements
    }

    pub fn may_have_received(&mut self, port: PortId) {
        if !self.received.contains(&port) {
            self.received.push(port);
        }
    }

    fn conditional(
        &mut self,
        arms: &'a [(Written, Vec<ast::Statement>)],
        otherwise: Option<&'a [ast::Statement]>,
    ) -> Option<StatementKind> {
        let before = self.received.clone();
        let mut after = Vec::new();
        let mut resolved = Some(Vec::new());
        for (condition, body) in arms {
            self.received.clone_from(&before);
            let condition = self.condition(condition, "`if`");
            let body = self.statements(body);
            after.append(&mut self.received);
            resolved = resolved.zip(condition).map(|(mut arms, condition)| {
                arms.push((condition, body));
                arms
            });
        }
        self.received = before;
        let otherwise = otherwise.map(|body| self.statements(body)).unwrap_or_default();
        after.into_iter().for_each(|port| self.may_have_received(port));
        Some(StatementKind::If { arms: resolved?, otherwise })
    }

    pub fn condition(&mut self, written: &'a Written, of: &str) -> Option<Expr> {
        let value = expr::typed(self, written)?;
        expr::truth(self, value, of).map(Typed::finish)
    }

    fn assign(&mut self, place: &'a Place, value: &'a Written) -> Option<StatementKind> {
        if let [name] = &place.path[..]
            && !self.scope.has(&name.text)
            && let Some(at) = self.resolver.ports.get(&name.text)
        {
            return self.publish(PortId::from_index(at), name, value);
        }
        if let Some(port) = self.heartbeats_of(value) {
            return self.published(port, place);
        }
        match self.find(place)? {
            Found::Timer(_) => {
                self.report(
                    Diagnostic::error(STATEMENT, place.span, "a timer is started, not assigned")
                        .label("a timer")
                        .help(format!("write `start {} 100 msec`", super::scope::path(&place.path))),
                );
                None
            }
            Found::One(to) => {
                let value = expr::typed(self, value)?;
                let name = format!("`{}`", super::scope::path(&place.path));
                let value = expr::coerced(self, value, to.of, &name)?.finish();
                Some(StatementKind::Assign { to, value })
            }
            Found::Whole(to) => {
                let fields: Vec<Type> = to.iter().map(|to| to.of).collect();
                let name = super::scope::path(&place.path);
                let values = self.whole(value, &fields, &format!("record `{name}`"))?;
                Some(StatementKind::AssignAll { to, values })
            }
        }
    }

    /// The fields of a record variable, for a place that needs values of these types.
    pub fn whole(&mut self, value: &'a Written, fields: &[Type], what: &str) -> Option<Vec<Expr>> {
        let places = match &value.kind {
            ast::ExprKind::Path(place) => match self.find(place)? {
                Found::Whole(places) => Some(places),
                Found::One(_) | Found::Timer(_) => None,
            },
            _ => None,
        };
        let agrees = |places: &Vec<Destination>| {
            places.len() == fields.len() && places.iter().zip(fields).all(|(place, of)| place.of == *of)
        };
        let Some(places) = places.filter(agrees) else {
            self.report(
                Diagnostic::error(TYPES, value.span, format!("{what} wants a record of the same fields"))
                    .label("no such record")
                    .help("assign a variable of the same type, or its fields one by one"),
            );
            return None;
        };
        Some(places.into_iter().map(|place| load(place, value.span)).collect())
    }

    pub fn find(&mut self, place: &Place) -> Option<Found> {
        match self.scope.place(place, &self.resolver.hir.records) {
            Ok(found) => Some(found),
            Err(found) => {
                if let Some(found) = found {
                    self.report(*found);
                }
                None
            }
        }
    }

    fn timer(&mut self, name: &'a ast::Name) -> Option<imrs_protocol::TimeId> {
        let place = Place { path: vec![name.clone()], span: name.span };
        match self.scope.get(&name.text) {
            None => {
                let timers = &self.resolver.hir.tasks[self.task.index()].timers;
                let found = super::names::unknown("timer", name, timers.iter().map(|t| t.name.as_str()));
                self.report(found);
                None
            }
            Some(_) => match self.find(&place)? {
                Found::Timer(timer) => Some(timer),
                Found::One(_) | Found::Whole(_) => {
                    self.report(
                        Diagnostic::error(TYPES, name.span, format!("`{}` is not a timer", name.text))
                            .label("a variable of another type")
                            .help(format!("declare one: `var {}: timer;`", name.text)),
                    );
                    None
                }
            },
        }
    }

    fn order(&mut self, names: &'a [ast::Name], span: Span) -> Option<StatementKind> {
        let mut ranked = Vec::new();
        for name in names {
            let Some(level) = self.ranked(name) else { continue };
            if ranked.contains(&level) {
                self.report(
                    Diagnostic::error(ORDER, name.span, format!("`{}` has a rank already", name.text))
                        .label("named twice")
                        .help("remove it once"),
                );
                continue;
            }
            ranked.push(level);
        }
        if let Some(extra) = names.get(ServiceOrder::LEVELS) {
            let message =
                format!("an order of {} levels; at most {} are kept", names.len(), ServiceOrder::LEVELS);
            self.report(
                Diagnostic::error(ORDER, extra.span, message)
                    .label("one too many")
                    .also(span, "this order")
                    .help("what is not named ranks last, all equal"),
            );
            return None;
        }
        Some(StatementKind::Order(ranked))
    }

    /// Resolves an entry of an `order`: a port, a task, a timer of this task, all `timers`, or `self`.
    fn ranked(&mut self, name: &'a ast::Name) -> Option<Ranked> {
        let word = name.text.to_ascii_lowercase();
        if word == "self" {
            return Some(Ranked::Own);
        }
        if word == "timer" || word == "timers" {
            return Some(Ranked::Timers);
        }
        let resolver = &mut *self.resolver;
        if let Some(at) = resolver.ports.get(&name.text) {
            let port = PortId::from_index(at);
            if resolver.poisoned_ports.contains(&at) {
                return None;
            }
            if resolver.hir.ports[at].usage_of(self.task).is_none() {
                self.not_declared(port, name);
                return None;
            }
            return Some(Ranked::Port(port));
        }
        if let Some(at) = resolver.tasks.get(&name.text) {
            return Some(Ranked::Source(TaskId::from_index(at)));
        }
        if let Some(Entity::Timer(timer)) = self.scope.get(&name.text) {
            return Some(Ranked::Timer(timer));
        }
        let known = resolver.poison.ports.contains(name.text.as_str())
            || resolver.poison.tasks.contains(name.text.as_str());
        if !known {
            let words = ["self", "timers"];
            let names = resolver.ports.all().chain(resolver.tasks.all()).chain(words);
            let found = super::names::unknown("port or task", name, names);
            resolver.report(found);
        }
        None
    }

    fn branches(&mut self, written: &'a ast::Statement, kind: Option<&StatementKind>) -> Vec<Branch> {
        let before = self.received.clone();
        let mut after: Vec<PortId> = Vec::new();
        let mut branches: Vec<Branch> = Vec::new();
        for branch in &written.branches {
            if let Some(first) = branches.iter().find(|other| other.when == branch.when) {
                let first = first.span;
                self.report(
                    Diagnostic::error(STATEMENT, branch.span, "the same branch twice")
                        .label("the second one")
                        .also(first, "the first one")
                        .help("put the statements of both into one"),
                );
            } else if let Some(kind) = kind {
                self.branch_fits(kind, branch);
            }
            self.received.clone_from(&before);
            let body = self.statements(&branch.body);
            after.append(&mut self.received);
            branches.push(Branch { when: branch.when, body, span: branch.span });
        }
        self.received = before;
        after.into_iter().for_each(|port| self.may_have_received(port));
        branches
    }

    /// The hidden variable in which this thread saves a value.
    pub fn capture(&mut self, what: Captured, span: Span) -> (Slot, Type) {
        let (name, of) = match what {
            Captured::Outcome => ("outcome", Type::Int8),
            Captured::Sender => ("sender", Type::Word),
            Captured::Received => ("received", Type::Word),
            Captured::Answered(..) => ("answered", Type::Bool),
            Captured::Refused(..) => ("refused", Type::Bool),
            Captured::Told(..) => ("told", Type::Bool),
            Captured::Ticket => ("ticket", Type::Word),
        };
        if let Some(known) = self.captures.iter().find(|known| known.what == what) {
            return (known.slot, of);
        }
        let slot = self.keep(Variable { name: format!("({name})"), of, span });
        self.captures.push(Capture { what, slot });
        (slot, of)
    }

    /// Adds a variable that has no name in the cell.
    fn keep(&mut self, variable: Variable) -> Slot {
        if let Some(locals) = &mut self.locals {
            locals.push(variable);
            Slot::Local(u16::try_from(locals.len() - 1).unwrap_or(u16::MAX))
        } else {
            let variables = &mut self.resolver.hir.tasks[self.task.index()].variables;
            variables.push(variable);
            slot(variables.len() - 1)
        }
    }

    /// The slot that says whether the values of a task are known. The slots of these values follow.
    pub fn told(&mut self, port: PortId, task: TaskId, fields: &[Field], span: Span) -> Slot {
        let what = Captured::Told(port, task);
        let is_new = self.captures.iter().all(|known| known.what != what);
        let (slot, _) = self.capture(what, span);
        for field in fields.iter().filter(|_| is_new) {
            self.keep(Variable { name: format!("({})", field.name), of: field.of, span });
        }
        slot
    }
}

/// An expression that reads a variable.
pub(super) fn load(place: Destination, span: Span) -> Expr {
    use imrs_protocol::script::{Op, Term};
    Expr { of: place.of, ops: vec![Op::Term(Term::Load(place.slot))], span }
}

/// The ports from which these statements receive.
fn received_in<'a>(statements: &'a [ast::Statement], into: &mut Vec<&'a ast::Name>) {
    for statement in statements {
        statement.branches.iter().for_each(|branch| received_in(&branch.body, into));
        match &statement.kind {
            Said::Receive { port: Some(port), .. } => into.push(port),
            Said::Atomic(body) | Said::Loop(body) | Said::While(_, body) => received_in(body, into),
            Said::If { arms, otherwise } => {
                arms.iter().for_each(|(_, body)| received_in(body, into));
                otherwise.iter().for_each(|body| received_in(body, into));
            }
            Said::Send { .. }
            | Said::Receive { port: None, .. }
            | Said::Reply { .. }
            | Said::Waitfor { .. }
            | Said::Order(_)
            | Said::Delay(_)
            | Said::Run { .. }
            | Said::Start { .. }
            | Said::Stop(_)
            | Said::Assign { .. }
            | Said::Exit
            | Said::Skip
            | Said::Abort(_)
            | Said::Assert(_) => {}
        }
    }
}

/// The keywords of a branch, as text.
pub(super) const fn branch_word(kind: BranchKind) -> &'static str {
    match kind {
        BranchKind::TimeOut => "on time_out",
        BranchKind::Refused => "on refused",
        BranchKind::Failed => "on failed",
    }
}
