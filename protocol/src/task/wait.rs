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
    /// The activation waits for the answers to the outstanding request at this position. The request has the deadline.
    Reply(u16),
    /// The activation waits at the rendezvous at this position. The rendezvous has the deadline.
    Meeting(u16),
    /// The activation waits in a delay with this name; the number is that of the delay's start.
    Delay(TimeId, u8),
    /// The activation waits for the end of an action.
    Work,
    /// The activation waits for the lease (D61).
    Lease,
    /// The activation waits for nothing: a handler interrupted it between two statements.
    Boundary,
}

/// How a wait ended. The task gets the signal at once, or when the handlers above the waiting activation have ended.
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

/// What a part reports to the dispatcher when a wait has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Ended {
    /// The wait that ended. `None` under the rule variant that accepts late replies: then the running activation gets the
    /// signal.
    pub wait: Option<Pending>,
    pub finished: Finished,
}
