//! The recent past of a node: its traffic and least slack in each second, and its counters some seconds before.

use crate::clock::Moment;
use imrs_protocol::{PortCounters, PortId, PortView, TaskId};
use imrs_wire::obs::{Snapshot, TaskSnapshot};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

/// How many seconds of a node are kept.
pub const SECONDS: usize = 60;
/// The interval over which [`Recent::grown`] compares counters. The compared counters are at most a second older.
pub const WINDOW: Duration = Duration::from_secs(5);
const SECOND: Duration = Duration::from_secs(1);

/// One second of a node's past.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Second {
    /// How many messages the node's tasks sent and took.
    pub messages: u64,
    /// The least slack of a queued message in microseconds, over all states that arrived in this second.
    pub slack_us: Option<u64>,
}

/// The counters of a port at one moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Counted {
    end: (TaskId, PortId),
    expired: u32,
    overflow: u32,
    rejected: u32,
    resent: u32,
    timed_out: u32,
}

/// The recent past of an incarnation.
#[derive(Clone, Debug, Default)]
pub struct Recent {
    seconds: VecDeque<Second>,
    /// When the present second began, and how many messages the tasks had sent and taken by then.
    open: Option<(Moment, u64)>,
    slack_us: Option<u64>,
    /// The counters of the ports at the beginning of each of the last seconds, sorted by task and port.
    counted: VecDeque<(Moment, Arc<[Counted]>)>,
}

impl Recent {
    /// The last seconds, oldest first.
    pub fn seconds(&self) -> impl ExactSizeIterator<Item = Second> + DoubleEndedIterator + '_ {
        self.seconds.iter().copied()
    }

    /// By how much the counters of a port have grown within [`WINDOW`]; `now` are its latest counters. Refused and
    /// evicted messages are one sum.
    #[must_use]
    pub fn grown(&self, task: TaskId, port: PortId, now: &PortCounters) -> PortCounters {
        let Some((_, all)) = self.counted.front() else { return PortCounters::default() };
        let found = all.binary_search_by_key(&(task, port), |counted| counted.end);
        let before = found.ok().map(|at| all[at]);
        let grown =
            |now: u64, of: fn(&Counted) -> u32| now.saturating_sub(before.as_ref().map_or(0, of).into());
        PortCounters {
            expired: grown(now.expired, |c| c.expired),
            refused: grown(now.refused.saturating_add(now.evicted), |c| c.overflow),
            rejected: grown(now.rejected, |c| c.rejected),
            resent: grown(now.resent, |c| c.resent),
            timed_out: grown(now.timed_out, |c| c.timed_out),
            ..PortCounters::default()
        }
    }

    /// The approximate memory of this value, in bytes.
    pub(super) fn weight(&self) -> usize {
        let counted = self.counted.iter().map(|(_, all)| size_of_val(&**all)).sum::<usize>();
        counted + self.seconds.capacity() * size_of::<Second>()
    }

    /// Takes a new state of the node.
    pub(super) fn sampled(&mut self, at: Moment, snapshot: &Snapshot, tick_us: u64) {
        let slack = |task: &TaskSnapshot| {
            let least = task.view.ports.iter().filter_map(|port| port.min_slack).min()?;
            Some(least.0.saturating_mul(tick_us).saturating_sub(task.age_us))
        };
        let slack = snapshot.tasks.iter().filter_map(slack).min();
        self.slack_us = [self.slack_us, slack].into_iter().flatten().min();
        let Some((began, before)) = self.open else {
            self.open = Some((at, messages(snapshot)));
            self.count(at, snapshot);
            return;
        };
        let passed = at.saturating_sub(began);
        if passed < SECOND {
            return;
        }
        let total = messages(snapshot);
        // If a node sent no state for some seconds, each of these seconds gets the same mean.
        let seconds = u64::try_from(passed.as_millis() / SECOND.as_millis()).unwrap_or(u64::MAX).max(1);
        let messages = total.saturating_sub(before) / seconds;
        let second = Second { messages, slack_us: self.slack_us.take() };
        for _ in 0..seconds.min(SECONDS as u64) {
            if self.seconds.len() >= SECONDS {
                self.seconds.pop_front();
            }
            self.seconds.push_back(second);
        }
        self.open = Some((at, total));
        self.count(at, snapshot);
    }

    fn count(&mut self, at: Moment, snapshot: &Snapshot) {
        let mut all: Vec<Counted> = Vec::new();
        for task in &snapshot.tasks {
            let counted = task.view.ports.iter().map(|port| Counted::of(task.view.task, port));
            // Most ports have counted nothing. A port that is not stored counts as such.
            all.extend(counted.filter(|counted| !counted.is_zero()));
        }
        all.sort_by_key(|counted| counted.end);
        let same = self.counted.back().filter(|(_, last)| **last == *all).map(|(_, last)| Arc::clone(last));
        self.counted.push_back((at, same.unwrap_or_else(|| all.into())));
        // One entry from before the window stays, as the window's beginning.
        while self.counted.get(1).is_some_and(|next| at.saturating_sub(next.0) >= WINDOW) {
            self.counted.pop_front();
        }
    }
}

impl Counted {
    fn of(task: TaskId, port: &PortView) -> Self {
        let small = |count: u64| u32::try_from(count).unwrap_or(u32::MAX);
        let c = port.counters;
        Self {
            end: (task, port.port),
            expired: small(c.expired),
            overflow: small(c.refused.saturating_add(c.evicted)),
            rejected: small(c.rejected),
            resent: small(c.resent),
            timed_out: small(c.timed_out),
        }
    }

    const fn is_zero(&self) -> bool {
        self.expired == 0
            && self.overflow == 0
            && self.rejected == 0
            && self.resent == 0
            && self.timed_out == 0
    }
}

/// How many messages the tasks of a state have sent and taken.
fn messages(snapshot: &Snapshot) -> u64 {
    let ports = snapshot.tasks.iter().flat_map(|task| &task.view.ports);
    let count = |port: &PortView| port.counters.sent.saturating_add(port.counters.delivered);
    ports.map(count).fold(0, u64::saturating_add)
}
