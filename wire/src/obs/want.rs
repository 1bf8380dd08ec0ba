//! The subscription of version 1.1: what a monitor wants to see, and the token that allows it to look.

use blake2::digest::consts::U32;
use blake2::digest::{Digest, KeyInit, Mac};
use blake2::{Blake2s256, Blake2sMac};
use imrs_protocol::{Event, PortId, TaskId};
use serde::{Deserialize, Serialize};

/// A monitor's subscription, in place of [`Subscribe`](super::Subscribe). The node answers with deltas
/// ([`Delta`](super::Delta)), the first one whole. No field can change the node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Want {
    /// Microseconds between snapshots or deltas. A node may take longer; values below 10 ms count as 10 ms.
    pub period_us: u32,
    /// How many queued messages of each port a snapshot lists; at most 64.
    pub queue_limit: u8,
    /// The watched ports, at most [`MAX_WATCHED`](super::MAX_WATCHED). The node lists all their queued messages and
    /// sends a [`Detail`](super::Detail) in each period.
    pub watched: Vec<(TaskId, PortId)>,
    /// Which events the node sends; `None` for none.
    pub events: Option<EventFilter>,
    /// Microseconds between [`Vitals`](super::Vitals) frames; zero for none.
    pub vitals_us: u32,
    /// Microseconds between whole snapshots. If zero, only the first snapshot is whole, and those for which the monitor asks.
    pub whole_us: u32,
    /// How many frames the node may send before it needs a [`ClientFrame::Credit`](super::ClientFrame::Credit).
    pub credit: u16,
}

/// A filter of events. Lost events of unselected tasks are not counted. The kind of a lost event is unknown, so all
/// lost events of the selected tasks are counted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EventFilter {
    /// The selected kinds.
    pub kinds: Kinds,
    /// The selected tasks. Empty selects all tasks and the transit buffer.
    pub tasks: Vec<TaskId>,
}

impl EventFilter {
    /// The filter that selects all events.
    pub const ALL: Self = Self { kinds: Kinds::ALL, tasks: Vec::new() };

    /// Whether the filter selects an event of this task (`None` for the transit buffer).
    #[must_use]
    pub fn wants(&self, task: Option<TaskId>, event: Event) -> bool {
        self.kinds.has(event) && self.of(task)
    }

    /// Whether the filter selects any event of this task.
    #[must_use]
    pub fn of(&self, task: Option<TaskId>) -> bool {
        self.tasks.is_empty() || task.is_some_and(|task| self.tasks.contains(&task))
    }
}

/// A set of kinds of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Kinds(u64);

impl Kinds {
    /// Every kind of observation, including the kinds of later versions.
    pub const ALL: Self = Self(u64::MAX);
    /// No kind of event.
    pub const NONE: Self = Self(0);

    /// This set plus the kind of `event`. All drops are one kind, whatever their reason.
    #[must_use]
    pub const fn and(self, event: Event) -> Self {
        Self(self.0 | 1 << place(event))
    }

    /// Whether the set contains the kind of `event`.
    #[must_use]
    pub const fn has(self, event: Event) -> bool {
        self.0 & (1 << place(event)) != 0
    }
}

/// The bit of an event's kind: its variant number in the encoding, which no version changes.
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

/// A request for the node's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ping {
    /// The monitor's own clock, in microseconds; the answer repeats it.
    pub mono_us: u64,
}

/// The longest token, in bytes.
pub const MAX_TOKEN: usize = 256;

/// The shared secret that lets a monitor watch a node. The token itself is not sent: the monitor [proves](Self::proof)
/// that it has the token. But the node's frames are not encrypted: use a tunnel on a network that others can read.
///
/// ```
/// use imrs_wire::obs::{Challenge, Token};
///
/// let token = Token::of("a secret of the cell")?;
/// let challenge = Challenge([7; 32]);
/// assert!(token.is_proven(&challenge, &token.proof(&challenge)));
/// assert!(!token.is_proven(&Challenge([8; 32]), &token.proof(&challenge)));
/// # Ok::<(), imrs_wire::obs::TokenError>(())
/// ```
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Token(Vec<u8>);

/// A text whose length does not fit a token.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a token has from 16 to {MAX_TOKEN} bytes")]
pub struct TokenError;

impl Token {
    /// Makes a token from the text of a file, without surrounding white space.
    ///
    /// # Errors
    /// [`TokenError`] if the text is too short to be hard to guess, or too long for a frame.
    pub fn of(text: &str) -> Result<Self, TokenError> {
        let text = text.trim();
        let fits = (16..=MAX_TOKEN).contains(&text.len());
        if fits { Ok(Self(text.into())) } else { Err(TokenError) }
    }

    /// Makes the proof that this program has the token, for the node that has drawn the challenge.
    #[must_use]
    pub fn proof(&self, challenge: &Challenge) -> Proof {
        Proof(self.hash(challenge).finalize().into_bytes().into())
    }

    /// Whether a proof was made with this token. The check takes as long for a wrong proof.
    #[must_use]
    pub fn is_proven(&self, challenge: &Challenge, proof: &Proof) -> bool {
        self.hash(challenge).verify((&proof.0).into()).is_ok()
    }

    /// A hash of the challenge, keyed with the token.
    fn hash(&self, challenge: &Challenge) -> Blake2sMac<U32> {
        let key = Blake2s256::digest(&self.0);
        let mut hash = <Blake2sMac<U32> as KeyInit>::new(&key);
        hash.update(b"imrs monitor");
        hash.update(&challenge.0);
        hash
    }
}

/// Random bytes that a node has drawn for one connection, to check whether the monitor has the node's token.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Challenge(pub [u8; 32]);

/// A monitor's answer to a [`Challenge`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Proof(pub [u8; 32]);

/// Hides the token, because it is a secret.
impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token(..)")
    }
}
