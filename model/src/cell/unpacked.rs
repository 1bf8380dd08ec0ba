//! A cell on the machine itself: moves are carried out and judged, and no state is ever packed.

use super::course::{CellMove, Course};
use super::judge::{Reached, Shown, judge, nothing_reached};
use super::plan::{CellFaults, CellPlan};
use super::verdict::Phase;
use crate::state::Violation;
use std::sync::Arc;

/// A cell that is never packed, and what its scripts have reached.
#[derive(Clone)]
pub(super) struct Unpacked {
    pub course: Course,
    pub reached: Reached,
    phase: Phase,
}

impl Unpacked {
    /// The start of a cell.
    pub fn new(plan: &Arc<CellPlan>, phase: Phase, faults: &CellFaults) -> Self {
        let course = Course::with_history(plan, faults);
        let reached = nothing_reached(&course);
        Self { course, reached, phase }
    }

    /// The same without what came before: to be loaded from packed states.
    pub fn without_history(mut self) -> Self {
        self.course.floor.forget_history();
        self
    }

    /// Carries a move out. A panic is a violation of the machine.
    pub fn take(&mut self, step: CellMove) {
        if !self.course.survives(step) {
            self.course.floor.violation = Some(Violation::Panic);
        }
    }

    /// What the last move showed, or the start. To be asked once after each.
    pub fn shown(&mut self) -> Vec<Shown> {
        judge(&mut self.course, self.phase, &mut self.reached)
    }
}
