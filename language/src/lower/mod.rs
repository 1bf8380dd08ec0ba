//! From a resolved cell to what runs: declarations, task scripts and checks of [`imrs_protocol`], in microseconds for
//! the runtime or in ticks for the model (D42).

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

use crate::checks::carries_beats;
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
    /// In which unit all durations are.
    pub unit: Unit,
    /// What each task does, by `TaskId`.
    pub tasks: Vec<Behaviour>,
    /// What the messages of each port hold, by `PortId`.
    pub formats: Vec<Formats>,
    /// Where each node is, by `NodeId`.
    pub addresses: Vec<Address>,
    /// What may go wrong.
    pub faults: Vec<hir::Faults>,
    /// What must hold.
    pub checks: Vec<Check>,
    /// What was rounded.
    pub notes: Vec<Diagnostic>,
}

/// What the messages of a port hold.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Formats {
    /// Its messages, or what is told at a `waitfor`; empty for the beats of a couple, whose layout is the machine's own.
    pub message: Format,
    /// Its answers.
    pub answer: Format,
}

/// What a task does.
#[derive(Clone, Debug)]
pub enum Behaviour {
    /// It runs a script.
    Script(Box<Script>),
    /// A Rust program says so, at most this often.
    Extern(Option<Rate>),
}

/// A task's script and where it comes from.
#[derive(Clone, Debug)]
pub struct Script {
    /// The operations.
    pub program: Arc<Program>,
    /// For each operation the statement that it belongs to.
    pub spans: Vec<Span>,
    /// For each handler of the program, its head.
    pub handlers: Vec<Span>,
    /// For each action of the program, what passes between it and the script.
    pub actions: Vec<Action>,
}

/// An action outside.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Action {
    /// Its name.
    pub name: String,
    /// What it is given.
    pub arguments: Vec<Type>,
    /// What it gives; nothing reads it where there is none.
    pub result: Option<Type>,
    /// The least and the most that it gives.
    pub range: Option<(i64, i64)>,
    /// Whether its result also goes elsewhere than into comparisons with constants: into a message, a sum, another variable.
    pub travels: bool,
    /// Results that a checker should try: the ends of the range, and both sides of what the results are compared with; of
    /// those that travel, of whatever the cell compares with.
    pub values: Vec<i64>,
}

/// Where a node is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Address {
    /// Its host.
    pub host: Option<String>,
    /// Its UDP port.
    pub port: Option<u16>,
}

/// What must hold.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Check {
    /// Its name.
    pub name: String,
    /// What.
    pub kind: CheckKind,
    /// Where its name stands.
    pub span: Span,
}

/// What must hold, as expressions that [`imrs_protocol::script::eval`] evaluates.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CheckKind {
    /// In every state.
    Always(Vec<Term>),
    /// Whenever `when` is true, `then` is, then or within so much time.
    Leads {
        /// The one.
        when: Vec<Term>,
        /// The other.
        then: Vec<Term>,
        /// How long.
        within: Ticks,
    },
}

/// Turns a cell into what runs.
///
/// # Errors
/// What is too large for a script (E123), and E125 for a fault of the compiler itself. Nothing else is left to be wrong
/// in a cell that was resolved without errors.
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
    if carries_beats(hir, id) {
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

/// The terms of an expression that asks the communication task nothing.
fn terms(expr: &hir::Expr) -> Vec<Term> {
    let terms = expr.ops.iter().map(|op| match op {
        Op::Term(term) => Some(*term),
        _ => None,
    });
    terms.flatten().collect()
}
