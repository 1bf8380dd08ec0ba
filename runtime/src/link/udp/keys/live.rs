//! One session with keys: it closes and opens the datagrams between one start of this node and one start of a neighbour.

use crate::link::LinkDiscard;
use crate::lock::lock;
use imrs_wire::envelope::keyed::{self, Bound};
use imrs_wire::envelope::{Datagram, Envelope, Opened, ReplayWindow};
use snow::StatelessTransportState;
use std::fmt;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// The age at which the initiator of a session replaces it, in microseconds.
const REPLACE_AFTER: u64 = 3_600_000_000;
/// How much longer the responder of a session waits before it replaces the session itself, in microseconds.
const PATIENCE: u64 = 60_000_000;
/// The number of datagrams after which a session is replaced.
const REPLACE_AFTER_DATAGRAMS: u64 = 1 << 32;

/// A session whose keys both nodes can have.
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
    /// Whether the neighbour is known to have the keys of the session.
    pub(super) confirmed: AtomicBool,
    /// The counter of the first datagram that this node closed with the session; `u64::MAX` before that datagram.
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
    /// A session whose handshake was finished at the instant `born`. The initiator then knows that the responder has
    /// the keys.
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
            confirmed: AtomicBool::new(is_initiator),
            first: AtomicU64::new(u64::MAX),
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

    #[cfg(test)]
    pub(super) fn state(&self) -> (bool, ReplayWindow) {
        (self.confirmed.load(Ordering::Acquire), lock(&self.window).clone())
    }

    /// Whether it is time to replace the session, if the next datagram has this counter.
    pub(super) fn is_old(&self, now: u64, counter: u64) -> bool {
        let after = if self.is_initiator { REPLACE_AFTER } else { REPLACE_AFTER + PATIENCE };
        let first = self.first.load(Ordering::Relaxed);
        now.saturating_sub(self.born) >= after || counter.saturating_sub(first) >= REPLACE_AFTER_DATAGRAMS
    }
}
