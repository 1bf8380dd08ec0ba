//! Service statistics of a port, derived from events and snapshots: service times, shares of the sources, and the
//! number of queued messages.

use super::incarnation::port_of;
use super::samples::Samples;
use super::{IncarnationId, Store};
use imrs_protocol::{Event, PortId, Reason, TaskId};
use imrs_wire::obs::{Events, Snapshot};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// How many service times of a port are kept: enough for a 99th percentile, and few enough to follow a change.
const TIMES: usize = 256;
/// How many rejected messages, and how many sources, are kept for a port.
const KNOWN: usize = 256;
/// If a port has fewer service times than this, there is no forecast.
const LEAST: usize = 5;

/// Counts of the messages of one source.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Share {
    /// How many messages of the source arrived.
    pub offered: u64,
    /// How many messages of the source were handed to the task.
    pub served: u64,
    /// How often messages of the source were rejected by rank.
    pub rejected: u64,
}

/// The service statistics of a port.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Service {
    /// Median service time in microseconds: from delivery until the answer, or until the task takes the next queued
    /// message. `None` if there are too few samples.
    pub p50_us: Option<u64>,
    /// The forecast that follows from the service times.
    pub outlook: Outlook,
    /// The number of kept service times, at most 256.
    pub samples: usize,
    /// For each source, in the order of the tasks, its share of the messages of this port.
    pub by_source: Vec<(TaskId, Share)>,
    /// How many messages were queued in recent samples, oldest first.
    pub fill: Vec<u16>,
    /// The 5th percentile of the slack of the most urgent queued message in the recent samples, in microseconds; `None`
    /// if no message was queued.
    pub slack_p5_us: Option<u64>,
    /// The median slack of the most urgent queued message in the recent samples, in microseconds.
    pub slack_p50_us: Option<u64>,
    rejected: BTreeMap<(TaskId, u32), u32>,
}

/// The forecast for a port. It is computed repeatedly for all ports, so it has no field that only one screen shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outlook {
    /// The 99th percentile of the service time, in microseconds; `None` if there are too few samples.
    pub p99_us: Option<u64>,
    /// The queued message with the most rejections: its source, its number, and how often it was rejected.
    pub most_rejected: Option<(TaskId, u32, u32)>,
}

impl Outlook {
    /// The time until the message at `position` (from 0) in the buffer is served, in microseconds, if service takes as
    /// long as at present.
    #[must_use]
    pub fn done_in(&self, position: usize) -> Option<u64> {
        let turns = u64::try_from(position).unwrap_or(u64::MAX).saturating_add(1);
        self.p99_us.map(|each| each.saturating_mul(turns))
    }
}

impl Service {
    /// Jain's fairness index, computed from the share of its messages that each source got served: 1 if all shares are
    /// equal, 1/n if one of n sources gets everything. `None` with fewer than two sources.
    #[must_use]
    pub fn jain(&self) -> Option<f64> {
        #[expect(clippy::cast_precision_loss, reason = "an index between 0 and 1")]
        let part = |share: &Share| share.served as f64 / share.offered as f64;
        let parts: Vec<f64> =
            self.by_source.iter().filter(|(_, s)| s.offered > 0).map(|(_, s)| part(s)).collect();
        let squares: f64 = parts.iter().map(|x| x * x).sum();
        let sum: f64 = parts.iter().sum();
        #[expect(clippy::cast_precision_loss, reason = "a number of sources")]
        (parts.len() > 1 && squares > 0.0).then(|| sum * sum / (parts.len() as f64 * squares))
    }

    /// How often a queued message was rejected by rank.
    #[must_use]
    pub fn rejections(&self, source: TaskId, number: u32) -> u32 {
        self.rejected.get(&(source, number)).copied().unwrap_or(0)
    }
}

