//! One life of one node: from its start to its death, and what it last said.

use super::health::Looked;
use super::names::Names;
use crate::clock::{Moment, Span, micros};
use crate::name::Name;
use imrs_protocol::{NodeId, PortCounters, PortId, PortView, QueueView, TaskId, Ticks, TimeId};
use imrs_wire::obs::{
    Count, Delta, Detail, HeldBack, Lateness, Liveness, Pong, Snapshot, TaskSnapshot, Vitals,
};
use std::collections::{BTreeMap, VecDeque};
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

/// A life that says nothing for so long is shown as silent.
pub const SILENT: Duration = Duration::from_secs(1);
/// A remaining time that was sampled longer ago than this is shown as an estimate.
const FRESH: Duration = Duration::from_millis(200);
/// Rates are taken over at least so long.
pub(super) const RATE: Duration = Duration::from_secs(2);

/// Over how long it is reckoned whether timers are late as a rule.
const LATELY: Duration = Duration::from_secs(3);

/// How many timers of one node are remembered.
const TIMERS: usize = 1024;

/// A life of a node, for as long as the monitor runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LifeId(pub u32);

/// Whether a node is still there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Condition {
    /// The monitor is attached to it.
    Attached,
    /// The connection ended without a word.
    Dead {
        /// When.
        since: Moment,
        /// How the monitor noticed.
        why: String,
    },
    /// It said that it stops.
    Stopped {
        /// When.
        since: Moment,
    },
}

/// How a node looks at one moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Presence {
    /// It speaks.
    Up,
    /// It is attached, but has said nothing for so long.
    Silent(Duration),
    /// It stopped in order, so long ago.
    Stopped(Duration),
    /// It is gone, for so long.
    Dead(Duration),
}

impl Presence {
    /// Whether the node is known to be no more.
    #[must_use]
    pub const fn is_gone(self) -> bool {
        matches!(self, Self::Stopped(_) | Self::Dead(_))
    }
}

impl fmt::Display for Presence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Up => f.write_str("up"),
            Self::Silent(since) => write!(f, "SILENT for {}", Whole(*since)),
            Self::Stopped(since) => write!(f, "stopped {} ago", Whole(*since)),
            Self::Dead(since) => write!(f, "DEAD {} ago", Whole(*since)),
        }
    }
}

/// A duration without fractions of a second.
struct Whole(Duration);

impl fmt::Display for Whole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let seconds = self.0.as_secs();
        if seconds < 60 {
            write!(f, "{seconds}s")
        } else {
            write!(f, "{}", Span(Duration::from_secs(seconds)))
        }
    }
}

/// A remaining time, counted on from when it was sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Left {
    /// Microseconds; zero: it has ended, as far as is known.
    pub us: u64,
    /// Whether the sample is so old that the truth may differ.
    pub estimated: bool,
}

impl fmt::Display for Left {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mark = if self.estimated { "~" } else { "" };
        f.pad(&format!("{mark}{}", Span::micros(self.us)))
    }
}

/// A snapshot and when it came.
#[derive(Clone, Debug)]
pub struct Sample {
    /// When it came.
    pub at: Moment,
    /// What it says.
    pub snapshot: Arc<Snapshot>,
}

/// Something that a node said, and when it came.
#[derive(Clone, Debug)]
pub struct Told<T> {
    /// When it came.
    pub at: Moment,
    /// What.
    pub what: T,
}

/// A queue that is watched.
#[derive(Clone, Debug)]
pub struct Watched {
    /// The task that receives.
    pub task: TaskId,
    /// The port.
    pub port: PortId,
    /// How old the times in it were when it came, in microseconds.
    pub age_us: u64,
    /// What waits there, and what it has been through.
    pub queue: QueueView,
}

/// How a node's clock goes beside the monitor's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockOffset {
    /// The node's clock when the monitor's was zero, in microseconds.
    pub us: i64,
    /// How far off that can be: half the round trip.
    pub error_us: u64,
    /// When they were compared.
    pub at: Moment,
}

/// Timers that have ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Ended {
    /// How many.
    pub count: u64,
    /// How many of them later than the tick.
    pub late: u64,
}

/// What is compared with what comes next.
pub(super) struct Notable {
    pub tasks: Vec<(TaskId, Liveness)>,
    pub link_discards: Vec<Count>,
}

