//! The journal: an event log in bounded memory, newest entry last. Events that repeat within a window share one entry,
//! so that a flood does not push other events off the screen.

use super::NodeIncarnation;
use super::names::Names;
use crate::clock::Moment;
use crate::name::Name;
use crate::query::{EventRow, Filter};
use imrs_protocol::{Event, Observation, Reason, TaskId};
use std::collections::{BTreeMap, VecDeque};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;
use std::time::Duration;

/// How many entries of each of the three kinds the journal keeps.
pub const KEPT: usize = 4096;
/// A notable event that repeats within this time of its last occurrence shares that occurrence's entry.
pub const WINDOW: Duration = Duration::from_secs(10);

/// The severity of an entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Severity {
    /// Routine traffic.
    Trace,
    /// An event that is worth an entry.
    Note,
    /// A message or event was lost or late.
    Warn,
    /// A robot waits until its time_out, or a node or task died.
    Bad,
}

/// The event of a journal entry.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum What {
    /// An event that a state machine observed.
    Observed {
        /// The task of the state machine; `None` for the transit buffer.
        task: Option<TaskId>,
        /// The observation.
        observation: Observation,
    },
    /// An event that the monitor noticed.
    Noticed {
        /// The severity of the event.
        level: Severity,
        /// The kind of event, in one word.
        kind: &'static str,
        /// The name of the affected node, task or link.
        object: String,
        /// Details about the event, as text.
        detail: String,
    },
}

/// An entry of the journal.
#[derive(Clone, Debug)]
pub struct Entry {
    /// The number of the entry among all entries; the journal assigns it.
    pub number: u64,
    /// The moment of the event's first occurrence.
    pub first: Moment,
    /// The moment of the event's last occurrence.
    pub at: Moment,
    /// The node at which the event occurred.
    pub node: Name,
    /// The names that belong to the ids in the event.
    pub names: Arc<Names>,
    /// The event that the entry is about.
    pub what: What,
    /// How often the event occurred.
    pub times: u64,
}

impl Entry {
    /// An event at a node that occurred `times` times at `at`.
    #[must_use]
    pub fn new(at: Moment, incarnation: &NodeIncarnation, what: What, times: u64) -> Self {
        let (node, names) = (incarnation.node.clone(), Arc::clone(&incarnation.names));
        Self { number: 0, first: at, at, node, names, what, times }
    }

    /// How often the event occurred, as text: empty if once, otherwise `x37`; if the occurrences span a second or more,
    /// with the rate, `x37 12/s`.
    #[must_use]
    pub fn count(&self) -> String {
        let seconds = self.at.saturating_sub(self.first).as_secs_f64();
        #[expect(clippy::cast_precision_loss, reason = "a rate for people")]
        let rate = self.times as f64 / seconds;
        match self.times {
            0 | 1 => String::new(),
            times if seconds < 1.0 => format!("x{times}"),
            times if rate < 10.0 => format!("x{times} {rate:.1}/s"),
            times => format!("x{times} {rate:.0}/s"),
        }
    }

    /// The severity of the event.
    #[must_use]
    pub const fn level(&self) -> Severity {
        match &self.what {
            What::Observed { observation, .. } => level_of(observation.event),
            What::Noticed { level, .. } => *level,
        }
    }

    /// The observation and its task; `None` for an event that the monitor noticed.
    #[must_use]
    pub const fn observed(&self) -> Option<(Option<TaskId>, &Observation)> {
        match &self.what {
            What::Observed { task, observation } => Some((*task, observation)),
            What::Noticed { .. } => None,
        }
    }

