//! One incarnation of a node as the monitor sees it: its last state and the recent past.

use super::health::Looked;
use super::left::Left;
use super::names::Names;
use super::presence::Presence;
use super::recent::Recent;
use crate::clock::{Moment, micros};
use crate::name::Name;
use imrs_protocol::{NodeId, PortCounters, PortId, PortView, QueueView, TaskId, Ticks, TimeId};
use imrs_wire::obs::{
    Count, Delta, Detail, HeldBack, Lateness, LinkReports, Liveness, Pong, Snapshot, TaskSnapshot, Vitals,
};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

/// A node that has sent nothing for this long is shown as silent.
pub const SILENT: Duration = Duration::from_secs(1);
/// A remaining time from a sample older than this is shown as an estimate only.
const FRESH: Duration = Duration::from_millis(200);
/// The shortest interval over which rates are computed.
pub(super) const RATE: Duration = Duration::from_secs(2);
/// The interval over which the monitor judges whether timers are usually late.
const LATELY: Duration = Duration::from_secs(3);
/// How many timers of a node are kept, at most.
const TIMERS: usize = 1024;

/// Identifies an incarnation of a node for as long as the monitor runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct IncarnationId(pub u32);

/// Whether the monitor is attached to a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Condition {
    /// The monitor is attached to the node.
    Attached,
    /// The connection ended without a goodbye.
    Dead {
        /// The moment at which the connection ended.
        since: Moment,
        /// How the monitor noticed the end.
        why: String,
    },
    /// The node announced that it stops.
    Stopped {
        /// The moment of the announcement.
        since: Moment,
    },
}

/// A snapshot, with the moment of its arrival.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The moment at which the snapshot arrived.
    pub at: Moment,
    /// The snapshot that arrived.
    pub snapshot: Arc<Snapshot>,
}

/// A message from a node, with the moment of its arrival.
#[derive(Clone, Debug)]
pub struct Received<T> {
    /// The moment at which the message arrived.
    pub at: Moment,
    /// The message that arrived.
    pub what: T,
}

/// The queue of a watched port.
#[derive(Clone, Debug)]
pub struct Watched {
    /// The task that receives through the port.
    pub task: TaskId,
    /// The watched port.
    pub port: PortId,
    /// The age of the remaining times in `queue` on arrival, in microseconds.
    pub age_us: u64,
    /// The queued messages of the port, with the history of each.
    pub queue: QueueView,
}

/// The offset between a node's clock and the monitor's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockOffset {
    /// The time of the node's clock when the monitor's clock was zero, in microseconds.
    pub us: i64,
    /// The largest possible error: half the round trip.
    pub error_us: u64,
    /// The moment of the comparison.
    pub at: Moment,
}

/// Counts of ended timers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Ended {
    /// How many timers ended.
    pub count: u64,
    /// How many of them ended later than the tick.
    pub late: u64,
}

/// The features of a node's state that are compared with the next state.
pub(super) struct Notable {
    pub tasks: Vec<(TaskId, Liveness)>,
    pub link_discards: Vec<Count>,
}

/// Finds a port of a task. Nodes send ports in ascending order; if the binary search fails, a linear one decides.
pub(super) fn port_of(task: &TaskSnapshot, id: PortId) -> Option<&PortView> {
    let ports = &task.view.ports;
    let found = ports.binary_search_by_key(&id, |port| port.port).ok().and_then(|at| ports.get(at));
    found.or_else(|| ports.iter().find(|port| port.port == id))
}

