//! Compares each fused step of a node with the small steps that it replaces (D176, D193).
//!
//! The search takes the small steps. Wherever a fused step applies, both are made on copies of the cell. Afterwards the
//! copies must be equal: the packed state, all of the node's tasks, and everything that the node did, in order.

use super::wires::Wires;
use super::{CellState, Effect, small};
use crate::fused::{are_same, count, may_have};
use crate::state::Violation;
use imrs_protocol::{Node, NodeId, NodeInput, NodeOutbox, Packet, Request, Signal, TaskId};

impl CellState {
    /// Compares the fused step of a request, if the request has one, with its small steps.
    pub(super) fn compare_fused(&self, i: usize, task: TaskId, request: &Request) -> Result<(), Violation> {
        if self.is_symbolic || !may_have(request) {
            return Ok(());
        }
        let here = &self.nodes[i].node;
        // Most requests have no fused step. This test copies only a node, which is cheaper than copying the cell.
        let may = !here.is_busy() && here.parts().tasks.len() > 1;
        if !may || !here.clone().fuse(task, request, &mut Unheard) {
            return Ok(());
        }
        let (mut fused, found) =
            self.copy_after(i, |node, out| node.step(node.now(), NodeInput::Request(task, *request), out));
        let (mut plain, expected) = self
            .copy_after(i, |node, out| node.small_steps(node.now(), NodeInput::Request(task, *request), out));
        let is_release = |effect: &Effect| matches!(effect, Effect::Signalled(_, Signal::Released { .. }));
        count(request, found.iter().any(is_release));
        let same = are_same(&fused.nodes[i].node, &plain.nodes[i].node);
        let same = same && found == expected && fused.store() == plain.store();
        if same { Ok(()) } else { Err(Violation::Fused) }
    }

    /// A copy of the cell in which one node has done some work, and what the node did.
    fn copy_after(&self, i: usize, work: impl FnOnce(&mut Node, &mut Wires<'_>)) -> (Self, Vec<Effect>) {
        let (mut copy, mut effects) = (self.clone(), Vec::new());
        let mut open = copy.open(i);
        let out = &mut Wires { effects: &mut effects, open: &mut open, node: small(i) };
        work(&mut copy.nodes[i].node, out);
        (copy, effects)
    }
}

/// Ignores the effects of a step that is only tried.
struct Unheard;

impl NodeOutbox for Unheard {
    fn link(&mut self, _: NodeId, _: Packet) {}
    fn signal(&mut self, _: TaskId, _: Signal) {}
}
