//! Tasks that run a script, the protocol's own [`Script`]: the search makes its choices and ends its actions.

use super::CellState;
use crate::state::Violation;
use imrs_protocol::script::{
    Action, Activity, Address, End, Program, ScriptHost, ScriptInput, ScriptOutbox, eval,
};
use imrs_protocol::{CommTask, NodeTable, Request, TaskId, Ticks};
use std::sync::Arc;

/// An action of a script that has begun.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Running {
    /// The activation that waits for the action: 0 is the task's own thread, a handler has its depth.
    pub level: u8,
    /// The number of the action in the program.
    pub action: u16,
    /// How long the action still takes, at least and at most.
    pub least: Ticks,
    pub most: Ticks,
}

impl Running {
    /// The value of `most` for an action that need not end.
    pub const FOREVER: Ticks = Ticks::FAR;

    /// A duration of the program in the form in which the checker counts it. A duration that a packed state cannot hold
    /// counts as endless.
    pub fn length(ticks: Ticks) -> Ticks {
        if ticks.0 < u64::from(u32::MAX) { ticks } else { Self::FOREVER }
    }
}

/// A script and its running actions, ascending by the level of their activations.
#[derive(Clone, Debug)]
pub(crate) struct Actor {
    pub host: ScriptHost,
    pub running: Vec<Running>,
}

impl Actor {
    pub fn new(program: &Arc<Program>) -> Self {
        Self { host: ScriptHost::new(Arc::clone(program)), running: Vec::new() }
    }

    pub fn chooses(&self) -> Option<u16> {
        match self.host.script.activity() {
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
        self.chooses().is_some() || self.running.iter().any(|action| action.most.is_zero())
    }

    /// The action for which the activation at this level waits.
    pub fn runs(&self, level: u8) -> Option<&Running> {
        self.running.iter().find(|action| action.level == level)
    }

    pub fn pass(&mut self, ticks: Ticks) {
        self.pass_for(ticks, |_| true);
    }

    /// As [`pass`](Self::pass), but only for the actions of those activations for which `begun` is true.
    pub fn pass_for(&mut self, ticks: Ticks, begun: impl Fn(u8) -> bool) {
        for action in self.running.iter_mut().filter(|action| begun(action.level)) {
            action.least = action.least - ticks;
            action.most = action.most - ticks;
        }
    }
}

/// The reaction of a script to one input, for the judge of the cell.
#[derive(Clone, Debug)]
pub(crate) struct ScriptReaction {
    pub task: usize,
    /// The operation in which the script waited.
    pub at: Address,
    pub input: ScriptInput,
    /// The statements that the script began.
    pub passed: Vec<Address>,
    pub end: Option<End>,
}

/// The outbox of a script: where its effects go.
struct Wanted<'a> {
    task: usize,
    machine: Option<(&'a CommTask, &'a NodeTable)>,
    running: &'a mut Vec<Running>,
    turns: Option<&'a mut Vec<ScriptReaction>>,
    steps: &'a mut usize,
    failed: bool,
}

impl Wanted<'_> {
    /// The record of the script's reaction to its present input.
    fn turn(&mut self) -> Option<&mut ScriptReaction> {
        self.turns.as_mut()?.last_mut()
    }
}

impl ScriptOutbox for Wanted<'_> {
    fn run(&mut self, action: Action<'_>) {
        let Action { level, least, most, action, .. } = action;
        let at = self.running.partition_point(|running| running.level <= level);
        self.running.insert(
            at,
            Running { level, action, least: Running::length(least), most: Running::length(most) },
        );
    }

    fn cut_short(&mut self, level: u8) {
        self.running.retain(|action| action.level != level);
    }

    fn choose(&mut self, _: u16) -> Option<u16> {
        None
    }

    fn ended(&mut self, end: End) {
        self.failed |= matches!(end, End::Fault { .. } | End::Assertion(_));
        if let Some(turn) = self.turn() {
            turn.end = Some(end);
        }
    }

    fn communication(&self) -> Option<(&CommTask, &NodeTable)> {
        self.machine
    }

    fn takes(&mut self, at: Address, input: &ScriptInput) -> bool {
        *self.steps += 1;
        if let Some(turns) = &mut self.turns {
            turns.push(ScriptReaction { task: self.task, at, input: *input, passed: Vec::new(), end: None });
        }
        true
    }

    fn statement(&mut self, at: Address) {
        if let Some(turn) = self.turn() {
            turn.passed.push(at);
        }
    }
}

impl CellState {
    /// Gives an input to a task's script. Returns false if the task has no script.
    pub(crate) fn leave(&mut self, task: usize, input: ScriptInput) -> bool {
        let Some(actor) = &mut self.bodies[task].actor else { return false };
        actor.host.tell(input);
        self.ready.push_back(task);
        true
    }

    /// Runs scripts until all of them wait, one after another, in the order in which each got its first input.
    pub(crate) fn run_scripts(&mut self) -> Result<(), Violation> {
        let mut steps = 0;
        while let Some(task) = self.ready.pop_front() {
            while let Some(request) = self.next_request(task, &mut steps)? {
                self.ask(task, request)?;
            }
            self.ready.retain(|&other| other != task);
        }
        Ok(())
    }

    /// The next request of a task's script. A script that never waits becomes a finding: it makes too many steps.
    fn next_request(&mut self, task: usize, steps: &mut usize) -> Result<Option<Request>, Violation> {
        let node_state = &self.nodes[self.node_state_of(task)];
        let machine = node_state.node.task(TaskId::from_index(task)).map(|task| (task, &node_state.table));
        let Some(Actor { host, running }) = &mut self.bodies[task].actor else { return Ok(None) };
        let turns = self.turns.as_mut();
        let judges = turns.is_none();
        let mut wanted = Wanted { task, machine, running, turns, steps, failed: false };
        host.count_anew();
        let request = host.next(&mut wanted);
        if wanted.failed && judges {
            return Err(Violation::Script);
        }
        if *steps >= super::FUSED { Err(Violation::Zeno) } else { Ok(request) }
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

    /// Ends the action of the activation at this level, and queues its result for the script.
    pub(crate) fn acted(&mut self, task: usize, level: u8, ok: bool, value: i32) {
        if let Some(actor) = &mut self.bodies[task].actor {
            actor.running.retain(|action| action.level != level);
        }
        self.leave(task, ScriptInput::Acted { level, ok, value });
    }
}
