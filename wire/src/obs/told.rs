//! The frames that version 1.1 added besides deltas (watched queues, process metrics, addresses of other nodes), and
//! the held-back scripts of version 1.2.

use imrs_protocol::{NodeId, PortId, QueueView, TaskId, Ticks};
use serde::{Deserialize, Serialize};

/// The most ports that one monitor can watch on one node.
pub const MAX_WATCHED: usize = 64;

/// The queues of the watched ports ([`Want::watched`](super::Want::watched)), sampled a little after the previous
/// snapshot.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Detail {
    /// The node's monotonic clock, in microseconds.
    pub mono_us: u64,
    /// The ports, in the order of the request; ports that the node does not have are missing.
    pub ports: Vec<PortDetail>,
}

/// One watched queue.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortDetail {
    /// The task that receives through the port.
    pub task: TaskId,
    /// The watched port.
    pub port: PortId,
    /// How long before [`Detail::mono_us`] the remaining times in `queue` were measured, in microseconds.
    pub age_us: u64,
    /// The port's queued messages.
    pub queue: QueueView,
}

/// Metrics of a node's process. Counters only grow during one incarnation.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Vitals {
    /// The node's monotonic clock, in microseconds.
    pub mono_us: u64,
    /// How late the node's Timer was.
    pub timer: Lateness,
    /// Link diagnostics other than drops: irregular datagrams, and how well the node knows the time that they waited in
    /// the kernel. Drops are in [`Snapshot::link_discards`](super::Snapshot::link_discards).
    pub links: Vec<super::Count>,
    /// The recording of the node's inputs, if there is one.
    pub recording: Option<RecordingFacts>,
    /// Processor time that the process used, in microseconds.
    pub cpu_us: u64,
    /// Resident memory of the process, in bytes; zero if unknown.
    pub memory: u64,
    /// The number of threads of the process; zero if unknown.
    pub threads: u32,
}

/// How late the Timer handled expiries for which no task's thread slept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lateness {
    /// How many expiries the Timer handled since the start.
    pub count: u64,
    /// How many of the handled expiries were later than the declared tick of the cell.
    pub late: u64,
    /// Median lateness of the expiries since the previous frame of this kind, in microseconds.
    pub p50_us: u64,
    /// The 99th percentile of the same lateness, in microseconds.
    pub p99_us: u64,
    /// The greatest lateness of an expiry since the previous frame of this kind, in microseconds.
    pub max_us: u64,
}

/// A recording that a node writes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordingFacts {
    /// The recording's file.
    pub path: String,
    /// How many inputs the recording has lost.
    pub lost: u64,
    /// Why the node stopped writing the recording, if it did.
    pub failure: Option<String>,
}

/// The answer to a [`Ping`](super::Ping).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pong {
    /// [`Ping::mono_us`](super::Ping::mono_us) of the ping.
    pub echo_us: u64,
    /// The node's monotonic clock at the answer. The error of the offset is at most half the round trip.
    pub mono_us: u64,
}

/// The address at which a node of the cell serves monitors.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodePlace {
    /// The node that listens there.
    pub node: NodeId,
    /// `unix:PATH` on the same machine, or `tcp:HOST:PORT`.
    pub address: String,
}

/// The addresses at which the other nodes of the cell serve monitors, as far as this node knows. So a monitor with one
/// address finds the whole cell. The frame is sent again when the addresses change.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Places {
    /// The address of each node.
    pub nodes: Vec<NodePlace>,
}

/// The scripts of a restarted node that have not begun yet. The frame is sent before the first snapshot if there are
/// such scripts, then once a second. The last such frame has no tasks.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeldBack {
    /// The node's monotonic clock, in microseconds.
    pub mono_us: u64,
    /// The held-back tasks, ascending.
    pub tasks: Vec<HeldTask>,
}

/// A task whose script has not begun yet, because commands of its previous incarnation may still arrive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeldTask {
    /// The task whose script is held back.
    pub task: TaskId,
    /// How long the script is still held back, counted from [`HeldBack::mono_us`].
    pub remaining: Ticks,
}

/// Why a node denies access to a monitor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum Denied {
    /// The node requires a token, and the monitor has shown none.
    #[error("it asks for a token: give the one it was started with (--token FILE)")]
    NoToken,
    /// The monitor's token is not the token that the node requires.
    #[error("it was started with another token: give the same one on both sides (--token FILE)")]
    WrongToken,
}
