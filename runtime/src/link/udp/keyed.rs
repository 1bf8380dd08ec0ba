//! A link whose datagrams are encrypted with keys (D191): the part of the sessions that needs sockets, clocks and threads.

#[cfg(test)]
mod renewed;
#[cfg(test)]
pub(super) mod rig;

use super::keys::{Answer, Channel, Live, NoRandom, NodeKeys};
use super::peer::{Peer, Route};
use super::session::Known;
use super::statistics::UdpCount;
use super::{UdpError, UdpLink};
use crate::link::residency::Reading;
use crate::link::{LinkBusy, LinkDiscard};
use crate::lock::lock;
use imrs_protocol::NodeId;
use imrs_wire::envelope::keyed::{self, Handshake, Keyed};
use imrs_wire::envelope::{Digests, Envelope, Greeting, Opened, Refused};
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// How often the polling thread checks whether an attempt at a session has failed.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// How a datagram is protected: by a checksum, or by the keys of a session.
pub(super) enum Closing {
    Checksum,
    Keys(Arc<Live>),
}

/// A datagram for this link, decrypted, and the session whose keys encrypted it.
pub(super) type Unlocked<'a> = (Opened<'a>, Option<Arc<Live>>);

impl UdpLink {
    /// Makes the link encrypt every datagram with these keys, and accept no other datagrams. A forged, changed or
    /// repeated datagram then has no effect. Neighbours need keys of the same cell. Call this before the link is
    /// used.
    ///
    /// # Errors
    /// [`UdpError::NoKey`] if `keys` lacks the public key of a neighbour, [`UdpError::NoRandom`] if the
    /// system gives no random numbers.
    pub fn with_keys(mut self, keys: &NodeKeys) -> Result<Self, UdpError> {
        let (digests, session, me) = (self.digests(), self.session, self.table.node);
        for (place, peer) in self.peers.iter_mut().enumerate() {
            let place = u16::try_from(place).unwrap_or(u16::MAX);
            let channel = Channel::new(keys, (me, peer.node), session, digests, place);
            let channel = channel.map_err(|NoRandom| UdpError::NoRandom)?;
            *peer.channel.get_mut().unwrap_or_else(std::sync::PoisonError::into_inner) =
                Some(channel.ok_or(UdpError::NoKey(peer.node))?);
        }
        self.has_keys = true;
        Ok(self)
    }

    /// Whether this link encrypts its datagrams with keys.
    #[must_use]
    pub const fn has_keys(&self) -> bool {
        self.has_keys
    }

    /// How the next datagram to a neighbour is protected: by a checksum or by a session. If the link has keys, and
    /// there is no session or only an old one, the link asks the neighbour for a session. The polling thread repeats
    /// this request.
    ///
    /// # Errors
    /// There is no session yet.
    pub(super) fn closing(&self, peer: &Peer, route: &mut Route, counter: u64) -> Result<Closing, LinkBusy> {
        let closing = self.asked_closing(peer, route, counter);
        if closing.is_none() && !self.knocks.swap(true, Ordering::AcqRel) {
            self.polling.wake().wake();
        }
        closing.ok_or(LinkBusy)
    }

    /// As [`closing`](Self::closing), but the request for a session is not repeated.
    fn asked_closing(&self, peer: &Peer, route: &mut Route, counter: u64) -> Option<Closing> {
        if !self.has_keys {
            return Some(Closing::Checksum);
        }
        let now = self.micros(Instant::now());
        let (session, hello) = {
            let mut channel = lock(&peer.channel);
            let channel = channel.as_mut()?;
            let hello = if channel.wants(now, counter) { channel.knock(now) } else { None };
            (channel.sending().cloned(), hello)
        };
        if let Some(hello) = hello {
            self.statistics.add(UdpCount::HandshakesSent, 1);
            // If this datagram is lost, the polling thread sends it again.
            let _ = self.transmit(&hello, route);
        }
        session.map(Closing::Keys)
    }

    /// Repeats requests for sessions that were not answered, and greetings in new sessions. Returns the instant at
    /// which this is due again; `None` if all were answered. The polling thread calls this.
    pub(super) fn knock(&self) -> Option<Instant> {
        if !self.knocks.swap(false, Ordering::AcqRel) {
            return None;
        }
        let mut is_left = false;
        for peer in &self.peers {
            if let Some(route) = lock(&peer.route).as_mut() {
                is_left |= self.asked_closing(peer, route, 0).is_none();
            }
            is_left |= self.greet_again(peer);
        }
        if is_left {
            self.knocks.store(true, Ordering::Release);
        }
        is_left.then(|| Instant::now() + LOOK_EVERY)
    }

