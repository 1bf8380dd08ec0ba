//! Computes for which times of its actions and packets a finding happens.
//!
//! The path to the finding is made again on symbolic times, which gives the times at which its moves are possible in the same order. Beyond
//! the ends of these times the finding is looked for in other orders.

use super::fixed::{Number, Timing, moves_with};
use super::path::{Path, instants};
use crate::cell::judge::Shown;
use crate::cell::parts::{only, parts};
use crate::cell::plan::{CellFaults, CellPlan, Times};
use crate::cell::run_state::CellMove;
use crate::cell::verdict::{Finding, Kind, Phase, TimeRange};
use crate::zone::forks::guided::along;
use std::sync::Arc;

/// The most other orders of events in which a finding is looked for, to widen its ranges.
const PATHS: u32 = 64;

/// How many ticks later the finding may come in another order of events, besides twice its tick.
const LONGER: u64 = 100;

/// What is found, and where.
pub(super) struct Story {
    /// The plan of the search that made the finding: its moves are on the event times of this plan.
    pub plan: Arc<CellPlan>,
    /// The same plan at every tick.
    pub every: Arc<CellPlan>,
    pub phase: Phase,
    pub faults: CellFaults,
    pub shown: Shown,
}

impl Story {
    /// The story of a finding of this plan. The plan has programs for the tasks outside the cell.
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
}

/// The uncertain times on the path to a finding, each with the values that it has when the finding happens: one after the other as they
/// end, and then those that have not ended. Empty if they cannot be told: the path is too long, has pauses or drift, or has times that
/// depend on three others.
pub(in crate::cell) fn ranges(plan: &Arc<CellPlan>, finding: &Finding) -> Vec<TimeRange> {
    let Story { plan, every, phase, faults, shown } = &Story::of(plan, finding);
    let of = |plan: &Arc<CellPlan>, moves: &[CellMove], end| {
        let instants = instants(plan, faults, moves)?;
        along(|guide| {
            let mut path = Path::new(guide, every, faults);
            path.run(*phase, &instants, shown).map(|()| (path.told(), path.timing(end)))
        })
    };
    let moves = &finding.moves;
    let Some((mut told, _)) = of(plan, moves, None) else { return Vec::new() };
    let mut left = PATHS;
    for (number, range) in &mut told {
        for is_long in [false, true] {
            let Some(end) = number.filter(|_| range.is_narrowed()).map(|number| (number, is_long)) else {
                continue;
            };
            let mut timing = of(plan, moves, Some(end)).map(|(_, timing)| timing).unwrap_or_default();
            let until = 2 * finding.at_ticks + LONGER;
            // The same finding may come in another order of events at the next tick.
            while left > 0
                && let Some(next) = next(range, end, timing)
                && let Some(other) = moves_with(every, (*phase, faults), &next, until, shown)
                && let Some((all, at_end)) = of(every, &other, Some(end))
                && let Some((_, other)) = all.iter().find(|(number, _)| *number == Some(end.0))
            {
                range.least = range.least.min(other.least);
                range.most = range.most.max(other.most);
                (timing, left) = (at_end, left - 1);
            }
        }
    }
    let is_uncertain = |range: &TimeRange| Some(range.declared_least) != range.declared_most;
    told.into_iter().map(|(_, range)| range).filter(is_uncertain).collect()
}

/// The same times, but that of one action or packet is a tick beyond its range; `None` if the cell declares no such time.
fn next(range: &TimeRange, (number, is_long): (Number, bool), mut timing: Timing) -> Option<Timing> {
    let (ticks, _) = timing.get_mut(&number)?;
    *ticks = range.beyond(*ticks, is_long)?;
    Some(timing)
}
