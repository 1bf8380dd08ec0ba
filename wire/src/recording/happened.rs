//! What happened at the tasks of a recorded node: what a replay makes of a recording, and what a run is followed by.

use imrs_protocol::script::{Address, End, ScriptInput};
use imrs_protocol::{NodeId, Packet, TaskId};

/// Something that happened at a task.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Happening {
    /// When: microseconds of the node's monotonic clock, which all nodes of one machine have in common.
    pub at: u64,
    /// Where.
    pub task: TaskId,
    /// What.
    pub what: Happened,
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Happened {
    /// Its communication task started.
    Started,
    /// Its script began.
    Begun,
    /// A packet came, with what was left of its life in microseconds.
    Came(Packet),
    /// It noticed that time has passed.
    Time,
    /// A node that it knows has a new life.
    PeerRestarted(NodeId),
    /// The action of a thread ended: whether well, and its result.
    Acted(u8, bool, i32),
    /// A choice was made for it.
    Chosen(u16),
    /// Its communication task sent a packet.
    Sent(Packet),
    /// Its script took something.
    Turn(Turn),
    /// Its node stopped, or was cut off for good: nothing that it does from here on is judged.
    Stopped,
}

/// What a script made of one input.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Turn {
    /// The operation that it waited in.
    pub at: Address,
    /// What came.
    pub input: ScriptInput,
    /// The statements that it began.
    pub passed: Vec<Address>,
    /// How it ended, if it did.
    pub end: Option<End>,
}
