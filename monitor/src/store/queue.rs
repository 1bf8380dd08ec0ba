//! The queued messages of a port: in detail if the port is watched, otherwise as listed in the snapshot.

use super::{Left, NodeIncarnation};
use crate::clock::Moment;
use imrs_protocol::{HeldView, PortId, QueueEntry, TaskId};
use std::time::Duration;

/// If the details of a watched queue are older than this, the snapshot's list is used instead.
const STALE: Duration = Duration::from_secs(1);

/// A queued message.
#[derive(Clone, Copy, Debug)]
pub struct Waiting {
    /// The queued message.
    pub entry: QueueEntry,
    /// The remaining time of the message now.
    pub left: Left,
    /// The history of the message, if the port is watched.
    pub held: Option<HeldView>,
    /// The time until the message is offered again after a rejection, in microseconds.
    pub back_off_us: u64,
}

/// The queued messages of a port, shortest remaining time first.
#[must_use]
pub fn queue(incarnation: &NodeIncarnation, task: TaskId, port: PortId, now: Moment) -> Vec<Waiting> {
    let Some(snapshot) = incarnation.task(task) else { return Vec::new() };
    let told = incarnation.watched(task, port).filter(|told| now.saturating_sub(told.at) < STALE);
    if let Some(told) = told {
        let passed = now.saturating_sub(told.at).saturating_add(Duration::from_micros(told.what.age_us));
        let passed_us = crate::clock::micros(passed);
        let us = |ticks: imrs_protocol::Ticks| {
            ticks.0.saturating_mul(incarnation.tick_us).saturating_sub(passed_us)
        };
        let waiting = |held: &HeldView| Waiting {
            entry: held.entry,
            left: Left { us: us(held.entry.remaining), estimated: false },
            held: Some(*held),
            back_off_us: us(held.back_off),
        };
        return told.what.queue.queue.iter().map(waiting).collect();
    }
    let listed = incarnation.port(task, port).map_or(&[][..], |view| &view.queue);
    let waiting = |entry: &QueueEntry| Waiting {
        entry: *entry,
        left: incarnation.left(entry.remaining, snapshot.age_us, now),
        held: None,
        back_off_us: 0,
    };
    listed.iter().map(waiting).collect()
}
