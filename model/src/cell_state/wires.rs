//! Where the effects of a node go in a transition.

use super::Effect;
use imrs_protocol::{NodeId, NodeOutbox, Observation, Packet, Signal, TaskId};

/// The outbox of one node, which takes the node's effects. `open` says how many packets each of its links still takes.
pub(super) struct Wires<'a> {
    pub effects: &'a mut Vec<Effect>,
    pub open: &'a mut [(NodeId, u8)],
    pub node: u8,
}

impl NodeOutbox for Wires<'_> {
    fn ready(&mut self, next: NodeId) -> bool {
        self.open.iter().any(|&(to, left)| to == next && left > 0)
    }

    fn link(&mut self, next: NodeId, packet: Packet) {
        if let Some((_, left)) = self.open.iter_mut().find(|(to, _)| *to == next) {
            *left = left.saturating_sub(1);
        }
        self.effects.push(Effect::Sent(next, packet));
    }

    fn signal(&mut self, task: TaskId, signal: Signal) {
        self.effects.push(Effect::Signalled(task, signal));
    }

    fn observe(&mut self, at: Option<TaskId>, observation: Observation) {
        self.effects.push(Effect::Seen(self.node, at, observation));
    }
}
