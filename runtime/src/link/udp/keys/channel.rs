//! The sessions of a node with one neighbour, and how they are made.

use super::live::REPLACE_AFTER;
use super::sessions::Sessions;
use super::{KEY_BYTES, Live, NoRandom, NodeKeys, SecretKey, is_tag, primitives, tag};
use crate::link::LinkDiscard;
use imrs_protocol::NodeId;
use imrs_wire::envelope::keyed::{
    Bound, Handshake, HandshakeBytes, NOISE_BYTES, NONCE_BYTES, Step, TAG_BYTES,
};
use imrs_wire::envelope::{Digests, Refused, Session};
use snow::HandshakeState;
use std::collections::VecDeque;
use std::sync::Arc;

/// How long the first attempt at a session may take, in microseconds. Each further attempt may take twice as long as
/// the one before.
const RETRY: u64 = 50_000;
/// The longest time that an attempt at a session may take, in microseconds.
const LONGEST_RETRY: u64 = 1_600_000;
/// This many first datagrams under another cell's key, without one under this cell's key, mean that the keys differ.
/// The attempts of a neighbour bring as many within 150 ms.
const HINTS: u8 = 3;
/// The length of a span, in microseconds. A cookie is valid in the span in which it was made, and in the next one.
const COOKIE_SPAN: u64 = 10_000_000;
/// How many answered initiations are kept at most, so that a copy of an initiation gets the same answer.
const ANSWERED: usize = 64;

type Nonce = [u8; NONCE_BYTES];

/// Makes sessions with one neighbour, and keeps them.
pub(in crate::link::udp) struct Channel {
    keys: NodeKeys,
    /// This node, and the neighbour.
    me: NodeId,
    peer: NodeId,
    /// The neighbour's public key.
    public: [u8; KEY_BYTES],
    /// Identifies this start of this node.
    session: Session,
    digests: Digests,
    /// The key that closes datagrams of handshakes.
    closing: SecretKey,
    /// The key that makes cookies, drawn anew at each start of the node.
    cookies: SecretKey,
    /// The upper half of each session index that this node gives.
    place: u16,
    /// The lower half of the last session index. The first one is random, so that an index of an earlier
    /// start is most likely no index of this start.
    pub(super) indices: u16,
    pub(super) sessions: Sessions,
    /// The age at which this node replaces a session that it asked for, in microseconds.
    pub(in crate::link::udp) replace_after: u64,
    pub(super) making: Option<Making>,
    /// When the current attempt at a session began, and how long it may take, in microseconds.
    pub(super) tried: Option<(u64, u64)>,
    /// When the neighbour was last greeted again, and how long after that the next greeting is due, in microseconds.
    pub(super) greeted: Option<(u64, u64)>,
    /// How many first datagrams of handshakes came under another cell's key since the last one under this cell's key.
    strange: u8,
    pub(super) answered: VecDeque<(Nonce, HandshakeBytes)>,
}

/// An attempt at a session that this node has begun.
pub(super) struct Making {
    pub(super) nonce: Nonce,
    /// The Noise handshake and the index of the session, once the neighbour's cookie has arrived.
    pub(super) noise: Option<(Box<HandshakeState>, u32)>,
}

/// The effect of a datagram of a handshake.
#[derive(Debug, PartialEq, Eq)]
pub(in crate::link::udp) enum Answer {
    /// The datagram has no effect: it is a copy, or belongs to an earlier attempt.
    Nothing,
    /// This datagram must be sent to the neighbour.
    Send(HandshakeBytes),
    /// A session was made. The neighbour uses it once it has received a datagram under the session's keys.
    Made,
    /// The two nodes cannot communicate. `here` is true if this node says so, false if the neighbour does. `reply` must
    /// be sent to the neighbour.
    Refused { why: Refused, theirs: Digests, here: bool, reply: Option<HandshakeBytes> },
}

