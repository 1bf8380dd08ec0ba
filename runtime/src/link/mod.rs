//! The primitive layer (§5.2.4): how packets leave a node and arrive at a node.
//!
//! A link moves packets between neighbouring nodes, and knows nothing of tasks. It may lose, repeat, delay and
//! reorder packets. When it hands packets over, it says how much of their remaining time the hop has cost.

pub mod faulty;
pub mod in_process;
pub(crate) mod residency;
pub mod udp;

pub use crate::sync::lead::Came;
use imrs_protocol::{Incarnation, NodeId, Packet, PacketError, Ticks};
use imrs_wire::envelope::{EnvelopeError, MAX_PACKETS};
use imrs_wire::obs::LinkReport;
use std::fmt;
use std::time::{Duration, Instant};

/// The receiver of a link's packets: the node implements it.
///
/// The sink handles a packet at once, on the same thread, and may call [`Link::send_at`] before the call returns. While
/// a link calls its sink, the link holds no lock that a sender or a waiting task would wait for.
pub trait Sink: Send + Sync {
    /// Takes packets that arrived together, decoded and checked, in the order in which they were sent. `charge` is the time
    /// that the link and the kernel's queue had cost each packet at the instant `at`, in microseconds. The sink also charges
    /// the time since `at`, so that a node that was stopped since then cannot make an old packet look young.
    fn packets(&self, from: NodeId, packets: &[Packet], charge: Ticks, at: Instant);

    /// Reports the first contact with a neighbour, or its new session. `restarted` says whether an earlier incarnation
    /// of the neighbour may have taken requests, according to the neighbour itself or to this node's memory.
    fn peer(&self, node: NodeId, incarnation: Incarnation, restarted: bool);

    /// Reports that a neighbour has stopped in order: none of its tasks runs any more. A link that cannot know this never
    /// calls it.
    fn stopped(&self, _node: NodeId) {}

    /// Reports that the link dropped a datagram or packet that arrived. Drops are counted by reason.
    fn discarded(&self, reason: LinkDiscard);
}

/// A node's links to its neighbours, shared by all threads of the node. Two nodes over UDP:
///
/// ```
/// use imrs_protocol::{Cell, CellTable, Incarnation, NodeTable, PortDecl, Ticks, Usage};
/// use imrs_runtime::{Runtime, link::udp::{UdpLink, UdpOptions}};
/// use std::{sync::Arc, time::Duration};
///
/// let mut cell = Cell::new("pair", Ticks(1_000));
/// let (na, nb) = (cell.node("na"), cell.node("nb"));
/// let (a, b) = (cell.task("a", na), cell.task("b", nb));
/// cell.link(na, nb, Ticks(1_000));
/// cell.port(PortDecl::new("ask", a, Usage::Send, &[b], Ticks(2_000_000)).command());
/// let table = Arc::new(CellTable::new(cell).expect("a sound cell"));
///
/// let bind = |node| {
///     let here = NodeTable::new(Arc::clone(&table), node);
///     let address = "127.0.0.1:0".parse().expect("an address");
///     Arc::new(UdpLink::bind(here, address, UdpOptions::new(Incarnation(1), false)).expect("a free port"))
/// };
/// let (of_a, of_b) = (bind(na), bind(nb));
/// of_a.set_address(nb, Some(of_b.local_address())).expect("a neighbour");
/// of_b.set_address(na, Some(of_a.local_address())).expect("a neighbour");
///
/// let first = Runtime::builder(Arc::clone(&table), na).incarnation(Incarnation(1), false).insecure(true).link(of_a);
/// let second = Runtime::builder(table, nb).incarnation(Incarnation(1), false).insecure(true).link(of_b);
/// let second = second
///     .task("b", |ctx| {
///         while let Some(question) = ctx.receive(None, None)? {
///             ctx.reply(&question.from, b"two")?;
///         }
///         Ok(())
///     })
///     .start()
///     .expect("a node that starts");
/// let first = first
///     .task("a", |ctx| {
///         let ask = ctx.port("ask")?;
///         println!("{:?}", ctx.send(ask, b"how many?")?.reply());
///         Ok(())
///     })
///     .start()
///     .expect("a node that starts");
/// assert!(first.wait(Duration::from_secs(10)));
/// second.stop(Duration::from_secs(10));
/// ```
pub trait Link: Send + Sync {
    /// Whether the link would take packets for this neighbour now.
    fn ready(&self, next: NodeId) -> bool;

