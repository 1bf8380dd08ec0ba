//! The link over UDP.
//!
//! Each neighbour whose address is known has a socket of its own, on the node's one address. One more socket serves all other
//! senders (`inbound`). Packets that are queued for one neighbour leave in one datagram. A lone packet leaves at once: it
//! does not wait for others. Several full datagrams leave in one call if the kernel can cut its data into datagrams, and
//! arrive in one call if the kernel has merged them. Errors that the socket reports are counted, and never end the link.
//!
//! An arriving packet is charged the larger of two times: the link's declared bound plus its wait in this node's
//! kernel, and the time for its whole hop that the clocks in the envelopes show (`delay`). So a packet never looks
//! younger than it is, even if its receiver was stopped, or its sender between the reading of the clock and `sendto`.
//!
//! Addresses come only from the address book, never from traffic. A datagram is judged by its content (digests, sender,
//! receiver, session, counter), not by its source address: this node accepts datagrams of a neighbour that sends from another
//! port, but no sender draws traffic to itself. In the envelope's checksum mode this protects from accidents, not from
//! attackers: a process that reaches the socket can forge datagrams. Keys ([`UdpLink::with_keys`]) protect from both (D191).

mod delay;
mod goodbye;
mod greet;
mod health;
mod inbound;
mod integrity;
mod keyed;
pub mod keys;
mod leading;
mod options;
mod peer;
mod receive;
mod send;
mod session;
mod socket;
mod statistics;
mod watch;

pub use integrity::{FAILURES, WINDOW};
pub use options::{NotANeighbour, UdpError, UdpOptions};
pub use peer::Refusal;
pub use statistics::UdpCount;

use super::{Leading, Link, LinkBusy, PollEnd, Sink};
use crate::clock;
use crate::lock::lock;
use imrs_protocol::{Incarnation, NodeId, NodeTable, Packet, Ticks};
use imrs_wire::envelope::{MAX_PACKETS, Session};
use imrs_wire::obs::LinkReport;
use inbound::{Inbound, STRANGERS};
use peer::{Peer, Route};
use receive::Room;
pub(crate) use send::SEGMENTS;
use socket::{Asked, Waited};
use statistics::Statistics;
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU16, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};
use watch::{ReadySockets, Seen, Watch};

/// The number of receive buffers: more than the number of threads that receive at once.
const ROOMS: usize = 16;

/// A UDP link of one node to all its neighbours.
///
/// [`bind`](Self::bind) it, tell the neighbours its [`local_address`](Self::local_address), and set their addresses with
/// [`set_address`](Self::set_address), which may be called again at any time. The link is not ready for a neighbour without
/// an address: packets for it stay in the transit buffer, and a packet that expires there has never left.
pub struct UdpLink {
    table: NodeTable,
    options: UdpOptions,
    /// The incarnation of the node, and whether an earlier incarnation may have taken requests.
    identity: AtomicU16,
    /// Whether the node does not know its incarnation yet, and so asks its neighbours.
    uncounted: AtomicBool,
    session: Session,
    /// Whether keys close the datagrams of this link.
    has_keys: bool,
    /// Whether a neighbour may still owe an answer to a request for a session.
    knocks: AtomicBool,
    /// The socket that was bound first. It receives all datagrams that do not come from a neighbour's address.
    strangers: Arc<Inbound>,
    /// The socket options that every receiving socket asks for.
    asked: Asked,
    /// A lock that is held while another socket is bound to the node's address.
    binding: Mutex<()>,
    local: SocketAddr,
    /// Whether the kernel can cut the data of one call into datagrams.
    segments: bool,
    /// The epoll instance in which the leader waits.
    leader: Watch,
    /// The epoll instance in which the polling thread waits.
    polling: Watch,
    /// Until when no thread reads the strangers' socket, because there was a flood.
    rest: Mutex<Option<Instant>>,
    /// The sockets that the kernel reported to the leader, and from which the leader has not received yet.
    told: Mutex<ReadySockets>,
    /// Receive buffers, one for each receiving thread: the polling thread, the leader, and threads that spin before they sleep.
    rooms: Mutex<Vec<Room>>,
    /// All neighbours, ascending by node id.
    peers: Box<[Peer]>,
    poll: Mutex<Poll>,
    poll_changed: Condvar,
    /// Whether the kernel's send queue for any neighbour was found full.
    blocked: AtomicBool,
    /// Whether [`Link::wake`] was called, and no poll has ended for that reason yet.
    woken: AtomicBool,
    /// Whether a neighbour got an address, and no poll has ended for that reason yet.
    address_known: AtomicBool,
    /// The origin of the clock that this node's envelopes show.
    origin: Instant,
    /// For how long the machine had been suspended at `origin`, in microseconds.
    suspended: u64,
    statistics: Statistics,
}

