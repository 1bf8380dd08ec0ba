//! What passes between a task and its communication task (§5.1.3): requests in, signals out.
//!
//! A request says only what the task wants and on which port; the verb is recovered from the port's usage (R44, D17).
//! Every request gets exactly one answer: [`Signal`]. A task has one outstanding request (R93).

use crate::ids::{MessageId, PortId, Round, TaskId};
use crate::packet::{Class, Contents};
use crate::ticks::Ticks;
use serde::{Deserialize, Serialize};

/// Who a message is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Target {
    /// All tasks at the other end of the port (R39).
    All,
    /// One of them (R43).
    One(TaskId),
}

/// Names one of a task's own timers or delays (Figure 3's `time_id`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct TimeId(pub u8);

/// What a task asks of its communication task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Request {
    /// SEND. Class 1: answered by [`Signal::Accepted`] at once. Class 2: answered by [`Signal::Outcome`].
    Send {
        /// The port, which the task must have with usage `send`.
        port: PortId,
        /// Who it is for.
        to: Target,
        /// What it says.
        contents: Contents,
        /// The life of the message where it is shorter than the port's; a longer one is cut to that.
        time_out: Option<Ticks>,
    },
    /// GET: the most urgent message of the port, or of all the task's ports (R68). Answered by [`Signal::Message`],
    /// or by [`Signal::Nothing`] when the time_out ends first; a time_out of zero polls.
    Get {
        /// One port, or the most urgent over all.
        port: Option<PortId>,
        /// One source, or any.
        source: Option<TaskId>,
        /// How long to wait; `None` waits without end.
        time_out: Option<Ticks>,
    },
    /// REPLY to a received class-2 message. Answered by [`Signal::Accepted`], or [`Signal::Fault`] with
    /// [`Fault::Late`] when the execution budget has ended.
    Reply {
        /// The message, as its delivery named it.
        to: ReplyTo,
        /// The answer.
        contents: Contents,
    },
    /// ARRIVE at a `waitfor` (§4.3). Answered by [`Signal::Released`] or [`Signal::GaveUp`].
    Arrive {
        /// The port.
        port: PortId,
        /// What the others are told.
        arguments: [u8; 8],
        /// How long to wait where it is shorter than the port's time_out; a longer one is cut to that.
        time_out: Option<Ticks>,
    },
    /// ORDER: ranks ports from here on (§5.1.1, D16). Answered by [`Signal::Accepted`].
    Order(ServiceOrder),
    /// DELAY (§5.1.2). Answered by [`Signal::TimeOut`].
    Delay {
        /// The name of the delay.
        id: TimeId,
        /// How long.
        length: Ticks,
    },
    /// CANCEL whatever is outstanding. Answered by [`Signal::Cancelled`]. Leaving a `waitfor` this way tells the others.
    Cancel,
}

/// The ranks that `order a > b > c` gives: named ports first, in this order, then all others alike.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ServiceOrder {
    ports: [PortId; Self::LEVELS],
    len: u8,
}

impl ServiceOrder {
    /// How many levels one `order` can name.
    pub const LEVELS: usize = 8;

    /// The order that ranks `ports` from first to last, or `None` where there are more than [`Self::LEVELS`].
    #[must_use]
    pub fn new(ports: &[PortId]) -> Option<Self> {
        let mut order = Self::default();
        order.ports.get_mut(..ports.len())?.copy_from_slice(ports);
        order.len = u8::try_from(ports.len()).ok()?;
        Some(order)
    }

    /// The ranked ports, first to last.
    #[must_use]
    pub fn ports(&self) -> &[PortId] {
        &self.ports[..usize::from(self.len)]
    }

    /// The rank of `port`: smaller goes first.
    #[must_use]
    pub fn rank(&self, port: PortId) -> u8 {
        let position = self.ports().iter().position(|&p| p == port);
        position.and_then(|p| u8::try_from(p).ok()).unwrap_or(self.len)
    }
}

/// Names a received message that can be answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ReplyTo {
    /// The port it came through.
    pub port: PortId,
    /// Who sent it.
    pub source: TaskId,
    /// Its id.
    pub id: MessageId,
}

/// A message handed to its task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Delivery {
    /// Names the message for a reply.
    pub from: ReplyTo,
    /// Status, or a command that must be answered.
    pub class: Class,
    /// What is left of its life: for a command, the execution budget, with the way back already taken off (D18).
    pub budget: Ticks,
    /// What it says.
    pub contents: Contents,
}

/// How a class-2 message ended. A robot program must know whether the arm may have moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Outcome {
    /// The answer.
    Reply(Contents),
    /// No space at the destination or on the way; it did not run.
    Refused,
    /// The time_out ended and no copy ever left this node; it did not run.
    TimedOutUnsent,
    /// The time_out ended without an answer; it may have run.
    TimedOutUnknown,
    /// The destination's node restarted meanwhile; it may have run.
    PeerRestarted,
}

/// Why a task was released from a `waitfor`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ReleasedBy {
    /// It held every arrival, with more than the margin left of each.
    AllArrived,
    /// This task's CONFIRM, or word that it has released the round.
    Confirm(TaskId),
}

/// A fault of a request itself. Nothing was done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Fault {
    /// The task neither owns nor uses the port.
    NotYourPort,
    /// The port's usage does not allow this.
    WrongUsage,
    /// The named task is not at the other end of the port.
    NotAPeer,
    /// A class-2 message is for one task; name it.
    NeedsOneDestination,
    /// Another request is outstanding.
    Busy,
    /// No such message is waiting for a reply.
    NothingToAnswer,
    /// The execution budget has ended; the sender is beyond waiting.
    Late,
}

/// What a communication task answers its task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Signal {
    /// Done; of a class-1 send, how many copies were accepted.
    Accepted(u16),
    /// The request itself is at fault.
    Fault(Fault),
    /// A class-2 message ended.
    Outcome(Outcome),
    /// A message.
    Message(Delivery),
    /// The wait of a GET ended without a message.
    Nothing,
    /// All have arrived.
    Released {
        /// The port.
        port: PortId,
        /// The round, the same for all that this meeting releases.
        round: Round,
        /// How this task came to know.
        by: ReleasedBy,
    },
    /// The wait of an ARRIVE ended without a release.
    GaveUp {
        /// The port.
        port: PortId,
        /// The round waited in.
        round: Round,
        /// Bit `i`: party `i` of the port (owner first) had not arrived.
        missing: u64,
    },
    /// The delay or timer of this name is over.
    TimeOut(TimeId),
    /// The outstanding request was given up.
    Cancelled,
}
