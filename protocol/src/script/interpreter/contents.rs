//! Packs operands into the contents of messages, and unpacks them (D28).

use super::{Flow, Interpreter, Step};
use crate::ids::{Incarnation, MessageId, PortId, Seq24, TaskId};
use crate::packet::{CONTENTS_BYTES, Contents};
use crate::request::{ReplyTo, Request};
use crate::script::program::{Format, MAX_MESSAGE, Op, StatementOutcome};
use crate::script::{Inbound, ScriptFault, ScriptOutbox, Wait};

impl<'a, O: ScriptOutbox> Interpreter<'a, O> {
    /// Sends the operands of a SEND or REPLY: the fragments from `part` on, one by one, and then fragment 0 with the request
    /// itself (D28).
    pub(super) fn transfer(&mut self, part: u8) -> Step {
        let op = self.op()?;
        let (Op::Send { format, .. }
        | Op::Reply { format }
        | Op::ReplyFor { format, .. }
        | Op::ReplyOwed { format, .. }) = *op
        else {
            return Err(ScriptFault::Malformed);
        };
        let to = match *op {
            Op::ReplyFor { port, format } => Some(self.named(port, format)?),
            Op::ReplyOwed { port, task, .. } => self.owed(port, task),
            _ => self.frame().message,
        };
        let port = match (*op, to) {
            (Op::Send { port, .. }, _) => port,
            (_, Some(to)) => to.port,
            (_, None) => {
                self.drop_fields(op)?;
                self.outcome = StatementOutcome::Unanswerable;
                return Ok(Flow::Next);
            }
        };
        let format = self.format(format)?;
        if usize::from(part) < format.fragments() {
            let contents = self.part(format, part)?;
            self.ask(Request::Part { port, index: part, contents });
            return Ok(self.wait(Wait::Part(part)));
        }
        let contents = self.part(format, 0)?;
        self.drop_fields(op)?;
        match (*op, to) {
            (Op::Send { port, to, time_out, .. }, _) => {
                self.ask(Request::Send { port, to, contents, time_out });
            }
            (_, Some(to)) => {
                let frame = self.frame();
                frame.message = frame.message.filter(|own| *own != to);
                self.ask(Request::Reply { to, contents });
            }
            (_, None) => return Err(ScriptFault::Malformed),
        }
        Ok(self.wait(Wait::Signal))
    }

    /// The message whose source and id are the two operands below the fields.
    fn named(&self, port: PortId, format: u16) -> Result<ReplyTo, ScriptFault> {
        let script = &*self.script;
        let first = script.held.checked_sub(self.format(format)?.fields.len() + 2);
        let name = first.and_then(|first| script.operands.get(first..)).ok_or(ScriptFault::Malformed)?;
        let [source, number, ..] = *name else { return Err(ScriptFault::Malformed) };
        let source = TaskId(u16::try_from(source).map_err(|_| ScriptFault::Overflow)?);
        let [low, middle, high, incarnation] =
            u32::try_from(number).map_err(|_| ScriptFault::Overflow)?.to_le_bytes();
        let sequence = Seq24::new(u32::from_le_bytes([low, middle, high, 0]));
        Ok(ReplyTo { port, source, id: MessageId { incarnation: Incarnation(incarnation), sequence } })
    }

