//! Sends packets: from the transit buffer of the node to a socket of the kernel.

use super::UdpLink;
use super::inbound::Inbound;
use super::keyed::Closing;
use super::peer::{Heard, Outgoing, Peer, Route};
use super::socket;
use super::statistics::UdpCount;
use crate::link::LinkBusy;
use crate::lock::lock;
use imrs_protocol::Packet;
use imrs_wire::envelope::keyed::MAX_KEYED_BYTES;
use imrs_wire::envelope::{Datagram, Envelope, MAX_DATAGRAM_BYTES, MAX_PACKETS, Purpose};
use rustix::io::Errno;
use std::io::{self, IoSlice};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

/// The most full datagrams that leave in one call, if the kernel cuts its data into datagrams. More urgent packets
/// cannot overtake datagrams in the socket: 20 datagrams if they leave in such calls, and 15 if each leaves in a call
/// of its own. Such calls save seven tenths of the cost of single calls. Twice as many datagrams in a call would save
/// only another tenth (D129).
pub(crate) const SEGMENTS: usize = 4;

impl UdpLink {
    /// Sends packets to a neighbour, in datagrams that are full except for the last one, each with a counter of its
    /// own. Returns how many packets the kernel took, or lost: at least one.
    pub(super) fn send_over(
        &self,
        peer: &Peer,
        route: &mut Route,
        packets: &[Packet],
        at: Instant,
    ) -> Result<usize, LinkBusy> {
        let first = self.envelope(peer, at, *lock(&peer.heard), Purpose::Packets);
        let Outgoing { counter, datagrams } = &mut *lock(&peer.outgoing);
        let closing = self.closing(peer, route, *counter)?;
        let count = packets.len().div_ceil(MAX_PACKETS);
        if datagrams.len() < count {
            datagrams.resize_with(count, Datagram::default);
        }
        let digests = self.digests();
        for (number, (datagram, packets)) in datagrams.iter_mut().zip(packets.chunks(MAX_PACKETS)).enumerate()
        {
            datagram.clear();
            for packet in packets {
                // This node's cell may lack the port. The packet is sent anyway, because the neighbour then reports
                // and counts it.
                let hash = self.table.port(packet.port).map_or(0, |port| port.hash);
                datagram.push(&packet.encode(self.table.digest(), hash));
            }
            let envelope = Envelope { counter: *counter + number as u64, ..first };
            match &closing {
                Closing::Checksum => drop(datagram.seal(&envelope, digests)),
                // Sealing fails only for a datagram that is longer than the greatest length.
                Closing::Keys(live) => live.seal(datagram, &envelope).map_err(|_| LinkBusy)?,
            }
        }
        let left = self.leave(peer, route, &datagrams[..count]);
        // The counters of datagrams that the kernel did not take are not used again, because a part of a failed call
        // may have left.
        *counter += count as u64;
        left.map(|left| packets.len().min(left * MAX_PACKETS))
    }

    /// The envelope of a datagram for a neighbour, with counter zero. `heard` is the neighbour's clock, which the envelope
    /// echoes.
    pub(super) fn envelope(
        &self,
        peer: &Peer,
        at: Instant,
        heard: Option<Heard>,
        purpose: Purpose,
    ) -> Envelope {
        let tx_mono = self.micros(at);
        peer.health.sends(tx_mono);
        let (incarnation, restarted) = self.identity();
        Envelope {
            sender: self.table.node,
            receiver: peer.node,
            incarnation,
            restarted,
            session: self.session,
            counter: 0,
            tx_mono,
            echo: heard.and_then(|heard| heard.echo(tx_mono)),
            purpose,
        }
    }

    /// Hands datagrams to the kernel in their order. Returns how many datagrams the kernel took, or lost.
    fn leave(&self, peer: &Peer, route: &mut Route, datagrams: &[Datagram]) -> Result<usize, LinkBusy> {
        if datagrams.len() > 1 {
            match self.transmit_segmented(datagrams, route) {
                Ok(()) => {
                    datagrams.iter().for_each(|datagram| self.has_left(datagram));
                    self.statistics.add(UdpCount::SendsSaved, datagrams.len() as u64 - 1);
                    return Ok(datagrams.len());
                }
                Err(error) if is_full(&error) => return Err(self.found_full(peer)),
                // After this error each datagram is sent again by itself. If one had left in spite of the error, the
                // receiver recognises its counter and drops the copy.
                Err(_) => {}
            }
        }
        for (left, datagram) in datagrams.iter().enumerate() {
            match self.transmit(datagram.sealed(), route) {
                Ok(()) => self.has_left(datagram),
                Err(error) if is_full(&error) => {
                    let busy = self.found_full(peer);
                    return if left > 0 { Ok(left) } else { Err(busy) };
                }
                Err(error) => self.statistics.send_failed(&error),
            }
        }
        Ok(datagrams.len())
    }

