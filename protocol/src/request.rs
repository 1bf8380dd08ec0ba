//! The interface between a task and its communication task: requests in, signals out (§5.1.3).
//!
//! A request says only what the task wants and on which port. The communication task derives the verb from the port's usage.
//! Every request gets exactly one answer, a [`Signal`], and a task has at most one outstanding request (R44, R93, D17).

use crate::ids::{MessageId, PortId, Round, TaskId};
use crate::packet::{Class, Contents};
use crate::ticks::Ticks;
use core::fmt;
use serde::{Deserialize, Serialize};

/// Greatest length of what a task publishes to its partner, in bytes: answers to heartbeats carry it (D61, D78).
pub const PUBLISHED_BYTES: usize = 8;

/// The receivers of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Target {
    /// All tasks at the other end of the port (R39).
    All,
    /// One task at the other end (R43).
    One(TaskId),
    /// Some of the tasks at the other end: bit `i` names party `i` of the port, owner first (R40).
    Some(u64),
}

/// Names one of a task's own timers or delays (Figure 3's `time_id`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct TimeId(pub u8);

/// A request of a task to its communication task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Request {
    /// SEND, or a query if that is the port's usage. Class 1: answered by [`Signal::Accepted`] at once. Class 2:
    /// answered by [`Signal::Outcome`] if it goes to one task, by [`Signal::Answers`] if it goes to several.
    Send {
        /// The port, which the task must have with usage `send` or `query`.
        port: PortId,
        /// The receivers.
        to: Target,
        /// The contents of the message, or its first fragment.
        contents: Contents,
        /// The TTL of the message, if shorter than the port's time_out; a longer one is cut to that.
        time_out: Option<Ticks>,
    },
    /// One further fragment of the next SEND or REPLY on this port, if its format takes more than one packet. The
    /// request itself carries fragment 0. Answered by [`Signal::Accepted`] (D28).
    Part {
        /// The port of the message.
        port: PortId,
        /// The position of the fragment, from 1.
        index: u8,
        /// The contents of the fragment.
        contents: Contents,
    },
    /// GET: takes the most urgent message of one port, or of all ports of the task that have no handler. Answered by
    /// [`Signal::Message`], or by [`Signal::Nothing`] when the time_out ends first. A time_out of zero polls (R68).
    Get {
        /// One port; `None` chooses among all ports without a handler.
        port: Option<PortId>,
        /// The sender whose messages suit; `None` takes a message of any sender.
        source: Option<TaskId>,
        /// How long to wait; `None` waits without a limit.
        time_out: Option<Ticks>,
    },
    /// REPLY or response to a received class-2 message. Answered by [`Signal::Accepted`], or by [`Fault::Late`] once
    /// the execution budget has ended. On a port with usage `reply` it answers a message that another task received:
    /// `to` then has this port, and the source and id of that message (D11).
    Reply {
        /// The answered message: the `from` of its [`Delivery`].
        to: ReplyTo,
        /// The answer.
        contents: Contents,
    },
    /// ARRIVE at a `waitfor` (rendezvous, §4.3). Answered by [`Signal::Released`] or [`Signal::GaveUp`].
    Arrive {
        /// The port of the `waitfor`.
        port: PortId,
        /// Bytes for the other members.
        arguments: [u8; 8],
        /// The patience, if shorter than the port's time_out; a longer one is cut to that.
        time_out: Option<Ticks>,
    },
    /// ORDER: from here on, how ports, sources, timers and the task's own thread rank. Answered by
    /// [`Signal::Accepted`] (§5.1.1, D16).
    Order(ServiceOrder),
    /// Says whether the task has a handler for messages of this port. Messages of such a port are offered to the task
    /// as [`Signal::Interrupt`]. Answered by [`Signal::Accepted`] (D15).
    Handle {
        /// The port, which the task must have with usage `receive` or `response`.
        port: PortId,
        /// Whether the task has a handler for the port from here on.
        handled: bool,
    },
    /// DELAY: the running activation sleeps. Answered by [`Signal::TimeOut`] (§5.1.2).
    Delay {
        /// The name of the delay.
        id: TimeId,
        /// How long it sleeps.
        length: Ticks,
    },
    /// Starts a timer of the task, or restarts it if it runs. Its end is offered as [`Call::Timer`]. Answered by
    /// [`Signal::Accepted`].
    Start {
        /// The name of the timer.
        id: TimeId,
        /// After which time the timer ends.
        length: Ticks,
    },
    /// Stops a timer. If its handler has not begun yet, the handler never begins. Answered by [`Signal::Accepted`].
    Stop {
        /// The name of the timer.
        id: TimeId,
    },
    /// A statement boundary: a handler that outranks the running activation may begin here. Answered by
    /// [`Signal::Interrupt`], once more after each [`Request::Return`], and finally by [`Signal::Accepted`] (D15).
    Boundary,
    /// The task carries out an external action, which handlers may interrupt. Not answered until [`Request::Done`].
    Work,
    /// The action of [`Request::Work`] has ended. Answered by [`Signal::Accepted`], or by [`Fault::Busy`] while a
    /// handler that interrupted the action runs.
    Done,
    /// A handler ended, and the activation below it resumes. If its wait ended meanwhile, the answer is that wait's
    /// signal. Otherwise the next [`Signal::Interrupt`] answers, or the end of the wait (R16).
    Return,
    /// Until `Atomic(false)` only the lease's handlers interrupt. Answered by [`Signal::Accepted`] (D15).
    Atomic(bool),
    /// Lets a primary or standby wait until it may act: by lease, or by a take-over. Answered by [`Signal::Granted`] (D61).
    Lease,
    /// From here on the answers to heartbeats carry this, at most [`PUBLISHED_BYTES`]. Answered by [`Signal::Accepted`] (D61).
    Publish(Contents),
    /// The task has ended: it answers no heartbeat any more, so that its partner takes over. Answered by
    /// [`Signal::Accepted`] (D61).
    End,
    /// CANCEL the wait of the running activation. Answered by [`Signal::Cancelled`]. Leaving a `waitfor` this way
    /// sends ABORT to the other members.
    Cancel,
    /// CANCEL every wait and every handler: the task starts again from its beginning. Answered by
    /// [`Signal::Cancelled`].
    Abandon,
}

