//! The problems of a run that make it a finding, beyond those in its summary.

use crate::fact::{Fact, Fold};
use crate::pipe::{EndSort, Word};
use imrs_protocol::CellTable;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A problem that makes the run a finding, beyond those in its summary.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Trouble {
    /// Whether this program is at fault; if not, the cause lies outside of it.
    pub at_fault: bool,
    /// The problem, in words.
    pub what: String,
}

/// The problems of tasks so far.
pub struct TaskTrouble {
    table: Arc<CellTable>,
    /// Whether the run gets an explanation, which judges the tasks that abort after a fault.
    is_explained: bool,
    /// Whether a fault was injected, or the run loses packets on purpose.
    is_disturbed: bool,
    found: Vec<Trouble>,
}

impl Fold for TaskTrouble {
    fn take(&mut self, _at: u64, fact: &Fact) {
        match fact {
            Fact::Fault(_) => self.is_disturbed = true,
            Fact::Said(_, Word::TaskEnded { task, how, sort }) => {
                let expected = *sort == EndSort::Aborted && self.is_explained && self.is_disturbed;
                if *sort != EndSort::Well && !expected {
                    let what = format!("task `{}` {how}", self.table.cell().tasks[task.index()].name);
                    self.found.push(Trouble { at_fault: false, what });
                }
            }
            _ => {}
        }
    }
}

impl TaskTrouble {
    /// Makes the empty list of a run's problems, before any fact.
    pub const fn new(table: Arc<CellTable>, is_explained: bool, loses: bool) -> Self {
        Self { table, is_explained, is_disturbed: loses, found: Vec::new() }
    }

    /// All problems of the run.
    pub fn found(self) -> Vec<Trouble> {
        self.found
    }
}
