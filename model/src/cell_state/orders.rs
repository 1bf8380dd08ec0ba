//! Interleavings within a node: the inputs of its tasks are queued, and the search tries every order in which the tasks may
//! take them (D170).

use super::CellState;
use super::plan::CellScenario;
use super::wires::Wires;
use crate::state::Violation;
use imrs_protocol::{Node, NodeInput, TaskId, Ticks};
use std::sync::Arc;

impl CellState {
    /// Lets time pass for a node. If a task then has something to do, the passed time is queued as its input.
    pub(super) fn let_time_pass(&mut self, i: usize, ticks: Ticks) -> Result<(), Violation> {
        self.drive_in_order(i, |node, out| node.let_pass(node.now() + ticks, out))
    }

    /// Drives a node. Its effects on the node's own tasks are queued as inputs of these tasks.
    fn drive_in_order(
        &mut self,
        i: usize,
        work: impl FnOnce(&mut Node, &mut Wires<'_>),
    ) -> Result<(), Violation> {
        self.drive(i, |node, out| {
            work(node, out);
            node.file(out);
            node.flush(out);
        })
    }

    /// Lets a node take an input. The effects on the node's own tasks are queued as inputs of these tasks.
    pub(super) fn step_in_order(&mut self, i: usize, input: NodeInput) -> Result<(), Violation> {
        self.drive_in_order(i, |node, out| {
            let before = node.inputs();
            node.begin(node.now(), input, out);
            node.file(out);
            // The task takes an arriving packet at once, unless an earlier input must come first.
            if let NodeInput::Packet { .. } = input
                && let Some(last) = node.open().last().filter(|&last| last >= before)
            {
                node.take(last, out);
            }
        })
    }

    /// Begins a script, and carries out all its effects within the node, because one thread of a node does all of this.
    pub(crate) fn begin_whole(&mut self, task: usize) -> Result<(), Violation> {
        let i = self.node_state_of(task);
        let before = self.nodes[i].node.inputs();
        self.begin(task)?;
        for _ in 0..super::FUSED {
            let Some(at) = self.next_inputs(i).find(|&at| at >= before) else { return Ok(()) };
            self.take(i, at)?;
            self.run_scripts()?;
        }
        Err(Violation::Zeno)
    }

    /// From here on, a step of a node includes the effects within the node.
    pub(super) fn fuse(&mut self) {
        self.plan = Arc::new(CellScenario { fused: true, ..(*self.plan).clone() });
        self.orders = false;
    }

    /// Sorts the queued inputs into the canonical order that packed and unpacked states share.
    pub(crate) fn sort_inputs(&mut self) {
        self.nodes
            .iter_mut()
            .filter(|node_state| node_state.up)
            .for_each(|node_state| node_state.node.sort_inputs());
    }

    /// Whether inputs of tasks are queued in a node.
    pub(crate) fn is_busy(&self, i: usize) -> bool {
        self.nodes[i].up && self.nodes[i].node.is_busy()
    }

    /// The positions of the queued inputs of a node's tasks that may be taken next.
    pub(crate) fn next_inputs(&self, i: usize) -> impl Iterator<Item = usize> {
        self.nodes[i].node.open()
    }

    /// Whether a task has noticed all the time that has passed at its node.
    pub(crate) fn notices_all(&self, i: usize, task: usize) -> bool {
        self.nodes[i].node.late(TaskId::from_index(task)) == Ticks::ZERO
    }

    /// Lets a task of a node take the queued input at this position.
    pub(crate) fn take(&mut self, i: usize, at: usize) -> Result<(), Violation> {
        if let (Some(history), Some((_, input))) = (&mut self.history, self.nodes[i].node.waiting(at)) {
            history.begin_input(&input);
        }
        self.drive_in_order(i, |node, out| node.take(at, out))
    }
}
