//! The snapshot: the state of a node at one instant.

use imrs_protocol::{NodeId, TaskId, TaskView, Ticks, TimeId, TransitView};
use serde::{Deserialize, Serialize};

/// Whether a task still runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Liveness {
    /// It runs or waits.
    Alive,
    /// It returned.
    Ended,
    /// It panicked.
    Crashed,
}

/// One task of the node and its communication task.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskSnapshot {
    /// Whether the task still runs.
    pub liveness: Liveness,
    /// How long before [`Snapshot::mono_us`] the communication task last advanced, in microseconds. The remaining times
    /// in `view` are as of that moment; at the snapshot each is shorter by this.
    pub age_us: u64,
    /// Its state, with at most the subscribed number of messages per port.
    pub view: TaskView,
}

/// An entry of the node's Timer (Figure 3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TimerEntry {
    /// The task that set it.
    pub owner: TaskId,
    /// Its identifier, unique within that task.
    pub id: TimeId,
    /// The remaining time at the snapshot.
    pub remaining: Ticks,
}

/// A named counter. It only grows during one incarnation of the node.
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
    /// Time since the last datagram from it, in microseconds; `None` before the first one.
    pub heard_us: Option<u64>,
    /// Packets sent to it.
    pub sent: u64,
    /// Packets accepted from it.
    pub received: u64,
}

/// Whether a node runs in real time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum RealTime {
    /// It was not requested.
    #[default]
    NotAsked,
    /// Granted: SCHED_FIFO, locked memory, one core.
    Had,
    /// The kernel refused a part of the request.
    Refused {
        /// Its memory is not locked.
        memory: bool,
        /// It runs under the ordinary scheduler.
        scheduler: bool,
        /// It may migrate between cores.
        core: bool,
    },
}

/// The whole state of a node at one instant (a keyframe). It always fits a frame: a node lists fewer messages per port
/// if the snapshot would be longer.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Snapshot {
    /// The node's monotonic clock at the sample, in microseconds: the same clock as in its hello.
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
    /// Messages dropped by its state machines, by reason; reasons with a count of zero may be missing.
    pub discards: Vec<Count>,
    /// Datagrams and packets that its links dropped before a state machine saw them, by reason.
    pub link_discards: Vec<Count>,
}
