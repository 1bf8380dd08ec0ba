//! Events at the tasks of a recorded node. A replay derives them from a recording, and the checker follows a run with them.

use imrs_protocol::script::{Address, End, ScriptInput};
use imrs_protocol::{NodeId, Packet, TaskId};

/// An event at a task.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Happening {
    /// The node's monotonic clock, in microseconds. All nodes of one machine share this clock.
    pub at: u64,
    /// The task.
    pub task: TaskId,
    /// The event.
    pub what: Happened,
}

/// The kind of an event.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Happened {
    /// Its communication task started.
    Started,
    /// Its script began.
    Begun,
    /// A packet arrived, with its remaining time in microseconds.
    Came(Packet),
    /// It observed that time has passed.
    Time,
    /// Another node has a new incarnation.
    PeerRestarted(NodeId),
    /// The action of a thread ended: the thread, whether it succeeded, and its result.
    Acted(u8, bool, i32),
    /// A nondeterministic choice was made for its script.
    Chosen(u16),
    /// Its communication task sent a packet.
    Sent(Packet),
    /// Its script processed an input.
    Turn(Turn),
    /// Its node stopped, or was cut off for good. Nothing that it does after this is judged.
    Stopped,
}

/// How a script processed one input.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Turn {
    /// The operation in which the script waited.
    pub at: Address,
    /// The input.
    pub input: ScriptInput,
    /// The statements that the script began.
    pub passed: Vec<Address>,
    /// How the script ended, if it did.
    pub end: Option<End>,
}
