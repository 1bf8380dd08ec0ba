//! What a task's script is compiled to: a flat list of operations and the tables they point into.

use super::value::{Slot, Term, Type};
use crate::ids::{PortId, TaskId};
use crate::packet::CONTENTS_BYTES;
use crate::request::{ServiceOrder, Target, TimeId};
use crate::ticks::Ticks;
use alloc::string::String;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};

/// A position in a program's code.
pub type Address = u16;

/// The most packets that one message takes (D28).
pub const MAX_FRAGMENTS: usize = 16;
/// The most bytes of one message.
pub const MAX_MESSAGE: usize = MAX_FRAGMENTS * CONTENTS_BYTES;

/// A variable.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Variable {
    /// Its name; of a field of a record, with the record's: `me.height`.
    pub name: String,
    /// What it holds.
    pub of: Type,
    /// What it holds when the task or the handler begins.
    pub initial: i64,
}

impl Variable {
    /// Its initial value; zero, which is of every type, where that is not of its type.
    pub(super) fn first(&self) -> i64 {
        if self.of.holds(self.initial) { self.initial } else { 0 }
    }
}

/// The layout of a message or an answer: its fields one after another, little endian, without gaps, cut into packets
/// of 12 bytes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Format {
    /// The fields.
    pub fields: Vec<Type>,
}

impl Format {
    /// How many bytes it takes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.fields.iter().map(|field| field.bytes()).sum()
    }

    /// The fields that stand whole in the first `bytes` of such a message, up to one that is no value of its type.
    pub fn values<'a>(&'a self, bytes: &'a [u8]) -> impl Iterator<Item = (Type, i64)> + 'a {
        let mut rest = bytes;
        self.fields.iter().map_while(move |&of| {
            let value = of.read(rest)?;
            rest = &rest[of.bytes()..];
            Some((of, value))
        })
    }

    /// How many packets it takes: one even where it is empty.
    #[must_use]
    pub fn fragments(&self) -> usize {
        self.bytes().div_ceil(CONTENTS_BYTES).max(1)
    }
}

/// What calls a handler.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Trigger {
    /// `on query`, `on receive`: a message of this port.
    Message(PortId),
    /// `on expiry`: the end of this timer.
    Timer(TimeId),
    /// `on fence`: the task lost its lease (D61).
    Fenced,
}

/// A handler: runs above the thread that it interrupts, with variables of its own.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Handler {
    /// What calls it.
    pub trigger: Trigger,
    /// Where its code begins. It ends with [`Op::HandlerEnd`].
    pub entry: Address,
    /// Its variables: [`Slot::Local`].
    pub locals: Vec<Variable>,
}

/// How a statement that asks for something ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum StatementOutcome {
    /// It was accepted, or what it waited for is over; of an action: it succeeded.
    Done = 0,
    /// The answer came; of a message to several: all answered.
    Reply = 1,
    /// Refused for want of space; it did not run.
    Refused = 2,
    /// The time_out ended before a copy left the node; it did not run.
    TimedOutUnsent = 3,
    /// The time_out ended without an answer; it may have run.
    TimedOutUnknown = 4,
    /// The destination restarted; it may have run.
    PeerRestarted = 5,
    /// Of a message to several: not all answered.
    Incomplete = 6,
    /// A message came.
    Message = 7,
    /// No message came in time.
    Nothing = 8,
    /// All have arrived.
    Released = 9,
    /// Not all arrived in time.
    GaveUp = 10,
    /// The action failed.
    Failed = 11,
    /// There is no message to answer: none was received, it is answered already, or its execution budget has ended.
    Unanswerable = 12,
    /// The port acts under a lease that the task does not hold (D61).
    Fenced = 13,
}

/// A set of outcomes, for a branch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Outcomes(pub u16);

impl Outcomes {
    /// What `on time_out do` takes.
    pub const TIME_OUT: Self = Self::of(&[
        StatementOutcome::TimedOutUnsent,
        StatementOutcome::TimedOutUnknown,
        StatementOutcome::PeerRestarted,
        StatementOutcome::Incomplete,
        StatementOutcome::Nothing,
        StatementOutcome::GaveUp,
    ]);
    /// What `on refused do` takes.
    pub const REFUSED: Self = Self::of(&[StatementOutcome::Refused]);
    /// What brings something to [`Op::Unpack`].
    pub const BRINGS: Self = Self::of(&[StatementOutcome::Reply, StatementOutcome::Message]);
    /// What a statement without a branch of its own ends the task on.
    pub const BAD: Self = Self(
        Self::TIME_OUT.0
            | Self::REFUSED.0
            | Self::of(&[StatementOutcome::Failed, StatementOutcome::Unanswerable, StatementOutcome::Fenced])
                .0,
    );