/// One incarnation of a node.
#[derive(Clone, Debug)]
pub struct NodeIncarnation {
    /// The identifier of the incarnation.
    pub id: IncarnationId,
    /// The node's name.
    pub node: Name,
    /// The node's position in the cell's list of nodes.
    pub node_id: NodeId,
    /// The incarnation number that the node reports.
    pub number: u8,
    /// The id of the node's process.
    pub pid: u32,
    /// The program and version of the node's process.
    pub build: Name,
    /// The digest of the node's cell.
    pub digest: u32,
    /// Microseconds per tick of the node's remaining times.
    pub tick_us: u64,
    /// Whether the monitor is attached to the node.
    pub condition: Condition,
    /// The moment at which the node's last frame arrived.
    pub heard: Moment,
    /// When the node's frames began again: when it was attached, or after its last silence.
    pub(super) resumed: Moment,
    /// The names of its cell.
    pub names: Arc<Names>,
    /// The last state of the node.
    pub last: Option<Sample>,
    /// The state of the node some seconds ago, with which rates and growth are computed.
    pub base: Option<Sample>,
    /// The state that will be the next `base`.
    pub(super) next_base: Option<Sample>,
    /// How many events the node could not keep for this monitor.
    pub lost: u64,
    /// The value of `lost` at `base` and at `next_base`.
    pub(super) lost_before: (u64, u64),
    /// The longest remaining time ever seen of each timer, because a node does not report the armed duration.
    pub(super) longest: BTreeMap<(TaskId, TimeId), Ticks>,
    /// The metrics of the node's process; `None` until the node reports any.
    pub vitals: Option<Received<Vitals>>,
    /// The node's last report on its links.
    pub(super) links: Option<Received<LinkReports>>,
    /// The node's last report of held-back scripts.
    pub(super) held_back: Option<Received<HeldBack>>,
    /// The node's reports of ended and late timers within the last seconds.
    pub(super) timers: VecDeque<Received<Ended>>,
    /// The watched queues of the node.
    pub watched: Vec<Received<Watched>>,
    /// The offset of the node's clock at the last comparison.
    pub clock: Option<ClockOffset>,
    /// The cached findings of the node's tasks, valid until its next frame.
    pub(super) looked: Looked,
    /// The traffic and the counters of the node's last seconds.
    pub recent: Recent,
    /// How many earlier incarnations of the node have died and are no longer kept.
    pub(super) buried: u32,
}

impl NodeIncarnation {
    /// The presence of the node at `now`.
    #[must_use]
    pub fn presence(&self, now: Moment) -> Presence {
        let ago = |since: Moment| now.saturating_sub(since);
        match &self.condition {
            Condition::Dead { since, .. } => Presence::Dead(ago(*since)),
            Condition::Stopped { since } => Presence::Stopped(ago(*since)),
            Condition::Attached if ago(self.heard) > SILENT => Presence::Silent(ago(self.heard)),
            Condition::Attached => Presence::Up,
        }
    }

    /// The node's tasks in its last state.
    #[must_use]
    pub fn tasks(&self) -> &[TaskSnapshot] {
        self.last.as_ref().map_or(&[], |s| &s.snapshot.tasks)
    }

    /// One of the node's tasks.
    #[must_use]
    pub fn task(&self, id: TaskId) -> Option<&TaskSnapshot> {
        self.tasks().iter().find(|t| t.view.task == id)
    }

    /// One port of one of the node's tasks.
    #[must_use]
    pub fn port(&self, task: TaskId, port: PortId) -> Option<&PortView> {
        port_of(self.task(task)?, port)
    }

    /// The remaining time at `now`; `age_us` before the last snapshot it was `remaining`. For an ended node it stays the same.
    #[must_use]
    pub fn left(&self, remaining: Ticks, age_us: u64, now: Moment) -> Left {
        let now = match &self.condition {
            Condition::Attached => now,
            Condition::Dead { since, .. } | Condition::Stopped { since } => now.min(*since),
        };
        let since = self.last.as_ref().map_or(Duration::ZERO, |s| now.saturating_sub(s.at));
        let passed = micros(since).saturating_add(age_us);
        let us = remaining.0.saturating_mul(self.tick_us).saturating_sub(passed);
        Left { us, estimated: since > FRESH }
    }

    /// The remaining time at the snapshot, in microseconds. The snapshot was taken `age_us` after the task last advanced.
    #[must_use]
    pub const fn left_when_seen(&self, remaining: Ticks, age_us: u64) -> u64 {
        remaining.0.saturating_mul(self.tick_us).saturating_sub(age_us)
    }