    /// The kind of event, in one word.
    #[must_use]
    pub const fn kind(&self) -> &'static str {
        match &self.what {
            What::Observed { observation, .. } => word(observation.event),
            What::Noticed { kind, .. } => kind,
        }
    }

    /// The name of the affected node, task or link.
    #[must_use]
    pub fn object(&self) -> String {
        match &self.what {
            What::Observed { task, observation } => {
                let port = self.names.port_name(observation.port);
                match task {
                    Some(task) => format!("{port} at {}", self.names.task(*task)),
                    None => format!("{port} in transit"),
                }
            }
            What::Noticed { object, .. } => object.clone(),
        }
    }

    /// Details about the event, as text.
    #[must_use]
    pub fn detail(&self) -> String {
        match &self.what {
            What::Observed { observation: o, .. } => {
                let peer = self.names.task(o.peer);
                let number = o.number;
                match o.event {
                    Event::Reached | Event::Rejoined | Event::ReleasedComplete | Event::WithinMargin => {
                        format!("round {number}")
                    }
                    Event::GaveUp => format!("round {number}, not all arrived in time"),
                    Event::ReleasedByConfirm
                    | Event::PartnerArrived
                    | Event::PartnerAborted
                    | Event::Confirmed => {
                        format!("round {number}, {peer}")
                    }
                    Event::Discarded(reason) => format!("{} (with {peer}, #{number})", reason.name()),
                    _ => format!("with {peer}, #{number}"),
                }
            }
            What::Noticed { detail, .. } => detail.clone(),
        }
    }

    /// Whether the entry contains `text`, which must be lower case.
    #[must_use]
    pub fn mentions(&self, text: &str) -> bool {
        let has = |part: &str| part.to_lowercase().contains(text);
        has(self.kind()) || has(self.node.shown()) || has(&self.object()) || has(&self.detail())
    }

    /// The fields that are equal in two entries if one repeats the other.
    fn subject(&self) -> impl PartialEq + Hash + use<'_> {
        let (observed, noticed) = match &self.what {
            What::Observed { task, observation: o } => (Some((task, o.event, o.port, o.peer)), None),
            What::Noticed { level, kind, object, detail } => (None, Some((level, kind, object, detail))),
        };
        (&self.node, observed, noticed)
    }

    fn repeats(&self, other: &Self) -> bool {
        self.subject() == other.subject()
    }

    /// A number that is the same for entries of one subject, and seldom for others.
    fn digest(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        self.subject().hash(&mut hasher);
        hasher.finish()
    }

    /// Whether the event may share an entry. Observations of a task and losses may. The start or end of a node or task
    /// may not, because their order matters.
    fn folds(&self) -> bool {
        matches!(&self.what, What::Observed { .. } | What::Noticed { kind: "discard" | "lost", .. })
    }
}

pub(crate) const fn level_of(event: Event) -> Severity {
    match event {
        Event::Sent
        | Event::Resent
        | Event::Enqueued
        | Event::Delivered
        | Event::Replied
        | Event::Answered
        | Event::Reached
        | Event::PartnerArrived
        | Event::Confirmed
        | Event::Interrupted
        | Event::Resumed
        | Event::Rejected
        | Event::Granted => Severity::Trace,
        Event::Rejoined | Event::ReleasedComplete | Event::ReleasedByConfirm => Severity::Trace,
        // Tasks send copies against losses, so dropping a duplicate is routine.
        Event::Discarded(Reason::Duplicate | Reason::OldRound | Reason::Superseded) => Severity::Trace,
        Event::Discarded(_) | Event::RefusedByPeer | Event::PartnerAborted | Event::WithinMargin => {
            Severity::Warn
        }
        Event::TimedOut
        | Event::TimedOutUnsent
        | Event::PeerRestarted
        | Event::GaveUp
        | Event::TookOver
        | Event::Fenced => Severity::Bad,
    }
}

pub(crate) const fn word(event: Event) -> &'static str {
    match event {
        Event::Sent => "sent",
        Event::Resent => "resent",
        Event::Enqueued => "enqueued",
        Event::Delivered => "delivered",
        Event::Replied => "replied",
        Event::Answered => "answered",
        Event::RefusedByPeer => "refused",
        Event::TimedOut => "timed out",
        Event::TimedOutUnsent => "unsent",
        Event::PeerRestarted => "restarted",
        Event::Discarded(_) => "discard",
        Event::Reached => "reached",
        Event::Rejoined => "rejoined",
        Event::PartnerArrived => "arrived",
        Event::PartnerAborted => "aborted",
        Event::Confirmed => "confirmed",
        Event::ReleasedComplete | Event::ReleasedByConfirm => "released",
        Event::WithinMargin => "margin",
        Event::GaveUp => "gave up",
        Event::Rejected => "rejected",
        Event::Interrupted => "interrupted",
        Event::Resumed => "resumed",
        Event::Granted => "granted",
        Event::TookOver => "took over",
        Event::Fenced => "fenced",
    }
}