impl Channel {
    /// Makes the channel of node `me` to its neighbour `peer`. `session` is this start of `me`, and `place` a number
    /// that no other neighbour of `me` has. Returns `None` if `keys` lacks the neighbour's public key.
    ///
    /// # Errors
    /// [`NoRandom`].
    pub(in crate::link::udp) fn new(
        keys: &NodeKeys,
        (me, peer): (NodeId, NodeId),
        session: Session,
        digests: Digests,
        place: u16,
    ) -> Result<Option<Self>, NoRandom> {
        let Some(&public) = keys.0.publics.get(&peer) else { return Ok(None) };
        let mut indices = [0; 2];
        getrandom::fill(&mut indices).map_err(|_| NoRandom)?;
        let mut closing = SecretKey::default();
        let halves = closing.as_chunks_mut::<TAG_BYTES>().0;
        for (half, label) in halves.iter_mut().zip([&b"imrs handshake 0"[..], b"imrs handshake 1"]) {
            *half = tag(&keys.0.cell, &[label]);
        }
        Ok(Some(Self {
            keys: keys.clone(),
            me,
            peer,
            public,
            session,
            digests,
            closing,
            cookies: super::draw_cell_key()?,
            place,
            indices: u16::from_le_bytes(indices),
            sessions: Sessions::new(),
            replace_after: REPLACE_AFTER,
            making: None,
            tried: None,
            greeted: None,
            strange: 0,
            answered: VecDeque::with_capacity(ANSWERED),
        }))
    }

    /// The session whose keys encrypt the datagrams that this node sends: the newest session whose keys the neighbour
    /// has, too.
    pub(in crate::link::udp) fn sending(&self) -> Option<&Arc<Live>> {
        self.sessions.sending()
    }

    /// The session with this index.
    pub(in crate::link::udp) fn find(&self, index: u32) -> Option<&Arc<Live>> {
        self.sessions.iter().find(|live| live.index == index)
    }

    /// Whether a session is still one of this channel's.
    pub(in crate::link::udp) fn has(&self, live: &Arc<Live>) -> bool {
        self.sessions.has(live)
    }

    /// Notes that the neighbour has sent a datagram in this session. Returns whether this is the first one.
    pub(in crate::link::udp) fn confirm(&mut self, live: &Arc<Live>, now: u64) -> bool {
        let is_news = self.sessions.confirm(live, now);
        if is_news {
            self.tried = None;
        }
        is_news
    }

    /// Whether the neighbour may not have the session in which this node sends: no datagram of the neighbour in it
    /// has come.
    pub(in crate::link::udp) fn is_unanswered(&self) -> bool {
        self.sending().is_some_and(|live| live.is_unanswered())
    }

    /// Whether it is time to greet the neighbour again, because it may not know of the session.
    pub(in crate::link::udp) fn greets_again(&mut self, now: u64) -> bool {
        let Some(live) = self.sending().filter(|live| live.is_unanswered()) else { return false };
        let (at, within) = self.greeted.unwrap_or((live.born, RETRY));
        let is_due = now.saturating_sub(at) >= within;
        if is_due {
            self.greeted = Some((now, (within * 2).min(LONGEST_RETRY)));
        }
        is_due
    }

    /// Whether a new session should be made before the datagram with this counter is sent.
    pub(in crate::link::udp) fn wants(&mut self, now: u64, counter: u64) -> bool {
        self.sessions.retire(now);
        self.sending().is_none_or(|live| live.is_old(now, counter, self.replace_after))
    }

    /// The request of the current attempt once more, so that it can be sent again. The attempt goes on.
    pub(in crate::link::udp) fn hello_again(&self) -> Option<HandshakeBytes> {
        self.making.as_ref().map(|making| self.close(making.nonce, Step::Hello(self.digests)))
    }

    /// Begins an attempt at a session, unless one is running. Returns its first datagram.
    pub(in crate::link::udp) fn knock(&mut self, now: u64) -> Option<HandshakeBytes> {
        let within = match self.tried {
            Some((at, within)) if now.saturating_sub(at) < within => return None,
            Some((_, within)) => (within * 2).min(LONGEST_RETRY),
            None => RETRY,
        };
        let mut nonce = Nonce::default();
        getrandom::fill(&mut nonce).ok()?;
        self.tried = Some((now, within));
        self.making = Some(Making { nonce, noise: None });
        Some(self.close(nonce, Step::Hello(self.digests)))
    }

