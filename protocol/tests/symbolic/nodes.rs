//! Tests of whole nodes on symbols: transit buffers, Timers, relays, and the links between them.

use super::{Clock, Evaluate, Run, State, random_runs_are_alike};
use crate::support::Effects;
use crate::support::world::{Op, World};
use imrs_protocol::*;

/// A packet on a link: where it comes from, where it goes, and when it was sent.
#[derive(Clone)]
struct Flight {
    from: NodeId,
    to: NodeId,
    packet: Packet,
    sent: Instant,
}

/// The nodes of a random cell. Packets arrive in any order, late, twice or never.
#[derive(Clone)]
struct Nodes {
    nodes: Vec<Node>,
    flying: Vec<Flight>,
    got: Vec<(TaskId, ReplyTo)>,
    /// The world that makes the requests, which fit the cell.
    world: World,
}

struct Out<'a> {
    effects: Effects,
    got: &'a mut Vec<(TaskId, ReplyTo)>,
    next: Vec<NodeId>,
    /// Whether the links take packets in this step.
    open: bool,
}

impl NodeOutbox for Out<'_> {
    fn ready(&mut self, _: NodeId) -> bool {
        self.open
    }
    fn link(&mut self, next: NodeId, packet: Packet) {
        self.next.push(next);
        self.effects.packets.push(packet);
    }
    fn signal(&mut self, task: TaskId, signal: Signal) {
        self.effects.signals.push(signal);
        if let Signal::Message(delivery) | Signal::Interrupt(Call::Message(delivery)) = signal
            && delivery.class == Class::Command
        {
            self.got.push((task, delivery.from));
        }
    }
    fn observe(&mut self, _: Option<TaskId>, observation: Observation) {
        self.effects.observations.push(observation);
    }
}

impl Nodes {
    fn new(world: World) -> Self {
        let mut tables: Vec<&NodeTable> = world.tables.iter().collect();
        tables.sort_by_key(|table| table.node);
        tables.dedup_by_key(|table| table.node);
        let node = |table: &&NodeTable| Node::new((*table).clone(), Incarnation(0), false, 2);
        Self { nodes: tables.iter().map(node).collect(), flying: Vec::new(), got: Vec::new(), world }
    }

    fn node_of(&self, task: usize) -> usize {
        let node = self.world.tables[task].node;
        self.nodes.iter().position(|own| own.parts().table.node == node).expect("each task has a node")
    }

    fn step(&mut self, now: Instant, (what, which, a, b): Op) -> Effects {
        let task = usize::from(which) % self.world.tables.len();
        let (id, at) = (TaskId::from_index(task), self.node_of(task));
        let open = !b.is_multiple_of(5);
        match what % 8 {
            0..=2 if !self.flying.is_empty() => self.arrive(now, usize::from(a) % self.flying.len(), b),
            3..=5 => self.input(now, at, open, NodeInput::Request(id, self.world.request(task, a, b))),
            6 if !self.got.is_empty() => {
                let (task, to) = self.got.swap_remove(usize::from(a) % self.got.len());
                let request = Request::Reply { to, contents: Contents::EMPTY };
                self.input(now, self.node_of(task.index()), open, NodeInput::Request(task, request))
            }
            6 => {
                let request = Request::Start { id: TimeId(which % 3), length: Ticks(u64::from(a % 20)) };
                self.input(now, at, open, NodeInput::Request(id, request))
            }
            _ => self.input(now, at, open, NodeInput::Time),
        }
    }

    /// Lets a packet arrive. It is charged the time that it spent on its link.
    fn arrive(&mut self, now: Instant, at: usize, b: u16) -> Effects {
        let Flight { from, to, packet, sent } = self.flying[at].clone();
        if !b.is_multiple_of(8) {
            self.flying.remove(at);
        }
        let Some(node) = self.nodes.iter().position(|node| node.parts().table.node == to) else {
            return Effects::default();
        };
        let charge = now - sent;
        self.input(now, node, !b.is_multiple_of(5), NodeInput::Packet { from, packet, charge })
    }

    fn input(&mut self, now: Instant, at: usize, open: bool, input: NodeInput) -> Effects {
        let mut out = Out { effects: Effects::default(), got: &mut self.got, next: Vec::new(), open };
        let node = &mut self.nodes[at];
        node.step(now, input, &mut out);
        let Parts { table, tasks, .. } = node.parts();
        for task in tasks {
            invariants::check(task, table).unwrap_or_else(|violation| panic!("after {input:?}: {violation}"));
        }
        let Out { effects, next, .. } = out;
        let flights = next.into_iter().zip(&effects.packets);
        self.flying.extend(flights.map(|(to, &packet)| Flight { from: table.node, to, packet, sent: now }));
        effects
    }
}

impl State for Nodes {
    fn bytes(mut self, evaluate: &mut Evaluate<'_>) -> Vec<Result<Vec<u8>, Overflow>> {
        for node in &mut self.nodes {
            let Parts { table, tasks, transit, timer } = node.parts_mut();
            tasks.iter_mut().for_each(|task| task.walk(table, evaluate));
            transit.walk(table, evaluate);
            timer.walk(evaluate);
        }
        let tasks = self.nodes.iter().flat_map(|node| &node.parts().tasks);
        let mut next: Vec<_> = tasks.map(|task| (task.task(), task.next_sequence())).collect();
        next.sort_by_key(|(task, _)| *task);
        let sequences: Vec<Seq24> = next.into_iter().map(|(_, next)| next).collect();
        let (rounds, _) = self.world.frame();
        let frame = Frame { rounds: &rounds, sequences: &sequences, incarnations: false };
        let packed = |node: &mut Node| {
            let Parts { table, tasks, transit, timer } = node.parts_mut();
            Encode::bytes(&frame, |w| {
                for task in tasks.iter_mut() {
                    task.bury();
                    task.walk(table, w);
                }
                transit.walk(table, w);
                timer.walk(w);
            })
        };
        self.nodes.iter_mut().map(packed).collect()
    }
}

fn run(nodes: &Nodes, ops: &[Op], clock: Clock<'_>) -> Run<Nodes> {
    let mut end = nodes.clone();
    let effects = ops.iter().zip(1..).map(|(op, step)| end.step(clock(step), *op)).collect();
    Run { effects, end }
}

#[test]
fn nodes_on_symbols_do_what_they_do_on_all_numbers_that_are_answered_alike() {
    random_runs_are_alike((800, 0..6), Nodes::new, run);
}
