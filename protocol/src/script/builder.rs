//! A builder of programs, for the compiler of the cell language, for tests and for the checker's worlds.

use super::check::ProgramError;
use super::program::{Address, Format, Handler, Op, Outcomes, Program, Trigger, Variable};
use super::value::{Binary, Slot, Term, Type};
use crate::ids::{PortId, TaskId};
use crate::request::{Ranked, ServiceOrder, Target, TimeId};
use crate::ticks::Ticks;
use alloc::vec::Vec;

/// A position in the code. Jumps may name it before [`ProgramBuilder::put`] places it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Label(Address);

/// Builds a [`Program`]. Jumps name labels; [`ProgramBuilder::finish`] turns them into addresses.
#[derive(Clone, Debug, Default)]
pub struct ProgramBuilder {
    program: Program,
    labels: Vec<Option<Address>>,
    handler: Option<usize>,
}

impl ProgramBuilder {
    /// A program without code, for the task of this name.
    #[must_use]
    pub fn new(name: &str) -> Self {
        Self { program: Program { name: name.into(), ..Program::default() }, ..Self::default() }
    }

    /// Adds a variable of the task that begins with zero.
    pub fn variable(&mut self, name: &str, of: Type) -> Slot {
        self.program.variables.push(Variable { name: name.into(), of, initial: 0 });
        Slot::Task(position(self.program.variables.len()))
    }

    /// Adds a variable of the handler whose code is being built; outside of handlers, of the task.
    pub fn local(&mut self, name: &str, of: Type) -> Slot {
        let Some(handler) = self.handler.and_then(|at| self.program.handlers.get_mut(at)) else {
            return self.variable(name, of);
        };
        handler.locals.push(Variable { name: name.into(), of, initial: 0 });
        Slot::Local(position(handler.locals.len()))
    }

    /// Adds a timer.
    pub fn timer(&mut self, name: &str) -> TimeId {
        self.program.timers.push(name.into());
        TimeId(u8::try_from(self.program.timers.len() - 1).unwrap_or(u8::MAX))
    }

    /// The format of these fields.
    pub fn format(&mut self, fields: &[Type]) -> u16 {
        let format = Format { fields: fields.into() };
        entry(&mut self.program.formats, format)
    }

    /// Adds these variables to the places that [`Op::Unpack`] reads into, and returns the position of the first.
    pub fn places(&mut self, places: &[Slot]) -> u16 {
        let at = position(self.program.places.len() + 1);
        self.program.places.extend_from_slice(places);
        at
    }

    /// The number of the action of this name, which is added if it is new.
    pub fn action(&mut self, name: &str) -> u16 {
        entry(&mut self.program.actions, name.into())
    }

    /// The number of one more action of this name, with results of its own.
    pub fn another_action(&mut self, name: &str) -> u16 {
        self.program.actions.push(name.into());
        position(self.program.actions.len())
    }

    /// The number of the abort reason with this text.
    pub fn reason(&mut self, text: &str) -> u16 {
        entry(&mut self.program.reasons, text.into())
    }

    /// A new label.
    pub fn label(&mut self) -> Label {
        self.labels.push(None);
        Label(position(self.labels.len()))
    }

    /// Puts the label at the next operation.
    pub fn put(&mut self, label: Label) {
        if let Some(place) = self.labels.get_mut(usize::from(label.0)) {
            *place = Some(position(self.program.code.len() + 1));
        }
    }

    /// The address of the next operation, for tables from code to source.
    #[must_use]
    pub fn here(&self) -> Address {
        position(self.program.code.len() + 1)
    }

    /// Adds this operation, which must not jump.
    pub fn op(&mut self, op: Op) -> &mut Self {
        self.program.code.push(op);
        self
    }

    /// Adds the beginning of a statement.
    pub fn statement(&mut self) -> &mut Self {
        self.op(Op::Statement)
    }

    /// Adds an operation that pushes a constant.
    pub fn push(&mut self, value: i64) -> &mut Self {
        self.op(Op::Term(Term::Push(value)))
    }

    /// Adds an operation that pushes the value of a variable.
    pub fn load(&mut self, slot: Slot) -> &mut Self {
        self.op(Op::Term(Term::Load(slot)))
    }

    /// Adds an operator on integers.
    pub fn int(&mut self, operator: Binary) -> &mut Self {
        self.op(Op::Term(Term::Int(operator)))
    }

    /// Adds an operation that pops the last value into a variable.
    pub fn store(&mut self, slot: Slot) -> &mut Self {
        self.op(Op::Store(slot))
    }

    /// Adds a jump.
    pub fn jump(&mut self, to: Label) -> &mut Self {
        self.op(Op::Jump(to.0))
    }

