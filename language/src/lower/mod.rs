//! Lowering: turns a resolved cell into declarations, task scripts and checks of [`imrs_protocol`], in microseconds for the
//! runtime or in ticks for the model (D42).

mod actions;
mod cell;
mod emit;
mod errors;
mod outcomes;
mod silence;
mod statements;
mod task;
mod units;

pub use errors::table_errors;
pub use units::Unit;

use crate::checks::carries_heartbeats;
use crate::diagnostic::Diagnostic;
use crate::hir::{self, Hir};
use crate::span::Span;
use imrs_protocol::script::{Format, Op, Program, Term, Type};
use imrs_protocol::{Cell, PortId, Rate, Ticks};
use std::sync::Arc;
use units::Clock;

/// A cell that can run.
#[derive(Clone, Debug)]
pub struct Lowered {
    /// The declarations. Ids are those of the [`Hir`].
    pub cell: Cell,
    /// The unit of all durations.
    pub unit: Unit,
    /// The behaviour of each task, by `TaskId`.
    pub tasks: Vec<Behaviour>,
    /// The formats of each port's messages, by `PortId`.
    pub formats: Vec<Formats>,
    /// The address of each node, by `NodeId`.
    pub addresses: Vec<Address>,
    /// The fault hypotheses.
    pub faults: Vec<hir::Faults>,
    /// The properties to check.
    pub checks: Vec<Check>,
    /// Notes about rounded durations.
    pub notes: Vec<Diagnostic>,
}

/// The formats of a port's messages.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Formats {
    /// The format of messages, or of the values that members bring to a `waitfor`. Empty for heartbeats,
    /// whose layout the protocol sets.
    pub message: Format,
    /// The format of answers.
    pub answer: Format,
}

/// The behaviour of a task.
#[derive(Clone, Debug)]
pub enum Behaviour {
    /// The task runs a script.
    Script(Box<Script>),
    /// A Rust program is the behaviour. The program acts at most this often.
    Extern(Option<Rate>),
}

/// A task's script, with spans of its source.
#[derive(Clone, Debug)]
pub struct Script {
    /// The operations of the script.
    pub program: Arc<Program>,
    /// The span of the statement for each operation.
    pub spans: Vec<Span>,
    /// The span of the head for each handler of the program.
    pub handlers: Vec<Span>,
    /// The types and results of each action of the program.
    pub actions: Vec<Action>,
}

/// An action of a robot or another machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Action {
    /// The action's name.
    pub name: String,
    /// The types of the action's arguments.
    pub arguments: Vec<Type>,
    /// The type of the action's result; none if nothing reads the result.
    pub result: Option<Type>,
    /// The least and the greatest result that is allowed.
    pub range: Option<(i64, i64)>,
    /// Whether the result is also read outside of comparisons with constants: in a message, a sum, another variable.
    pub travels: bool,
    /// Results that a checker should try: the ends of the range, and both sides of the constants with which the result is
    /// compared. If the result travels, also both sides of every constant in the cell's comparisons.
    pub values: Vec<i64>,
}

/// The address of a node.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Address {
    /// The node's host.
    pub host: Option<String>,
    /// The node's UDP port.
    pub port: Option<u16>,
}

/// A property to check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Check {
    /// The property's name.
    pub name: String,
    /// The property's kind and its terms.
    pub kind: CheckKind,
    /// The span of the check's name.
    pub span: Span,
}

/// A kind of property, in terms that [`imrs_protocol::script::eval`] evaluates.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CheckKind {
    /// The terms are true in every state.
    Always(Vec<Term>),
    /// Whenever `when` is true, `then` is true at the same time or within `within`.
    Leads {
        /// The premise of the property.
        when: Vec<Term>,
        /// The consequence, which must become true in time.
        then: Vec<Term>,
        /// The longest time from the premise to the consequence.
        within: Ticks,
    },
}

/// Lowers a cell.
///
/// # Errors
/// E123 for a script that is too large, and E125 for a fault of the compiler itself. A cell that was resolved without errors
/// has no other errors here.
pub fn lower(hir: &Hir, unit: Unit) -> Result<Lowered, Vec<Diagnostic>> {
    let mut clock = Clock::new(hir, unit);
    let cell = cell::cell(hir, &mut clock);
    let mut errors = Vec::new();
    let mut tasks = Vec::new();
    for (at, task) in hir.tasks.iter().enumerate() {
        if task.is_extern {
            let rate = task.rate.map(|(count, per)| Rate { count, per: clock.period(per) });
            tasks.push(Behaviour::Extern(rate));
            continue;
        }
        match task::script(hir, imrs_protocol::TaskId::from_index(at), &mut clock) {
            Ok(script) => tasks.push(Behaviour::Script(Box::new(script))),
            Err(found) => errors.push(*found),
        }
    }
    if !errors.is_empty() {
        return Err(errors);
    }
    actions::try_what_others_compare(hir, &mut tasks);
    let addresses = hir.nodes.iter().map(|node| Address { host: node.host.clone(), port: node.port });
    let checks = hir.checks.iter().map(|check| self::check(check, &mut clock)).collect();
    let (addresses, faults) = (addresses.collect(), hir.faults.clone());
    let formats = (0..hir.ports.len()).map(|at| formats(hir, PortId::from_index(at))).collect();
    Ok(Lowered { cell, unit, tasks, formats, addresses, faults, checks, notes: clock.notes })
}

fn formats(hir: &Hir, id: PortId) -> Formats {
    if carries_heartbeats(hir, id) {
        return Formats::default();
    }
    let port = &hir.ports[id.index()];
    let format = |fields: &[hir::Field]| Format { fields: fields.iter().map(|field| field.of).collect() };
    Formats { message: format(&port.message), answer: format(&port.answer) }
}

fn check(check: &hir::Check, clock: &mut Clock) -> Check {
    let kind = match &check.kind {
        hir::CheckKind::Always(expr) => CheckKind::Always(terms(expr)),
        hir::CheckKind::Never(expr) => {
            let mut terms = terms(expr);
            terms.push(Term::Not);
            CheckKind::Always(terms)
        }
        hir::CheckKind::Leads { when, then, within } => {
            CheckKind::Leads { when: terms(when), then: terms(then), within: clock.time_out(*within) }
        }
    };
    Check { name: check.name.clone(), kind, span: check.span }
}

/// The terms of an expression that reads nothing from the communication task.
fn terms(expr: &hir::Expr) -> Vec<Term> {
    let terms = expr.ops.iter().map(|op| match op {
        Op::Term(term) => Some(*term),
        _ => None,
    });
    terms.flatten().collect()
}
