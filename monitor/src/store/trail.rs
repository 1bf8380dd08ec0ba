//! What the machines observed, one by one and in bounded memory: what the journal folds into one line is here still
//! apart, for the screens that follow single messages.

use super::LifeId;
use super::coverage::{Fired, KINDS, place};
use crate::clock::Moment;
use imrs_protocol::{Event, Observation, PortId, TaskId};
use imrs_wire::obs::Events;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

/// How many observations are kept.
pub const KEPT: usize = 32 * 1024;

/// How far back one looks for what belongs to a present state, in batches.
const LOOKED_AT: usize = 64;

/// Of how many lives, and tasks of each, it is counted what happened.
const LIVES: usize = 256;
const TASKS: usize = 4096;

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
    /// For each life, and each of its tasks: how often each kind was observed, ever.
    fired: BTreeMap<LifeId, BTreeMap<Option<TaskId>, Box<Fired>>>,
}

impl Trail {
    /// Takes over what a life said, and forgets the oldest.
    pub fn take(&mut self, at: Moment, life: LifeId, events: &Events) {
        if events.events.is_empty() && events.lost == 0 {
            return;
        }
        let seen: Arc<[Seen]> =
            (events.events.iter()).map(|e| Seen { mono_us: e.mono_us, task: e.task, what: e.what }).collect();
        self.count(life, &seen);
        let newest_us = seen.iter().map(|s| s.mono_us).max().unwrap_or(0);
        self.len += cost(&seen);
        self.batches.push_back(Batch { life, at, lost: events.lost, newest_us, seen });
        while self.len > KEPT {
            let Some(oldest) = self.batches.pop_front() else { break };
            self.len -= cost(&oldest.seen);
        }
    }

    fn count(&mut self, life: LifeId, seen: &[Seen]) {
        if !self.fired.contains_key(&life) && self.fired.len() == LIVES {
            self.fired.pop_first();
        }
        let tasks = self.fired.entry(life).or_default();
        for one in seen {
            if tasks.len() < TASKS || tasks.contains_key(&one.task) {
                let fired = tasks.entry(one.task).or_insert_with(|| Box::new([0; KINDS.len()]));
                let count = &mut fired[place(one.what.event)];
                *count = count.saturating_add(1);
            }
        }
    }

    /// How often each kind was observed in a task of a life (`None`: in its transit buffer), ever.
    #[must_use]
    pub fn fired(&self, life: LifeId, task: Option<TaskId>) -> Option<&Fired> {
        self.fired.get(&life)?.get(&task).map(|fired| &**fired)
    }

    /// The number in the latest such observation of a task on a port.
    #[must_use]
    pub fn last_number(&self, life: LifeId, task: TaskId, event: Event, port: PortId) -> Option<u32> {
        let fits = |s: &&Seen| s.task == Some(task) && s.what.event == event && s.what.port == port;
        let batches = self.batches.iter().rev().filter(|batch| batch.life == life).take(LOOKED_AT);
        batches.flat_map(|batch| batch.seen.iter().rev()).find(fits).map(|seen| seen.what.number)
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
