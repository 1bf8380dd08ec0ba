//! The state that a node keeps for each neighbour with which it communicates over UDP.

use super::delay::DRIFT_PPM;
use super::health::Health;
use super::inbound::Inbound;
use super::integrity::Progress;
use super::keys::Channel;
use super::session::Known;
use super::socket::set_segment;
use crate::lock::lock;
use imrs_protocol::{Incarnation, NodeId, Ticks};
use imrs_wire::envelope::{Datagram, Digests, Echo, Envelope, Refused, Session, supersedes};
use imrs_wire::obs::LinkReport;
use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU16, Ordering};
use std::sync::{Arc, Mutex};

/// One neighbour, with the state that the sending threads share.
pub(super) struct Peer {
    pub(super) node: NodeId,
    /// The declared bound of the link to the neighbour, in microseconds.
    pub(super) declared: Ticks,
    pub(super) route: Mutex<Option<Route>>,
    /// The socket that is connected to the neighbour. It still receives after the neighbour's address became unknown.
    pub(super) inbound: Mutex<Option<Arc<Inbound>>>,
    /// The neighbour's session, as the receiving threads know it. The lock is held while a datagram of the neighbour is
    /// judged and recorded, because two datagrams may arrive at once: one over the neighbour's own socket, and one over
    /// the socket of strangers.
    pub(super) known: Mutex<Option<Known>>,
    /// Whether the kernel's send queue for this neighbour was found full. The neighbour may be unreachable, so this
    /// says nothing about other neighbours.
    pub(super) full: AtomicBool,
    pub(super) outgoing: Mutex<Outgoing>,
    /// The neighbour's clock, as its last datagram showed it.
    pub(super) heard: Mutex<Option<Heard>>,
    /// Whether any datagram of the neighbour was accepted since its address was set.
    pub(super) met: AtomicBool,
    /// Whether the neighbour has said goodbye in its current session.
    pub(super) has_stopped: AtomicBool,
    /// The newest incarnation of the neighbour that was seen in its envelopes, or in packets that other nodes relayed.
    /// [`NOTHING`] before any was seen.
    remembered: AtomicU16,
    /// The incarnation of this node that the neighbour remembers, if any. The outer option is `None` until the
    /// neighbour has answered.
    pub(super) remembers: Mutex<Option<Option<Incarnation>>>,
    /// The last refusal; `None` once a datagram is accepted after it.
    pub(super) refusal: Mutex<Option<Refusal>>,
    /// Whether `refusal` has a value.
    pub(super) is_refused: AtomicBool,
    pub(super) pace: Mutex<Pace>,
    pub(super) health: Health,
    /// The sessions with keys, if the link has keys. This lock is taken last, and never held while a datagram is sent
    /// or received.
    pub(super) channel: Mutex<Option<Channel>>,
}

/// The datagrams that are being built for a neighbour, and the counter of the first of them.
#[derive(Default)]
pub(super) struct Outgoing {
    pub(super) counter: u64,
    /// Datagrams whose memory is used again. There are as many as ever left in one call.
    pub(super) datagrams: Vec<Datagram>,
}

impl Outgoing {
    /// Takes the next counter.
    pub(super) const fn next(&mut self) -> u64 {
        self.counter += 1;
        self.counter - 1
    }
}

/// A neighbour with which this node cannot communicate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// The neighbour whose datagrams were refused.
    pub node: NodeId,
    /// Why the two nodes cannot communicate.
    pub why: Refused,
    /// The neighbour's digests.
    pub theirs: Digests,
    /// Whether this node refused a datagram of the neighbour.
    pub here: bool,
    /// Whether the neighbour says that it refuses this node's datagrams.
    pub there: bool,
}

/// The number that stands for no incarnation.
const NOTHING: u16 = u16::MAX;

/// The route to one neighbour: its address, and a socket that is connected to it.
///
/// The connected socket sends and receives. The kernel looks up the route once, and reports on this socket if no socket
/// listens at the address (ECONNREFUSED). If the connected socket fails, the socket of strangers sends, from the same
/// address. If the connected socket is full, no socket sends: datagrams that the kernel holds for an unresolved
/// neighbour would fill the socket of strangers, too.
pub(super) struct Route {
    pub(super) address: SocketAddr,
    pub(super) connected: Option<Arc<Inbound>>,
    segments: Segments,
}

