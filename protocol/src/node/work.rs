//! Effects within a node that are not carried out yet.

use crate::ids::TaskId;
use crate::packet::Packet;
use crate::request::TimeId;
use crate::task::Input;
use crate::ticks::Ticks;

#[derive(Clone, Copy, Debug)]
pub(super) enum Work {
    Route(Packet),
    Task(TaskId, Input),
    /// So much time has passed that a task has not noticed.
    #[cfg(feature = "checker")]
    Pass(TaskId, Ticks),
    Arm(TaskId, TimeId, u8, Ticks),
    Disarm(TaskId, TimeId),
}
