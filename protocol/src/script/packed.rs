//! The packed form of a script: what a model checker hashes (D51). Variables take the width of their type, truth values
//! a bit; what is not in use takes nothing.
//!
//! ```text
//! standing 2 | operands follow 1 | atomic follows 1 | level 4                     (high bits first)
//! of one that lives: [atomic] [operands: count, 8 bytes each] variables, then each thread from the first:
//!     [handler] position, wait with its data, [port, source, id of the message to answer] [its variables]
//! of one that ended: how, variables
//! ```

use super::program::{Program, Variable};
use super::value::Type;
use super::{Acted, Anew, End, Frame as Thread, Inbound, Script, ScriptFault, Standing, Wait};
use crate::comm_task::{Frame, Overflow, Visit, VisitMut};
use crate::ids::{Incarnation, MessageId, PortId, Seq24, TaskId};
use crate::packet::Contents;
use crate::request::{Fault, ReplyTo};

const LIVES: u8 = 1;
const ENDED: u8 = 2;
const OPERANDS: u8 = 0x20;
const ATOMIC: u8 = 0x10;
/// Set in the number of a wait: the thread has a message to answer.
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

/// The position of an entry in one of the lists above.
fn number<T: PartialEq>(list: &[T], wanted: &T) -> u8 {
    list.iter().position(|known| known == wanted).and_then(|at| u8::try_from(at).ok()).unwrap_or(0)
}

struct Writer<'a> {
    bytes: &'a mut [u8],
    at: usize,
}

impl Writer<'_> {
    fn put(&mut self, bytes: &[u8]) -> Result<(), Overflow> {
        let end = self.at + bytes.len();
        self.bytes.get_mut(self.at..end).ok_or(Overflow)?.copy_from_slice(bytes);
        self.at = end;
        Ok(())
    }

    fn byte(&mut self, byte: u8) -> Result<(), Overflow> {
        self.put(&[byte])
    }

    /// A position in a list that has at most 256 entries in a checked world.
    fn small(&mut self, number: u16) -> Result<(), Overflow> {
        self.byte(u8::try_from(number).map_err(|_| Overflow)?)
    }

    fn variables(&mut self, of: &[Variable], values: &[i64]) -> Result<(), Overflow> {
        let pairs = || of.iter().zip(values);
        let (mut bits, mut used) = (0, 0);
        for (_, &value) in pairs().filter(|(variable, _)| variable.of == Type::Bool) {
            bits |= u8::from(value != 0) << used;
            used += 1;
            if used == 8 {
                self.byte(bits)?;
                (bits, used) = (0, 0);
            }
        }
        if used > 0 {
            self.byte(bits)?;
        }
        for (variable, &value) in pairs().filter(|(variable, _)| variable.of != Type::Bool) {
            let mut room = [0; 4];
            variable.of.write(value, &mut room).ok_or(Overflow)?;
            self.put(&room[..variable.of.bytes()])?;
        }
        Ok(())
    }

    fn acted(&mut self, acted: Acted) -> Result<(), Overflow> {
        self.byte(u8::from(acted.ok))?;
        self.put(&acted.value.to_le_bytes())
    }

    fn wait(&mut self, wait: Wait, flag: u8) -> Result<(), Overflow> {
        match wait {
            Wait::Nothing => self.byte(flag),
            Wait::Register(handler, anew) => self.put(&[flag | 1, handler, number(&ANEW, &anew)]),
            Wait::Part(part) => self.put(&[flag | 2, part]),
            Wait::Signal => self.byte(flag | 3),
            Wait::Boundary => self.byte(flag | 4),
            Wait::Working => self.byte(flag | 5),
            Wait::Done(acted) => self.byte(flag | 6).and_then(|()| self.acted(acted)),
            Wait::Kept(acted) => self.byte(flag | 7).and_then(|()| self.acted(acted)),
            Wait::Choice(among) => {
                self.byte(flag | 8)?;
                self.put(&among.to_le_bytes())
            }
            Wait::Entering(None) => self.byte(flag | 9),
            Wait::Entering(Some(Inbound { contents, port, task, is_answer })) => {
                self.byte(flag | 10)?;
                self.small(port.0)?;
                self.byte(u8::from(is_answer) | u8::from(task.is_some()) << 1)?;
                self.small(task.unwrap_or_default().0)?;
                self.byte(u8::try_from(contents.as_bytes().len()).map_err(|_| Overflow)?)?;
                self.put(contents.as_bytes())
            }
            Wait::Abandon(anew) => self.put(&[flag | 11, number(&ANEW, &anew)]),
            Wait::Passive => self.byte(flag | 12),
        }
    }

    fn message(&mut self, to: ReplyTo, frame: &Frame<'_>) -> Result<(), Overflow> {
        self.small(to.port.0)?;
        self.small(to.source.0)?;
        if frame.lives {
            self.byte(to.id.incarnation.0)?;
        }
        let next = frame.sequences.get(to.source.index()).copied().unwrap_or_default();
        self.byte(u8::try_from(next.steps_from(to.id.sequence)).map_err(|_| Overflow)?)
    }

    fn end(&mut self, end: End) -> Result<(), Overflow> {
        match end {
            End::Finished => self.byte(0),
            End::Aborted(reason) => self.byte(1).and_then(|()| self.put(&reason.to_le_bytes())),
            End::Assertion(at) => self.byte(2).and_then(|()| self.put(&at.to_le_bytes())),
            End::Fenced => self.byte(3),
            End::Fault { fault: ScriptFault::Request(fault), at } => {
                self.put(&[4, number(&FAULTS, &fault)])?;
                self.put(&at.to_le_bytes())
            }
            End::Fault { fault, at } => {
                self.put(&[5, number(&SCRIPT_FAULTS, &fault)])?;
                self.put(&at.to_le_bytes())
            }
        }
    }
}