/// The service statistics of a port of a task, if there are any.
#[must_use]
pub fn service(store: &Store, incarnation: IncarnationId, task: TaskId, port: PortId) -> Option<Service> {
    let last = store.incarnation(incarnation)?.last.as_ref()?;
    let samples = store.services.samples.get(&incarnation)?;
    let (fill, mut slack) = samples.of(&last.snapshot, task, port);
    let served = store.services.ports.get(&(incarnation, task, port));
    // Nothing is known of a port whose queue was always empty, and that had no events.
    (served.is_some() || fill.iter().any(|len| *len > 0)).then(|| Service {
        slack_p5_us: percentile(&mut slack, 5),
        slack_p50_us: percentile(&mut slack, 50),
        fill,
        ..served.map_or_else(Service::default, |port| port.service())
    })
}

/// The forecast for a port of a task.
#[must_use]
pub fn outlook(store: &Store, incarnation: IncarnationId, task: TaskId, port: PortId) -> Outlook {
    store.services.ports.get(&(incarnation, task, port)).map_or_else(Outlook::default, |port| port.outlook())
}

/// The statistics of all ports.
#[derive(Clone, Debug, Default)]
pub(super) struct Services {
    ports: BTreeMap<(IncarnationId, TaskId, PortId), Arc<Port>>,
    samples: BTreeMap<IncarnationId, Samples>,
}

/// The statistics of one port.
#[derive(Clone, Debug, Default)]
struct Port {
    /// How many messages are queued, by the last state and the events since then.
    waiting: u32,
    /// How many states there were when `waiting` was last taken from a state.
    states: u64,
    /// The message that the task is serving: source, number, moment of delivery, and whether other messages were queued
    /// behind it.
    in_hand: Option<(TaskId, u32, u64, bool)>,
    times: VecDeque<u32>,
    shares: BTreeMap<TaskId, Share>,
    rejected: BTreeMap<(TaskId, u32), u32>,
}

impl Services {
    /// Updates the statistics with the events of an incarnation, which are in order for each task. `last` is its last state,
    /// which says how many messages were queued then.
    pub fn happened(&mut self, incarnation: IncarnationId, last: Option<&Snapshot>, events: &Events) {
        let states = self.samples.get(&incarnation).map_or(0, |samples| samples.count);
        if events.lost > 0 {
            // Because events are missing, the measurements that have begun are discarded.
            for (_, port) in self.ports.range_mut(of(incarnation)) {
                Arc::make_mut(port).in_hand = None;
            }
        }
        for event in &events.events {
            let what = event.what;
            let (Some(task), true) = (event.task, what.port != PortId::NONE) else { continue };
            let concerns = matches!(
                what.event,
                Event::Enqueued
                    | Event::Delivered
                    | Event::Replied
                    | Event::Rejected
                    | Event::Discarded(Reason::Expired | Reason::Evicted | Reason::Superseded)
            );
            if concerns {
                let port = Arc::make_mut(self.ports.entry((incarnation, task, what.port)).or_default());
                if port.states < states {
                    port.states = states;
                    let queued = last.and_then(|last| queued_at(last, task, what.port));
                    port.waiting = queued.unwrap_or(port.waiting);
                }
                port.happened(event.mono_us, what.event, what.peer, what.number);
            }
        }
    }

    /// Takes a new state of an incarnation.
    pub fn sampled(&mut self, incarnation: IncarnationId, tick_us: u64, snapshot: &Snapshot) {
        self.samples.entry(incarnation).or_default().take(tick_us, snapshot);
    }

    /// The approximate memory of the statistics, in bytes.
    pub fn weight(&self) -> usize {
        let port = |port: &Arc<Port>| size_of::<Port>() + 4 * port.times.capacity();
        let samples = self.samples.values().map(Samples::weight).sum::<usize>();
        samples + self.ports.values().map(port).sum::<usize>()
    }

    /// Drops the statistics of an incarnation.
    pub fn forget(&mut self, incarnation: IncarnationId) {
        self.ports.retain(|(of, _, _), _| *of != incarnation);
        self.samples.remove(&incarnation);
    }
}

fn of(incarnation: IncarnationId) -> std::ops::RangeInclusive<(IncarnationId, TaskId, PortId)> {
    (incarnation, TaskId(0), PortId(0))..=(incarnation, TaskId(u16::MAX), PortId(u16::MAX))
}