    /// How many packets the link takes in one call, at most: by default as many as a datagram holds. A node gathers up
    /// to this many packets for a neighbour. Once the link has them, no more urgent packet can overtake them. A link
    /// that wraps another link returns the number of the inner link.
    fn at_once(&self) -> usize {
        MAX_PACKETS
    }

    /// Sends packets to a neighbour, the most urgent of each datagram first. Their remaining times are true at the
    /// instant `at`. The link charges the time from `at` to the departure, so that a node that was stopped in that time
    /// cannot make old packets look young. Returns how many packets the link took: at least one, and from the front. A
    /// packet that is taken may still be lost.
    ///
    /// # Errors
    /// [`LinkBusy`] if the link took no packet. The link ends a [`poll`](Self::poll) with [`PollEnd::Ready`] when it
    /// takes packets again.
    fn send_at(&self, next: NodeId, packets: &[Packet], at: Instant) -> Result<usize, LinkBusy>;

    /// As [`send_at`](Self::send_at), for packets whose remaining times are true now.
    ///
    /// # Errors
    /// The errors of [`send_at`](Self::send_at).
    fn send(&self, next: NodeId, packets: &[Packet]) -> Result<usize, LinkBusy> {
        self.send_at(next, packets, Instant::now())
    }

    /// Receives until something arrived, `until` passed, or [`wake`](Self::wake) was called. Any waiting thread may
    /// call this (leader and followers). A wake-up while no thread polls ends the next poll.
    fn poll(&self, sink: &dyn Sink, until: Option<Instant>) -> PollEnd;

    /// Ends the current poll; if there is none, the next poll.
    fn wake(&self);

    /// Failures of the link itself, counted by name. They are not reported to the sink.
    fn failures(&self) -> Vec<(&'static str, u64)> {
        Vec::new()
    }

    /// Other counters of the link, by name: how much work it does, and how certain it is of the times for which
    /// datagrams waited.
    fn evidence(&self) -> Vec<(&'static str, u64)> {
        Vec::new()
    }

    /// Tells the neighbours that this node has stopped in order. Called when no task of the node runs any more. The
    /// default does nothing.
    fn goodbye(&self) {}

    /// How long datagrams from each neighbour took, and how many were damaged, as far as the link measures that.
    fn health(&self) -> Vec<LinkReport> {
        Vec::new()
    }

    /// The part of the link in which a task's thread may wait while another thread polls; `None` if the link has none.
    fn leading(&self) -> Option<&dyn Leading> {
        None
    }
}

/// A link in which a task's thread can wait, one thread at a time. While that thread waits, datagrams from neighbours
/// are reported to it alone, and to no polling thread. Datagrams from elsewhere are reported to the polling thread.
pub trait Leading: Send + Sync {
    /// Waits until something arrives, for at most `left`, or until [`call`](Self::call). This function
    /// receives nothing itself, and may end early (spurious wake-up). It returns [`Came::Time`] only if
    /// `left` is zero.
    fn wait(&self, left: Option<Duration>) -> Came;

    /// Receives the datagrams that [`wait`](Self::wait) reported or, without a wait, one datagram if there is one.
    /// Returns false if the polling thread is receiving, because that thread then receives these datagrams, too.
    fn take_in(&self, sink: &dyn Sink) -> bool;

    /// Ends the current wait; if there is none, the next wait.
    fn call(&self);
}

/// The error that the link takes no packet for this neighbour now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the link takes no packets now")]
pub struct LinkBusy;

/// Why a poll ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PollEnd {
    /// A datagram or packet arrived, and the sink got it.
    Received,
    /// A neighbour that was busy takes packets again.
    Ready,
    /// The given instant has passed.
    TimedOut,
    /// [`Link::wake`] was called during the poll or before it.
    Woken,
}

