//! The trail: single observations in bounded memory, for screens that follow single messages. The journal, in contrast,
//! combines repetitions into one entry.

use super::IncarnationId;
use super::coverage::{Fired, KINDS, place};
use crate::clock::Moment;
use imrs_protocol::{Event, Observation, PortId, TaskId};
use imrs_wire::obs::Events;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

/// How many observations are kept, at most.
pub const KEPT: usize = 32 * 1024;

/// How many of the latest batches are searched for the event that led to a task's present state.
const LOOKED_AT: usize = 64;

/// For how many incarnations events are counted, at most, and for how many tasks of each.
const INCARNATIONS: usize = 256;
const TASKS: usize = 4096;

/// One observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seen {
    /// The node's monotonic clock at the event, in microseconds.
    pub mono_us: u64,
    /// The task that observed it; `None` for the transit buffer.
    pub task: Option<TaskId>,
    /// The observation.
    pub what: Observation,
}

/// One frame of events from an incarnation of a node.
#[derive(Clone, Debug)]
pub struct Batch {
    /// The incarnation from which the frame came.
    pub incarnation: IncarnationId,
    /// The moment at which the frame arrived.
    pub at: Moment,
    /// How many observations were lost before those of this batch.
    pub lost: u64,
    /// The greatest `mono_us` of the batch's observations.
    pub newest_us: u64,
    /// The observations, oldest first for each task.
    pub seen: Arc<[Seen]>,
}

impl Batch {
    /// The moment of an observation of the batch, if the frame had no transfer delay.
    #[must_use]
    pub const fn moment(&self, seen: &Seen) -> Moment {
        self.at.saturating_sub(Duration::from_micros(self.newest_us.saturating_sub(seen.mono_us)))
    }
}

/// The latest observations of all incarnations. A clone shares them.
#[derive(Clone, Debug, Default)]
pub struct Trail {
    batches: VecDeque<Batch>,
    len: usize,
    /// For each incarnation and each of its tasks: how often each kind of event was observed so far.
    fired: BTreeMap<IncarnationId, BTreeMap<Option<TaskId>, Box<Fired>>>,
}

impl Trail {
    /// Adds the events of an incarnation, and drops the oldest batches.
    pub fn take(&mut self, at: Moment, incarnation: IncarnationId, events: &Events) {
        if events.events.is_empty() && events.lost == 0 {
            return;
        }
        let seen: Arc<[Seen]> =
            (events.events.iter()).map(|e| Seen { mono_us: e.mono_us, task: e.task, what: e.what }).collect();
        self.count(incarnation, &seen);
        let newest_us = seen.iter().map(|s| s.mono_us).max().unwrap_or(0);
        self.len += cost(&seen);
        self.batches.push_back(Batch { incarnation, at, lost: events.lost, newest_us, seen });
        while self.len > KEPT {
            let Some(oldest) = self.batches.pop_front() else { break };
            self.len -= cost(&oldest.seen);
        }
    }

    fn count(&mut self, incarnation: IncarnationId, seen: &[Seen]) {
        if !self.fired.contains_key(&incarnation) && self.fired.len() == INCARNATIONS {
            self.fired.pop_first();
        }
        let tasks = self.fired.entry(incarnation).or_default();
        for one in seen {
            if tasks.len() < TASKS || tasks.contains_key(&one.task) {
                let fired = tasks.entry(one.task).or_insert_with(|| Box::new([0; KINDS.len()]));
                let count = &mut fired[place(one.what.event)];
                *count = count.saturating_add(1);
            }
        }
    }

    /// How often each kind of event was observed so far in a task of an incarnation (`None` for its transit buffer).
    #[must_use]
    pub fn fired(&self, incarnation: IncarnationId, task: Option<TaskId>) -> Option<&Fired> {
        self.fired.get(&incarnation)?.get(&task).map(|fired| &**fired)
    }

    /// The number in the latest observation of this kind at a task's port.
    #[must_use]
    pub fn last_number(
        &self,
        incarnation: IncarnationId,
        task: TaskId,
        event: Event,
        port: PortId,
    ) -> Option<u32> {
        let fits = |s: &&Seen| s.task == Some(task) && s.what.event == event && s.what.port == port;
        let batches =
            self.batches.iter().rev().filter(|batch| batch.incarnation == incarnation).take(LOOKED_AT);
        batches.flat_map(|batch| batch.seen.iter().rev()).find(fits).map(|seen| seen.what.number)
    }

    /// The approximate memory of the observations, in bytes.
    #[must_use]
    pub fn weight(&self) -> usize {
        let counts = self.fired.values().map(|tasks| tasks.len() * size_of::<Fired>()).sum::<usize>();
        self.len * size_of::<Seen>() + counts
    }

    /// The batches, in order of arrival.
    pub fn batches(&self) -> impl DoubleEndedIterator<Item = &Batch> {
        self.batches.iter()
    }
}

/// What a batch costs: its observations, and one for the batch itself, so that the number of empty batches is bounded, too.
fn cost(seen: &[Seen]) -> usize {
    seen.len() + 1
}
