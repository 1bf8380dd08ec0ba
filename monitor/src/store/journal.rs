//! The journal: an event log in bounded memory, newest entry last. Repeated events share one entry.

use super::names::Names;
use crate::clock::Moment;
use crate::name::Name;
use crate::query::{EventRow, Filter};
use imrs_protocol::{Event, Observation, Reason, TaskId};
use std::collections::VecDeque;
use std::sync::Arc;

/// How many entries are kept of each of the two kinds.
pub const KEPT: usize = 4096;

/// The severity of an entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Severity {
    /// Routine traffic.
    Trace,
    /// Worth an entry.
    Note,
    /// Something was lost or late.
    Warn,
    /// A robot waits until its time_out, or a node or task died.
    Bad,
}

/// The event of an entry.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum What {
    /// A state machine observed it.
    Observed {
        /// The task; `None` for the transit buffer.
        task: Option<TaskId>,
        /// The observation.
        observation: Observation,
    },
    /// The monitor noticed it.
    Noticed {
        /// The severity.
        level: Severity,
        /// The kind, in one word.
        kind: &'static str,
        /// The affected object.
        object: String,
        /// Details.
        detail: String,
    },
}

/// An entry of the journal.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Its number among all entries; the journal assigns it.
    pub number: u64,
    /// The moment of its last occurrence.
    pub at: Moment,
    /// The node.
    pub node: Name,
    /// The names of its ids.
    pub names: Arc<Names>,
    /// The event.
    pub what: What,
    /// How often it occurred in a row.
    pub times: u64,
}

impl Entry {
    /// Its severity.
    #[must_use]
    pub const fn level(&self) -> Severity {
        match &self.what {
            What::Observed { observation, .. } => level_of(observation.event),
            What::Noticed { level, .. } => *level,
        }
    }

    /// The observation and its task; `None` for an entry that the monitor noticed.
    #[must_use]
    pub const fn observed(&self) -> Option<(Option<TaskId>, &Observation)> {
        match &self.what {
            What::Observed { task, observation } => Some((*task, observation)),
            What::Noticed { .. } => None,
        }
    }

    /// Its kind, in one word.
    #[must_use]
    pub const fn kind(&self) -> &'static str {
        match &self.what {
            What::Observed { observation, .. } => word(observation.event),
            What::Noticed { kind, .. } => kind,
        }
    }

    /// The affected object.
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

    /// The details.
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

    fn repeats(&self, other: &Self) -> bool {
        let same = match (&self.what, &other.what) {
            (What::Observed { task, observation: a }, What::Observed { task: other, observation: b }) => {
                task == other && (a.event, a.port, a.peer) == (b.event, b.port, b.peer)
            }
            (a, b) => a == b,
        };
        same && self.node == other.node
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
        // The protocol repeats copies against losses, so dropping a duplicate is routine.
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

/// The event log. Notable entries and routine traffic have separate queues, so that traffic cannot displace notable entries.
#[derive(Clone, Debug, Default)]
pub struct Journal {
    notable: VecDeque<Entry>,
    trace: VecDeque<Entry>,
    /// How many entries were ever added.
    ever: u64,
}

impl Journal {
    /// Adds an entry, or raises the count of the last one of its queue if the entry repeats it.
    pub fn add(&mut self, entry: Entry) {
        let lines = if entry.level() == Severity::Trace { &mut self.trace } else { &mut self.notable };
        if let Some(last) = lines.back_mut().filter(|last| last.repeats(&entry)) {
            *last = Entry { times: last.times.saturating_add(entry.times), number: last.number, ..entry };
            return;
        }
        if lines.len() == KEPT {
            lines.pop_front();
        }
        lines.push_back(Entry { number: self.ever, ..entry });
        self.ever += 1;
    }

    /// The entries that match `text` (a condition, or words), oldest first: only notable ones, or `all`.
    #[must_use]
    pub fn lines(&self, all: bool, text: &str) -> Vec<&Entry> {
        let trace = self.trace.iter().filter(|_| all);
        let now = [&self.notable, &self.trace].into_iter().filter_map(|of| of.back()).map(|e| e.at).max();
        let now = now.unwrap_or_default();
        let filter = Filter::lenient(text);
        let fits = |entry: &&Entry| filter.as_ref().is_none_or(|f| f.takes(&EventRow { entry, now }));
        let mut lines: Vec<&Entry> = self.notable.iter().chain(trace).filter(fits).collect();
        lines.sort_by_key(|e| e.number);
        lines
    }

    /// The notable entries from number `from` on, oldest first.
    pub fn since(&self, from: u64) -> impl Iterator<Item = &Entry> {
        self.notable.iter().filter(move |e| e.number >= from)
    }

    /// The number of the next entry.
    #[must_use]
    pub const fn next_number(&self) -> u64 {
        self.ever
    }
}
