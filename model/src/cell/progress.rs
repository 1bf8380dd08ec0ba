//! What a search of a cell reports while it runs.

use super::plan::Times;
use super::verdict::{Coverage, Kind, Phase};
use crate::Silent;
use imrs_protocol::TaskId;
use imrs_protocol::script::Address;

/// Receives the reports of the searches of a cell. All methods are called by the thread that called
/// [`check_cell_and_tell`](super::check_cell_and_tell).
pub trait SearchProgress {
    /// A search begins. A phase (without faults, or with one fault hypothesis) has several searches if its parts are
    /// searched one by one, or if finer times took too long.
    fn started(&self, phase: (Phase, usize), times: Times) {
        let _ = (phase, times);
    }
    /// Called now and then while the search goes on.
    fn states(&self, so_far: &SoFar) {
        let _ = so_far;
    }
    /// The search has found something. After the search its path is examined, which may give the finding another kind.
    fn found(&self, found: &FoundSoFar<'_>) {
        let _ = found;
    }
    /// A phase ends.
    fn finished(&self, coverage: &Coverage) {
        let _ = coverage;
    }
}

impl SearchProgress for Silent {}

/// How far a search is.
#[derive(Clone, Copy, Debug)]
pub struct SoFar {
    /// The number of kept states. A search by zones does not count a state if another kept state includes all its
    /// times.
    pub states: u64,
    /// How many of the kept states are still to be expanded.
    pub open: u64,
    /// The seconds since the search began.
    pub seconds: f64,
    /// The seconds that the search may take at most.
    pub at_most_seconds: f64,
}

/// A finding of a search that still runs.
#[derive(Clone, Copy, Debug)]
pub struct FoundSoFar<'a> {
    /// The kind of the finding.
    pub kind: Kind,
    /// The cause of the finding: one line, in the cell's words.
    pub cause: &'a str,
    /// The task and the operation of its program, if the finding has them.
    pub place: Option<(TaskId, Address)>,
}
