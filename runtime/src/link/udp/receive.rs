//! Receiving: from the socket to the sink.

use super::UdpLink;
use super::peer::{Contact, Heard, Life, judge, lock};
use super::socket::{Received, Receiver};
use super::statistics::UdpCount;
use crate::clock;
use crate::link::{LinkDiscard, Sink};
use crate::residency::{Evidence, Reading, residency};
use imrs_protocol::{NodeId, Packet, Ticks};
use imrs_wire::envelope::{self, EnvelopeError};
use std::io;
use std::time::Duration;

/// After how many datagrams a poll gives way to whatever else its thread has to do.
const BATCH: usize = 64;
/// How long ago the socket may have been seen empty before whoever takes one datagram looks for more.
const EMPTY_OFTEN: Duration = Duration::from_millis(10);

/// What the thread has that waits in the socket and receives.
pub(super) struct Receiving {
    pub(super) receiver: Receiver,
    /// The clocks when the socket was last seen empty.
    pub(super) empty: Reading,
    /// The clocks when a datagram was last taken.
    pub(super) last: Reading,
    /// By the position of the neighbour.
    pub(super) lives: Box<[Option<Life>]>,
    /// What came at once brought. Has room for what leaves in one call, and keeps it.
    pub(super) decoded: Vec<Packet>,
}

impl UdpLink {
    /// Takes the datagram that the leader was told of, with those that the kernel put together with it: whatever came after
    /// was told to whoever polls. To see the socket empty costs a system call more, so that is done only now and then:
    /// nothing rests on it while the stamps can be believed.
    pub(super) fn receive_one(&self, receiving: &mut Receiving, sink: &dyn Sink) {
        let Receiving { receiver, empty, last, .. } = &*receiving;
        let lately = last.after.saturating_duration_since(empty.after) < EMPTY_OFTEN;
        let most = if lately && receiver.stamped { 1 } else { BATCH };
        self.receive(receiving, most, sink);
    }

    /// Takes what waits, until it was a [`BATCH`]. Returns whether any datagram came in.
    pub(super) fn drain(&self, receiving: &mut Receiving, sink: &dyn Sink) -> bool {
        self.receive(receiving, BATCH, sink)
    }

    fn receive(&self, receiving: &mut Receiving, most: usize, sink: &dyn Sink) -> bool {
        let Receiving { receiver, empty, last, lives, decoded } = receiving;
        // Read before the socket is looked at: if it turns out to be empty, it was so after this.
        let mut before = if most > 1 { Reading::take() } else { *last };
        let mut taken = 0;
        while taken < most {
            match receiver.receive(&self.socket) {
                Ok((received, dropped)) => {
                    let now = Reading::take();
                    self.statistics.add(UdpCount::KernelDropped, u64::from(dropped));
                    let waited = self.waited(&received, &now, empty);
                    let together = Together { link: self, now, waited, lives, decoded, of: None, sink };
                    taken += together.deliver(&received);
                    (before, *last) = (now, now);
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    *empty = before;
                    return taken > 0;
                }
                // What the network says of datagrams sent before, or an interruption: the queue is as it was.
                Err(_) => {
                    self.statistics.add(UdpCount::ReceiveFailed, 1);
                    taken += 1;
                }
            }
        }
        true
    }

    /// How long a datagram waited in the kernel.
    fn waited(&self, received: &Received<'_>, now: &Reading, empty: &Reading) -> Ticks {
        let residency = residency(now, received.stamp, empty);
        match residency.by {
            Evidence::Stamp => {}
            Evidence::NoStamp => self.statistics.add(UdpCount::NoStamp, 1),
            Evidence::ClockSet => {
                self.statistics.add(UdpCount::ClockSet, 1);
                // The wall clock goes on while the machine is suspended, and the monotonic one does not.
                let slept = clock::look_for_suspend().saturating_sub(empty.suspended);
                return Ticks(clock::micros(residency.waited).saturating_add(slept));
            }
        }
        Ticks(clock::micros(residency.waited))
    }
}

