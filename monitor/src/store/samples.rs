//! The queues of all ports of a node in its last states: how long they were, and the slack of the most urgent message.
//!
//! A state is one row for all ports together, because a recording that is stepped through has thousands of states of ten
//! thousand ports. Copies of the store share the rows.

use imrs_protocol::{PortId, PortView, TaskId};
use imrs_wire::obs::{Snapshot, TaskSnapshot};
use std::collections::VecDeque;
use std::sync::Arc;

/// How many states are kept.
pub(super) const STATES: usize = 60;
/// The slack of a port without queued messages.
const NONE: u32 = u32::MAX;

/// The last states of an incarnation.
#[derive(Clone, Debug, Default)]
pub(super) struct Samples {
    rows: VecDeque<Row>,
    /// How many states were added so far, dropped ones included.
    pub count: u64,
}

/// One state of a node. Both lists have an entry per port with a queue, in the order of the node's ports.
#[derive(Clone, Debug)]
struct Row {
    queued: Arc<[u16]>,
    /// The slack of the most urgent message in microseconds, at most about an hour; [`NONE`] without a message.
    slack: Arc<[u32]>,
}

/// The ports of a task that have a queue.
fn ports_of(task: &TaskSnapshot) -> impl Iterator<Item = &PortView> {
    task.view.ports.iter().filter(|port| port.capacity > 0)
}

impl Samples {
    /// Takes a new state.
    pub fn take(&mut self, tick_us: u64, snapshot: &Snapshot) {
        let count = snapshot.tasks.iter().map(|task| task.view.ports.len()).sum();
        let (mut queued, mut slack) = (Vec::with_capacity(count), Vec::with_capacity(count));
        for task in &snapshot.tasks {
            for port in ports_of(task) {
                queued.push(port.len);
                slack.push(port.min_slack.map_or(NONE, |slack| {
                    let left = slack.0.saturating_mul(tick_us).saturating_sub(task.age_us);
                    u32::try_from(left).unwrap_or(NONE).min(NONE - 1)
                }));
            }
        }
        if self.rows.back().is_some_and(|last| last.queued.len() != queued.len()) {
            self.rows.clear();
        }
        if self.rows.len() >= STATES {
            self.rows.pop_front();
        }
        let last = self.rows.back();
        let row = Row {
            queued: shared(last.map(|last| &last.queued), queued),
            slack: shared(last.map(|last| &last.slack), slack),
        };
        self.rows.push_back(row);
        self.count += 1;
    }

    /// The recent queue lengths of a port, and the slacks of the most urgent message in the states in which the queue
    /// was not empty; both oldest first. `snapshot` is the last state. Both are empty for a port without a queue.
    pub fn of(&self, snapshot: &Snapshot, task: TaskId, port: PortId) -> (Vec<u16>, Vec<u64>) {
        let of = |one| ports_of(one).map(|view| (one.view.task, view.port));
        let at = snapshot.tasks.iter().flat_map(of).position(|one| one == (task, port));
        let Some(at) = at else { return Default::default() };
        let queued = self.rows.iter().filter_map(|row| row.queued.get(at).copied());
        let slack = self.rows.iter().filter_map(|row| row.slack.get(at).copied());
        (queued.collect(), slack.filter(|&us| us != NONE).map(u64::from).collect())
    }

    /// The approximate memory of the rows, in bytes.
    pub fn weight(&self) -> usize {
        self.rows.iter().map(|row| size_of_val(&*row.queued) + size_of_val(&*row.slack)).sum()
    }
}

/// Returns the last values again if `values` are equal to them, so that rows share memory.
fn shared<T: PartialEq>(last: Option<&Arc<[T]>>, values: Vec<T>) -> Arc<[T]> {
    last.filter(|last| ***last == *values).map_or_else(|| values.into(), Arc::clone)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::specimen::Specimen;
    use imrs_protocol::Ticks;

    const TASK: TaskId = TaskId(0);

    #[test]
    fn the_last_states_of_each_port_are_kept() {
        let mut samples = Samples::default();
        let mut state = Specimen { nodes: 1, tasks: 2, ports: 3, queue_limit: 0 }.snapshot(0);
        for port in &mut state.tasks[1].view.ports {
            port.capacity = 4;
        }
        let port = state.tasks[1].view.ports[1].port;
        let task = state.tasks[1].view.task;
        for number in 0..100_u16 {
            let view = &mut state.tasks[1].view.ports[1];
            view.len = number % 3;
            view.min_slack = (view.len > 0).then_some(Ticks(u64::from(number)));
            samples.take(1_000, &state);
        }
        let (queued, slack) = samples.of(&state, task, port);
        let expected: Vec<u16> = (40..100).map(|number| number % 3).collect();
        assert_eq!(queued, expected);
        let expected: Vec<u64> = (40..100).filter(|number| number % 3 > 0).map(|us| us * 1_000).collect();
        assert_eq!(slack, expected);
        // The node has got another table, with one port less.
        state.tasks[1].view.ports.pop();
        samples.take(1_000, &state);
        assert_eq!(samples.of(&state, task, port).0.len(), 1);
        assert_eq!(samples.of(&state, TASK, PortId(u16::MAX)), Default::default());
    }

    #[test]
    fn a_state_that_is_the_last_one_again_takes_no_memory() {
        let mut samples = Samples::default();
        let state = Specimen { nodes: 1, tasks: 1, ports: 3, queue_limit: 0 }.snapshot(0);
        samples.take(1, &state);
        samples.take(1, &state);
        assert!(Arc::ptr_eq(&samples.rows[0].queued, &samples.rows[1].queued));
    }
}