/// Why a link dropped a datagram or packet that arrived. Every drop has a reason and is counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum LinkDiscard {
    /// The datagram is shorter than the least envelope.
    TooShort,
    /// The datagram does not begin as an envelope does, so it is not from this program.
    NotImrs,
    /// The envelope has another version.
    Version,
    /// The envelope has another mode (with or without keys) than this node's.
    Mode,
    /// The datagram is of a cell with other declarations.
    OtherCell,
    /// The datagram is from a node that is not a neighbour.
    UnknownNode,
    /// The datagram is damaged.
    Checksum,
    /// The length of the content is not a whole number of packets, or the packets are too many.
    Length,
    /// The datagram was seen before, or is so old that this cannot be known.
    Replayed,
    /// The datagram is from an earlier incarnation of its sender.
    StaleIncarnation,
    /// The datagram has a purpose that this version does not know.
    Purpose,
    /// The datagram is of a cell with the same declarations and other statements.
    OtherStatements,
    /// The datagram is for another node.
    Misdelivered,
    /// The datagram is from an unknown session of its sender, which is not proven to be later than the known one. The
    /// link asks the sender for a proof.
    UnprovenSession,
    /// The sender says that it refuses the datagrams of this node.
    RefusedByPeer,
    /// The datagram belongs to a handshake that was encrypted with other keys.
    OtherKeys,
    /// The datagram belongs to a session with keys, or to a handshake, that this node does not have, or does not have
    /// any more.
    StaleSession,
    /// The datagram was not encrypted with the keys of its session.
    Forged,
    /// A packet inside a valid envelope is no packet of this cell.
    Packet(PacketError),
}

impl LinkDiscard {
    /// The names of all reasons, by [`index`](Self::index).
    pub const NAMES: [&'static str; 22] = [
        "too_short",
        "not_imrs",
        "version",
        "mode",
        "other_cell",
        "unknown_node",
        "checksum",
        "length",
        "replayed",
        "stale_incarnation",
        "packet_version",
        "packet_port",
        "packet_checksum",
        "packet_malformed",
        "purpose",
        "other_statements",
        "misdelivered",
        "unproven_session",
        "refused_by_peer",
        "other_keys",
        "stale_session",
        "forged",
    ];

    /// The position of this reason in [`NAMES`](Self::NAMES), by which counters are kept.
    #[must_use]
    pub const fn index(self) -> usize {
        match self {
            Self::TooShort => 0,
            Self::NotImrs => 1,
            Self::Version => 2,
            Self::Mode => 3,
            Self::OtherCell => 4,
            Self::UnknownNode => 5,
            Self::Checksum => 6,
            Self::Length => 7,
            Self::Replayed => 8,
            Self::StaleIncarnation => 9,
            Self::Packet(PacketError::Version(_)) => 10,
            Self::Packet(PacketError::UnknownPort(_)) => 11,
            Self::Packet(PacketError::Checksum) => 12,
            Self::Packet(PacketError::Malformed) => 13,
            Self::Purpose => 14,
            Self::OtherStatements => 15,
            Self::Misdelivered => 16,
            Self::UnprovenSession => 17,
            Self::RefusedByPeer => 18,
            Self::OtherKeys => 19,
            Self::StaleSession => 20,
            Self::Forged => 21,
        }
    }

    /// Whether the datagram is damaged, or is no datagram of this program at all. A checksum or a tag shows that.
    #[must_use]
    pub const fn is_damage(self) -> bool {
        matches!(self, Self::TooShort | Self::NotImrs | Self::Checksum | Self::Length | Self::Forged)
    }

    /// A short name for tables and counters.
    #[must_use]
    pub const fn name(self) -> &'static str {
        Self::NAMES[self.index()]
    }
}

impl fmt::Display for LinkDiscard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
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
            EnvelopeError::Purpose(_) => Self::Purpose,
            EnvelopeError::OtherCell(_) => Self::OtherCell,
            EnvelopeError::OtherStatements(_) => Self::OtherStatements,
            EnvelopeError::Misdelivered(_) => Self::Misdelivered,
            EnvelopeError::UnknownNode(_) => Self::UnknownNode,
        }
    }
}
