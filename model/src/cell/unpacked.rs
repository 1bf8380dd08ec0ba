//! Runs a cell without packing: makes moves on the protocol's state machine and judges them.

use super::judge::{Reached, Shown, judge, nothing_reached};
use super::plan::{CellFaults, CellPlan};
use super::run_state::{CellMove, RunState};
use super::verdict::Phase;
use crate::state::Violation;
use std::sync::Arc;

/// A cell that is never packed, and the statements that its scripts have reached.
#[derive(Clone)]
pub(super) struct Unpacked {
    pub run_state: RunState,
    pub reached: Reached,
    phase: Phase,
}

impl Unpacked {
    /// A cell before its first move, with the history of the run.
    pub fn new(plan: &Arc<CellPlan>, phase: Phase, faults: &CellFaults) -> Self {
        let run_state = RunState::with_history(plan, faults);
        let reached = nothing_reached(&run_state);
        Self { run_state, reached, phase }
    }

    /// The same cell without its history. Rules over the history are then not judged, and packed states can be loaded.
    pub fn without_history(mut self) -> Self {
        self.run_state.cell.forget_history();
        self
    }

    /// Makes a move. A panic in the move becomes a violation.
    pub fn take(&mut self, step: CellMove) {
        if !self.run_state.survives(step) {
            self.run_state.cell.violation = Some(Violation::Panic);
        }
    }

    /// The findings of the last move, or of the first state. Call it once after each move.
    pub fn shown(&mut self) -> Vec<Shown> {
        judge(&mut self.run_state, self.phase, &mut self.reached)
    }
}