    /// Adds a jump that is taken if the last value is false.
    pub fn unless(&mut self, to: Label) -> &mut Self {
        self.op(Op::Unless(to.0))
    }

    /// Adds a jump that is taken if the last statement ended with one of these outcomes.
    pub fn on(&mut self, outcomes: Outcomes, to: Label) -> &mut Self {
        self.op(Op::On { outcomes, to: to.0 })
    }

    /// Adds `slot := value`.
    pub fn set(&mut self, slot: Slot, value: i64) -> &mut Self {
        self.statement().push(value).store(slot)
    }

    /// Adds `order a > b > c`. With more entries than an `order` can have, it is an empty `order`.
    pub fn order(&mut self, named: &[Ranked]) -> &mut Self {
        let order = entry(&mut self.program.orders, ServiceOrder::new(named).unwrap_or_default());
        self.statement().op(Op::Order(order))
    }

    /// Adds `send`, `use_send` or `query`, with one variable for each field.
    pub fn send(&mut self, port: PortId, to: Target, fields: &[(Type, Slot)]) -> &mut Self {
        let format = self.arguments(fields);
        self.op(Op::Send { port, to, format, time_out: None })
    }

    /// Adds `receive port(..)` with this time_out, and unpacks the message. If no message came, the variables keep their
    /// values.
    pub fn receive(&mut self, port: PortId, time_out: Option<Ticks>, into: &[(Type, Slot)]) -> &mut Self {
        self.statement().op(Op::Get { port: Some(port), source: None, time_out });
        self.unpack(into)
    }

    /// Reads the message or answer of the last statement, if there is one.
    pub fn unpack(&mut self, into: &[(Type, Slot)]) -> &mut Self {
        if into.is_empty() {
            return self;
        }
        let (read, on) = (self.label(), self.label());
        let format = self.format_of(into);
        let places: Vec<Slot> = into.iter().map(|&(_, slot)| slot).collect();
        let into = self.places(&places);
        self.on(Outcomes::BRINGS, read).jump(on);
        self.put(read);
        self.op(Op::Unpack { format, into });
        self.put(on);
        self
    }

    /// Adds `reply` or `response`, with one variable for each field.
    pub fn reply(&mut self, fields: &[(Type, Slot)]) -> &mut Self {
        let format = self.arguments(fields);
        self.op(Op::Reply { format })
    }

    /// Adds `waitfor port()`.
    pub fn waitfor(&mut self, port: PortId) -> &mut Self {
        self.waitfor_with(port, &[])
    }

    /// Adds `waitfor port(..)`, with one variable for each field.
    pub fn waitfor_with(&mut self, port: PortId, fields: &[(Type, Slot)]) -> &mut Self {
        let format = self.arguments(fields);
        self.op(Op::Arrive { port, format, time_out: None })
    }

    /// Reads the arguments of a member at the waitfor; if the arguments are not known, the variables keep their values.
    pub fn arrival(&mut self, port: PortId, task: TaskId, into: &[(Type, Slot)]) -> &mut Self {
        let format = self.format_of(into);
        self.op(Op::Arrival { port, task, format });
        self.unpack_if(into)
    }

    /// Reads what the partner of the couple published last; if it has published nothing, the variables keep their values.
    pub fn published(&mut self, into: &[(Type, Slot)]) -> &mut Self {
        self.op(Op::Published);
        self.unpack_if(into)
    }

    /// Adds an operation that unpacks if the last value is true.
    fn unpack_if(&mut self, into: &[(Type, Slot)]) -> &mut Self {
        let format = self.format_of(into);
        let places: Vec<Slot> = into.iter().map(|&(_, slot)| slot).collect();
        let into = self.places(&places);
        self.then(|b| {
            b.op(Op::Unpack { format, into });
        })
    }

    /// Adds `delay`.
    pub fn delay(&mut self, length: Ticks) -> &mut Self {
        self.statement().op(Op::Delay(length))
    }

    /// Adds `start timer`.
    pub fn start(&mut self, timer: TimeId, length: Ticks) -> &mut Self {
        self.statement().op(Op::Start { timer, length })
    }

    /// Adds `run action takes least .. most`.
    pub fn run(&mut self, name: &str, least: Ticks, most: Ticks) -> &mut Self {
        let action = self.action(name);
        self.statement().op(Op::Run { action, arguments: 0, least, most })
    }

    /// Adds `abort reason`.
    pub fn abort(&mut self, reason: &str) -> &mut Self {
        let reason = self.reason(reason);
        self.statement().op(Op::Abort(reason))
    }

