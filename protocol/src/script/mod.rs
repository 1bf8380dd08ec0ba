//! Scripts: the compiled behaviour of tasks, and its interpreter, a small-step state machine (D45).
//!
//! A [`Program`] is static. A [`Script`] is a fixed stack of operands, the task's variables, and one frame with a program
//! counter per *activation*: the task's own thread, and each running handler (R16, D15). [`Script::step`] takes one input
//! and runs until the script ends or needs an answer: to a request, to an action outside, or to a choice of the driver. No
//! other event can come between the operations of such a run, so it is one step for the model checker.
//!
//! Like a communication task, a script uses no clock and no lock, allocates nothing after `new`, and panics on no program
//! and no input. A malformed program ends in [`End::Fault`]; [`Program::check`] finds the fault beforehand.

mod builder;
mod check;
#[doc(hidden)]
pub mod code;
mod host;
mod interpreter;
mod program;
mod value;
#[cfg(feature = "checker")]
mod walk;

pub use builder::{Label, ProgramBuilder};
pub use check::ProgramError;
pub use code::Code;
pub use host::{Action, ScriptHost, ScriptOutbox};
pub use program::{
    Address, Format, Fusing, Handler, MAX_FRAGMENTS, MAX_MESSAGE, Mark, Op, Outcomes, Program,
    StatementOutcome, Trigger, Variable,
};
pub use value::{Binary, CHECK_DEPTH, Predicate, Reading, Slot, Term, Type, eval, real};

use crate::ids::{PortId, TaskId};
use crate::packet::Contents;
use crate::request::{Fault, ReplyTo, Request, ServiceOrder, Signal};
use alloc::boxed::Box;
use alloc::vec;
use core::fmt;
use interpreter::Interpreter;
use serde::{Deserialize, Serialize};

/// How many operands a script may hold at once: the fields of the longest message, and one expression.
pub const MAX_OPERANDS: usize = MAX_MESSAGE + CHECK_DEPTH;
/// How many operations a script may run from one input to the next operation that waits.
pub const STEP_LIMIT: u32 = 4096;
/// How many steps a script may take after its last message or outside input. [`ScriptHost`] ends a script that takes more (D95).
pub const HOST_LIMIT: u32 = 10_000;
/// How many activations a script may have: the task's own thread, and the handlers that the communication task nests (D15).
pub const MAX_THREADS: usize = ServiceOrder::LEVELS + 3;

/// An input of a script.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ScriptInput {
    /// The task begins.
    Begin,
    /// The communication task answers, or interrupts.
    Signal(Signal),
    /// An action has ended.
    Acted {
        /// The activation that ran the action, as [`Action::level`] said.
        level: u8,
        /// Whether the action succeeded.
        ok: bool,
        /// The result of the action.
        value: i32,
    },
    /// The driver chose this alternative, after the script asked for a choice.
    Chosen(u16),
}

/// What ends a script before its last statement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ScriptFault {
    /// A value is out of the range of its type, or of 64 bits.
    Overflow,
    /// A division by zero.
    DivisionByZero,
    /// A real that is not finite.
    NotFinite,
    /// The program is malformed: see [`Program::check`].
    Malformed,
    /// More than [`STEP_LIMIT`] operations without a wait, or endless requests while no time passes.
    Runaway,
    /// More than [`MAX_THREADS`] activations.
    TooDeep,
    /// An input of the driver or of the communication task does not answer the current wait.
    Unexpected,
    /// A message or answer does not have the format that the program reads.
    WrongContents,
    /// There is no message or answer to read.
    NothingReceived,
    /// The communication task says that the request itself is at fault.
    Request(Fault),
}

impl fmt::Display for ScriptFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Overflow => "a value is out of the range of its type",
            Self::DivisionByZero => "a division by zero",
            Self::NotFinite => "a real that is not finite",
            Self::Malformed => "the program is malformed",
            Self::Runaway => "the task runs on and on without waiting",
            Self::TooDeep => "too many handlers interrupt each other",
            Self::Unexpected => "an answer without a request",
            Self::WrongContents => "a message is not of the declared format",
            Self::NothingReceived => "no message or answer came",
            Self::Request(fault) => return write!(f, "the request is at fault: {fault}"),
        })
    }
}

impl core::error::Error for ScriptFault {}