    pub(super) fn format(&self, format: u16) -> Result<&'a Format, ScriptFault> {
        self.program.formats.get(usize::from(format)).ok_or(ScriptFault::Malformed)
    }

    /// Writes a message whose fields are the topmost operands. Returns its length.
    pub(super) fn pack(&self, format: &Format, bytes: &mut [u8]) -> Result<usize, ScriptFault> {
        let script = &*self.script;
        let first = script.held.checked_sub(format.fields.len()).ok_or(ScriptFault::Malformed)?;
        let operands = script.operands.get(first..script.held).ok_or(ScriptFault::Malformed)?;
        let mut len = 0;
        for (&field, &value) in format.fields.iter().zip(operands) {
            if !field.holds(value) {
                return Err(ScriptFault::Overflow);
            }
            let room = bytes.get_mut(len..).ok_or(ScriptFault::Malformed)?;
            field.write(value, room).ok_or(ScriptFault::Malformed)?;
            len += field.bytes();
        }
        Ok(len)
    }

    /// One fragment of the message whose fields are the topmost operands.
    pub(super) fn part(&self, format: &Format, index: u8) -> Result<Contents, ScriptFault> {
        if format.fragments() == 1 {
            let mut bytes = [0; CONTENTS_BYTES];
            let len = self.pack(format, &mut bytes)?;
            return Contents::new(&bytes[..len]).filter(|_| index == 0).ok_or(ScriptFault::Malformed);
        }
        let mut bytes = [0; MAX_MESSAGE];
        let len = self.pack(format, &mut bytes)?;
        let from = usize::from(index) * CONTENTS_BYTES;
        let bytes = bytes.get(from.min(len)..len.min(from + CONTENTS_BYTES)).ok_or(ScriptFault::Malformed)?;
        Contents::new(bytes).ok_or(ScriptFault::Malformed)
    }

    /// Pops the fields of an operation.
    pub(super) fn drop_fields(&mut self, op: &Op) -> Result<(), ScriptFault> {
        let (Op::Send { format, .. }
        | Op::Reply { format }
        | Op::ReplyFor { format, .. }
        | Op::ReplyOwed { format, .. }
        | Op::Arrive { format, .. }
        | Op::Publish { format }) = *op
        else {
            return Err(ScriptFault::Malformed);
        };
        let name = if matches!(op, Op::ReplyFor { .. }) { 2 } else { 0 };
        let fields = self.format(format)?.fields.len() + name;
        let first = self.script.held.checked_sub(fields).ok_or(ScriptFault::Malformed)?;
        self.drop_operands(first);
        Ok(())
    }

    pub(super) fn drop_operands(&mut self, first: usize) {
        let script = &mut *self.script;
        script.operands.iter_mut().take(script.held).skip(first).for_each(|cell| *cell = 0);
        script.held = first;
    }

    /// Reads the fields of the last message or answer into the variables of the operation.
    pub(super) fn unpack(&mut self, format: u16, into: u16) -> Result<(), ScriptFault> {
        let inbound = self.inbound.ok_or(ScriptFault::NothingReceived)?;
        let format = self.format(format)?;
        let total = format.bytes();
        let mut whole = [0; MAX_MESSAGE];
        let bytes = if total <= CONTENTS_BYTES {
            inbound.contents.as_bytes()
        } else {
            self.gather(&inbound, whole.get_mut(..total).ok_or(ScriptFault::Malformed)?)?;
            &whole[..total]
        };
        if bytes.len() != total {
            return Err(ScriptFault::WrongContents);
        }
        let places = self.program.places.get(usize::from(into)..).ok_or(ScriptFault::Malformed)?;
        if places.len() < format.fields.len() {
            return Err(ScriptFault::Malformed);
        }
        let mut at = 0;
        for (field, &place) in format.fields.iter().zip(places) {
            let value =
                bytes.get(at..).and_then(|bytes| field.read(bytes)).ok_or(ScriptFault::WrongContents)?;
            self.set(place, value)?;
            at += field.bytes();
        }
        Ok(())
    }

    /// Copies all fragments of a message or answer into `bytes`.
    fn gather(&mut self, inbound: &Inbound, bytes: &mut [u8]) -> Result<(), ScriptFault> {
        for (index, room) in (0..).zip(bytes.chunks_mut(CONTENTS_BYTES)) {
            let part = match index {
                0 => Some(inbound.contents),
                _ if inbound.is_answer => self.out.answer(inbound.port, inbound.task, index),
                _ => self.out.fragment(index),
            };
            let part = part.ok_or(ScriptFault::WrongContents)?;
            if part.as_bytes().len() != room.len() {
                return Err(ScriptFault::WrongContents);
            }
            room.copy_from_slice(part.as_bytes());
        }
        Ok(())
    }
}