/// What came in at once, before `now`.
struct Together<'a> {
    link: &'a UdpLink,
    now: Reading,
    /// How long it waited in the kernel, by the one stamp that it has.
    waited: Ticks,
    lives: &'a mut [Option<Life>],
    /// What its datagrams brought and the sink was not yet given.
    decoded: &'a mut Vec<Packet>,
    /// Whose that is, and its charge.
    of: Option<(NodeId, Ticks)>,
    sink: &'a dyn Sink,
}

impl Together<'_> {
    /// Judges each datagram by itself, and hands over what they bring. Returns how many there were.
    ///
    /// What one neighbour sent in one call has one charge, and is handed over as one: else a later packet would be taken to
    /// be the older one wherever the clock went on between two datagrams (D126).
    fn deliver(mut self, received: &Received<'_>) -> usize {
        let mut count = 0;
        for bytes in received.datagrams() {
            count += 1;
            if let Err(reason) = self.take(bytes) {
                self.sink.discarded(reason);
            }
        }
        self.hand_over();
        self.link.statistics.add(UdpCount::DatagramsReceived, count);
        if count > 1 {
            self.link.statistics.add(UdpCount::ReceivesSaved, count - 1);
        }
        usize::try_from(count).unwrap_or(usize::MAX)
    }

    fn take(&mut self, bytes: &[u8]) -> Result<(), LinkDiscard> {
        let link = self.link;
        let digest = link.table.digest();
        let (envelope, packets) =
            envelope::open(bytes, digest, |node| link.peer(node).is_some()).map_err(LinkDiscard::from)?;
        let (index, peer) = link.peer(envelope.sender).ok_or(LinkDiscard::UnknownNode)?;
        if let Contact::New { restarted } = judge(&mut self.lives[index], &envelope, peer.declared)? {
            // Of the life before.
            self.hand_over();
            link.statistics.add(UdpCount::NewLives, 1);
            self.sink.peer(peer.node, envelope.incarnation, restarted);
        }
        let at = link.micros(self.now.after) + 1;
        let heard = Heard { incarnation: envelope.incarnation, tx_mono: envelope.tx_mono, at };
        *lock(&peer.heard) = Some(heard);
        let echo = envelope.echo.filter(|echo| echo.incarnation == link.options.incarnation);
        let life = self.lives[index].as_mut();
        let shown = life.map_or(Ticks::ZERO, |l| l.delay.arrived(envelope.tx_mono, echo.map(|e| e.mono), at));
        let of = Some((peer.node, shown.max(peer.declared + self.waited)));
        if self.of != of || self.decoded.len() + packets.len() > self.decoded.capacity() {
            self.hand_over();
            self.of = of;
        }
        let port_hash = |port| link.table.port(port).map(|port| port.hash);
        for packet in packets {
            match Packet::decode(packet, digest, port_hash) {
                Ok(packet) => self.decoded.push(packet),
                Err(error) => self.sink.discarded(LinkDiscard::Packet(error)),
            }
        }
        Ok(())
    }

    fn hand_over(&mut self) {
        if let Some((node, charge)) = self.of.filter(|_| !self.decoded.is_empty()) {
            self.link.statistics.add(UdpCount::PacketsReceived, self.decoded.len() as u64);
            self.sink.packets(node, self.decoded, charge, self.now.after);
        }
        self.decoded.clear();
    }
}

impl From<EnvelopeError> for LinkDiscard {
    fn from(error: EnvelopeError) -> Self {
        match error {
            EnvelopeError::TooShort(_) => Self::TooShort,
            EnvelopeError::NotImrs => Self::NotImrs,
            EnvelopeError::Version(_) => Self::Version,
            EnvelopeError::Mode(_) => Self::Mode,
            EnvelopeError::Length(_) => Self::Length,
            EnvelopeError::Checksum => Self::Checksum,
            EnvelopeError::OtherCell(_) => Self::OtherCell,
            EnvelopeError::UnknownNode(_) => Self::UnknownNode,
        }
    }
}
