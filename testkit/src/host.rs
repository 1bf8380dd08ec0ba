//! A node with the scripts of its tasks, for drivers that run everything in one thread (D38, D45, D91).

use imrs_protocol::script::{
    Action, Activity, Address, End, HOST_LIMIT, Program, ProgramError, Script, ScriptFault, ScriptInput,
    ScriptOutbox,
};
use imrs_protocol::{
    Call, Contents, Instant, Node, NodeId, NodeInput, NodeOutbox, Observation, Packet, PortId, ReplyTo,
    Request, Signal, TaskId,
};
use std::collections::VecDeque;
use std::sync::Arc;

/// An input of a node with scripts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HostInput {
    /// All scripts that have not begun begin, in the order of their tasks.
    Begin,
    /// An input of the node itself, or a request of a task that has no script.
    Node(NodeInput),
    /// An action has ended.
    Acted {
        /// The task that ran it.
        task: TaskId,
        /// The activation that ran it, as [`Action::level`] said.
        level: u8,
        /// Whether it succeeded.
        ok: bool,
        /// Its result.
        value: i32,
    },
    /// The driver chose.
    Chosen {
        /// The task that chose.
        task: TaskId,
        /// The chosen alternative.
        choice: u16,
    },
}

impl From<NodeInput> for HostInput {
    fn from(input: NodeInput) -> Self {
        Self::Node(input)
    }
}

/// Where the effects of a node with scripts go. [`NodeOutbox::signal`] gets the signals of tasks without a script only.
pub trait HostOutbox: NodeOutbox {
    /// Begins an action; [`HostInput::Acted`] ends it.
    fn run(&mut self, task: TaskId, action: Action<'_>);
    /// Stops the action of an activation. No [`HostInput::Acted`] follows.
    fn cut_short(&mut self, task: TaskId, level: u8);
    /// Chooses a number below `alternatives` at once, or `None` to give it later with [`HostInput::Chosen`].
    fn choose(&mut self, task: TaskId, alternatives: u16) -> Option<u16>;
    /// A script has ended.
    fn ended(&mut self, task: TaskId, end: End);
    /// A script asks its communication task.
    fn asked(&mut self, task: TaskId, request: &Request) {
        let _ = (task, request);
    }
    /// The communication task answers a script.
    fn answered(&mut self, task: TaskId, signal: &Signal) {
        let _ = (task, signal);
    }
    /// A statement of a script begins.
    fn statement(&mut self, task: TaskId, at: Address) {
        let _ = (task, at);
    }
    /// A script drops a class-2 message that it never answered.
    fn unanswered(&mut self, task: TaskId, message: ReplyTo) {
        let _ = (task, message);
    }
}

/// A script and its program.
#[derive(Clone, Debug)]
pub struct Hosted {
    /// The task.
    pub task: TaskId,
    /// Its program.
    pub program: Arc<Program>,
    /// Its state.
    pub script: Script,
}

/// A node with the scripts of its tasks.
#[derive(Clone, Debug)]
pub struct ScriptedNode {
    /// The node.
    pub node: Node,
    /// The scripts, ascending by task.
    pub scripts: Box<[Hosted]>,
    /// Inputs that the scripts have not taken yet. Empty between steps.
    inputs: VecDeque<(TaskId, ScriptInput)>,
    /// The requests that a script made in its last step.
    requests: VecDeque<Request>,
    /// How many steps each script took for the current input since it last received a message.
    steps: Box<[u32]>,
}

/// Preallocated room for the signals of one input.
const SIGNALS: usize = 256;

impl ScriptedNode {
    /// The node with these scripts, each for a task that runs there.
    ///
    /// # Errors
    /// The task and what is wrong with its program.
    pub fn new(
        node: Node,
        programs: impl IntoIterator<Item = (TaskId, Arc<Program>)>,
    ) -> Result<Self, (TaskId, ProgramError)> {
        let mut scripts = Vec::new();
        for (task, program) in programs {
            program.check().map_err(|fault| (task, fault))?;
            scripts.push(Hosted { task, script: Script::new(&program), program });
        }
        scripts.sort_unstable_by_key(|hosted| hosted.task);
        let inputs = VecDeque::with_capacity(SIGNALS.max(scripts.len()));
        let steps = vec![0; scripts.len()].into();
        Ok(Self { node, scripts: scripts.into(), inputs, requests: VecDeque::with_capacity(8), steps })
    }

    /// Takes one input at `now` and runs the node and its scripts until every script waits. What is due by `now` happens
    /// first.
    pub fn step(&mut self, now: Instant, input: impl Into<HostInput>, out: &mut impl HostOutbox) {
        let input = input.into();
        // A node without scripts does this itself.
        if now > self.node.now() && !self.scripts.is_empty() && input != HostInput::Node(NodeInput::Time) {
            self.go_on(now, HostInput::Node(NodeInput::Time), out);
        }
        self.go_on(now, input, out);
    }

    fn go_on(&mut self, now: Instant, input: HostInput, out: &mut impl HostOutbox) {
        match input {
            HostInput::Begin => {
                self.inputs.extend(self.scripts.iter().map(|hosted| (hosted.task, ScriptInput::Begin)));
            }
            HostInput::Node(input) => self.drive(now, input, out),
            HostInput::Acted { task, level, ok, value } => {
                self.inputs.push_back((task, ScriptInput::Acted { level, ok, value }));
            }
            HostInput::Chosen { task, choice } => self.inputs.push_back((task, ScriptInput::Chosen(choice))),
        }
        self.steps.fill(0);
        let together = HOST_LIMIT.saturating_mul(u32::try_from(self.scripts.len()).unwrap_or(u32::MAX));
        let (mut last, mut steps) = (None, 0);
        while let Some((task, input)) = self.next(last) {
            let Ok(at) = self.scripts.binary_search_by_key(&task, |hosted| hosted.task) else { continue };
            steps += 1;
            if steps > together && self.stop_busiest(out) {
                steps = 0;
            }
            self.run(at, input, out);
            last = Some(task);
        }
    }