    /// The recent rate at a port: how many messages per second the task sent and took.
    #[must_use]
    pub fn rate(&self, task: TaskId, port: PortId) -> Option<f64> {
        let task = self.task(task)?;
        let port = task.view.ports.iter().find(|p| p.port == port)?;
        self.rate_of(self.earlier(task), port)
    }

    /// The task's state some seconds ago, with which its rates are computed.
    #[must_use]
    pub fn earlier(&self, task: &TaskSnapshot) -> Option<&TaskSnapshot> {
        self.base.as_ref()?.snapshot.tasks.iter().find(|t| t.view.task == task.view.task)
    }

    /// The rate at a port since `earlier`, the older state of its task: how many messages per second the task sent and took.
    #[must_use]
    pub fn rate_of(&self, earlier: Option<&TaskSnapshot>, port: &PortView) -> Option<f64> {
        let (last, base) = (self.last.as_ref()?, self.base.as_ref()?);
        let seconds = last.at.checked_sub(base.at)?.as_secs_f64();
        let before = port_of(earlier?, port.port)?;
        let count = |counters: &PortCounters| counters.sent.saturating_add(counters.delivered);
        let grown = count(&port.counters).checked_sub(count(&before.counters))?;
        #[expect(clippy::cast_precision_loss, reason = "a rate for people")]
        (seconds > 0.0).then(|| grown as f64 / seconds)
    }

    /// How many events the node could not keep for this monitor recently.
    #[must_use]
    pub const fn lost_lately(&self) -> u64 {
        self.lost.saturating_sub(self.lost_before.0)
    }

    /// The estimated duration of a timer in microseconds: the longest remaining time ever seen.
    #[must_use]
    pub fn longest_timer(&self, task: TaskId, id: TimeId) -> Option<u64> {
        self.longest.get(&(task, id)).map(|ticks| ticks.0.saturating_mul(self.tick_us))
    }

    /// The queue of a watched port with the history of each message, if the node has reported it.
    #[must_use]
    pub fn watched(&self, task: TaskId, port: PortId) -> Option<&Received<Watched>> {
        self.watched.iter().find(|told| (told.what.task, told.what.port) == (task, port))
    }

