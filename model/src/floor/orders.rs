//! What the tasks of a node do at one time, in the order that somebody else chooses (D170).

use super::plan::FloorPlan;
use super::{Floor, Wires};
use crate::state::Violation;
use imrs_protocol::{Node, NodeInput, TaskId, Ticks};
use std::sync::Arc;

impl Floor {
    /// So much time passes for a node. What its tasks do at it waits.
    pub(super) fn let_time_pass(&mut self, i: usize, ticks: Ticks) -> Result<(), Violation> {
        self.drive_in_order(i, |node, out| node.let_pass(node.now() + ticks, out))
    }

    /// Drives a node. What comes of it for its tasks waits.
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

    /// A node takes an input, and leaves to others what comes of it for its tasks.
    pub(super) fn step_in_order(&mut self, i: usize, input: NodeInput) -> Result<(), Violation> {
        self.drive_in_order(i, |node, out| {
            let before = node.inputs();
            node.begin(node.now(), input, out);
            node.file(out);
            // A packet that comes in for a task for which nothing else waits is taken as it comes.
            if let NodeInput::Packet { .. } = input
                && let Some(last) = node.open().last().filter(|&last| last >= before)
            {
                node.take(last, out);
            }
        })
    }

    /// Lets a script begin, with all that this brings about within its node: one thread does it.
    pub(crate) fn begin_whole(&mut self, task: usize) -> Result<(), Violation> {
        let i = self.station_of(task);
        let before = self.stations[i].node.inputs();
        self.begin(task)?;
        for _ in 0..super::FUSED {
            let Some(at) = self.next_inputs(i).find(|&at| at >= before) else { return Ok(()) };
            self.take(i, at)?;
            self.run_scripts()?;
        }
        Err(Violation::Zeno)
    }

    /// From here on what follows from a step within its node belongs to the step.
    pub(super) fn fuse(&mut self) {
        self.plan = Arc::new(FloorPlan { fused: true, ..(*self.plan).clone() });
        self.orders = false;
    }

    /// Puts what waits into the one order that packed states and runs that were never packed share.
    pub(crate) fn sort_inputs(&mut self) {
        self.stations.iter_mut().filter(|station| station.up).for_each(|station| station.node.sort_inputs());
    }

    /// Whether inputs of tasks wait in a node.
    pub(crate) fn is_busy(&self, i: usize) -> bool {
        self.stations[i].up && self.stations[i].node.is_busy()
    }

    /// The positions of the inputs of a node's tasks that may be taken next.
    pub(crate) fn next_inputs(&self, i: usize) -> impl Iterator<Item = usize> {
        self.stations[i].node.open()
    }

    /// Whether a task has noticed all the time that has passed at its node.
    pub(crate) fn notices_all(&self, i: usize, task: usize) -> bool {
        self.stations[i].node.late(TaskId::from_index(task)) == Ticks::ZERO
    }

    /// A task of a node takes an input that waits.
    pub(crate) fn take(&mut self, i: usize, at: usize) -> Result<(), Violation> {
        if let (Some(history), Some((_, input))) = (&mut self.history, self.stations[i].node.waiting(at)) {
            history.begin_input(&input);
        }
        self.drive_in_order(i, |node, out| node.take(at, out))
    }
}
