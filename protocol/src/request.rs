//! What passes between a task and its communication task (§5.1.3): requests in, signals out.
//!
//! A request says only what the task wants and on which port; the verb is recovered from the port's usage (R44, D17).
//! Every request gets exactly one answer: [`Signal`]. A task has one outstanding request (R93).

use crate::ids::{MessageId, PortId, Round, TaskId};
use crate::packet::{Class, Contents};
use crate::ticks::Ticks;
use core::fmt;
use serde::{Deserialize, Serialize};

/// How many bytes a task can publish for the answers to the beats of its couple (D61, D78).
pub const PUBLISHED_BYTES: usize = 8;

/// Who a message is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Target {
    /// All tasks at the other end of the port (R39).
    All,
    /// One of them (R43).
    One(TaskId),
    /// Some of them (R40): bit `i` names party `i` of the port, owner first.
    Some(u64),
}

/// Names one of a task's own timers or delays (Figure 3's `time_id`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct TimeId(pub u8);

/// What a task asks of its communication task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Request {
    /// SEND, or a query where that is the port's usage. Class 1: answered by [`Signal::Accepted`] at once. Class 2:
    /// answered by [`Signal::Outcome`] where one task is asked, by [`Signal::Answers`] where several are.
    Send {
        /// The port, which the task must have with usage `send` or `query`.
        port: PortId,
        /// Who it is for.
        to: Target,
        /// What it says.
        contents: Contents,
        /// The life of the message where it is shorter than the port's; a longer one is cut to that.
        time_out: Option<Ticks>,
    },
    /// One more fragment of the next SEND or REPLY on this port, where its format takes more than one packet (D28).
    /// Fragment 0 is the contents of the request itself. Answered by [`Signal::Accepted`].
    Part {
        /// The port.
        port: PortId,
        /// The position of the fragment, from 1.
        index: u8,
        /// The fragment.
        contents: Contents,
    },
    /// GET: the most urgent message of the port, or of all the task's ports (R68) that have no handler. Answered by [`Signal::Message`],
    /// or by [`Signal::Nothing`] when the time_out ends first; a time_out of zero polls.
    Get {
        /// One port, or the most urgent over all.
        port: Option<PortId>,
        /// One source, or any.
        source: Option<TaskId>,
        /// How long to wait; `None` waits without end.
        time_out: Option<Ticks>,
    },
    /// REPLY or response to a received class-2 message. Answered by [`Signal::Accepted`], or [`Signal::Fault`] with
    /// [`Fault::Late`] when the execution budget has ended. On a port with usage `reply` it answers a message that
    /// another task received (D11): the port is that port, source and id are those of the message.
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
    /// ORDER: ranks ports, sources, timers and the current thread from here on (§5.1.1, D16). Answered by
    /// [`Signal::Accepted`].
    Order(ServiceOrder),
    /// Says whether the task has a handler for messages of this port: then they are offered to it as
    /// [`Signal::Interrupt`] (D15). Answered by [`Signal::Accepted`].
    Handle {
        /// The port, on which the task receives or responds.
        port: PortId,
        /// Whether there is a handler.
        handled: bool,
    },
    /// DELAY (§5.1.2). Answered by [`Signal::TimeOut`].
    Delay {
        /// The name of the delay.
        id: TimeId,
        /// How long.
        length: Ticks,
    },
    /// Starts a timer of the task, anew where it runs: its end is offered as [`Call::Timer`]. Answered by
    /// [`Signal::Accepted`].
    Start {
        /// The name of the timer.
        id: TimeId,
        /// How long.
        length: Ticks,
    },
    /// Stops a timer, and takes back its end where that was not offered yet. Answered by [`Signal::Accepted`].
    Stop {
        /// The name of the timer.
        id: TimeId,
    },
    /// A statement boundary: a handler that outranks the current thread may run here (D15). Answered by
    /// [`Signal::Interrupt`], and after its [`Request::Return`] again by this rule, or by [`Signal::Accepted`].
    Boundary,
    /// The task is busy with an action outside that handlers may interrupt. Not answered until [`Request::Done`].
    Work,
    /// The action of [`Request::Work`] has ended. Answered by [`Signal::Accepted`]; by [`Fault::Busy`] while a handler
    /// that interrupted it runs.
    Done,
    /// A handler ended: the interrupted thread resumes (R16). Answered by the signal that the interrupted wait came to
    /// meanwhile, by another [`Signal::Interrupt`], or not before there is one of them.
    Return,
    /// Until `Atomic(false)` no handler interrupts (D15). Answered by [`Signal::Accepted`].
    Atomic(bool),
    /// Waits for the lease of the couple that the task is the primary of (D61). Answered by [`Signal::Granted`].
    Lease,
    /// What the beats' answers carry from here on (D61): at most [`PUBLISHED_BYTES`]. Answered by [`Signal::Accepted`].
    Publish(Contents),
    /// The task has ended: it answers no beat any more, so that its partner takes over (D61). Answered by
    /// [`Signal::Accepted`].
    End,
    /// CANCEL the wait of the current thread. Answered by [`Signal::Cancelled`]. Leaving a `waitfor` this way tells the
    /// others.
    Cancel,
    /// CANCEL every wait, and every handler with the threads it interrupted: the task begins anew. Answered by
    /// [`Signal::Cancelled`].
    Abandon,
}

