//! The compiled form of a task's script: a flat list of operations and the tables that they refer to.

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
    /// The variable's name; for a field of a record, with the record's name: `me.height`.
    pub name: String,
    /// The variable's type.
    pub of: Type,
    /// The variable's value when the task or the handler begins.
    pub initial: i64,
}

impl Variable {
    /// The variable's initial value, or zero if that value is not of its type. Every type has a zero.
    pub(super) fn first(&self) -> i64 {
        if self.of.holds(self.initial) { self.initial } else { 0 }
    }
}

/// The layout of a message or an answer: its fields one after another, little endian, without gaps, cut into packets
/// of 12 bytes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Format {
    /// The types of the fields.
    pub fields: Vec<Type>,
}

impl Format {
    /// How many bytes a message of this format takes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.fields.iter().map(|field| field.bytes()).sum()
    }

    /// The fields that are complete in `bytes`, the start of a message. Ends before a value that its type does not hold.
    pub fn values<'a>(&'a self, bytes: &'a [u8]) -> impl Iterator<Item = (Type, i64)> + 'a {
        let mut rest = bytes;
        self.fields.iter().map_while(move |&of| {
            let value = of.read(rest)?;
            rest = &rest[of.bytes()..];
            Some((of, value))
        })
    }

    /// How many packets a message of this format takes: at least one, even if it is empty.
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

/// A handler: runs as an activation above the one that it interrupts, with variables of its own.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Handler {
    /// What calls the handler.
    pub trigger: Trigger,
    /// Where the handler's code begins. The code ends with [`Op::HandlerEnd`].
    pub entry: Address,
    /// The handler's variables: [`Slot::Local`].
    pub locals: Vec<Variable>,
}

/// How a statement that makes a request has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum StatementOutcome {
    /// The request was accepted, or its wait is over; for an action: the action succeeded.
    Done = 0,
    /// The answer came; for a message to several tasks: all of them answered.
    Reply = 1,
    /// The receiver had no space; the command did not run.
    Refused = 2,
    /// The time_out ended before a copy left the node; the command did not run.
    TimedOutUnsent = 3,
    /// The time_out ended without an answer; the command may have run.
    TimedOutUnknown = 4,
    /// The destination restarted; the command may have run.
    PeerRestarted = 5,
    /// For a message to several tasks: not all of them answered.
    Incomplete = 6,
    /// A message came before the time_out.
    Message = 7,
    /// No message came before the time_out.
    Nothing = 8,
    /// All members of the rendezvous have arrived.
    Released = 9,
    /// Not all members of the rendezvous arrived in time.
    GaveUp = 10,
    /// The action failed.
    Failed = 11,
    /// No message can be answered: none was received, it is answered already, or its execution budget has ended.
    Unanswerable = 12,
    /// The port acts under a lease that the task does not hold (D61).
    Fenced = 13,
}

/// A set of outcomes, for a branch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Outcomes(pub u16);

impl Outcomes {
    /// The outcomes that `on time_out do` handles.
    pub const TIME_OUT: Self = Self::of(&[
        StatementOutcome::TimedOutUnsent,
        StatementOutcome::TimedOutUnknown,
        StatementOutcome::PeerRestarted,
        StatementOutcome::Incomplete,
        StatementOutcome::Nothing,
        StatementOutcome::GaveUp,
    ]);
    /// The outcome that `on refused do` handles.
    pub const REFUSED: Self = Self::of(&[StatementOutcome::Refused]);
    /// The outcomes that leave contents for [`Op::Unpack`].
    pub const BRINGS: Self = Self::of(&[StatementOutcome::Reply, StatementOutcome::Message]);
    /// The outcomes that end the task, if the statement has no branch for them.
    pub const BAD: Self = Self(
        Self::TIME_OUT.0
            | Self::REFUSED.0
            | Self::of(&[StatementOutcome::Failed, StatementOutcome::Unanswerable, StatementOutcome::Fenced])
                .0,
    );

    /// The set of these outcomes.
    #[must_use]
    pub const fn of(outcomes: &[StatementOutcome]) -> Self {
        let (mut set, mut i) = (0, 0);
        while i < outcomes.len() {
            set |= 1 << outcomes[i] as u16;
            i += 1;
        }
        Self(set)
    }

    /// Whether the set has this outcome.
    #[must_use]
    pub const fn has(self, outcome: StatementOutcome) -> bool {
        self.0 >> outcome as u16 & 1 == 1
    }
}

