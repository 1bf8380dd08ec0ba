//! Receiving: from the socket to the sink.

use super::UdpLink;
use super::peer::{Contact, Heard, Life, judge, lock};
use super::socket::{Received, Receiver};
use super::statistics::UdpCount;
use crate::clock;
use crate::link::{LinkDiscard, Sink};
use crate::residency::{Evidence, Reading, residency};
use imrs_protocol::{Packet, Ticks};
use imrs_wire::envelope::{self, EnvelopeError};
use std::io;
use std::time::Duration;

/// How many datagrams one poll takes at most before it gives way to whatever else its thread has to do.
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
    /// What a datagram brought.
    pub(super) decoded: Vec<Packet>,
}

impl UdpLink {
    /// Takes the datagram that the leader was told of: whatever came after it was told to whoever polls. To see the
    /// socket empty costs a system call more, so that is done only now and then: nothing rests on it while the stamps can
    /// be believed.
    pub(super) fn receive_one(&self, receiving: &mut Receiving, sink: &dyn Sink) {
        let Receiving { receiver, empty, last, .. } = &*receiving;
        let lately = last.after.saturating_duration_since(empty.after) < EMPTY_OFTEN;
        let most = if lately && receiver.stamped { 1 } else { BATCH };
        self.receive(receiving, most, sink);
    }

    /// Takes what waits, up to a [`BATCH`]. Returns whether any datagram came in.
    pub(super) fn drain(&self, receiving: &mut Receiving, sink: &dyn Sink) -> bool {
        self.receive(receiving, BATCH, sink)
    }

    fn receive(&self, receiving: &mut Receiving, most: usize, sink: &dyn Sink) -> bool {
        let Receiving { receiver, empty, last, lives, decoded } = receiving;
        // Read before the socket is looked at: if it turns out to be empty, it was so after this.
        let mut before = if most > 1 { Reading::take() } else { *last };
        for taken in 0..most {
            match receiver.receive(&self.socket) {
                Ok((received, dropped)) => {
                    let now = Reading::take();
                    self.statistics.add(UdpCount::DatagramsReceived, 1);
                    self.statistics.add(UdpCount::KernelDropped, u64::from(dropped));
                    if let Err(reason) =
                        self.deliver(&received, &now, empty, (&mut *lives, &mut *decoded), sink)
                    {
                        sink.discarded(reason);
                    }
                    (before, *last) = (now, now);
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    *empty = before;
                    return taken > 0;
                }
                // What the network says of datagrams sent before, or an interruption: the queue is as it was.
                Err(_) => self.statistics.add(UdpCount::ReceiveFailed, 1),
            }
        }
        true
    }

    /// Hands the packets of a datagram to the sink, that was received before `now`.
    fn deliver(
        &self,
        received: &Received<'_>,
        now: &Reading,
        empty: &Reading,
        (lives, decoded): (&mut [Option<Life>], &mut Vec<Packet>),
        sink: &dyn Sink,
    ) -> Result<(), LinkDiscard> {
        let digest = self.table.digest();
        let (envelope, packets) = envelope::open(received.bytes, digest, |node| self.peer(node).is_some())
            .map_err(LinkDiscard::from)?;
        let (index, peer) = self.peer(envelope.sender).ok_or(LinkDiscard::UnknownNode)?;
        let contact = judge(&mut lives[index], &envelope, peer.declared)?;
        if let Contact::New { restarted } = contact {
            self.statistics.add(UdpCount::NewLives, 1);
            sink.peer(peer.node, envelope.incarnation, restarted);
        }
        let at = self.micros(now.after) + 1;
        let heard = Heard { incarnation: envelope.incarnation, tx_mono: envelope.tx_mono, at };
        *lock(&peer.heard) = Some(heard);
        let waited = self.waited(received, now, empty);
        let echo = envelope.echo.filter(|echo| echo.incarnation == self.options.incarnation);
        let life = lives[index].as_mut();
        let shown = life.map_or(Ticks::ZERO, |l| l.delay.arrived(envelope.tx_mono, echo.map(|e| e.mono), at));
        let charge = shown.max(peer.declared + waited);
        let port_hash = |port| self.table.port(port).map(|port| port.hash);
        decoded.clear();
        for packet in packets {
            match Packet::decode(packet, digest, port_hash) {
                Ok(packet) => decoded.push(packet),
                Err(error) => sink.discarded(LinkDiscard::Packet(error)),
            }
        }
        if !decoded.is_empty() {
            self.statistics.add(UdpCount::PacketsReceived, decoded.len() as u64);
            sink.packets(peer.node, decoded, charge, now.after);
        }
        Ok(())
    }

    /// How long a datagram waited in the kernel.
    fn waited(&self, received: &Received<'_>, now: &Reading, empty: &Reading) -> Ticks {
        let residency = residency(now, received.stamp, empty);
        match residency.by {
            Evidence::Stamp => {}
            Evidence::NoStamp => self.statistics.add(UdpCount::NoStamp, 1),
            Evidence::ClockSet => self.statistics.add(UdpCount::ClockSet, 1),
        }
        Ticks(clock::micros(residency.waited))
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
