//! Runs a script beside its communication task: the one loop of all drivers.

use super::code::{Act, get_after};
use super::{Address, Code, End, HOST_LIMIT, Op, Program, Requests, Script, ScriptFault, ScriptInput, Wait};
use crate::ids::{PortId, TaskId};
use crate::packet::Contents;
use crate::request::{Call, ReplyTo, Request, Signal};
use crate::table::NodeTable;
use crate::task::CommTask;
use crate::ticks::Ticks;
use alloc::collections::VecDeque;
use alloc::sync::Arc;

/// How many later inputs fit without an allocation, besides the next input.
const ROOM: usize = 16;

/// A script, the inputs that it has not taken, and the requests that its driver has not passed on.
///
/// The driver gives each input with [`tell`](Self::tell). Then it passes each request that [`next`](Self::next) returns to the
/// communication task, and tells the script the answers, until `next` returns `None`: the script waits. If the input came from
/// outside the node, the driver calls [`count_anew`](Self::count_anew) first.
#[derive(Clone, Debug)]
pub struct ScriptHost {
    /// The program of the script.
    pub program: Arc<Program>,
    code: Arc<Code>,
    /// The state of the script.
    pub script: Script,
    /// The next input. It has a place of its own, because most scripts have at most one input.
    input: Option<ScriptInput>,
    /// The inputs after the next one.
    later: VecDeque<ScriptInput>,
    /// What the script asked in its last step. Its next step begins only when all these requests are passed on.
    requests: Requests,
    /// Steps since the last input from outside, or the last message.
    steps: u32,
    stopped: bool,
}

impl ScriptHost {
    /// The script of a task that has not begun.
    #[must_use]
    pub fn new(program: Arc<Program>) -> Self {
        Self {
            script: Script::new(&program),
            code: Arc::new(Code::new(&program)),
            program,
            input: None,
            later: VecDeque::with_capacity(ROOM),
            requests: Requests::default(),
            steps: 0,
            stopped: false,
        }
    }

    /// Queues an input, which the script takes after all earlier ones.
    #[inline]
    pub fn tell(&mut self, input: ScriptInput) {
        if self.stopped {
            return;
        }
        if self.input.is_none() {
            self.input = Some(input);
        } else {
            self.later.push_back(input);
        }
    }

    /// Whether the script has an input that it has not taken.
    #[must_use]
    pub const fn has_input(&self) -> bool {
        self.input.is_some()
    }

    /// Restarts the count of steps, because input comes from outside the node.
    pub const fn count_anew(&mut self) {
        self.steps = 0;
    }

    /// Assumes that the REPLY that [`next`](Self::next) returned last is accepted: the GET that the script then makes. A driver
    /// may make both at once (D200), and then calls [`made`](Self::made). `None` if another operation comes first, or the script
    /// is near its limit of steps. The driver's outbox gets neither the acceptance, nor the GET, nor the statements in between,
    /// which [`statements_before_get`](Self::statements_before_get) gives.
    #[must_use]
    #[inline]
    pub fn get_after_reply(&self) -> Option<(Address, Request)> {
        if self.steps >= HOST_LIMIT || self.input.is_some() || self.stopped {
            return None;
        }
        self.script.get_after_reply(&self.program, &self.code)
    }

    /// Passes to `begins` each statement between the REPLY and the GET of [`get_after_reply`](Self::get_after_reply).
    pub fn statements_before_get(&self, begins: impl FnMut(Address)) {
        if let Some(frame) = self.script.top() {
            get_after(&self.program, frame.at.saturating_add(1), begins);
        }
    }

    /// Notes that the REPLY was accepted, and that the driver has made the GET at this address.
    #[inline]
    pub fn made(&mut self, at: Address) {
        self.steps += 1;
        self.script.waits_in_get(at);
    }

    /// The next request for the communication task. Runs the script until it has one; `None` if it waits instead.
    pub fn next(&mut self, out: &mut impl ScriptOutbox) -> Option<Request> {
        loop {
            if let Some(request) = self.requests.pop() {
                return Some(request);
            }
            self.step(out)?;
        }
    }

    /// The script takes the next input, if there is one.
    #[inline]
    fn step(&mut self, out: &mut impl ScriptOutbox) -> Option<()> {
        let input = self.input.as_ref()?;
        let is_message =
            matches!(input, ScriptInput::Signal(Signal::Message(_) | Signal::Interrupt(Call::Message(_))));
        self.steps = if is_message { 0 } else { self.steps.saturating_add(1) };
        let may_go_on = out.takes(self.script.position(), input);
        if self.steps > HOST_LIMIT || !may_go_on {
            self.script.stop(&self.program, ScriptFault::Runaway, &mut self.requests, out);
        } else {
            self.script.step(&self.program, &self.code, input, &mut self.requests, out);
        }
        self.input = None;
        if !self.later.is_empty() {
            self.input = self.later.pop_front();
        }
        Some(())
    }

