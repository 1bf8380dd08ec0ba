//! Runs a cell without packing: makes moves on the protocol's state machine and judges them.

use super::course::{CellMove, Course};
use super::judge::{Reached, Shown, judge, nothing_reached};
use super::plan::{CellFaults, CellPlan};
use super::verdict::Phase;
use crate::state::Violation;
use std::sync::Arc;

/// A cell that is never packed, and the statements that its scripts have reached.
#[derive(Clone)]
pub(super) struct Unpacked {
    pub course: Course,
    pub reached: Reached,
    phase: Phase,
}

impl Unpacked {
    /// The start of a cell, with the history of the run.
    pub fn new(plan: &Arc<CellPlan>, phase: Phase, faults: &CellFaults) -> Self {
        let course = Course::with_history(plan, faults);
        let reached = nothing_reached(&course);
        Self { course, reached, phase }
    }

    /// The same without history, so that packed states can be loaded.
    pub fn without_history(mut self) -> Self {
        self.course.floor.forget_history();
        self
    }

    /// Makes a move. A panic becomes a violation.
    pub fn take(&mut self, step: CellMove) {
        if !self.course.survives(step) {
            self.course.floor.violation = Some(Violation::Panic);
        }
    }

    /// The findings of the last move, or of the start. Call it once after each move.
    pub fn shown(&mut self) -> Vec<Shown> {
        judge(&mut self.course, self.phase, &mut self.reached)
    }
}
