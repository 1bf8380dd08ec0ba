//! How the calls of a task's program end.

use crate::api::message::Bytes;
use imrs_protocol::{Answers, Contents, Fault, Outcome, ReleasedBy, ReplyTo, Round, Ticks, TimeId};

/// Why a call of a task's program was not carried out.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TaskError {
    /// The node stops: the program should return.
    #[error("the node stops")]
    Stopped,
    /// The request is wrong; the communication task did nothing.
    #[error("{0}")]
    Fault(#[from] RequestFault),
    /// The cell has no port of this name, or the task is no party of it.
    #[error("the task has no port `{0}`: check the name and the port's user_list")]
    NoPort(String),
    /// The cell has no task of this name.
    #[error("the cell has no task `{0}`")]
    NoTask(String),
    /// The message does not fit into the packets of the port's format.
    #[error("a message of {0} bytes is longer than its port's format allows")]
    TooLong(usize),
    /// One `order` names more ports than there are levels.
    #[error("`order` ranks at most 8 ports, not {0}")]
    TooManyLevels(usize),
    /// The received bytes are not a message of the type that the program reads.
    #[error("{0} bytes arrived that are not a `{1}`: check that both ends use the port's format")]
    NotThisType(usize, &'static str),
    /// A field holds a value that no message can hold: a real that is not finite.
    #[error("a `{0}` with a real that is not finite cannot be sent")]
    NotSendable(&'static str),
    /// The task has taken another message since, so the fragments of this message are gone.
    #[error("only the message that was taken last can be read whole")]
    Gone,
    /// The timer to be started has no handler.
    #[error("timer {0:?} has no handler: call `on_timer` first")]
    NoHandler(TimeId),
}

/// A [`Fault`] as an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", explain(.0))]
pub struct RequestFault(pub Fault);

fn explain(fault: &Fault) -> &'static str {
    match fault {
        Fault::NotYourPort => "the task neither owns nor uses this port",
        Fault::WrongUsage => "the port's usage does not allow this",
        Fault::NotAPeer => "the named task is not at the other end of the port",
        Fault::TooManyTimers => "the task has as many timers as it may",
        Fault::WrongLength => "the message has more fragments than its format, or one is missing",
        Fault::NotInterrupted => "no handler runs",
        Fault::Fenced => "the task does not hold the lease that this port acts under",
        Fault::Busy => "another request is outstanding",
        Fault::NothingToAnswer => "no such message waits for a reply",
        Fault::Late => "the execution budget has ended, and the sender waits no longer",
    }
}

/// How a `send` ended.
///
/// ```
/// use imrs_protocol::Outcome;
/// use imrs_runtime::Sent;
///
/// /// What a program does next: after a time_out the command may have run, so it asks before it tries again.
/// fn next(sent: Sent) -> &'static str {
///     match sent {
///         Sent::Copies(_) | Sent::Outcome(Outcome::Reply(_)) => "go on",
///         Sent::Outcome(Outcome::Refused | Outcome::TimedOutUnsent) => "try again: it did not run",
///         Sent::Outcome(Outcome::TimedOutUnknown | Outcome::PeerRestarted) => "ask first: it may have run",
///         Sent::Several(answers) => if answers.answered == answers.asked { "go on" } else { "ask the others" },
///     }
/// }
/// assert_eq!(next(Sent::Outcome(Outcome::Refused)), "try again: it did not run");
/// ```
#[must_use = "a command that was not answered may or may not have run"]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    /// Class 1: how many copies were accepted. Whether they arrive is not reported.
    Copies(u16),
    /// Class 2: the outcome.
    Outcome(Outcome),
    /// Class 2 to several tasks: the outcome for each task.
    Several(Answers),
}

impl Sent {
    /// The answer to a class-2 message to one task, if there is one. Of an answer of several packets this is the first
    /// packet.
    #[must_use]
    pub fn reply(self) -> Option<Contents> {
        match self {
            Self::Outcome(Outcome::Reply(contents)) => Some(contents),
            Self::Outcome(
                Outcome::Refused
                | Outcome::TimedOutUnsent
                | Outcome::TimedOutUnknown
                | Outcome::PeerRestarted,
            )
            | Self::Copies(_)
            | Self::Several(_) => None,
        }
    }
}

/// How a query or a command ended, with its answer. A `match` must say what the program does in each case: in two of
/// them, `TimedOutUnknown` and `PeerRestarted`, the other task may have acted.
#[must_use = "a command that was not answered may or may not have run"]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asked<M = Bytes> {
    /// The answer.
    Reply(M),
    /// There was no room at the destination or on the route; the command did not run.
    Refused,
    /// The time_out ended and no copy ever left this node; the command did not run.
    TimedOutUnsent,
    /// The time_out ended without an answer; the command may have run.
    TimedOutUnknown,
    /// The destination's node stopped or restarted before the answer came; the command may have run.
    PeerRestarted,
}

impl<M> Asked<M> {
    /// The answer, if there is one.
    #[must_use]
    pub fn reply(self) -> Option<M> {
        match self {
            Self::Reply(answer) => Some(answer),
            Self::Refused | Self::TimedOutUnsent | Self::TimedOutUnknown | Self::PeerRestarted => None,
        }
    }

    /// Whether the other task may have acted on the message without this program knowing the result.
    #[must_use]
    pub const fn may_have_run(&self) -> bool {
        match self {
            Self::TimedOutUnknown | Self::PeerRestarted => true,
            Self::Reply(_) | Self::Refused | Self::TimedOutUnsent => false,
        }
    }
}

/// A message of a known type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Received<M> {
    /// The message itself.
    pub message: M,
    /// Names the message for a reply, and its sender.
    pub from: ReplyTo,
    /// The remaining time of the message, in microseconds: for a command, the execution budget.
    pub budget: Ticks,
}

/// How a `waitfor` ended (§4.3). Both outcomes are normal: every program says what it does on time_out.
///
/// ```
/// use imrs_protocol::{Cell, CellTable, PortDecl, Ticks, Usage};
/// use imrs_runtime::{Context, Rendezvous, Runtime, TaskError};
/// use std::{sync::Arc, time::Duration};
///
/// fn lift(ctx: &mut Context) -> Result<(), TaskError> {
///     let port = ctx.port("lift")?;
///     match ctx.waitfor(port)? {
///         Rendezvous::Released { .. } => println!("{} lifts", ctx.name()),
///         Rendezvous::GaveUp { missing, .. } => println!("{} puts down: {missing:b} did not come", ctx.name()),
///     }
///     Ok(())
/// }
///
/// let mut cell = Cell::new("beam", Ticks(1_000));
/// let here = cell.node("here");
/// let (left, right) = (cell.task("left", here), cell.task("right", here));
/// cell.port(PortDecl::new("lift", left, Usage::Waitfor, &[right], Ticks(2_000_000)));
/// let table = Arc::new(CellTable::new(cell).expect("a sound cell"));
/// let node = Runtime::builder(table, here).task("left", lift).task("right", lift).start().expect("a node that starts");
/// assert!(node.wait(Duration::from_secs(10)));
/// ```
#[must_use = "a task that gave up must not act as if all had arrived"]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rendezvous {
    /// All members of the rendezvous have arrived.
    Released {
        /// The round, the same for all tasks that this meeting releases.
        round: Round,
        /// How this task learned of the release.
        by: ReleasedBy,
    },
    /// The task's time_out ended before the rendezvous was complete.
    GaveUp {
        /// The round in which the task waited.
        round: Round,
        /// Bit `i`: party `i` of the port (owner first) had not arrived.
        missing: u64,
    },
}