/// Whether the kernel cuts the data for a neighbour into full datagrams.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Segments {
    /// The kernel was not asked to cut data, because no send has filled more than one datagram yet.
    NotYet,
    Cut,
    Refused,
}

impl Route {
    /// The route to `address`. `segments` says whether the kernel may be asked to cut data into datagrams.
    pub(super) const fn new(address: SocketAddr, connected: Option<Arc<Inbound>>, segments: bool) -> Self {
        let segments = if segments { Segments::NotYet } else { Segments::Refused };
        Self { address, connected, segments }
    }

    /// The socket that cuts what it sends into datagrams of `full` bytes, if the kernel does that on this route. The
    /// option is set on the socket, not with each call, because it does not affect data that fits into one datagram.
    pub(super) fn segmenting(&mut self, full: usize) -> Option<&UdpSocket> {
        let socket = &self.connected.as_deref()?.socket;
        if self.segments == Segments::NotYet {
            let asked = set_segment(socket, full);
            self.segments = asked.map_or(Segments::Refused, |()| Segments::Cut);
        }
        (self.segments == Segments::Cut).then_some(socket)
    }

    /// Makes each datagram leave in a call of its own from now on. Returns false if each did already.
    pub(super) fn segment_no_more(&mut self) -> bool {
        let cut = std::mem::replace(&mut self.segments, Segments::Refused) == Segments::Cut;
        if let Some(connected) = self.connected.as_deref().filter(|_| cut) {
            // If the option cannot be unset, this socket fails, and the socket of strangers sends.
            let _ = set_segment(&connected.socket, 0);
        }
        cut
    }
}

impl Peer {
    pub(super) fn new(node: NodeId, declared: Ticks) -> Self {
        Self {
            node,
            declared,
            route: Mutex::default(),
            inbound: Mutex::default(),
            known: Mutex::default(),
            full: AtomicBool::new(false),
            outgoing: Mutex::default(),
            heard: Mutex::default(),
            met: AtomicBool::new(false),
            has_stopped: AtomicBool::new(false),
            remembered: AtomicU16::new(NOTHING),
            remembers: Mutex::default(),
            refusal: Mutex::default(),
            is_refused: AtomicBool::new(false),
            pace: Mutex::default(),
            health: Health::new(declared),
            channel: Mutex::default(),
        }
    }

    /// The report about the link from the neighbour at the instant `now`.
    pub(super) fn report(&self, now: u64) -> LinkReport {
        let has_stopped = self.has_stopped.load(Ordering::Acquire);
        LinkReport { has_stopped, ..self.health.report(self.node, now, self.progress()) }
    }

    /// How many of the neighbour's datagrams were accepted, and which counter comes next.
    pub(super) fn progress(&self) -> Progress {
        lock(&self.known).as_ref().map_or_else(Progress::default, Known::progress)
    }

    /// The newest incarnation of the neighbour that was seen.
    pub(super) fn remembered(&self) -> Option<Incarnation> {
        u8::try_from(self.remembered.load(Ordering::Relaxed)).ok().map(Incarnation)
    }

    /// Records an incarnation, unless a later one was seen. Several threads may receive at once.
    pub(super) fn remember(&self, incarnation: Incarnation) {
        let later = |before: u16| {
            let before = u8::try_from(before).ok().map(Incarnation);
            before.is_none_or(|before| supersedes(incarnation, before)).then(|| incarnation.0.into())
        };
        // This fails only if the known incarnation is as late or later, and then nothing needs to change.
        let _ = self.remembered.fetch_update(Ordering::Relaxed, Ordering::Relaxed, later);
    }
}

/// The neighbour's clock, as a datagram showed it, and this node's clock when that datagram was received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Heard {
    pub(super) session: Session,
    pub(super) tx_mono: u64,
    pub(super) at: u64,
}

