//! Nodes with scripts in virtual time: every packet takes one tick, every action its shortest duration.

use imrs_protocol::script::*;
use imrs_protocol::*;
use std::sync::Arc;

/// The effects of all nodes. The log has lines of the form `time task: what`.
#[derive(Default)]
struct Outside {
    now: u64,
    from: NodeId,
    flying: Vec<(u64, NodeId, NodeId, Packet)>,
    actions: Vec<(u64, TaskId, u8)>,
    told: Vec<(TaskId, Signal)>,
    log: Vec<String>,
    choice: Option<u16>,
    /// Links that lose everything.
    cut: Vec<(NodeId, NodeId)>,
    requests: usize,
    unanswered: usize,
    statements: usize,
}

impl Outside {
    fn note(&mut self, task: TaskId, what: &str) {
        self.log.push(format!("{} {task}: {what}", self.now));
    }
}

impl NodeOutbox for Outside {
    fn link(&mut self, next: NodeId, packet: Packet) {
        if !self.cut.contains(&(self.from, next)) {
            self.flying.push((self.now + 1, self.from, next, packet));
        }
    }
    fn signal(&mut self, task: TaskId, signal: Signal) {
        self.told.push((task, signal));
    }
}

impl HostOutbox for Outside {
    fn run(&mut self, task: TaskId, action: Action<'_>) {
        self.note(task, &format!("run {} {:?} at {}", action.action, action.arguments, action.level));
        self.actions.push((self.now + action.least.0, task, action.level));
    }
    fn cut_short(&mut self, task: TaskId, level: u8) {
        self.note(task, &format!("cut short {level}"));
        self.actions.retain(|&(_, whose, at)| (whose, at) != (task, level));
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

pub struct VirtualCell {
    table: Arc<CellTable>,
    pub nodes: Vec<ScriptedNode>,
    out: Outside,
}

impl VirtualCell {
    /// The cell with these scripts; tasks without one are played by the test.
    pub fn new(cell: Cell, scripts: Vec<(TaskId, Program)>) -> Self {
        let table = Arc::new(CellTable::new(cell).expect("a checked cell"));
        let scripts: Vec<_> = scripts.into_iter().map(|(task, program)| (task, Arc::new(program))).collect();
        let nodes = (0..table.cell().nodes.len()).map(NodeId::from_index).map(|id| {
            let node = Node::new(NodeTable::new(Arc::clone(&table), id), Incarnation(0), false, 16);
            let here = scripts.iter().filter(|(task, _)| table.location(*task) == Some(id)).cloned();
            ScriptedNode::new(node, here).expect("checked programs")
        });
        Self { nodes: nodes.collect(), out: Outside::default(), table: Arc::clone(&table) }
    }

    pub fn step(&mut self, node: NodeId, input: HostInput) {
        self.drive(node, input);
        self.end_actions();
    }

    fn drive(&mut self, node: NodeId, input: HostInput) {
        self.out.from = node;
        self.nodes[node.index()].step(Instant(self.out.now), input, &mut self.out);
        let parts = self.nodes[node.index()].node().parts();
        for task in &parts.tasks {
            invariants::check(task, &parts.table).unwrap_or_else(|violation| panic!("{violation}"));
        }
    }

    /// Ends the actions that are over; those that take no time end at once.
    fn end_actions(&mut self) {
        while let Some(at) = self.out.actions.iter().position(|&(due, ..)| due <= self.out.now) {
            let (_, task, level) = self.out.actions.remove(at);
            let node = self.table.location(task).expect("a task of the cell");
            self.step(node, HostInput::Acted { task, level, ok: true, value: 40 });
        }
    }

    pub fn begin(&mut self) {
        (0..self.nodes.len()).for_each(|node| self.step(NodeId::from_index(node), HostInput::Begin));
    }

    /// A request of a task without a script.
    pub fn ask(&mut self, task: TaskId, request: Request) {
        let node = self.table.location(task).expect("a task of the cell");
        self.step(node, HostInput::Node(NodeInput::Request(task, request)));
    }

    /// The signals that a task without a script received since the last call.
    pub fn told(&mut self, task: TaskId) -> Vec<Signal> {
        let (mine, rest) = std::mem::take(&mut self.out.told).into_iter().partition(|&(to, _)| to == task);
        self.out.told = rest;
        let mine: Vec<(TaskId, Signal)> = mine;
        mine.into_iter().map(|(_, signal)| signal).collect()
    }

    pub fn run(&mut self, ticks: u64) {
        for _ in 0..ticks {
            self.out.now += 1;
            for node in 0..self.nodes.len() {
                self.drive(NodeId::from_index(node), HostInput::Node(NodeInput::Time));
            }
            self.end_actions();
            while let Some(at) = self.out.flying.iter().position(|&(due, ..)| due <= self.out.now) {
                let (_, from, to, packet) = self.out.flying.remove(at);
                self.step(to, HostInput::Node(NodeInput::Packet { from, packet, charge: Ticks(1) }));
            }
        }
    }

    /// From now on these links lose everything, and no others do.
    pub fn cut(&mut self, links: &[(NodeId, NodeId)]) {
        self.out.cut = links.into();
    }

    pub fn is_active(&self, task: TaskId) -> bool {
        let node = self.table.location(task).expect("a task of the cell");
        self.nodes[node.index()].node().task(task).expect("a task").is_active()
    }

    pub fn log(&mut self) -> Vec<String> {
        std::mem::take(&mut self.out.log)
    }

    pub fn choose_at_once(&mut self, choice: u16) {
        self.out.choice = Some(choice);
    }

    /// What the scripts are doing, node by node.
    pub fn activities(&self) -> Vec<Activity> {
        let scripts = self.nodes.iter().flat_map(ScriptedNode::scripts);
        scripts.map(|hosted| hosted.script.activity()).collect()
    }

    pub const fn now(&self) -> u64 {
        self.out.now
    }

    /// The numbers of requests other than boundaries, of statements, and of commands never answered.
    pub const fn counts(&self) -> (usize, usize, usize) {
        (self.out.requests, self.out.statements, self.out.unanswered)
    }

    pub fn var(&self, task: TaskId, at: u16) -> i64 {
        let node = self.table.location(task).expect("a task of the cell");
        self.nodes[node.index()].script(task).and_then(|script| script.var(at)).expect("a variable")
    }
}
