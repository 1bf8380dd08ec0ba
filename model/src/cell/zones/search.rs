//! Expands kept states, in an order that lets zones grow before they are expanded.

use super::runner::{From, Run, Runner};
use super::still::Walks;
use super::store::{Store, Widening};
use crate::Silent;
use crate::cell::judge::Shown;
use crate::cell::plan::{Budget, CellFaults, CellPlan};
use crate::cell::progress::{SearchProgress, SoFar};
use crate::cell::run_state::canon::Left;
use crate::cell::verdict::Phase;
use crate::explore::resident_bytes;
use crate::side_by_side::side_by_side;
use crate::zone::dbm::Dbm;
use crate::zone::forks::{Cut, each};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Instant;

/// A finding of a run from a kept state.
pub(super) struct Hit {
    pub shown: Shown,
    /// The number of the kept state in which the run began; `None`: the run began at the start.
    pub state: Option<u32>,
    /// The run's choices where a comparison of symbolic times was open, in their order.
    pub answers: Box<[u16]>,
    /// The number of moves from the beginning of the run to the finding.
    pub moves: usize,
}

/// The most states that are expanded side by side. A state of such a batch no longer joins with the states to which the others
/// lead, so a larger batch leads to more states.
const BATCH: usize = 16;

/// The most states that are searched for whether one state is still.
const MOST_STILL: u64 = 4096;

/// Batches between two looks at the memory in use.
const LOOK: u64 = 128;

/// Of this many states one is in the sample. In the runs from a sampled state, the invariants of the state machines are
/// checked.
const SAMPLE: u32 = 16;

pub(super) struct Search {
    /// A runner for each thread.
    pub runners: Vec<Runner>,
    pub store: Store,
    pub hits: Vec<Hit>,
    pub walks: Walks,
    /// The number of runs whose times were not all exact.
    pub inexact: u64,
    pub outgrown: bool,
    pub longest: usize,
    /// The number of states that were expanded.
    expanded: u64,
}

impl Search {
    /// A search without states.
    pub fn new(runners: Vec<Runner>, widening: Widening) -> Self {
        let (store, walks) = (Store::new(widening), Walks::default());
        Self { runners, store, hits: Vec::new(), walks, inexact: 0, outgrown: false, longest: 0, expanded: 0 }
    }

    /// Searches until no state is left, or returns the budget that ended the search. The result is the same for any number of
    /// threads.
    pub fn run(
        &mut self,
        plan: &CellPlan,
        (start, progress): (Instant, &dyn SearchProgress),
    ) -> Option<String> {
        let first = self.runners[0].expand(&self.store, None);
        self.take_in(None, first);
        self.expand_all(plan.budget, (start, progress))
    }

    /// Whether no run from a state with these times, without faults and restarts, leads to progress or to an end. False if it takes more
    /// than [`MOST_STILL`] states to find that out.
    pub fn is_still(
        plan: &Arc<CellPlan>,
        (phase, faults): (Phase, &CellFaults),
        (control, zone): (Box<[u8]>, Dbm),
    ) -> bool {
        let mut search = Self::new(vec![Runner::new(plan, phase, faults)], Widening::of(plan));
        let core = core(&search.runners[0], &control);
        search.store.insert(control, core, zone, (None, &[], 0));
        let budget = Budget { states: MOST_STILL, seconds: f64::INFINITY, ..plan.budget };
        let ended_by = search.expand_all(budget, (Instant::now(), &Silent));
        let first = search.store.heir(0);
        ended_by.is_none() && !search.outgrown && search.walks.still(&search.store).contains(&first)
    }

    /// Expands states until none is left, or returns the budget that ended the search.
    fn expand_all(
        &mut self,
        budget: Budget,
        (start, progress): (Instant, &dyn SearchProgress),
    ) -> Option<String> {
        for batches in 0_u64.. {
            let seconds = start.elapsed().as_secs_f64();
            if seconds > budget.seconds {
                return Some(budget.out_of_time());
            }
            if batches.is_multiple_of(LOOK) && resident_bytes().is_some_and(|bytes| bytes > budget.bytes) {
                return Some(budget.out_of_memory());
            }
            let (states, open) = (self.store.len() as u64, self.open());
            progress.states(&SoFar { states, open, seconds, at_most_seconds: budget.seconds });
            let most = usize::try_from(budget.states - self.expanded).unwrap_or(usize::MAX).min(BATCH);
            let batch = self.store.next(most);
            if batch.is_empty() {
                return (most == 0 && open > 0).then(|| format!("{} states", budget.states));
            }
            self.expanded += batch.len() as u64;
            for (&(at, _), runs) in batch.iter().zip(self.expand(&batch)) {
                self.take_in(Some(at), runs);
            }
        }
        None
    }