/// A port of a task. They are ascending, as nodes send them; what is not found so is searched for.
pub(super) fn port_of(task: &TaskSnapshot, id: PortId) -> Option<&PortView> {
    let ports = &task.view.ports;
    let found = ports.binary_search_by_key(&id, |port| port.port).ok().and_then(|at| ports.get(at));
    found.or_else(|| ports.iter().find(|port| port.port == id))
}

/// One life of one node.
#[derive(Clone, Debug)]
pub struct Life {
    /// Which.
    pub id: LifeId,
    /// The node's name.
    pub node: Name,
    /// The node's place in the cell.
    pub node_id: NodeId,
    /// Which of the node's lives, as it says.
    pub incarnation: u8,
    /// Its process.
    pub pid: u32,
    /// Its program.
    pub build: Name,
    /// The digest of its cell.
    pub digest: u32,
    /// Microseconds per tick.
    pub tick_us: u64,
    /// Whether it is still there.
    pub condition: Condition,
    /// When it last said anything.
    pub heard: Moment,
    /// The names of its cell.
    pub names: Arc<Names>,
    /// What it said last.
    pub last: Option<Sample>,
    /// What it said some seconds ago: rates and growth are against this.
    pub base: Option<Sample>,
    /// What will be `base` next.
    pub(super) next_base: Option<Sample>,
    /// Events that it could not keep for this monitor.
    pub lost: u64,
    /// The same, as it was at `base` and will be at the next one.
    pub(super) lost_before: (u64, u64),
    /// The longest that each timer was ever seen to have left: nothing says how long it was armed for.
    pub(super) longest: BTreeMap<(TaskId, TimeId), Ticks>,
    /// How its process does; `None` before it told, and of a node that does not tell.
    pub vitals: Option<Told<Vitals>>,
    /// Which scripts are held back, as it told last.
    pub(super) held_back: Option<Told<HeldBack>>,
    /// How many timers had ended, and how many of them late, as it told in the last seconds.
    pub(super) timers: VecDeque<Told<Ended>>,
    /// The queues that are watched.
    pub watched: Vec<Told<Watched>>,
    /// How its clock goes, as compared last.
    pub clock: Option<ClockOffset>,
    /// What is wrong with its tasks, if that was looked for since it last said something.
    pub(super) looked: Looked,
}

impl Life {
    /// How it looks now.
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

    /// Its tasks as it last said.
    #[must_use]
    pub fn tasks(&self) -> &[TaskSnapshot] {
        self.last.as_ref().map_or(&[], |s| &s.snapshot.tasks)
    }

    /// One of its tasks.
    #[must_use]
    pub fn task(&self, id: TaskId) -> Option<&TaskSnapshot> {
        self.tasks().iter().find(|t| t.view.task == id)
    }

    /// One port of one of its tasks.
    #[must_use]
    pub fn port(&self, task: TaskId, port: PortId) -> Option<&PortView> {
        port_of(self.task(task)?, port)
    }

    /// What is left now of a time that was `remaining` when its task last advanced, `age_us` before the snapshot.
    /// In a dead node time stands still: its last state is shown as it was.
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

    /// What was left, in microseconds, when the node took the snapshot: `age_us` after its task last advanced.
    #[must_use]
    pub const fn left_when_seen(&self, remaining: Ticks, age_us: u64) -> u64 {
        remaining.0.saturating_mul(self.tick_us).saturating_sub(age_us)
    }

    /// Messages per second that a port's task sent and took, lately.
    #[must_use]
    pub fn rate(&self, task: TaskId, port: PortId) -> Option<f64> {
        let task = self.task(task)?;
        let port = task.view.ports.iter().find(|p| p.port == port)?;
        self.rate_of(self.earlier(task), port)
    }

    /// A task as it was some seconds ago.
    #[must_use]
    pub fn earlier(&self, task: &TaskSnapshot) -> Option<&TaskSnapshot> {
        self.base.as_ref()?.snapshot.tasks.iter().find(|t| t.view.task == task.view.task)
    }

    /// Messages per second at a port, against the task as it was.
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

    /// Events that it could not keep for this monitor, lately.
    #[must_use]
    pub const fn lost_lately(&self) -> u64 {
        self.lost.saturating_sub(self.lost_before.0)
    }

    /// How long a timer seems to be armed for, in microseconds: the most that was ever seen left of it.
    #[must_use]
    pub fn longest_timer(&self, task: TaskId, id: TimeId) -> Option<u64> {
        self.longest.get(&(task, id)).map(|ticks| ticks.0.saturating_mul(self.tick_us))
    }

