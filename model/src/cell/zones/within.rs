//! Makes random runs at times within the ranges of a finding, for tests.

use super::concrete::{Leg, Replay};
use super::found::Found;
use super::path::{Instant, Path, instants};
use crate::cell::guard::Disagreement;
use crate::cell::outside::with_programs;
use crate::cell::plan::CellPlan;
use crate::cell::run_state::CellMove;
use crate::cell::verdict::{Finding, Kind};
use crate::zone::dbm::Dbm;
use crate::zone::forks::guided::along;
use std::sync::Arc;

/// Makes random runs on plain ticks at times for which the path to a finding happens, drawn together for all its actions and packets, and
/// some with one of these times as short or as long as it may be. Each run must show the finding. Returns the number of runs: none if the
/// finding has no ranges. `draw` returns a number below its argument.
///
/// # Errors
/// [`Disagreement`]: the moves of the run that does not show the finding.
pub fn compare_ranges_with_runs(
    plan: &Arc<CellPlan>,
    finding: &Finding,
    runs: u32,
    draw: &mut dyn FnMut(usize) -> usize,
) -> Result<u64, Disagreement> {
    let found = Found::of(&with_programs(plan), finding);
    let Found { plan, every, phase, faults, shown } = &found;
    let Some(instants) = instants(plan, faults, &finding.moves) else { return Ok(0) };
    let zones = along(|guide| {
        let mut path = Path::new(guide, every, faults);
        path.run(*phase, &instants, shown).map(|()| (path.ends(), path.untils))
    });
    let mut made = 0;
    let (zones, untils) = zones.unwrap_or_default();
    for (number, zone) in zones.iter().enumerate() {
        for _ in 0..if number == 0 { runs } else { 1 } {
            let legs = drawn((&instants, &untils), zone, draw);
            let replay = Replay::of(every, (*phase, faults), &legs);
            let is_shown = replay.is_some_and(|replay| match shown.kind {
                Kind::Standstill => found.standstill(replay.moves).is_some(),
                _ => replay.shows(shown),
            });
            if !is_shown {
                let what = format!("a run within the ranges does not show: {}", finding.kind.name());
                let moves = legs.into_iter().flat_map(|leg| leg.moves).collect();
                return Err(Disagreement { what, moves });
            }
            made += 1;
        }
    }
    Ok(made)
}

/// The moves of a path at instants that are drawn from a zone. The variables `untils` are one tick before each instant but the first.
fn drawn(
    (instants, untils): (&[Instant], &[u8]),
    zone: &Dbm,
    draw: &mut dyn FnMut(usize) -> usize,
) -> Vec<Leg> {
    let point = zone.point_by(|least, most| {
        let least = least.unwrap_or(0);
        let apart = usize::try_from(most.map_or(50, |most| most - least)).unwrap_or(0);
        let more = match draw(4) {
            0 => 0,
            1 => apart,
            _ => draw(apart + 1),
        };
        least + i64::try_from(more).unwrap_or(0)
    });
    let variable = |at: usize| usize::from(untils[at - 1]);
    let tick = |at: usize| if at == 0 { 0 } else { point[variable(at)].unsigned_abs() + 1 };
    let leg = |(at, instant): (usize, &Instant)| {
        let pass = (at > 0).then_some(CellMove::Pass);
        let silent = if at + 1 == instants.len() { 0 } else { tick(at + 1) - tick(at) - 1 };
        Leg { moves: pass.into_iter().chain(instant.moves.iter().copied()).collect(), silent }
    };
    instants.iter().enumerate().map(leg).collect()
}
