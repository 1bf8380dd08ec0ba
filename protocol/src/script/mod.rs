//! The script of a task: the small-step machine that runs its compiled behaviour (D45), the third machine of a node.
//!
//! A [`Program`] is static; a [`Script`] is a program counter, a fixed stack of operands, the task's variables and one
//! frame for each thread that a handler interrupted (R16, D15). [`Script::step`] takes one input and runs until the
//! next thing that needs an answer: a request to the communication task, an action outside, a choice of the driver,
//! the end. What lies between two of these follows each other without a gap, so it is one step for the model checker.
//!
//! As for the communication task: no clock, no lock, no allocation after `new`, and no program and no input panics. A
//! program that is none ends in [`End::Fault`]; [`Program::check`] finds it before.

mod builder;
mod check;
mod host;
mod program;
mod turn;
mod value;
#[cfg(feature = "checker")]
mod walk;

pub use builder::{Label, ProgramBuilder};
pub use check::ProgramError;
pub use host::{HOST_LIMIT, HostInput, HostOutbox, Hosted, ScriptedNode};
pub use program::{
    Address, Format, Fusing, Handler, MAX_FRAGMENTS, MAX_MESSAGE, Mark, Op, Outcomes, Program,
    StatementOutcome, Trigger, Variable,
};
pub use value::{Binary, CHECK_DEPTH, Predicate, Slot, Term, Type, eval, real};

use crate::ids::{PortId, TaskId};
use crate::packet::Contents;
use crate::request::{Fault, ReplyTo, Request, ServiceOrder, Signal};
use crate::ticks::Ticks;
use alloc::boxed::Box;
use alloc::vec;
use core::fmt;
use serde::{Deserialize, Serialize};
use turn::Turn;

/// How many operands a script may hold at once: those of the longest message, and an expression.
pub const MAX_OPERANDS: usize = MAX_MESSAGE + CHECK_DEPTH;
/// How many operations a script may run from one input to its next request.
pub const STEP_LIMIT: u32 = 4096;
/// How many threads a script may have: its own, and the handlers that the communication task nests (D15).
pub const MAX_THREADS: usize = ServiceOrder::LEVELS + 3;

/// What can happen to a script.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ScriptInput {
    /// The task begins.
    Begin,
    /// The communication task answers, or interrupts.
    Signal(Signal),
    /// An action has ended.
    Acted {
        /// The thread that ran it, as [`Action::level`] said.
        level: u8,
        /// Whether it succeeded.
        ok: bool,
        /// Its result.
        value: i32,
    },
    /// The driver chose.
    Chosen(u16),
}

/// An action outside: of a robot's driver, of a PLC, or simulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Action<'a> {
    /// The thread that waits for it: 0 is the task's own, each handler has the next one. Handlers may run actions of
    /// their own while that of the thread they interrupted goes on.
    pub level: u8,
    /// Which of [`Program::actions`].
    pub action: u16,
    /// Its arguments.
    pub arguments: &'a [i64],
    /// It takes no less
    pub least: Ticks,
    /// and no more than this.
    pub most: Ticks,
}

