//! Detects a standstill (livelock): tasks go on for ever without progress. For example, two robots each hold a zone and
//! poll for the zone of the other, or one robot polls for a zone whose holder is dead.
//!
//! *Progress* is a step in which an action ends well, a rendezvous completes, or a live variable changes its value. A state
//! is *still* if no path without faults and restarts leads from it to progress or to an end. A cycle of still states is
//! reported if a task in the cycle waits for other tasks. So a camera that loops by itself is no standstill.

use super::judge::{Shown, name};
use super::plan::{CellFaults, CellPlan};
use super::run_state::{CellMove, RunState};
use super::seen::Mark;
use super::story;
use super::verdict::{Finding, Kind, Phase};
use crate::cell_state::script::ScriptReaction;
use imrs_protocol::Signal;
use imrs_protocol::script::{Address, ScriptInput};
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::sync::Arc;

/// The greatest number of states of a standstill that are explored to find what repeats in it.
const MOST_STATES: usize = 4096;

/// The greatest number of still states that the search tries, until one of them shows a standstill.
pub(super) const MOST_TOLD: usize = 64;

/// The greatest number of bytes that [`StateGraph::all_still`] needs for a state: an entry in a map and on a stack, and two
/// flags.
const BYTES_OF_A_STATE: usize = 64;

/// The analysis does not fit into the memory budget of the search.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct OutOfMemory;

/// The graph of kept states for the livelock analysis. An edge is a path from one kept state to the next, without faults
/// and restarts.
#[derive(Default)]
pub(super) struct StateGraph {
    /// Edges without progress: the number of the state where the edge begins, and the core fingerprint of the state where
    /// it ends.
    steps: Vec<(u32, u64)>,
    /// States from which an edge leads to progress or to an end.
    free: Vec<u32>,
}

impl StateGraph {
    /// Notes an edge from one kept state to another. `None`: the edge leads to progress or to an end.
    pub fn note(&mut self, from: u32, to: Option<u64>) {
        match to {
            Some(to) => self.steps.push((from, to)),
            None if self.free.last() != Some(&from) => self.free.push(from),
            None => {}
        }
    }

    /// Adds the edges that another thread noted.
    pub fn take_in(&mut self, other: Self) {
        self.steps.extend(other.steps);
        self.free.extend(other.free);
    }

    /// The still states: no path leads from them to progress or to an end. `cores` has the fingerprints of the kept states,
    /// and `room` is the number of bytes that the analysis may use.
    ///
    /// # Errors
    /// [`OutOfMemory`] if the analysis needs more bytes than `room`.
    pub fn all_still(&self, cores: &[u64], room: u64) -> Result<Vec<usize>, OutOfMemory> {
        let bytes = cores.len() * BYTES_OF_A_STATE + self.steps.len() * size_of::<(u32, u32)>();
        if bytes as u64 > room {
            return Err(OutOfMemory);
        }
        let mut free = vec![false; cores.len()];
        let mut open: Vec<u32> = Vec::new();
        let mut leads = vec![false; cores.len()];
        for &(from, _) in &self.steps {
            leads[from as usize] = true;
        }
        // A kept state without any edge is an end, too: every path from it needs a fault or a restart.
        let ends = (0_u32..).zip(&leads).filter(|(_, leads)| !**leads).map(|(at, _)| at);
        for at in self.free.iter().copied().chain(ends) {
            if !std::mem::replace(&mut free[at as usize], true) {
                open.push(at);
            }
        }
        if free.iter().all(|free| *free) {
            return Ok(Vec::new());
        }
        let mut places: HashMap<u64, u32> = HashMap::with_capacity(cores.len());
        for (at, &core) in (0_u32..).zip(cores) {
            places.entry(core).or_insert(at);
        }
        let mut back: Vec<(u32, u32)> = Vec::with_capacity(self.steps.len());
        back.extend(self.steps.iter().filter_map(|&(from, to)| Some((*places.get(&to)?, from))));
        back.sort_unstable();
        while let Some(at) = open.pop() {
            // States that differ only in their remaining faults have the same edges, because no edge contains a fault.
            let first = places.get(&cores[at as usize]).copied().unwrap_or(at);
            let begin = back.partition_point(|&(to, _)| to < first);
            for &(_, from) in back[begin..].iter().take_while(|&&(to, _)| to == first) {
                if !std::mem::replace(&mut free[from as usize], true) {
                    open.push(from);
                }
            }
        }
        Ok((0..free.len()).filter(|&at| !free[at]).collect())
    }
}

