//! The options of a link over UDP, and the reasons for which it cannot start.

use imrs_protocol::{Incarnation, NodeId};
use std::io;
use std::net::SocketAddr;
use thiserror::Error;

/// The size of a kernel receive queue, by default: some 200 full datagrams.
const DEFAULT_QUEUE_BYTES: usize = 256 * 1024;

/// How a node takes part in UDP traffic.
#[derive(Clone, Copy, Debug)]
pub struct UdpOptions {
    /// The incarnation of the node.
    pub incarnation: Incarnation,
    /// Whether an earlier incarnation of the node may have taken requests. The node tells this to its neighbours.
    pub restarted: bool,
    /// The digest of the statements of all tasks of the cell ([`record::statements`](crate::record::statements)), or
    /// zero if no task has a script. Nodes with different digests refuse each other.
    pub statements: u32,
    /// How many bytes each of the kernel's receive queues holds (SO_RCVBUF; the kernel doubles it for its own needs).
    /// There is one queue for each neighbour and one for all other senders. A queue need not hold more than
    /// arrives within the longest time_out.
    pub queue_bytes: usize,
    /// Whether the kernel, if it can, cuts the data of one call into datagrams (UDP_SEGMENT, Linux 4.18), and merges
    /// datagrams that come from one neighbour (UDP_GRO, Linux 5.0).
    pub segments: bool,
}

impl UdpOptions {
    /// The default options for this incarnation of a node.
    #[must_use]
    pub const fn new(incarnation: Incarnation, restarted: bool) -> Self {
        Self { incarnation, restarted, statements: 0, queue_bytes: DEFAULT_QUEUE_BYTES, segments: true }
    }
}

/// Why a UDP link could not be made.
#[derive(Debug, Error)]
pub enum UdpError {
    /// The address cannot be bound.
    #[error("cannot bind UDP address {address}: {source}")]
    Bind {
        /// The address that the socket could not be bound to.
        address: SocketAddr,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The system refused an option of the socket.
    #[error("cannot set {option} on a UDP socket: {source}")]
    Option {
        /// The option that the system refused.
        option: &'static str,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The means to wait in the socket and to end such waits (epoll, eventfd) cannot be made.
    #[error("cannot make an epoll or an eventfd: {0}")]
    Wake(io::Error),
    /// The keys lack the public key of a neighbour.
    #[error("there is no public key of node {0}, which is a neighbour")]
    NoKey(NodeId),
    /// The system gives no random numbers for the keys of sessions.
    #[error("the system gives no random numbers")]
    NoRandom,
}

/// The node is not a neighbour: the cell declares no link to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("node {0} is not a neighbour")]
pub struct NotANeighbour(pub NodeId);
