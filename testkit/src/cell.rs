//! A cell of nodes in virtual time: every packet takes the bound of its link, every action its shortest duration. Every step
//! checks the invariants.

mod tables;

use crate::host::{HostInput, HostOutbox, ScriptedNode};
use crate::words;
use imrs_protocol::script::{Action, Activity, Address, End, Program};
use imrs_protocol::*;
use std::sync::Arc;

/// A packet that is on a link.
struct Flight {
    due: u64,
    from: NodeId,
    to: NodeId,
    packet: Packet,
    charge: Ticks,
}

/// An action that a script has begun.
struct Running {
    due: u64,
    task: TaskId,
    level: u8,
    name: String,
}

/// Decides for each packet that leaves a node whether it is lost.
type Loss = Box<dyn FnMut(NodeId, NodeId, &Packet) -> bool>;

/// Everything outside of the nodes: the links, the actions, and a record of what the nodes did.
struct Outside {
    table: Arc<CellTable>,
    programs: Vec<(TaskId, Arc<Program>)>,
    now: u64,
    /// The node that is taking the current input.
    from: NodeId,
    loss: Loss,
    busy: Vec<NodeId>,
    flying: Vec<Flight>,
    running: Vec<Running>,
    choice: Option<u16>,
    transcript: Vec<String>,
    signals: Vec<(TaskId, Signal)>,
    observations: Vec<(Option<TaskId>, Observation)>,
    log: Vec<String>,
    requests: usize,
    statements: usize,
    unanswered: usize,
}

impl Outside {
    fn note(&mut self, task: TaskId, what: &str) {
        let name = &self.table.cell().tasks[task.index()].name;
        self.log.push(format!("{} {name}: {what}", self.now));
    }
}

impl NodeOutbox for Outside {
    fn ready(&mut self, next: NodeId) -> bool {
        !self.busy.contains(&next)
    }

    fn link(&mut self, next: NodeId, packet: Packet) {
        let (now, from) = (self.now, self.from);
        let lost = (self.loss)(from, next, &packet);
        let mark = if lost { " LOST" } else { "" };
        self.transcript.push(format!("{now} {from}>{next} {}{mark}", words::packet(&packet)));
        let charge = self.table.link_bound(from, next).expect("a link");
        if !lost {
            self.flying.push(Flight { due: now + charge.0, from, to: next, packet, charge });
        }
    }

    fn signal(&mut self, task: TaskId, signal: Signal) {
        self.transcript.push(format!("{} {task}: {}", self.now, words::signal(&signal)));
        self.signals.push((task, signal));
    }

    fn observe(&mut self, at: Option<TaskId>, observation: Observation) {
        self.observations.push((at, observation));
    }
}

impl HostOutbox for Outside {
    fn run(&mut self, task: TaskId, action: Action<'_>) {
        let Action { level, action, arguments, least, .. } = action;
        let (_, program) = self.programs.iter().find(|(of, _)| *of == task).expect("a script");
        let name = program.actions[usize::from(action)].clone();
        let arguments: Vec<String> = arguments.iter().map(|argument| format!(" {argument}")).collect();
        self.note(task, &format!("{name}{}{}", arguments.concat(), of_handler(level)));
        self.running.push(Running { due: self.now + least.0, task, level, name });
    }

    fn cut_short(&mut self, task: TaskId, level: u8) {
        self.note(task, &format!("cut short{}", of_handler(level)));
        self.running.retain(|running| (running.task, running.level) != (task, level));
    }

    fn choose(&mut self, task: TaskId, alternatives: u16) -> Option<u16> {
        self.note(task, &format!("choose {alternatives}"));
        self.choice
    }

    fn ended(&mut self, task: TaskId, end: End) {
        self.note(task, &format!("ended {end:?}"));
    }

    fn asked(&mut self, _: TaskId, request: &Request) {
        self.requests += usize::from(*request != Request::Boundary);
    }

    fn statement(&mut self, _: TaskId, _: Address) {
        self.statements += 1;
    }

    fn unanswered(&mut self, _: TaskId, _: ReplyTo) {
        self.unanswered += 1;
    }
}

fn of_handler(level: u8) -> String {
    if level > 0 { format!(" at {level}") } else { String::new() }
}

/// A cell in virtual time. For a task without a script, the test itself makes the requests.
pub struct VirtualCell {
    /// The nodes of the cell.
    pub nodes: Vec<ScriptedNode>,
    /// A function that gives the result of an action, from the action's name and the time.
    pub results: fn(&str, u64) -> i32,
    down: Vec<bool>,
    transit: u16,
    out: Outside,
}

impl VirtualCell {
    /// A cell in virtual time without scripts.
    #[must_use]
    pub fn new(cell: Cell) -> Self {
        Self::with_transit(cell, 16)
    }

