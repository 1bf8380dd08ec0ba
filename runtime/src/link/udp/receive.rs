//! Receives datagrams: from a socket of the kernel to the sink of the node.

#[cfg(test)]
mod forged;

use super::UdpLink;
use super::inbound::{Inbound, Queue};
use super::keys::Live;
use super::peer::{Heard, Peer};
use super::send::SEGMENTS;
use super::session::{Contact, Known, admit, judge};
use super::socket::{Asked, Received, Receiver};
use super::statistics::UdpCount;
use super::watch::ReadySockets;
use crate::clock;
use crate::link::residency::{Evidence, Reading, residency};
use crate::link::{LinkDiscard, Sink};
use crate::lock::lock;
use imrs_protocol::{NodeId, Packet, Ticks};
use imrs_wire::envelope::keyed::MAX_KEYED_BYTES;
use imrs_wire::envelope::{self, Envelope, Greeting, MAX_PACKETS, Opened, Purpose};
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// After how many datagrams of one socket a poll turns to the other sockets, and to the other work of its thread.
const BATCH: usize = 64;
/// The same limit for the socket of strangers: neighbours wait for at most this many of its datagrams.
const STRANGERS_BATCH: usize = 16;
/// If a socket was seen empty within this time, a thread takes only one datagram from it; otherwise up to [`BATCH`].
const EMPTY_OFTEN: Duration = Duration::from_millis(10);

/// The result of a visit to a socket.
#[derive(Clone, Copy, Debug, Default)]
struct Taken {
    /// The number of datagrams that the visit took, accepted or not.
    count: usize,
    /// The number of greetings, and of datagrams that were accepted.
    heard: usize,
}

impl Taken {
    /// Whether the visit took as many datagrams as it may, and accepted none of them.
    const fn is_flood(self, most: usize) -> bool {
        self.count >= most && self.heard == 0
    }
}

/// The buffers into which a thread receives.
pub(super) struct Room {
    receiver: Receiver,
    /// The packets of one receive call. The buffer has room for as many packets as leave in one call, and keeps that room.
    decoded: Vec<Packet>,
    /// The content of a datagram that keys have opened.
    plain: Box<[u8]>,
}

impl Room {
    pub(super) fn new(asked: Asked) -> Self {
        let receiver = Receiver::new(asked.stamped, asked.merges);
        let plain = vec![0; MAX_KEYED_BYTES].into();
        Self { receiver, decoded: Vec::with_capacity(MAX_PACKETS * SEGMENTS), plain }
    }
}

impl UdpLink {
    /// Takes one datagram, with those that the kernel merged with it, from each socket that was reported to the
    /// leader. The kernel reports later datagrams to the polling thread. Returns false if another thread receives
    /// from one of the sockets: that thread takes the datagram. Reading a socket until it is empty costs one more
    /// syscall, so this is done only after `EMPTY_OFTEN`. That instant matters only without the kernel's stamps.
    pub(super) fn take_told(&self, told: &ReadySockets, sink: &dyn Sink) -> bool {
        self.with_room(|room| {
            let mut all = true;
            for inbound in told.places().filter_map(|place| self.inbound(place)) {
                all &= inbound.try_take_in(|queue| {
                    let lately = queue.last.after.saturating_duration_since(queue.empty.after) < EMPTY_OFTEN;
                    let most = if lately && self.asked.stamped { 1 } else { BATCH };
                    self.receive((&inbound, queue), room, most, sink);
                });
            }
            all
        })
    }

    /// Takes the datagrams that wait in the reported sockets: up to a [`BATCH`] of each, or a [`STRANGERS_BATCH`] of
    /// strangers. Returns whether it took any datagram.
    pub(super) fn drain(&self, told: &ReadySockets, sink: &dyn Sink) -> bool {
        self.with_room(|room| {
            let mut any = false;
            for inbound in told.places().filter_map(|place| self.inbound(place)) {
                let most = if inbound.is_of_strangers() { STRANGERS_BATCH } else { BATCH };
                inbound.take_in(|queue| {
                    let taken = self.receive((&inbound, queue), room, most, sink);
                    if inbound.is_of_strangers() && taken.is_flood(most) {
                        self.rest_from_strangers();
                    }
                    any |= taken.count > 0;
                });
            }
            any
        })
    }

