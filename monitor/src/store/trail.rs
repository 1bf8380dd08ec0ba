//! What the machines observed, one by one and in bounded memory: what the journal folds into one line is here still
//! apart, for the screens that follow single messages.

use super::LifeId;
use crate::clock::Moment;
use imrs_protocol::{Observation, TaskId};
use imrs_wire::obs::Events;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

/// How many observations are kept.
pub const KEPT: usize = 32 * 1024;

/// One observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seen {
    /// The node's monotonic clock then, in microseconds.
    pub mono_us: u64,
    /// Where: a task, or `None` for the transit buffer.
    pub task: Option<TaskId>,
    /// What.
    pub what: Observation,
}

/// What one life of a node said at once.
#[derive(Clone, Debug)]
pub struct Batch {
    /// Which life.
    pub life: LifeId,
    /// When it came.
    pub at: Moment,
    /// How many observations before these were lost.
    pub lost: u64,
    /// The greatest `mono_us` of them.
    pub newest_us: u64,
    /// The observations, oldest first for each task.
    pub seen: Arc<[Seen]>,
}

impl Batch {
    /// When an observation of the batch was made, as far as its way to the monitor took no time.
    #[must_use]
    pub const fn moment(&self, seen: &Seen) -> Moment {
        self.at.saturating_sub(Duration::from_micros(self.newest_us.saturating_sub(seen.mono_us)))
    }
}

/// The latest observations of all lives. A copy shares them.
#[derive(Clone, Debug, Default)]
pub struct Trail {
    batches: VecDeque<Batch>,
    len: usize,
}

impl Trail {
    /// Takes over what a life said, and forgets the oldest.
    pub fn take(&mut self, at: Moment, life: LifeId, events: &Events) {
        if events.events.is_empty() && events.lost == 0 {
            return;
        }
        let seen: Arc<[Seen]> =
            (events.events.iter()).map(|e| Seen { mono_us: e.mono_us, task: e.task, what: e.what }).collect();
        let newest_us = seen.iter().map(|s| s.mono_us).max().unwrap_or(0);
        self.len += cost(&seen);
        self.batches.push_back(Batch { life, at, lost: events.lost, newest_us, seen });
        while self.len > KEPT {
            let Some(oldest) = self.batches.pop_front() else { break };
            self.len -= cost(&oldest.seen);
        }
    }

    /// What was said, in the order in which it came.
    pub fn batches(&self) -> impl DoubleEndedIterator<Item = &Batch> {
        self.batches.iter()
    }
}

/// A batch counts too, so that empty ones cannot fill the memory.
fn cost(seen: &[Seen]) -> usize {
    seen.len() + 1
}
