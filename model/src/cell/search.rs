//! Searches the state space breadth-first. Only states with a choice are stored (*kept*); the search passes through the
//! others.
//!
//! Threads expand a batch of kept states in parallel, and look up only states that were kept before the batch. Then one
//! thread merges the results in the order of the batch, so the answer is the same for any number of threads.

use super::done::Done;
use super::judge::{Reached, Shown};
use super::plan::{CellFaults, CellPlan};
use super::progress::{SearchProgress, SoFar};
use super::run_state::{CellMove, RunState};
use super::seen::{Seen, is_in_sample};
use super::standstill::{self, OutOfMemory, StateGraph};
use super::verdict::{Coverage, Finding, Kind, Phase};
use super::walker::{Hit, Origin, Walker, Walks};
use super::{starve, story, unfinished};
use crate::Silent;
use crate::explore::resident_bytes;
use crate::side_by_side::side_by_side;
use std::collections::{HashSet, VecDeque};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Instant;

/// The number of states that are expanded between two checks of the budget.
const BATCH: usize = 1024;
/// The number of states of a batch that a thread takes at a time.
const PART: usize = 32;

/// A kept state that is still to be expanded, and its number.
type Queued = (u32, Box<[u8]>);

#[derive(Default)]
struct Search {
    seen: Seen,
    origins: Vec<Origin>,
    queue: VecDeque<Queued>,
    hits: Vec<Hit>,
    moves: u64,
    longest: usize,
    outgrown: bool,
    graph: StateGraph,
    /// For each kept state, the fingerprint of its core: all bytes of the state except its remaining faults.
    cores: Vec<u64>,
    sample: unfinished::Sample,
    /// The least depth in the last batch, if a budget ended the search before all results of that batch were merged.
    batch: Option<u16>,
}

/// The result of a search, and the states that the search kept.
pub(super) struct Kept {
    pub seen: Seen,
    pub states: u64,
    pub complete: bool,
    pub hits: Vec<Shown>,
    pub findings: Vec<Finding>,
    pub reached: Reached,
}

/// Searches a phase: without faults, or with one fault hypothesis. Also returns the states that the search kept.
pub(super) fn explore_and_keep(plan: &Arc<CellPlan>, phase: Phase, faults: &CellFaults) -> Kept {
    let (search, done) = search(plan, (phase, 0), faults, &Silent);
    let hits = search.hits.into_iter().map(|hit| hit.shown).collect();
    let Done { coverage, findings, reached, .. } = done;
    Kept { seen: search.seen, states: coverage.states, complete: coverage.complete, hits, findings, reached }
}

/// Searches a phase. `says_what_is_large`: if a budget ends the search, also finds out what makes it large, which takes time.
pub(super) fn explore(
    plan: &Arc<CellPlan>,
    phase: (Phase, usize),
    faults: &CellFaults,
    progress: &dyn SearchProgress,
    says_what_is_large: bool,
) -> Done {
    let (search, mut done) = search(plan, phase, faults, progress);
    if says_what_is_large {
        done.coverage.unfinished = unfinished::of(plan, faults, &search.sample, search.queue.len());
    }
    done
}

fn search(
    plan: &Arc<CellPlan>,
    (phase, hypothesis): (Phase, usize),
    faults: &CellFaults,
    progress: &dyn SearchProgress,
) -> (Search, Done) {
    let start = Instant::now();
    progress.started((phase, hypothesis), plan.times);
    let mut search = Search::default();
    let walker = || Walker::new(phase, RunState::new(plan, faults));
    let mut walkers: Vec<Walker> = (0..plan.jobs.max(1)).map(|_| walker()).collect();
    let ended_by = search.run(plan, &mut walkers, (start, progress));
    let outgrown = || {
        search.outgrown.then(|| "a number in some states is too large for the checker to store".to_string())
    };
    let mut ended_by = ended_by.or_else(outgrown);
    let tell = |hit: &Hit| search.tell(plan, (phase, hypothesis), faults, hit);
    let (mut warnings, findings): (Vec<Finding>, Vec<Finding>) =
        search.hits.iter().map(tell).partition(|found| found.kind.is_warning());
    let mut still = Vec::new();
    if ended_by.is_none() {
        let room = plan.budget.bytes.saturating_sub(resident_bytes().unwrap_or(0));
        match search.graph.all_still(&search.cores, room) {
            Ok(all) => still = all,
            Err(OutOfMemory) => ended_by = Some(plan.budget.out_of_memory()),
        }
    }
    // Several still states (no path leads from them to progress) are tried, because the first may lie on a cycle in
    // which no task waits for others.
    let mut idle = HashSet::new();
    let told = still.into_iter().take(standstill::MOST_TOLD).find_map(|at| {
        if idle.contains(&search.cores[at]) {
            return None;
        }
        let moves = search.path(plan, faults, search.origins[at]);
        standstill::tell(plan, (phase, hypothesis), faults, moves, &mut idle)
    });
    warnings.extend(told);
    let depth = search.origins.iter().map(|origin| u64::from(origin.depth)).max().unwrap_or(0);
    let depth_of = |&(at, _): &Queued| search.origins.get(at as usize).map(|origin| origin.depth);
    let left = search.queue.iter().filter_map(depth_of).chain(search.batch).min();
    let coverage = Coverage {
        phase,
        hypothesis,
        times: plan.times,
        parts: 1,
        states: search.origins.len() as u64,
        inexact: 0,
        moves: search.moves,
        depth,
        whole_depth: left.map_or(depth, u64::from),
        ticks: findings.iter().map(|finding| finding.at_ticks).max().unwrap_or(0),
        complete: ended_by.is_none(),
        // A deadlock, too, hides states: the search does not explore what the deadlocked tasks would have done next.
        pruned: search.hits.iter().any(|hit| hit.shown.last || hit.shown.kind == Kind::Deadlock),
        ended_by,
        unfinished: None,
        finer: None,
        longest_state: search.longest as u64,
        seconds: start.elapsed().as_secs_f64(),
    };
    let mut mattered = vec![false; plan.checks.len()];
    for walker in &walkers {
        mattered.iter_mut().zip(walker.mattered()).for_each(|(all, one)| *all |= one);
    }
    let reached = walkers.into_iter().map(|walker| walker.reached).reduce(Reached::join).unwrap_or_default();
    (search, Done { coverage, findings, warnings, reached, mattered })
}

