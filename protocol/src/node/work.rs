//! Pending effects within a node.

use crate::ids::TaskId;
use crate::packet::Packet;
use crate::request::TimeId;
use crate::task::Input;
use crate::ticks::Ticks;

#[derive(Clone, Copy, Debug)]
pub(super) enum Work {
    Route(Packet),
    Task(TaskId, Input),
    /// Time has passed that the task has not handled.
    #[cfg(feature = "checker")]
    Pass(TaskId, Ticks),
    Arm(TaskId, TimeId, u8, Ticks),
    Disarm(TaskId, TimeId),
}
