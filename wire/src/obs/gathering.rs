//! Assembles a snapshot from the state machines of a node. A running node and the checker use the same code.

use super::snapshot::{Count, Liveness, Snapshot, TaskSnapshot};
use imrs_protocol::{Reason, TaskView, TransitView};

/// Collects the views of a node's state machines, one after the other.
#[derive(Clone, Debug)]
pub struct Gathering {
    tasks: Vec<TaskSnapshot>,
    discards: [u64; Reason::ALL.len()],
}

impl Gathering {
    /// Starts with the counts of the messages that the node itself dropped, by position in [`Reason::ALL`].
    #[must_use]
    pub const fn new(discards: [u64; Reason::ALL.len()]) -> Self {
        Self { tasks: Vec::new(), discards }
    }

    /// Adds the view of a communication task, taken `age_us` microseconds before the sample, and its drop counters.
    /// Tasks are added in ascending order.
    pub fn task(&mut self, liveness: Liveness, age_us: u64, view: TaskView, discards: &[u64]) {
        self.add(discards);
        self.tasks.push(TaskSnapshot { liveness, age_us, view });
    }

    /// The snapshot; the fields that only a running node knows (its clock, its Timer and its links) are
    /// empty.
    #[must_use]
    pub fn snapshot(mut self, transit: TransitView) -> Snapshot {
        self.add(&transit.discarded);
        let count = |(reason, count): (&Reason, u64)| Count { name: reason.name().into(), count };
        let discards = Reason::ALL.iter().zip(self.discards).map(count).collect();
        Snapshot { tasks: self.tasks, transit, discards, ..Snapshot::default() }
    }

    fn add(&mut self, more: &[u64]) {
        self.discards.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
    }
}
