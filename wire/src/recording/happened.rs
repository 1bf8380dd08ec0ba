//! Events at the tasks of a recorded node. A replay derives the events from a recording, and the checker follows a run
//! with them.

use imrs_protocol::script::{Address, End, ScriptInput};
use imrs_protocol::{MessageId, NodeId, Packet, TaskId};

/// An event at a task.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Happening {
    /// The time of the node's monotonic clock, in microseconds. All nodes of one machine share this clock.
    pub at: u64,
    /// The task at which the event happened.
    pub task: TaskId,
    /// The event in the script.
    pub what: Happened,
}

/// The kind of an event.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Happened {
    /// The communication task of the task started.
    Started,
    /// The task's script began.
    Begun,
    /// A packet arrived, with its remaining time in microseconds.
    Came(Packet),
    /// Time has passed for the task, without any other input.
    Time,
    /// Another node has a new incarnation.
    PeerRestarted(NodeId),
    /// Another node stopped in order while the task waited for an answer, perhaps from it.
    PeerStopped(NodeId),
    /// A packet of a command of the task never left its node, because no link took it in time.
    Unsent(MessageId),
    /// The action of one of the task's threads ended: the thread, whether the action succeeded, and its result.
    Acted(u8, bool, i32),
    /// A nondeterministic choice was made for the task's script.
    Chosen(u16),
    /// The communication task of the task sent a packet.
    Sent(Packet),
    /// The task's script processed an input.
    Turn(Turn),
    /// The node of the task stopped, or was cut off for good. Later events of the task are not judged.
    Stopped,
}

/// How a script processed one input.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Turn {
    /// The operation of the program in which the script waited for the input.
    pub at: Address,
    /// The input that the script took.
    pub input: ScriptInput,
    /// The statements that the script began.
    pub passed: Vec<Address>,
    /// How the script ended, if it ended.
    pub end: Option<End>,
}