/// The mask that [`Op::Mark`] reads after a message to several tasks: see [`Answers`](crate::Answers).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the names are those of the fields")]
pub enum Mark {
    Asked,
    Answered,
    Refused,
    Restarted,
    Unsent,
}

/// One operation. An operation that makes a request waits for its answer. The answer leaves a [`StatementOutcome`] and
/// perhaps a value, an answer or a message. These results last until the next statement or the next request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Op {
    /// A statement begins here: the interpreter reports it to the driver, and a handler may run first (D15).
    Statement,
    /// A step of an expression.
    Term(Term),
    /// Pops a value into a variable.
    Store(Slot),
    /// Pops a value and discards it.
    Pop,
    /// Jumps to this address.
    Jump(Address),
    /// Pops a truth value and jumps if it is false.
    Unless(Address),
    /// Jumps if the last statement ended with one of these outcomes.
    On {
        /// The outcomes for which the script jumps.
        outcomes: Outcomes,
        /// The target of the jump.
        to: Address,
    },
    /// Pushes the number of the last statement's [`StatementOutcome`].
    Outcome,
    /// Pushes the number that the last answer brought: the result of an action, how many copies a send made, or bit by bit
    /// which members were missing at a `waitfor`.
    Value,
    /// Pushes a mask of the answers to the last message to several tasks.
    Mark(Mark),
    /// Selects for [`Op::Unpack`] the answer of one of several asked tasks, and pushes whether its answer came.
    Answer {
        /// The port of the message.
        port: PortId,
        /// The task whose answer is selected.
        task: TaskId,
    },
    /// Reads the fields of the received message or answer into the variables of [`Program::places`], from `into` on.
    Unpack {
        /// The format of the message or answer.
        format: u16,
        /// The position in [`Program::places`] of the first variable.
        into: u16,
    },
    /// Pushes the port through which the last message came.
    ReceivedPort,
    /// Pushes the task from which the last message came.
    ReceivedSource,
    /// Pushes the id of the message that this activation received last and must answer, a [`Type::Word`]; 0 if there is none.
    /// With [`Op::ReceivedSource`] it names the message to a task that answers instead. A canonical state cannot hold such an
    /// id in a variable or a message, so a checker refuses the program (D51).
    ReceivedId,
    /// Selects for [`Op::Unpack`] what the partner of the task's couple published last, and pushes whether it has published
    /// anything (D61).
    Published,
    /// Selects for [`Op::Unpack`] the arguments of a member, in the round in which this task waits or from which it was
    /// released last. Pushes whether the arguments are known: after a release by a CONFIRM they may be unknown.
    Arrival {
        /// The port of the waitfor.
        port: PortId,
        /// The member whose arguments are selected.
        task: TaskId,
        /// The format of the member's arguments.
        format: u16,
    },
    /// SEND or a query: pops the fields of the message.
    Send {
        /// The port of the message.
        port: PortId,
        /// The receivers of the message.
        to: Target,
        /// The format of the message.
        format: u16,
        /// The TTL of the message, if shorter than the port's time_out.
        time_out: Option<Ticks>,
    },
    /// GET: waits for a message.
    Get {
        /// The port to read, or all ports that have no handler.
        port: Option<PortId>,
        /// The source whose messages are taken, or any.
        source: Option<TaskId>,
        /// How long to wait; `None` waits without end.
        time_out: Option<Ticks>,
    },
    /// Reply or response to the message that this activation received last: pops the fields of the answer.
    Reply {
        /// The format of the answer.
        format: u16,
    },
    /// Reply to a message that another task received, or that this task received earlier. Pops the fields, then the id of
    /// the message ([`Op::ReceivedId`]), then its source.
    ReplyFor {
        /// A port with usage `reply`, or the port on which this task received the message.
        port: PortId,
        /// The format of the answer.
        format: u16,
    },
    /// Reply to the message of `task` that this task received earlier on `port` and has not answered (D93): pops the fields.
    /// There is at most one such message per task and port (D75), so no id is needed.
    ReplyOwed {
        /// The port on which the message came.
        port: PortId,
        /// The task that sent the message.
        task: TaskId,
        /// The format of the answer.
        format: u16,
    },
    /// ARRIVE: pops the fields, at most 8 bytes of them. The other members read them with [`Op::Arrival`].
    Arrive {
        /// The port of the waitfor.
        port: PortId,
        /// The format of the arguments.
        format: u16,
        /// The patience, if shorter than the port's time_out.
        time_out: Option<Ticks>,
    },
    /// ORDER: one of [`Program::orders`].
    Order(u16),
    /// DELAY.
    Delay(Ticks),
    /// Starts a timer.
    Start {
        /// The name of the timer.
        timer: TimeId,
        /// How long the timer runs.
        length: Ticks,
    },
    /// Stops a timer.
    Stop(TimeId),
    /// Begins an action, one of [`Program::actions`]: pops the arguments. Handlers may interrupt the wait for its end; the
    /// action goes on meanwhile.
    Run {
        /// The number of the action.
        action: u16,
        /// The number of arguments.
        arguments: u8,
        /// The shortest duration of the action.
        least: Ticks,
        /// The longest duration of the action.
        most: Ticks,
    },
    /// From `Atomic(true)` to `Atomic(false)` no handler interrupts. Such sections nest.
    Atomic(bool),
    /// Sets what the answers to heartbeats carry from here on (D61): pops the fields, at most
    /// [`PUBLISHED_BYTES`](crate::PUBLISHED_BYTES) of them.
    Publish {
        /// The format of the published fields.
        format: u16,
    },
    /// Waits for the lease (D61).
    Lease,
    /// Pops a truth value; ends the task if it is false.
    Assert,
    /// Ends the task, for one of [`Program::reasons`].
    Abort(u16),
    /// Pushes a number that the driver chooses. The number is below this limit.
    Choose(u16),
    /// The handler ends; the activation that it interrupted goes on (R16).
    HandlerEnd,
    /// The task ends.
    End,
}

