//! Canonical packing of a script (D165). Variables take the width of their type, truth values one bit, and unused room
//! nothing.
//!
//! ```text
//! standing 2 | operands follow 1 | atomic follows 1 | level 4                     (high bits first)
//! live:  [atomic] [operands: count, 8 bytes each] variables, then each activation from the first:
//!     [handler] position, wait with its data, [port, source, id of the message to answer] [its variables]
//! ended: how, variables
//! ```

use super::program::{Program, Variable};
use super::value::Type;
use super::{Acted, Anew, End, Frame as Thread, Inbound, Script, ScriptFault, Standing, Wait};
use crate::ids::{Incarnation, PortId};
use crate::packet::Contents;
use crate::request::{Fault, ReplyTo};
use crate::state::{Walk, mark, same_variant};

const RUNS: u8 = 1;
const ENDED: u8 = 2;
const OPERANDS: u8 = 0x20;
const ATOMIC: u8 = 0x10;
const LEVEL: u8 = 0x0f;
/// Set in the number of a wait: the activation has a message to answer.
const MESSAGE: u8 = 0x80;

const SCRIPT_FAULTS: [ScriptFault; 9] = [
    ScriptFault::Overflow,
    ScriptFault::DivisionByZero,
    ScriptFault::NotFinite,
    ScriptFault::Malformed,
    ScriptFault::Runaway,
    ScriptFault::TooDeep,
    ScriptFault::Unexpected,
    ScriptFault::WrongContents,
    ScriptFault::NothingReceived,
];
const FAULTS: [Fault; 9] = [
    Fault::NotYourPort,
    Fault::WrongUsage,
    Fault::NotAPeer,
    Fault::Busy,
    Fault::WrongLength,
    Fault::NotInterrupted,
    Fault::Fenced,
    Fault::NothingToAnswer,
    Fault::Late,
];
const ANEW: [Anew; 4] = [Anew::Begin, Anew::TakeOver, Anew::Passive, Anew::Granted];
const DONE: Acted = Acted { ok: false, value: 0 };
const NOTHING: Inbound = Inbound { contents: Contents::EMPTY, port: PortId(0), task: None, is_answer: false };
const WAITS: [Wait; 13] = [
    Wait::Nothing,
    Wait::Register(0, Anew::Begin),
    Wait::Part(0),
    Wait::Signal,
    Wait::Boundary,
    Wait::Working,
    Wait::Done(DONE),
    Wait::Kept(DONE),
    Wait::Choice(0),
    Wait::Entering(None),
    Wait::Entering(Some(NOTHING)),
    Wait::Abandon(Anew::Begin),
    Wait::Passive,
];
const ENDS: [End; 6] = [
    End::Finished,
    End::Aborted(0),
    End::Assertion(0),
    End::Fenced,
    End::Fault { fault: ScriptFault::Request(Fault::WrongUsage), at: 0 },
    End::Fault { fault: ScriptFault::Malformed, at: 0 },
];

impl Script {
    /// Walks the script. A pass that reads must get bytes that a script of the same program wrote.
    pub fn walk<W: Walk>(&mut self, program: &Program, w: &mut W) {
        let Self {
            standing,
            frames,
            level,
            operands,
            held,
            variables,
            locals,
            // The program determines `width` and `acting`, so neither is packed.
            width,
            acting: _,
            atomic,
        } = self;
        let head = w.put(match standing {
            Standing::NotBegun => 0,
            Standing::Ended(_) => ENDED << 6,
            Standing::Runs => RUNS << 6 | mark(*held > 0, OPERANDS) | mark(*atomic > 0, ATOMIC) | *level,
        });
        if W::READS {
            *standing = match head >> 6 {
                RUNS => Standing::Runs,
                ENDED => Standing::Ended(End::Finished),
                _ => Standing::NotBegun,
            };
            frames.fill(Thread::default());
            (*held, *atomic) = (0, 0);
            operands.fill(0);
            locals.fill(0);
            let top =
                if *standing == Standing::Runs { usize::from(head & LEVEL).min(frames.len() - 1) } else { 0 };
            *level = u8::try_from(top).unwrap_or(0);
        }
        match standing {
            Standing::NotBegun if W::READS => {
                let first = program.variables.iter().map(Variable::first);
                variables.iter_mut().zip(first).for_each(|(value, first)| *value = first);
            }
            Standing::NotBegun => {}
            Standing::Ended(end) => {
                end.walk(w);
                walk_variables(&program.variables, variables, w);
            }
            Standing::Runs => {
                if head & ATOMIC != 0 {
                    w.byte(atomic);
                }
                if head & OPERANDS != 0 {
                    *held = w.count(*held).min(operands.len());
                    operands.iter_mut().take(*held).for_each(|operand| walk_operand(operand, w));
                }
                walk_variables(&program.variables, variables, w);
                for (at, thread) in frames.iter_mut().enumerate().take(usize::from(*level) + 1) {
                    thread.walk(program, at > 0, w);
                    let own = locals.get_mut(at * *width..).unwrap_or_default();
                    walk_variables(handler_locals(program, thread), own, w);
                }
            }
        }
    }

    /// Drops the messages that can no longer be answered: a reply to such a message has the same outcome as a reply
    /// without a message.
    pub fn bury(&mut self, answerable: impl Fn(&ReplyTo) -> bool) {
        for thread in &mut self.frames {
            thread.message = thread.message.filter(&answerable);
        }
    }

