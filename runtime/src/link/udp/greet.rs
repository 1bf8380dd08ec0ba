//! Greetings and refusals: datagrams without packets, in which nodes introduce themselves (D144, D145).

use super::keyed::Closing;
use super::peer::{Heard, Peer, Refusal};
use super::statistics::UdpCount;
use super::{NotANeighbour, UdpLink};
use crate::link::{Link, LinkBusy, LinkDiscard, Sink};
use crate::lock::lock;
use imrs_protocol::{Incarnation, Kind, NodeId, Packet, Ticks};
use imrs_wire::envelope::{
    Datagram, Digests, Envelope, EnvelopeError, Greeting, Opened, Purpose, Refused, without_packets,
};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// How often a neighbour that has not answered is asked again.
const ASK_EVERY: Duration = Duration::from_millis(100);

/// The sink of a node that has not begun yet: it drops all packets.
struct Deaf<'a>(&'a UdpLink);

impl Sink for Deaf<'_> {
    fn packets(&self, _from: NodeId, packets: &[Packet], _charge: Ticks, _at: Instant) {
        self.0.statistics.add(UdpCount::BeforeStart, packets.len() as u64);
    }

    fn peer(&self, _node: NodeId, _incarnation: Incarnation, _restarted: bool) {}

    fn discarded(&self, _reason: LinkDiscard) {}
}

impl UdpLink {
    /// The digests that this node and its neighbours must have in common.
    #[must_use]
    pub fn digests(&self) -> Digests {
        Digests { cell: self.table.digest(), statements: self.options.statements }
    }

    /// Greets every neighbour that has an address and from which this node has accepted nothing since that address was
    /// set. The answer shows whether the two nodes can communicate. The greeting also tells the neighbour the new
    /// session of this node before its first packet. Returns whether this greeted any neighbour.
    pub fn greet(&self) -> bool {
        let mut any = false;
        let unmet = |(_, peer): &(usize, &Peer)| !peer.met.load(Ordering::Relaxed);
        for (position, peer) in self.peers.iter().enumerate().filter(unmet) {
            if let Some(route) = &mut *lock(&peer.route) {
                any = true;
                // When the address was set, the kernel may have had no route to it.
                if route.connected.is_none() {
                    route.connected = self.connected(position, route.address);
                }
            }
            let heard = *lock(&peer.heard);
            self.say(peer, Greeting { wants_answer: true, ..Greeting::default() }, heard);
        }
        any
    }

    /// Asks the neighbours which incarnations of this node they remember. Waits at most for `within`, or until all
    /// neighbours with an address have answered. A node that cannot trust its own record of its incarnation calls
    /// this before [`set_incarnation`](Self::set_incarnation), and before the node runs.
    ///
    /// Returns the answer of each neighbour that answered.
    pub fn ask_incarnations(&self, within: Duration) -> Vec<(NodeId, Option<Incarnation>)> {
        self.uncounted.store(true, Ordering::Release);
        let end = Instant::now() + within;
        let is_silent = |peer: &&Peer| {
            // A process without keys can claim that the keys differ, so this is only a hint.
            let hint = |refusal: Refusal| {
                matches!(refusal.why, Refused::OtherKeys | Refused::OtherMode | Refused::OtherVersion)
            };
            let talks = lock(&peer.refusal).is_none_or(hint);
            lock(&peer.route).is_some() && lock(&peer.remembers).is_none() && talks
        };
        let mut ask_at = Instant::now();
        while Instant::now() < end && self.peers.iter().any(|peer| is_silent(&peer)) {
            if ask_at <= Instant::now() {
                let greeting = Greeting { wants_answer: true, ..Greeting::default() };
                self.peers.iter().filter(is_silent).for_each(|peer| self.say(peer, greeting, None));
                ask_at = Instant::now() + ASK_EVERY;
            }
            self.poll(&Deaf(self), Some(ask_at.min(end)));
        }
        // If the process was stopped, `within` may have passed although answers wait in its socket: they are read
        // now.
        self.poll(&Deaf(self), Some(Instant::now()));
        // The node will greet its neighbours again with its own incarnation, so their sessions are forgotten here.
        for peer in &self.peers {
            *lock(&peer.known) = None;
            peer.met.store(false, Ordering::Relaxed);
        }
        let said = self.peers.iter().filter_map(|peer| Some((peer.node, (*lock(&peer.remembers))?)));
        said.collect()
    }

    /// Whether any neighbour has an address, so that this node can send to it.
    #[must_use]
    pub fn has_addresses(&self) -> bool {
        self.peers.iter().any(|peer| lock(&peer.route).is_some())
    }

    /// The neighbours with which this node cannot communicate at present, and why.
    #[must_use]
    pub fn refusals(&self) -> Vec<Refusal> {
        self.peers.iter().filter_map(|peer| *lock(&peer.refusal)).collect()
    }

    /// Whether any datagram of a neighbour was accepted since its address was set.
    ///
    /// # Errors
    ///
    /// [`NotANeighbour`] if the node is no neighbour.
    pub fn has_met(&self, node: NodeId) -> Result<bool, NotANeighbour> {
        let (_, peer) = self.peer(node).ok_or(NotANeighbour(node))?;
        Ok(peer.met.load(Ordering::Relaxed))
    }

    /// Sends a greeting, unless many greetings left shortly before or the neighbour has no address.
    pub(super) fn say(&self, peer: &Peer, greeting: Greeting, heard: Option<Heard>) {
        let now = self.micros(Instant::now());
        if lock(&peer.pace).greets(now) {
            let uncounted = self.uncounted.load(Ordering::Acquire);
            let greeting = Greeting { remembers: peer.remembered(), uncounted, ..greeting };
            self.send_bare(peer, Purpose::Greeting(greeting), heard);
        }
    }

