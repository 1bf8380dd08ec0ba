//! The state of a node at one instant.

use imrs_protocol::{NodeId, TaskId, TaskView, Ticks, TimeId, TransitView};
use serde::{Deserialize, Serialize};

/// Whether a task still runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Liveness {
    /// It runs or waits.
    Alive,
    /// It returned.
    Ended,
    /// It panicked (D43).
    Crashed,
}

/// One task of the node and its communication task.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskSnapshot {
    /// Whether the task still runs.
    pub liveness: Liveness,
    /// How long before [`Snapshot::mono_us`] the communication task last advanced, in microseconds: every remaining
    /// time in `view` was true then, and is shorter by this at the snapshot.
    pub age_us: u64,
    /// Its state; at most the subscribed number of messages per port.
    pub view: TaskView,
}

/// An entry of the node's Timer (Figure 3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TimerEntry {
    /// Whose it is.
    pub owner: TaskId,
    /// Its name at its owner.
    pub id: TimeId,
    /// What is left of it at the snapshot.
    pub remaining: Ticks,
}

/// A named counter. It only grows while the node lives.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Count {
    /// What is counted: snake_case, as [`Reason::name`](imrs_protocol::Reason::name).
    pub name: String,
    /// How many.
    pub count: u64,
}

/// A link of the node to a neighbour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkView {
    /// The neighbour.
    pub peer: NodeId,
    /// How long ago anything came from it, in microseconds; `None` before the first time.
    pub heard_us: Option<u64>,
    /// Packets sent to it.
    pub sent: u64,
    /// Packets taken from it.
    pub received: u64,
}

/// Whether a node runs in real time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum RealTime {
    /// Nobody asked for it.
    #[default]
    NotAsked,
    /// Under SCHED_FIFO, its memory locked, on one core.
    Had,
    /// The kernel refused some of it.
    Refused {
        /// Its memory is not locked.
        memory: bool,
        /// It runs under the ordinary scheduler.
        scheduler: bool,
        /// It may move from core to core.
        core: bool,
    },
}

/// The whole state of a node at one instant (a keyframe). Never longer than a frame: a node whose snapshot would be
/// sends fewer messages per port.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Snapshot {
    /// The node's monotonic clock at the sample, in microseconds, as in its hello.
    pub mono_us: u64,
    /// How long the node has run, in microseconds.
    pub uptime_us: u64,
    /// Whether packets travel without authentication.
    pub insecure: bool,
    /// Whether it runs in real time.
    pub real_time: RealTime,
    /// Its tasks, ascending.
    pub tasks: Vec<TaskSnapshot>,
    /// Its transit buffer.
    pub transit: TransitView,
    /// How long before the sample the transit buffer last advanced, in microseconds; see [`TaskSnapshot::age_us`].
    pub transit_age_us: u64,
    /// Its Timer's entries.
    pub timers: Vec<TimerEntry>,
    /// Its links.
    pub links: Vec<LinkView>,
    /// Messages dropped by its machines, by reason; reasons that never occurred may be left out.
    pub discards: Vec<Count>,
    /// Datagrams and packets dropped by its links before they reached a machine, by reason.
    pub link_discards: Vec<Count>,
}