    /// The next input of the script that ran last, so that nothing comes between its steps; otherwise the first in the queue.
    fn next(&mut self, last: Option<TaskId>) -> Option<(TaskId, ScriptInput)> {
        let own = self.inputs.iter().position(|&(task, _)| Some(task) == last);
        self.inputs.remove(own.unwrap_or(0))
    }

    fn run(&mut self, at: usize, input: ScriptInput, out: &mut impl HostOutbox) {
        let asked =
            matches!(input, ScriptInput::Signal(Signal::Message(_) | Signal::Interrupt(Call::Message(_))));
        self.steps[at] = if asked { 0 } else { self.steps[at] + 1 };
        if self.steps[at] > HOST_LIMIT {
            return self.stop(at, out);
        }
        let Hosted { task, program, script } = &mut self.scripts[at];
        let (task, node, requests) = (*task, &self.node, &mut self.requests);
        script.step(program, input, &mut ScriptEffects { task, node, requests, out });
        self.ask(task, out);
    }

    /// Ends the script with the most steps since its last message; false if all have ended.
    fn stop_busiest(&mut self, out: &mut impl HostOutbox) -> bool {
        let incarnations = |hosted: &Hosted| !matches!(hosted.script.activity(), Activity::Ended(_));
        let living = (0..self.scripts.len()).filter(|&at| incarnations(&self.scripts[at]));
        let Some(busiest) = living.max_by_key(|&at| self.steps[at]) else { return false };
        self.stop(busiest, out);
        true
    }

    fn stop(&mut self, at: usize, out: &mut impl HostOutbox) {
        let Hosted { task, program, script } = &mut self.scripts[at];
        let (task, node, requests) = (*task, &self.node, &mut self.requests);
        script.stop(program, ScriptFault::Runaway, &mut ScriptEffects { task, node, requests, out });
        self.ask(task, out);
    }

    fn ask(&mut self, task: TaskId, out: &mut impl HostOutbox) {
        while let Some(request) = self.requests.pop_front() {
            out.asked(task, &request);
            self.drive(self.node.now(), NodeInput::Request(task, request), out);
        }
    }

    fn drive(&mut self, now: Instant, input: NodeInput, out: &mut impl HostOutbox) {
        let effects = &mut NodeEffects { scripts: &self.scripts, inputs: &mut self.inputs, out };
        self.node.step(now, input, effects);
    }
}

struct ScriptEffects<'a, O> {
    task: TaskId,
    node: &'a Node,
    requests: &'a mut VecDeque<Request>,
    out: &'a mut O,
}

impl<O: HostOutbox> ScriptOutbox for ScriptEffects<'_, O> {
    fn request(&mut self, request: Request) {
        self.requests.push_back(request);
    }

    fn run(&mut self, action: Action<'_>) {
        self.out.run(self.task, action);
    }

    fn cut_short(&mut self, level: u8) {
        self.out.cut_short(self.task, level);
    }

    fn choose(&mut self, alternatives: u16) -> Option<u16> {
        self.out.choose(self.task, alternatives)
    }

    fn ended(&mut self, end: End) {
        // The heartbeats of a task stop when it has ended (D61).
        if self.node.task(self.task).is_some_and(|task| task.epoch().is_some()) {
            self.requests.push_back(Request::End);
        }
        self.out.ended(self.task, end);
    }

    fn statement(&mut self, at: Address) {
        self.out.statement(self.task, at);
    }

    fn unanswered(&mut self, message: ReplyTo) {
        self.out.unanswered(self.task, message);
    }

    fn fragment(&mut self, index: u8) -> Option<Contents> {
        self.node.task(self.task)?.fragment(index).copied()
    }

    fn published(&mut self) -> Option<Contents> {
        self.node.task(self.task)?.partner_published().copied()
    }

    fn arrival(&mut self, port: PortId, task: TaskId) -> Option<[u8; 8]> {
        self.node.task(self.task)?.meeting_arguments(&self.node.parts().table, port, task)
    }

    fn owed(&mut self, port: PortId, task: TaskId) -> Option<ReplyTo> {
        self.node.task(self.task)?.owed(port, task)
    }

    fn answer(&mut self, port: PortId, task: Option<TaskId>, index: u8) -> Option<Contents> {
        let communication = self.node.task(self.task)?;
        match task {
            Some(task) => communication.answer_fragment(port, task, index).copied(),
            None => {
                let mut peers = self.node.parts().table.port(port)?.peers(self.task);
                peers.find_map(|peer| communication.answer_fragment(port, peer, index).copied())
            }
        }
    }
}

struct NodeEffects<'a, O> {
    scripts: &'a [Hosted],
    inputs: &'a mut VecDeque<(TaskId, ScriptInput)>,
    out: &'a mut O,
}

impl<O: HostOutbox> NodeOutbox for NodeEffects<'_, O> {
    fn ready(&mut self, next: NodeId) -> bool {
        self.out.ready(next)
    }

    fn link(&mut self, next: NodeId, packet: Packet) {
        self.out.link(next, packet);
    }

    fn signal(&mut self, task: TaskId, signal: Signal) {
        if self.scripts.binary_search_by_key(&task, |hosted| hosted.task).is_err() {
            return self.out.signal(task, signal);
        }
        self.out.answered(task, &signal);
        self.inputs.push_back((task, ScriptInput::Signal(signal)));
    }

    fn observe(&mut self, at: Option<TaskId>, observation: Observation) {
        self.out.observe(at, observation);
    }
}
