//! Shortcuts: operations with resolved operands. A shortcut is carried out wholly or returns `None`. Before a `None` it
//! makes no change that the operations themselves would not make, too.

use super::Interpreter;
use crate::packet::{CONTENTS_BYTES, Contents};
use crate::request::Request;
use crate::script::code::{Act, Compute, Function, Landing, Operand, Send, Shortcut, Then, Unpack};
use crate::script::program::{Address, Op};
use crate::script::value::{Slot, integers, number, reals};
use crate::script::{ScriptOutbox, Wait};

/// How a script goes on after a shortcut.
pub(super) enum Next {
    At(Landing),
    /// The script does not go on: its activation waits.
    Stop,
    /// The shortcut was not taken.
    Plain,
}

impl<O: ScriptOutbox> Interpreter<'_, O> {
    /// Carries out the shortcut of the operation `at`, without the beginning of a statement.
    #[inline]
    pub(super) fn shortcut(&mut self, shortcut: &Shortcut, at: Address) -> Next {
        let next = Next::At(shortcut.next);
        match &shortcut.act {
            Act::Plain => Next::Plain,
            Act::Jump => next,
            Act::On(first) => {
                let landing = self.code.branches.get(usize::from(*first) + self.outcome as usize);
                landing.map_or(Next::Plain, |&landing| Next::At(landing))
            }
            Act::Compute(compute) => {
                let Some(value) = self.compute(compute) else { return Next::Plain };
                match compute.then {
                    Then::Unless(to) if value == 0 => Next::At(Landing { to, count: shortcut.count }),
                    _ => next,
                }
            }
            Act::Send(send) => {
                if self.send(send, at).is_some() {
                    Next::Stop
                } else {
                    Next::Plain
                }
            }
            Act::Unpack(unpack) => {
                if self.read(unpack).is_some() {
                    next
                } else {
                    Next::Plain
                }
            }
            Act::Get => {
                let Some(&Op::Get { port, source, time_out }) = self.program.code.get(usize::from(at)) else {
                    return Next::Plain;
                };
                self.ask(Request::Get { port, source, time_out });
                self.wait_at(at);
                Next::Stop
            }
        }
    }

    fn wait_at(&mut self, at: Address) {
        let frame = self.frame();
        (frame.at, frame.wait) = (at, Wait::Signal);
    }

    /// Computes a value, and stores it, pushes it or jumps by it.
    #[inline]
    fn compute(&mut self, compute: &Compute) -> Option<i64> {
        let a = self.value(compute.a)?;
        let value = match compute.function {
            Function::Same => a,
            Function::Not => i64::from(a == 0),
            Function::Int(operator) => integers(operator, a, self.value(compute.b)?).ok()?,
            Function::Real(operator) => reals(operator, number(a)?, number(self.value(compute.b)?)?).ok()?,
        };
        match compute.then {
            Then::Store(slot, of) => {
                if !of.holds(value) {
                    return None;
                }
                *self.cell(slot)? = value;
                self.pop(compute.pops);
            }
            Then::Unless(_) => self.pop(compute.pops),
            Then::Push => {
                self.pop(compute.pops);
                self.operands().push(value).ok()?;
            }
        }
        Some(value)
    }

    fn value(&self, operand: Operand) -> Option<i64> {
        let script = &*self.script;
        match operand {
            Operand::Constant(value) => Some(value),
            Operand::Task(at) => script.variables.get(usize::from(at)).copied(),
            Operand::Local(at) => script.locals.get(self.base() + usize::from(at)).copied(),
            Operand::Stack(below) => {
                script.operands.get(script.held.checked_sub(usize::from(below))?).copied()
            }
        }
    }

    fn cell(&mut self, slot: Slot) -> Option<&mut i64> {
        match slot {
            Slot::Task(at) => self.script.variables.get_mut(usize::from(at)),
            Slot::Local(at) => {
                let base = self.base();
                self.script.locals.get_mut(base + usize::from(at))
            }
        }
    }

    /// The position of the first variable of the running handler.
    fn base(&self) -> usize {
        usize::from(self.script.level) * self.script.width
    }

    /// Removes `count` operands from the stack, which holds at least as many.
    fn pop(&mut self, count: u8) {
        if count > 0 {
            self.drop_operands(self.script.held.saturating_sub(usize::from(count)));
        }
    }

    /// Packs a message and makes the request that sends it.
    #[inline]
    fn send(&mut self, send: &Send, at: Address) -> Option<()> {
        let mut bytes = [0; CONTENTS_BYTES];
        for field in self.code.sent.get(send.fields.range())? {
            let value = self.value(field.value)?;
            if !field.of.holds(value) {
                return None;
            }
            field.of.write(value, bytes.get_mut(usize::from(field.at)..)?)?;
        }
        let at = at.checked_add(send.pushed.into())?;
        let request = match *self.program.code.get(usize::from(at))? {
            Op::Send { port, to, time_out, .. } => {
                Request::Send { port, to, contents: Contents::padded_with(bytes, send.len), time_out }
            }
            Op::Reply { .. } => {
                let to = self.frame().message.take()?;
                Request::Reply { to, contents: Contents::padded_with(bytes, send.len) }
            }
            Op::Arrive { port, time_out, .. } => {
                Request::Arrive { port, arguments: *bytes.first_chunk()?, time_out }
            }
            _ => return None,
        };
        self.pop(send.pops);
        self.ask(request);
        self.wait_at(at);
        Some(())
    }

    /// Reads a message or answer of one packet.
    #[inline]
    fn read(&mut self, unpack: &Unpack) -> Option<()> {
        let contents = self.inbound.as_ref()?.contents;
        if contents.len() != unpack.len {
            return None;
        }
        for field in self.code.read.get(unpack.fields.range())? {
            let value = field.of.read(contents.padded().get(usize::from(field.at)..)?)?;
            if field.of != field.holds && !field.holds.holds(value) {
                return None;
            }
            *self.cell(field.place)? = value;
        }
        Some(())
    }
}
