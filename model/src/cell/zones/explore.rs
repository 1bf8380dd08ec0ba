//! Makes the result of a search by zones.

use super::concrete;
use super::runner::Runner;
use super::search::Search;
use super::store::Widening;
use crate::cell::done::Done;
use crate::cell::judge::Reached;
use crate::cell::plan::{CellFaults, CellPlan, Times};
use crate::cell::progress::SearchProgress;
use crate::cell::standstill::{MOST_TOLD, tell};
use crate::cell::unfinished::{SAMPLE, Values};
use crate::cell::verdict::{Coverage, Finding, Kind, Phase, Unfinished};
use crate::zone::dbm::Dbm;
use crate::zone::forks::again;
use std::collections::HashSet;
use std::sync::Arc;
use std::time::Instant;

/// Searches a cell by zones. Every finding that it returns was found again on plain ticks. If one is not, and some zones were
/// widened, that may be the reason; then the cell is searched once more without acceleration or, if no zone was accelerated, without hulls.
pub(in crate::cell) fn explore(
    plan: &Arc<CellPlan>,
    of: (Phase, usize),
    faults: &CellFaults,
    progress: &dyn SearchProgress,
) -> Done {
    let start = Instant::now();
    progress.started(of, plan.times);
    let mut widening = Widening::of(plan);
    loop {
        let (done, again) = explore_with(plan, widening, of, faults, (start, progress));
        match again {
            Some(less) => widening = less,
            None => return done,
        }
    }
}

/// Searches with zones that may be widened. Also returns how to search once more, if a finding was not found again and that may
/// come from widened zones.
fn explore_with(
    plan: &Arc<CellPlan>,
    widening: Widening,
    (phase, hypothesis): (Phase, usize),
    faults: &CellFaults,
    (start, progress): (Instant, &dyn SearchProgress),
) -> (Done, Option<Widening>) {
    let runners = (0..plan.jobs.max(1)).map(|_| Runner::new(plan, phase, faults)).collect();
    let mut search = Search::new(runners, widening);
    let mut ended_by = search.run(plan, (start, progress)).or_else(|| search.shortcoming());
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
    let again = if told.len() == hits.len() { None } else { search.store.less_widening() };
    if ended_by.is_none() {
        told.extend(standstill(plan, (phase, hypothesis), faults, &mut search));
    }
    let (warnings, findings) = told.into_iter().partition(|found| found.kind.is_warning());
    let (open, unfinished) = (search.open(), search.unfinished());
    let Search { runners, store, longest, inexact, .. } = search;
    let depth = store.states.iter().map(|state| u64::from(state.depth)).max().unwrap_or(0);
    let coverage = Coverage {
        phase,
        hypothesis,
        times: Times::Zones,
        parts: 1,
        states: store.len() as u64,
        inexact: inexact + store.accelerated + store.hulls,
        moves: runners.iter().map(|runner| runner.moves).sum(),
        depth,
        whole_depth: if open == 0 { depth } else { 0 },
        ticks: 0,
        complete: ended_by.is_none(),
        pruned,
        ended_by,
        unfinished,
        finer: None,
        longest_state: longest as u64,
        seconds: start.elapsed().as_secs_f64(),
    };
    let mut mattered = vec![false; plan.checks.len()];
    for runner in &runners {
        mattered.iter_mut().zip(&runner.mattered).for_each(|(all, one)| *all |= one);
    }
    let reached = runners.into_iter().map(|runner| runner.reached).reduce(Reached::join).unwrap_or_default();
    (Done { coverage, findings, warnings, reached, mattered }, again)
}

impl Search {
    /// What the search left, and what makes it large; `None` if it expanded all its states.
    fn unfinished(&mut self) -> Option<Unfinished> {
        let open = self.open();
        if open == 0 {
            return None;
        }
        let Self { runners, store, .. } = self;
        let run_state = &mut runners[0].run_state;
        let mut values = Values::new(run_state);
        let controls = store.controls.iter().step_by(1 + store.controls.len() / SAMPLE);
        for control in controls {
            // The times of a state are in its zone. Here they are any times, because no variable of a task is a time.
            again(&Dbm::zero(), &[], |_| run_state.load(control.get(1..).unwrap_or_default()));
            values.note(run_state);
        }
        let (sampled, apart_from_times) = (store.len() as u64, store.controls.len() as u64);
        Some(Unfinished { open, sampled, apart_from_times, variables: values.named(run_state) })
    }

    /// Why the search is not complete although it expanded all its states.
    fn shortcoming(&self) -> Option<String> {
        self.outgrown.then(|| "a number in some states is too large for the checker to store".into())
    }
}

/// The first standstill that is also found on plain ticks.
fn standstill(
    plan: &Arc<CellPlan>,
    (phase, hypothesis): (Phase, usize),
    faults: &CellFaults,
    search: &mut Search,
) -> Option<Finding> {
    let still = search.walks.still(&search.store);
    let mut idle = HashSet::new();
    still.into_iter().take(MOST_TOLD).find_map(|state| {
        let moves = concrete::moves_to(plan, (phase, faults), search, state)?;
        tell(plan, (phase, hypothesis), faults, moves, &mut idle)
    })
}
