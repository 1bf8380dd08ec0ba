//! Waits for datagrams in the link's sockets, and decides which thread a datagram wakes.
//!
//! Two epoll instances watch each socket that is connected to a neighbour, both with EPOLLEXCLUSIVE: the leader's first, then
//! the polling thread's. The kernel goes through the two instances in this order and stops at the first instance in which a
//! thread sleeps. So a datagram wakes only the leader. If no thread leads, or the leader is already awake, the datagram wakes
//! the polling thread. When a leader begins or ends its wait, nothing needs to be changed, and no thread is woken.
//!
//! The order decides only which thread is woken, never whether one is woken: an instance without a waiting thread
//! keeps its events, and both instances are level-triggered. Only the polling thread's instance watches the socket of
//! strangers, so datagrams of strangers wake no task (D155).

use super::UdpError;
use super::socket::Wake;
use crate::clock;
use rustix::event::epoll::{self, CreateFlags, EventData, EventFlags};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::io;
use std::mem::MaybeUninit;
use std::net::UdpSocket;
use std::os::fd::OwnedFd;
use std::time::{Duration, Instant};

/// The event data of the event counter. The event data of a socket are the socket's number.
const WAKE: u64 = u64::MAX;
/// The most events that one wait reports. If there are more, the kernel reports them with the next waits.
const AT_ONCE: usize = 16;

/// Waits shorter than this use a precise timeout, because epoll's timeout has whole milliseconds.
const COARSE: Duration = Duration::from_millis(2);
const NOW: Timespec = Timespec { tv_sec: 0, tv_nsec: 0 };
/// The kernel may end a wait late, by a thousandth of its length. So a long wait is made of two waits. The first is shorter
/// by this fraction of the length, which is twice that lateness. The second is short and exact, and ends on time.
const LATE: u32 = 500;

/// One epoll instance with sockets and an event counter.
pub(super) struct Watch {
    epoll: OwnedFd,
    wake: Wake,
    /// Which event is reported first if there are both a datagram and a wake-up: the wake-up if this is true. The
    /// other event ends the next wait.
    wake_first: bool,
}

/// How a wait ended.
#[derive(Clone, Copy, Debug)]
pub(super) enum Seen {
    Readable(ReadySockets),
    Woken,
    TimedOut,
}

/// The numbers of the sockets that have something to receive, in the order in which they got it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ReadySockets {
    places: [u32; AT_ONCE],
    count: usize,
}

impl ReadySockets {
    pub(super) fn places(&self) -> impl Iterator<Item = u32> + '_ {
        self.places[..self.count].iter().copied()
    }

    pub(super) const fn is_empty(&self) -> bool {
        self.count == 0
    }

    const fn push(&mut self, place: u32) {
        self.places[self.count] = place;
        self.count += 1;
    }
}

impl Watch {
    pub(super) fn new(wake_first: bool) -> Result<Self, UdpError> {
        let make = || -> io::Result<OwnedFd> { Ok(epoll::create(CreateFlags::CLOEXEC)?) };
        let (epoll, wake) = (make().map_err(UdpError::Wake)?, Wake::new()?);
        epoll::add(&epoll, wake.fd(), EventData::new_u64(WAKE), EventFlags::IN)
            .map_err(|errno| UdpError::Wake(errno.into()))?;
        Ok(Self { epoll, wake, wake_first })
    }

    /// Watches a socket that no other epoll instance watches. `place` is the socket's number.
    pub(super) fn add_alone(&self, socket: &UdpSocket, place: u32) -> io::Result<()> {
        Ok(epoll::add(&self.epoll, socket, EventData::new_u64(place.into()), EventFlags::IN)?)
    }

    /// Watches a socket that was added with [`add_alone`](Self::add_alone), or stops watching it until the next call.
    pub(super) fn heed(&self, socket: &UdpSocket, place: u32, heeds: bool) -> io::Result<()> {
        let events = if heeds { EventFlags::IN } else { EventFlags::empty() };
        Ok(epoll::modify(&self.epoll, socket, EventData::new_u64(place.into()), events)?)
    }

