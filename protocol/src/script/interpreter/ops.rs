//! The operations of the interpreter: what each one does.

use super::{Flow, Interpreter, Step};
use crate::ids::{PortId, TaskId};
use crate::packet::Contents;
use crate::request::{Answers, Request};
use crate::script::program::{Fusing, Mark, Op, StatementOutcome, Trigger};
use crate::script::value::{Operands, Slot, Term};
use crate::script::{Action, Address, End, Frame, Inbound, Script, ScriptFault, ScriptOutbox, Wait};
use crate::ticks::Ticks;

impl<O: ScriptOutbox> Interpreter<'_, O> {
    pub(super) fn execute(&mut self, op: &Op) -> Step {
        match *op {
            Op::Statement => return Ok(self.statement(self.script.frames[usize::from(self.script.level)].at)),
            Op::Term(term) => self.term(term)?,
            Op::Store(slot) => {
                let value = self.operands().pop()?;
                self.set(slot, value)?;
            }
            Op::Pop => {
                self.operands().pop()?;
            }
            Op::Jump(to) => return Ok(Flow::To(to)),
            Op::Unless(to) => {
                return Ok(if self.operands().pop()? == 0 { Flow::To(to) } else { Flow::Next });
            }
            Op::On { outcomes, to } => {
                return Ok(if outcomes.has(self.outcome) { Flow::To(to) } else { Flow::Next });
            }
            Op::Outcome => {
                let outcome = self.outcome as u8;
                self.operands().push(i64::from(outcome))?;
            }
            Op::Value => {
                let value = self.value;
                self.operands().push(value)?;
            }
            Op::Mark(mark) => {
                let mask = self.mark(mark);
                self.operands().push(mask.cast_signed())?;
            }
            Op::Answer { port, task } => {
                let answer = self.out.answer(port, Some(task), 0);
                self.bring(port, Some(task), answer)?;
            }
            Op::Published => {
                let published = self.published().filter(|said| !said.as_bytes().is_empty());
                self.bring(PortId::NONE, None, published)?;
            }
            Op::Arrival { port, task, format } => {
                let told = self.arrival(port, task);
                let bytes = self.format(format)?.bytes();
                let told = told.and_then(|told| Contents::new(told.get(..bytes)?));
                self.bring(port, Some(task), told)?;
            }
            Op::ReceivedId => {
                let id = self.frame().message.map(|message| message.id);
                let number = id.map_or(0, |id| u32::from(id.incarnation.0) << 24 | id.sequence.get());
                self.operands().push(i64::from(number))?;
            }
            Op::Unpack { format, into } => self.unpack(format, into)?,
            Op::ReceivedPort => {
                let port = self.inbound.ok_or(ScriptFault::NothingReceived)?.port;
                self.operands().push(i64::from(port.0))?;
            }
            Op::ReceivedSource => {
                let task =
                    self.inbound.and_then(|inbound| inbound.task).ok_or(ScriptFault::NothingReceived)?;
                self.operands().push(i64::from(task.0))?;
            }
            Op::Assert => {
                if self.operands().pop()? == 0 {
                    let at = self.frame().at;
                    self.finish(End::Assertion(at));
                    return Ok(Flow::Stop);
                }
            }
            Op::Abort(reason) => {
                self.finish(End::Aborted(reason));
                return Ok(Flow::Stop);
            }
            Op::End => {
                self.finish(End::Finished);
                return Ok(Flow::Stop);
            }
            Op::HandlerEnd => return self.handler_end(),
            Op::Choose(alternatives) => return self.choose(alternatives),
            Op::Send { .. } | Op::Reply { .. } | Op::ReplyFor { .. } | Op::ReplyOwed { .. } => {
                return self.transfer(1);
            }
            Op::Run { action, arguments, least, most } => return self.act(action, arguments, least, most),
            Op::Get { .. }
            | Op::Arrive { .. }
            | Op::Order(_)
            | Op::Delay(_)
            | Op::Start { .. }
            | Op::Stop(_)
            | Op::Atomic(_)
            | Op::Publish { .. }
            | Op::Lease => {
                let request = self.request(op)?;
                self.ask(request);
                return Ok(self.wait(Wait::Signal));
            }
        }
        Ok(Flow::Next)
    }

    /// A mask of the tasks whose last answers were of the kind `mark`.
    fn mark(&self, mark: Mark) -> u64 {
        let Some(Answers { asked, answered, refused, restarted, unsent }) = self.answers else { return 0 };
        *match mark {
            Mark::Asked => asked,
            Mark::Answered => answered,
            Mark::Refused => refused,
            Mark::Restarted => restarted,
            Mark::Unsent => unsent,
        }
    }

    /// Sets the contents that [`Op::Unpack`] reads, and pushes whether there are any.
    fn bring(
        &mut self,
        port: PortId,
        task: Option<TaskId>,
        came: Option<Contents>,
    ) -> Result<(), ScriptFault> {
        self.inbound = came.map(|contents| Inbound { contents, port, task, is_answer: true });
        self.operands().push(i64::from(came.is_some()))
    }

    /// Begins an action. A task that waits for its lease begins no action (D61). Only its fence handler may, to bring the
    /// robot to rest.
    fn act(&mut self, action: u16, arguments: u8, least: Ticks, most: Ticks) -> Step {
        let script = &*self.script;
        let first = script.held.checked_sub(usize::from(arguments)).ok_or(ScriptFault::Malformed)?;
        if self.waits_for_its_lease() {
            self.forget_answer();
            self.outcome = StatementOutcome::Fenced;
            self.drop_operands(first);
            return Ok(Flow::Next);
        }
        self.ask(Request::Work);
        let script = &*self.script;
        let level = script.level;
        let arguments = script.operands.get(first..script.held).ok_or(ScriptFault::Malformed)?;
        self.out.run(Action { level, action, arguments, least, most });
        self.drop_operands(first);
        Ok(self.wait(Wait::Working))
    }

    /// Whether the task's own thread waits to get its lease, for the first time or again.
    fn waits_for_its_lease(&self) -> bool {
        let own = self.script.frames[0];
        let op = || self.program.code.get(usize::from(own.at));
        own.wait == Wait::Passive || own.wait == Wait::Signal && op() == Some(&Op::Lease)
    }

    /// The request of an operation that makes exactly one request.
    fn request(&mut self, op: &Op) -> Result<Request, ScriptFault> {
        Ok(match *op {
            Op::Get { port, source, time_out } => Request::Get { port, source, time_out },
            Op::Arrive { port, format, time_out } => {
                let mut arguments = [0; 8];
                self.pack(self.format(format)?, &mut arguments)?;
                self.drop_fields(op)?;
                Request::Arrive { port, arguments, time_out }
            }
            Op::Publish { format } => {
                let contents = self.part(self.format(format)?, 0)?;
                self.drop_fields(op)?;
                Request::Publish(contents)
            }
            Op::Order(order) => {
                let order = self.program.orders.get(usize::from(order)).ok_or(ScriptFault::Malformed)?;
                Request::Order(*order)
            }
            Op::Delay(length) => Request::Delay { id: self.delay_id(), length },
            Op::Start { timer, length } => Request::Start { id: timer, length },
            Op::Stop(timer) => Request::Stop { id: timer },
            Op::Lease => Request::Lease,
            Op::Atomic(opens) => return self.atomic(opens),
            _ => return Err(ScriptFault::Malformed),
        })
    }

    /// Opens or closes an atomic section. Sections nest; the communication task only learns whether any is open.
    fn atomic(&mut self, opens: bool) -> Result<Request, ScriptFault> {
        let open = self.script.atomic;
        self.script.atomic =
            if opens { open.checked_add(1) } else { open.checked_sub(1) }.ok_or(ScriptFault::Malformed)?;
        Ok(Request::Atomic(self.script.atomic > 0))
    }

    /// Begins a statement. If a handler may be due, first asks the communication task whether the handler runs now
    /// (D15).
    #[inline(always)]
    pub(super) fn statement(&mut self, at: Address) -> Flow {
        self.out.statement(at);
        self.forget_answer();
        let asks = match self.program.fusing {
            Fusing::Fused => self.fresh,
            Fusing::EveryStatement => true,
        };
        self.fresh = false;
        if !asks || self.script.atomic > 0 || !self.program.is_interruptible() {
            return Flow::Next;
        }
        self.ask(Request::Boundary);
        self.frame().at = at;
        self.wait(Wait::Boundary)
    }

    fn forget_answer(&mut self) {
        (self.outcome, self.value, self.inbound) = (StatementOutcome::Done, 0, None);
        self.answers = None;
    }

    fn choose(&mut self, alternatives: u16) -> Step {
        self.forget_answer();
        match self.out.choose(alternatives) {
            None if alternatives > 0 => Ok(self.wait(Wait::Choice(alternatives))),
            Some(choice) if choice < alternatives => {
                self.operands().push(i64::from(choice))?;
                Ok(Flow::Next)
            }
            None | Some(_) => Err(ScriptFault::Unexpected),
        }
    }

    fn handler_end(&mut self) -> Step {
        let Some(handler) = self.frame().handler else { return Err(ScriptFault::Malformed) };
        if self.script.atomic > 0 {
            return Err(ScriptFault::Malformed);
        }
        if let Some(message) = self.frame().message {
            self.out.unanswered(message);
        }
        let trigger = self.program.handlers.get(usize::from(handler)).map(|handler| handler.trigger);
        *self.frame() = Frame::default();
        let script = &mut *self.script;
        let level = usize::from(script.level);
        script.locals.iter_mut().skip(level * script.width).for_each(|cell| *cell = 0);
        script.level = script.level.saturating_sub(1);
        if trigger == Some(Trigger::Fenced) {
            self.fenced();
            return Ok(Flow::Stop);
        }
        self.ask(Request::Return);
        if let Wait::Kept(acted) = self.frame().wait {
            self.frame().wait = Wait::Done(acted);
            self.ask(Request::Done);
        }
        Ok(Flow::Stop)
    }

    fn term(&mut self, term: Term) -> Result<(), ScriptFault> {
        let program = self.program;
        let Script { operands, held, variables, locals, width, level, frames, .. } = &mut *self.script;
        let base = usize::from(*level) * *width;
        let handler = frames[usize::from(*level)].handler;
        let mut look = |term| match term {
            Term::Load(Slot::Task(at)) => variables.get(usize::from(at)).copied(),
            Term::Load(Slot::Local(at)) => {
                program.local(handler, at)?;
                locals.get(base + usize::from(at)).copied()
            }
            _ => None,
        };
        Operands { cells: operands, len: held }.apply(term, &mut look)
    }

    pub(super) fn set(&mut self, slot: Slot, value: i64) -> Result<(), ScriptFault> {
        let handler = self.frame().handler;
        let script = &mut *self.script;
        let (variable, cell) = match slot {
            Slot::Task(at) => {
                (self.program.variables.get(usize::from(at)), script.variables.get_mut(usize::from(at)))
            }
            Slot::Local(at) => {
                let base = usize::from(script.level) * script.width;
                (self.program.local(handler, at), script.locals.get_mut(base + usize::from(at)))
            }
        };
        let (Some(variable), Some(cell)) = (variable, cell) else { return Err(ScriptFault::Malformed) };
        if !variable.of.holds(value) {
            return Err(ScriptFault::Overflow);
        }
        *cell = value;
        Ok(())
    }
}
