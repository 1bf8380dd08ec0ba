//! Computes for which times of its actions and packets a finding happens.
//!
//! The path to the finding is made again on symbolic times, which gives the times at which its moves are possible in the same order. Beyond
//! the ends of these times the finding is looked for in other orders.

use super::fixed::{Number, Timing, moves_with};
use super::found::Found;
use super::path::{Path, instants};
use crate::cell::plan::CellPlan;
use crate::cell::run_state::CellMove;
use crate::cell::verdict::{Finding, TimeRange};
use crate::zone::forks::guided::along;
use std::sync::Arc;

/// The most other orders of events in which a finding is looked for, to widen its ranges.
const PATHS: u32 = 64;

/// In another order of events the finding may come after up to twice its ticks, and this many ticks more.
const LONGER: u64 = 100;

/// The uncertain times on the path to a finding, each with the values that it has when the finding happens: one after the other as they
/// end, and then those that have not ended. Empty if they cannot be told: the path is too long, has pauses or drift, or has times that
/// depend on three others.
pub(in crate::cell) fn ranges(plan: &Arc<CellPlan>, finding: &Finding) -> Vec<TimeRange> {
    let found = Found::of(plan, finding);
    let Found { plan, every, phase, faults, shown } = &found;
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
            if !range.is_narrowed() {
                continue;
            }
            let end = (*number, is_long);
            let mut timing = of(plan, moves, Some(end)).map(|(_, timing)| timing).unwrap_or_default();
            let until = 2 * finding.at_ticks + LONGER;
            // The same finding may come in another order of events at the next tick.
            while left > 0
                && let Some(next) = next(range, end, timing)
                && let Some(other) = moves_with(&found, &next, until)
                && let Some((all, at_end)) = of(every, &other, Some(end))
                && let Some((_, other)) = all.iter().find(|(number, _)| *number == end.0)
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

/// Puts the time of one action or packet a tick beyond its range; `None` if the cell declares no such time.
fn next(range: &TimeRange, (number, is_long): (Number, bool), mut timing: Timing) -> Option<Timing> {
    let (ticks, _) = timing.get_mut(&number)?;
    *ticks = range.beyond(*ticks, is_long)?;
    Some(timing)
}
