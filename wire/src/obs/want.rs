//! What a monitor wants to see, since version 1.1.

use imrs_protocol::{Event, PortId, TaskId};
use serde::{Deserialize, Serialize};

/// How much a monitor wants to see. Takes the place of [`Subscribe`](super::Subscribe): whoever says this is told what
/// changed ([`Delta`](super::Delta)), the first time all. Nothing here can change a node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Want {
    /// Microseconds between snapshots or what changed. A node may take longer; it never takes less than 10 ms.
    pub period_us: u32,
    /// How many waiting messages of each port a snapshot lists; at most 64 are.
    pub queue_limit: u8,
    /// The ports that are watched: all their waiting messages, and a [`Detail`](super::Detail) in each period. At most
    /// [`MAX_WATCHED`](super::MAX_WATCHED) are.
    pub watched: Vec<(TaskId, PortId)>,
    /// Which events are wanted, if any.
    pub events: Option<EventFilter>,
    /// Microseconds between [`Vitals`](super::Vitals); zero: none.
    pub vitals_us: u32,
    /// Microseconds between whole snapshots; zero: only the first one, and those that are asked for.
    pub whole_us: u32,
    /// How many frames the node may send before it needs a [`ClientFrame::Credit`](super::ClientFrame::Credit).
    pub credit: u16,
}

/// Which events are wanted. Of other tasks none is counted as lost; of what is lost of these tasks the kind is not known,
/// so all of it is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EventFilter {
    /// Of these kinds.
    pub kinds: Kinds,
    /// Of these tasks; empty: of all, and of the transit buffer.
    pub tasks: Vec<TaskId>,
}

impl EventFilter {
    /// All events.
    pub const ALL: Self = Self { kinds: Kinds::ALL, tasks: Vec::new() };

    /// Whether an event of this task (`None`: of the transit buffer) is wanted.
    #[must_use]
    pub fn wants(&self, task: Option<TaskId>, event: Event) -> bool {
        self.kinds.has(event) && self.of(task)
    }

    /// Whether any event of this task is wanted.
    #[must_use]
    pub fn of(&self, task: Option<TaskId>) -> bool {
        self.tasks.is_empty() || task.is_some_and(|task| self.tasks.contains(&task))
    }
}

/// A set of kinds of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Kinds(u64);

impl Kinds {
    /// Every kind, those of later versions included.
    pub const ALL: Self = Self(u64::MAX);
    /// None.
    pub const NONE: Self = Self(0);

    /// This set and the kind of `event`; of a drop, whatever its reason.
    #[must_use]
    pub const fn and(self, event: Event) -> Self {
        Self(self.0 | 1 << place(event))
    }

    /// Whether it has the kind of `event`.
    #[must_use]
    pub const fn has(self, event: Event) -> bool {
        self.0 & (1 << place(event)) != 0
    }
}

/// The bit of an event's kind: its place in the encoding, which no version changes.
const fn place(event: Event) -> u32 {
    match event {
        Event::Sent => 0,
        Event::Resent => 1,
        Event::Enqueued => 2,
        Event::Delivered => 3,
        Event::Replied => 4,
        Event::Answered => 5,
        Event::RefusedByPeer => 6,
        Event::TimedOut => 7,
        Event::TimedOutUnsent => 8,
        Event::PeerRestarted => 9,
        Event::Discarded(_) => 10,
        Event::Reached => 11,
        Event::Rejoined => 12,
        Event::PartnerArrived => 13,
        Event::PartnerAborted => 14,
        Event::Confirmed => 15,
        Event::ReleasedComplete => 16,
        Event::ReleasedByConfirm => 17,
        Event::WithinMargin => 18,
        Event::GaveUp => 19,
        Event::Rejected => 20,
        Event::Interrupted => 21,
        Event::Resumed => 22,
        Event::Granted => 23,
        Event::TookOver => 24,
        Event::Fenced => 25,
    }
}

/// Asks for the node's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ping {
    /// The monitor's own clock, in microseconds: comes back as it is.
    pub mono_us: u64,
}

/// The longest token, in bytes.
pub const MAX_TOKEN: usize = 256;

/// What lets a monitor look at a node that asks for it. It crosses the network as it is: whoever can read the network can
/// read it, and everything that is watched, too. A tunnel keeps others out.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Token(Vec<u8>);

/// A text that can be no token.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a token has from 16 to {MAX_TOKEN} bytes")]
pub struct TokenError;

impl Token {
    /// The token of a file: its text, without the white space around it.
    ///
    /// # Errors
    /// [`TokenError`] where it is too short to keep anybody out, or too long for a frame.
    pub fn of(text: &str) -> Result<Self, TokenError> {
        let text = text.trim();
        let fits = (16..=MAX_TOKEN).contains(&text.len());
        if fits { Ok(Self(text.into())) } else { Err(TokenError) }
    }

    /// Whether this is the token that `other` is, found out in a time that does not tell where they differ.
    #[must_use]
    pub fn is(&self, other: &Self) -> bool {
        let differ = (0..self.0.len().max(other.0.len())).fold(0, |differ, at| {
            let (ours, theirs) = (self.0.get(at).copied(), other.0.get(at).copied());
            differ | (ours.unwrap_or(0) ^ theirs.unwrap_or(0)) | u8::from(ours.is_none() != theirs.is_none())
        });
        std::hint::black_box(differ) == 0
    }
}

/// Never shows what it is.
impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token(..)")
    }
}
