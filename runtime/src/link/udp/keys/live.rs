//! One session with keys: it encrypts (closes) and decrypts (opens) the datagrams between one start of this
//! node and one start of a neighbour.

use crate::link::LinkDiscard;
use crate::lock::lock;
use imrs_wire::envelope::keyed::{self, Bound};
use imrs_wire::envelope::{Datagram, Envelope, Opened, ReplayWindow};
use snow::StatelessTransportState;
use std::fmt;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// The age at which the initiator of a session replaces it, in microseconds.
pub(super) const REPLACE_AFTER: u64 = 3_600_000_000;
/// How much longer than the initiator the responder waits before it replaces the session itself, in microseconds.
const PATIENCE: u64 = 60_000_000;
/// The number of datagrams after which a session is replaced.
const REPLACE_AFTER_DATAGRAMS: u64 = 1 << 32;
/// If the neighbour has sent nothing in a session for this long (in microseconds), the node that asked for the
/// session replaces it.
const ANSWERED_WITHIN: u64 = 10_000_000;
/// The value of an instant or a counter for something that has not happened.
const NEVER: u64 = u64::MAX;

/// A session: both nodes can compute its keys.
pub(in crate::link::udp) struct Live {
    /// The indices of the session: this node's, and the neighbour's.
    pub(super) index: u32,
    theirs: u32,
    /// The properties that each datagram of the neighbour must have in this session.
    pub(super) bound: Bound,
    transport: StatelessTransportState,
    window: Mutex<ReplayWindow>,
    is_initiator: bool,
    /// When the session was made.
    pub(super) born: u64,
    /// When the first datagram of the neighbour was opened with this session; [`NEVER`] before.
    heard: AtomicU64,
    /// The counter of the first datagram that this node closed with this session; [`NEVER`] before.
    first: AtomicU64,
}

impl fmt::Debug for Live {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Live")
            .field("index", &self.index)
            .field("theirs", &self.theirs)
            .finish_non_exhaustive()
    }
}

impl Live {
    /// A session whose handshake was finished at `born`.
    pub(super) fn new(
        (index, theirs): (u32, u32),
        bound: Bound,
        transport: StatelessTransportState,
        born: u64,
    ) -> Self {
        let is_initiator = transport.is_initiator();
        Self {
            index,
            theirs,
            bound,
            transport,
            window: Mutex::default(),
            is_initiator,
            born,
            heard: AtomicU64::new(NEVER),
            first: AtomicU64::new(NEVER),
        }
    }

    /// Closes a datagram. Each counter may be used only once in all sessions with a neighbour, because it is the nonce.
    ///
    /// # Errors
    /// If the datagram is longer than the greatest length.
    pub(in crate::link::udp) fn seal(
        &self,
        datagram: &mut Datagram,
        envelope: &Envelope,
    ) -> Result<(), snow::Error> {
        self.first.fetch_min(envelope.counter, Ordering::Relaxed);
        let close =
            |plain: &[u8], closed: &mut [u8]| self.transport.write_message(envelope.counter, plain, closed);
        datagram.seal_keyed(envelope, self.theirs, close).map(|_| ())
    }

    /// Opens a datagram into `room`, and records its counter. Nothing changes before the tag is verified.
    ///
    /// # Errors
    /// [`LinkDiscard::Replayed`], [`LinkDiscard::Forged`], or the reason for which the content is invalid.
    pub(in crate::link::udp) fn open<'a>(
        &self,
        counter: u64,
        closed: &[u8],
        room: &'a mut [u8],
    ) -> Result<Opened<'a>, LinkDiscard> {
        if !lock(&self.window).is_new(counter) {
            return Err(LinkDiscard::Replayed);
        }
        let length = self.transport.read_message(counter, closed, room).map_err(|_| LinkDiscard::Forged)?;
        // Another thread may have opened a copy of the datagram since the first check of the counter.
        if !lock(&self.window).accept(counter) {
            return Err(LinkDiscard::Replayed);
        }
        Ok(keyed::open(&room[..length], counter, &self.bound)?)
    }

    /// When the neighbour first sent in this session, and the window of received counters.
    #[cfg(test)]
    pub(super) fn state(&self) -> (u64, ReplayWindow) {
        (self.heard.load(Ordering::Acquire), lock(&self.window).clone())
    }

    /// Notes that the neighbour has sent a datagram in this session. Returns whether this is the first one.
    pub(super) fn hear(&self, now: u64) -> bool {
        self.heard.compare_exchange(NEVER, now, Ordering::AcqRel, Ordering::Acquire).is_ok()
    }

    /// When the first datagram of the neighbour in this session came; `None` before.
    pub(super) fn heard(&self) -> Option<u64> {
        Some(self.heard.load(Ordering::Acquire)).filter(|&at| at != NEVER)
    }

    /// Whether the neighbour is known to have the keys of this session. The node that asked for the session
    /// knows this from the response.
    pub(super) fn is_confirmed(&self) -> bool {
        self.is_initiator || self.heard().is_some()
    }

    /// Whether this node asked for this session, and the neighbour may not know yet that the session was
    /// made.
    pub(super) fn is_unanswered(&self) -> bool {
        self.is_initiator && self.heard().is_none()
    }

    /// The numbers of this session's handshake at this node and at the neighbour: each node counts the
    /// handshakes in which it took part since its start.
    const fn numbers(&self) -> (u16, u16) {
        (self.index as u16, self.theirs as u16)
    }

    /// Whether this session's handshake was later, by this node's own count, than that of `other`.
    pub(super) fn is_begun_after(&self, other: &Self) -> bool {
        is_later(self.numbers().0, other.numbers().0)
    }

    /// Whether this session counts as made after `other`, which is between the same starts of both nodes. If both
    /// nodes ask for a session at once, each counts its own handshake first, so their own counts disagree on which
    /// session is newer. But the sum of both nodes' numbers is the same at both nodes, and a session that is later
    /// for both nodes has the greater sum.
    pub(super) fn is_after(&self, other: &Self) -> bool {
        let sum = |(own, theirs): (u16, u16)| own.wrapping_add(theirs);
        let of_lower = |live: &Self| {
            let (own, theirs) = live.numbers();
            if live.bound.receiver.0 < live.bound.sender.0 { own } else { theirs }
        };
        let (one, two) = (sum(self.numbers()), sum(other.numbers()));
        if one == two { is_later(of_lower(self), of_lower(other)) } else { is_later(one, two) }
    }

    /// Whether to replace the session before the datagram with this counter is sent. The initiator replaces a session
    /// of the age `after`.
    pub(super) fn is_old(&self, now: u64, counter: u64, after: u64) -> bool {
        let after = if self.is_initiator { after } else { after + PATIENCE };
        let first = self.first.load(Ordering::Relaxed);
        let after = if self.is_unanswered() { ANSWERED_WITHIN } else { after };
        now.saturating_sub(self.born) >= after || counter.saturating_sub(first) >= REPLACE_AFTER_DATAGRAMS
    }
}

/// Whether a number is later than another one; numbers wrap around.
const fn is_later(number: u16, than: u16) -> bool {
    number.wrapping_sub(than).cast_signed() > 0
}