const fn identity(incarnation: Incarnation, restarted: bool) -> u16 {
    u16::from_be_bytes([restarted as u8, incarnation.0])
}

/// Draws 64 bits that no other start of any node has. The keys of a new hash state come from the system's random source.
fn new_session() -> Session {
    Session(RandomState::new().hash_one(Instant::now()))
}

/// The right to poll: one thread at a time polls, and the other threads wait until it stops.
struct Poll {
    taken: bool,
    /// How many threads wait for the right to poll.
    waiting: usize,
    /// How often the link was woken.
    wakes: u64,
}

impl UdpLink {
    /// A link of the node of `table`, bound to `address` (port 0 means any free port).
    pub fn bind(table: NodeTable, address: SocketAddr, options: UdpOptions) -> Result<Self, UdpError> {
        let (origin, suspended) = (Instant::now(), clock::look_for_suspend());
        let mut neighbours: Vec<NodeId> = table.neighbours(table.node).collect();
        neighbours.sort_unstable();
        let declared = |node| table.link_bound(table.node, node).unwrap_or(Ticks::ZERO);
        let peers: Box<[Peer]> = neighbours.into_iter().map(|node| Peer::new(node, declared(node))).collect();
        let (socket, asked, empty) = socket::bind(address, options.queue_bytes, options.segments)?;
        let segments = options.segments && socket::segments(&socket);
        let local = socket.local_addr().map_err(|source| UdpError::Bind { address, source })?;
        let (leader, polling) = (Watch::new(false)?, Watch::new(true)?);
        polling.add_alone(&socket, STRANGERS).map_err(UdpError::Wake)?;
        let mut rooms = Vec::with_capacity(ROOMS);
        rooms.extend((0..2).map(|_| Room::new(asked)));
        Ok(Self {
            table,
            options,
            identity: AtomicU16::new(identity(options.incarnation, options.restarted)),
            uncounted: AtomicBool::new(false),
            session: new_session(),
            has_keys: false,
            knocks: AtomicBool::new(false),
            local,
            segments,
            leader,
            polling,
            rest: Mutex::default(),
            told: Mutex::default(),
            rooms: Mutex::new(rooms),
            strangers: Arc::new(Inbound::new(socket, None, empty)),
            asked,
            binding: Mutex::default(),
            peers,
            poll: Mutex::new(Poll { taken: false, waiting: 0, wakes: 0 }),
            poll_changed: Condvar::new(),
            blocked: AtomicBool::new(false),
            woken: AtomicBool::new(false),
            address_known: AtomicBool::new(false),
            origin,
            suspended,
            statistics: Statistics::default(),
        })
    }

    /// The address at which the link receives.
    #[must_use]
    pub const fn local_address(&self) -> SocketAddr {
        self.local
    }

    /// Sets the address of a neighbour; `None` says that it is not known. From now on, packets that wait for the
    /// neighbour can leave, and datagrams from the address come to a socket of their own.
    ///
    /// # Errors
    /// [`NotANeighbour`] if the node is no neighbour.
    pub fn set_address(&self, node: NodeId, address: Option<SocketAddr>) -> Result<(), NotANeighbour> {
        let (position, peer) = self.peer(node).ok_or(NotANeighbour(node))?;
        let mut route = lock(&peer.route);
        *route = address.map(|address| Route::new(address, self.connected(position, address), self.segments));
        drop(route);
        peer.met.store(false, Ordering::Relaxed);
        if address.is_some() {
            self.address_known.store(true, Ordering::Release);
            self.polling.wake().wake();
        }
        Ok(())
    }

