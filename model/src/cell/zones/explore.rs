//! Makes the result of a search by zones.

use super::concrete;
use super::runner::Runner;
use super::search::Search;
use crate::cell::done::Done;
use crate::cell::plan::{CellFaults, CellPlan, Times};
use crate::cell::standstill::{MOST_TOLD, tell};
use crate::cell::verdict::{Coverage, Finding, Kind, Phase};
use std::collections::HashSet;
use std::sync::Arc;
use std::time::Instant;

/// Searches a cell by zones. Every finding that it returns was found again on plain ticks.
pub(in crate::cell) fn explore(
    plan: &Arc<CellPlan>,
    (phase, hypothesis): (Phase, usize),
    faults: &CellFaults,
) -> Done {
    let start = Instant::now();
    let runner = Runner::new(plan, phase, faults);
    let mut search = Search::new(runner);
    let mut ended_by = search.run(plan, start);
    if search.outgrown {
        ended_by
            .get_or_insert_with(|| "a number in some states is too large for the checker to store".into());
    }
    if search.inexact > 0 {
        ended_by.get_or_insert_with(|| {
            "the times of three instants met in one, which zones do not cover exactly; use --times every"
                .into()
        });
    }
    let hits = std::mem::take(&mut search.hits);
    let pruned = hits.iter().any(|hit| hit.shown.last || hit.shown.kind == Kind::Deadlock);
    let mut told: Vec<Finding> = Vec::new();
    for hit in &hits {
        match concrete::told(plan, (phase, hypothesis), faults, &mut search, hit) {
            Some(finding) => told.push(finding),
            None => {
                let what =
                    format!("{} is not found at plain times: {}", hit.shown.kind.name(), hit.shown.cause);
                ended_by.get_or_insert(what);
            }
        }
    }
    if ended_by.is_none() {
        told.extend(standstill(plan, (phase, hypothesis), faults, &mut search));
    }
    let (warnings, findings) = told.into_iter().partition(|found| found.kind.is_warning());
    let Search { runner, store, longest, .. } = search;
    let depth = store.states.iter().map(|state| u64::from(state.depth)).max().unwrap_or(0);
    let coverage = Coverage {
        phase,
        hypothesis,
        times: Times::Zones,
        parts: 1,
        states: store.len() as u64,
        moves: runner.moves,
        depth,
        whole_depth: store.least_left().map_or(depth, u64::from),
        ticks: 0,
        complete: ended_by.is_none(),
        pruned,
        ended_by,
        unfinished: None,
        longest_state: longest as u64,
        seconds: start.elapsed().as_secs_f64(),
    };
    Done { coverage, findings, warnings, reached: runner.reached, mattered: runner.mattered }
}

/// The first standstill that is also found on plain ticks.
fn standstill(
    plan: &Arc<CellPlan>,
    (phase, hypothesis): (Phase, usize),
    faults: &CellFaults,
    search: &mut Search,
) -> Option<Finding> {
    let still = search.walks.still(&search.store);
    let every = &concrete::at_every_tick(plan);
    let mut idle = HashSet::new();
    still.into_iter().take(MOST_TOLD).find_map(|state| {
        let moves = concrete::moves_to(every, (phase, faults), search, state)?;
        tell(every, (phase, hypothesis), faults, moves, &mut idle)
    })
}
