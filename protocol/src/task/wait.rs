//! The waits of activations, and how they end.

use crate::ids::{PortId, Round, TaskId};
use crate::request::{Outcome, ReleasedBy, TimeId};
use crate::ticks::Instant;
use serde::{Deserialize, Serialize};

/// The wait of an activation: each has at most one (R93).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) enum Pending {
    Nothing,
    Get {
        port: Option<PortId>,
        source: Option<TaskId>,
        deadline: Instant,
    },
    /// For the answers to the outstanding request at this position, which has the deadline.
    Reply(u16),
    /// At the rendezvous at this position, which has the deadline.
    Meeting(u16),
    /// A delay, by its name and the number of its start.
    Delay(TimeId, u8),
    /// For the end of an external action.
    Work,
    /// For the lease (D61).
    Lease,
    /// For nothing: a handler runs between two of its statements.
    Boundary,
}

/// The end of a wait. It is signalled at once, or when the handlers above the waiting activation have ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) enum Finished {
    Outcome(Outcome),
    /// The request to several tasks at this position has ended.
    Answers(u16),
    /// The request at this position has ended with an answer of several packets.
    Long(u16),
    Released {
        port: PortId,
        round: Round,
        by: ReleasedBy,
    },
    GaveUp {
        port: PortId,
        round: Round,
        missing: u64,
    },
    TimeOut(TimeId),
    Granted(u8),
}

/// The end of a wait, as a part reports it to the dispatcher.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Ended {
    /// The wait that ended. `None` under the variant that accepts late replies: then the running activation is told.
    pub wait: Option<Pending>,
    pub finished: Finished,
}
