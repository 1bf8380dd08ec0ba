//! A cell of nodes joined by links in virtual time: every packet takes exactly its link's bound.

use super::{packet as in_words, signal as signal_in_words};
use imrs_protocol::*;
use std::sync::Arc;

/// A packet on a link.
#[derive(Clone, Copy, Debug)]
struct Flight {
    due: u64,
    from: NodeId,
    to: NodeId,
    packet: Packet,
    charge: Ticks,
}

/// Decides for each packet that leaves a node whether it is lost.
type Loss = Box<dyn FnMut(NodeId, NodeId, &Packet) -> bool>;

pub struct Net {
    pub table: Arc<CellTable>,
    pub nodes: Vec<Node>,
    pub now: u64,
    flying: Vec<Flight>,
    loss: Loss,
    /// The nodes to which links take no packets.
    pub busy: Vec<NodeId>,
    /// Everything that left a node or reached a task, in words: `3 N0>N1 SEND ...`, `4 T1: message ...`.
    pub log: Vec<String>,
    pub signals: Vec<(TaskId, Signal)>,
    pub observations: Vec<(Option<TaskId>, Observation)>,
}

struct Wires<'a> {
    from: NodeId,
    now: u64,
    table: &'a CellTable,
    flying: &'a mut Vec<Flight>,
    loss: &'a mut Loss,
    busy: &'a [NodeId],
    log: &'a mut Vec<String>,
    signals: &'a mut Vec<(TaskId, Signal)>,
    observations: &'a mut Vec<(Option<TaskId>, Observation)>,
}

impl NodeOutbox for Wires<'_> {
    fn ready(&mut self, next: NodeId) -> bool {
        !self.busy.contains(&next)
    }

    fn link(&mut self, next: NodeId, packet: Packet) {
        let lost = (self.loss)(self.from, next, &packet);
        let mark = if lost { " LOST" } else { "" };
        self.log.push(format!("{} {}>{} {}{mark}", self.now, self.from, next, in_words(&packet)));
        let charge = self.table.link_bound(self.from, next).expect("a link");
        if !lost {
            let due = self.now + charge.0;
            self.flying.push(Flight { due, from: self.from, to: next, packet, charge });
        }
    }

    fn signal(&mut self, task: TaskId, signal: Signal) {
        self.log.push(format!("{} {task}: {}", self.now, signal_in_words(&signal)));
        self.signals.push((task, signal));
    }

    fn observe(&mut self, at: Option<TaskId>, observation: Observation) {
        self.observations.push((at, observation));
    }
}

impl Net {
    pub fn new(cell: Cell) -> Self {
        Self::with_transit(cell, 16)
    }

    /// Nodes whose transit buffers hold `capacity` packets.
    pub fn with_transit(cell: Cell, capacity: u16) -> Self {
        let table = Arc::new(CellTable::new(cell).expect("a checked cell"));
        let node =
            |i| Node::new(NodeTable::new(Arc::clone(&table), NodeId(i)), Incarnation(0), false, capacity);
        let count = u16::try_from(table.cell().nodes.len()).expect("few nodes");
        let nodes = (0..count).map(node).collect();
        Self {
            table,
            nodes,
            now: 0,
            flying: Vec::new(),
            loss: Box::new(|_, _, _| false),
            busy: Vec::new(),
            log: Vec::new(),
            signals: Vec::new(),
            observations: Vec::new(),
        }
    }

    /// From now on `loss` decides which packets are lost.
    pub fn lose(&mut self, loss: impl FnMut(NodeId, NodeId, &Packet) -> bool + 'static) {
        self.loss = Box::new(loss);
    }

    pub fn ask(&mut self, task: TaskId, request: Request) {
        let node = self.table.location(task).expect("a task of the cell");
        self.step(node, NodeInput::Request(task, request));
    }

    /// Replaces a node by the incarnation `incarnation`, and tells the others.
    pub fn restart(&mut self, node: NodeId, incarnation: u8) {
        let table = NodeTable::new(Arc::clone(&self.table), node);
        self.nodes[node.index()] = Node::new(table, Incarnation(incarnation), true, 16);
        for other in 0..self.nodes.len() {
            if other != node.index() {
                self.step(NodeId::from_index(other), NodeInput::PeerRestarted(node));
            }
        }
    }

    pub fn step(&mut self, node: NodeId, input: NodeInput) {
        self.step_after(node, 0, input);
    }

    /// Lets `ticks` pass for one node.
    pub fn pass(&mut self, node: NodeId, ticks: u64) {
        self.step_after(node, ticks, NodeInput::Time);
    }

    /// An input, `ticks` after the last one.
    pub fn step_after(&mut self, node: NodeId, ticks: u64, input: NodeInput) {
        let mut wires = Wires {
            from: node,
            now: self.now,
            table: &self.table,
            flying: &mut self.flying,
            loss: &mut self.loss,
            busy: &self.busy,
            log: &mut self.log,
            signals: &mut self.signals,
            observations: &mut self.observations,
        };
        let stepped = &mut self.nodes[node.index()];
        stepped.step(stepped.now() + Ticks(ticks), input, &mut wires);
        let parts = self.nodes[node.index()].parts();
        for task in &parts.tasks {
            if let Err(violation) = invariants::check(task, &parts.table) {
                panic!("{} after {input:?}: {violation}", task.task());
            }
        }
    }

    /// Lets `ticks` pass, one by one: first time passes in all nodes, then packets arrive.
    pub fn run(&mut self, ticks: u64) {
        for _ in 0..ticks {
            self.now += 1;
            for node in 0..self.nodes.len() {
                self.pass(NodeId::from_index(node), 1);
            }
            let now = self.now;
            let (arrived, flying) = self.flying.drain(..).partition(|flight| flight.due <= now);
            self.flying = flying;
            let arrived: Vec<Flight> = arrived;
            for Flight { from, to, packet, charge, .. } in arrived {
                self.step(to, NodeInput::Packet { from, packet, charge });
            }
        }
    }

    /// The signals that the task received since the last call.
    pub fn told(&mut self, task: TaskId) -> Vec<Signal> {
        let (mine, rest) = self.signals.drain(..).partition(|(to, _)| *to == task);
        self.signals = rest;
        let mine: Vec<(TaskId, Signal)> = mine;
        mine.into_iter().map(|(_, signal)| signal).collect()
    }

    /// The signals that the task received since the last call, in words.
    pub fn heard(&mut self, task: TaskId) -> Vec<String> {
        self.told(task).iter().map(signal_in_words).collect()
    }

    /// The message that the task received since the last call.
    pub fn message(&mut self, task: TaskId) -> Delivery {
        let told = self.told(task);
        let delivery = told.iter().find_map(|s| match s {
            Signal::Message(d) | Signal::Interrupt(Call::Message(d)) => Some(*d),
            _ => None,
        });
        delivery.unwrap_or_else(|| panic!("{task} was told {told:?}"))
    }

    /// The log since the last call.
    pub fn transcript(&mut self) -> Vec<String> {
        std::mem::take(&mut self.log)
    }

    /// How often something was observed.
    pub fn count(&self, event: Event) -> usize {
        self.observations.iter().filter(|(_, o)| o.event == event).count()
    }
}