/// Reads packed bytes back; past their end there are zeros.
struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let mut bytes = [0; N];
        for byte in &mut bytes {
            *byte = self.bytes.get(self.at).copied().unwrap_or(0);
            self.at += 1;
        }
        bytes
    }

    fn byte(&mut self) -> u8 {
        let [byte] = self.take();
        byte
    }

    fn variables(&mut self, of: &[Variable], values: &mut [i64]) {
        let (mut bits, mut left) = (0, 0);
        for (variable, value) in of.iter().zip(values.iter_mut()) {
            if variable.of == Type::Bool {
                if left == 0 {
                    (bits, left) = (self.byte(), 8);
                }
                *value = i64::from(bits & 1);
                (bits, left) = (bits >> 1, left - 1);
            }
        }
        for (variable, value) in of.iter().zip(values.iter_mut()) {
            let raw: [u8; 4] = match variable.of {
                Type::Bool => continue,
                Type::Int8 => [self.byte(), 0, 0, 0],
                Type::Int16 => {
                    let [low, high] = self.take();
                    [low, high, 0, 0]
                }
                Type::Int32 | Type::Word | Type::Real => self.take(),
            };
            *value = variable.of.read(&raw).unwrap_or(0);
        }
    }

    fn acted(&mut self) -> Acted {
        Acted { ok: self.byte() == 1, value: i32::from_le_bytes(self.take()) }
    }

    fn anew(&mut self) -> Anew {
        ANEW.get(usize::from(self.byte())).copied().unwrap_or(Anew::Begin)
    }

    fn wait(&mut self, tag: u8) -> Wait {
        match tag {
            0 => Wait::Nothing,
            1 => Wait::Register(self.byte(), self.anew()),
            2 => Wait::Part(self.byte()),
            3 => Wait::Signal,
            4 => Wait::Boundary,
            5 => Wait::Working,
            6 => Wait::Done(self.acted()),
            7 => Wait::Kept(self.acted()),
            8 => Wait::Choice(u16::from_le_bytes(self.take())),
            9 => Wait::Entering(None),
            10 => {
                let port = PortId(u16::from(self.byte()));
                let flags = self.byte();
                let task = TaskId(u16::from(self.byte()));
                let mut bytes = [0; 12];
                let len = usize::from(self.byte()).min(12);
                bytes.iter_mut().take(len).for_each(|byte| *byte = self.byte());
                let contents = Contents::new(&bytes[..len]).unwrap_or_default();
                let task = (flags & 2 != 0).then_some(task);
                Wait::Entering(Some(Inbound { contents, port, task, is_answer: flags & 1 != 0 }))
            }
            11 => Wait::Abandon(self.anew()),
            _ => Wait::Passive,
        }
    }

    fn message(&mut self, lives: bool) -> ReplyTo {
        let port = PortId(u16::from(self.byte()));
        let source = TaskId(u16::from(self.byte()));
        let incarnation = Incarnation(if lives { self.byte() } else { 0 });
        let sequence = Frame::SEQUENCE.plus(Seq24::MODULUS - u32::from(self.byte()));
        ReplyTo { port, source, id: MessageId { incarnation, sequence } }
    }

    fn end(&mut self) -> End {
        match self.byte() {
            0 => End::Finished,
            1 => End::Aborted(u16::from_le_bytes(self.take())),
            2 => End::Assertion(u16::from_le_bytes(self.take())),
            3 => End::Fenced,
            4 => {
                let fault = FAULTS.get(usize::from(self.byte())).copied().unwrap_or(Fault::WrongUsage);
                End::Fault { fault: ScriptFault::Request(fault), at: u16::from_le_bytes(self.take()) }
            }
            _ => {
                let fault = SCRIPT_FAULTS.get(usize::from(self.byte())).copied();
                let fault = fault.unwrap_or(ScriptFault::Malformed);
                End::Fault { fault, at: u16::from_le_bytes(self.take()) }
            }
        }
    }
}