    /// The number of states that are still to be expanded.
    pub fn open(&self) -> u64 {
        self.store.len() as u64 - self.expanded
    }

    /// The runs from each state of a batch.
    fn expand(&mut self, batch: &[(u32, Dbm)]) -> Vec<Vec<(Run, Way)>> {
        let Self { runners, store, .. } = self;
        if let [only] = batch {
            return vec![runners[0].expand(store, Some(only))];
        }
        let done: Vec<OnceLock<Vec<(Run, Way)>>> = batch.iter().map(|_| OnceLock::new()).collect();
        let next = AtomicUsize::new(0);
        let work = |runner: &mut Runner| {
            while let at = next.fetch_add(1, Ordering::Relaxed)
                && let Some(state) = batch.get(at)
            {
                // Each number is given to one thread only, so the place is empty.
                let _ = done[at].set(runner.expand(store, Some(state)));
            }
        };
        side_by_side(runners.iter_mut().take(batch.len()), work);
        done.into_iter().filter_map(OnceLock::into_inner).collect()
    }

    fn take_in(&mut self, parent: Option<u32>, runs: Vec<(Run, Way)>) {
        let depth = parent.map_or(0, |at| self.store.states[at as usize].depth + 1);
        for (run, way) in runs {
            self.take_in_run(parent, depth, run, way);
        }
    }

    fn take_in_run(&mut self, parent: Option<u32>, depth: u32, run: Run, way: Way) {
        let Way { answers, zone, is_exact } = way;
        self.inexact += u64::from(!is_exact);
        self.outgrown |= run.outgrown;
        for (shown, moves) in run.hits {
            if !self.hits.iter().any(|known| known.shown.is_same(&shown)) {
                self.hits.push(Hit { shown, state: parent, answers: answers.clone(), moves });
            }
        }
        let mut to = Vec::new();
        if let (Some(control), Some(zone)) = (run.control, zone) {
            self.longest = self.longest.max(control.len());
            let core = core(&self.runners[0], &control);
            to = self.store.insert(control, core, zone, (parent, &answers, depth));
        }
        // If only time has passed, the run has no new state at its end and leads back to its own state. Such a run is
        // not noted.
        let leads = run.gets_on || !to.is_empty();
        if let Some(from) = parent.filter(|_| leads && !run.takes_fault) {
            self.walks.note(from, if run.gets_on { &[] } else { &to });
        }
    }
}

impl Runner {
    /// Makes all runs from a kept state, or from the start of the cell: one for each way that the state's times allow.
    fn expand(&mut self, store: &Store, state: Option<&(u32, Dbm)>) -> Vec<(Run, Way)> {
        let mut runs = Vec::new();
        let at = state.map(|&(at, _)| at);
        let (zone, from) = match state {
            Some((at, zone)) => {
                let control = store.states[*at as usize].control;
                (zone.clone(), From::Kept(&store.controls[control as usize]))
            }
            None => (Dbm::zero(), From::Start),
        };
        self.begin_state();
        each(
            &zone,
            |forks| self.run(forks, from, is_sampled(at)),
            |mut run: Run, cut: &Cut| {
                let zone = run.control.is_some().then(|| cut.state());
                run.outgrown |= zone.as_ref().is_some_and(Dbm::is_weakened);
                let answers = cut.answers().into();
                runs.push((run, Way { answers, zone, is_exact: cut.is_exact() }));
            },
        );
        runs
    }
}

/// How the times of a run went.
struct Way {
    answers: Box<[u16]>,
    /// The times of the state at the run's end.
    zone: Option<Dbm>,
    is_exact: bool,
}

/// Whether the invariants of the state machines are checked in the runs from a state.
pub(super) fn is_sampled(at: Option<u32>) -> bool {
    at.is_none_or(|at| at.is_multiple_of(SAMPLE))
}

/// Splits a control into the remaining faults and all other bytes.
pub(super) fn core(runner: &Runner, control: &[u8]) -> (Left, Box<[u8]>) {
    let (left, core) = runner.split(control);
    (left, [control.get(..1).unwrap_or_default(), core].concat().into())
}