    pub(super) fn send_bare(&self, peer: &Peer, purpose: Purpose, heard: Option<Heard>) {
        let mut route = lock(&peer.route);
        let Some(route) = route.as_mut() else { return };
        let envelope = self.envelope(peer, Instant::now(), heard, purpose);
        let count = match purpose {
            Purpose::Refusal(_) => UdpCount::RefusalsSent,
            Purpose::Goodbye => UdpCount::GoodbyesSent,
            Purpose::Packets | Purpose::Greeting(_) => UdpCount::GreetingsSent,
        };
        let mut outgoing = lock(&peer.outgoing);
        let sent = match self.closing(peer, route, outgoing.counter) {
            Ok(Closing::Checksum) => {
                // A goodbye is the last datagram of its session, so it takes a new counter, which is the greatest.
                let counter = if purpose == Purpose::Goodbye { outgoing.next() } else { envelope.counter };
                let bytes = without_packets(&Envelope { counter, ..envelope }, self.digests());
                self.transmit(&bytes, route)
            }
            Ok(Closing::Keys(live)) => {
                let (envelope, mut bare) =
                    (Envelope { counter: outgoing.next(), ..envelope }, Datagram::default());
                live.seal(&mut bare, &envelope)
                    .map_err(std::io::Error::other)
                    .and_then(|()| self.transmit(bare.sealed(), route))
            }
            // There is no session yet. Once there is one, the neighbour is greeted.
            Err(LinkBusy) => return,
        };
        drop(outgoing);
        if sent.is_ok() {
            self.statistics.add(count, 1);
        }
    }

    /// The time of this node's clock that the envelope echoes, if the echo is of this session of the node.
    pub(super) fn own_echo(&self, envelope: &Envelope) -> Option<u64> {
        envelope.echo.filter(|echo| echo.session == self.session).map(|echo| echo.mono)
    }

    /// An instant of this node's clock that is certainly before the datagram was sent: the one that its echo shows.
    /// `None` without an echo, or if the echo shows a future instant.
    pub(super) fn sent_after(&self, envelope: &Envelope, at: u64) -> Option<u64> {
        self.own_echo(envelope).filter(|&echo| echo <= at)
    }

    /// The neighbour that sent a datagram, if the two nodes can communicate. Otherwise both nodes learn why they cannot.
    pub(super) fn sender_of(&self, opened: &Opened<'_>) -> Result<&Peer, LinkDiscard> {
        let sender = self.peer(opened.envelope.sender);
        if let (Purpose::Refusal(why), Some((_, peer)), true) =
            (opened.envelope.purpose, sender, opened.envelope.receiver == self.table.node)
        {
            self.note_refusal(peer, why, opened.digests, false);
            return Err(LinkDiscard::RefusedByPeer);
        }
        let checked = opened.check(self.table.node, self.digests(), |_| sender.is_some());
        if let (Err(error), Some((_, peer))) = (checked, sender) {
            let why = match error {
                EnvelopeError::OtherCell(_) => Some(Refused::OtherCell),
                EnvelopeError::OtherStatements(_) => Some(Refused::OtherStatements),
                EnvelopeError::Misdelivered(_) => Some(Refused::Misdelivered),
                _ => None,
            };
            let is_refusal = matches!(opened.envelope.purpose, Purpose::Refusal(_));
            if let Some(why) = why.filter(|_| !is_refusal) {
                self.note_refusal(peer, why, opened.digests, true);
                let now = self.micros(Instant::now());
                if lock(&peer.pace).refuses(now) {
                    self.send_bare(peer, Purpose::Refusal(why), None);
                }
            }
        }
        checked?;
        sender.map(|(_, peer)| peer).ok_or(LinkDiscard::UnknownNode)
    }

    pub(super) fn note_refusal(&self, peer: &Peer, why: Refused, theirs: Digests, here: bool) {
        // One misdelivered datagram does not show whether the two nodes can communicate.
        if why == Refused::Misdelivered {
            return;
        }
        let mut refusal = lock(&peer.refusal);
        let before = refusal.filter(|before| (before.why, before.theirs) == (why, theirs));
        let (was_here, was_there) = before.map_or((false, false), |before| (before.here, before.there));
        let (here, there) = (here || was_here, !here || was_there);
        *refusal = Some(Refusal { node: peer.node, why, theirs, here, there });
        peer.is_refused.store(true, Ordering::Release);
    }

    /// Notes that the two nodes can communicate, and clears a refusal.
    pub(super) fn met(&self, peer: &Peer) {
        if !peer.met.load(Ordering::Relaxed) {
            peer.met.store(true, Ordering::Relaxed);
        }
        if peer.is_refused.load(Ordering::Acquire) {
            peer.is_refused.store(false, Ordering::Release);
            *lock(&peer.refusal) = None;
        }
    }

    /// Learns a neighbour's incarnation from a packet that another node relays for it.
    pub(super) fn remember_source(&self, sender: NodeId, packet: &Packet) {
        if !matches!(packet.kind, Kind::Send | Kind::Query | Kind::Arrive) {
            return;
        }
        let source = self.table.location(packet.source).filter(|&source| source != sender);
        if let Some((_, peer)) = source.and_then(|source| self.peer(source)) {
            peer.remember(packet.id.incarnation);
        }
    }
}
