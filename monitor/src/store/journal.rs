//! What happened, newest last, in bounded memory; what happens again and again takes one line.

use super::names::Names;
use crate::clock::Moment;
use crate::name::Name;
use crate::query::{EventRow, Filter};
use imrs_protocol::{Event, Observation, Reason, TaskId};
use std::collections::VecDeque;
use std::sync::Arc;

/// How many lines are kept of each kind.
pub const KEPT: usize = 4096;

/// How much a line matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Level {
    /// The ordinary course of things.
    Trace,
    /// Worth a line.
    Note,
    /// Something was lost or late.
    Warn,
    /// A robot waits in vain, or somebody died.
    Bad,
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum What {
    /// A machine observed something.
    Observed {
        /// At this task, or in the transit buffer.
        task: Option<TaskId>,
        /// This.
        observation: Observation,
    },
    /// The monitor noticed something.
    Noticed {
        /// How much it matters.
        level: Level,
        /// What kind of thing.
        kind: &'static str,
        /// On what.
        object: String,
        /// Details.
        detail: String,
    },
}

/// A line of the journal.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Its number among all lines; given by the journal.
    pub number: u64,
    /// When it came, the last time.
    pub at: Moment,
    /// On which node.
    pub node: Name,
    /// What its ids mean.
    pub names: Arc<Names>,
    /// What.
    pub what: What,
    /// How often in a row.
    pub times: u64,
}

impl Entry {
    /// How much it matters.
    #[must_use]
    pub const fn level(&self) -> Level {
        match &self.what {
            What::Observed { observation, .. } => level_of(observation.event),
            What::Noticed { level, .. } => *level,
        }
    }

    /// Where a machine observed it, and what; none where the monitor noticed it.
    #[must_use]
    pub const fn observed(&self) -> Option<(Option<TaskId>, &Observation)> {
        match &self.what {
            What::Observed { task, observation } => Some((*task, observation)),
            What::Noticed { .. } => None,
        }
    }

    /// In one word.
    #[must_use]
    pub const fn kind(&self) -> &'static str {
        match &self.what {
            What::Observed { observation, .. } => word(observation.event),
            What::Noticed { kind, .. } => kind,
        }
    }

    /// What it happened to.
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

    /// The rest.
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

    /// Whether `text`, in lower case, occurs in the line.
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

pub(crate) const fn level_of(event: Event) -> Level {
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
        | Event::Granted => Level::Trace,
        Event::Rejoined | Event::ReleasedComplete | Event::ReleasedByConfirm => Level::Trace,
        // Repeated copies are how the protocol bears losses: dropping them is its ordinary course.
        Event::Discarded(Reason::Duplicate | Reason::OldRound | Reason::Superseded) => Level::Trace,
        Event::Discarded(_) | Event::RefusedByPeer | Event::PartnerAborted | Event::WithinMargin => {
            Level::Warn
        }
        Event::TimedOut
        | Event::TimedOutUnsent
        | Event::PeerRestarted
        | Event::GaveUp
        | Event::TookOver
        | Event::Fenced => Level::Bad,
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

/// The lines: those that matter apart from the ordinary course, so that traffic cannot push them out.
#[derive(Clone, Debug, Default)]
pub struct Journal {
    notable: VecDeque<Entry>,
    trace: VecDeque<Entry>,
    /// How many lines there have ever been.
    ever: u64,
}

impl Journal {
    /// Adds a line, or counts it onto the last one of its kind if it only repeats it.
    pub fn add(&mut self, entry: Entry) {
        let lines = if entry.level() == Level::Trace { &mut self.trace } else { &mut self.notable };
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

    /// The lines that `text` asks for (a condition, or words that occur in them), oldest first: those that matter, or `all`.
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

    /// The lines that matter from the number `from` on, oldest first.
    pub fn since(&self, from: u64) -> impl Iterator<Item = &Entry> {
        self.notable.iter().filter(move |e| e.number >= from)
    }

    /// The number that the next line will have.
    #[must_use]
    pub const fn next_number(&self) -> u64 {
        self.ever
    }
}