/// How a script ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum End {
    /// The script reached its end.
    Finished,
    /// The script aborted, for one of [`Program::reasons`].
    Aborted(u16),
    /// An `assert` did not hold.
    Assertion(Address),
    /// The task lost its lease, and has no take-over part or can never hold a lease again (D61).
    Fenced,
    /// A fault ended the script, at this operation.
    Fault {
        /// The fault.
        fault: ScriptFault,
        /// The operation at which the fault happened.
        at: Address,
    },
}

/// The overall state of a script.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
enum Standing {
    NotBegun,
    Runs,
    Ended(End),
}

/// Where a script continues when its handlers are registered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
enum Anew {
    /// At its first operation. If the body waits for a lease, handlers that act are registered only with the lease.
    Begin,
    /// At its take-over part.
    TakeOver,
    /// After the operation that waited for the lease. Only handlers that act are registered now: these needed the lease.
    Granted,
    /// Nowhere: the task lost its lease and does not act until it gets the lease back or takes over. Handlers that act are
    /// unregistered, so messages for them wait in the buffer. The other handlers still run.
    Passive,
}

/// What an activation waits for. Only the running activation may wait for nothing, and only within a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
enum Wait {
    #[default]
    Nothing,
    /// The answer to the registration of the handler at this position.
    Register(u8, Anew),
    /// The answer to the request that hands over this fragment. The operands of the message are still on the stack.
    Part(u8),
    /// The answer to the activation's current operation.
    Signal,
    /// The answer whether a handler runs before the activation's current statement.
    Boundary,
    /// The end of the activation's action.
    Working,
    /// The answer to [`Request::Done`]. The value says how the action ended.
    Done(Acted),
    /// The end of the handlers above this activation. Its own action has already ended, as the value says.
    Kept(Acted),
    /// The driver's choice among this many alternatives.
    Choice(u16),
    /// The answer to a [`Request::Done`] made just before this handler was called. The handler then begins, with this message.
    Entering(Option<Inbound>),
    /// The answer to [`Request::Abandon`].
    Abandon(Anew),
    /// The activation waits for its lease, or for a take-over.
    Passive,
}

/// How an action ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
struct Acted {
    ok: bool,
    value: i32,
}

/// The message or answer that [`Op::Unpack`] reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
struct Inbound {
    contents: Contents,
    port: PortId,
    /// The source of a message; for an answer, the task that gave it, if several were asked.
    task: Option<TaskId>,
    is_answer: bool,
}

/// The frame of an activation: the task's own thread, or a handler.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
struct Frame {
    /// The handler that the activation runs; `None` for the task's own thread.
    handler: Option<u8>,
    /// The operation that the activation runs, or in which it waits.
    at: Address,
    wait: Wait,
    /// The class-2 message that the activation received last and has not answered.
    message: Option<ReplyTo>,
}

/// The state of a task's script, sized by its program. Unused room is zero, so that equal states compare equal.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Script {
    standing: Standing,
    frames: Box<[Frame]>,
    /// The position of the running activation.
    level: u8,
    operands: Box<[i64]>,
    held: usize,
    variables: Box<[i64]>,
    /// The handlers' variables, `width` of them for each activation.
    locals: Box<[i64]>,
    width: usize,
    /// How many atomic sections are open.
    atomic: u8,
    /// The handlers of the program that may begin an action, one bit for each handler.
    acting: u64,
}

/// The requests that a script makes of its communication task in one step: at most two.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Requests([Option<Request>; 2]);

impl Requests {
    #[inline]
    fn push(&mut self, request: Request) {
        let Self([first, second]) = self;
        debug_assert!(second.is_none(), "a step asks twice at most");
        *if first.is_none() { first } else { second } = Some(request);
    }

    /// Takes the first request.
    #[inline]
    pub fn pop(&mut self) -> Option<Request> {
        let Self([first, second]) = self;
        let next = if first.is_some() { first } else { second };
        // `take` would also copy an absent value, which is slower.
        if next.is_some() { next.take() } else { None }
    }
}

/// What a script is doing, for display.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Activity {
    /// The script has not begun.
    NotBegun,
    /// The script waits for its communication task.
    Waits,
    /// The script waits for the end of its action.
    Acts,
    /// The script waits for the driver's choice among this many alternatives.
    Chooses(u16),
    /// The task lost its lease and waits to get the lease back or to take over.
    Passive,
    /// The script has ended.
    Ended(End),
}

