//! Runs lowered cells in virtual time: every packet takes its link's whole delay, every action its least time.

use imrs_language::Lowered;
use imrs_language::lower::Behaviour;
use imrs_protocol::script::{Action, End, HostInput, HostOutbox, ScriptedNode};
use imrs_protocol::*;
use std::sync::Arc;

/// The environment of the nodes: links, actions, and a log of `time task: what`.
#[derive(Default)]
struct Outside {
    now: u64,
    from: NodeId,
    flying: Vec<(u64, NodeId, NodeId, Packet)>,
    ready: Vec<(NodeId, NodeId, Packet)>,
    actions: Vec<(u64, TaskId, u8, String)>,
    log: Vec<String>,
    names: Vec<(String, Vec<String>)>,
    cut: Vec<(NodeId, NodeId)>,
}

impl Outside {
    fn note(&mut self, task: TaskId, what: &str) {
        self.log.push(format!("{} {}: {what}", self.now, self.names[task.index()].0));
    }
}

impl NodeOutbox for Outside {
    fn link(&mut self, next: NodeId, packet: Packet) {
        if !self.cut.contains(&(self.from, next)) {
            self.ready.push((self.from, next, packet));
        }
    }
    fn signal(&mut self, _: TaskId, _: Signal) {}
}

impl HostOutbox for Outside {
    fn run(&mut self, task: TaskId, action: Action<'_>) {
        let name = self.names[task.index()].1[usize::from(action.action)].clone();
        let shown: Vec<String> = action.arguments.iter().map(i64::to_string).collect();
        self.note(task, format!("{name} {}", shown.join(" ")).trim_end());
        self.actions.push((self.now + action.least.0, task, action.level, name));
    }
    fn cut_short(&mut self, task: TaskId, level: u8) {
        self.note(task, "cut short");
        self.actions.retain(|&(_, whose, at, _)| (whose, at) != (task, level));
    }
    fn choose(&mut self, _: TaskId, _: u16) -> Option<u16> {
        Some(0)
    }
    fn ended(&mut self, task: TaskId, end: End) {
        self.note(task, &format!("ended {end:?}"));
    }
}

/// A whole cell that runs in virtual time.
pub struct VirtualCell {
    table: Arc<CellTable>,
    nodes: Vec<ScriptedNode>,
    down: Vec<bool>,
    out: Outside,
    /// The result of an action, by its name and the time.
    pub results: fn(&str, u64) -> i32,
}

impl VirtualCell {
    /// The cell at its start.
    pub fn new(lowered: &Lowered) -> Self {
        let table = Arc::new(CellTable::new(lowered.cell.clone()).expect("a checked cell"));
        let mut names = Vec::new();
        let mut scripts = Vec::new();
        for (at, (task, behaviour)) in lowered.cell.tasks.iter().zip(&lowered.tasks).enumerate() {
            let Behaviour::Script(script) = behaviour else { panic!("`{}` is extern", task.name) };
            names.push((task.name.clone(), script.program.actions.clone()));
            scripts.push((TaskId::from_index(at), Arc::clone(&script.program)));
        }
        let nodes = (0..lowered.cell.nodes.len()).map(NodeId::from_index).map(|id| {
            let node = Node::new(NodeTable::new(Arc::clone(&table), id), Incarnation(0), false, 16);
            let here = scripts.iter().filter(|(task, _)| table.location(*task) == Some(id)).cloned();
            ScriptedNode::new(node, here).expect("checked programs")
        });
        let nodes: Vec<_> = nodes.collect();
        let down = vec![false; nodes.len()];
        let out = Outside { names, ..Outside::default() };
        let mut virtual_cell = Self { nodes, down, out, table: Arc::clone(&table), results: |_, _| 0 };
        (0..virtual_cell.nodes.len())
            .for_each(|node| virtual_cell.step(NodeId::from_index(node), HostInput::Begin));
        virtual_cell
    }

    fn step(&mut self, node: NodeId, input: HostInput) {
        self.drive(node, input);
        self.end_actions();
    }

    fn drive(&mut self, node: NodeId, input: HostInput) {
        if self.down[node.index()] {
            return;
        }
        self.out.from = node;
        self.nodes[node.index()].step(Instant(self.out.now), input, &mut self.out);
        for (from, to, packet) in std::mem::take(&mut self.out.ready) {
            let bound = self.table.link_bound(from, to).expect("a link").0;
            self.out.flying.push((self.out.now + bound, from, to, packet));
        }
    }

    /// Ends the actions whose time has passed. Actions that take no time end at once.
    fn end_actions(&mut self) {
        while let Some(at) = self.out.actions.iter().position(|&(due, ..)| due <= self.out.now) {
            let (_, task, level, name) = self.out.actions.remove(at);
            let node = self.table.location(task).expect("a task of the cell");
            let value = (self.results)(&name, self.out.now);
            self.step(node, HostInput::Acted { task, level, ok: true, value });
        }
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
                let charge = self.table.link_bound(from, to).expect("a link");
                self.step(to, HostInput::Node(NodeInput::Packet { from, packet, charge }));
            }
        }
    }

    pub fn cut(&mut self, a: &str, b: &str) {
        let (a, b) = (self.node(a), self.node(b));
        self.out.cut = vec![(a, b), (b, a)];
    }

    /// Stops a node for good.
    pub fn crash(&mut self, name: &str) {
        let node = self.node(name);
        self.down[node.index()] = true;
        let table = &self.table;
        self.out.actions.retain(|&(_, task, ..)| table.location(task) != Some(node));
    }

    fn node(&self, name: &str) -> NodeId {
        let at = self.table.cell().nodes.iter().position(|node| node.name == name);
        NodeId::from_index(at.expect("a node of the cell"))
    }

    pub fn log(&mut self) -> Vec<String> {
        std::mem::take(&mut self.out.log)
    }

    pub const fn now(&self) -> u64 {
        self.out.now
    }

    /// A variable of a task.
    pub fn var(&self, task: &str, variable: &str) -> i64 {
        let at = self.table.cell().tasks.iter().position(|t| t.name == task).expect("a task of the cell");
        let task = TaskId::from_index(at);
        let node = self.table.location(task).expect("a node");
        let hosted = self.nodes[node.index()].scripts().iter().find(|hosted| hosted.task == task);
        let hosted = hosted.expect("a script");
        let index = hosted.program.variables.iter().position(|v| v.name == variable).expect("a variable");
        hosted.script.var(u16::try_from(index).expect("few variables")).expect("a value")
    }
}