    /// Sets the incarnation of the node, if it was not known when the socket was bound. This must come before the first
    /// packet is sent.
    pub fn set_incarnation(&self, incarnation: Incarnation, restarted: bool) {
        self.identity.store(identity(incarnation, restarted), Ordering::Release);
        self.uncounted.store(false, Ordering::Release);
    }

    /// The incarnation of this node, and whether an earlier one may have taken requests.
    fn identity(&self) -> (Incarnation, bool) {
        let [restarted, incarnation] = self.identity.load(Ordering::Acquire).to_be_bytes();
        (Incarnation(incarnation), restarted != 0)
    }

    /// The value of one counter.
    #[must_use]
    pub fn count(&self, of: UdpCount) -> u64 {
        self.statistics.get(of)
    }

    /// All counters by name.
    pub fn counts(&self) -> impl Iterator<Item = (&'static str, u64)> + '_ {
        UdpCount::ALL.iter().map(|&count| (count.name(), self.statistics.get(count)))
    }

    fn peer(&self, node: NodeId) -> Option<(usize, &Peer)> {
        let index = self.peers.binary_search_by_key(&node, |peer| peer.node).ok()?;
        Some((index, &self.peers[index]))
    }

    /// This node's clock at an instant, rounded down. It runs on while the machine is suspended (D153).
    fn micros(&self, at: Instant) -> u64 {
        let since = u64::try_from(at.saturating_duration_since(self.origin).as_micros()).unwrap_or(u64::MAX);
        since.saturating_add(clock::suspended().saturating_sub(self.suspended))
    }

    /// Waits until no other thread polls.
    ///
    /// # Errors
    /// The reason for which the wait ended without the right to poll.
    fn take_poll(&self, until: Option<Instant>) -> Result<OwnPoll<'_>, PollEnd> {
        let mut poll = lock(&self.poll);
        let wakes = poll.wakes;
        loop {
            if !std::mem::replace(&mut poll.taken, true) {
                return Ok(OwnPoll { link: self });
            }
            poll.waiting += 1;
            clock::sleeps();
            poll = match until.map(|until| until.saturating_duration_since(Instant::now())) {
                Some(Duration::ZERO) => {
                    poll.waiting -= 1;
                    return Err(PollEnd::TimedOut);
                }
                Some(left) => {
                    self.poll_changed.wait_timeout(poll, left).unwrap_or_else(PoisonError::into_inner).0
                }
                None => self.poll_changed.wait(poll).unwrap_or_else(PoisonError::into_inner),
            };
            poll.waiting -= 1;
            if poll.wakes != wakes {
                return Err(PollEnd::Woken);
            }
        }
    }

    /// Waits for a datagram or a wake-up. Returns `None` once a socket that was full takes datagrams again.
    fn wait(&self, until: Option<Instant>) -> io::Result<Option<Seen>> {
        loop {
            let pause = [self.end_of_rest(), self.knock()].into_iter().flatten().min();
            let seen = self.wait_once(until.into_iter().chain(pause).min())?;
            let is_over = || until.is_some_and(|until| until <= Instant::now());
            if !matches!(seen, Some(Seen::TimedOut)) || pause.is_none() || is_over() {
                return Ok(seen);
            }
        }
    }

    fn wait_once(&self, until: Option<Instant>) -> io::Result<Option<Seen>> {
        if self.blocked.swap(false, Ordering::AcqRel) {
            let full = self.full();
            if !full.is_empty() {
                self.blocked.store(true, Ordering::Release);
                return self.wait_for_room(&full, until);
            }
        }
        self.polling.wait(until).map(Some)
    }

    fn wait_for_room(&self, full: &[Arc<Inbound>], until: Option<Instant>) -> io::Result<Option<Seen>> {
        let full: Vec<&UdpSocket> = full.iter().map(|full| &full.socket).collect();
        loop {
            match socket::wait_for_room(self.polling.epoll(), &full, until)? {
                Waited::Writable => return Ok(None),
                Waited::TimedOut => return Ok(Some(Seen::TimedOut)),
                // Another thread may have taken the datagram since the kernel reported it.
                Waited::ReadySockets => match self.polling.wait_some(Some(Duration::ZERO))? {
                    Some(Seen::TimedOut) | None => {}
                    seen => return Ok(seen),
                },
            }
        }
    }

