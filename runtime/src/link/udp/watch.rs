//! Waiting for the sockets: who is told of a datagram.
//!
//! Two epoll instances look at each socket that is connected to a neighbour, both with EPOLLEXCLUSIVE: the leader's first, then
//! that of the thread that polls. The kernel goes through them in this order and ends at the first one that a thread sleeps in.
//! So a datagram wakes the leader alone; one that comes while nobody leads, or while the leader is already awake, wakes the one
//! that polls. Nothing has to be switched over when a leader comes or goes, and no thread is woken for it.
//!
//! That order decides who is woken, never whether somebody is: an instance with nobody in it keeps what it was told, and
//! both are level-triggered. With the instance of the thread that polls alone the socket of strangers is looked at: what they send
//! wakes no task (D155).

use super::UdpError;
use super::socket::Wake;
use rustix::event::epoll::{self, CreateFlags, EventData, EventFlags};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::io;
use std::mem::MaybeUninit;
use std::net::UdpSocket;
use std::os::fd::OwnedFd;
use std::time::{Duration, Instant};

/// What stands for the event counter; a socket is told by its place.
const WAKE: u64 = u64::MAX;
/// How many events are told at once, at most. The kernel tells the others with the next wait, in turns.
const AT_ONCE: usize = 16;

/// Below this the kernel's clock for epoll, whole milliseconds, is too coarse.
const COARSE: Duration = Duration::from_millis(2);
const NOW: Timespec = Timespec { tv_sec: 0, tv_nsec: 0 };
/// The kernel may end a wait later than asked by a thousandth of it. So a first wait leaves out twice that, and another
/// one, short and exact, ends on time.
const LATE: u32 = 500;

/// One epoll instance with sockets and an event counter.
pub(super) struct Watch {
    epoll: OwnedFd,
    wake: Wake,
    /// Whether a wake is told where there are both a datagram and a wake; else the datagram is. The other one ends the next wait.
    wake_first: bool,
}

/// What a wait ended with.
#[derive(Clone, Copy, Debug)]
pub(super) enum Seen {
    Readable(Told),
    Woken,
    TimedOut,
}

/// The places of sockets that have something, the one first that had it first.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Told {
    places: [u32; AT_ONCE],
    count: usize,
}

impl Told {
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

    /// Looks at a socket that no other instance looks at.
    pub(super) fn add_alone(&self, socket: &UdpSocket, place: u32) -> io::Result<()> {
        Ok(epoll::add(&self.epoll, socket, EventData::new_u64(place.into()), EventFlags::IN)?)
    }

    /// Looks at such a socket, or does not for the time being.
    pub(super) fn heed(&self, socket: &UdpSocket, place: u32, heeds: bool) -> io::Result<()> {
        let events = if heeds { EventFlags::IN } else { EventFlags::empty() };
        Ok(epoll::modify(&self.epoll, socket, EventData::new_u64(place.into()), events)?)
    }

    /// Looks at a socket, too, after all instances to which it was added before. It goes when it is closed.
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

    /// Waits until a socket has something, a wake, or `until`.
    pub(super) fn wait(&self, until: Option<Instant>) -> io::Result<Seen> {
        loop {
            let left = until.map(|until| until.saturating_duration_since(Instant::now()));
            if let Some(seen) = self.wait_some(left)? {
                return Ok(seen);
            }
        }
    }

    /// As [`wait`](Self::wait), for at most `left`, but it may end without anything: then there is more to wait.
    pub(super) fn wait_some(&self, left: Option<Duration>) -> io::Result<Option<Seen>> {
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

    /// The sockets that have something now. Takes no wake.
    pub(super) fn look(&self) -> Told {
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

    /// For so short a time it does no harm that others are woken, too.
    fn wait_exactly(&self, left: Duration) -> rustix::io::Result<Seen> {
        if !left.is_zero() {
            poll(&mut [PollFd::new(&self.epoll, PollFlags::IN)], Timespec::try_from(left).ok().as_ref())?;
        }
        let (told, wake) = self.events(Some(&NOW))?;
        Ok(self.seen(told, wake))
    }

    /// What the kernel has to tell within `left`: sockets, and whether a wake. An error of a socket (EPOLLERR) is fetched by
    /// receiving.
    fn events(&self, left: Option<&Timespec>) -> rustix::io::Result<(Told, bool)> {
        let mut room = [MaybeUninit::uninit(); AT_ONCE];
        let (events, _) = epoll::wait(&self.epoll, &mut room, left)?;
        let (mut told, mut wake) = (Told::default(), false);
        for event in events {
            match u32::try_from(event.data.u64()) {
                Ok(place) => told.push(place),
                Err(_) => wake = true,
            }
        }
        Ok((told, wake))
    }

    fn seen(&self, told: Told, wake: bool) -> Seen {
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