    /// Watches a socket. The kernel serves this epoll instance after all instances to which the socket was added
    /// before. Closing the socket removes it.
    pub(super) fn add(&self, socket: &UdpSocket, place: u32) -> io::Result<()> {
        let exclusive = EventFlags::IN | EventFlags::EXCLUSIVE;
        Ok(epoll::add(&self.epoll, socket, EventData::new_u64(place.into()), exclusive)?)
    }

    pub(super) const fn epoll(&self) -> &OwnedFd {
        &self.epoll
    }

    pub(super) const fn wake(&self) -> &Wake {
        &self.wake
    }

    /// Waits until a socket has something to receive, a wake-up comes, or the instant `until` has passed.
    pub(super) fn wait(&self, until: Option<Instant>) -> io::Result<Seen> {
        loop {
            let left = until.map(|until| until.saturating_duration_since(Instant::now()));
            if let Some(seen) = self.wait_some(left)? {
                return Ok(seen);
            }
        }
    }

    /// As [`wait`](Self::wait), for at most `left`. Returns `None` if the wait ended early, so that the caller must
    /// wait again.
    pub(super) fn wait_some(&self, left: Option<Duration>) -> io::Result<Option<Seen>> {
        clock::sleeps();
        let seen = match left {
            Some(left) if left < COARSE => self.wait_exactly(left),
            left => self.wait_long(left),
        };
        match seen {
            Ok(Seen::TimedOut) if left.is_some_and(|left| left.is_zero()) => Ok(Some(Seen::TimedOut)),
            Ok(Seen::TimedOut) | Err(rustix::io::Errno::INTR) => Ok(None),
            Ok(seen) => Ok(Some(seen)),
            Err(errno) => Err(errno.into()),
        }
    }

    /// The sockets that have something to receive now. A wake-up stays for the next wait.
    pub(super) fn look(&self) -> ReadySockets {
        self.events(Some(&NOW)).map(|(told, _)| told).unwrap_or_default()
    }

    fn wait_long(&self, left: Option<Duration>) -> rustix::io::Result<Seen> {
        let whole = left.map(|left| {
            let millis = (left - left / LATE).as_millis().min(i32::MAX.unsigned_abs().into());
            Timespec::try_from(Duration::from_millis(u64::try_from(millis).unwrap_or(u64::MAX)))
        });
        let (told, wake) = self.events(whole.and_then(Result::ok).as_ref())?;
        Ok(self.seen(told, wake))
    }

    /// Waits with a precise timeout. A datagram may then wake other threads, too, which does no harm because the wait
    /// is short.
    fn wait_exactly(&self, left: Duration) -> rustix::io::Result<Seen> {
        if !left.is_zero() {
            poll(&mut [PollFd::new(&self.epoll, PollFlags::IN)], Timespec::try_from(left).ok().as_ref())?;
        }
        let (told, wake) = self.events(Some(&NOW))?;
        Ok(self.seen(told, wake))
    }

    /// The sockets that get something to receive within `left`, and whether there is a wake-up. A socket's error
    /// (EPOLLERR) is reported by its next receive call.
    fn events(&self, left: Option<&Timespec>) -> rustix::io::Result<(ReadySockets, bool)> {
        let mut room = [MaybeUninit::uninit(); AT_ONCE];
        let (events, _) = epoll::wait(&self.epoll, &mut room, left)?;
        let (mut told, mut wake) = (ReadySockets::default(), false);
        for event in events {
            match u32::try_from(event.data.u64()) {
                Ok(place) => told.push(place),
                Err(_) => wake = true,
            }
        }
        Ok((told, wake))
    }

    fn seen(&self, told: ReadySockets, wake: bool) -> Seen {
        if wake && (self.wake_first || told.is_empty()) {
            self.wake.clear();
            Seen::Woken
        } else if told.is_empty() {
            Seen::TimedOut
        } else {
            Seen::Readable(told)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wait_in_the_sockets_makes_the_thread_ask_the_kernel_for_the_time() {
        let watch = Watch::new(true).expect("an epoll instance");
        assert!(clock::is_told_of(|| drop(watch.wait(Some(Instant::now())))));
        assert!(clock::is_told_of(|| {
            super::super::socket::wait_for_room(watch.epoll(), &[], Some(Instant::now())).expect("a wait");
        }));
    }
}