/// Which statements ask whether a handler may run first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Fusing {
    /// The first statement after a wait, or after an operation that changes ranks. No message can arrive between the other
    /// statements, so the other statements need not ask.
    #[default]
    Fused,
    /// Every statement.
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
    /// Where the task continues when it takes over from its partner (D61).
    pub takeover: Option<Address>,
    /// The task's variables: [`Slot::Task`].
    pub variables: Vec<Variable>,
    /// The names of the task's timers: [`TimeId`] is the position here.
    pub timers: Vec<String>,
    /// The formats of the messages that the task sends and receives.
    pub formats: Vec<Format>,
    /// Lists of variables into which messages are read, one after another.
    pub places: Vec<Slot>,
    /// The names of the task's actions.
    pub actions: Vec<String>,
    /// The reasons for which the task aborts.
    pub reasons: Vec<String>,
    /// The task's `order`s.
    pub orders: Vec<ServiceOrder>,
    /// Which of the task's statements ask whether a handler may run first.
    pub fusing: Fusing,
}

impl Program {
    /// Whether anything may interrupt the task.
    #[must_use]
    pub fn is_interruptible(&self) -> bool {
        !self.handlers.is_empty() || self.takeover.is_some()
    }

    /// Whether its variables or messages may hold message ids, which a canonical state cannot represent (D51).
    #[must_use]
    pub fn names_messages(&self) -> bool {
        self.code.contains(&Op::ReceivedId)
    }

    /// A variable of a handler.
    pub(super) fn local(&self, handler: Option<u8>, at: u16) -> Option<&Variable> {
        self.handlers.get(usize::from(handler?))?.locals.get(usize::from(at))
    }

    /// The handler that this trigger calls, and its position.
    pub(super) fn handler(&self, trigger: Trigger) -> Option<(u8, &Handler)> {
        let at = self.handlers.iter().position(|handler| handler.trigger == trigger)?;
        Some((u8::try_from(at).ok()?, &self.handlers[at]))
    }

    /// The ports that have a handler, in the order of the handlers, from position `from` on.
    pub(super) fn handled(&self, from: u8) -> impl Iterator<Item = (u8, PortId)> {
        let later = self.handlers.iter().enumerate().skip(usize::from(from));
        later.filter_map(|(i, handler)| match handler.trigger {
            Trigger::Message(port) => Some((u8::try_from(i).ok()?, port)),
            Trigger::Timer(_) | Trigger::Fenced => None,
        })
    }

    /// Whether the program waits for a lease before its body.
    pub(super) fn begins_with_a_lease(&self) -> bool {
        self.code.contains(&Op::Lease)
    }
}
