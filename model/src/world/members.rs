//! The members of a world's meeting: which rounds each member left, and how the members would meet on one node.

use super::World;
use crate::fused::{are_same, count};
use crate::scenario::{Behaviour, Scenario};
use crate::state::{Packed, Violation};
use imrs_protocol::{
    CellTable, Incarnation, Node, NodeId, NodeInput, NodeOutbox, NodeTable, Observation, Packet, Request,
    Signal, TaskId, TaskState,
};
use std::sync::Arc;

/// A node on which all members of a meeting run; `None` if the scenario is no meeting.
pub(super) fn together(scenario: &Scenario) -> Option<Node> {
    let mut cell = scenario.is_meeting().then(|| scenario.cell.cell().clone())?;
    let node = NodeId::from_index(0);
    cell.tasks.iter_mut().for_each(|task| task.node = node);
    let table = NodeTable::new(Arc::new(CellTable::new(cell).ok()?), node);
    Some(Node::new(table, Incarnation(0), false, super::TRANSIT))
}

impl World {
    /// The rounds that members other than `i` announced and in which they no longer wait, as a bit mask.
    pub(super) fn left_by_others(&self, i: usize) -> u32 {
        let others = (0..self.n()).filter(|&other| other != i);
        others.fold(0, |mask, other| {
            let here = match self.task(other).state() {
                TaskState::Waiting { round, .. } if self.nodes[other].up => {
                    1_u32.checked_shl(u32::from(round.steps_from(self.rounds[0])))
                }
                _ => None,
            };
            mask | (self.spec_states[other].announced & !here.unwrap_or(0))
        })
    }

    /// Compares the arrival of a task in a packed state, if the state is in the sample: see `compare_arrival`.
    pub fn compare_in(&mut self, state: &Packed, i: usize) -> Result<(), Violation> {
        if self.together.is_none() {
            return Ok(());
        }
        self.load(state, None);
        self.compare_arrival(i)
    }

    /// Compares the fused step in which a task reaches the waitfor with its small steps, as if all members were on one node
    /// in their present states (D193). Packets in flight take no part in this.
    fn compare_arrival(&self, i: usize) -> Result<(), Violation> {
        let Behaviour::Member { port, .. } = self.scenario.behaviours[i] else { return Ok(()) };
        let is_awake = self.nodes.iter().all(|place| place.up && place.owed == 0);
        let Some(together) = self.together.as_ref().filter(|_| is_awake) else { return Ok(()) };
        let mut fused = together.clone();
        for (copy, place) in fused.parts_mut().tasks.iter_mut().zip(&self.nodes) {
            copy.clone_from(&place.node.parts().tasks[0]);
        }
        let mut small = fused.clone();
        let (mut found, mut expected) = (Did::default(), Did::default());
        let (task, request) =
            (TaskId::from_index(i), Request::Arrive { port, arguments: [0; 8], time_out: None });
        if !fused.fuse(task, &request, &mut found) {
            return Ok(());
        }
        small.small_steps(small.now(), NodeInput::Request(task, request), &mut expected);
        count(
            &fused.parts().table,
            &request,
            found.signals.iter().any(|(_, signal)| matches!(signal, Signal::Released { .. })),
        );
        if found == expected && are_same(&fused, &small) { Ok(()) } else { Err(Violation::Fused) }
    }
}

/// What happened in a step of members on one node. No member sends anything over a link.
#[derive(Debug, Default, PartialEq, Eq)]
struct Did {
    signals: Vec<(TaskId, Signal)>,
    seen: Vec<(Option<TaskId>, Observation)>,
}

impl NodeOutbox for Did {
    fn link(&mut self, _: NodeId, _: Packet) {}
    fn signal(&mut self, task: TaskId, signal: Signal) {
        self.signals.push((task, signal));
    }
    fn observe(&mut self, at: Option<TaskId>, observation: Observation) {
        self.seen.push((at, observation));
    }
}
