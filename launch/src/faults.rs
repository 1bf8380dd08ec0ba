//! Faults that the launcher injects.

use imrs_protocol::NodeId;

/// A fault, or its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The node's process is killed.
    Kill(NodeId),
    /// The node is started again.
    Restart(NodeId),
    /// The link between two nodes is cut.
    Cut(NodeId, NodeId),
    /// The link is repaired.
    Heal(NodeId, NodeId),
    /// The node is suspended.
    Pause(NodeId),
    /// The node is resumed.
    Resume(NodeId),
}