    /// The set of these.
    #[must_use]
    pub const fn of(outcomes: &[StatementOutcome]) -> Self {
        let (mut set, mut i) = (0, 0);
        while i < outcomes.len() {
            set |= 1 << outcomes[i] as u16;
            i += 1;
        }
        Self(set)
    }

    /// Whether it has this one.
    #[must_use]
    pub const fn has(self, outcome: StatementOutcome) -> bool {
        self.0 >> outcome as u16 & 1 == 1
    }
}

/// Which mask of a message to several [`Op::Mark`] looks at: see [`Answers`](crate::Answers).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the names are those of the fields")]
pub enum Mark {
    Asked,
    Answered,
    Refused,
    Restarted,
    Unsent,
}

/// One operation. Those that ask for something wait for the answer, which leaves a [`StatementOutcome`] and perhaps a
/// value, an answer or a message. These last until the next statement begins, or the script asks for something else.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Op {
    /// A statement begins here: what runs may be observed, and a handler may come first (D15).
    Statement,
    /// A step of an expression.
    Term(Term),
    /// Pops a value into a variable.
    Store(Slot),
    /// Pops a value and forgets it.
    Pop,
    /// Goes on elsewhere.
    Jump(Address),
    /// Pops a truth value and goes on elsewhere where it is false.
    Unless(Address),
    /// Goes on elsewhere where the last statement ended in one of these ways.
    On {
        /// The ways.
        outcomes: Outcomes,
        /// Where.
        to: Address,
    },
    /// Pushes the number of the [`StatementOutcome`].
    Outcome,
    /// Pushes the number that the last answer brought: the result of an action, how many copies a send made, the epoch
    /// of a lease, or bit by bit who was missing at a `waitfor`.
    Value,
    /// Pushes a mask of how the last message to several ended.
    Mark(Mark),
    /// Takes the answer of one of several that were asked as what [`Op::Unpack`] reads, and pushes whether it came.
    Answer {
        /// The port.
        port: PortId,
        /// The task.
        task: TaskId,
    },
    /// Reads the fields of the message or answer that came into [`Program::places`], from `into` on.
    Unpack {
        /// Its format.
        format: u16,
        /// The first of as many places as it has fields.
        into: u16,
    },
    /// Pushes the port through which the last message came.
    ReceivedPort,
    /// Pushes the task from which the last message came.
    ReceivedSource,
    /// Pushes the number of the message that this thread received last and has to answer, a [`Type::Word`]; 0 where there is
    /// none. With [`Op::ReceivedSource`] it names the message to a task that answers in this one's place. Such a number
    /// in a variable or a message is no part of a canonical state (D51): a checker refuses the program.
    ReceivedId,
    /// Takes what the task at the other end of the couple published last as what [`Op::Unpack`] reads, and pushes
    /// whether there is anything (D61).
    Published,
    /// Takes what a member told at the waitfor, in the round that this task waits in or was released from last, as what
    /// [`Op::Unpack`] reads, and pushes whether that is known: after a release by a CONFIRM it may not be.
    Arrival {
        /// The waitfor.
        port: PortId,
        /// The member.
        task: TaskId,
        /// The format of its arguments.
        format: u16,
    },
    /// SEND, or a query: pops the fields.
    Send {
        /// The port.
        port: PortId,
        /// Who it is for.
        to: Target,
        /// Its format.
        format: u16,
        /// Its life, where it is shorter than the port's.
        time_out: Option<Ticks>,
    },
    /// GET.
    Get {
        /// One port, or all that have no handler.
        port: Option<PortId>,
        /// One source, or any.
        source: Option<TaskId>,
        /// How long to wait; `None` waits without end.
        time_out: Option<Ticks>,
    },
    /// Reply or response to the message that this thread received last: pops the fields.
    Reply {
        /// Its format.
        format: u16,
    },
    /// Reply to a message that another task received, or this one before: pops the fields, then the number of the message
    /// ([`Op::ReceivedId`]), then its source.
    ReplyFor {
        /// A port with usage `reply`, or the one that this task received the message on.
        port: PortId,
        /// Its format.
        format: u16,
    },
    /// Reply to the message of `task` that this task took on `port` some time ago and has not answered (D93): pops the
    /// fields. A task has one such message on a port at most (D75), so that no number is needed.
    ReplyOwed {
        /// The port that it came on.
        port: PortId,
        /// Whose it is.
        task: TaskId,
        /// The format of the answer.
        format: u16,
    },
    /// ARRIVE: pops the fields, at most 8 bytes of them. The others read them with [`Op::Arrival`].
    Arrive {
        /// The waitfor.
        port: PortId,
        /// The format of its arguments.
        format: u16,
        /// The patience, where it is shorter than the port's.
        time_out: Option<Ticks>,
    },
    /// ORDER: one of [`Program::orders`].
    Order(u16),
    /// DELAY.
    Delay(Ticks),
    /// Starts a timer.
    Start {
        /// Its name.
        timer: TimeId,
        /// How long.
        length: Ticks,
    },
    /// Stops a timer.
    Stop(TimeId),
    /// An action outside, one of [`Program::actions`]: pops the arguments. Handlers may interrupt the waiting
    /// for it; it goes on meanwhile.
    Run {
        /// Which.
        action: u16,
        /// How many arguments.
        arguments: u8,
        /// It takes no less
        least: Ticks,
        /// and no more than this.
        most: Ticks,
    },
    /// From `true` to `false` no handler interrupts. Such sections nest.
    Atomic(bool),
    /// What the beats' answers carry from here on (D61): pops the fields, at most
    /// [`PUBLISHED_BYTES`](crate::PUBLISHED_BYTES) of them.
    Publish {
        /// The format.
        format: u16,
    },
    /// Waits for the lease (D61).
    Lease,
    /// Pops a truth value; ends the task where it is false.
    Assert,
    /// Ends the task, for one of [`Program::reasons`].
    Abort(u16),
    /// Pushes a number below this one that the driver chooses.
    Choose(u16),
    /// The handler ends; the thread that it interrupted goes on (R16).
    HandlerEnd,
    /// The task ends.
    End,
}