impl Script {
    /// Writes the canonical bytes of this state and returns how many.
    ///
    /// # Errors
    /// [`Overflow`] when a number or a distance between ids outgrows its field, or `out` is too short.
    pub fn store(&self, program: &Program, frame: &Frame<'_>, out: &mut [u8]) -> Result<usize, Overflow> {
        let mut w = Writer { bytes: out, at: 0 };
        match self.standing {
            Standing::NotBegun => w.byte(0)?,
            Standing::Ended(end) => {
                w.byte(ENDED << 6)?;
                w.end(end)?;
                w.variables(&program.variables, &self.variables)?;
            }
            Standing::Lives => {
                let flag = |set: bool, bit: u8| if set { bit } else { 0 };
                let flags = flag(self.held > 0, OPERANDS) | flag(self.atomic > 0, ATOMIC);
                w.byte(LIVES << 6 | flags | self.level)?;
                if self.atomic > 0 {
                    w.byte(self.atomic)?;
                }
                if self.held > 0 {
                    w.byte(u8::try_from(self.held).map_err(|_| Overflow)?)?;
                    let held = self.operands.iter().take(self.held);
                    held.copied().try_for_each(|operand| w.put(&operand.to_le_bytes()))?;
                }
                w.variables(&program.variables, &self.variables)?;
                for (level, thread) in self.frames.iter().enumerate().take(usize::from(self.level) + 1) {
                    self.store_thread(program, level, thread, frame, &mut w)?;
                }
            }
        }
        Ok(w.at)
    }

    fn store_thread(
        &self,
        program: &Program,
        level: usize,
        thread: &Thread,
        frame: &Frame<'_>,
        w: &mut Writer<'_>,
    ) -> Result<(), Overflow> {
        if level > 0 {
            w.byte(thread.handler.unwrap_or(u8::MAX))?;
        }
        if wide(program) {
            w.put(&thread.at.to_le_bytes())?;
        } else {
            w.small(thread.at)?;
        }
        w.wait(thread.wait, if thread.message.is_some() { MESSAGE } else { 0 })?;
        if let Some(message) = thread.message {
            w.message(message, frame)?;
        }
        let locals = self.locals.get(level * self.width..).unwrap_or(&[]);
        w.variables(handler_locals(program, thread), locals)
    }

