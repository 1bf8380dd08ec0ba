//! Counterexamples of cells as sequence charts.

use super::plan::CellScenario;
use super::{CellState, Effect, InFlight, Move};
use crate::chart::{ChartRecorder, Counterexample, conclude};
use crate::explore::Exploration;
use crate::state::Packed;
use crate::world::Shown;
use imrs_protocol::{CellTable, NodeId, TaskId};
use std::sync::Arc;

/// Draws the path that an exploration found; `None` if it found no violation.
#[must_use]
pub fn draw_cell_state(plan: &Arc<CellScenario>, exploration: &Exploration<Move>) -> Option<Counterexample> {
    conclude(exploration, |states| walk(plan, states))
}

/// Draws a path. `None` if its states do not follow from each other.
pub(crate) fn walk(plan: &Arc<CellScenario>, states: &[Packed]) -> Option<ChartRecorder> {
    let lanes = Lanes::new(plan);
    let mut recorder = ChartRecorder::new(lanes.names.clone());
    let mut cell_state = CellState::new(plan);
    cell_state.keep_log = true;
    let mut tick = 0;
    for target in states.iter().skip(1) {
        let (step, next) = concrete_move(&cell_state, target)?;
        let carried = carried_of(&cell_state, step);
        tick += next.passed;
        cell_state = next;
        lanes.step(&mut recorder, tick, step, carried.as_ref(), &cell_state);
    }
    Some(recorder)
}

/// The packet that a move delivers or loses.
fn carried_of(cell_state: &CellState, step: Move) -> Option<InFlight> {
    match step {
        Move::Deliver(i, _) | Move::Lose(i) | Move::Duplicate(i) => {
            cell_state.in_flight.get(usize::from(i)).copied()
        }
        _ => None,
    }
}

/// Draws one step from a packed state.
pub(crate) fn one_step(plan: &Arc<CellScenario>, state: &Packed, step: Move) -> ChartRecorder {
    let (lanes, mut cell_state) = (Lanes::new(plan), CellState::new(plan));
    let mut recorder = ChartRecorder::new(lanes.names.clone());
    cell_state.load(state);
    cell_state.keep_log = true;
    cell_state.log.clear();
    let carried = carried_of(&cell_state, step);
    cell_state.apply(step);
    lanes.step(&mut recorder, 0, step, carried.as_ref(), &cell_state);
    recorder
}

/// The transition of `cell_state` whose packed result is `target`. A chart replays the path without packing, so that
/// numbers stay absolute.
fn concrete_move(cell_state: &CellState, target: &Packed) -> Option<(Move, CellState)> {
    let mut moves = Vec::new();
    cell_state.moves(&mut moves);
    moves.into_iter().find_map(|step| {
        let mut next = cell_state.clone();
        next.log.clear();
        next.passed = 0;
        next.apply(step);
        (next.clone().store() == *target).then_some((step, next))
    })
}

/// The lanes of a chart: one for each task, and one for each node that only relays.
pub(crate) struct Lanes {
    pub names: Vec<String>,
    /// For each node, its lane as a relay, if it has one.
    relays: Vec<Option<usize>>,
    tasks_on: Vec<Vec<usize>>,
    links: Vec<(NodeId, NodeId, u8)>,
}

impl Lanes {
    pub fn new(plan: &CellScenario) -> Self {
        Self { links: plan.links(), ..Self::of(&plan.cell) }
    }

    /// The lanes of a cell.
    pub fn of(table: &CellTable) -> Self {
        let mut names: Vec<String> = table.cell().tasks.iter().map(|task| task.name.clone()).collect();
        let nodes = &table.cell().nodes;
        let mut relays = vec![None; nodes.len()];
        let mut tasks_on = Vec::new();
        for (i, node) in nodes.iter().enumerate() {
            let here: Vec<usize> = table.tasks_on(NodeId::from_index(i)).map(TaskId::index).collect();
            if here.is_empty() {
                relays[i] = Some(names.len());
                names.push(node.name.clone());
            }
            tasks_on.push(here);
        }
        Self { names, relays, tasks_on, links: Vec::new() }
    }

    /// The lane where a chart shows a packet on a node: its own task there, the relay's lane, or the node's first task.
    pub fn lane(&self, node: NodeId, task: TaskId) -> usize {
        let here = &self.tasks_on[node.index()];
        let own = here.contains(&task.index()).then_some(task.index());
        own.or(self.relays[node.index()]).or(here.first().copied()).unwrap_or(0)
    }

    /// The lanes of some nodes: those of the nodes' tasks, and those of relays.
    pub fn on_nodes(&self, is: impl Fn(usize) -> bool) -> Vec<usize> {
        let nodes = (0..self.tasks_on.len()).filter(|&node| is(node));
        let mut all: Vec<usize> =
            nodes.flat_map(|node| self.tasks_on[node].iter().copied().chain(self.relays[node])).collect();
        all.sort_unstable();
        all
    }

    pub fn on_node(&self, node: u8) -> usize {
        self.lane(NodeId(u16::from(node)), TaskId(u16::MAX))
    }

    fn step(
        &self,
        recorder: &mut ChartRecorder,
        tick: u32,
        step: Move,
        carried: Option<&InFlight>,
        cell_state: &CellState,
    ) {
        let outcome = match step {
            Move::Deliver(_, 0) => Some(""),
            Move::Deliver(..) => Some("OVERCHARGED"),
            Move::Lose(_) => Some("LOST"),
            Move::Duplicate(_) => Some("TWICE"),
            _ => None,
        };
        if let (Some(outcome), Some(carried)) = (outcome, carried) {
            let (from, to, _) = self.links[usize::from(carried.link)];
            let ends = (self.lane(from, carried.packet.source), self.lane(to, carried.packet.destination));
            recorder.arrow(tick, ends, &carried.packet, outcome);
        }
        match step {
            Move::Crash(i) => recorder.event(tick, self.on_node(i), "CRASHES"),
            Move::Restart(i) => recorder.event(tick, self.on_node(i), "restarts"),
            Move::Tick(code) => {
                for i in 0..self.tasks_on.len() {
                    let text = match (code >> (2 * i)) & 3 {
                        1 => "misses a tick",
                        2 => "counts a tick twice",
                        3 => "is late",
                        _ => continue,
                    };
                    recorder.event(tick, self.on_node(super::small(i)), text);
                }
            }
            _ => {}
        }
        self.effects(recorder, tick, &cell_state.log);
    }

    /// Draws the effects of a step.
    pub fn effects(&self, recorder: &mut ChartRecorder, tick: u32, log: &[Effect]) {
        log.iter().for_each(|effect| self.effect(recorder, tick, effect));
    }

    /// Draws one effect of a step.
    pub fn effect(&self, recorder: &mut ChartRecorder, tick: u32, effect: &Effect) {
        match effect {
            Effect::Seen(_, Some(task), seen) => recorder.shown(tick, task.index(), &Shown::Seen(*seen)),
            Effect::Signalled(task, signal) => recorder.shown(tick, task.index(), &Shown::Signalled(*signal)),
            Effect::Seen(node, None, seen) => recorder.shown(tick, self.on_node(*node), &Shown::Seen(*seen)),
            Effect::Sent(..) => {}
        }
    }
}