/// When a statement asks whether a handler may come first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Fusing {
    /// At the first statement after a wait, and after what changes ranks. Statements in between follow each other
    /// without a gap in which a message could come, so nothing else could be answered there.
    #[default]
    Fused,
    /// At every statement.
    EveryStatement,
}

/// A task's compiled behaviour. Durations are in the ticks of the cell that it was compiled for.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Program {
    /// The name of the task.
    pub name: String,
    /// The operations. The task begins at the first one.
    pub code: Vec<Op>,
    /// The handlers.
    pub handlers: Vec<Handler>,
    /// Where the task goes on when it takes over from its partner (D61).
    pub takeover: Option<Address>,
    /// The task's variables: [`Slot::Task`].
    pub variables: Vec<Variable>,
    /// The names of its timers: [`TimeId`] is the position here.
    pub timers: Vec<String>,
    /// The formats of what it sends and receives.
    pub formats: Vec<Format>,
    /// Lists of variables that messages are read into, one after another.
    pub places: Vec<Slot>,
    /// The names of its actions.
    pub actions: Vec<String>,
    /// The reasons for which it aborts.
    pub reasons: Vec<String>,
    /// Its `order`s.
    pub orders: Vec<ServiceOrder>,
    /// When its statements ask for handlers.
    pub fusing: Fusing,
}

impl Program {
    /// Whether anything may interrupt it.
    #[must_use]
    pub fn is_interruptible(&self) -> bool {
        !self.handlers.is_empty() || self.takeover.is_some()
    }

    /// Whether its variables or messages may hold numbers of messages, which no canonical state knows of (D51).
    #[must_use]
    pub fn names_messages(&self) -> bool {
        self.code.contains(&Op::ReceivedId)
    }

    /// A variable of a handler.
    pub(super) fn local(&self, handler: Option<u8>, at: u16) -> Option<&Variable> {
        self.handlers.get(usize::from(handler?))?.locals.get(usize::from(at))
    }

    /// The handler that this calls, and its position.
    pub(super) fn handler(&self, trigger: Trigger) -> Option<(u8, &Handler)> {
        let at = self.handlers.iter().position(|handler| handler.trigger == trigger)?;
        Some((u8::try_from(at).ok()?, &self.handlers[at]))
    }

    /// The ports that have a handler, in the order of the handlers.
    pub(super) fn handled(&self, from: u8) -> impl Iterator<Item = (u8, PortId)> {
        let later = self.handlers.iter().enumerate().skip(usize::from(from));
        later.filter_map(|(i, handler)| match handler.trigger {
            Trigger::Message(port) => Some((u8::try_from(i).ok()?, port)),
            Trigger::Timer(_) | Trigger::Fenced => None,
        })
    }

    /// Whether the script waits for a lease before its body.
    pub(super) fn begins_with_a_lease(&self) -> bool {
        self.code.contains(&Op::Lease)
    }
}
