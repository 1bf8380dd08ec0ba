//! A forger without the keys of the cell, who can do anything else: record and hold back datagrams, send under any
//! address, and run another cell with the same nodes.

use super::scene::{ENDS, SILENT, Scene};
use crate::link::udp::keyed::rig::packet;
use crate::lock::lock;
use imrs_protocol::{Incarnation, Kind, NodeId, Packet};
use imrs_wire::envelope::keyed::{Handshake, HandshakeBytes, Step};
use imrs_wire::envelope::{
    COUNTER_END, Datagram, Digests, Echo, Envelope, Greeting, Purpose, Refused, Session, without_packets,
};
use std::net::SocketAddr;

/// The number of kinds of forged datagrams.
const KINDS: u64 = 15;
/// Where a datagram has the receiver's index of the session, the counter, the kind, and the nonce of a handshake.
const INDEX_AT: std::ops::Range<usize> = 4..8;
const COUNTER_AT: std::ops::Range<usize> = 8..15;
const KIND_AT: usize = 15;
const NONCE_AT: std::ops::Range<usize> = 16..32;

/// How many of the first datagrams make the first session.
const HANDSHAKE: usize = 6;

/// A forged datagram: the node for which it is, the address from which it seems to come, and its bytes.
pub type Forged = (usize, Option<SocketAddr>, Vec<u8>);

pub struct Forger {
    pub random: fastrand::Rng,
    /// The nodes of the forger's own cell, which talk with each other.
    own: Scene,
    /// The recordings of an earlier start of the attacked nodes, and of the forger's cell.
    earlier: Vec<(usize, Vec<u8>)>,
    others: Vec<(usize, Vec<u8>)>,
}

impl Forger {
    pub fn new(own: Scene, earlier: Vec<(usize, Vec<u8>)>, others: Vec<(usize, Vec<u8>)>) -> Self {
        Self { random: fastrand::Rng::with_seed(3), own, earlier, others }
    }

    /// Makes the next forged datagram, one kind after another.
    pub fn datagram(&mut self, number: u64, at: &Scene) -> Forged {
        let me = self.random.usize(..2);
        let (to, mut bytes) = self.recorded(at);
        let next = || lock(&at.links[1 - me].peers[0].outgoing).counter;
        let kind = number % KINDS;
        let (to, bytes) = match kind {
            // A recorded datagram: repeated unchanged to its receiver, or reflected to its sender.
            0 => (to, bytes),
            1 => (1 - to, bytes),
            // A recorded datagram with the next counter, or with the greatest possible counter.
            2 | 3 => {
                let counter = if kind == 2 { next() + self.random.u64(..3) } else { COUNTER_END - 1 };
                bytes[COUNTER_AT].copy_from_slice(&counter.to_le_bytes()[..7]);
                (me, bytes)
            }
            // A recorded datagram with another kind, node or index, with one bit changed, or with another length.
            4 => {
                bytes[self.random.usize(2..16)] = self.random.u8(..);
                (me, bytes)
            }
            5 | 6 => {
                let at = self.random.usize(..bytes.len());
                bytes[at] ^= 1 << self.random.u8(..8);
                (me, bytes)
            }
            7 => {
                bytes.truncate(self.random.usize(..bytes.len()));
                (me, bytes)
            }
            // A datagram that the neighbour never sent, closed with the keys of the forger's cell.
            8..=10 => (me, self.closed(me, at)),
            // The same without keys: with the right digests, and perhaps the right session.
            11 => (me, self.plain(me, at)),
            // A datagram of a handshake that an attempt of this node awaits, or a request.
            12 | 13 => (me, self.handshake(me, at)),
            _ => (me, (0..self.random.usize(..200)).map(|_| self.random.u8(..)).collect()),
        };
        let from = match self.random.u8(..4) {
            0 => None,
            1 => Some(at.silent_address()),
            _ => Some(at.address_of_other(to)),
        };
        (to, from, bytes)
    }

    fn recorded(&mut self, at: &Scene) -> (usize, Vec<u8>) {
        let from = [&at.recorded, &at.recorded, &self.earlier, &self.others][self.random.usize(..4)];
        // The first datagrams are those of the handshake.
        let count = if self.random.u8(..4) == 0 { HANDSHAKE } else { from.len() };
        from[self.random.usize(..count)].clone()
    }

