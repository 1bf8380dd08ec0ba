//! The rows of the problems screen: findings under their causes, then the messages nearest to their deadline.

use crate::clock::Moment;
use crate::name::Name;
use crate::store::blocked::Blocker;
use crate::store::health::{Finding, Place};
use crate::store::nearest::{Near, nearest};
use crate::store::{IncarnationId, Store};
use imrs_protocol::{MessageId, PortId, TaskId};

/// How many messages the problems screen lists.
const NEAREST: usize = 40;

/// A row of the problems screen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Problem {
    /// A block of the cell (a task that others wait for, for example) that no finding mentions.
    Block(Blocker),
    /// A finding of the cell.
    Finding {
        /// The finding of this row.
        finding: Finding,
        /// Whether the finding is only a consequence of the row above.
        caused: bool,
    },
    /// A message near its deadline.
    Message(Near),
}

/// Identifies a row even when its position changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProblemKey {
    /// A finding, or what blocks the cell without one, by its code and place.
    At(&'static str, Place),
    /// A message near its deadline.
    Message(IncarnationId, TaskId, PortId, Option<(TaskId, MessageId)>),
}

impl Problem {
    /// The identity of the row.
    #[must_use]
    pub fn key(&self) -> ProblemKey {
        match self {
            Self::Block(blocker) => ProblemKey::At("", blocker.place),
            Self::Finding { finding, .. } => ProblemKey::At(finding.code, finding.place),
            Self::Message(near) => ProblemKey::Message(near.incarnation, near.task, near.port, near.message),
        }
    }
}

/// The rows for a cell that has these findings and blocks.
#[must_use]
pub fn problems(
    store: &Store,
    cell: &Name,
    findings: &[Finding],
    blockers: &[Blocker],
    now: Moment,
) -> Vec<Problem> {
    let mut rows = grouped(findings, blockers);
    rows.extend(nearest(store, cell, now, NEAREST).into_iter().map(Problem::Message));
    rows
}

/// The findings, with each cause followed by its consequences.
fn grouped(findings: &[Finding], blockers: &[Blocker]) -> Vec<Problem> {
    let cause = |finding: &Finding| blockers.iter().position(|blocker| blocker.explains(finding));
    let mut told = vec![false; blockers.len()];
    let mut rows = Vec::new();
    let caused_by = |at: usize| {
        let of = findings.iter().filter(move |finding| cause(finding) == Some(at));
        of.map(|finding| Problem::Finding { finding: finding.clone(), caused: true })
    };
    for finding in findings.iter().filter(|finding| cause(finding).is_none()) {
        rows.push(Problem::Finding { finding: finding.clone(), caused: false });
        // A finding about a whole node concerns the tasks of that node, too.
        let about = |place: &Place| place.holds(&finding.place) || finding.place.holds(place);
        for (at, blocker) in blockers.iter().enumerate() {
            if !told[at] && blocker.is_alarming() && about(&blocker.place) {
                told[at] = true;
                rows.extend(caused_by(at));
            }
        }
    }
    let untold = blockers.iter().enumerate().filter(|(at, blocker)| !told[*at] && blocker.is_alarming());
    let blocks = untold
        .flat_map(|(at, blocker)| std::iter::once(Problem::Block(blocker.clone())).chain(caused_by(at)));
    blocks.chain(rows).collect()
}
