//! The queued messages of a cell that are nearest to missing their deadline.

use super::service::outlook;
use super::{IncarnationId, Left, Store};
use crate::clock::Moment;
use crate::name::Name;
use imrs_protocol::{MessageId, PortId, TaskId, Usage};

/// How many ports are searched for messages that may miss their deadline: the ports with the least slack. Examining
/// each message of ten thousand ports would take longer than a frame.
const PORTS: usize = 64;

/// A queued message, with the time that it has left and needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Near {
    /// The incarnation of the node at which the message is queued.
    pub incarnation: IncarnationId,
    /// The task that receives the message.
    pub task: TaskId,
    /// The port of the message.
    pub port: PortId,
    /// The task that sent the message, and the message's id; `None` if the node does not list the port's queue.
    pub message: Option<(TaskId, MessageId)>,
    /// The remaining time of the message.
    pub left: Left,
    /// The time from now until the receiver has probably served the message, in microseconds: 99 of 100 messages are
    /// served earlier.
    pub needs_us: Option<u64>,
}

impl Near {
    /// Whether the message will probably miss its deadline.
    #[must_use]
    pub fn is_miss(&self) -> bool {
        self.needs_us.is_some_and(|needs| self.left.us < needs)
    }

    /// The time to spare, in microseconds.
    fn spare(&self) -> i128 {
        i128::from(self.left.us) - i128::from(self.needs_us.unwrap_or(0))
    }
}

/// The messages that are nearest to missing their deadline, at most `most`: first those that will probably miss it, least
/// remaining time first, then the others, least time to spare first.
#[must_use]
pub fn nearest(store: &Store, cell: &Name, now: Moment, most: usize) -> Vec<Near> {
    let mut ports = Vec::new();
    for incarnation in store.present(cell).filter(|incarnation| !incarnation.presence(now).is_gone()) {
        for task in incarnation.tasks() {
            let queues = task.view.ports.iter().filter(|port| port.len > 0 && port.usage != Usage::Waitfor);
            ports.extend(queues.filter_map(|port| {
                Some((incarnation.left(port.min_slack?, task.age_us, now), incarnation, task, port))
            }));
        }
    }
    ports.sort_by_key(|(left, ..)| *left);
    let mut found = Vec::new();
    for (left, incarnation, task, port) in ports.into_iter().take(PORTS) {
        let outlook = outlook(store, incarnation.id, task.view.task, port.port);
        let near = |message, left, position| Near {
            incarnation: incarnation.id,
            task: task.view.task,
            port: port.port,
            message,
            left,
            needs_us: outlook.done_in(position),
        };
        if port.queue.is_empty() {
            found.push(near(None, left, 0));
        }
        for (position, entry) in port.queue.iter().enumerate() {
            let left = incarnation.left(entry.remaining, task.age_us, now);
            found.push(near(Some((entry.source, entry.id)), left, position));
        }
    }
    let order = |near: &Near| if near.is_miss() { i128::from(near.left.us) } else { near.spare() };
    found.sort_by_key(|near| (!near.is_miss(), order(near), near.task, near.port));
    found.truncate(most);
    found
}