    /// Handles a datagram of a handshake: `bytes` is the datagram, `said` its content.
    ///
    /// # Errors
    /// [`LinkDiscard::OtherKeys`] if other keys closed the datagram, [`LinkDiscard::StaleSession`] if it belongs to no
    /// session or attempt of this node. Then nothing has changed.
    pub(in crate::link::udp) fn heard(
        &mut self,
        bytes: &[u8],
        said: &Handshake<'_>,
        now: u64,
    ) -> Result<Answer, LinkDiscard> {
        if !self.is_closed(bytes) {
            return self.unclosed(said);
        }
        self.strange = 0;
        let awaited = self.making.as_ref().is_some_and(|making| making.nonce == said.nonce);
        match said.step {
            Step::Hello(theirs) => Ok(self.hello(said.nonce, theirs, now)),
            Step::Initiation { cookie, index, noise } => {
                self.initiation((said.nonce, cookie), (index, noise), now)
            }
            _ if !awaited => Err(LinkDiscard::StaleSession),
            Step::Cookie(cookie) => self.cookie(cookie),
            Step::Response { initiator, responder, noise } => {
                self.response((initiator, responder), noise, now)
            }
            Step::Refusal { digests, reason } => {
                let why = Refused::of(reason).ok_or(LinkDiscard::Purpose)?;
                Ok(Answer::Refused { why, theirs: digests, here: false, reply: None })
            }
        }
    }

    /// Handles a datagram under another cell's key. It proves nothing, and the network may have damaged it. Several
    /// of them, while there is no session, are a hint for the users.
    fn unclosed(&mut self, said: &Handshake<'_>) -> Result<Answer, LinkDiscard> {
        let other_keys = Refused::OtherKeys as u8;
        let awaited = self.making.as_ref().is_some_and(|making| making.nonce == said.nonce);
        let (theirs, here, reply) = match said.step {
            Step::Hello(theirs) => (theirs, true, Some(self.refusal(said.nonce, Refused::OtherKeys))),
            Step::Refusal { digests, reason } if reason == other_keys && awaited => (digests, false, None),
            _ => return Err(LinkDiscard::OtherKeys),
        };
        self.strange = self.strange.saturating_add(here.into());
        if self.sending().is_some() || here && self.strange < HINTS {
            return Err(LinkDiscard::OtherKeys);
        }
        Ok(Answer::Refused { why: Refused::OtherKeys, theirs, here, reply })
    }

    fn hello(&self, nonce: Nonce, theirs: Digests, now: u64) -> Answer {
        let why = match theirs {
            _ if theirs.cell != self.digests.cell => Refused::OtherCell,
            _ if theirs != self.digests => Refused::OtherStatements,
            _ => {
                return Answer::Send(
                    self.close(nonce, Step::Cookie(self.cookie_of(nonce, now / COOKIE_SPAN))),
                );
            }
        };
        Answer::Refused { why, theirs, here: true, reply: Some(self.refusal(nonce, why)) }
    }

    fn cookie(&mut self, cookie: Nonce) -> Result<Answer, LinkDiscard> {
        let Some(Making { nonce, noise: None }) = self.making else { return Ok(Answer::Nothing) };
        let index = self.next_index();
        let mut noise = self.noise((self.me, self.peer), |noise| noise.build_initiator())?;
        let first = self.write(&mut noise)?;
        self.making = Some(Making { nonce, noise: Some((Box::new(noise), index)) });
        Ok(Answer::Send(self.close(nonce, Step::Initiation { cookie, index, noise: &first })))
    }

    fn initiation(
        &mut self,
        (nonce, cookie): (Nonce, Nonce),
        (theirs, first): (u32, &[u8; NOISE_BYTES]),
        now: u64,
    ) -> Result<Answer, LinkDiscard> {
        let span = now / COOKIE_SPAN;
        let is_one = |span: u64| is_tag(&self.cookies, &[&nonce, &span.to_le_bytes()], &cookie);
        if !is_one(span) && !span.checked_sub(1).is_some_and(is_one) {
            return Err(LinkDiscard::StaleSession);
        }
        if let Some((_, answer)) = self.answered.iter().find(|(answered, _)| *answered == nonce) {
            return Ok(Answer::Send(answer.clone()));
        }
        let mut noise = self.noise((self.peer, self.me), |noise| noise.build_responder())?;
        let Ok(started) = read(&mut noise, first) else {
            // The datagram is authenticated with the right key of the cell, but the key of a node is wrong.
            let (why, reply) = (Refused::OtherKeys, Some(self.refusal(nonce, Refused::OtherKeys)));
            return Ok(Answer::Refused { why, theirs: self.digests, here: true, reply });
        };
        let second = self.write(&mut noise)?;
        let index = self.next_index();
        self.enter(noise, (index, theirs), started, now)?;
        let step = Step::Response { initiator: theirs, responder: index, noise: &second };
        let answer = self.close(nonce, step);
        if self.answered.len() == ANSWERED {
            self.answered.pop_front();
        }
        self.answered.push_back((nonce, answer.clone()));
        Ok(Answer::Send(answer))
    }