    /// The node stops: the script takes no input any more.
    pub fn stop(&mut self) {
        self.stopped = true;
        self.clear();
    }

    /// Whether the node has stopped.
    #[must_use]
    pub const fn is_stopped(&self) -> bool {
        self.stopped
    }

    /// Drops all inputs and requests, for a driver that abandons a run.
    pub fn clear(&mut self) {
        self.input = None;
        self.later.clear();
        self.requests = Requests::default();
    }
}

impl Script {
    /// Assumes that the REPLY whose answer the script awaits is accepted: the address of the script's next GET, and its request.
    /// `None` if the script comes to another operation first, apart from jumps and beginnings of statements (D200).
    #[must_use]
    #[inline]
    pub fn get_after_reply(&self, program: &Program, code: &Code) -> Option<(Address, Request)> {
        let frame = self.top().filter(|frame| matches!(frame.wait, Wait::Signal))?;
        let Some(Op::Reply { .. }) = program.code.get(usize::from(frame.at)) else { return None };
        let shortcut = code.shortcut(frame.at);
        let Act::Send(_) = shortcut.act else { return None };
        let at = shortcut.next.to;
        match *program.code.get(usize::from(at))? {
            Op::Get { port, source, time_out } => Some((at, Request::Get { port, source, time_out })),
            _ => None,
        }
    }

    /// Notes that the REPLY was accepted and that the driver has made the GET at this address, in which the script now waits.
    #[inline]
    pub fn waits_in_get(&mut self, at: Address) {
        if let Some(frame) = self.frames.get_mut(usize::from(self.level)) {
            frame.at = at;
        }
    }
}

/// An action outside: of a robot's driver, of a PLC, or simulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Action<'a> {
    /// The activation that waits for this action: 0 is the task's own thread, each nested handler has the next number. A
    /// handler may run an action while the action of the interrupted activation continues.
    pub level: u8,
    /// The number of the action, a position in [`Program::actions`].
    pub action: u16,
    /// The arguments of the action.
    pub arguments: &'a [i64],
    /// The shortest duration of the action.
    pub least: Ticks,
    /// The longest duration of the action.
    pub most: Ticks,
}

/// Where the effects of a script go, and the communication task that it reads.
pub trait ScriptOutbox {
    /// Begins an action; [`ScriptInput::Acted`] ends it.
    fn run(&mut self, action: Action<'_>);
    /// Stops the action of this activation: the task must not act any more (D61). No [`ScriptInput::Acted`] follows.
    fn cut_short(&mut self, level: u8);
    /// Chooses a number below `alternatives` at once, or `None` to give it later with [`ScriptInput::Chosen`].
    fn choose(&mut self, alternatives: u16) -> Option<u16>;
    /// The script has ended: it takes no input any more.
    fn ended(&mut self, end: End);
    /// The script's communication task, on a node with this table. Without it the script reads nothing but signals.
    fn communication(&self) -> Option<(&CommTask, &NodeTable)>;
    /// Called before the script, which waits in the operation `at`, takes an input. Returning false ends the script as a
    /// runaway: the scripts of the node have taken too many steps together.
    fn takes(&mut self, at: Address, input: &ScriptInput) -> bool {
        let _ = (at, input);
        true
    }
    /// The script makes a request of its communication task.
    fn asked(&mut self, request: &Request) {
        let _ = request;
    }
    /// A statement begins.
    fn statement(&mut self, at: Address) {
        let _ = at;
    }
    /// An activation drops a class-2 message that it never answered: the sender will see a time_out.
    fn unanswered(&mut self, message: ReplyTo) {
        let _ = message;
    }
    /// A fragment, counted from 1, of the message received last (D28).
    fn fragment(&self, index: u8) -> Option<Contents> {
        self.communication()?.0.fragment(index).copied()
    }
    /// A fragment, counted from 0, of the answer of `task` to the last request on `port`. `None` stands for the only task
    /// asked.
    fn answer(&self, port: PortId, task: Option<TaskId>, index: u8) -> Option<Contents> {
        let (machine, table) = self.communication()?;
        let answer = |task| machine.answer_fragment(port, task, index).copied();
        task.map_or_else(|| table.port(port)?.peers(machine.task()).find_map(answer), answer)
    }
}
