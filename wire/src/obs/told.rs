//! What a node says since version 1.1, besides what changed: watched queues, how the process does, where others are; and since
//! version 1.2, which scripts are held back.

use imrs_protocol::{NodeId, PortId, QueueView, TaskId, Ticks};
use serde::{Deserialize, Serialize};

/// The most ports that one monitor can watch at one node.
pub const MAX_WATCHED: usize = 64;

/// The queues of the ports that are watched ([`Want::watched`](super::Want::watched)), a little after the snapshot that
/// came before.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Detail {
    /// The node's monotonic clock, in microseconds.
    pub mono_us: u64,
    /// The ports, in the order they were asked for; those that the node does not have are left out.
    pub ports: Vec<PortDetail>,
}

/// One watched queue.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortDetail {
    /// The task that receives.
    pub task: TaskId,
    /// The port.
    pub port: PortId,
    /// How long before [`Detail::mono_us`] the times in `queue` were true, in microseconds.
    pub age_us: u64,
    /// What waits there.
    pub queue: QueueView,
}

/// How the process of a node does. Counters only grow while it lives.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Vitals {
    /// The node's monotonic clock, in microseconds.
    pub mono_us: u64,
    /// How late its Timer was.
    pub timer: Lateness,
    /// What its links found wrong with datagrams, and how sure the node is of how long they waited in the kernel (D50):
    /// [`Snapshot::link_discards`](super::Snapshot::link_discards) has what was lost, here is the rest.
    pub links: Vec<super::Count>,
    /// Where the node records its inputs to, if it does.
    pub recording: Option<RecordingFacts>,
    /// Processor time of the process, in microseconds.
    pub cpu_us: u64,
    /// Its resident memory, in bytes; zero where that cannot be asked.
    pub memory: u64,
    /// Its threads; zero where that cannot be asked.
    pub threads: u32,
}

/// How much later than their instant the expiries were looked after that no task's thread slept for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lateness {
    /// How many, since the start.
    pub count: u64,
    /// How many of them later than the declared tick of the cell.
    pub late: u64,
    /// Half of those since the last such frame were no later than this, in microseconds.
    pub p50_us: u64,
    /// 99 of a hundred were no later.
    pub p99_us: u64,
    /// None was later.
    pub max_us: u64,
}

/// A recording that a node writes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordingFacts {
    /// The file.
    pub path: String,
    /// How many inputs could not be written down.
    pub lost: u64,
    /// Why it is no longer written, if so.
    pub failure: Option<String>,
}

/// The answer to a [`Ping`](super::Ping).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pong {
    /// What the ping said.
    pub echo_us: u64,
    /// The node's monotonic clock then: half the round trip is the most that it is off.
    pub mono_us: u64,
}

/// Where a node of the cell serves monitors.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodePlace {
    /// The node.
    pub node: NodeId,
    /// `unix:PATH` on the same machine, or `tcp:HOST:PORT`.
    pub address: String,
}

/// Where the other nodes of the cell serve monitors, as far as this one knows: so one address finds the system. Sent
/// when it changes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Places {
    /// The places.
    pub nodes: Vec<NodePlace>,
}

/// The scripts of a restarted node that have not begun yet (D94, D157). Sent before the first snapshot if there are any, then
/// once a second until there are none: the last such frame has no tasks.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeldBack {
    /// The node's monotonic clock, in microseconds.
    pub mono_us: u64,
    /// The tasks, ascending.
    pub tasks: Vec<HeldTask>,
}

/// A task whose script has not begun yet: commands of its earlier incarnation may still arrive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeldTask {
    /// The task.
    pub task: TaskId,
    /// How long it is still held back, from [`HeldBack::mono_us`] on.
    pub remaining: Ticks,
}

/// Why a node does not show itself to who connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum Denied {
    /// It asks for a token, and none was given.
    #[error("it asks for a token: give the one it was started with (--token FILE)")]
    NoToken,
    /// It asks for another token.
    #[error("it was started with another token: give the same one on both sides (--token FILE)")]
    WrongToken,
}
