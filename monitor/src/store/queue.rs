//! What waits at a port: as the node's state lists it, or in detail where the port is watched.

use super::{Left, Life};
use crate::clock::Moment;
use imrs_protocol::{HeldView, PortId, QueueEntry, TaskId};
use std::time::Duration;

/// Detail that is older than this gives way to the state.
const STALE: Duration = Duration::from_secs(1);

/// A message that waits.
#[derive(Clone, Copy, Debug)]
pub struct Waiting {
    /// The message.
    pub entry: QueueEntry,
    /// What is left of its life now.
    pub left: Left,
    /// What it has been through, where the port is watched.
    pub held: Option<HeldView>,
    /// What is left of its back-off now, in microseconds.
    pub back_off_us: u64,
}

/// The messages that wait at a port, in the order of their lives.
#[must_use]
pub fn queue(life: &Life, task: TaskId, port: PortId, now: Moment) -> Vec<Waiting> {
    let Some(snapshot) = life.task(task) else { return Vec::new() };
    let told = life.watched(task, port).filter(|told| now.saturating_sub(told.at) < STALE);
    if let Some(told) = told {
        let passed = now.saturating_sub(told.at).saturating_add(Duration::from_micros(told.what.age_us));
        let passed_us = crate::clock::micros(passed);
        let us = |ticks: imrs_protocol::Ticks| ticks.0.saturating_mul(life.tick_us).saturating_sub(passed_us);
        let waiting = |held: &HeldView| Waiting {
            entry: held.entry,
            left: Left { us: us(held.entry.remaining), estimated: false },
            held: Some(*held),
            back_off_us: us(held.back_off),
        };
        return told.what.queue.queue.iter().map(waiting).collect();
    }
    let listed = life.port(task, port).map_or(&[][..], |view| &view.queue);
    let waiting = |entry: &QueueEntry| Waiting {
        entry: *entry,
        left: life.left(entry.remaining, snapshot.age_us, now),
        held: None,
        back_off_us: 0,
    };
    listed.iter().map(waiting).collect()
}
