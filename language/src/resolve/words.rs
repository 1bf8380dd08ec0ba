//! Resolves names and keywords in the expressions of statements.

use super::STATEMENT;
use super::TYPES;
use super::expr::{Leaves, Typed};
use super::scope::Found;
use super::statements::Thread;
use crate::ast::{Expr as Written, ExprKind, Name, Place};
use crate::diagnostic::Diagnostic;
use crate::hir::Captured;
use crate::span::Span;
use imrs_protocol::script::{Binary, Op, StatementOutcome, Term, Type};
use imrs_protocol::{Class, PortId, TaskId, Usage};

/// The names of outcomes; `done` stands for every good outcome.
const OUTCOMES: [(&str, &[StatementOutcome]); 15] = [
    (
        "done",
        &[
            StatementOutcome::Done,
            StatementOutcome::Reply,
            StatementOutcome::Message,
            StatementOutcome::Released,
        ],
    ),
    ("answered", &[StatementOutcome::Reply]),
    ("reply", &[StatementOutcome::Reply]),
    ("refused", &[StatementOutcome::Refused]),
    ("timed_out_unsent", &[StatementOutcome::TimedOutUnsent]),
    ("timed_out_unknown", &[StatementOutcome::TimedOutUnknown]),
    ("peer_restarted", &[StatementOutcome::PeerRestarted]),
    ("incomplete", &[StatementOutcome::Incomplete]),
    ("message", &[StatementOutcome::Message]),
    ("nothing", &[StatementOutcome::Nothing]),
    ("released", &[StatementOutcome::Released]),
    ("gave_up", &[StatementOutcome::GaveUp]),
    ("failed", &[StatementOutcome::Failed]),
    ("unanswerable", &[StatementOutcome::Unanswerable]),
    ("fenced", &[StatementOutcome::Fenced]),
];

impl Leaves for Thread<'_, '_> {
    fn report(&mut self, found: Diagnostic) {
        self.resolver.report(found);
    }

    fn place(&mut self, place: &Place) -> Option<Typed> {
        if let [name] = &place.path[..]
            && !self.scope.has(&name.text)
        {
            let message = match name.text.to_ascii_lowercase().as_str() {
                "ticket" => return Some(self.ticket(name.span)),
                "outcome" => "`outcome` is compared with one: `outcome = refused`",
                "sender" => "`sender` is compared with a task: `sender = armL`",
                "received" => "`received` is compared with a port: `received = halt`",
                _ => {
                    self.unknown_variable(name, &["outcome", "sender", "received", "ticket"]);
                    return None;
                }
            };
            self.report(
                Diagnostic::error(TYPES, name.span, message)
                    .label("no value of its own")
                    .help("compare it with `=` or `<>`"),
            );
            return None;
        }
        match self.find(place)? {
            Found::One(to) => Some(Typed::new(to.of, vec![Op::Term(Term::Load(to.slot))], place.span)),
            Found::Whole(_) => {
                let name = super::scope::path(&place.path);
                self.report(
                    Diagnostic::error(TYPES, place.span, format!("`{name}` is a whole record"))
                        .label("not one value")
                        .help(format!("name a field: `{name}.x`")),
                );
                None
            }
            Found::Timer(_) => {
                self.report(
                    Diagnostic::error(TYPES, place.span, "a timer has no value")
                        .label("a timer")
                        .help("set a variable in its `on expiry`, and look at that"),
                );
                None
            }
        }
    }

    fn call(&mut self, of: &Place, argument: &Name, span: Span) -> Option<Typed> {
        let [port, word] = &of.path[..] else {
            self.report(
                Diagnostic::error(TYPES, of.span, "neither a function nor a question about a port")
                    .label("`trunc(r)`, `p.answered(t)`, `p.refused(t)`, `p.told(t)` or `p.field(t)`")
                    .help("another function is an action: `run NAME x -> y;`, and a driver computes it"),
            );
            return None;
        };
        let Some(at) = self.resolver.ports.get(&port.text) else {
            let found = super::names::unknown("port", port, self.resolver.ports.all());
            self.report(found);
            return None;
        };
        let id = PortId::from_index(at);
        let task = self.resolver.tasks.get(&argument.text).map(TaskId::from_index);
        let declared = &self.resolver.hir.ports[at];
        let Some(task) = task.filter(|&task| declared.peers(self.task).any(|peer| peer == task)) else {
            let message = format!("`{}` is not at the other end of port `{}`", argument.text, port.text);
            let found = Diagnostic::error(STATEMENT, argument.span, message)
                .label("was not asked")
                .also(declared.user_list.unwrap_or(declared.span), "the tasks that were asked")
                .help("name a task at the other end of the port");
            self.report(found);
            return None;
        };
        let what = match word.text.to_ascii_lowercase().as_str() {
            "answered" => Captured::Answered(id, task),
            "refused" => Captured::Refused(id, task),
            _ => return self.told_by(id, task, word, span),
        };
        let (slot, of) = self.capture(what, span);
        Some(Typed::new(of, vec![Op::Term(Term::Load(slot))], span))
    }

