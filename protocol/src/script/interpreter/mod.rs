//! The interpreter of scripts: handles one input, and runs the operations that follow from it.

mod answers;
mod contents;
mod ops;
mod shortcut;

use super::code::{Code, Landing};
use super::program::{Op, Program, StatementOutcome, Trigger};
use super::value::Operands;
use super::{
    Acted, Address, Anew, End, Frame, Inbound, Requests, STEP_LIMIT, Script, ScriptFault, ScriptOutbox,
    Standing, Wait,
};
use crate::request::{Answers, Call, Fault, Request, Signal, TimeId};
use shortcut::Next;

/// The interpreter of one step, with the results of the last answer. These results end with the step, so they are not part
/// of a script's state.
pub(super) struct Interpreter<'a, O> {
    script: &'a mut Script,
    program: &'a Program,
    code: &'a Code,
    requests: &'a mut Requests,
    out: &'a mut O,
    outcome: StatementOutcome,
    value: i64,
    inbound: Option<Inbound>,
    answers: Option<&'a Answers>,
    /// Whether a message may have arrived since a handler could last begin.
    fresh: bool,
}

/// How the script goes on after an operation.
#[derive(Clone, Copy)]
enum Flow {
    Next,
    To(Address),
    /// The script does not go on: its activation waits, or has ended.
    Stop,
}

type Step = Result<Flow, ScriptFault>;

impl<'a, O: ScriptOutbox> Interpreter<'a, O> {
    pub fn new(
        script: &'a mut Script,
        program: &'a Program,
        code: &'a Code,
        requests: &'a mut Requests,
        out: &'a mut O,
    ) -> Self {
        Self {
            script,
            program,
            code,
            requests,
            out,
            outcome: StatementOutcome::Done,
            value: 0,
            inbound: None,
            answers: None,
            fresh: false,
        }
    }

    pub fn begin(&mut self) {
        self.script.standing = Standing::Runs;
        self.register(0, Anew::Begin);
    }

    pub fn signal(&mut self, signal: &'a Signal) {
        // This match handles the usual answer quickly, before all other cases are distinguished.
        let is_usual = matches!(self.frame().wait, Wait::Signal)
            && !matches!(signal, Signal::Interrupt(_) | Signal::Granted(_) | Signal::Fault(_));
        if is_usual || self.is_plain_answer(signal) {
            self.resume(|turn| turn.answered(signal).map(|()| Flow::Next));
        }
    }

    /// Handles a signal, unless the signal only answers the operation in which the running activation waits. For such an answer
    /// this function returns true and does nothing.
    fn is_plain_answer(&mut self, signal: &Signal) -> bool {
        let wait = self.frame().wait;
        match (wait, *signal) {
            // Requests made before the `Abandon` may still be answered.
            (Wait::Abandon(anew), Signal::Cancelled) => self.register(0, anew),
            (Wait::Abandon(_), _) => {}
            (Wait::Passive, Signal::Granted(_)) => self.begin_anew(Anew::TakeOver),
            (Wait::Passive, Signal::Fault(Fault::Fenced)) => self.finish(End::Fenced),
            // The lease was lost before the script began, as after a restart: the body must not run without it (D156).
            (Wait::Signal, Signal::Fault(Fault::Fenced)) if matches!(self.op(), Ok(Op::Lease)) => {
                self.finish(End::Fenced);
            }
            (Wait::Signal, Signal::Granted(_)) if matches!(self.op(), Ok(Op::Lease)) => {
                self.register(0, Anew::Granted);
            }
            (_, Signal::Interrupt(call)) => self.interrupt(call),
            (Wait::Register(handler, anew), Signal::Accepted(_)) => {
                self.register(handler.saturating_add(1), anew);
            }
            (Wait::Part(part), Signal::Accepted(_)) => {
                self.resume(|turn| turn.transfer(part.saturating_add(1)));
            }
            (Wait::Boundary, Signal::Accepted(_)) => self.resume(|_| Ok(Flow::Next)),
            (Wait::Done(acted), Signal::Accepted(_)) => {
                self.fresh = true;
                self.value = i64::from(acted.value);
                self.outcome = if acted.ok { StatementOutcome::Done } else { StatementOutcome::Failed };
                self.resume(|_| Ok(Flow::Next));
            }
            (Wait::Entering(inbound), Signal::Fault(Fault::Busy)) => {
                self.inbound = inbound;
                if inbound.is_some() {
                    self.outcome = StatementOutcome::Message;
                }
                self.frame().wait = Wait::Nothing;
                self.run();
            }
            (Wait::Signal, _) | (Wait::Part(_), Signal::Fault(_)) => return true,
            (_, Signal::Fault(fault)) => self.fault(ScriptFault::Request(fault)),
            _ => self.fault(ScriptFault::Unexpected),
        }
        false
    }