impl Search {
    /// Searches until the queue is empty, or returns the budget that ended the search.
    fn run(
        &mut self,
        plan: &CellPlan,
        walkers: &mut [Walker],
        (start, progress): (Instant, &dyn SearchProgress),
    ) -> Option<String> {
        let budget = plan.budget;
        if let Some(first) = walkers.first_mut() {
            first.start(&self.seen);
            self.take_in(first.take());
        }
        let mut told = 0;
        while !self.queue.is_empty() {
            if start.elapsed().as_secs_f64() > budget.seconds {
                return Some(budget.out_of_time());
            }
            if resident_bytes().is_some_and(|bytes| bytes > budget.bytes) {
                return Some(plan.budget.out_of_memory());
            }
            let seconds = start.elapsed().as_secs_f64();
            progress.states(&SoFar {
                states: self.origins.len() as u64,
                open: self.queue.len() as u64,
                seconds,
                at_most_seconds: budget.seconds,
            });
            for hit in &self.hits[std::mem::replace(&mut told, self.hits.len())..] {
                progress.found(&hit.shown.so_far());
            }
            let batch: Vec<_> = self.queue.drain(..self.queue.len().min(BATCH)).collect();
            for walks in self.walk_on(&batch, walkers) {
                self.take_in(walks);
                if self.origins.len() as u64 >= budget.states {
                    let depths = batch.iter().filter_map(|&(at, _)| self.origins.get(at as usize));
                    self.batch = depths.map(|origin| origin.depth).min();
                    return Some(format!("{} states", budget.states));
                }
            }
        }
        None
    }

    /// Expands each state of a batch, and returns the results in the order of the batch.
    fn walk_on(&self, batch: &[Queued], walkers: &mut [Walker]) -> Vec<Walks> {
        let parts: Vec<&[Queued]> = batch.chunks(PART).collect();
        let done: Vec<OnceLock<Walks>> = parts.iter().map(|_| OnceLock::new()).collect();
        let next = AtomicUsize::new(0);
        let work = |walker: &mut Walker| {
            while let at = next.fetch_add(1, Ordering::Relaxed)
                && let Some(part) = parts.get(at)
            {
                for (state_at, state) in *part {
                    let place = *state_at as usize;
                    let what = (self.origins[place].depth, is_in_sample(self.cores[place]));
                    walker.expand(*state_at, what, state, &self.seen);
                }
                // Only one thread takes this part of the batch, so the place for its result is empty.
                let _ = done[at].set(walker.take());
            }
        };
        side_by_side(walkers.iter_mut().take(parts.len()), work);
        done.into_iter().filter_map(OnceLock::into_inner).collect()
    }

    fn take_in(&mut self, walks: Walks) {
        self.moves += walks.moves;
        self.outgrown |= walks.outgrown;
        self.graph.take_in(walks.graph);
        for hit in walks.hits {
            if !self.hits.iter().any(|known| known.shown.is_same(&hit.shown)) {
                self.hits.push(hit);
            }
        }
        for stop in walks.stops {
            let Ok(at) = u32::try_from(self.origins.len()) else { return };
            if self.seen.insert(stop.mark) {
                self.longest = self.longest.max(stop.state.len());
                self.origins.push(stop.origin);
                self.cores.push(stop.mark.core());
                self.sample.take_in(stop.mark.core(), &stop.state);
                self.queue.push_back((at, stop.state));
            }
        }
    }

    /// The moves from the start to `origin`, including the moves between kept states.
    fn path(&self, plan: &Arc<CellPlan>, faults: &CellFaults, mut origin: Origin) -> Vec<CellMove> {
        let mut walks = Vec::new();
        while origin.parent != u32::MAX {
            walks.push((Some(usize::from(origin.choice)), origin.steps));
            origin = self.origins[origin.parent as usize];
        }
        walks.push((None, origin.steps));
        let mut run_state = RunState::new(plan, faults);
        let mut path = Vec::new();
        let mut moves = Vec::new();
        for (mut choice, steps) in walks.into_iter().rev() {
            for _ in 0..steps {
                moves.clear();
                run_state.moves(&mut moves);
                let alone = choice.is_none() && moves.len() != 1;
                let Some(&step) = moves.get(choice.take().unwrap_or(0)).filter(|_| !alone) else {
                    return path;
                };
                path.push(step);
                if !run_state.survives(step) {
                    return path;
                }
            }
        }
        path
    }

    fn tell(
        &self,
        plan: &Arc<CellPlan>,
        (phase, hypothesis): (Phase, usize),
        faults: &CellFaults,
        hit: &Hit,
    ) -> Finding {
        let moves = self.path(plan, faults, hit.origin);
        let shown = starve::decided(plan, &moves, hit.shown.clone());
        story::finding(plan, (phase, hypothesis), faults, moves, &shown)
    }
}
