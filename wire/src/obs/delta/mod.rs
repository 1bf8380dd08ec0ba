//! Deltas: the changes from one snapshot to the next. The mere passing of time is not sent.
//!
//! Remaining times are compared as deadlines. If the previous snapshot, aged by the time since then, equals the new
//! snapshot, nothing is sent. So an idle node costs a few bytes per period. For any two snapshots,
//! `old.apply(&Delta::between(&old, &new))` gives `new`. A whole snapshot is encoded as the delta from the empty
//! snapshot.

mod age;
mod apply;
mod between;

use super::snapshot::{Count, LinkView, Liveness, RealTime, TimerEntry};
use imrs_protocol::{Class, MeetingView, QueueEntry, TaskId, TaskState, Ticks, TransitView, Usage};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The number of counters of a port.
const COUNTERS: usize = 11;

/// A part of a list that changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct At<T> {
    /// How many unchanged elements lie between the previous changed one and this one.
    pub skip: u32,
    /// The changed element.
    pub what: T,
}

/// The change of a list.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Changed<P, W> {
    /// The list has as many elements as before, and these changed.
    Parts(Vec<At<P>>),
    /// The whole new list.
    Whole(Vec<W>),
}

/// The changes between two snapshots of one node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Delta {
    /// [`Snapshot::mono_us`](super::Snapshot::mono_us) of the snapshot to which the delta applies. `None` if the delta
    /// is whole, and replaces any snapshot.
    pub base_us: Option<u64>,
    /// The time between the sample before and this one, in microseconds. A delta that holds the whole state has no sample
    /// before it: then this is the time since the origin of the clock.
    pub passed_us: u64,
    /// The fields of the node itself, if they changed.
    pub node: Option<NodeFacts>,
    /// The changes of the node's tasks.
    pub tasks: Changed<TaskChange, TaskAnew>,
    /// By how much the transit buffer's own time advanced, in microseconds.
    pub transit_passed_us: u64,
    /// The transit buffer, if more than its time changed.
    pub transit: Option<TransitView>,
    /// The entries of the node's Timer, if more than their remaining times changed.
    pub timers: Option<Vec<TimerEntry>>,
    /// The node's links.
    pub links: Changed<LinkView, LinkView>,
    /// By how much the counters of the messages that the node's state machines dropped have grown.
    pub discards: Changed<u64, Count>,
    /// By how much the counters of drops at the node's links have grown.
    pub link_discards: Changed<u64, Count>,
}

/// The fields of a snapshot that belong to the node itself, not to one of its tasks, buffers or links.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeFacts {
    /// How long the node has run, in microseconds.
    pub uptime_us: u64,
    /// Whether packets travel without authentication.
    pub insecure: bool,
    /// Whether the node runs in real time.
    pub real_time: RealTime,
}

/// The change of a task.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TaskChange {
    /// Some parts of the task changed.
    Parts(TaskParts),
    /// The task's identity, its ports or the number of its meetings differ from before.
    Anew(TaskAnew),
}

/// The changed parts of a task.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskParts {
    /// By how much the communication task's own time advanced, in microseconds.
    pub passed_us: u64,
    /// The task's liveness, if that changed.
    pub liveness: Option<Liveness>,
    /// The task's state, if more than the time changed.
    pub state: Option<TaskState>,
    /// The changed ports of the task.
    pub ports: Vec<At<PortChange>>,
    /// The task's rendezvous that changed, each by its port.
    pub meetings: Vec<At<MeetingView>>,
}

/// The change of a port.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortChange {
    /// A bit for each counter that grew, in the order of [`PortCounters`](imrs_protocol::PortCounters), lowest bit first.
    pub grown: u16,
    /// By how much each of the counters in `grown` grew.
    pub by: Vec<u64>,
    /// The port's queue, if more than the time changed.
    pub waiting: Option<Waiting>,
}

/// The whole state of a task, independent of the previous snapshot.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskAnew {
    /// The task that changed.
    pub task: TaskId,
    /// Whether the task still runs.
    pub liveness: Liveness,
    /// How long before the sample the communication task last advanced, in microseconds; see
    /// [`TaskSnapshot::age_us`](super::TaskSnapshot::age_us).
    pub age_us: u64,
    /// What the task is doing.
    pub state: TaskState,
    /// The task's ports, ascending.
    pub ports: Vec<PortAnew>,
    /// The task's rendezvous, ascending by port.
    pub meetings: Vec<MeetingView>,
}

/// The whole state of a port, independent of the previous snapshot.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortAnew {
    /// The port's number minus that of the previous port (0 for the first), with wrap-around.
    pub further: u16,
    /// What the task does with the port.
    pub usage: Usage,
    /// The port's class.
    pub class: Class,
    /// How many messages may wait; zero if this end receives nothing.
    pub capacity: u16,
    /// The port's difference from a port that was never used.
    pub change: PortChange,
}

/// The queue of a port.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Waiting {
    /// How many messages wait on the port.
    pub len: u16,
    /// The remaining time of the most urgent waiting message.
    pub min_slack: Option<Ticks>,
    /// The waiting messages in the order in which they will be served, at most as many as the monitor asked for.
    pub queue: Vec<QueueEntry>,
}

/// Why a delta cannot be applied. The snapshot is unchanged then.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum DeltaError {
    /// The delta applies to another snapshot.
    #[error("a change of the snapshot at {wanted} us, the last one is of {have} us")]
    OtherBase {
        /// The sample time of the snapshot to which the delta applies, in microseconds.
        wanted: u64,
        /// The sample time of the present snapshot, in microseconds.
        have: u64,
    },
    /// The delta changes a part that the snapshot does not have.
    #[error("a change of something that the snapshot does not have")]
    NoSuchPart,
    /// The delta does not give one growth for each counter that it names, or it names a counter that does not exist.
    #[error("a change of counters that is not one for each")]
    OtherCounters,
}