    fn response(
        &mut self,
        (initiator, responder): (u32, u32),
        second: &[u8; NOISE_BYTES],
        now: u64,
    ) -> Result<Answer, LinkDiscard> {
        let is_awaited = self
            .making
            .as_ref()
            .and_then(|making| making.noise.as_ref())
            .is_some_and(|(_, index)| *index == initiator);
        let Some((mut noise, index)) = self.making.take_if(|_| is_awaited).and_then(|making| making.noise)
        else {
            return Err(LinkDiscard::StaleSession);
        };
        let started = read(&mut noise, second).map_err(|_| LinkDiscard::OtherKeys)?;
        self.enter(*noise, (index, responder), started, now)?;
        (self.tried, self.greeted) = (None, None);
        Ok(Answer::Made)
    }

    /// Stores a new session with the start `started` of the neighbour.
    fn enter(
        &mut self,
        noise: HandshakeState,
        indices: (u32, u32),
        started: Session,
        now: u64,
    ) -> Result<(), LinkDiscard> {
        let bound =
            Bound { digests: self.digests, sender: (self.peer, started), receiver: (self.me, self.session) };
        let transport = noise.into_stateless_transport_mode().map_err(|_| LinkDiscard::OtherKeys)?;
        self.sessions.add(Live::new(indices, bound, transport, now));
        Ok(())
    }

    /// Makes a Noise handshake of the two nodes; `initiator` and responder are given in this order.
    fn noise(
        &self,
        (initiator, responder): (NodeId, NodeId),
        build: impl FnOnce(snow::Builder<'_>) -> Result<HandshakeState, snow::Error>,
    ) -> Result<HandshakeState, LinkDiscard> {
        let mut prologue = *b"imrs\x01_________ii_rr";
        prologue[5..9].copy_from_slice(&self.digests.cell.to_le_bytes());
        prologue[9..13].copy_from_slice(&self.digests.statements.to_le_bytes());
        prologue[14..16].copy_from_slice(&initiator.0.to_le_bytes());
        prologue[17..19].copy_from_slice(&responder.0.to_le_bytes());
        let secrets = &self.keys.0;
        let made = || {
            let builder = primitives::builder()?
                .prologue(&prologue)?
                .local_private_key(&*secrets.private)?
                .remote_public_key(&self.public)?
                .psk(0, &secrets.cell)?;
            build(builder)
        };
        made().map_err(|_: snow::Error| LinkDiscard::OtherKeys)
    }

    /// Writes the next Noise message, which carries the session number of this node's start.
    fn write(&self, noise: &mut HandshakeState) -> Result<[u8; NOISE_BYTES], LinkDiscard> {
        let mut message = [0; NOISE_BYTES];
        let written = noise.write_message(&self.session.0.to_le_bytes(), &mut message);
        written.map_err(|_| LinkDiscard::OtherKeys)?;
        Ok(message)
    }

    fn next_index(&mut self) -> u32 {
        self.indices = self.indices.wrapping_add(1);
        u32::from(self.place) << 16 | u32::from(self.indices)
    }

    fn cookie_of(&self, nonce: Nonce, span: u64) -> Nonce {
        tag(&self.cookies, &[&nonce, &span.to_le_bytes()])
    }

    fn refusal(&self, nonce: Nonce, why: Refused) -> HandshakeBytes {
        self.close(nonce, Step::Refusal { digests: self.digests, reason: why as u8 })
    }

    fn close(&self, nonce: Nonce, step: Step<'_>) -> HandshakeBytes {
        let of = Handshake { sender: self.me, receiver: self.peer, nonce, step };
        HandshakeBytes::new(&of, |bytes| tag(&self.closing, &[bytes]))
    }

    fn is_closed(&self, bytes: &[u8]) -> bool {
        bytes.split_last_chunk().is_some_and(|(bytes, closed)| is_tag(&self.closing, &[bytes], closed))
    }
}

/// Reads a Noise message. Returns the session number of the neighbour's start.
fn read(noise: &mut HandshakeState, message: &[u8; NOISE_BYTES]) -> Result<Session, snow::Error> {
    let mut started = [0; NOISE_BYTES];
    noise.read_message(message, &mut started)?;
    let [a, b, c, d, e, f, g, h, ..] = started;
    Ok(Session(u64::from_le_bytes([a, b, c, d, e, f, g, h])))
}