/// The event log. Critical entries, other notable entries and routine traffic have separate queues, so that no entry
/// displaces a more severe one.
#[derive(Clone, Debug, Default)]
pub struct Journal {
    bad: VecDeque<Entry>,
    notable: VecDeque<Entry>,
    trace: VecDeque<Entry>,
    /// For the digest of each subject of `bad` and `notable`, the number of its newest entry.
    newest: BTreeMap<u64, u64>,
    /// How many entries were added so far.
    ever: u64,
}

impl Journal {
    /// Adds an entry, or increases the count of an earlier entry that it repeats. Routine traffic can only repeat the
    /// entry just before it, because its order matters.
    pub fn add(&mut self, entry: Entry) {
        let lines = match entry.level() {
            Severity::Trace => &mut self.trace,
            Severity::Note | Severity::Warn => &mut self.notable,
            Severity::Bad => &mut self.bad,
        };
        let (folds, is_routine) = (entry.folds(), entry.level() == Severity::Trace);
        let digest = (folds && !is_routine).then(|| entry.digest());
        let earlier = match digest {
            Some(digest) => self.newest.get(&digest).and_then(|&number| {
                let at = lines.binary_search_by_key(&number, |entry| entry.number).ok()?;
                lines.get_mut(at)
            }),
            None if folds => lines.back_mut(),
            None => None,
        };
        let recent = |earlier: &Entry| entry.at.saturating_sub(earlier.at) <= WINDOW;
        if let Some(same) = earlier.filter(|earlier| recent(earlier) && earlier.repeats(&entry)) {
            let times = same.times.saturating_add(entry.times);
            *same = Entry { times, number: same.number, first: same.first, ..entry };
            return;
        }
        if lines.len() == KEPT
            && let Some(oldest) = lines.pop_front()
            && !is_routine
            && let digest = oldest.digest()
            && self.newest.get(&digest) == Some(&oldest.number)
        {
            self.newest.remove(&digest);
        }
        self.newest.extend(digest.map(|digest| (digest, self.ever)));
        lines.push_back(Entry { number: self.ever, ..entry });
        self.ever += 1;
    }

    /// The entries that match `text` (a condition, or words), in the order of their first occurrence: all entries, or
    /// only the notable ones.
    #[must_use]
    pub fn lines(&self, all: bool, text: &str) -> Vec<&Entry> {
        let now = [&self.bad, &self.notable, &self.trace].into_iter().flatten().map(|e| e.at).max();
        let now = now.unwrap_or_default();
        let filter = Filter::lenient(text);
        let fits = |entry: &&Entry| filter.as_ref().is_none_or(|f| f.takes(&EventRow { entry, now }));
        let trace = self.trace.iter().filter(|_| all);
        let mut lines: Vec<&Entry> = self.bad.iter().chain(&self.notable).chain(trace).filter(fits).collect();
        lines.sort_by_key(|e| e.number);
        lines
    }

    /// The notable entries from number `from` on, in the order of their first occurrence.
    #[must_use]
    pub fn since(&self, from: u64) -> Vec<&Entry> {
        let mut lines: Vec<_> = self.bad.iter().chain(&self.notable).filter(|e| e.number >= from).collect();
        lines.sort_by_key(|e| e.number);
        lines
    }

    /// The approximate memory of the entries, in bytes.
    #[must_use]
    pub fn weight(&self) -> usize {
        (self.bad.len() + self.notable.len() + self.trace.len()) * size_of::<Entry>()
            + self.newest.len() * size_of::<(u64, u64)>()
    }

    /// The number of the next entry.
    #[must_use]
    pub const fn next_number(&self) -> u64 {
        self.ever
    }
}