/// Where the effects of [`Script::step`] go.
pub trait ScriptOutbox {
    /// Asks the communication task. Requests of one step are made in their order.
    fn request(&mut self, request: Request);
    /// Begins an action; [`ScriptInput::Acted`] ends it.
    fn run(&mut self, action: Action<'_>);
    /// Stops the action of this thread: the task must not act any more (D61). No [`ScriptInput::Acted`] follows.
    fn cut_short(&mut self, level: u8);
    /// Chooses a number below `alternatives` at once, or `None` to give it later with [`ScriptInput::Chosen`].
    fn choose(&mut self, alternatives: u16) -> Option<u16>;
    /// The script has ended: it takes no input any more.
    fn ended(&mut self, end: End);
    /// A statement begins.
    fn statement(&mut self, at: Address) {
        let _ = at;
    }
    /// The thread forgets a class-2 message that it never answered: its sender will see a time_out.
    fn unanswered(&mut self, message: ReplyTo) {
        let _ = message;
    }
    /// A fragment, from 1, of the message that came last (D28): [`CommTask::fragment`](crate::CommTask).
    fn fragment(&mut self, index: u8) -> Option<Contents> {
        let _ = index;
        None
    }
    /// What the partner of the task's couple published last: [`CommTask::partner_published`](crate::CommTask).
    fn published(&mut self) -> Option<Contents> {
        None
    }
    /// What a member told at a waitfor: [`CommTask::meeting_arguments`](crate::CommTask).
    fn arrival(&mut self, port: PortId, task: TaskId) -> Option<[u8; 8]> {
        let _ = (port, task);
        None
    }
    /// The message of a task that was taken on this port and not answered: [`CommTask::owed`](crate::CommTask).
    fn owed(&mut self, port: PortId, task: TaskId) -> Option<ReplyTo> {
        let _ = (port, task);
        None
    }
    /// A fragment, from 0, of an answer to the last request on `port`: that of `task`, or of the only one asked.
    fn answer(&mut self, port: PortId, task: Option<TaskId>, index: u8) -> Option<Contents> {
        let _ = (port, task, index);
        None
    }
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
    /// The program is none: see [`Program::check`].
    Malformed,
    /// More than [`STEP_LIMIT`] operations without a request, or requests without end in no time.
    Runaway,
    /// More than [`MAX_THREADS`] threads.
    TooDeep,
    /// The driver or the communication task said what was no answer.
    Unexpected,
    /// A message or answer is not of the format that the program reads.
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
            Self::Unexpected => "an answer that nobody asked for",
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
    /// It came to its end.
    Finished,
    /// It aborted, for one of [`Program::reasons`].
    Aborted(u16),
    /// An `assert` did not hold.
    Assertion(Address),
    /// It lost its lease, and has no part to take over or will never hold one again (D61).
    Fenced,
    /// A fault, at this operation.
    Fault {
        /// Which.
        fault: ScriptFault,
        /// Where.
        at: Address,
    },
}

/// Where a script stands as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
enum Standing {
    NotBegun,
    Lives,
    Ended(End),
}

/// Where a script begins anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
enum Anew {
    /// At its first operation. Where the body belongs to a lease, handlers that act are held off until it comes.
    Begin,
    /// At its take-over.
    TakeOver,
    /// Behind the operation that asked for its lease: it has it now. The handlers that act are announced, too.
    Granted,
    /// Nowhere: it lost its lease and acts no more, unless it gets it back or takes over. Handlers that act are
    /// withdrawn: what comes for them waits in its buffer. The others go on answering and taking notice.
    Passive,
}

/// What a thread waits for. Only the top one may wait for nothing, and only within a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
enum Wait {
    #[default]
    Nothing,
    /// That the handler at this position is announced.
    Register(u8, Anew),
    /// That this fragment is taken; its operands are still there.
    Part(u8),
    /// The answer to the operation it stands at.
    Signal,
    /// Whether a handler comes before the statement it stands at.
    Boundary,
    /// The end of its action.
    Working,
    /// That the communication task knows of the end of the action.
    Done(Acted),
    /// A handler: the action has ended meanwhile.
    Kept(Acted),
    /// The driver's choice among so many.
    Choice(u16),
    /// The answer to a Done that the handler's call crossed; then the handler begins with this.
    Entering(Option<Inbound>),
    /// That everything is given up.
    Abandon(Anew),
    /// Nothing any more, but its lease or a take-over.
    Passive,
}

/// How an action ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
struct Acted {
    ok: bool,
    value: i32,
}

/// What came, for [`Op::Unpack`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
struct Inbound {
    contents: Contents,
    port: PortId,
    /// Of a message, its source; of an answer, who gave it where several were asked.
    task: Option<TaskId>,
    is_answer: bool,
}

/// A thread: the task's own, or a handler.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
struct Frame {
    /// The handler that it runs; none below.
    handler: Option<u8>,
    /// The operation that it runs, or waits in.
    at: Address,
    wait: Wait,
    /// The class-2 message that it received last and has not answered.
    message: Option<ReplyTo>,
}

/// The state of a task's script. Sized by its program; what is not in use is zero, so that equal states are equal.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Script {
    standing: Standing,
    frames: Box<[Frame]>,
    /// The position of the running thread.
    level: u8,
    operands: Box<[i64]>,
    held: usize,
    variables: Box<[i64]>,
    /// The handlers' variables: so many per thread.
    locals: Box<[i64]>,
    width: usize,
    /// How many atomic sections are open.
    atomic: u8,
    /// Of the program, bit by bit: the handlers that act.
    acting: u64,
}

