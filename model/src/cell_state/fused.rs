//! Compares each fused step of a node with the small steps that it stands for (D176).
//!
//! The search takes the small steps. Wherever a fused step applies, both are made on copies, which must then be equal: the
//! packed state, and everything that the node does, in its order.

use super::wires::Wires;
use super::{CellState, Effect, small};
use crate::state::Violation;
use imrs_protocol::{Node, NodeInput, Request, TaskId};
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
            Request::Send { .. } => 0,
            Request::Reply { .. } => 1,
            _ => return Ok(()),
        };
        if self.nodes[i].node.is_busy() || self.nodes[i].node.parts().tasks.len() < 2 {
            return Ok(());
        }
        let mut applies = false;
        let (fused, done) = self.copy_after(i, |node, out| {
            applies = node.fuse(task, request, out);
            node.flush(out);
        });
        if !applies {
            return Ok(());
        }
        let (mut plain, expected) = self.copy_after(i, |node, out| {
            node.small_steps(node.now(), NodeInput::Request(task, *request), out);
        });
        COMPARED[kind].fetch_add(1, Ordering::Relaxed);
        let mut fused = fused;
        let same = done == expected && fused.store() == plain.store();
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
