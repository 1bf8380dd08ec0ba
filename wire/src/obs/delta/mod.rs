//! What changed from one snapshot to the next: nothing is said of what only grew older.
//!
//! A remaining time is compared as the instant that it ends at. Where the snapshot before, made older by the time that
//! passed, is the new one, nothing is sent: a node in which nothing happens costs a few bytes a period. The law is
//! `old.apply(&Delta::between(&old, &new))` gives `new`, whatever the two are. A whole snapshot is told as what changed
//! since there was nothing.

mod age;
mod apply;
mod between;

use super::snapshot::{Count, LinkView, Liveness, RealTime, TimerEntry};
use imrs_protocol::{Class, MeetingView, QueueEntry, TaskId, TaskState, Ticks, TransitView, Usage};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// How many counters a port has.
const COUNTERS: usize = 11;

/// A part of a list that changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct At<T> {
    /// How many that did not change lie between the one before and this one.
    pub skip: u32,
    /// What changed.
    pub what: T,
}

/// What became of a list.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Changed<P, W> {
    /// Its elements are those of before, and of these something changed.
    Parts(Vec<At<P>>),
    /// It is now this.
    Whole(Vec<W>),
}

/// What changed between two snapshots of one node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Delta {
    /// [`Snapshot::mono_us`](super::Snapshot::mono_us) of the snapshot that it changes. `None`: it is whole, and takes the place of any.
    pub base_us: Option<u64>,
    /// How much later the new one was taken, in microseconds; where it is whole, since the clock's start.
    pub passed_us: u64,
    /// What a node has besides its parts, where it changed.
    pub node: Option<NodeFacts>,
    /// Its tasks.
    pub tasks: Changed<TaskChange, TaskAnew>,
    /// By how many microseconds the transit buffer's own time went on.
    pub transit_passed_us: u64,
    /// The transit buffer, where more than its time changed.
    pub transit: Option<TransitView>,
    /// The Timer's entries, where more than their time changed.
    pub timers: Option<Vec<TimerEntry>>,
    /// Its links.
    pub links: Changed<LinkView, LinkView>,
    /// By how much the counters of messages dropped by its machines grew.
    pub discards: Changed<u64, Count>,
    /// By how much those of its links grew.
    pub link_discards: Changed<u64, Count>,
}

/// What a node has besides its parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeFacts {
    /// [`Snapshot::uptime_us`](super::Snapshot::uptime_us).
    pub uptime_us: u64,
    /// [`Snapshot::insecure`](super::Snapshot::insecure).
    pub insecure: bool,
    /// [`Snapshot::real_time`](super::Snapshot::real_time).
    pub real_time: RealTime,
}

/// What became of a task.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TaskChange {
    /// These parts of it changed.
    Parts(TaskParts),
    /// It has other ports or meetings than before.
    Anew(TaskAnew),
}

/// What changed of a task.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskParts {
    /// By how many microseconds the communication task's own time went on.
    pub passed_us: u64,
    /// Whether it still runs, if that changed.
    pub liveness: Option<Liveness>,
    /// What it does, if more than its time changed.
    pub state: Option<TaskState>,
    /// Its ports.
    pub ports: Vec<At<PortChange>>,
    /// Its waitfors.
    pub meetings: Vec<At<MeetingView>>,
}

/// What changed of a port.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortChange {
    /// Which of its counters grew: the bits in the order of [`PortCounters`](imrs_protocol::PortCounters), from the lowest.
    pub grown: u16,
    /// By how much each of them did.
    pub by: Vec<u64>,
    /// What waits there, if more than its time changed.
    pub waiting: Option<Waiting>,
}

/// A task, whatever was known of it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskAnew {
    /// [`TaskView::task`](imrs_protocol::TaskView::task).
    pub task: TaskId,
    /// [`TaskSnapshot::liveness`](super::TaskSnapshot::liveness).
    pub liveness: Liveness,
    /// [`TaskSnapshot::age_us`](super::TaskSnapshot::age_us).
    pub age_us: u64,
    /// [`TaskView::state`](imrs_protocol::TaskView::state).
    pub state: TaskState,
    /// [`TaskView::ports`](imrs_protocol::TaskView::ports).
    pub ports: Vec<PortAnew>,
    /// [`TaskView::meetings`](imrs_protocol::TaskView::meetings).
    pub meetings: Vec<MeetingView>,
}

/// A port, whatever was known of it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortAnew {
    /// By how much its number is greater than that of the port before, or than 0, counted around the end of the numbers.
    pub further: u16,
    /// [`PortView::usage`](imrs_protocol::PortView::usage).
    pub usage: Usage,
    /// [`PortView::class`](imrs_protocol::PortView::class).
    pub class: Class,
    /// [`PortView::capacity`](imrs_protocol::PortView::capacity).
    pub capacity: u16,
    /// How it differs from a port at which nothing ever happened.
    pub change: PortChange,
}

/// What waits at a port.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Waiting {
    /// [`PortView::len`](imrs_protocol::PortView::len).
    pub len: u16,
    /// [`PortView::min_slack`](imrs_protocol::PortView::min_slack).
    pub min_slack: Option<Ticks>,
    /// [`PortView::queue`](imrs_protocol::PortView::queue).
    pub queue: Vec<QueueEntry>,
}

/// Why a delta cannot be applied. The snapshot is as it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum DeltaError {
    /// It changes another snapshot.
    #[error("a change of the snapshot at {wanted} us, the last one is of {have} us")]
    OtherBase {
        /// The snapshot that it changes.
        wanted: u64,
        /// The snapshot that there is.
        have: u64,
    },
    /// It changes something that the snapshot does not have.
    #[error("a change of something that the snapshot does not have")]
    NoSuchPart,
    /// It names other counters than it has growths for.
    #[error("a change of counters that is not one for each")]
    OtherCounters,
}