/// What a script does, for showing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Activity {
    /// It has not begun.
    NotBegun,
    /// It waits for its communication task.
    Waits,
    /// It waits for the end of its action.
    Acts,
    /// It waits for the driver's choice among so many.
    Chooses(u16),
    /// It lost its lease and waits to get it back or to take over.
    Passive,
    /// It has ended.
    Ended(End),
}

impl Script {
    /// The script of a task that has not begun. Its only allocations.
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

    /// Takes one input and runs until the next thing that needs an answer. Total: no program and no input panics.
    pub fn step(&mut self, program: &Program, input: ScriptInput, out: &mut impl ScriptOutbox) {
        match (self.standing, input) {
            (Standing::Ended(_), _)
            | (
                Standing::NotBegun,
                ScriptInput::Signal(_) | ScriptInput::Acted { .. } | ScriptInput::Chosen(_),
            )
            | (Standing::Lives, ScriptInput::Begin) => {}
            (Standing::NotBegun, ScriptInput::Begin) => Turn::new(self, program, out).begin(),
            (Standing::Lives, ScriptInput::Signal(signal)) => Turn::new(self, program, out).signal(signal),
            (Standing::Lives, ScriptInput::Acted { level, ok, value }) => {
                Turn::new(self, program, out).acted(level, Acted { ok, value });
            }
            (Standing::Lives, ScriptInput::Chosen(choice)) => Turn::new(self, program, out).chosen(choice),
        }
    }

    /// Ends the script with a fault, as a driver does with one that never waits.
    pub fn stop(&mut self, program: &Program, fault: ScriptFault, out: &mut impl ScriptOutbox) {
        if !matches!(self.standing, Standing::Ended(_)) {
            Turn::new(self, program, out).fault(fault);
        }
    }

    /// What it does.
    #[must_use]
    pub fn activity(&self) -> Activity {
        match (self.standing, self.top().wait) {
            (Standing::NotBegun, _) => Activity::NotBegun,
            (Standing::Ended(end), _) => Activity::Ended(end),
            (Standing::Lives, Wait::Working) => Activity::Acts,
            (Standing::Lives, Wait::Choice(alternatives)) => Activity::Chooses(alternatives),
            (Standing::Lives, Wait::Passive) => Activity::Passive,
            (
                Standing::Lives,
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

    /// The operation that the running thread waits in.
    #[must_use]
    pub fn position(&self) -> Address {
        match self.standing {
            Standing::Ended(End::Fault { at, .. } | End::Assertion(at)) => at,
            Standing::Ended(End::Finished | End::Aborted(_) | End::Fenced) | Standing::NotBegun => 0,
            Standing::Lives => self.top().at,
        }
    }

    /// The operation that a thread waits in: the task's own at level 0, above it the handlers that run. `None` where there is none.
    #[must_use]
    pub fn position_at(&self, level: u8) -> Option<Address> {
        match self.standing {
            Standing::Ended(_) => None,
            Standing::NotBegun => (level == 0).then_some(0),
            Standing::Lives if level > self.level => None,
            Standing::Lives => self.frames.get(usize::from(level)).map(|thread| thread.at),
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

    fn top(&self) -> Frame {
        self.frames.get(usize::from(self.level)).copied().unwrap_or_default()
    }
}