    fn compared(&mut self, a: &Written, b: &Written, span: Span) -> Option<Option<Typed>> {
        let word = |written: &Written| match &written.kind {
            ExprKind::Path(Place { path, .. }) if path.len() == 1 => Some(path[0].clone()),
            _ => None,
        };
        let (a, b) = (word(a), word(b));
        let special = |name: &Name| {
            let lower = name.text.to_ascii_lowercase();
            let known = ["outcome", "sender", "received"].into_iter().find(|word| *word == lower);
            known.filter(|_| !self.scope.has(&name.text))
        };
        let first = a.as_ref().and_then(special);
        let (which, own, other) = match (first, b.as_ref().and_then(special)) {
            (Some(which), _) => (which, a?, b),
            (None, Some(which)) => (which, b?, a),
            (None, None) => return None,
        };
        let Some(other) = other else {
            return Some(self.place(&Place { path: vec![own.clone()], span: own.span }));
        };
        Some(self.compare(which, &other, span))
    }
}

impl Thread<'_, '_> {
    /// Resolves `ticket`: the number of the last received message.
    fn ticket(&mut self, span: Span) -> Typed {
        let (slot, of) = self.capture(Captured::Ticket, span);
        Typed::new(of, vec![Op::Term(Term::Load(slot))], span)
    }

    /// Resolves `lift.height(armR)`: a value that a member brought to a waitfor, or sent in its answer (D93).
    fn told_by(&mut self, port: PortId, task: TaskId, word: &Name, span: Span) -> Option<Typed> {
        let declared = self.resolver.hir.ports[port.index()].clone();
        let meets = declared.usage == Usage::Waitfor;
        let asks = matches!(declared.usage_of(self.task), Some(Usage::Send | Usage::Query))
            && declared.class == Class::Command;
        let fields = if meets { &declared.message } else { &declared.answer };
        let at = fields.iter().position(|field| field.name == word.text);
        let told = meets && word.text.eq_ignore_ascii_case("told");
        if !(meets || asks) || (at.is_none() && !told) {
            let words = if meets { &["told"][..] } else { &["answered", "refused"][..] };
            let names = fields.iter().filter(|_| meets || asks).map(|field| field.name.as_str());
            let found = super::names::unknown("question", word, words.iter().copied().chain(names));
            self.report(found.also(declared.span, "the port"));
            return None;
        }
        let first = self.told(port, task, fields, span);
        let (slot, of) = match at {
            Some(at) => (super::scope::after(first, at + 1), fields[at].of),
            None => (first, Type::Bool),
        };
        Some(Typed::new(of, vec![Op::Term(Term::Load(slot))], span))
    }

    fn compare(&mut self, which: &str, other: &Name, span: Span) -> Option<Typed> {
        let (what, values): (Captured, Vec<i64>) = match which {
            "outcome" => {
                let lower = other.text.to_ascii_lowercase();
                let Some((_, outcomes)) = OUTCOMES.iter().find(|(name, _)| *name == lower) else {
                    let names = OUTCOMES.iter().map(|&(name, _)| name);
                    let found = super::names::unknown("outcome", other, names);
                    self.report(found);
                    return None;
                };
                (Captured::Outcome, outcomes.iter().map(|&outcome| i64::from(outcome as u8)).collect())
            }
            "sender" => {
                let Some(at) = self.resolver.tasks.get(&other.text) else {
                    let found = super::names::unknown("task", other, self.resolver.tasks.all());
                    self.report(found);
                    return None;
                };
                (Captured::Sender, vec![i64::from(TaskId::from_index(at).0)])
            }
            _ => {
                let Some(at) = self.resolver.ports.get(&other.text) else {
                    let found = super::names::unknown("port", other, self.resolver.ports.all());
                    self.report(found);
                    return None;
                };
                (Captured::Received, vec![i64::from(PortId::from_index(at).0)])
            }
        };
        let (slot, _) = self.capture(what, span);
        let mut ops = Vec::new();
        for (i, value) in values.into_iter().enumerate() {
            let is = [Term::Load(slot), Term::Push(value), Term::Int(Binary::Equal)];
            ops.extend(is.map(Op::Term));
            if i > 0 {
                ops.push(Op::Term(Term::Int(Binary::Or)));
            }
        }
        Some(Typed::new(Type::Bool, ops, span))
    }
}