    /// Adds `loop .. end`, without an `exit`.
    pub fn forever(&mut self, body: impl FnOnce(&mut Self)) -> &mut Self {
        let top = self.label();
        self.put(top);
        body(self);
        self.jump(top)
    }

    /// Adds `while slot do .. end`.
    pub fn while_true(&mut self, slot: Slot, body: impl FnOnce(&mut Self)) -> &mut Self {
        let (top, out) = (self.label(), self.label());
        self.put(top);
        self.statement().load(slot).unless(out);
        body(self);
        self.jump(top);
        self.put(out);
        self
    }

    /// Adds `.. on time_out do .. end` or a similar branch, after a statement.
    pub fn when(&mut self, outcomes: Outcomes, body: impl FnOnce(&mut Self)) -> &mut Self {
        let (inside, on) = (self.label(), self.label());
        self.on(outcomes, inside).jump(on);
        self.put(inside);
        body(self);
        self.put(on);
        self
    }

    /// Adds `if`, which tests the last value.
    pub fn then(&mut self, body: impl FnOnce(&mut Self)) -> &mut Self {
        let on = self.label();
        self.unless(on);
        body(self);
        self.put(on);
        self
    }

    /// Adds `if .. else`, which tests the last value.
    pub fn either(&mut self, yes: impl FnOnce(&mut Self), no: impl FnOnce(&mut Self)) -> &mut Self {
        let (other, on) = (self.label(), self.label());
        self.unless(other);
        yes(self);
        self.jump(on);
        self.put(other);
        no(self);
        self.put(on);
        self
    }

    /// Adds `on .. do .. end`: a handler. Call this after the end of the body, so that the body does not run into the
    /// handler.
    pub fn handler(&mut self, trigger: Trigger, body: impl FnOnce(&mut Self)) -> &mut Self {
        let entry = self.here();
        self.program.handlers.push(Handler { trigger, entry, locals: Vec::new() });
        self.handler = Some(self.program.handlers.len() - 1);
        body(self);
        self.handler = None;
        self.op(Op::HandlerEnd)
    }

    /// Adds `on query` or `on receive`, with the names and types of the variables that take the message's fields.
    pub fn on_message(
        &mut self,
        port: PortId,
        fields: &[(&str, Type)],
        body: impl FnOnce(&mut Self, &[Slot]),
    ) -> &mut Self {
        self.handler(Trigger::Message(port), |b| {
            let locals: Vec<(Type, Slot)> =
                fields.iter().map(|&(name, of)| (of, b.local(name, of))).collect();
            b.unpack(&locals);
            let slots: Vec<Slot> = locals.iter().map(|&(_, slot)| slot).collect();
            body(b, &slots);
        })
    }

    /// Adds `takeover`: where the task continues in its partner's place. Call this after the end of the body.
    pub fn takeover(&mut self, body: impl FnOnce(&mut Self)) -> &mut Self {
        self.program.takeover = Some(self.here());
        body(self);
        self.op(Op::End)
    }

    /// Adds the end of the task.
    pub fn end(&mut self) -> &mut Self {
        self.op(Op::End)
    }

    /// Returns the finished program, checked.
    ///
    /// # Errors
    /// What [`Program::check`] finds; a label that was never placed is [`ProgramError::NoSuchAddress`].
    pub fn finish(mut self) -> Result<Program, ProgramError> {
        for op in &mut self.program.code {
            if let Op::Jump(to) | Op::Unless(to) | Op::On { to, .. } = op {
                let place = self.labels.get(usize::from(*to)).copied().flatten();
                *to = place.ok_or(ProgramError::NoSuchAddress(*to))?;
            }
        }
        self.program.check()?;
        Ok(self.program)
    }

    fn arguments(&mut self, fields: &[(Type, Slot)]) -> u16 {
        self.statement();
        for &(_, slot) in fields {
            self.load(slot);
        }
        self.format_of(fields)
    }

    fn format_of(&mut self, fields: &[(Type, Slot)]) -> u16 {
        let types: Vec<Type> = fields.iter().map(|&(of, _)| of).collect();
        self.format(&types)
    }
}

/// The position of `wanted` in its table; a missing entry is added.
fn entry<T: PartialEq>(table: &mut Vec<T>, wanted: T) -> u16 {
    let at = table.iter().position(|known| *known == wanted).unwrap_or(table.len());
    if at == table.len() {
        table.push(wanted);
    }
    position(at + 1)
}

/// The position of the last of `len` entries. A program with more entries than a position can name fails its check.
fn position(len: usize) -> u16 {
    u16::try_from(len - 1).unwrap_or(u16::MAX)
}
