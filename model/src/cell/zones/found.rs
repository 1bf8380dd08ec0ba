//! What a search found, as far as a path at other times must show it, too.

use crate::cell::judge::Shown;
use crate::cell::parts::{only, parts};
use crate::cell::plan::{CellFaults, CellPlan, Times};
use crate::cell::run_state::CellMove;
use crate::cell::standstill;
use crate::cell::verdict::{Finding, Kind, Phase};
use imrs_protocol::TaskId;
use std::collections::HashSet;
use std::sync::Arc;

/// What is found, and where.
pub(super) struct Found {
    /// The plan of the search that made the finding: its moves are on the event times of this plan.
    pub plan: Arc<CellPlan>,
    /// The same plan at every tick.
    pub every: Arc<CellPlan>,
    pub phase: Phase,
    pub faults: CellFaults,
    pub shown: Shown,
}

impl Found {
    /// What a search of this plan has found. The plan has programs for the tasks outside the cell.
    pub fn of(plan: &Arc<CellPlan>, finding: &Finding) -> Self {
        let part = finding.part.and_then(|number| parts(plan).into_iter().nth(number));
        let plan = only(&plan.timed(finding.times), part.as_ref());
        let faults = plan.faults.get(finding.hypothesis).filter(|_| finding.phase == Phase::Faults);
        let faults = faults.cloned().unwrap_or_default();
        // Whether a request starved is decided on its path. Its last move shows a time_out.
        let kind = if finding.kind == Kind::Starves { Kind::TimeOut } else { finding.kind };
        let (address, check, couple) = (finding.address, finding.check, finding.couple);
        let task = finding.task.map(|task| task.index());
        let shown = Shown { task, address, check, couple, ..Shown::whole(kind, &finding.cause) };
        Self { every: plan.timed(Times::Zones), plan, phase: finding.phase, faults, shown }
    }

    /// The moves and one round of the standstill to which they lead; `None` if they lead to no such standstill.
    pub fn standstill(&self, moves: Vec<CellMove>) -> Option<Vec<CellMove>> {
        let found = standstill::tell(&self.every, (self.phase, 0), &self.faults, moves, &mut HashSet::new())?;
        let is_same = found.task.map(TaskId::index) == self.shown.task && found.address == self.shown.address;
        is_same.then_some(found.moves)
    }
}
