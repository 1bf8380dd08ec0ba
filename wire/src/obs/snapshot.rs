//! The snapshot: the state of a node at one instant.

use imrs_protocol::{NodeId, TaskId, TaskView, Ticks, TimeId, TransitView};
use serde::{Deserialize, Serialize};

/// Whether a task still runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Liveness {
    /// The task runs or waits.
    Alive,
    /// The task returned.
    Ended,
    /// The task panicked.
    Crashed,
}

/// One task of the node, with its communication task.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskSnapshot {
    /// Whether the task still runs.
    pub liveness: Liveness,
    /// How long before [`Snapshot::mono_us`] the communication task last advanced, in microseconds. The remaining times
    /// in `view` are of that moment; at the time of the snapshot each is shorter by `age_us`.
    pub age_us: u64,
    /// The task's state, with at most the subscribed number of messages per port.
    pub view: TaskView,
}

/// An entry of the node's Timer (Figure 3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TimerEntry {
    /// The task that set the timer.
    pub owner: TaskId,
    /// The entry's identifier, unique within the task.
    pub id: TimeId,
    /// The remaining time at the snapshot.
    pub remaining: Ticks,
}

/// A named counter. It only grows during one incarnation of the node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Count {
    /// The name of the counted thing, in snake_case, as [`Reason::name`](imrs_protocol::Reason::name) returns it.
    pub name: String,
    /// How often the node has counted this thing.
    pub count: u64,
}

/// A link of the node to a neighbour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkView {
    /// The neighbour at the other end of the link.
    pub peer: NodeId,
    /// Time since the last datagram from the neighbour, in microseconds; `None` before the first one.
    pub heard_us: Option<u64>,
    /// Packets sent to the neighbour.
    pub sent: u64,
    /// Packets accepted from the neighbour.
    pub received: u64,
}

/// Whether a node runs in real time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum RealTime {
    /// Real time was not requested.
    #[default]
    NotAsked,
    /// Real time was granted: SCHED_FIFO, locked memory, one core.
    Had,
    /// The kernel refused a part of the request.
    Refused {
        /// The node's memory is not locked.
        memory: bool,
        /// The node runs under the ordinary scheduler.
        scheduler: bool,
        /// The node may migrate between cores.
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
    /// Whether the node runs in real time.
    pub real_time: RealTime,
    /// The node's tasks, ascending.
    pub tasks: Vec<TaskSnapshot>,
    /// The node's transit buffer.
    pub transit: TransitView,
    /// How long before the sample the transit buffer last advanced, in microseconds; see [`TaskSnapshot::age_us`].
    pub transit_age_us: u64,
    /// The entries of the node's Timer.
    pub timers: Vec<TimerEntry>,
    /// The node's links.
    pub links: Vec<LinkView>,
    /// Counts of the messages that the node's state machines dropped, by reason; reasons with a count of zero may be
    /// missing.
    pub discards: Vec<Count>,
    /// Counts of the datagrams and packets that the node's links dropped before a state machine saw them, by reason.
    pub link_discards: Vec<Count>,
}