    fn with_room<T>(&self, work: impl FnOnce(&mut Room) -> T) -> T {
        let room = lock(&self.rooms).pop();
        let mut room = room.unwrap_or_else(|| Room::new(self.asked));
        let done = work(&mut room);
        lock(&self.rooms).push(room);
        done
    }

    fn receive(
        &self,
        (inbound, queue): (&Inbound, &mut Queue),
        room: &mut Room,
        most: usize,
        sink: &dyn Sink,
    ) -> Taken {
        let Room { receiver, decoded, plain } = room;
        // The clocks are read before the socket is checked. If the socket turns out to be empty, it was empty after this reading.
        let mut before = if most > 1 { Reading::take() } else { queue.last };
        let (mut taken, mut errors) = (Taken::default(), 0);
        while taken.count < most && errors < BATCH {
            match receiver.receive(&inbound.socket) {
                Ok(received) => {
                    let now = Reading::take();
                    self.count_dropped(inbound, queue, received.dropped);
                    let waited = self.waited(&received, &now, &queue.empty);
                    let together = Together {
                        link: self,
                        from: inbound.from,
                        now,
                        waited,
                        decoded,
                        plain,
                        of: None,
                        greetings: 0,
                        handshakes: 0,
                        admitted: 0,
                        sink,
                    };
                    let (count, heard) = together.deliver(&received);
                    taken.count += count;
                    taken.heard += heard;
                    (before, queue.last) = (now, now);
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    queue.empty = before;
                    return taken;
                }
                // The error is an interruption, or a network error about an earlier datagram. No datagram was taken.
                Err(error) => {
                    // A connected socket reports such network errors only for datagrams that were sent through it.
                    if inbound.from.is_some() && error.kind() != io::ErrorKind::Interrupted {
                        self.statistics.send_failed(&error);
                    } else {
                        self.statistics.add(UdpCount::ReceiveFailed, 1);
                    }
                    errors += 1;
                }
            }
        }
        taken
    }

    /// Counts the datagrams that the kernel dropped from a queue. `total` is their number since the socket was made, if the
    /// kernel reports it.
    fn count_dropped(&self, inbound: &Inbound, queue: &mut Queue, total: Option<u32>) {
        let Some(total) = total else { return };
        let new = u64::from(total.wrapping_sub(std::mem::replace(&mut queue.dropped, total)));
        self.statistics.add(UdpCount::KernelDropped, new);
        if inbound.is_of_strangers() {
            self.statistics.add(UdpCount::StrangersDropped, new);
        }
    }

    /// How long a datagram waited in the kernel.
    fn waited(&self, received: &Received<'_>, now: &Reading, empty: &Reading) -> Ticks {
        let residency = residency(now, received.stamp, empty);
        let waited = clock::micros(residency.waited);
        let count = match residency.by {
            // The wall clock also runs while the machine is suspended, so the stamp covers that time.
            Evidence::Stamp => return Ticks(waited),
            Evidence::NoStamp => UdpCount::NoStamp,
            Evidence::ClockSet => UdpCount::ClockSet,
        };
        self.statistics.add(count, 1);
        // The whole time since the socket was seen empty counts as waiting. `Instant` does not advance while the machine is
        // suspended, so that time is added.
        let slept = clock::look_for_suspend().saturating_sub(empty.suspended);
        Ticks(waited.saturating_add(slept))
    }
}

