//! The primitive layer (§5.2.4): how packets leave a node and come in.
//!
//! A link moves packets between neighbouring nodes and knows nothing of tasks. It may lose, repeat, delay and reorder
//! them; whatever it hands over carries how much life the way has cost (D20).

pub mod faulty;
pub mod in_process;
pub(crate) mod residency;
pub mod udp;

pub use crate::sync::lead::Came;
use imrs_protocol::{Incarnation, NodeId, Packet, PacketError, Ticks};
use imrs_wire::envelope::MAX_PACKETS;
use std::fmt;
use std::time::{Duration, Instant};

/// Where a link puts what it receives: implemented by the node.
///
/// What is handed over is dealt with at once, by the same thread: it may call [`Link::send_at`] before the call returns.
/// A link holds no lock while it calls its sink that a sender or a waiting task would wait for.
pub trait Sink: Send + Sync {
    /// Packets that came together, decoded and checked, in the order in which they were sent. `charge` is what the link and
    /// the kernel's queue had cost each of them at `at`, in microseconds; the sink charges what has passed since, so that a
    /// node that was stopped between the two cannot make an old packet young.
    fn packets(&self, from: NodeId, packets: &[Packet], charge: Ticks, at: Instant);

    /// First contact with a neighbour, or a new session of it. `restarted`: whether an earlier incarnation of it can have
    /// taken requests, as the neighbour says itself or as this node knows.
    fn peer(&self, node: NodeId, incarnation: Incarnation, restarted: bool);

    /// Something came in that is not for this node. Counted by reason.
    fn discarded(&self, reason: LinkDiscard);
}

/// A node's way to its neighbours. Shared by all threads of the node.
pub trait Link: Send + Sync {
    /// Whether a send to this neighbour would be taken now.
    fn ready(&self, next: NodeId) -> bool;

    /// How many packets it takes in one call, at most: by default what a datagram holds. A node gathers so many for a
    /// neighbour, and none of them can be overtaken any more once they are handed over. Who wraps a link passes this on.
    fn at_once(&self) -> usize {
        MAX_PACKETS
    }

    /// Sends packets to a neighbour, the most urgent of each datagram first. Their remaining times hold for the instant `at`: what passes
    /// between it and the departure is charged to them, so that a node that was stopped in between cannot make old
    /// packets young. Returns how many were taken: at least one, and from the front. A packet that is taken may still be
    /// lost.
    ///
    /// # Errors
    /// [`LinkBusy`] where none was taken. The link ends a [`poll`](Self::poll) with [`PollEnd::Ready`] when it takes
    /// packets again.
    fn send_at(&self, next: NodeId, packets: &[Packet], at: Instant) -> Result<usize, LinkBusy>;

    /// As [`send_at`](Self::send_at), of packets whose remaining times hold for this instant.
    ///
    /// # Errors
    /// As [`send_at`](Self::send_at).
    fn send(&self, next: NodeId, packets: &[Packet]) -> Result<usize, LinkBusy> {
        self.send_at(next, packets, Instant::now())
    }

    /// Receives until something came in, `until` passed, or [`wake`](Self::wake) was called. Whoever waits may call it
    /// (leader and followers). A wake that comes while nobody polls ends the next poll.
    fn poll(&self, sink: &dyn Sink, until: Option<Instant>) -> PollEnd;

    /// Ends a poll.
    fn wake(&self);

    /// What went wrong on the link itself, counted by name: what no sink was told of.
    fn failures(&self) -> Vec<(&'static str, u64)> {
        Vec::new()
    }

    /// What the link counts besides, by name: how much it does, and how sure it is of how long datagrams waited (D50).
    fn evidence(&self) -> Vec<(&'static str, u64)> {
        Vec::new()
    }

    /// Where the thread of a task may wait in the link itself while another thread polls, if it may.
    fn leading(&self) -> Option<&dyn Leading> {
        None
    }
}

/// A link that a task's thread can wait in (D40): what comes in from neighbours while it does is told to it alone, and to nobody
/// that polls. One thread at a time. What comes from elsewhere is told to whoever polls (D155).
pub trait Leading: Send + Sync {
    /// Waits until something comes in, for at most so long, or until [`call`](Self::call). Takes nothing in, and may end
    /// early for no reason; that the time is over it says only where `left` is zero.
    fn wait(&self, left: Option<Duration>) -> Came;

    /// Takes in what [`wait`](Self::wait) told of, or without a wait one that is there, if any. False where the thread that
    /// polls is at it: it takes that in, too.
    fn take_in(&self, sink: &dyn Sink) -> bool;

    /// Ends the present wait, or else the next one.
    fn call(&self);
}

/// The link takes nothing for this neighbour now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the link takes no packets now")]
pub struct LinkBusy;

/// Why a poll ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PollEnd {
    /// Something came in and was handed to the sink.
    Received,
    /// A neighbour that was busy takes packets again.
    Ready,
    /// The given instant has passed.
    TimedOut,
    /// [`Link::wake`] was called.
    Woken,
}

/// Why a link dropped something that came in (D48). Every drop has a reason and is counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum LinkDiscard {
    /// Shorter than the least envelope.
    TooShort,
    /// Does not begin as an envelope does.
    NotImrs,
    /// An envelope of another version.
    Version,
    /// An envelope of another mode than this node's.
    Mode,
    /// Of a cell with other declarations.
    OtherCell,
    /// From a node that is not a neighbour.
    UnknownNode,
    /// Damaged.
    Checksum,
    /// Not a whole number of packets, or too many.
    Length,
    /// Seen before, or too old to tell.
    Replayed,
    /// From an earlier incarnation of its sender.
    StaleIncarnation,
    /// For a purpose that this version does not know.
    Purpose,
    /// Of a cell with the same declarations and other statements.
    OtherStatements,
    /// For another node.
    Misdelivered,
    /// From a session of its sender that is not known, and not proven to be later than the known one. The sender is asked.
    UnprovenSession,
    /// The sender says that it refuses what this node sends.
    RefusedByPeer,
    /// A packet inside a good envelope is not one of this cell.
    Packet(PacketError),
}

impl LinkDiscard {
    /// The names of all reasons, by [`index`](Self::index).
    pub const NAMES: [&'static str; 19] = [
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
    ];

    /// The position of this reason in [`NAMES`](Self::NAMES): what counters are kept by.
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
        }
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
