//! What a thread of the task waits for, and how its wait ended.

use crate::ids::{PortId, Round, TaskId};
use crate::request::{Outcome, ReleasedBy, TimeId};
use crate::ticks::Instant;
use serde::{Deserialize, Serialize};

/// What a thread of the task waits for: one outstanding communication (R93).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) enum Pending {
    Nothing,
    Get {
        port: Option<PortId>,
        source: Option<TaskId>,
        deadline: Instant,
    },
    /// The answers to the request at this desk; its deadline stands there.
    Reply(u16),
    /// The rendezvous at this position of the list; its deadline stands there.
    Meeting(u16),
    /// A delay, and which start of it.
    Delay(TimeId, u8),
    /// The end of an action outside.
    Work,
    /// The lease (D61).
    Lease,
    /// Nothing, but a handler runs between two of its statements.
    Boundary,
}

/// How a wait ended. It is told at once, or when the handlers above the thread that waited have ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) enum Finished {
    Outcome(Outcome),
    /// The request at this desk, to several tasks.
    Answers(u16),
    /// The request at this desk, with an answer in several packets.
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

/// A wait that ended, as the part that it was for says it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Ended {
    /// What was waited for. None: under the variant that takes late answers, whoever runs is told.
    pub wait: Option<Pending>,
    pub finished: Finished,
}
