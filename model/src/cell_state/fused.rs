//! Compares each fused step of a node with the small steps that it stands for (D176).
//!
//! The search takes the small steps. Wherever a fused step applies, both are made on copies, which must then be equal: the
//! packed state, the node's tasks, and everything that the node does, in its order.

use super::wires::Wires;
use super::{CellState, Effect, small};
use crate::state::Violation;
use imrs_protocol::{Node, NodeId, NodeInput, NodeOutbox, Packet, Request, Signal, TaskId};
use std::sync::atomic::{AtomicU64, Ordering};

/// How many fused steps this process has compared: messages and answers.
static COMPARED: [AtomicU64; 2] = [AtomicU64::new(0), AtomicU64::new(0)];

/// How many fused steps this process has compared so far: messages to a task that waits for them, and answers.
#[must_use]
pub fn compared() -> [u64; 2] {
    [&COMPARED[0], &COMPARED[1]].map(|count| count.load(Ordering::Relaxed))
}

impl CellState {
    /// Compares the fused step of a request, if it has one, with its small steps.
    pub(super) fn compare_fused(&self, i: usize, task: TaskId, request: &Request) -> Result<(), Violation> {
        let kind = match request {
            _ if self.is_symbolic => return Ok(()),
            Request::Send { .. } => 0,
            Request::Reply { .. } => 1,
            _ => return Ok(()),
        };
        let here = &self.nodes[i].node;
        // Most requests have no fused step: the copy of a node is cheaper than that of a cell.
        let may = !here.is_busy() && here.parts().tasks.len() > 1;
        if !may || !here.clone().fuse(task, request, &mut Unheard) {
            return Ok(());
        }
        COMPARED[kind].fetch_add(1, Ordering::Relaxed);
        let (mut fused, found) =
            self.copy_after(i, |node, out| node.step(node.now(), NodeInput::Request(task, *request), out));
        let (mut plain, expected) = self
            .copy_after(i, |node, out| node.small_steps(node.now(), NodeInput::Request(task, *request), out));
        // The packed state has neither counters nor the ready set, which is rebuilt when it is read.
        let [one, other] = [&fused, &plain].map(|cell| &cell.nodes[i].node.parts().tasks);
        let alike = one.iter().zip(other).all(|(one, other)| one.is_same(other));
        let same = alike && found == expected && fused.store() == plain.store();
        if same { Ok(()) } else { Err(Violation::Fused) }
    }

    /// A copy in which one node has done some work, and what it did.
    fn copy_after(&self, i: usize, work: impl FnOnce(&mut Node, &mut Wires<'_>)) -> (Self, Vec<Effect>) {
        let (mut copy, mut effects) = (self.clone(), Vec::new());
        let mut open = copy.open(i);
        let out = &mut Wires { effects: &mut effects, open: &mut open, node: small(i) };
        work(&mut copy.nodes[i].node, out);
        (copy, effects)
    }
}

/// Hears nothing of a step that is only tried.
struct Unheard;

impl NodeOutbox for Unheard {
    fn link(&mut self, _: NodeId, _: Packet) {}
    fn signal(&mut self, _: TaskId, _: Signal) {}
}