    /// Repeats the greeting in a new session until the neighbour has sent a datagram in it: if the first
    /// greeting was lost, the neighbour does not know of the session. Returns whether the greeting must be
    /// repeated again.
    fn greet_again(&self, peer: &Peer) -> bool {
        let now = self.micros(Instant::now());
        let (waits, is_due) = match &mut *lock(&peer.channel) {
            Some(channel) => (channel.is_unanswered(), channel.greets_again(now)),
            None => return false,
        };
        if is_due {
            let heard = *lock(&peer.heard);
            self.say(peer, Greeting { wants_answer: true, ..Greeting::default() }, heard);
        }
        waits && lock(&peer.route).is_some()
    }

    /// Decrypts the datagram in `bytes` into `room`, if it belongs to a session. Returns `None` if it belongs
    /// to a handshake: then it has been handled completely.
    ///
    /// # Errors
    /// The reason for which the datagram is dropped. Nothing has changed then, except the result of
    /// [`refusals`](Self::refusals).
    pub(super) fn unlock<'a>(
        &self,
        bytes: &[u8],
        room: &'a mut [u8],
    ) -> Result<Option<Unlocked<'a>>, LinkDiscard> {
        let read = keyed::read(bytes).inspect_err(|_| self.hint_at_plain(bytes))?;
        let (index, counter, closed) = match read {
            Keyed::Transport { index, counter, closed } => (index, counter, closed),
            Keyed::Handshake(said) => {
                self.handshake(bytes, &said)?;
                return Ok(None);
            }
        };
        let peer = usize::try_from(index >> 16).ok().and_then(|place| self.peers.get(place));
        let peer = peer.ok_or(LinkDiscard::StaleSession)?;
        let live = lock(&peer.channel).as_ref().and_then(|channel| channel.find(index).cloned());
        let live = live.ok_or(LinkDiscard::StaleSession)?;
        let opened = live.open(counter, closed, room)?;
        let now = self.micros(Instant::now());
        let is_news = lock(&peer.channel).as_mut().is_some_and(|channel| channel.confirm(&live, now));
        if is_news {
            self.session_made();
        }
        Ok(Some((opened, Some(live))))
    }

    fn handshake(&self, bytes: &[u8], said: &Handshake<'_>) -> Result<(), LinkDiscard> {
        let (_, peer) = self.peer(said.sender).ok_or(LinkDiscard::UnknownNode)?;
        if said.receiver != self.table.node {
            return Err(LinkDiscard::Misdelivered);
        }
        let now = self.micros(Instant::now());
        let answer = match &mut *lock(&peer.channel) {
            Some(channel) => channel.heard(bytes, said, now)?,
            None => return Err(LinkDiscard::Mode),
        };
        match answer {
            Answer::Nothing => Ok(()),
            Answer::Send(reply) => {
                if lock(&peer.pace).answers(now) {
                    self.reply(peer, &reply);
                }
                Ok(())
            }
            Answer::Made => {
                self.statistics.add(UdpCount::SessionsMade, 1);
                // The neighbour sends in the new session only after it has received a datagram in it, so a greeting
                // may be needed.
                self.knocks.store(true, Ordering::Release);
                self.session_made();
                let heard = *lock(&peer.heard);
                self.say(peer, Greeting { wants_answer: true, ..Greeting::default() }, heard);
                Ok(())
            }
            Answer::Refused { why, theirs, here, reply } => {
                self.note_refusal(peer, why, theirs, here);
                if let Some(reply) = reply.filter(|_| lock(&peer.pace).refuses(now)) {
                    self.reply(peer, &reply);
                }
                Err(discard(why, here))
            }
        }
    }

    /// Sends a datagram of a handshake to the neighbour's address in the address book, even if the request came from
    /// another address.
    fn reply(&self, peer: &Peer, bytes: &[u8]) {
        if let Some(route) = lock(&peer.route).as_mut() {
            self.statistics.add(UdpCount::HandshakesSent, 1);
            // If this datagram is lost, the neighbour repeats its request.
            let _ = self.transmit(bytes, route);
        }
    }

    /// Notes a new session, so that packets that wait for the neighbour can leave.
    fn session_made(&self) {
        self.address_known.store(true, Ordering::Release);
        self.polling.wake().wake();
    }

    /// With keys: proves that a datagram is later than everything that this node has accepted. The proof is that the
    /// datagram is the first one accepted in its session, and that this session is still valid. The caller holds the
    /// lock of the neighbour's state: otherwise a late datagram of an ended session could replace the current
    /// session.
    pub(super) fn proof(
        &self,
        peer: &Peer,
        known: Option<&Known>,
        envelope: &Envelope,
        by: Option<&Arc<Live>>,
    ) -> Option<u64> {
        let is_new = known.is_none_or(|known| known.session != envelope.session);
        by.filter(|live| is_new && self.still_has(peer, live)).map(|_| u64::MAX)
    }

    /// Whether a session is still valid: it is not if the neighbour has been restarted since.
    fn still_has(&self, peer: &Peer, live: &Arc<Live>) -> bool {
        lock(&peer.channel).as_ref().is_some_and(|channel| channel.has(live))
    }

    /// Records a hint for the users that a node without keys sends to this node, which has keys. There is no hint if
    /// the two nodes have communicated before.
    fn hint_at_plain(&self, bytes: &[u8]) {
        if let Ok(Opened { envelope: Envelope { sender, .. }, digests, .. }) =
            imrs_wire::envelope::read(bytes)
        {
            self.hint_at_mode(sender, digests);
        }
    }

    /// Records a hint for the users that a node with keys sends to this node, which has no keys.
    pub(super) fn hint_at_keys(&self, bytes: &[u8]) {
        if let Ok(Keyed::Handshake(said)) = keyed::read(bytes) {
            self.hint_at_mode(said.sender, self.digests());
        }
    }

    /// Notes that a datagram from the address of a neighbour was dropped for this reason.
    pub(super) fn discarded_of(&self, from: SocketAddr, reason: LinkDiscard, now: &Reading) {
        let is_it = |peer: &&Peer| lock(&peer.route).as_ref().is_some_and(|route| route.address == from);
        let Some(peer) = self.peers.iter().find(is_it) else { return };
        match reason {
            LinkDiscard::Version => self.hint_at_version(peer),
            reason if reason.is_damage() => peer.health.failed(self.micros(now.after), peer.progress()),
            _ => {}
        }
    }

    /// Handles a datagram of another version from a neighbour's address. If this node has talked with that neighbour
    /// before, nothing happens. For the first such datagram otherwise, records a hint for people, and sends the neighbour a
    /// datagram, which shows this node's version. The rest of the received datagram cannot be read.
    fn hint_at_version(&self, peer: &Peer) {
        if peer.met.load(Ordering::Relaxed) {
            return;
        }
        let is_known = lock(&peer.refusal).is_some_and(|refusal| refusal.why == Refused::OtherVersion);
        if is_known {
            return;
        }
        self.note_refusal(peer, Refused::OtherVersion, self.digests(), true);
        // Anybody can forge such a datagram, so it must not end an attempt at a session.
        let again = lock(&peer.channel).as_ref().and_then(Channel::hello_again);
        match again {
            Some(hello) => self.reply(peer, &hello),
            None => self.say(peer, Greeting { wants_answer: true, ..Greeting::default() }, None),
        }
    }

    fn hint_at_mode(&self, sender: NodeId, theirs: Digests) {
        if let Some((_, peer)) = self.peer(sender).filter(|(_, peer)| !peer.met.load(Ordering::Relaxed)) {
            self.note_refusal(peer, Refused::OtherMode, theirs, true);
        }
    }
}

/// The reason under which this node counts a datagram that it refuses, or with which a neighbour refuses.
const fn discard(why: Refused, here: bool) -> LinkDiscard {
    match why {
        _ if !here => LinkDiscard::RefusedByPeer,
        Refused::OtherCell => LinkDiscard::OtherCell,
        Refused::OtherStatements => LinkDiscard::OtherStatements,
        Refused::Misdelivered => LinkDiscard::Misdelivered,
        Refused::OtherKeys => LinkDiscard::OtherKeys,
        Refused::OtherMode => LinkDiscard::Mode,
        Refused::OtherVersion => LinkDiscard::Version,
    }
}