    /// An action has ended. Its activation goes on, or keeps the result until the handlers above it have ended.
    pub fn acted(&mut self, level: u8, acted: Acted) {
        let running = level == self.script.level;
        let Some(frame) = self.script.frames.get_mut(usize::from(level)) else { return };
        if frame.wait != Wait::Working {
            return;
        }
        frame.wait = if running { Wait::Done(acted) } else { Wait::Kept(acted) };
        if running {
            self.ask(Request::Done);
        }
    }

    pub fn chosen(&mut self, choice: u16) {
        match self.frame().wait {
            Wait::Choice(alternatives) if choice < alternatives => self.resume(|turn| {
                turn.operands().push(i64::from(choice))?;
                // Time may have passed before the driver chose.
                turn.fresh = true;
                Ok(Flow::Next)
            }),
            Wait::Choice(_) => self.fault(ScriptFault::Unexpected),
            _ => {}
        }
    }

    /// Ends the script with a fault: later inputs have no effect.
    pub fn fault(&mut self, fault: ScriptFault) {
        let at = self.frame().at;
        self.finish(End::Fault { fault, at });
    }

    fn finish(&mut self, end: End) {
        self.give_up();
        self.script.standing = Standing::Ended(end);
        self.out.ended(end);
        // A primary or standby that has ended must answer no heartbeat any more, so that its partner takes over
        // (D61).
        if self.out.communication().is_some_and(|(machine, _)| machine.epoch().is_some()) {
            self.ask(Request::End);
        }
    }

    fn ask(&mut self, request: Request) {
        self.out.asked(&request);
        self.requests.push(request);
    }

    /// Stops every action, and drops every activation here and in the communication task.
    fn give_up(&mut self) {
        self.cut_short();
        let script = &mut *self.script;
        for frame in &mut script.frames[..=usize::from(script.level)] {
            if let Some(message) = frame.message {
                self.out.unanswered(message);
            }
            *frame = Frame::default();
        }
        script.level = 0;
        script.atomic = 0;
        script.operands.fill(0);
        script.held = 0;
        script.locals.fill(0);
        self.ask(Request::Abandon);
    }

    fn cut_short(&mut self) {
        for (level, frame) in (0..).zip(self.script.frames.iter_mut()) {
            if frame.wait == Wait::Working {
                frame.wait = Wait::Signal;
                self.out.cut_short(level);
            }
        }
    }

    /// Registers the handlers with the communication task, one after another, and then lets the script continue as `anew`
    /// says.
    fn register(&mut self, from: u8, anew: Anew) {
        let acting = self.script.acting;
        let acts = |handler: u8| acting >> handler & 1 == 1;
        let mut handlers = self.program.handled(from);
        // The grant of the lease registers only the handlers that had to wait for it.
        if let Some((handler, port)) = handlers.find(|&(handler, _)| anew != Anew::Granted || acts(handler)) {
            self.frame().wait = Wait::Register(handler, anew);
            let lacks = match anew {
                Anew::Begin => self.program.begins_with_a_lease(),
                Anew::Passive => true,
                Anew::Granted | Anew::TakeOver => false,
            };
            return self.ask(Request::Handle { port, handled: !(lacks && acts(handler)) });
        }
        let at = match anew {
            Anew::Granted => {
                self.fresh = true;
                return self.resume(|_| Ok(Flow::Next));
            }
            Anew::Begin => 0,
            Anew::TakeOver => self.program.takeover.unwrap_or(0),
            Anew::Passive => {
                self.frame().wait = Wait::Passive;
                return self.ask(Request::Lease);
            }
        };
        *self.frame() = Frame { at, ..Frame::default() };
        self.fresh = true;
        self.run();
    }