    /// Pauses after a failed wait, because the kernel lacks even the memory for a wait.
    fn wait_failed(&self) {
        self.statistics.add(UdpCount::ReceiveFailed, 1);
        std::thread::sleep(Duration::from_millis(1));
    }

    /// Why the poll must end, now that the event counter was raised; `None` if it must only check the socket again.
    fn end_of_wake(&self) -> Option<PollEnd> {
        if self.address_known.swap(false, Ordering::AcqRel) {
            if self.woken.load(Ordering::Acquire) {
                // Both causes have occurred, and each must end a poll of its own. So the next poll is ended, too.
                self.polling.wake().wake();
            }
            return Some(PollEnd::Ready);
        }
        self.woken.swap(false, Ordering::AcqRel).then_some(PollEnd::Woken)
    }
}

/// A thread's right to poll. It ends when this value is dropped, also if a sink panics.
struct OwnPoll<'a> {
    link: &'a UdpLink,
}

impl Drop for OwnPoll<'_> {
    fn drop(&mut self) {
        let mut poll = lock(&self.link.poll);
        poll.taken = false;
        if poll.waiting > 0 {
            self.link.poll_changed.notify_one();
        }
    }
}

impl Link for UdpLink {
    fn ready(&self, next: NodeId) -> bool {
        let Some((_, peer)) = self.peer(next) else { return false };
        lock(&peer.route)
            .as_mut()
            .is_some_and(|route| self.takes(peer, route) && self.closing(peer, route, 0).is_ok())
    }

    fn at_once(&self) -> usize {
        if self.segments { MAX_PACKETS * SEGMENTS } else { MAX_PACKETS }
    }

    fn send_at(&self, next: NodeId, packets: &[Packet], at: Instant) -> Result<usize, LinkBusy> {
        let (_, peer) = self.peer(next).ok_or(LinkBusy)?;
        let mut route = lock(&peer.route);
        let route = route.as_mut().ok_or(LinkBusy)?;
        match &packets[..packets.len().min(self.at_once())] {
            [] => Ok(0),
            packets => self.send_over(peer, route, packets, at),
        }
    }

    fn poll(&self, sink: &dyn Sink, until: Option<Instant>) -> PollEnd {
        let _poll = match self.take_poll(until) {
            Ok(poll) => poll,
            Err(end) => return end,
        };
        loop {
            let end = match self.wait(until) {
                Ok(Some(Seen::Readable(told))) => self.drain(&told, sink).then_some(PollEnd::Received),
                Ok(None) => {
                    for peer in &self.peers {
                        lock(&peer.route).iter().for_each(|route| {
                            self.takes(peer, route);
                        });
                    }
                    Some(PollEnd::Ready)
                }
                Ok(Some(Seen::Woken)) => self.end_of_wake(),
                Ok(Some(Seen::TimedOut)) => Some(PollEnd::TimedOut),
                Err(_) => {
                    self.wait_failed();
                    None
                }
            };
            if let Some(end) = end {
                return end;
            }
        }
    }

    fn wake(&self) {
        lock(&self.poll).wakes += 1;
        self.woken.store(true, Ordering::Release);
        self.polling.wake().wake();
        self.poll_changed.notify_all();
    }

    fn failures(&self) -> Vec<(&'static str, u64)> {
        let failures = UdpCount::FAILURES.iter();
        failures.map(|&count| (count.name(), self.statistics.get(count))).collect()
    }

    fn evidence(&self) -> Vec<(&'static str, u64)> {
        let evidence = UdpCount::ALL.iter().filter(|count| !UdpCount::FAILURES.contains(count));
        evidence.map(|&count| (count.name(), self.statistics.get(count))).collect()
    }

    fn goodbye(&self) {
        self.say_goodbye();
    }

    fn health(&self) -> Vec<LinkReport> {
        let now = self.micros(Instant::now());
        self.peers.iter().map(|peer| peer.report(now)).collect()
    }

    fn leading(&self) -> Option<&dyn Leading> {
        Some(self)
    }
}