impl Heard {
    /// What a datagram that arrived at the instant `at` shows.
    pub(super) const fn of(envelope: &Envelope, at: u64) -> Self {
        Self { session: envelope.session, tx_mono: envelope.tx_mono, at }
    }

    /// The least value that the neighbour's clock has when this node's clock shows `tx`. The time since the
    /// neighbour's last datagram is measured by this node's clock, which may run faster than the neighbour's.
    pub(super) fn echo(&self, tx: u64) -> Option<Echo> {
        let drift = |time: u64| time / (1_000_000 / DRIFT_PPM) + 1;
        let mono = match tx.checked_sub(self.at) {
            Some(held) => self.tx_mono.checked_add(held.saturating_sub(drift(held)))?,
            // This node read `tx` before it received the neighbour's datagram.
            None => self.tx_mono.checked_sub((self.at - tx) + drift(self.at - tx))?,
        };
        Some(Echo { session: self.session, mono })
    }
}

/// A limit on how many greetings and refusals leave for a neighbour.
#[derive(Default)]
pub(super) struct Pace {
    /// When the current span began, and how many greetings left in it.
    greetings: (u64, u32),
    /// When the current span of answers in handshakes began, and how many answers left in it.
    answers: (u64, u32),
    /// When the last refusal left.
    refused: Option<u64>,
}

/// How many greetings leave in one [`SPAN`], at most.
const GREETINGS: u32 = 8;
/// How many answers in handshakes leave in one [`SPAN`], at most. Each copy of a request gets an answer of its own.
const ANSWERS: u32 = 64;
/// The length of a span of this limit, in microseconds.
const SPAN: u64 = 50_000;
/// The least time between two refusals, in microseconds.
const REFUSE_EVERY: u64 = 200_000;

impl Pace {
    /// Whether one more greeting may leave now.
    pub(super) fn greets(&mut self, now: u64) -> bool {
        Self::leaves(&mut self.greetings, GREETINGS, now)
    }

    /// Whether one more answer in a handshake may leave now.
    pub(super) fn answers(&mut self, now: u64) -> bool {
        Self::leaves(&mut self.answers, ANSWERS, now)
    }

    fn leaves((begun, count): &mut (u64, u32), most: u32, now: u64) -> bool {
        if now.saturating_sub(*begun) >= SPAN {
            (*begun, *count) = (now, 0);
        }
        *count += 1;
        *count <= most
    }

    /// Whether a refusal may leave now.
    pub(super) fn refuses(&mut self, now: u64) -> bool {
        let may = self.refused.is_none_or(|last| now.saturating_sub(last) >= REFUSE_EVERY);
        if may {
            self.refused = Some(now);
        }
        may
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_echo_never_says_more_than_the_neighbours_clock_shows() {
        let heard = Heard { session: Session(3), tx_mono: 5_000, at: 100_000 };
        let mono = |tx| heard.echo(tx).map(|e| e.mono);
        assert_eq!(mono(100_000), Some(5_000));
        assert_eq!(mono(100_100), Some(5_099));
        assert_eq!(mono(100_000 + 25_000_000), Some(5_000 + 25_000_000 - 10_001));
        assert_eq!(mono(99_000), Some(3_999), "made ready before");
        assert_eq!(mono(90_000), None, "before its clock began");
    }

    #[test]
    fn greetings_and_refusals_are_few() {
        let mut pace = Pace::default();
        assert_eq!((0..100).filter(|_| pace.greets(7_000_000)).count(), 8);
        assert!(pace.greets(7_000_000 + SPAN));
        let refusals = (0..1_000).filter(|ms| pace.refuses(ms * 1_000)).count();
        assert_eq!(refusals, 5, "in a second");
    }

    #[test]
    fn the_newest_incarnation_is_remembered() {
        let peer = Peer::new(NodeId(1), Ticks(0));
        assert_eq!(peer.remembered(), None);
        for (seen, newest) in [(200, 200), (199, 200), (255, 255), (3, 3), (250, 3)] {
            peer.remember(Incarnation(seen));
            assert_eq!(peer.remembered(), Some(Incarnation(newest)));
        }
    }
}