    /// Zeroes a dead variable: a checker knows from the program that the variable is written before it is read again.
    pub fn bury_variable(&mut self, index: u16) {
        if let Some(variable) = self.variables.get_mut(usize::from(index)) {
            *variable = 0;
        }
    }
}

impl Thread {
    fn walk<W: Walk>(&mut self, program: &Program, is_handler: bool, w: &mut W) {
        let Self { handler, at, wait, message } = self;
        if is_handler {
            let read = w.put(handler.unwrap_or(u8::MAX));
            if W::READS {
                *handler = Some(read).filter(|&handler| handler != u8::MAX);
            }
        }
        if program.code.len() > 256 {
            w.word(at);
        } else {
            w.small(at);
        }
        let is_answer = wait.walk(message.is_some(), w);
        if let Some(ReplyTo { port, source, id }) = w.some(message, is_answer, ReplyTo::BLANK) {
            w.small(&mut port.0);
            w.small(&mut source.0);
            w.id(*source, Incarnation(0), id);
        }
    }
}

impl Wait {
    /// Walks the wait, with a flag for whether its activation has a message to answer. Returns the flag.
    fn walk<W: Walk>(&mut self, with_message: bool, w: &mut W) -> bool {
        let mut message = with_message;
        if W::PACKS {
            let is_like = |one: &Self| match (one, &*self) {
                (Self::Entering(a), Self::Entering(b)) => a.is_some() == b.is_some(),
                (a, b) => same_variant(a, b),
            };
            let place =
                WAITS.iter().position(is_like).and_then(|place| u8::try_from(place).ok()).unwrap_or(0);
            let tag = w.put(place | if with_message { MESSAGE } else { 0 });
            if W::READS {
                message = tag & MESSAGE != 0;
                *self = WAITS.get(usize::from(tag & !MESSAGE)).copied().unwrap_or(Self::Passive);
            }
        }
        match self {
            Self::Register(handler, anew) => {
                w.byte(handler);
                w.one_of(&ANEW, anew, PartialEq::eq);
            }
            Self::Part(part) => w.byte(part),
            Self::Done(acted) | Self::Kept(acted) => {
                let Acted { ok, value } = acted;
                w.flag(ok);
                let mut bytes = value.to_le_bytes();
                w.raw(&mut bytes);
                *value = i32::from_le_bytes(bytes);
            }
            Self::Choice(among) => w.word(among),
            Self::Entering(Some(Inbound { contents, port, task, is_answer })) => {
                w.small(&mut port.0);
                let [answers, has_task] = w.flags([*is_answer, task.is_some()]);
                *is_answer = answers;
                let mut of = task.unwrap_or_default();
                w.small(&mut of.0);
                *task = has_task.then_some(of);
                w.contents(contents);
            }
            Self::Abandon(anew) => w.one_of(&ANEW, anew, PartialEq::eq),
            Self::Nothing
            | Self::Signal
            | Self::Boundary
            | Self::Working
            | Self::Entering(None)
            | Self::Passive => {}
        }
        message
    }
}

impl End {
    fn walk<W: Walk>(&mut self, w: &mut W) {
        w.one_of(&ENDS, self, |a, b| match (a, b) {
            (Self::Fault { fault: a, .. }, Self::Fault { fault: b, .. }) => a.is_request() == b.is_request(),
            (a, b) => same_variant(a, b),
        });
        match self {
            Self::Finished | Self::Fenced => {}
            Self::Aborted(number) | Self::Assertion(number) => w.word(number),
            Self::Fault { fault, at } => {
                match fault {
                    ScriptFault::Request(fault) => w.one_of(&FAULTS, fault, PartialEq::eq),
                    fault => w.one_of(&SCRIPT_FAULTS, fault, PartialEq::eq),
                }
                w.word(at);
            }
        }
    }
}

impl ScriptFault {
    const fn is_request(self) -> bool {
        matches!(self, Self::Request(_))
    }
}

fn walk_operand<W: Walk>(operand: &mut i64, w: &mut W) {
    let mut bytes = operand.to_le_bytes();
    w.raw(&mut bytes);
    *operand = i64::from_le_bytes(bytes);
}

/// First the truth values, eight in a byte; then all others in the width of their type.
fn walk_variables<W: Walk>(of: &[Variable], values: &mut [i64], w: &mut W) {
    if !W::PACKS {
        return;
    }
    // Eight truth values a byte, the first one in the lowest bit.
    let (mut bits, mut count) = (0, 0);
    for (_, truth) in of.iter().zip(values.iter_mut()).filter(|(variable, _)| variable.of == Type::Bool) {
        if W::READS && count == 0 {
            bits = w.put(0);
        }
        if W::READS {
            *truth = i64::from(bits >> count & 1);
        } else {
            bits |= u8::from(*truth != 0) << count;
        }
        count = (count + 1) % 8;
        if !W::READS && count == 0 {
            w.put(core::mem::take(&mut bits));
        }
    }
    if !W::READS && count > 0 {
        w.put(bits);
    }
    for (variable, value) in of.iter().zip(values).filter(|(variable, _)| variable.of != Type::Bool) {
        let mut room = value.to_le_bytes();
        let room = &mut room[..variable.of.bytes()];
        w.raw(room);
        if W::READS {
            *value = variable.of.read(room).unwrap_or(0);
        }
    }
}

fn handler_locals<'a>(program: &'a Program, thread: &Thread) -> &'a [Variable] {
    let handler = thread.handler.and_then(|at| program.handlers.get(usize::from(at)));
    handler.map_or(&[], |handler| &handler.locals)
}