    /// Reads a state back in place and returns how many bytes it took. Ids come back relative to [`Frame::SEQUENCE`].
    /// `bytes` must come from [`store`](Self::store) of a script of the same program.
    pub fn load(&mut self, program: &Program, lives: bool, bytes: &[u8]) -> usize {
        let mut r = Reader { bytes, at: 0 };
        self.frames.fill(Thread::default());
        (self.level, self.held, self.atomic) = (0, 0, 0);
        self.operands.fill(0);
        self.locals.fill(0);
        let head = r.byte();
        match head >> 6 {
            LIVES => {
                self.standing = Standing::Lives;
                if head & ATOMIC != 0 {
                    self.atomic = r.byte();
                }
                if head & OPERANDS != 0 {
                    self.held = usize::from(r.byte()).min(self.operands.len());
                    let room = self.operands.iter_mut().take(self.held);
                    room.for_each(|operand| *operand = i64::from_le_bytes(r.take()));
                }
                r.variables(&program.variables, &mut self.variables);
                let top = usize::from(head & 0xf).min(self.frames.len() - 1);
                self.level = u8::try_from(top).unwrap_or(0);
                (0..=top).for_each(|level| self.load_thread(program, level, lives, &mut r));
            }
            ENDED => {
                self.standing = Standing::Ended(r.end());
                r.variables(&program.variables, &mut self.variables);
            }
            _ => {
                self.standing = Standing::NotBegun;
                let initial = program.variables.iter().map(Variable::first);
                self.variables.iter_mut().zip(initial).for_each(|(value, initial)| *value = initial);
            }
        }
        r.at
    }

    fn load_thread(&mut self, program: &Program, level: usize, lives: bool, r: &mut Reader<'_>) {
        let handler = if level > 0 { Some(r.byte()).filter(|&handler| handler != u8::MAX) } else { None };
        let at = if wide(program) { u16::from_le_bytes(r.take()) } else { u16::from(r.byte()) };
        let tag = r.byte();
        let wait = r.wait(tag & !MESSAGE);
        let message = (tag & MESSAGE != 0).then(|| r.message(lives));
        let thread = Thread { handler, at, wait, message };
        let room = self.locals.get_mut(level * self.width..).unwrap_or(&mut []);
        r.variables(handler_locals(program, &thread), room);
        self.frames[level] = thread;
    }

    /// Looks at everything relative: the ids of the messages to answer.
    pub fn visit(&self, v: &mut impl Visit) {
        for message in self.frames.iter().filter_map(|thread| thread.message) {
            v.sequence(message.source, message.id.sequence);
        }
    }

    /// Changes everything relative.
    pub fn visit_mut(&mut self, v: &mut impl VisitMut) {
        for message in self.frames.iter_mut().filter_map(|thread| thread.message.as_mut()) {
            v.sequence(message.source, &mut message.id.sequence);
        }
    }

    /// Forgets the messages that cannot be answered any more: an answer to them and an answer to none end alike.
    pub fn bury(&mut self, answerable: impl Fn(&ReplyTo) -> bool) {
        for thread in &mut self.frames {
            thread.message = thread.message.filter(&answerable);
        }
    }

    /// Forgets a variable that nothing reads before it is written anew, as a checker knows from the program.
    pub fn bury_variable(&mut self, index: u16) {
        if let Some(variable) = self.variables.get_mut(usize::from(index)) {
            *variable = 0;
        }
    }
}

/// Whether positions in the code take two bytes.
fn wide(program: &Program) -> bool {
    program.code.len() > 256
}

fn handler_locals<'a>(program: &'a Program, thread: &Thread) -> &'a [Variable] {
    let handler = thread.handler.and_then(|at| program.handlers.get(usize::from(at)));
    handler.map_or(&[], |handler| &handler.locals)
}