/// How many messages a state has in the queue of a port; `None` for a port without a queue.
fn queued_at(state: &Snapshot, task: TaskId, port: PortId) -> Option<u32> {
    // Nodes send tasks in ascending order; if the binary search fails, a linear one decides.
    let tasks = &state.tasks;
    let found = tasks.binary_search_by_key(&task, |one| one.view.task).ok().and_then(|at| tasks.get(at));
    let task = found.or_else(|| tasks.iter().find(|one| one.view.task == task))?;
    port_of(task, port).filter(|port| port.capacity > 0).map(|port| port.len.into())
}

impl Port {
    fn happened(&mut self, at: u64, event: Event, source: TaskId, number: u32) {
        match event {
            Event::Enqueued => {
                self.waiting += 1;
                self.share(source).offered += 1;
            }
            Event::Delivered => {
                if let Some((.., since, true)) = self.in_hand.take() {
                    self.took(at.saturating_sub(since));
                }
                // A message for a waiting task is delivered without being queued, so it is counted here.
                if self.waiting == 0 {
                    self.share(source).offered += 1;
                }
                self.waiting = self.waiting.saturating_sub(1);
                self.share(source).served += 1;
                self.rejected.remove(&(source, number));
                self.in_hand = Some((source, number, at, self.waiting > 0));
            }
            Event::Replied => {
                if let Some((.., since, _)) = self.in_hand.take_if(|(s, n, ..)| (*s, *n) == (source, number))
                {
                    self.took(at.saturating_sub(since));
                }
            }
            Event::Rejected => {
                self.share(source).rejected += 1;
                if self.rejected.len() < KNOWN || self.rejected.contains_key(&(source, number)) {
                    *self.rejected.entry((source, number)).or_default() += 1;
                }
            }
            _ => {
                self.waiting = self.waiting.saturating_sub(1);
                self.rejected.remove(&(source, number));
            }
        }
    }

    fn took(&mut self, us: u64) {
        if self.times.len() == TIMES {
            self.times.pop_front();
        }
        self.times.push_back(u32::try_from(us).unwrap_or(u32::MAX));
    }

    fn share(&mut self, source: TaskId) -> &mut Share {
        // Node data is untrusted, so the number of sources is bounded.
        let source = if self.shares.len() < KNOWN || self.shares.contains_key(&source) {
            source
        } else {
            TaskId(u16::MAX)
        };
        self.shares.entry(source).or_default()
    }

    fn outlook(&self) -> Outlook {
        // The 99th percentile of at most 256 values is one of the three greatest.
        let mut greatest = [0; 3];
        for &us in &self.times {
            if let Some(place) = greatest.iter().position(|&other| us > other) {
                greatest[place..].rotate_right(1);
                greatest[place] = us;
            }
        }
        let above = self.times.len() / 100;
        let p99_us = greatest.get(above).filter(|_| self.times.len() >= LEAST).map(|us| u64::from(*us));
        let most = self.rejected.iter().max_by_key(|(_, times)| **times);
        Outlook { p99_us, most_rejected: most.map(|(&(source, number), &times)| (source, number, times)) }
    }

    fn service(&self) -> Service {
        let mut times: Vec<u64> = self.times.iter().map(|us| u64::from(*us)).collect();
        let known = times.len() >= LEAST;
        Service {
            p50_us: percentile(&mut times, 50).filter(|_| known),
            outlook: self.outlook(),
            samples: times.len(),
            by_source: self.shares.iter().map(|(source, share)| (*source, *share)).collect(),
            rejected: self.rejected.clone(),
            ..Service::default()
        }
    }
}

/// The value that `percent` of `values` do not exceed; `None` if there are no values.
pub(super) fn percentile(values: &mut [u64], percent: usize) -> Option<u64> {
    values.sort_unstable();
    let rank = (values.len() * percent).div_ceil(100).max(1);
    values.get(rank - 1).copied()
}

#[cfg(test)]
mod tests {
    use super::*;
    use imrs_protocol::{Observation, Ticks};
    use imrs_wire::obs::TimedEvent;

    const PORT: PortId = PortId(3);

    fn event(mono_us: u64, event: Event, source: u16, number: u32) -> TimedEvent {
        let what = Observation { event, port: PORT, peer: TaskId(source), number, remaining: Ticks(1) };
        TimedEvent { mono_us, task: Some(TaskId(0)), what }
    }

