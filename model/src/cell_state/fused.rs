//! Compares each fused step of a node with the small steps that it stands for (D176, D193, D200).
//!
//! The search takes the small steps. Wherever a fused step applies, both are made on copies of the cell. Afterwards the
//! copies must be equal: the packed state, all of the node's tasks, and everything that the node did, in order.

use super::wires::Wires;
use super::{CellState, Effect, small};
use crate::fused::{are_same, count, count_pair, may_have};
use crate::state::Violation;
use imrs_protocol::{Node, NodeId, NodeInput, NodeOutbox, Packet, Request, Signal, TaskId, Ticks};

impl CellState {
    /// Compares the fused step of a request, if the request has one, with its small steps.
    pub(super) fn compare_fused(&self, i: usize, task: TaskId, request: &Request) -> Result<(), Violation> {
        if self.is_symbolic || !may_have(request) {
            return Ok(());
        }
        let here = &self.nodes[i].node;
        // Most requests have no fused step. A copy of the node shows this more cheaply than a copy of the whole cell.
        let mut may = !here.is_busy() && here.parts().tasks.len() > 1;
        // GETs are the most frequent requests, and each concerns one task only. So they are compared in sampled states
        // only.
        may &= self.is_sampled || !matches!(request, Request::Get { .. });
        if !may || !here.clone().fuse(task, request, &mut Unheard) {
            return Ok(());
        }
        let effects = self.compare(
            i,
            |node, out| node.step(node.now(), NodeInput::Request(task, *request), out),
            |node, out| node.small_steps(node.now(), NodeInput::Request(task, *request), out),
        )?;
        let is_release = |effect: &Effect| matches!(effect, Effect::Signalled(_, Signal::Released { .. }));
        count(&here.parts().table, request, effects.iter().any(is_release));
        self.compare_pairs(i, task, request)
    }

    /// Compares the fused step for an answer followed by a GET with the small steps of both.
    fn compare_pairs(&self, i: usize, task: TaskId, reply: &Request) -> Result<(), Violation> {
        let &Request::Reply { to, .. } = reply else { return Ok(()) };
        // The GETs to try after the answer: a wait at the answer's port, and a look at all ports.
        let wait = Request::Get { port: Some(to.port), source: None, time_out: None };
        let look = Request::Get { port: None, source: None, time_out: Some(Ticks::ZERO) };
        for get in [wait, look] {
            if !self.nodes[i].node.clone().reply_and_get(task, [reply, &get], &mut Unheard) {
                continue;
            }
            let fused = |node: &mut Node, out: &mut Wires<'_>| {
                node.reply_and_get(task, [reply, &get], out);
            };
            self.compare(i, fused, |node, out| {
                for request in [*reply, get] {
                    node.small_steps(node.now(), NodeInput::Request(task, request), out);
                }
            })?;
            count_pair();
        }
        Ok(())
    }

    /// Compares the effects of the node under `fused` with those under `plain`. Returns the effects.
    fn compare(
        &self,
        i: usize,
        fused: impl FnOnce(&mut Node, &mut Wires<'_>),
        plain: impl FnOnce(&mut Node, &mut Wires<'_>),
    ) -> Result<Vec<Effect>, Violation> {
        let (mut fused, found) = self.copy_after(i, fused);
        let (mut plain, expected) = self.copy_after(i, plain);
        let same = are_same(&fused.nodes[i].node, &plain.nodes[i].node);
        let same = same && found == expected && fused.store() == plain.store();
        if same { Ok(found) } else { Err(Violation::Fused) }
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