    /// An envelope that is wrong in one way: the next incarnation, a clock far ahead, an echo of an instant that
    /// never was, the last possible counter, or a goodbye.
    fn envelope(&mut self, to: usize, at: &Scene) -> Envelope {
        let clocks = [0, 5, 1 << 40, u64::MAX];
        let next = lock(&at.links[1 - to].peers[0].outgoing).counter;
        let (of_sender, of_receiver) = (at.links[1 - to].session, at.links[to].session);
        let session = if self.random.bool() { of_sender } else { Session(self.random.u64(..)) };
        let greeting = Greeting {
            wants_answer: self.random.bool(),
            uncounted: self.random.bool(),
            remembers: self.random.bool().then(|| Incarnation(self.random.u8(..))),
        };
        let purposes = [
            Purpose::Packets,
            Purpose::Greeting(greeting),
            Purpose::Goodbye,
            Purpose::Refusal(Refused::OtherCell),
        ];
        Envelope {
            sender: if self.random.u8(..4) == 0 { SILENT } else { ENDS[1 - to] },
            receiver: ENDS[to],
            incarnation: Incarnation(1 + self.random.u8(..3)),
            restarted: self.random.bool(),
            session,
            counter: [next, next + 1, COUNTER_END - 1][self.random.usize(..3)],
            tx_mono: clocks[self.random.usize(..4)],
            echo: self
                .random
                .bool()
                .then(|| Echo { session: of_receiver, mono: clocks[self.random.usize(..4)] }),
            purpose: purposes[self.random.usize(..4)],
        }
    }

    /// A datagram with this envelope, not sealed yet. Its packet would release the members of a rendezvous, or is the
    /// packet that the neighbour would send next.
    fn filled(&mut self, to: usize, envelope: &Envelope, at: &Scene) -> Datagram {
        let mut datagram = Datagram::default();
        if envelope.purpose == Purpose::Packets {
            let genuine = packet(1 - to, to, at.sent[1 - to] + 1);
            let confirm = Packet { kind: Kind::Confirm, ..genuine };
            let packet = if self.random.bool() { confirm } else { genuine };
            let table = &at.links[to].table;
            let hash = table.port(packet.port).expect("a port").hash;
            datagram.push(&packet.encode(table.digest(), hash));
        }
        datagram
    }

    fn closed(&mut self, to: usize, at: &Scene) -> Vec<u8> {
        let envelope = self.envelope(to, at);
        let mut datagram = self.filled(to, &envelope, at);
        let live =
            lock(&self.own.links[1 - to].peers[0].channel).as_ref().and_then(|own| own.sending().cloned());
        live.expect("a session").seal(&mut datagram, &envelope).unwrap();
        let mut bytes = datagram.sealed().to_vec();
        bytes[INDEX_AT].copy_from_slice(&self.index(to, at).to_le_bytes());
        bytes
    }

    /// The index that a node has given one of the two sessions. The forger has read it, because it is not encrypted.
    fn index(&mut self, to: usize, at: &Scene) -> u32 {
        let is_of_session = |(of, bytes): &&(usize, Vec<u8>)| *of == to && bytes[KIND_AT] == 0;
        let (_, seen) = at.recorded.iter().rfind(is_of_session).expect("a datagram");
        let used = u32::from_le_bytes(seen[INDEX_AT].try_into().expect("four bytes"));
        if self.random.bool() { used } else { at.pending.1[to] }
    }

    fn plain(&mut self, to: usize, at: &Scene) -> Vec<u8> {
        let envelope = self.envelope(to, at);
        let digests = Digests { statements: self.random.u32(..2), ..at.links[to].digests() };
        if envelope.purpose != Purpose::Packets {
            return without_packets(&envelope, digests).to_vec();
        }
        self.filled(to, &envelope, at).seal(&envelope, digests).to_vec()
    }

    fn handshake(&mut self, to: usize, at: &Scene) -> Vec<u8> {
        let (cookie, noise) = (self.random.u128(..).to_le_bytes(), [self.random.u8(..); 56]);
        let [initiator, responder] = if self.random.bool() { at.pending.1 } else { [0; 2] };
        let digests = at.links[to].digests();
        let step = match self.random.u8(..5) {
            0 => Step::Hello(digests),
            1 => Step::Cookie(cookie),
            2 => Step::Initiation { cookie, index: initiator, noise: &noise },
            3 => Step::Response { initiator, responder, noise: &noise },
            _ => Step::Refusal { digests, reason: self.random.u8(..8) },
        };
        let (_, of_other) = self.recorded(at);
        let (sender, seen): (NodeId, &[u8]) = match self.random.u8(..3) {
            0 => (SILENT, &at.asked[to]),
            1 => (ENDS[1 - to], &at.pending.0),
            _ => (ENDS[1 - to], &of_other),
        };
        let nonce = seen.get(NONCE_AT).and_then(|nonce| nonce.try_into().ok()).unwrap_or_default();
        let forged = Handshake { sender, receiver: ENDS[to], nonce, step };
        HandshakeBytes::new(&forged, |_| cookie).to_vec()
    }
}
