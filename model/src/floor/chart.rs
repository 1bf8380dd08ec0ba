//! Counterexamples of floors as sequence charts.

use super::plan::FloorPlan;
use super::{Crossing, Effect, Floor, Move};
use crate::chart::{Counterexample, Pen};
use crate::explore::Exploration;
use crate::state::Packed;
use crate::world::Shown;
use imrs_protocol::{CellTable, NodeId, TaskId};
use std::sync::Arc;

/// Draws the path of an exploration; `None` where it found no violation.
#[must_use]
pub fn draw_floor(plan: &Arc<FloorPlan>, exploration: &Exploration<Move>) -> Option<Counterexample> {
    let states = exploration.states_on_path.as_ref()?;
    let violation = exploration.violation?;
    let length = u32::try_from(states.len().saturating_sub(1)).unwrap_or(u32::MAX);
    Some(walk(plan, states)?.conclude(violation.text(), length))
}

/// Draws a path. `None` where its states do not follow from each other.
pub(crate) fn walk(plan: &Arc<FloorPlan>, states: &[Packed]) -> Option<Pen> {
    let lanes = Lanes::new(plan);
    let mut pen = Pen::new(lanes.names.clone());
    let mut floor = Floor::new(plan);
    floor.keep_log = true;
    let mut tick = 0;
    for target in states.iter().skip(1) {
        let (step, next) = concrete_move(&floor, target)?;
        let crossing = crossing_of(&floor, step);
        tick += next.passed;
        floor = next;
        lanes.step(&mut pen, tick, step, crossing.as_ref(), &floor);
    }
    Some(pen)
}

/// The packet that a move is about.
fn crossing_of(floor: &Floor, step: Move) -> Option<Crossing> {
    match step {
        Move::Deliver(i, _) | Move::Lose(i) | Move::Duplicate(i) => {
            floor.crossings.get(usize::from(i)).copied()
        }
        _ => None,
    }
}

/// Draws one step from a packed state.
pub(crate) fn one_step(plan: &Arc<FloorPlan>, state: &Packed, step: Move) -> Pen {
    let (lanes, mut floor) = (Lanes::new(plan), Floor::new(plan));
    let mut pen = Pen::new(lanes.names.clone());
    floor.load(state);
    floor.keep_log = true;
    floor.log.clear();
    let crossing = crossing_of(&floor, step);
    floor.apply(step);
    lanes.step(&mut pen, 0, step, crossing.as_ref(), &floor);
    pen
}

/// The transition of `floor` whose packed result is `target`. A chart walks the path unpacked, so that numbers stay
/// absolute.
fn concrete_move(floor: &Floor, target: &Packed) -> Option<(Move, Floor)> {
    let mut moves = Vec::new();
    floor.moves(&mut moves);
    moves.into_iter().find_map(|step| {
        let mut next = floor.clone();
        next.log.clear();
        next.passed = 0;
        next.apply(step);
        (next.clone().store() == *target).then_some((step, next))
    })
}

/// One lane for each task, and one for each node that only relays.
pub(crate) struct Lanes {
    pub names: Vec<String>,
    /// For each node, its lane as a relay, if it has one.
    relays: Vec<Option<usize>>,
    tasks_on: Vec<Vec<usize>>,
    links: Vec<(NodeId, NodeId, u8)>,
}

impl Lanes {
    pub fn new(plan: &FloorPlan) -> Self {
        Self { links: plan.links(), ..Self::of(&plan.cell) }
    }

    /// The lanes of a cell, without its links.
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

    /// The lane at which a packet is on a node: its own task there, the relay's lane, or the node's first task.
    pub fn lane(&self, node: NodeId, task: TaskId) -> usize {
        let here = &self.tasks_on[node.index()];
        let own = here.contains(&task.index()).then_some(task.index());
        own.or(self.relays[node.index()]).or(here.first().copied()).unwrap_or(0)
    }

    /// The lanes of some nodes: those of their tasks, and those of relays.
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

    fn step(&self, pen: &mut Pen, tick: u32, step: Move, crossing: Option<&Crossing>, floor: &Floor) {
        let fate = match step {
            Move::Deliver(_, 0) => Some(""),
            Move::Deliver(..) => Some("OVERCHARGED"),
            Move::Lose(_) => Some("LOST"),
            Move::Duplicate(_) => Some("TWICE"),
            _ => None,
        };
        if let (Some(fate), Some(crossing)) = (fate, crossing) {
            let (from, to, _) = self.links[usize::from(crossing.link)];
            let ends = (self.lane(from, crossing.packet.source), self.lane(to, crossing.packet.destination));
            pen.arrow(tick, ends, &crossing.packet, fate);
        }
        match step {
            Move::Crash(i) => pen.event(tick, self.on_node(i), "CRASHES"),
            Move::Restart(i) => pen.event(tick, self.on_node(i), "restarts"),
            Move::Tick(code) => {
                for i in 0..self.tasks_on.len() {
                    let text = match (code >> (2 * i)) & 3 {
                        1 => "misses a tick",
                        2 => "counts a tick twice",
                        3 => "is late",
                        _ => continue,
                    };
                    pen.event(tick, self.on_node(super::small(i)), text);
                }
            }
            _ => {}
        }
        self.effects(pen, tick, &floor.log);
    }

    /// Draws what a step showed.
    pub fn effects(&self, pen: &mut Pen, tick: u32, log: &[Effect]) {
        log.iter().for_each(|effect| self.effect(pen, tick, effect));
    }

    /// Draws one effect of a step.
    pub fn effect(&self, pen: &mut Pen, tick: u32, effect: &Effect) {
        match effect {
            Effect::Seen(_, Some(task), seen) => pen.shown(tick, task.index(), &Shown::Seen(*seen)),
            Effect::Told(task, signal) => pen.shown(tick, task.index(), &Shown::Told(*signal)),
            Effect::Seen(node, None, seen) => pen.shown(tick, self.on_node(*node), &Shown::Seen(*seen)),
            Effect::Sent(..) => {}
        }
    }
}