/// An entry of an `order` (D16).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Ranked {
    /// Messages of this port.
    Port(PortId),
    /// Messages from this task, through any port (Appendix: `order(Ti, TIMER, Tic)`).
    Source(TaskId),
    /// The ends of all timers, except those that the `order` names earlier.
    Timers,
    /// The end of this timer. Its own rank lets a timer that watches a port for silence rank next to that port (D86).
    Timer(TimeId),
    /// The task's own thread: `self`.
    Own,
}

/// The ranks that `order a > b > c` assigns: named entries count up from 0, and everything not named shares the rank
/// after the last. A lower rank goes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "WrittenOrder")]
pub struct ServiceOrder {
    ranked: [Ranked; Self::LEVELS],
    len: u8,
}

/// A [`ServiceOrder`] as deserialised, not yet validated.
#[derive(Deserialize)]
#[serde(rename = "ServiceOrder")]
struct WrittenOrder {
    ranked: [Ranked; ServiceOrder::LEVELS],
    len: u8,
}

impl TryFrom<WrittenOrder> for ServiceOrder {
    type Error = &'static str;

    fn try_from(WrittenOrder { ranked, len }: WrittenOrder) -> Result<Self, Self::Error> {
        let order = Self { ranked, len };
        if usize::from(len) <= Self::LEVELS { Ok(order) } else { Err("an order of too many levels") }
    }
}

impl Default for ServiceOrder {
    fn default() -> Self {
        Self { ranked: [Ranked::Own; Self::LEVELS], len: 0 }
    }
}

impl ServiceOrder {
    /// The greatest number of entries of one `order`.
    pub const LEVELS: usize = 8;

    /// The order that ranks `named` from first to last, or `None` if there are more than [`Self::LEVELS`].
    #[must_use]
    pub fn new(named: &[Ranked]) -> Option<Self> {
        let mut order = Self::default();
        order.ranked.get_mut(..named.len())?.copy_from_slice(named);
        order.len = u8::try_from(named.len()).ok()?;
        Some(order)
    }

    /// The named entries, first to last.
    #[must_use]
    pub fn ranked(&self) -> &[Ranked] {
        &self.ranked[..usize::from(self.len)]
    }

    /// The rank of a message: that of its port or of its source, whichever the `order` names first.
    #[must_use]
    pub fn rank(&self, port: PortId, source: TaskId) -> u8 {
        self.position(|&named| named == Ranked::Port(port) || named == Ranked::Source(source))
    }

    /// The rank of a timer's end: that of this timer or of all timers, whichever the `order` names first.
    #[must_use]
    pub fn timer(&self, id: TimeId) -> u8 {
        self.position(|&named| named == Ranked::Timers || named == Ranked::Timer(id))
    }

    /// The rank of the task's own thread. Without an `order` it is 0, as for all messages: nothing outranks the thread.
    #[must_use]
    pub fn own(&self) -> u8 {
        self.position(|&named| named == Ranked::Own)
    }

    fn position(&self, is: impl Fn(&Ranked) -> bool) -> u8 {
        let position = self.ranked().iter().position(is);
        position.and_then(|p| u8::try_from(p).ok()).unwrap_or(self.len)
    }
}

/// Identifies a received message for a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ReplyTo {
    /// The port through which the message came.
    pub port: PortId,
    /// The sender of the received message.
    pub source: TaskId,
    /// The received message's id.
    pub id: MessageId,
}

impl ReplyTo {
    /// A placeholder, to be overwritten by a decoder.
    pub const BLANK: Self = Self { port: PortId(0), source: TaskId(0), id: MessageId::BLANK };
}