/// The datagrams that one receive call brought, before the instant `now`.
pub(super) struct Together<'a> {
    pub(super) link: &'a UdpLink,
    /// The address of the neighbour from which they came, if the socket is connected to one.
    from: Option<SocketAddr>,
    now: Reading,
    /// How long the datagrams waited in the kernel, by the one stamp of the call.
    waited: Ticks,
    /// Decoded packets that were not handed to the sink yet.
    decoded: &'a mut Vec<Packet>,
    plain: &'a mut Box<[u8]>,
    /// The sender of the packets in `decoded`, and by how much their remaining times are reduced.
    of: Option<(NodeId, Ticks)>,
    /// How many of the datagrams were greetings, and how many belonged to handshakes: anybody can repeat those.
    greetings: u64,
    handshakes: u64,
    /// How many of the datagrams brought packets that the sink gets.
    admitted: u64,
    pub(super) sink: &'a dyn Sink,
}

impl Together<'_> {
    /// Checks each datagram by itself, and hands over its packets. Returns how many datagrams there were, and how
    /// many of them were accepted.
    ///
    /// All datagrams of one neighbour in one call lose the same remaining time, and are handed over together.
    /// Otherwise a later packet would count as older if the clock advanced between two datagrams (D126).
    fn deliver(mut self, received: &Received<'_>) -> (usize, usize) {
        let mut count = 0;
        for bytes in received.datagrams() {
            count += 1;
            let Err(reason) = self.take(bytes) else { continue };
            if let Some(from) = self.from {
                self.link.discarded_of(from, reason, &self.now);
            }
            self.sink.discarded(reason);
        }
        self.hand_over();
        self.link.statistics.add(UdpCount::DatagramsReceived, count - self.greetings - self.handshakes);
        if count > 1 {
            self.link.statistics.add(UdpCount::ReceivesSaved, count - 1);
        }
        let size = |count| usize::try_from(count).unwrap_or(usize::MAX);
        (size(count), size(self.greetings + self.admitted))
    }

    fn take(&mut self, bytes: &[u8]) -> Result<(), LinkDiscard> {
        if !self.link.has_keys() {
            let opened = envelope::read(bytes).inspect_err(|_| self.link.hint_at_keys(bytes))?;
            return self.take_opened(&opened, None);
        }
        let mut room = std::mem::take(self.plain);
        let taken = match self.link.unlock(bytes, &mut room) {
            Ok(Some((opened, live))) => self.take_opened(&opened, live.as_ref()),
            Ok(None) => {
                self.handshakes += 1;
                Ok(())
            }
            Err(reason) => Err(reason),
        };
        *self.plain = room;
        taken
    }

    /// Handles an intact datagram. `by` is the session with keys that closed it.
    fn take_opened(&mut self, opened: &Opened<'_>, by: Option<&Arc<Live>>) -> Result<(), LinkDiscard> {
        let link = self.link;
        let peer = link.sender_of(opened)?;
        let (envelope, at) = (&opened.envelope, link.micros(self.now.after) + 1);
        if let Purpose::Greeting(greeting) = envelope.purpose {
            self.greetings += 1;
            self.greeted(peer, (envelope, greeting), at, by);
            return Ok(());
        }
        if envelope.purpose == Purpose::Goodbye {
            self.greetings += 1;
            return self.hears_goodbye(peer, envelope, at, by);
        }
        if self.decoded.len() + opened.packets.len() > self.decoded.capacity() {
            self.hand_over();
        }
        let one_way = || lock(&peer.route).is_none();
        let mut known = lock(&peer.known);
        let sent_after =
            link.proof(peer, known.as_ref(), envelope, by).or_else(|| link.sent_after(envelope, at));
        let judged = judge(known.as_ref(), envelope, sent_after, one_way);
        let contact = judged.map_err(|unheard| {
            if unheard.asks {
                link.statistics.add(UdpCount::EchoesAsked, 1);
                let asks = Greeting { wants_answer: true, ..Greeting::default() };
                link.say(peer, asks, Some(Heard::of(envelope, at)));
            }
            unheard.reason
        })?;
        // A datagram changes the node's knowledge of its sender only if it brings at least one packet of this cell.
        let mut before = self.decode(opened.packets, envelope.sender);
        if self.decoded.len() == before {
            return Ok(());
        }
        if let Contact::New { .. } = contact {
            // The packets that were decoded before this datagram belong to an earlier session of the sender.
            self.hand_over_first(std::mem::take(&mut before));
        }
        self.admitted += 1;
        let shown = self.enter(peer, &mut known, (envelope, contact), at);
        drop(known);
        let of = Some((peer.node, shown.max(peer.declared + self.waited)));
        if self.of != of {
            self.hand_over_first(before);
            self.of = of;
        }
        Ok(())
    }

    /// Appends decoded packets to the buffer, which has room for them. Returns how many packets waited in it before.
    fn decode(&mut self, packets: &[[u8; 32]], sender: NodeId) -> usize {
        let (link, before) = (self.link, self.decoded.len());
        let port_hash = |port| link.table.port(port).map(|port| port.hash);
        for packet in packets {
            match Packet::decode(packet, link.table.digest(), port_hash) {
                Ok(packet) => {
                    link.remember_source(sender, &packet);
                    self.decoded.push(packet);
                }
                Err(error) => self.sink.discarded(LinkDiscard::Packet(error)),
            }
        }
        before
    }

    /// Records what an accepted datagram says about its sender. Returns how long its hop took at most.
    pub(super) fn enter(
        &mut self,
        peer: &Peer,
        known: &mut Option<Known>,
        (envelope, contact): (&Envelope, Contact),
        at: u64,
    ) -> Ticks {
        let link = self.link;
        if let Contact::New { restarted } = contact {
            link.statistics.add(UdpCount::NewIncarnations, 1);
            peer.remember(envelope.incarnation);
            peer.has_stopped.store(false, Ordering::Release);
            self.sink.peer(peer.node, envelope.incarnation, restarted);
        }
        if contact == Contact::Resumed {
            link.statistics.add(UdpCount::CountersMended, 1);
        }
        link.met(peer);
        *lock(&peer.heard) = Some(Heard::of(envelope, at));
        let echo = link.own_echo(envelope);
        let known = admit(known, contact, envelope, (at, peer.declared));
        let hop = known.delay.arrived(envelope.tx_mono, echo, at);
        peer.health.arrived(&hop, at);
        hop.longest
    }

    /// Handles a greeting. A greeting changes the node's knowledge of its sender only if its echo proves when it was sent.
    fn greeted(
        &mut self,
        peer: &Peer,
        (envelope, greeting): (&Envelope, Greeting),
        at: u64,
        by: Option<&Arc<Live>>,
    ) {
        let link = self.link;
        link.statistics.add(UdpCount::GreetingsReceived, 1);
        let sent_after = link.sent_after(envelope, at);
        if sent_after.is_some() && !greeting.wants_answer {
            *lock(&peer.remembers) = Some(greeting.remembers);
        }
        let mut known = lock(&peer.known);
        let sent_after = link.proof(peer, known.as_ref(), envelope, by).or(sent_after);
        let judged = judge(known.as_ref(), envelope, sent_after, || false);
        let contact = judged.ok().filter(|_| sent_after.is_some() && !greeting.uncounted);
        let is_new = matches!(contact, Some(Contact::New { .. }));
        if let Some(contact) = contact {
            self.hand_over();
            self.enter(peer, &mut known, (envelope, contact), at);
        }
        if let Some(known) = known.as_mut().filter(|_| by.is_some()) {
            known.has_greeted();
        }
        drop(known);
        // A new neighbour must learn at once that this node listens. The answer echoes the clock of this greeting, so
        // the neighbour can prove that it receives from this node.
        if greeting.wants_answer || is_new {
            link.say(peer, Greeting::default(), Some(Heard::of(envelope, at)));
        }
    }

    pub(super) fn hand_over(&mut self) {
        self.hand_over_first(self.decoded.len());
    }

    /// Hands the first `count` decoded packets to the sink.
    fn hand_over_first(&mut self, count: usize) {
        if let Some((node, charge)) = self.of.filter(|_| count > 0) {
            self.link.statistics.add(UdpCount::PacketsReceived, count as u64);
            self.sink.packets(node, &self.decoded[..count], charge, self.now.after);
        }
        self.decoded.drain(..count);
    }
}
