//! Waiting for the socket: who is told of a datagram.
//!
//! Two epoll instances look at the socket, both with EPOLLEXCLUSIVE: the leader's first, then that of the thread that
//! polls. The kernel goes through them in this order and ends at the first one that a thread sleeps in. So a datagram
//! wakes the leader alone; one that comes while nobody leads, or while the leader is already awake, wakes the one that
//! polls. Nothing has to be switched over when a leader comes or goes, and no thread is woken for it.
//!
//! That order decides who is woken, never whether somebody is: an instance with nobody in it keeps what it was told, and
//! both are level-triggered.

use super::UdpError;
use super::socket::Wake;
use crate::lead::Came;
use rustix::event::epoll::{self, CreateFlags, EventData, EventFlags};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::io;
use std::mem::MaybeUninit;
use std::net::UdpSocket;
use std::os::fd::OwnedFd;
use std::time::{Duration, Instant};

const SOCKET: u64 = 0;
const WAKE: u64 = 1;

/// Below this the kernel's clock for epoll, whole milliseconds, is too coarse.
const COARSE: Duration = Duration::from_millis(2);
/// The kernel may end a wait later than asked by a thousandth of it. So a first wait leaves out twice that, and another
/// one, short and exact, ends on time.
const LATE: u32 = 500;

/// One epoll instance with the socket and an event counter.
pub(super) struct Watch {
    epoll: OwnedFd,
    wake: Wake,
    /// What is told where both are ready.
    first: Seen,
}

/// What a wait ended with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Seen {
    Readable,
    Woken,
    TimedOut,
}

impl Watch {
    /// Looks at the socket after all that were made before it. `first` is told where there are both a datagram and a
    /// wake; the other one ends the next wait.
    pub(super) fn new(socket: &UdpSocket, first: Seen) -> Result<Self, UdpError> {
        let make = || -> io::Result<OwnedFd> {
            let epoll = epoll::create(CreateFlags::CLOEXEC)?;
            let exclusive = EventFlags::IN | EventFlags::EXCLUSIVE;
            epoll::add(&epoll, socket, EventData::new_u64(SOCKET), exclusive)?;
            Ok(epoll)
        };
        let (epoll, wake) = (make().map_err(UdpError::Wake)?, Wake::new()?);
        epoll::add(&epoll, wake.fd(), EventData::new_u64(WAKE), EventFlags::IN)
            .map_err(|errno| UdpError::Wake(errno.into()))?;
        Ok(Self { epoll, wake, first })
    }

    pub(super) const fn wake(&self) -> &Wake {
        &self.wake
    }

    /// Waits until the socket has something, a wake, or `until`.
    pub(super) fn wait(&self, socket: &UdpSocket, until: Option<Instant>) -> io::Result<Seen> {
        loop {
            let left = until.map(|until| until.saturating_duration_since(Instant::now()));
            if let Some(seen) = self.wait_some(socket, left)? {
                return Ok(seen);
            }
        }
    }

    /// As [`wait`](Self::wait), for at most `left`, but it may end without anything: then there is more to wait.
    pub(super) fn wait_some(&self, socket: &UdpSocket, left: Option<Duration>) -> io::Result<Option<Seen>> {
        let seen = match left {
            Some(left) if left < COARSE => self.wait_exactly(socket, left),
            left => self.wait_long(left),
        };
        match seen {
            Ok(Seen::TimedOut) if left.is_some_and(|left| left.is_zero()) => Ok(Some(Seen::TimedOut)),
            Ok(Seen::TimedOut) | Err(rustix::io::Errno::INTR) => Ok(None),
            Ok(seen) => Ok(Some(seen)),
            Err(errno) => Err(errno.into()),
        }
    }

    fn wait_long(&self, left: Option<Duration>) -> rustix::io::Result<Seen> {
        let whole = left.map(|left| {
            let millis = (left - left / LATE).as_millis().min(i32::MAX.unsigned_abs().into());
            Timespec::try_from(Duration::from_millis(u64::try_from(millis).unwrap_or(u64::MAX)))
        });
        let whole = whole.and_then(Result::ok);
        let mut room = [MaybeUninit::uninit(); 2];
        let (events, _) = epoll::wait(&self.epoll, &mut room, whole.as_ref())?;
        let of = |what: u64| events.iter().any(|event| event.data.u64() == what);
        Ok(self.seen(of(SOCKET), of(WAKE)))
    }

    /// For so short a time it does no harm that others are woken, too.
    fn wait_exactly(&self, socket: &UdpSocket, left: Duration) -> rustix::io::Result<Seen> {
        let mut fds = [PollFd::new(socket, PollFlags::IN), PollFd::new(self.wake.fd(), PollFlags::IN)];
        poll(&mut fds, Timespec::try_from(left).ok().as_ref())?;
        // An error of the socket (POLLERR) is fetched by receiving.
        Ok(self.seen(!fds[0].revents().is_empty(), !fds[1].revents().is_empty()))
    }

    fn seen(&self, socket: bool, wake: bool) -> Seen {
        match (socket, wake) {
            (false, false) => Seen::TimedOut,
            (true, false) => Seen::Readable,
            (true, true) if self.first == Seen::Readable => Seen::Readable,
            (_, true) => {
                self.wake.clear();
                Seen::Woken
            }
        }
    }
}

impl From<Seen> for Came {
    fn from(seen: Seen) -> Self {
        match seen {
            Seen::Readable => Self::Something,
            Seen::Woken => Self::Nothing,
            Seen::TimedOut => Self::Time,
        }
    }
}
