//! Tasks that run a script, the protocol's own [`Script`]: the search takes its choices and ends its actions.

use super::CellState;
use super::plan::CellScenario;
use crate::state::Violation;
use imrs_protocol::script::{
    Action, Activity, Address, End, Program, Script, ScriptInput, ScriptOutbox, eval,
};
use imrs_protocol::{CommTask, Contents, PortId, ReplyTo, Request, TaskId};
use std::sync::Arc;

/// An action of a script that has begun.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Running {
    /// The level of the script that waits for it.
    pub level: u8,
    /// The action.
    pub action: u16,
    /// Ticks that it still takes, at least and at most.
    pub least: u32,
    pub most: u32,
}

impl Running {
    /// The `most` of an action that need not end.
    pub const FOREVER: u32 = u32::MAX;
}

/// A script and its running actions.
#[derive(Clone, Debug)]
pub(crate) struct Actor {
    pub program: Arc<Program>,
    pub script: Script,
    pub running: Vec<Running>,
}

impl Actor {
    pub fn new(program: &Arc<Program>) -> Self {
        Self { program: Arc::clone(program), script: Script::new(program), running: Vec::new() }
    }

    pub fn chooses(&self) -> Option<u16> {
        match self.script.activity() {
            Activity::Chooses(alternatives) => Some(alternatives),
            Activity::NotBegun
            | Activity::Waits
            | Activity::Acts
            | Activity::Passive
            | Activity::Ended(_) => None,
        }
    }

    /// Whether the script must step before anything else happens.
    pub fn must_act(&self) -> bool {
        self.chooses().is_some() || self.running.iter().any(|action| action.most == 0)
    }

    /// The action that an level waits for.
    pub fn runs(&self, level: u8) -> Option<&Running> {
        self.running.iter().find(|action| action.level == level)
    }

    pub fn pass(&mut self, ticks: u32) {
        self.pass_for(ticks, |_| true);
    }

    /// The same for the actions of those activations for which `begun` is true.
    pub fn pass_for(&mut self, ticks: u32, begun: impl Fn(u8) -> bool) {
        for action in self.running.iter_mut().filter(|action| begun(action.level)) {
            action.least = action.least.saturating_sub(ticks);
            action.most = action.most.saturating_sub(if action.most == Running::FOREVER { 0 } else { ticks });
        }
    }
}

/// What a script did with one input, for its judge.
#[derive(Clone, Debug)]
pub(crate) struct ScriptReaction {
    pub task: usize,
    /// The operation that the script waited in.
    pub at: Address,
    pub input: ScriptInput,
    /// The statements that it began.
    pub passed: Vec<Address>,
    pub end: Option<End>,
}

/// What a script asks for in one step.
struct Wanted<'a> {
    plan: &'a CellScenario,
    machine: Option<&'a CommTask>,
    requests: Vec<Request>,
    began: Vec<Running>,
    cut: Vec<u8>,
    end: Option<End>,
    passed: Vec<Address>,
}

impl ScriptOutbox for Wanted<'_> {
    fn request(&mut self, request: Request) {
        self.requests.push(request);
    }

    fn run(&mut self, action: Action<'_>) {
        let ticks = |t: imrs_protocol::Ticks| u32::try_from(t.0).unwrap_or(Running::FOREVER);
        let Action { level, least, most, action, .. } = action;
        self.began.push(Running { level, action, least: ticks(least), most: ticks(most) });
    }

    fn cut_short(&mut self, level: u8) {
        self.cut.push(level);
    }

    fn choose(&mut self, _: u16) -> Option<u16> {
        None
    }

    fn ended(&mut self, end: End) {
        // Heartbeats stop when the task has ended (D61).
        if self.machine.is_some_and(|machine| machine.epoch().is_some()) {
            self.requests.push(Request::End);
        }
        self.end = Some(end);
    }

    fn statement(&mut self, at: Address) {
        self.passed.push(at);
    }

    fn fragment(&mut self, index: u8) -> Option<Contents> {
        self.machine?.fragment(index).copied()
    }

    fn published(&mut self) -> Option<Contents> {
        self.machine?.partner_published().copied()
    }

    fn arrival(&mut self, port: PortId, task: TaskId) -> Option<[u8; 8]> {
        let machine = self.machine?;
        let node = self.plan.cell.location(machine.task())?;
        machine.meeting_arguments(&self.plan.table(node), port, task)
    }

    fn owed(&mut self, port: PortId, task: TaskId) -> Option<ReplyTo> {
        self.machine?.owed(port, task)
    }

    fn answer(&mut self, port: PortId, task: Option<TaskId>, index: u8) -> Option<Contents> {
        let machine = self.machine?;
        let answer = |task| machine.answer_fragment(port, task, index).copied();
        match task {
            Some(task) => answer(task),
            None => self.plan.cell.port(port)?.peers(machine.task()).find_map(answer),
        }
    }
}

impl CellState {
    /// Queues an input for a task's script; false if the task has none.
    pub(crate) fn leave(&mut self, task: usize, input: ScriptInput) -> bool {
        let scripted = self.bodies[task].actor.is_some();
        if scripted {
            self.inputs.push_back((task, input));
        }
        scripted
    }

    /// Runs scripts until all of them wait. A running script goes on first: nothing comes between its steps.
    pub(crate) fn run_scripts(&mut self) -> Result<(), Violation> {
        let mut last = None;
        for _ in 0..super::FUSED {
            let own = self.inputs.iter().position(|&(task, _)| Some(task) == last);
            let Some((task, input)) = self.inputs.remove(own.unwrap_or(0)) else { return Ok(()) };
            self.run_script(task, input)?;
            last = Some(task);
        }
        Err(Violation::Zeno)
    }

    fn run_script(&mut self, task: usize, input: ScriptInput) -> Result<(), Violation> {
        let node_state = self.node_state_of(task);
        let machine = self.nodes[node_state].node.task(TaskId::from_index(task));
        let Some(actor) = &mut self.bodies[task].actor else { return Ok(()) };
        let plan = &self.plan;
        let mut wanted = Wanted {
            plan,
            machine,
            requests: Vec::new(),
            began: Vec::new(),
            cut: Vec::new(),
            end: None,
            passed: Vec::new(),
        };
        let at = actor.script.position();
        actor.script.step(&actor.program, input, &mut wanted);
        actor.running.retain(|action| !wanted.cut.contains(&action.level));
        actor.running.extend(&wanted.began);
        actor.running.sort_unstable_by_key(|action| action.level);
        if let Some(turns) = &mut self.turns {
            turns.push(ScriptReaction { task, at, input, passed: wanted.passed, end: wanted.end });
        } else if matches!(wanted.end, Some(End::Fault { .. } | End::Assertion(_))) {
            return Err(Violation::Script);
        }
        let requests = wanted.requests;
        requests.into_iter().try_for_each(|request| self.ask(task, request))
    }

    /// Whether the plan's checks hold.
    pub(super) fn judge_checks(&self) -> Result<(), Violation> {
        for terms in &self.plan.checks {
            match eval(terms, |term| self.look_up(term)) {
                Ok(0) => return Err(Violation::Check),
                Ok(_) => {}
                Err(_) => return Err(Violation::Script),
            }
        }
        Ok(())
    }

    /// Ends the action of an level, and queues its result for the script.
    pub(crate) fn acted(&mut self, task: usize, level: u8, ok: bool, value: i32) {
        if let Some(actor) = &mut self.bodies[task].actor {
            actor.running.retain(|action| action.level != level);
        }
        self.leave(task, ScriptInput::Acted { level, ok, value });
    }
}
