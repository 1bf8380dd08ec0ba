//! The sockets that a link receives from: one for each neighbour whose address is known, and one for all others (D155).
//!
//! The kernel gives a datagram to the socket that is connected to where it comes from. So whoever else floods the node's
//! port fills the socket of strangers, and no other. That one is where a neighbour is heard whose address is not known or has
//! changed; what comes there is judged in the same way, and a visit takes less of it.

use super::UdpLink;
use super::socket;
use crate::link::residency::Reading;
use crate::lock::lock;
use crate::sync::turn::Turn;
use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The place of the socket of strangers. That of a neighbour is its position and one.
pub(super) const STRANGERS: u32 = 0;

/// For how long nobody looks at the socket of strangers after a visit that found no end of what means nothing: a thread that did
/// nothing but turn a flood away would take its core from the tasks.
const REST: Duration = Duration::from_millis(1);

/// A socket that receives.
pub(super) struct Inbound {
    pub(super) socket: UdpSocket,
    /// To where it is connected.
    pub(super) from: Option<SocketAddr>,
    queue: Turn<Queue>,
}

/// What is known of a socket's queue in the kernel.
pub(super) struct Queue {
    /// The clocks when the socket was last seen empty.
    pub(super) empty: Reading,
    /// The clocks when a datagram was last taken.
    pub(super) last: Reading,
    /// The kernel's count of datagrams that found the queue full: since the socket was made, around the wrap.
    pub(super) dropped: u32,
}

impl Inbound {
    /// `empty`: the clocks before anything can have come in.
    pub(super) fn new(socket: UdpSocket, from: Option<SocketAddr>, empty: Reading) -> Self {
        Self { socket, from, queue: Turn::new(Queue { empty, last: empty, dropped: 0 }) }
    }

    /// Whether it is the one that receives what comes to none of a neighbour.
    pub(super) const fn is_of_strangers(&self) -> bool {
        self.from.is_none()
    }

    /// Takes in with `receive`, unless another thread is at it, which then does so once more in place of this one. False where
    /// that is so.
    pub(super) fn try_take_in(&self, mut receive: impl FnMut(&mut Queue)) -> bool {
        let mut is_done = false;
        self.queue.want();
        self.queue.take(|queue| {
            receive(queue);
            is_done = true;
        });
        is_done
    }

    /// As [`try_take_in`](Self::try_take_in), but waits for the other thread. For the one that polls: it is told of a datagram until
    /// somebody has taken it, and would ask for it again and again.
    pub(super) fn take_in(&self, mut receive: impl FnMut(&mut Queue)) {
        if !self.try_take_in(&mut receive) {
            self.queue.take_after(receive);
        }
    }
}

impl UdpLink {
    /// Nobody looks at the socket of strangers for a while. Called by the thread that polls.
    pub(super) fn rest_from_strangers(&self) {
        // What the kernel does not let go of is looked at all the same.
        if self.polling.heed(&self.strangers.socket, STRANGERS, false).is_ok() {
            *lock(&self.rest) = Some(Instant::now() + REST);
        }
    }

    /// Ends the rest from strangers if it is over. Returns until when it lasts.
    pub(super) fn end_of_rest(&self) -> Option<Instant> {
        let mut rest = lock(&self.rest);
        if rest.is_some_and(|until| until <= Instant::now()) {
            // Fails only where the socket is not there to be looked at.
            let _ = self.polling.heed(&self.strangers.socket, STRANGERS, true);
            *rest = None;
        }
        *rest
    }

    /// The socket at a place, if there is one.
    pub(super) fn inbound(&self, place: u32) -> Option<Arc<Inbound>> {
        match usize::try_from(place).ok()?.checked_sub(1) {
            None => Some(Arc::clone(&self.strangers)),
            Some(position) => lock(&self.peers.get(position)?.inbound).clone(),
        }
    }

    /// The socket that is connected to where the neighbour at `position` receives: the one that it has, or a new one. None
    /// where the kernel makes none; then the one of strangers serves it.
    pub(super) fn connected(&self, position: usize, address: SocketAddr) -> Option<Arc<Inbound>> {
        let mut inbound = lock(&self.peers[position].inbound);
        if inbound.as_ref().is_none_or(|inbound| inbound.from != Some(address)) {
            // What waits in the former socket came from where the neighbour no longer is: it goes with it.
            *inbound = self.connect(position, address).ok().map(Arc::new);
        }
        inbound.clone()
    }

    fn connect(&self, position: usize, address: SocketAddr) -> io::Result<Inbound> {
        let empty = Reading::take();
        let socket = {
            let _one_at_a_time = lock(&self.binding);
            socket::connect_beside(&self.strangers.socket, self.local, address, self.asked)?
        };
        let place = u32::try_from(position + 1).map_err(io::Error::other)?;
        // In this order.
        self.leader.add(&socket, place)?;
        self.polling.add(&socket, place)?;
        Ok(Inbound::new(socket, Some(address), empty))
    }
}