    /// Suspends the running activation for a handler (R16).
    fn interrupt(&mut self, call: Call) {
        let interruptible = match self.frame().wait {
            Wait::Signal | Wait::Boundary | Wait::Working | Wait::Done(_) | Wait::Passive => true,
            Wait::Nothing
            | Wait::Register(..)
            | Wait::Part(_)
            | Wait::Kept(_)
            | Wait::Choice(_)
            | Wait::Entering(_)
            | Wait::Abandon(_) => false,
        };
        if !interruptible {
            return self.fault(ScriptFault::Unexpected);
        }
        let trigger = match call {
            Call::Message(delivery) => Trigger::Message(delivery.from.port),
            Call::Timer(timer) => Trigger::Timer(timer),
            Call::Fenced => Trigger::Fenced,
            Call::TakeOver(_) if self.program.takeover.is_none() => {
                return self.fault(ScriptFault::Unexpected);
            }
            Call::TakeOver(_) => return self.begin_anew(Anew::TakeOver),
        };
        let handler = self.program.handler(trigger);
        if call == Call::Fenced {
            self.cut_short();
            // An activation that a fence interrupts never goes on, so its open atomic sections end here.
            self.script.atomic = 0;
            if handler.is_none() {
                return self.fenced();
            }
        }
        let Some((position, handler)) = handler else { return self.fault(ScriptFault::Unexpected) };
        let crossed = if let Wait::Done(acted) = self.frame().wait {
            self.frame().wait = Wait::Kept(acted);
            true
        } else {
            false
        };
        let script = &mut *self.script;
        let level = usize::from(script.level) + 1;
        let Some(frame) = script.frames.get_mut(level) else { return self.fault(ScriptFault::TooDeep) };
        *frame = Frame { handler: Some(position), at: handler.entry, ..Frame::default() };
        script.level += 1;
        let locals = script.locals.iter_mut().skip(level * script.width);
        for (cell, variable) in locals.zip(&handler.locals) {
            *cell = variable.first();
        }
        if let Call::Message(delivery) = call {
            self.take(&delivery);
        }
        if crossed {
            self.frame().wait = Wait::Entering(self.inbound);
        } else {
            self.run();
        }
    }

    fn begin_anew(&mut self, anew: Anew) {
        self.give_up();
        self.frame().wait = Wait::Abandon(anew);
    }

    /// The task lost its lease: the script stops its work, but may take over later (D61).
    fn fenced(&mut self) {
        if self.program.takeover.is_some() {
            self.begin_anew(Anew::Passive);
        } else {
            self.finish(End::Fenced);
        }
    }

    /// Ends the wait of the running activation and continues as `step` says, unless that activation waits for something
    /// else.
    fn resume(&mut self, step: impl FnOnce(&mut Self) -> Step) {
        let flow = step(self);
        let frame = self.frame();
        frame.at = match flow {
            Ok(Flow::Next) => frame.at.saturating_add(1),
            Ok(Flow::To(at)) => at,
            Ok(Flow::Stop) => return,
            Err(fault) => return self.fault(fault),
        };
        frame.wait = Wait::Nothing;
        let at = frame.at;
        self.run_from(at);
    }

    /// Runs operations until one waits or the script ends.
    fn run(&mut self) {
        let at = self.frame().at;
        self.run_from(at);
    }

    fn run_from(&mut self, mut at: Address) {
        let code = self.code;
        let mut left = STEP_LIMIT;
        while left > 0 {
            let shortcut = code.shortcut(at);
            // The sum counts the shortcut, a statement that begins before it, and a jump after it.
            if left >= u32::from(shortcut.count) + 2 {
                if shortcut.statement {
                    if let Flow::Stop = self.statement(at) {
                        return;
                    }
                    (at, left) = (at.saturating_add(1), left - 1);
                }
                match self.shortcut(shortcut, at) {
                    Next::At(Landing { to, count }) => {
                        (at, left) = (to, left - u32::from(count));
                        continue;
                    }
                    Next::Stop => return,
                    Next::Plain => {}
                }
            }
            self.frame().at = at;
            left -= 1;
            at = match self.op().and_then(|op| self.execute(op)) {
                Ok(Flow::Next) => at.saturating_add(1),
                Ok(Flow::To(to)) => to,
                Ok(Flow::Stop) => return,
                Err(fault) => return self.fault(fault),
            };
        }
        self.frame().at = at;
        self.fault(ScriptFault::Runaway);
    }

    /// The running activation waits, so the step ends.
    fn wait(&mut self, wait: Wait) -> Flow {
        self.frame().wait = wait;
        Flow::Stop
    }

    fn op(&mut self) -> Result<&'a Op, ScriptFault> {
        let at = self.frame().at;
        self.program.code.get(usize::from(at)).ok_or(ScriptFault::Malformed)
    }

    /// The name of the running activation's delay: each activation has one such name. The timers of the program have the
    /// names before these.
    fn delay_id(&self) -> TimeId {
        let timers = u8::try_from(self.program.timers.len()).unwrap_or(u8::MAX);
        TimeId(timers.saturating_add(self.script.level))
    }

    fn frame(&mut self) -> &mut Frame {
        &mut self.script.frames[usize::from(self.script.level)]
    }

    fn operands(&mut self) -> Operands<'_> {
        Operands { cells: &mut self.script.operands, len: &mut self.script.held }
    }
}