    fn learnt(events: Vec<TimedEvent>) -> Service {
        let mut services = Services::default();
        services.happened(IncarnationId(1), None, &Events { lost: 0, events });
        services.ports[&(IncarnationId(1), TaskId(0), PORT)].service()
    }

    #[test]
    fn a_message_takes_until_it_is_answered_or_until_the_next_that_waited_is_taken() {
        let mut all: Vec<_> = (0..6).map(|n| event(0, Event::Enqueued, 1, n)).collect();
        all.extend((0..6).map(|n| event(u64::from(n) * 1_000, Event::Delivered, 1, n)));
        // No message was queued behind the last one, so only its answer ends the measurement.
        all.push(event(5_300, Event::Replied, 1, 5));
        let service = learnt(all);
        assert_eq!((service.samples, service.p50_us, service.outlook.p99_us), (6, Some(1_000), Some(1_000)));
        assert_eq!(service.outlook.done_in(0), Some(1_000));
        assert_eq!(service.outlook.done_in(2), Some(3_000));
    }

    #[test]
    fn a_task_that_waits_for_work_is_not_slow() {
        let all = (0..9).map(|n| event(u64::from(n) * 1_000_000, Event::Delivered, 1, n)).collect();
        let service = learnt(all);
        assert_eq!((service.samples, service.outlook.p99_us), (0, None));
        assert_eq!(service.by_source, [(TaskId(1), Share { offered: 9, served: 9, rejected: 0 })]);
    }

    #[test]
    fn sources_that_fare_alike_have_index_one_and_a_starved_one_lowers_it() {
        let fair = (0..4).flat_map(|n| [event(0, Event::Delivered, 1, n), event(0, Event::Delivered, 2, n)]);
        assert_eq!(learnt(fair.collect()).jain(), Some(1.0));
        let mut unfair: Vec<_> = (0..4).map(|n| event(0, Event::Delivered, 1, n)).collect();
        unfair.push(event(0, Event::Enqueued, 2, 9));
        unfair.extend((0..3).map(|_| event(0, Event::Rejected, 2, 9)));
        let service = learnt(unfair);
        assert_eq!(service.jain(), Some(0.5));
        assert_eq!(service.rejections(TaskId(2), 9), 3);
        assert_eq!(service.outlook.most_rejected, Some((TaskId(2), 9, 3)));
    }

    #[test]
    fn a_gap_ends_what_was_being_measured() {
        let mut services = Services::default();
        let first = vec![
            event(0, Event::Enqueued, 1, 0),
            event(0, Event::Enqueued, 1, 1),
            event(0, Event::Delivered, 1, 0),
        ];
        services.happened(IncarnationId(1), None, &Events { lost: 0, events: first });
        let later = vec![event(9_000_000, Event::Delivered, 1, 1)];
        services.happened(IncarnationId(1), None, &Events { lost: 7, events: later });
        assert_eq!(services.ports[&(IncarnationId(1), TaskId(0), PORT)].service().samples, 0);
    }

    #[test]
    fn what_is_foretold_goes_by_the_same_percentile() {
        for samples in [1, LEAST, 99, 100, 101, 199, 200, TIMES] {
            let mut port = Port::default();
            (0..samples).for_each(|n| port.took((n as u64 * 7_919) % 1_009));
            let mut times: Vec<u64> = port.times.iter().map(|us| u64::from(*us)).collect();
            let p99 = percentile(&mut times, 99).filter(|_| samples >= LEAST);
            assert_eq!(port.outlook().p99_us, p99, "of {samples}");
        }
    }

    #[test]
    fn percentiles_are_values_that_occurred() {
        let mut values: Vec<u64> = (1..=100).rev().collect();
        assert_eq!(percentile(&mut values, 99), Some(99));
        assert_eq!(percentile(&mut values, 50), Some(50));
        assert_eq!(percentile(&mut values, 5), Some(5));
        assert_eq!(percentile(&mut [7], 99), Some(7));
        assert_eq!(percentile(&mut [], 50), None);
    }
}