    fn has_left(&self, datagram: &Datagram) {
        self.statistics.add(UdpCount::DatagramsSent, 1);
        self.statistics.add(UdpCount::PacketsSent, datagram.len() as u64);
    }

    /// Notes that the kernel takes no more datagrams for a neighbour.
    fn found_full(&self, peer: &Peer) -> LinkBusy {
        self.statistics.add(UdpCount::Busy, 1);
        peer.full.store(true, Ordering::Release);
        self.blocked.store(true, Ordering::Release);
        // The polling thread may already wait in its sockets, without waiting for room in the send queue. It is woken
        // to do so.
        self.polling.wake().wake();
        LinkBusy
    }

    /// The socket that sends to a neighbour.
    pub(super) fn sending(&self, route: &Route) -> Arc<Inbound> {
        Arc::clone(route.connected.as_ref().unwrap_or(&self.strangers))
    }

    /// Whether the kernel takes a datagram for a neighbour, as far as this node knows.
    pub(super) fn takes(&self, peer: &Peer, route: &Route) -> bool {
        if peer.full.load(Ordering::Acquire) && socket::takes(&self.sending(route).socket) {
            peer.full.store(false, Ordering::Release);
        }
        !peer.full.load(Ordering::Acquire)
    }

    /// The sockets for which the kernel was found to take no more datagrams.
    pub(super) fn full(&self) -> Vec<Arc<Inbound>> {
        let full = self.peers.iter().filter(|peer| peer.full.load(Ordering::Acquire));
        full.filter_map(|peer| lock(&peer.route).as_ref().map(|route| self.sending(route))).collect()
    }

    /// Hands a datagram to the kernel.
    pub(super) fn transmit(&self, bytes: &[u8], route: &mut Route) -> io::Result<()> {
        if let Some(connected) = &route.connected {
            match self.sent(|| connected.socket.send(bytes)) {
                Ok(()) => return Ok(()),
                Err(error) if is_full(&error) => return Err(error),
                Err(error) => self.doubt_segments(route, &error),
            }
        }
        retried(|| self.strangers.socket.send_to(bytes, route.address))
    }

    /// Hands datagrams to the kernel in one call, all of one length except the last: all of them leave, or none.
    fn transmit_segmented(&self, datagrams: &[Datagram], route: &mut Route) -> io::Result<()> {
        let full = if self.has_keys { MAX_KEYED_BYTES } else { MAX_DATAGRAM_BYTES };
        let Some(socket) = route.segmenting(full) else { return Err(io::ErrorKind::Unsupported.into()) };
        let slices: [IoSlice<'_>; SEGMENTS] = std::array::from_fn(|number| {
            IoSlice::new(datagrams.get(number).map_or(&[], |datagram| datagram.sealed()))
        });
        let sent = self.sent(|| socket::send_all(socket, &slices[..datagrams.len()]));
        if let Err(error) = &sent {
            self.doubt_segments(route, error);
        }
        sent
    }

    /// Sends over a connected socket.
    fn sent(&self, mut send: impl FnMut() -> io::Result<usize>) -> io::Result<()> {
        let sent = retried(&mut send);
        let Err(error) = &sent else { return sent };
        if error.kind() != io::ErrorKind::ConnectionRefused {
            return sent;
        }
        // The error concerns an earlier datagram; the kernel has not sent this datagram yet.
        self.statistics.send_failed(error);
        retried(send)
    }

    /// Stops cutting calls into datagrams on this route if the error says that the kernel refuses to cut them: the
    /// network takes no full datagrams in one piece (EINVAL, EMSGSIZE), or cannot compute the checksums of the pieces
    /// (EIO). From then on each datagram leaves by itself. Other errors concern earlier datagrams, or do not last.
    fn doubt_segments(&self, route: &mut Route, error: &io::Error) {
        let refused = [Errno::INVAL, Errno::IO, Errno::MSGSIZE];
        if Errno::from_io_error(error).is_some_and(|errno| refused.contains(&errno))
            && route.segment_no_more()
        {
            self.statistics.add(UdpCount::SegmentsRefused, 1);
        }
    }
}

fn is_full(error: &io::Error) -> bool {
    error.kind() == io::ErrorKind::WouldBlock
}

/// Repeats the call while a signal interrupts it.
fn retried(mut send: impl FnMut() -> io::Result<usize>) -> io::Result<()> {
    loop {
        match send() {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            sent => return sent.map(|_| ()),
        }
    }
}