impl Script {
    /// The script of a task that has not begun. Only this function allocates.
    #[must_use]
    pub fn new(program: &Program) -> Self {
        let threads = if program.handlers.is_empty() { 1 } else { MAX_THREADS };
        let operands = program.check().unwrap_or(MAX_OPERANDS);
        let width = program.handlers.iter().map(|handler| handler.locals.len()).max().unwrap_or(0);
        Self {
            standing: Standing::NotBegun,
            frames: vec![Frame::default(); threads].into(),
            level: 0,
            operands: vec![0; operands].into(),
            held: 0,
            variables: program.variables.iter().map(Variable::first).collect(),
            locals: vec![0; width * threads].into(),
            width,
            atomic: 0,
            acting: program.acting_handlers(),
        }
    }

    /// Takes one input and runs until the script ends or needs an answer. Total: no program and no input panics. `code` is
    /// that of the program, or [`Code::plain`]. `requests` gets the requests to the communication task, in order.
    pub fn step(
        &mut self,
        program: &Program,
        code: &Code,
        input: &ScriptInput,
        requests: &mut Requests,
        out: &mut impl ScriptOutbox,
    ) {
        let is_new = matches!(self.standing, Standing::NotBegun);
        let runs = matches!(self.standing, Standing::Runs);
        let mut interpreter = Interpreter::new(self, program, code, requests, out);
        match *input {
            ScriptInput::Signal(ref signal) if runs => interpreter.signal(signal),
            ScriptInput::Acted { level, ok, value } if runs => interpreter.acted(level, Acted { ok, value }),
            ScriptInput::Chosen(choice) if runs => interpreter.chosen(choice),
            ScriptInput::Begin if is_new => interpreter.begin(),
            ScriptInput::Begin
            | ScriptInput::Signal(_)
            | ScriptInput::Acted { .. }
            | ScriptInput::Chosen(_) => {}
        }
    }

    /// Ends the script with a fault. A driver calls this if the script runs on without a wait.
    pub fn stop(
        &mut self,
        program: &Program,
        fault: ScriptFault,
        requests: &mut Requests,
        out: &mut impl ScriptOutbox,
    ) {
        if !matches!(self.standing, Standing::Ended(_)) {
            Interpreter::new(self, program, &Code::plain(), requests, out).fault(fault);
        }
    }

    /// What the script is doing.
    #[must_use]
    pub fn activity(&self) -> Activity {
        match (self.standing, self.top().map_or(Wait::Nothing, |frame| frame.wait)) {
            (Standing::NotBegun, _) => Activity::NotBegun,
            (Standing::Ended(end), _) => Activity::Ended(end),
            (Standing::Runs, Wait::Working) => Activity::Acts,
            (Standing::Runs, Wait::Choice(alternatives)) => Activity::Chooses(alternatives),
            (Standing::Runs, Wait::Passive) => Activity::Passive,
            (
                Standing::Runs,
                Wait::Nothing
                | Wait::Register(..)
                | Wait::Part(_)
                | Wait::Signal
                | Wait::Boundary
                | Wait::Done(_)
                | Wait::Kept(_)
                | Wait::Entering(_)
                | Wait::Abandon(_),
            ) => Activity::Waits,
        }
    }

    /// The operation in which the running activation waits.
    #[must_use]
    #[inline]
    pub fn position(&self) -> Address {
        match self.standing {
            Standing::Ended(End::Fault { at, .. } | End::Assertion(at)) => at,
            Standing::Ended(End::Finished | End::Aborted(_) | End::Fenced) | Standing::NotBegun => 0,
            Standing::Runs => self.top().map_or(0, |frame| frame.at),
        }
    }

    /// The operation in which an activation waits: the task's own thread at level 0, running handlers above it. `None` if absent.
    #[must_use]
    pub fn position_at(&self, level: u8) -> Option<Address> {
        match self.standing {
            Standing::Ended(_) => None,
            Standing::NotBegun => (level == 0).then_some(0),
            Standing::Runs if level > self.level => None,
            Standing::Runs => self.frames.get(usize::from(level)).map(|thread| thread.at),
        }
    }

    /// How many handlers run.
    #[must_use]
    pub const fn depth(&self) -> u8 {
        self.level
    }

    /// The value of a variable of the task.
    #[must_use]
    pub fn var(&self, index: u16) -> Option<i64> {
        self.variables.get(usize::from(index)).copied()
    }

    /// The values of all variables of the task, by position.
    #[must_use]
    pub fn variables(&self) -> &[i64] {
        &self.variables
    }

    #[inline]
    fn top(&self) -> Option<&Frame> {
        self.frames.get(usize::from(self.level))
    }
}
