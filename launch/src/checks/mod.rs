//! Judges the checks of a cell (`never`, `always`, `leads … within`) by the values that the cell's tasks had in a run (D101).

mod judge;
mod sampler;
mod told;
mod vouch;

pub use judge::{Broken, Judge};
pub use sampler::{Change, ReplaySampler, ValueSampler};
pub use told::{First, Outcome, Settled, Settlement, Unvouched};

use crate::cells::Loaded;
use imrs_language::lower::{Check, CheckKind};
use imrs_protocol::script::{Predicate, Reading, Term};
use imrs_protocol::{CellTable, PortId, TaskId};

/// A value of one task that a check reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ask {
    /// The value of a variable, by its position.
    Variable(u16),
    /// Whether the task is active: whether it may act.
    Active,
    /// Whether the task has an outstanding request on this port.
    Asked(PortId),
    /// Whether the task's last request on this port was answered.
    Answered(PortId),
    /// How far the task has come at the waitfor of this port. −1: it has not reached the waitfor in this incarnation.
    /// 0: it has reached the waitfor, but no round yet. Otherwise the number of its last round plus 1.
    Arrived(PortId),
}

/// For each task, which of its values the checks of the cell read.
pub fn asks(loaded: &Loaded) -> Vec<Vec<Ask>> {
    let mut asks = vec![Vec::new(); loaded.table.cell().tasks.len()];
    for term in loaded.checks.iter().flat_map(terms) {
        for (task, ask) in of(&loaded.table, *term) {
            if let Some(asks) = asks.get_mut(task.index()).filter(|asks: &&mut Vec<Ask>| !asks.contains(&ask))
            {
                asks.push(ask);
            }
        }
    }
    asks
}

/// All terms of a check.
fn terms(check: &Check) -> impl Iterator<Item = &Term> {
    let (one, other) = match &check.kind {
        CheckKind::Always(terms) => (terms.as_slice(), &[][..]),
        CheckKind::Leads { when, then, .. } => (when.as_slice(), then.as_slice()),
    };
    one.iter().chain(other)
}

/// The values that a term reads, each with its task.
fn of(table: &CellTable, term: Term) -> Vec<(TaskId, Ask)> {
    match term.reads() {
        None => Vec::new(),
        Some(Reading::Variable(task, variable)) => vec![(task, Ask::Variable(variable))],
        Some(Reading::Predicate(Predicate::Active(task))) => vec![(task, Ask::Active)],
        Some(Reading::Predicate(Predicate::Asked { task, port })) => vec![(task, Ask::Asked(port))],
        Some(Reading::Predicate(Predicate::Answered { task, port })) => vec![(task, Ask::Answered(port))],
        // The values of all parties are read, because their rounds decide together whether one party has arrived (D85).
        Some(Reading::Predicate(Predicate::Arrived { port, .. })) => {
            let parties = table.port(port).map_or(&[][..], |port| &port.parties);
            parties.iter().map(|party| (party.task, Ask::Arrived(port))).collect()
        }
    }
}
