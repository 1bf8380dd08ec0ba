//! A node with the scripts of its tasks, for drivers that run everything in one thread (D38, D45, D91).

use imrs_protocol::script::{
    Action, Address, End, HOST_LIMIT, Program, ProgramError, ScriptHost, ScriptInput, ScriptOutbox,
};
use imrs_protocol::{
    CommTask, Instant, Node, NodeId, NodeInput, NodeOutbox, NodeTable, Observation, Packet, ReplyTo, Request,
    Signal, TaskId,
};
use std::collections::VecDeque;
use std::sync::Arc;

/// An input of a node with scripts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HostInput {
    /// All scripts that have not begun begin, in the order of their tasks.
    Begin,
    /// An input of the node itself, or a request of a task without a script.
    Node(NodeInput),
    /// An action has ended.
    Acted {
        /// The task that ran the action.
        task: TaskId,
        /// The activation that ran the action, as [`Action::level`] said.
        level: u8,
        /// Whether the action succeeded.
        ok: bool,
        /// The action's result.
        value: i32,
    },
    /// The driver makes a choice for a script.
    Chosen {
        /// The task whose script waits for the choice.
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

/// The receiver of the effects of a node with scripts. [`NodeOutbox::signal`] gets only the signals of tasks without a
/// script.
pub trait HostOutbox: NodeOutbox {
    /// Begins an action. The driver reports its end with [`HostInput::Acted`].
    fn run(&mut self, task: TaskId, action: Action<'_>);
    /// Stops the action of an activation. No [`HostInput::Acted`] follows.
    fn cut_short(&mut self, task: TaskId, level: u8);
    /// Chooses a number below `alternatives` at once, or returns `None` to give it later with [`HostInput::Chosen`].
    fn choose(&mut self, task: TaskId, alternatives: u16) -> Option<u16>;
    /// Tells the driver that a script has ended.
    fn ended(&mut self, task: TaskId, end: End);
    /// Tells the driver that a script makes this request of its communication task.
    fn asked(&mut self, task: TaskId, request: &Request) {
        let _ = (task, request);
    }
    /// Tells the driver that a communication task gives this answer to the script of its task.
    fn answered(&mut self, task: TaskId, signal: &Signal) {
        let _ = (task, signal);
    }
    /// Tells the driver that a statement of a script begins.
    fn statement(&mut self, task: TaskId, at: Address) {
        let _ = (task, at);
    }
    /// Tells the driver that a script drops a class-2 message that it never answered.
    fn unanswered(&mut self, task: TaskId, message: ReplyTo) {
        let _ = (task, message);
    }
}

/// A script, and the task to which it belongs.
#[derive(Clone, Debug)]
pub struct Hosted {
    /// The task to which the script belongs.
    pub task: TaskId,
    /// The script, and the machine that runs it.
    pub host: ScriptHost,
}

/// A node with the scripts of its tasks.
#[derive(Clone, Debug)]
pub struct ScriptedNode {
    /// The state machine of the node.
    pub node: Node,
    /// The scripts, ascending by task.
    pub scripts: Box<[Hosted]>,
    /// The scripts that have inputs, in the order of their first inputs. Empty between steps.
    ready: VecDeque<usize>,
}

/// Preallocated room for the signals of one input.
const SIGNALS: usize = 256;

impl ScriptedNode {
    /// A node with these scripts, each for a task that runs on it.
    ///
    /// # Errors
    /// The task, and what is wrong with its program.
    pub fn new(
        node: Node,
        programs: impl IntoIterator<Item = (TaskId, Arc<Program>)>,
    ) -> Result<Self, (TaskId, ProgramError)> {
        let mut scripts = Vec::new();
        for (task, program) in programs {
            program.check().map_err(|fault| (task, fault))?;
            scripts.push(Hosted { task, host: ScriptHost::new(program) });
        }
        scripts.sort_unstable_by_key(|hosted| hosted.task);
        let ready = VecDeque::with_capacity(SIGNALS.max(scripts.len()));
        Ok(Self { node, scripts: scripts.into(), ready })
    }

    /// Takes one input at `now` and runs the node and its scripts until every script waits. Everything that is due by `now`
    /// happens first.
    pub fn step(&mut self, now: Instant, input: impl Into<HostInput>, out: &mut impl HostOutbox) {
        let input = input.into();
        // A node without scripts lets time pass within the step of the input.
        if now > self.node.now() && !self.scripts.is_empty() && input != HostInput::Node(NodeInput::Time) {
            self.go_on(now, HostInput::Node(NodeInput::Time), out);
        }
        self.go_on(now, input, out);
    }

    fn go_on(&mut self, now: Instant, input: HostInput, out: &mut impl HostOutbox) {
        self.scripts.iter_mut().for_each(|hosted| hosted.host.count_anew());
        match input {
            HostInput::Begin => {
                let tasks: Vec<_> = self.scripts.iter().map(|hosted| hosted.task).collect();
                tasks.into_iter().for_each(|task| self.tell(task, ScriptInput::Begin));
            }
            HostInput::Node(input) => self.drive(now, input, out),
            HostInput::Acted { task, level, ok, value } => {
                self.tell(task, ScriptInput::Acted { level, ok, value });
            }
            HostInput::Chosen { task, choice } => self.tell(task, ScriptInput::Chosen(choice)),
        }
        let mut steps = 0;
        while let Some(at) = self.ready.pop_front() {
            let task = self.scripts[at].task;
            loop {
                let together = self.scripts.len();
                let effects = &mut ScriptEffects {
                    task,
                    node: &self.node,
                    steps: &mut steps,
                    together,
                    out: &mut *out,
                };
                let Some(request) = self.scripts[at].host.next(effects) else { break };
                self.drive(self.node.now(), NodeInput::Request(task, request), out);
            }
            self.ready.retain(|&other| other != at);
        }
    }

    fn tell(&mut self, task: TaskId, input: ScriptInput) {
        tell(&mut self.scripts, &mut self.ready, task, input);
    }

    fn drive(&mut self, now: Instant, input: NodeInput, out: &mut impl HostOutbox) {
        let effects = &mut NodeEffects { scripts: &mut self.scripts, ready: &mut self.ready, out };
        self.node.step(now, input, effects);
    }
}

/// Gives a task's script an input. Returns false if the task has no script.
fn tell(scripts: &mut [Hosted], ready: &mut VecDeque<usize>, task: TaskId, input: ScriptInput) -> bool {
    let Ok(at) = scripts.binary_search_by_key(&task, |hosted| hosted.task) else { return false };
    scripts[at].host.tell(input);
    ready.push_back(at);
    true
}

struct ScriptEffects<'a, O> {
    task: TaskId,
    node: &'a Node,
    /// How many steps the scripts of the node have taken together, and how many scripts there are.
    steps: &'a mut usize,
    together: usize,
    out: &'a mut O,
}

impl<O: HostOutbox> ScriptOutbox for ScriptEffects<'_, O> {
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
        self.out.ended(self.task, end);
    }

    fn communication(&self) -> Option<(&CommTask, &NodeTable)> {
        Some((self.node.task(self.task)?, &self.node.parts().table))
    }

    fn takes(&mut self, _: Address, _: &ScriptInput) -> bool {
        *self.steps += 1;
        let may = *self.steps <= HOST_LIMIT as usize * self.together;
        if !may {
            *self.steps = 0;
        }
        may
    }

    fn asked(&mut self, request: &Request) {
        self.out.asked(self.task, request);
    }

    fn statement(&mut self, at: Address) {
        self.out.statement(self.task, at);
    }

    fn unanswered(&mut self, message: ReplyTo) {
        self.out.unanswered(self.task, message);
    }
}

struct NodeEffects<'a, O> {
    scripts: &'a mut [Hosted],
    ready: &'a mut VecDeque<usize>,
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
        if tell(self.scripts, self.ready, task, ScriptInput::Signal(signal)) {
            self.out.answered(task, &signal);
        } else {
            self.out.signal(task, signal);
        }
    }

    fn observe(&mut self, at: Option<TaskId>, observation: Observation) {
        self.out.observe(at, observation);
    }
}