/// What `order` ranks (D16).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Ranked {
    /// Messages of this port.
    Port(PortId),
    /// Messages of this task, through any port (Appendix: `order(Ti, TIMER, Tic)`).
    Source(TaskId),
    /// The ends of the task's timers, but those that are named before.
    Timers,
    /// The end of this timer: so a watch on a port's silence ranks beside the port (D86).
    Timer(TimeId),
    /// The current thread: `self`.
    Own,
}

/// The ranks that `order a > b > c` gives: what is named first, in this order, then all the rest alike. A smaller rank
/// goes first, and the rank is the number of levels above it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "WrittenOrder")]
pub struct ServiceOrder {
    ranked: [Ranked; Self::LEVELS],
    len: u8,
}

/// An order as a file has it, before it is known to be one.
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
    /// How many levels one `order` can name.
    pub const LEVELS: usize = 8;

    /// The order that ranks `named` from first to last, or `None` where there are more than [`Self::LEVELS`].
    #[must_use]
    pub fn new(named: &[Ranked]) -> Option<Self> {
        let mut order = Self::default();
        order.ranked.get_mut(..named.len())?.copy_from_slice(named);
        order.len = u8::try_from(named.len()).ok()?;
        Some(order)
    }

    /// What is named, first to last.
    #[must_use]
    pub fn ranked(&self) -> &[Ranked] {
        &self.ranked[..usize::from(self.len)]
    }

    /// The rank of a message: that of its port or of its source, whichever is named first.
    #[must_use]
    pub fn rank(&self, port: PortId, source: TaskId) -> u8 {
        self.position(|&named| named == Ranked::Port(port) || named == Ranked::Source(source))
    }

    /// The rank of the end of a timer: its own or that of all timers, whichever is named first.
    #[must_use]
    pub fn timer(&self, id: TimeId) -> u8 {
        self.position(|&named| named == Ranked::Timers || named == Ranked::Timer(id))
    }

    /// The rank of the current thread. Without an `order` it is 0, as that of all messages: nothing outranks it.
    #[must_use]
    pub fn own(&self) -> u8 {
        self.position(|&named| named == Ranked::Own)
    }

    fn position(&self, is: impl Fn(&Ranked) -> bool) -> u8 {
        let position = self.ranked().iter().position(is);
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

impl ReplyTo {
    /// Of no message yet: to be read.
    pub const BLANK: Self = Self { port: PortId(0), source: TaskId(0), id: MessageId::BLANK };
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
    /// What it says; of a longer format the first fragment (D28). The others are [`CommTask::fragment`]s until the task
    /// takes its next message.
    ///
    /// [`CommTask::fragment`]: crate::CommTask::fragment
    pub contents: Contents,
    /// How many fragments it has.
    pub fragments: u8,
}

/// What interrupts the current thread (D15).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Call {
    /// A message for a handler.
    Message(Delivery),
    /// The end of a timer.
    Timer(TimeId),
    /// The task lost its lease: it must stop acting (D61). Outranks everything.
    Fenced,
    /// The task's partner is gone: it acts in its place from now on, under this epoch (D61). Outranks everything.
    TakeOver(u8),
}

/// How a class-2 message to several tasks ended. Bit `i` stands for party `i` of the port, owner first. An asked task
/// without any bit may have run it: its answer did not come in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Answers {
    /// Who was asked.
    pub asked: u64,
    /// Who answered: see [`CommTask::answer_of`](crate::CommTask::answer_of).
    pub answered: u64,
    /// Who refused.
    pub refused: u64,
    /// Whose node restarted meanwhile.
    pub restarted: u64,
    /// For whom no copy ever left this node.
    pub unsent: u64,
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
    /// Another request is outstanding, or one on this port in a thread that a handler interrupted.
    Busy,
    /// The task has as many timers as it may: [`CommTask::TIMERS`](crate::CommTask::TIMERS).
    TooManyTimers,
    /// A message or an answer has more fragments than its format allows, or a fragment is missing (D28).
    WrongLength,
    /// No handler runs.
    NotInterrupted,
    /// The port acts under a lease that the task does not hold (D61).
    Fenced,
    /// No such message is waiting for a reply.
    NothingToAnswer,
    /// The execution budget has ended; the sender is beyond waiting.
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
            Self::Late => "the execution budget has ended, nobody waits for the answer any more",
        })
    }
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
    /// A class-2 message to several tasks ended: all answered or refused, or its time_out did.
    Answers {
        /// The port.
        port: PortId,
        /// How.
        answers: Answers,
    },
    /// The current thread is suspended: the handler for this runs, and ends with [`Request::Return`].
    Interrupt(Call),
    /// The task holds the lease of its couple, under this epoch (D61).
    Granted(u8),
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