    /// A cell in virtual time without scripts. The transit buffer of each node holds `transit` packets.
    #[must_use]
    pub fn with_transit(cell: Cell, transit: u16) -> Self {
        let table = Arc::new(CellTable::new(cell).expect("a checked cell"));
        let ids = (0..table.cell().nodes.len()).map(NodeId::from_index);
        let nodes: Vec<_> = ids.map(|id| node(&table, id, 0, transit)).collect();
        let out = Outside {
            table,
            programs: Vec::new(),
            now: 0,
            from: NodeId(0),
            loss: Box::new(|_, _, _| false),
            busy: Vec::new(),
            flying: Vec::new(),
            running: Vec::new(),
            choice: None,
            transcript: Vec::new(),
            signals: Vec::new(),
            observations: Vec::new(),
            log: Vec::new(),
            requests: 0,
            statements: 0,
            unanswered: 0,
        };
        Self { down: vec![false; nodes.len()], nodes, results: |_, _| 0, transit, out }
    }

    /// From now on scripts that choose get this alternative at once. Otherwise they wait for [`HostInput::Chosen`].
    #[must_use]
    pub fn choosing(mut self, choice: u16) -> Self {
        self.out.choice = Some(choice);
        self
    }

    /// Begins these scripts, each on the node of its task.
    #[must_use]
    pub fn begin(mut self, scripts: impl IntoIterator<Item = (TaskId, impl Into<Arc<Program>>)>) -> Self {
        self.out.programs = scripts.into_iter().map(|(task, program)| (task, program.into())).collect();
        for node in &mut self.nodes {
            let Parts { table, .. } = node.node.parts();
            let is_here = |(task, _): &&(TaskId, _)| table.location(*task) == Some(table.node);
            let here = self.out.programs.iter().filter(is_here).cloned();
            *node = ScriptedNode::new(node.node.clone(), here).expect("checked programs");
        }
        self.ids().for_each(|id| self.step(id, HostInput::Begin));
        self
    }

    /// From now on `loss` decides for each packet whether it is lost.
    pub fn lose(&mut self, loss: impl FnMut(NodeId, NodeId, &Packet) -> bool + 'static) {
        self.out.loss = Box::new(loss);
    }

    /// From now on all packets between these two nodes are lost, and no others.
    pub fn cut(&mut self, a: NodeId, b: NodeId) {
        self.lose(move |from, to, _| (from, to) == (a, b) || (from, to) == (b, a));
    }

    /// From now on no packet is lost.
    pub fn mend(&mut self) {
        self.lose(|_, _, _| false);
    }

    /// Blocks the links to these nodes, so that they take no packets; all other links take packets.
    pub fn block(&mut self, nodes: &[NodeId]) {
        self.out.busy = nodes.into();
    }

    /// Stops a node for good.
    pub fn crash(&mut self, node: NodeId) {
        self.down[node.index()] = true;
        let table = &self.out.table;
        self.out.running.retain(|running| table.location(running.task) != Some(node));
    }

    /// Replaces a node by a later incarnation without scripts, and tells the other nodes.
    pub fn restart(&mut self, id: NodeId, incarnation: u8) {
        self.nodes[id.index()] = node(&self.out.table, id, incarnation, self.transit);
        for other in self.ids().filter(|other| *other != id) {
            self.step(other, NodeInput::PeerRestarted(id));
        }
    }

    /// Makes a request of a task without a script.
    pub fn ask(&mut self, task: TaskId, request: Request) {
        self.step(self.location(task), NodeInput::Request(task, request));
    }

    /// Lets `ticks` pass for one node.
    pub fn pass(&mut self, node: NodeId, ticks: u64) {
        self.step_after(ticks, node, NodeInput::Time);
    }

    /// Gives a node an input.
    pub fn step(&mut self, node: NodeId, input: impl Into<HostInput>) {
        self.step_after(0, node, input);
    }

    /// Gives a node an input, `ticks` after its last one.
    pub fn step_after(&mut self, ticks: u64, node: NodeId, input: impl Into<HostInput>) {
        self.drive(ticks, node, input.into());
        self.end_actions();
    }

    fn drive(&mut self, ticks: u64, id: NodeId, input: HostInput) {
        if self.down[id.index()] {
            return;
        }
        self.out.from = id;
        let node = &mut self.nodes[id.index()];
        node.step(node.node.now() + Ticks(ticks), input, &mut self.out);
        let Parts { table, tasks, .. } = node.node.parts();
        for task in tasks {
            if let Err(violation) = invariants::check(task, table) {
                panic!("{} after {input:?}: {violation}", task.task());
            }
        }
    }

    /// Ends the actions whose duration has passed. Actions without a duration end at once.
    fn end_actions(&mut self) {
        while let Some(at) = self.out.running.iter().position(|running| running.due <= self.out.now) {
            let Running { task, level, name, .. } = self.out.running.remove(at);
            let value = (self.results)(&name, self.out.now);
            self.step(self.location(task), HostInput::Acted { task, level, ok: true, value });
        }
    }