    /// The tasks whose scripts are held back after a restart, with the remaining time in microseconds. For an ended
    /// node time stands still.
    pub fn held_back(&self, now: Moment) -> impl Iterator<Item = (TaskId, u64)> + '_ {
        let now = match &self.condition {
            Condition::Attached => now,
            Condition::Dead { since, .. } | Condition::Stopped { since } => now.min(*since),
        };
        let told = self.held_back.iter();
        told.flat_map(move |told| {
            let passed = micros(now.saturating_sub(told.at));
            told.what.tasks.iter().filter_map(move |held| {
                let us = held.remaining.0.saturating_mul(self.tick_us).saturating_sub(passed);
                (us > 0).then_some((held.task, us))
            })
        })
    }

    /// The longest time in microseconds for which a script of the node is still held back.
    #[must_use]
    pub fn longest_held_back(&self, now: Moment) -> Option<u64> {
        self.held_back(now).map(|(_, us)| us).max()
    }

    /// The time in microseconds for which the script of a task is still held back.
    #[must_use]
    pub fn task_held_back(&self, task: TaskId, now: Moment) -> Option<u64> {
        self.held_back(now).find(|(held, _)| *held == task).map(|(_, us)| us)
    }

    /// The approximate memory of the states in this value, in bytes.
    pub(super) fn weight(&self) -> usize {
        let samples = [&self.last, &self.base, &self.next_base];
        let port = |port: &PortView| size_of::<PortView>() + size_of_val(port.queue.as_slice());
        let tasks = |sample: &Sample| -> usize {
            let ports = sample.snapshot.tasks.iter().flat_map(|task| &task.view.ports);
            ports.map(port).sum::<usize>() + size_of_val(sample.snapshot.tasks.as_slice())
        };
        // A state that is kept twice is counted twice.
        samples.into_iter().flatten().map(tasks).sum::<usize>() + self.recent.weight()
    }

    /// The features that are compared with the next state.
    pub(super) fn notable(&self) -> Option<Notable> {
        let snapshot = &self.last.as_ref()?.snapshot;
        let tasks = snapshot.tasks.iter().map(|task| (task.view.task, task.liveness)).collect();
        Some(Notable { tasks, link_discards: snapshot.link_discards.clone() })
    }

    /// Applies a delta. Returns false if it does not fit the last state.
    pub(super) fn change(&mut self, at: Moment, delta: &Delta) -> bool {
        if delta.is_whole() {
            let mut snapshot = Snapshot::default();
            let fits = snapshot.apply(delta).is_ok();
            if fits {
                self.take(at, snapshot);
            }
            return fits;
        }
        let Some(last) = &mut self.last else { return false };
        // The base is checked before `make_mut` copies a shared snapshot.
        if delta.base_us != Some(last.snapshot.mono_us)
            || Arc::make_mut(&mut last.snapshot).apply(delta).is_err()
        {
            return false;
        }
        last.at = at;
        self.sampled(at);
        true
    }

    /// Stores the metrics of the node's process.
    pub(super) fn feel(&mut self, at: Moment, vitals: Vitals) {
        let Lateness { count, late, .. } = vitals.timer;
        self.timers.push_back(Received { at, what: Ended { count, late } });
        // One report from before the interval stays, as the start of the interval.
        while self.timers.get(1).is_some_and(|next| at.saturating_sub(next.at) >= LATELY) {
            self.timers.pop_front();
        }
        self.vitals = Some(Received { at, what: vitals });
    }

    /// How many timers ended within the last seconds.
    pub(super) fn timers_lately(&self) -> Option<Ended> {
        let (first, last) = (self.timers.front()?.what, self.timers.back()?.what);
        let since = |of: fn(&Ended) -> u64| of(&last).saturating_sub(of(&first));
        Some(Ended { count: since(|ended| ended.count), late: since(|ended| ended.late) })
    }

    pub(super) fn look_at(&mut self, at: Moment, detail: Detail) {
        let told = detail.ports.into_iter().map(|port| {
            let what = Watched { task: port.task, port: port.port, age_us: port.age_us, queue: port.queue };
            Received { at, what }
        });
        self.watched = told.collect();
    }

    pub(super) fn compare_clocks(&mut self, at: Moment, pong: Pong) {
        let now = micros(at);
        let Some(trip) = now.checked_sub(pong.echo_us) else { return };
        let middle = i128::from(pong.echo_us) + i128::from(trip / 2);
        let Ok(us) = i64::try_from(i128::from(pong.mono_us) - middle) else { return };
        self.clock = Some(ClockOffset { us, error_us: trip.div_ceil(2), at });
    }

    /// Stores a snapshot. Rates compare it with a snapshot that is between [`RATE`] and twice [`RATE`] older.
    pub(super) fn take(&mut self, at: Moment, snapshot: Snapshot) {
        self.last = Some(Sample { at, snapshot: Arc::new(snapshot) });
        self.sampled(at);
    }

    /// Updates the longest remaining time of each timer.
    fn note_timers(&mut self) {
        let Some(last) = &self.last else { return };
        for timer in &last.snapshot.timers {
            if self.longest.len() < TIMERS || self.longest.contains_key(&(timer.owner, timer.id)) {
                let longest = self.longest.entry((timer.owner, timer.id)).or_default();
                *longest = (*longest).max(timer.remaining);
            }
        }
    }

    /// Handles a new state in `last`: it becomes the next `base` when that is due.
    fn sampled(&mut self, at: Moment) {
        self.note_timers();
        if let Some(last) = &self.last {
            self.recent.sampled(at, &last.snapshot, self.tick_us);
        }
        let due = self.next_base.as_ref().is_none_or(|next| at.saturating_sub(next.at) >= RATE);
        if due {
            self.base = std::mem::replace(&mut self.next_base, self.last.clone());
            self.lost_before = (self.lost_before.1, self.lost);
        }
        self.base = self.base.take().or_else(|| self.next_base.clone());
    }
}