/// Whether a move is a fault or a restart. A restart counts as a fault, because a node that crashed may stay down.
pub(super) const fn is_outside(step: CellMove) -> bool {
    step.is_fault() || matches!(step, CellMove::Restart(_))
}

/// Explores a standstill and reports what repeats in it. Returns `None` if no task waits for others, if some path makes
/// progress after all, or if the standstill has too many states. If no task waits for others, `idle` gets the core
/// fingerprints of the standstill's states.
pub(super) fn tell(
    plan: &Arc<CellPlan>,
    (phase, hypothesis): (Phase, usize),
    faults: &CellFaults,
    mut moves: Vec<CellMove>,
    idle: &mut HashSet<u64>,
) -> Option<Finding> {
    let mut run_state = RunState::new(plan, faults);
    if !moves.iter().all(|&step| run_state.survives(step)) {
        return None;
    }
    // The steps of scripts before the standstill are dropped, because they are not part of the standstill.
    run_state.cell.turns.iter_mut().for_each(Vec::clear);
    let seen = Round::walk(&mut run_state, &mut moves)?;
    let asks = seen.asks();
    let tasks: Vec<usize> = asks.keys().copied().collect();
    let names: Vec<&str> = tasks.iter().map(|&task| name(&plan.table, task)).collect();
    let cause = match &names[..] {
        [] => {
            idle.extend(seen.known);
            return None;
        }
        [one] => format!("{one} goes on for ever, and no task makes progress any more"),
        [all @ .., last] => {
            format!("{} and {last} go on for ever, and no task makes progress any more", all.join(", "))
        }
    };
    let (task, address) = asks.first_key_value().map(|(&task, &at)| (task, at)).unzip();
    let shown =
        Shown { task, address, others: tasks[1..].to_vec(), ..Shown::whole(Kind::Standstill, &cause) };
    Some(story::finding(plan, (phase, hypothesis), faults, moves, &shown))
}

/// The explored states of a standstill, by core fingerprint.
#[derive(Default)]
struct Round {
    known: HashSet<u64>,
    leads: HashMap<u64, Vec<u64>>,
    /// The outcomes of requests that tasks learnt: the task, the statement, the state before and the state after.
    told: BTreeSet<(usize, Address, u64, u64)>,
}

impl Round {
    /// Explores all states of the standstill. Appends the first move of each state to `moves`, so that the chart shows one
    /// cycle.
    fn walk(run_state: &mut RunState, moves: &mut Vec<CellMove>) -> Option<Self> {
        let mut round = Self::default();
        let mut open = vec![(run_state.store().ok()?, true)];
        let mut all = Vec::new();
        while let Some((state, first)) = open.pop() {
            let from = Mark::of(run_state.split(&state)).core();
            if !round.known.insert(from) {
                continue;
            }
            if round.known.len() > MOST_STATES {
                return None;
            }
            run_state.load(&state);
            all.clear();
            run_state.moves(&mut all);
            all.retain(|&step| !is_outside(step));
            for (at, &step) in all.iter().enumerate().rev() {
                run_state.load(&state);
                if run_state.progresses(step) != Some(false) {
                    return None;
                }
                let turns = run_state.cell.turns.as_mut().map(std::mem::take).unwrap_or_default();
                let next = run_state.store().ok()?;
                let to = Mark::of(run_state.split(&next)).core();
                round.leads.entry(from).or_default().push(to);
                // Outcomes that a task outside the cell learns do not count, because it is unknown what the task's real
                // program does next.
                let told = turns
                    .iter()
                    .filter(|turn| is_answered(turn) && !run_state.plan.outside.contains(&turn.task));
                round.told.extend(told.map(|turn| (turn.task, turn.at, from, to)));
                let shown = first && at == 0;
                if shown {
                    moves.push(step);
                }
                open.push((next, shown));
            }
        }
        Some(round)
    }

