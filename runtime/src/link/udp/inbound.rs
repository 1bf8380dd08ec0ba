//! The sockets from which a link receives: one for each neighbour whose address is known, and one for all other senders
//! (D155).
//!
//! The kernel gives a datagram to the socket that is connected to its source address. So a flood from elsewhere fills the
//! socket of strangers, and no other socket. The socket of strangers also receives from a neighbour whose address is not
//! known or has changed. Its datagrams are judged like those of other sockets, but each visit to it takes fewer of them.

use super::UdpLink;
use super::socket;
use crate::link::residency::Reading;
use crate::lock::lock;
#[cfg(not(test))]
use crate::sync::combining_lock::CombiningLock;
use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::time::{Duration, Instant};
#[cfg(test)]
use waiting_lock::CombiningLock;

/// The number of the socket of strangers. The number of a neighbour's socket is the neighbour's position plus one.
pub(super) const STRANGERS: u32 = 0;

/// For how long no thread reads the socket of strangers after a visit that found nothing but a flood. Otherwise the
/// thread would only drop the flood, and the tasks would lose that core.
const REST: Duration = Duration::from_millis(1);

/// A socket from which the link receives.
pub(super) struct Inbound {
    pub(super) socket: UdpSocket,
    /// The address to which the socket is connected; `None` for the socket of strangers.
    pub(super) from: Option<SocketAddr>,
    queue: CombiningLock<Queue>,
}

/// What this node knows about a socket's queue in the kernel.
pub(super) struct Queue {
    /// Both clocks when the socket was last seen empty.
    pub(super) empty: Reading,
    /// Both clocks when a datagram was last taken from the socket.
    pub(super) last: Reading,
    /// The kernel's count of datagrams that found the queue full, since the socket was made; it wraps around.
    pub(super) dropped: u32,
}

impl Inbound {
    /// Wraps a socket. `empty` is a reading of the clocks from before any datagram can have arrived.
    pub(super) fn new(socket: UdpSocket, from: Option<SocketAddr>, empty: Reading) -> Self {
        Self { socket, from, queue: CombiningLock::new(Queue { empty, last: empty, dropped: 0 }) }
    }

    /// Whether this is the socket of strangers, which gets all datagrams that no neighbour's socket gets.
    pub(super) const fn is_of_strangers(&self) -> bool {
        self.from.is_none()
    }

    /// Receives from the socket with `receive`. If another thread is receiving already, returns false, and that
    /// thread receives once more, so that no datagram stays in the socket.
    pub(super) fn try_take_in(&self, mut receive: impl FnMut(&mut Queue)) -> bool {
        let mut is_done = false;
        self.queue.want();
        self.queue.take(|queue| {
            receive(queue);
            is_done = true;
        });
        is_done
    }

    /// As [`try_take_in`](Self::try_take_in), but waits for the other thread. The polling thread calls this: the kernel
    /// reports a datagram to it until some thread has taken the datagram, so without the wait it would ask again and again.
    pub(super) fn take_in(&self, mut receive: impl FnMut(&mut Queue)) {
        if !self.try_take_in(&mut receive) {
            self.queue.take_after(receive);
        }
    }
}

impl UdpLink {
    /// Leaves the socket of strangers unread for a while. Only the polling thread calls this.
    pub(super) fn rest_from_strangers(&self) {
        // If the kernel refuses this, the socket stays watched.
        if self.polling.heed(&self.strangers.socket, STRANGERS, false).is_ok() {
            *lock(&self.rest) = Some(Instant::now() + REST);
        }
    }

    /// Ends the pause of the socket of strangers if its time is over. Otherwise returns the instant at which the pause ends.
    pub(super) fn end_of_rest(&self) -> Option<Instant> {
        let mut rest = lock(&self.rest);
        if rest.is_some_and(|until| until <= Instant::now()) {
            // This fails only if the socket is not watched at all.
            let _ = self.polling.heed(&self.strangers.socket, STRANGERS, true);
            *rest = None;
        }
        *rest
    }

    /// The socket with this number, if there is one.
    pub(super) fn inbound(&self, place: u32) -> Option<Arc<Inbound>> {
        match usize::try_from(place).ok()?.checked_sub(1) {
            None => Some(Arc::clone(&self.strangers)),
            Some(position) => lock(&self.peers.get(position)?.inbound).clone(),
        }
    }

    /// The socket that is connected to the address of the neighbour at `position`: the current socket, or a new one.
    /// `None` if the kernel makes none; then the socket of strangers serves the neighbour.
    pub(super) fn connected(&self, position: usize, address: SocketAddr) -> Option<Arc<Inbound>> {
        let mut inbound = lock(&self.peers[position].inbound);
        if inbound.as_ref().is_none_or(|inbound| inbound.from != Some(address)) {
            // Datagrams in the former socket came from the neighbour's former address. They are dropped with that
            // socket.
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
        // The order of these two calls matters, because it decides which thread the kernel wakes (see `watch`).
        self.leader.add(&socket, place)?;
        self.polling.add(&socket, place)?;
        Ok(Inbound::new(socket, Some(address), empty))
    }
}

/// Unit tests use this simple lock, because the real lock's primitives then work only in an exploration of schedules.
#[cfg(test)]
mod waiting_lock {
    use crate::lock::lock;
    use std::sync::Mutex;

    pub struct CombiningLock<T>(Mutex<T>);

    impl<T> CombiningLock<T> {
        pub const fn new(inside: T) -> Self {
            Self(Mutex::new(inside))
        }

        pub const fn want(&self) {
            let _ = self;
        }

        pub fn take(&self, mut work: impl FnMut(&mut T)) {
            work(&mut lock(&self.0));
        }

        pub fn take_after(&self, work: impl FnMut(&mut T)) {
            self.take(work);
        }
    }
}
