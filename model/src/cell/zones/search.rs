//! Expands kept states of a search by zones, breadth first.

use super::runner::{From, Run, Runner};
use super::still::Walks;
use super::store::{Origin, Store};
use crate::cell::judge::Shown;
use crate::cell::plan::CellPlan;
use crate::cell::run_state::canon::Left;
use crate::explore::resident_bytes;
use crate::zone::dbm::Dbm;
use crate::zone::forks::{Cut, each};
use std::time::Instant;

/// A finding of a run from a kept state.
pub(super) struct Hit {
    pub shown: Shown,
    /// The number of the kept state in which the run began; `None`: the run began at the start. The next field has the
    /// answers of the run.
    pub state: Option<u32>,
    pub answers: Box<[u16]>,
    /// The number of moves of the run that lead to the finding.
    pub moves: usize,
}

/// The number of states that are expanded between two looks at the budget.
const BATCH: usize = 64;

/// One state in this many is in the sample: in runs from it the invariants of the state machines are checked.
const SAMPLE: u32 = 16;

pub(super) struct Search {
    pub runner: Runner,
    pub store: Store,
    pub hits: Vec<Hit>,
    pub walks: Walks,
    /// The number of runs whose times were not all exact.
    pub inexact: u64,
    pub outgrown: bool,
    pub longest: usize,
}

impl Search {
    pub fn new(runner: Runner) -> Self {
        let (store, walks) = (Store::default(), Walks::default());
        Self { runner, store, hits: Vec::new(), walks, inexact: 0, outgrown: false, longest: 0 }
    }

    /// Searches until no state is left, or returns the budget that ended the search.
    pub fn run(&mut self, plan: &CellPlan, start: Instant) -> Option<String> {
        let budget = plan.budget;
        self.expand(None);
        let mut done = 0_usize;
        loop {
            if done.is_multiple_of(BATCH) {
                if start.elapsed().as_secs_f64() > budget.seconds {
                    return Some(format!("out of time ({} s)", budget.seconds));
                }
                if resident_bytes().is_some_and(|bytes| bytes > budget.bytes) {
                    return Some(format!("out of memory ({} MiB)", budget.bytes >> 20));
                }
            }
            done += 1;
            if done as u64 > budget.states {
                return Some(format!("{} states", budget.states));
            }
            let runner = &self.runner;
            let state = self.store.next(|control| core(runner, control).1)?;
            self.expand(Some(state));
        }
    }

    /// Makes all runs from a kept state or from the start: one for each way that its times allow.
    fn expand(&mut self, at: Option<u32>) {
        let Self { runner, store, .. } = self;
        let (zone, control, depth) = match at.and_then(|at| store.states.get(at as usize)) {
            Some(state) => {
                (state.zone.clone(), store.controls[state.control as usize].clone(), state.depth + 1)
            }
            None => (Some(Dbm::zero()), Box::default(), 0),
        };
        let Some(zone) = zone else { return };
        let from = if at.is_some() { From::Kept(&control) } else { From::Start };
        let mut runs = Vec::new();
        each(
            &zone,
            |forks| runner.run(forks, from, is_sampled(at)),
            |run, cut: &Cut| {
                let zone = run.control.is_some().then(|| cut.state());
                runs.push((run, Way { answers: cut.answers().into(), zone, is_exact: cut.is_exact() }));
            },
        );
        for (run, way) in runs {
            self.take_in(at, depth, run, way);
        }
    }

    fn take_in(&mut self, parent: Option<u32>, depth: u32, run: Run, way: Way) {
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
            let core = core(&self.runner, &control);
            to = self.store.insert(control, core, Origin { parent, answers, zone }, depth);
        }
        // A run in which only time has passed leads back to its own state.
        let leads = run.gets_on || !to.is_empty();
        if let Some(from) = parent.filter(|_| leads && !run.takes_fault) {
            self.walks.note(from, if run.gets_on { &[] } else { &to });
        }
    }
}

/// What the times of one run were.
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

/// The remaining faults of a control, and the other bytes of it.
fn core(runner: &Runner, control: &[u8]) -> (Left, Box<[u8]>) {
    let (left, core) = runner.split(control);
    (left, [control.get(..1).unwrap_or_default(), core].concat().into())
}