    /// The tasks that learn an outcome again and again, each with the statement. An outcome that a task learns only once,
    /// on the path into the cycle, does not count.
    fn asks(&self) -> BTreeMap<usize, Address> {
        let mut asks = BTreeMap::new();
        for &(task, at, from, to) in &self.told {
            if !asks.contains_key(&task) && comes_to(&self.leads, to, from) {
                asks.insert(task, at);
            }
        }
        asks
    }
}

/// Whether one state of the standstill leads to another in one step or more.
fn comes_to(leads: &HashMap<u64, Vec<u64>>, from: u64, to: u64) -> bool {
    let (mut open, mut seen) = (vec![from], HashSet::from([from]));
    while let Some(state) = open.pop() {
        if state == to {
            return true;
        }
        open.extend(leads.get(&state).into_iter().flatten().filter(|&&next| seen.insert(next)));
    }
    false
}

/// Whether a script learns the outcome of a request to other tasks in this step.
const fn is_answered(turn: &ScriptReaction) -> bool {
    match turn.input {
        ScriptInput::Signal(Signal::Outcome(_) | Signal::Answers { .. } | Signal::GaveUp { .. }) => true,
        ScriptInput::Signal(
            Signal::Accepted(_)
            | Signal::Nothing
            | Signal::Fault(_)
            | Signal::Interrupt(_)
            | Signal::Granted(_)
            | Signal::Message(_)
            | Signal::Released { .. }
            | Signal::TimeOut(_)
            | Signal::Cancelled,
        )
        | ScriptInput::Begin
        | ScriptInput::Acted { .. }
        | ScriptInput::Chosen(_) => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether no path leads to progress or to an end, computed for one state by a plain search.
    fn is_still(graph: &StateGraph, cores: &[u64], from: usize) -> bool {
        let (mut seen, mut open) = (vec![from], vec![from]);
        while let Some(at) = open.pop() {
            let number = u32::try_from(at).expect("few");
            let mut on = graph.steps.iter().filter(|(of, _)| *of == number).peekable();
            if graph.free.contains(&number) || on.peek().is_none() {
                return false;
            }
            for (_, to) in on {
                let to = cores.iter().position(|core| core == to).expect("it was kept");
                if !seen.contains(&to) {
                    seen.push(to);
                    open.push(to);
                }
            }
        }
        true
    }

    #[test]
    fn the_states_without_a_way_out_are_those_that_asking_each_state_gives() {
        let mut random = 1987_u64;
        let mut draw = |below: u64| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 33) % below
        };
        let (mut still, mut none) = (0, 0);
        for _ in 0..2000 {
            let n = 2 + draw(9);
            let cores: Vec<u64> = (0..n).map(|at| at * 7 + 3).collect();
            let mut graph = StateGraph::default();
            for from in 0..n {
                for _ in 0..1 + draw(2) {
                    let to = (draw(8) > 0).then(|| cores[usize::try_from(draw(n)).expect("few")]);
                    graph.note(u32::try_from(from).expect("few"), to);
                }
            }
            let asked: Vec<usize> = (0..cores.len()).filter(|&at| is_still(&graph, &cores, at)).collect();
            let is_any = !asked.is_empty();
            assert_eq!(graph.all_still(&cores, 4096), Ok(asked), "{:?} {:?}", graph.steps, graph.free);
            let less = cores.len() * BYTES_OF_A_STATE + graph.steps.len() * 8 - 1;
            assert_eq!(graph.all_still(&cores, less as u64), Err(OutOfMemory));
            if is_any { still += 1 } else { none += 1 }
        }
        assert!(still > 300 && none > 300, "{still} {none}");
    }
}