/// A message delivered to its task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Delivery {
    /// Identifies the message for a reply.
    pub from: ReplyTo,
    /// Class 1: a status. Class 2: a command, which must be answered.
    pub class: Class,
    /// The remaining time. For a command this is the execution budget: the link delay of the reply is already subtracted (D18).
    pub budget: Ticks,
    /// The contents, or the first fragment of several. [`CommTask::fragment`] gives the others until the task takes
    /// its next message (D28).
    ///
    /// [`CommTask::fragment`]: crate::CommTask::fragment
    pub contents: Contents,
    /// The number of fragments.
    pub fragments: u8,
}

/// The reason for which a handler begins (D15).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Call {
    /// A message for a handler.
    Message(Delivery),
    /// The end of a timer.
    Timer(TimeId),
    /// The task lost its lease and must stop acting. Outranks everything (D61).
    Fenced,
    /// The task's partner has failed: the task acts in its place from now on, under this epoch. Outranks everything (D61).
    TakeOver(u8),
}

/// The outcome of a class-2 message to several tasks. Bit `i` stands for party `i` of the port, owner first. An asked
/// task with no other bit may have carried the message out: no answer came in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Answers {
    /// The tasks that were asked.
    pub asked: u64,
    /// The tasks that answered: see [`CommTask::answer_of`](crate::CommTask::answer_of).
    pub answered: u64,
    /// The tasks that refused.
    pub refused: u64,
    /// The tasks whose node restarted meanwhile.
    pub restarted: u64,
    /// The tasks for which no copy ever left this node.
    pub unsent: u64,
}

/// The outcome of a class-2 message. It tells a robot program whether the arm may have moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Outcome {
    /// The answer.
    Reply(Contents),
    /// No room at the destination or on the route; the command did not run.
    Refused,
    /// The time_out ended and no copy ever left this node; the command did not run.
    TimedOutUnsent,
    /// The time_out ended without an answer; the command may have run.
    TimedOutUnknown,
    /// The destination's node stopped or restarted meanwhile; the command may have run.
    PeerRestarted,
}

/// Why a task was released from a `waitfor` (rendezvous).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ReleasedBy {
    /// The task held the arrivals of all others, each with more patience left than the margin.
    AllArrived,
    /// A CONFIRM of this member, or its message that it has released the round.
    Confirm(TaskId),
}

/// The reason why a request is not carried out. Nothing was sent; fragments staged for the message are dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Fault {
    /// The task neither owns nor uses the port.
    NotYourPort,
    /// The port's usage does not allow this; or the task is neither primary nor standby, or carries out no action.
    WrongUsage,
    /// The named task is not at the other end of the port.
    NotAPeer,
    /// A request is outstanding in the running activation, or in an interrupted one on the same port, lease or delay name.
    Busy,
    /// All timers of the task are in use: [`CommTask::TIMERS`](crate::CommTask::TIMERS).
    TooManyTimers,
    /// A message or an answer has more fragments than its format allows, or a fragment is missing (D28).
    WrongLength,
    /// No handler runs.
    NotInterrupted,
    /// The task does not hold the lease that the port needs, or it no longer acts at all (D61).
    Fenced,
    /// No such message is waiting for a reply.
    NothingToAnswer,
    /// The execution budget has ended: the sender no longer waits.
    Late,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotYourPort => "the port is not the task's own",
            Self::WrongUsage => "the port's usage does not allow this",
            Self::NotAPeer => "that task is not at the other end of the port",
            Self::Busy => "another request of the task is not over",
            Self::TooManyTimers => "the task has too many timers",
            Self::WrongLength => "the message has the wrong length",
            Self::NotInterrupted => "no handler runs",
            Self::Fenced => "the task does not hold the lease that the port needs",
            Self::NothingToAnswer => "no message waits for an answer",
            Self::Late => "the execution budget has ended, and the sender waits no longer",
        })
    }
}

/// The answer of a communication task to its task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Signal {
    /// Done. For a class-1 send: the number of copies handed to the route layer.
    Accepted(u16),
    /// The request cannot be carried out.
    Fault(Fault),
    /// A class-2 message to one task ended.
    Outcome(Outcome),
    /// A class-2 message to several tasks ended: every task has answered, refused or restarted, or the time_out ended.
    Answers {
        /// The port of the message.
        port: PortId,
        /// The outcome for each task.
        answers: Answers,
    },
    /// The running activation is suspended for a handler, which ends with [`Request::Return`].
    Interrupt(Call),
    /// The task, a primary or standby, may act from now on, under this epoch of its lease (D61).
    Granted(u8),
    /// The message that a GET waited for.
    Message(Delivery),
    /// A GET ended without a message.
    Nothing,
    /// All members of the rendezvous have arrived.
    Released {
        /// The port of the rendezvous.
        port: PortId,
        /// The round: the same for all members that are released together.
        round: Round,
        /// How this task learnt of the release.
        by: ReleasedBy,
    },
    /// An ARRIVE ended without a release.
    GaveUp {
        /// The port of the rendezvous.
        port: PortId,
        /// The round in which the task waited.
        round: Round,
        /// Bit `i`: party `i` of the port, owner first, had not arrived.
        missing: u64,
    },
    /// The delay of this name is over.
    TimeOut(TimeId),
    /// The cancelled wait, or all waits, have ended.
    Cancelled,
}