    /// A queue that is watched, with what each message has been through, if the node told.
    #[must_use]
    pub fn watched(&self, task: TaskId, port: PortId) -> Option<&Told<Watched>> {
        self.watched.iter().find(|told| (told.what.task, told.what.port) == (task, port))
    }

    /// The tasks whose scripts a restarted node holds back, and for how long from now on, in microseconds. In a dead node time
    /// stands still.
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

    /// For how long from now on a script of the node is held back, in microseconds, if one is.
    #[must_use]
    pub fn longest_held_back(&self, now: Moment) -> Option<u64> {
        self.held_back(now).map(|(_, us)| us).max()
    }

    /// For how long from now on the script of a task is held back, in microseconds, if it is.
    #[must_use]
    pub fn task_held_back(&self, task: TaskId, now: Moment) -> Option<u64> {
        self.held_back(now).find(|(held, _)| *held == task).map(|(_, us)| us)
    }

    /// About how much memory its states take, in bytes.
    pub(super) fn weight(&self) -> usize {
        let samples = [&self.last, &self.base, &self.next_base];
        let port = |port: &PortView| size_of::<PortView>() + size_of_val(port.queue.as_slice());
        let tasks = |sample: &Sample| -> usize {
            let ports = sample.snapshot.tasks.iter().flat_map(|task| &task.view.ports);
            ports.map(port).sum::<usize>() + size_of_val(sample.snapshot.tasks.as_slice())
        };
        // Those that are one and the same are counted as often as they are kept.
        samples.into_iter().flatten().map(tasks).sum()
    }

    /// What will be compared with the next state.
    pub(super) fn notable(&self) -> Option<Notable> {
        let snapshot = &self.last.as_ref()?.snapshot;
        let tasks = snapshot.tasks.iter().map(|task| (task.view.task, task.liveness)).collect();
        Some(Notable { tasks, link_discards: snapshot.link_discards.clone() })
    }

    /// Takes over what changed. False: not of what it said last.
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
        // Looked at before it is copied, where it is shared with an earlier sample.
        if delta.base_us != Some(last.snapshot.mono_us)
            || Arc::make_mut(&mut last.snapshot).apply(delta).is_err()
        {
            return false;
        }
        last.at = at;
        self.sampled(at);
        true
    }

    /// Takes over how its process does.
    pub(super) fn feel(&mut self, at: Moment, vitals: Vitals) {
        let Lateness { count, late, .. } = vitals.timer;
        self.timers.push_back(Told { at, what: Ended { count, late } });
        // One of them is as old as the time that is looked at, or all are younger.
        while self.timers.get(1).is_some_and(|next| at.saturating_sub(next.at) >= LATELY) {
            self.timers.pop_front();
        }
        self.vitals = Some(Told { at, what: vitals });
    }

    /// The timers that ended in the last seconds.
    pub(super) fn timers_lately(&self) -> Option<Ended> {
        let (first, last) = (self.timers.front()?.what, self.timers.back()?.what);
        let since = |of: fn(&Ended) -> u64| of(&last).saturating_sub(of(&first));
        Some(Ended { count: since(|ended| ended.count), late: since(|ended| ended.late) })
    }

    pub(super) fn look_at(&mut self, at: Moment, detail: Detail) {
        let told = detail.ports.into_iter().map(|port| {
            let what = Watched { task: port.task, port: port.port, age_us: port.age_us, queue: port.queue };
            Told { at, what }
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

    /// Takes a snapshot over; counters are compared with one that is [`RATE`] to twice that older.
    pub(super) fn take(&mut self, at: Moment, snapshot: Snapshot) {
        self.last = Some(Sample { at, snapshot: Arc::new(snapshot) });
        self.sampled(at);
    }

    /// Remembers how long timers are, as far as it was seen.
    fn note_timers(&mut self) {
        let Some(last) = &self.last else { return };
        for timer in &last.snapshot.timers {
            if self.longest.len() < TIMERS || self.longest.contains_key(&(timer.owner, timer.id)) {
                let longest = self.longest.entry((timer.owner, timer.id)).or_default();
                *longest = (*longest).max(timer.remaining);
            }
        }
    }

    /// There is a new `last`: keeps it for comparison, when it is time.
    fn sampled(&mut self, at: Moment) {
        self.note_timers();
        let due = self.next_base.as_ref().is_none_or(|next| at.saturating_sub(next.at) >= RATE);
        if due {
            self.base = std::mem::replace(&mut self.next_base, self.last.clone());
            self.lost_before = (self.lost_before.1, self.lost);
        }
        if self.base.is_none() {
            self.base = self.next_base.clone();
        }
    }
}