    /// Lets `ticks` pass, one by one: first time passes in all nodes, then actions end, then packets arrive.
    pub fn run(&mut self, ticks: u64) {
        for _ in 0..ticks {
            self.out.now += 1;
            self.ids().for_each(|id| self.drive(1, id, NodeInput::Time.into()));
            self.end_actions();
            while let Some(at) = self.out.flying.iter().position(|flight| flight.due <= self.out.now) {
                let Flight { from, to, packet, charge, .. } = self.out.flying.remove(at);
                self.step(to, NodeInput::Packet { from, packet, charge });
            }
        }
    }

    /// How many ticks have passed.
    #[must_use]
    pub const fn now(&self) -> u64 {
        self.out.now
    }

    /// The table of the cell.
    #[must_use]
    pub fn table(&self) -> &CellTable {
        &self.out.table
    }

    /// A node by its name.
    #[must_use]
    pub fn node(&self, name: &str) -> NodeId {
        let at = self.table().cell().nodes.iter().position(|node| node.name == name);
        NodeId::from_index(at.expect("a node of the cell"))
    }

    /// The communication task of a task.
    #[must_use]
    pub fn task(&self, task: TaskId) -> &CommTask {
        self.nodes[self.location(task).index()].node.task(task).expect("a task of its node")
    }

    fn location(&self, task: TaskId) -> NodeId {
        self.table().location(task).expect("a task of the cell")
    }

    fn ids(&self) -> impl Iterator<Item = NodeId> + use<> {
        (0..self.nodes.len()).map(NodeId::from_index)
    }

    /// The signals that a task without a script received since the last call.
    pub fn told(&mut self, task: TaskId) -> Vec<Signal> {
        let mine = self.out.signals.extract_if(.., |(to, _)| *to == task);
        mine.map(|(_, signal)| signal).collect()
    }

    /// The signals that a task without a script received since the last call, in words.
    pub fn heard(&mut self, task: TaskId) -> Vec<String> {
        self.told(task).iter().map(words::signal).collect()
    }

    /// The message that a task without a script received since the last call.
    pub fn message(&mut self, task: TaskId) -> Delivery {
        let told = self.told(task);
        let delivery = told.iter().find_map(|signal| match signal {
            Signal::Message(delivery) | Signal::Interrupt(Call::Message(delivery)) => Some(*delivery),
            _ => None,
        });
        delivery.unwrap_or_else(|| panic!("{task} was told {told:?}"))
    }

    /// The packets that left a node and the signals to tasks without a script, since the last call, as text: `3 N0>N1 SEND
    /// ...`, `4 T1: message ...`.
    pub fn transcript(&mut self) -> Vec<String> {
        std::mem::take(&mut self.out.transcript)
    }

    /// What scripts did since the last call: `7 left: weld 3`, `9 left: ended Finished`. A handler's action also has its level:
    /// `8 left: stop at 1`.
    pub fn log(&mut self) -> Vec<String> {
        std::mem::take(&mut self.out.log)
    }

    /// The observations since the last call, each with its task.
    pub fn observed(&mut self) -> Vec<(Option<TaskId>, Event)> {
        self.out.observations.drain(..).map(|(at, observation)| (at, observation.event)).collect()
    }

    /// How often this event was observed.
    #[must_use]
    pub fn count(&self, event: Event) -> usize {
        self.out.observations.iter().filter(|(_, observation)| observation.event == event).count()
    }

    /// The activities of the scripts, node by node.
    #[must_use]
    pub fn activities(&self) -> Vec<Activity> {
        let scripts = self.nodes.iter().flat_map(|node| &node.scripts);
        scripts.map(|hosted| hosted.host.script.activity()).collect()
    }

    /// Three counts: the scripts' requests except boundaries, the scripts' statements, and the commands that scripts
    /// never answered.
    #[must_use]
    pub const fn counts(&self) -> (usize, usize, usize) {
        (self.out.requests, self.out.statements, self.out.unanswered)
    }

    /// A variable of a script, by the names of both.
    #[must_use]
    pub fn var(&self, task: &str, variable: &str) -> i64 {
        let at = self.table().cell().tasks.iter().position(|declared| declared.name == task);
        let task = TaskId::from_index(at.expect("a task of the cell"));
        let (_, program) = self.out.programs.iter().find(|(of, _)| *of == task).expect("a script");
        let at = program.variables.iter().position(|declared| declared.name == variable);
        self.var_at(task, u16::try_from(at.expect("a variable")).expect("few variables"))
    }

    /// The value of a script's variable at this position.
    #[must_use]
    pub fn var_at(&self, task: TaskId, at: u16) -> i64 {
        let mut scripts = self.nodes[self.location(task).index()].scripts.iter();
        let hosted = scripts.find(|hosted| hosted.task == task).expect("a script");
        hosted.host.script.var(at).expect("a variable")
    }
}

fn node(table: &Arc<CellTable>, id: NodeId, incarnation: u8, transit: u16) -> ScriptedNode {
    let table = NodeTable::new(Arc::clone(table), id);
    let node = Node::new(table, Incarnation(incarnation), incarnation > 0, transit);
    ScriptedNode::new(node, []).expect("no script is wrong")
}
