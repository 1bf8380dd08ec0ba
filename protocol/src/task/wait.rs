//! The waits of activations, and how they end.

use crate::ids::{PortId, Round, TaskId};
use crate::request::{Outcome, ReleasedBy, TimeId};
use crate::ticks::Instant;
use serde::{Deserialize, Serialize};

/// The wait of an activation. Each activation has at most one (R93).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) enum Pending {
    Nothing,
    Get {
        port: Option<PortId>,
        source: Option<TaskId>,
        deadline: Instant,
    },
    /// It waits for the answers to the outstanding request at this position, which has the deadline.
    Reply(u16),
    /// It waits at the rendezvous at this position, which has the deadline.
    Meeting(u16),
    /// It waits in a delay: the name, and the number of its start.
    Delay(TimeId, u8),
    /// It waits for the end of an external action.
    Work,
    /// It waits for the lease (D61).
    Lease,
    /// It waits for nothing: a handler runs between two of its statements.
    Boundary,
}

/// How a wait ended. This is signalled at once, or when the handlers above the waiting activation have ended.
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

/// The report of a part to the dispatcher that a wait ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Ended {
    /// The wait that ended. `None` under the variant that accepts late replies: the running activation is then told.
    pub wait: Option<Pending>,
    pub finished: Finished,
}
