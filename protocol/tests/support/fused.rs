//! The nodes of a random cell, driven by any operations: each fused step is compared with the small steps that it stands for.

use super::plan::Plan;
use imrs_protocol::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The effects of a node, in order.
#[derive(Debug, Default, PartialEq, Eq)]
struct Did(Vec<Effect>);

#[derive(Debug, PartialEq, Eq)]
enum Effect {
    Sent(NodeId, Packet),
    Told(TaskId, Signal),
    Seen(Option<TaskId>, Observation),
}

impl NodeOutbox for Did {
    fn link(&mut self, next: NodeId, packet: Packet) {
        self.0.push(Effect::Sent(next, packet));
    }
    fn signal(&mut self, task: TaskId, signal: Signal) {
        self.0.push(Effect::Told(task, signal));
    }
    fn observe(&mut self, at: Option<TaskId>, observation: Observation) {
        self.0.push(Effect::Seen(at, observation));
    }
}

/// The whole state of a node as text, counters included, but without the cached deadlines.
fn state(node: &Node) -> String {
    let text = format!("{:?}", node.parts());
    let mut pieces = text.split(", due: ");
    let first = pieces.next().unwrap_or_default().to_owned();
    pieces.fold(first, |all, piece| all + piece.split_once(" }").map_or("", |(_, rest)| rest))
}

/// How long it takes until time alone makes each part of a node act.
fn times(node: &Node) -> Vec<Ticks> {
    node.times_left().collect()
}

/// The nodes of a cell, and the packets between them.
pub struct Run {
    table: Arc<CellTable>,
    nodes: Vec<Node>,
    flying: Vec<(NodeId, NodeId, Packet)>,
    /// For each task, the commands that it took.
    got: Vec<Vec<ReplyTo>>,
    now: Instant,
    inputs: u32,
}

/// An operation: what is done, by which task, and two numbers that decide the rest.
pub type Op = (u8, u8, u16, u16);
/// How often each kind of request was fused.
pub type Counts = BTreeMap<&'static str, u32>;

impl Run {
    pub fn new(plan: &Plan) -> Self {
        let table = plan.build();
        let node = |i| {
            let table = NodeTable::new(Arc::clone(&table), NodeId::from_index(i));
            Node::new(table, Incarnation(0), false, 2)
        };
        let nodes = (0..table.cell().nodes.len()).map(node).collect();
        let got = vec![Vec::new(); table.cell().tasks.len()];
        Self { table, nodes, flying: Vec::new(), got, now: Instant::START, inputs: 0 }
    }

    pub fn step(&mut self, (what, which, a, b): Op, counts: &mut Counts) {
        let task = self.actor(usize::from(which), b % 8 == 0);
        match what % 16 {
            0 => self.now += Ticks(u64::from(a % 7)),
            1 if b % 8 == 0 => self.now += Ticks(u64::from(a % 90)),
            2..=4 => return self.deliver(a, counts),
            5..=7 => return self.answer(task, a, b, counts),
            8..=11 => return self.request(task, a, b, counts),
            12..=15 => return self.exchange(a, b, counts),
            _ => {}
        }
        for node in 0..self.nodes.len() {
            self.both(node, NodeInput::Time, counts);
        }
    }

    /// Chooses a task that may make a request now. With `any`, sometimes chooses a task that may not.
    fn actor(&self, from: usize, any: bool) -> TaskId {
        let tasks = self.got.len();
        let mut tasks = (0..tasks).map(|i| TaskId::from_index((from + i) % tasks));
        let first = TaskId::from_index(from % self.got.len());
        let is_idle = |task: &TaskId| {
            let at = self.table.location(*task).expect("located");
            self.nodes[at.index()].task(*task).is_some_and(CommTask::is_idle)
        };
        if any { first } else { tasks.find(is_idle).unwrap_or(first) }
    }

    fn deliver(&mut self, a: u16, counts: &mut Counts) {
        if self.flying.is_empty() {
            return;
        }
        let (from, to, packet) = self.flying.remove(usize::from(a) % self.flying.len());
        let charge = self.table.link_bound(from, to).expect("a link");
        self.both(to.index(), NodeInput::Packet { from, packet, charge }, counts);
    }

    fn answer(&mut self, task: TaskId, a: u16, b: u16, counts: &mut Counts) {
        let got = &self.got[task.index()];
        // Usually this picks the latest command that the task got, sometimes an earlier one.
        let back = if b.is_multiple_of(8) { usize::from(a) } else { 0 };
        let Some(&to) = got.iter().rev().nth(back % got.len().max(1)) else { return };
        let contents = Contents::new(&b.to_le_bytes()).expect("short");
        let reply = Request::Reply { to, contents };
        // The task answers, and usually makes a GET next: on the same port, on another port, or on all ports.
        let own = self.table.ports_of(task);
        let time_out = (a & 0x30 == 0).then(|| Ticks(u64::from(a % 5)));
        let source = (a & 0x300 == 0).then_some(to.source);
        let port = match a % 4 {
            0 => return self.ask(task, reply, counts),
            1 => None,
            2 => own.get(usize::from(b) % own.len().max(1)).copied(),
            _ => Some(to.port),
        };
        self.ask_both(task, [reply, Request::Get { port, source, time_out }], counts);
    }

    fn request(&mut self, task: TaskId, a: u16, b: u16, counts: &mut Counts) {
        let own = self.table.ports_of(task);
        let Some(&id) = own.get(usize::from(a) % own.len().max(1)) else { return };
        let port = self.table.port(id).expect("an own port");
        let time_out = (b & 0x300 == 0).then(|| Ticks(u64::from(b % 70)));
        let contents = Contents::new(&a.to_le_bytes()).expect("short");
        let peers: Vec<TaskId> = port.peers(task).collect();
        let request = match port.party(task).expect("a party").usage {
            _ if b & 0xf000 == 0 => Request::Handle { port: id, handled: b & 0x80 != 0 },
            _ if b & 0xf000 == 0x1000 => {
                [Request::Cancel, Request::Return, Request::Boundary][usize::from(b % 3)]
            }
            Usage::Send | Usage::Query if b & 0xf000 == 0x2000 => {
                Request::Part { port: id, index: 1, contents }
            }
            Usage::Send | Usage::Query => {
                let one = Target::One(peers[usize::from(a / 8) % peers.len()]);
                let to = if b & 0x400 == 0 { one } else { Target::All };
                Request::Send { port: id, to, contents, time_out }
            }
            Usage::Receive | Usage::Response | Usage::Reply => {
                let source = (b & 0x800 == 0).then(|| peers[usize::from(a / 8) % peers.len()]);
                Request::Get { port: (b & 0xc00 != 0).then_some(id), source, time_out }
            }
            Usage::Waitfor => Request::Arrive { port: id, arguments: [0; 8], time_out },
        };
        self.ask(task, request, counts);
    }

    /// Lets one task wait for a message on a port, and another task send that message. The receiver usually answers.
    fn exchange(&mut self, a: u16, b: u16, counts: &mut Counts) {
        let ports = self.table.ports();
        let Some(port) = ports.get(usize::from(a) % ports.len().max(1)) else { return };
        let (id, owner) = (port.id, port.decl.owner);
        let user = port.parties[1 + usize::from(b) % (port.parties.len() - 1)].task;
        let (sender, receiver) = match port.decl.usage {
            Usage::Send | Usage::Query => (owner, user),
            Usage::Receive | Usage::Response => (user, owner),
            Usage::Waitfor => return self.meet(id, a, b, counts),
            Usage::Reply => return,
        };
        let time_out = (b & 0x300 == 0).then(|| Ticks(u64::from(b % 70)));
        let source = (b & 0x800 == 0).then_some(sender);
        let get = Request::Get { port: (b & 0xc00 != 0).then_some(id), source, time_out };
        let contents = Contents::new(&a.to_le_bytes()).expect("short");
        let to = if b & 0x1000 == 0 { Target::One(receiver) } else { Target::All };
        self.ask(receiver, get, counts);
        self.ask(sender, Request::Send { port: id, to, contents, time_out }, counts);
        if b & 0x4000 != 0 {
            self.leave(receiver, a, counts);
        }
        if b & 0x6000 != 0 {
            self.answer(receiver, a, b, counts);
        }
    }

    /// Lets another task send a message to this task. The message waits in the buffer.
    fn leave(&mut self, task: TaskId, a: u16, counts: &mut Counts) {
        let receives = |id: &&PortId| {
            let party = self.table.port(**id).and_then(|port| port.party(task));
            party.is_some_and(|party| matches!(party.usage, Usage::Receive | Usage::Response))
        };
        let own: Vec<PortId> = self.table.ports_of(task).iter().filter(receives).copied().collect();
        let Some(&id) = own.get(usize::from(a) % own.len().max(1)) else { return };
        let peers: Vec<TaskId> = self.table.port(id).expect("an own port").peers(task).collect();
        let from = peers[usize::from(a / 16) % peers.len()];
        let contents = Contents::new(&a.to_le_bytes()).expect("short");
        self.ask(from, Request::Send { port: id, to: Target::One(task), contents, time_out: None }, counts);
    }

    /// Lets most members of a waitfor reach it, one after the other, some of them with less patience.
    fn meet(&mut self, port: PortId, a: u16, b: u16, counts: &mut Counts) {
        let parties: Vec<TaskId> =
            self.table.port(port).expect("a port").parties.iter().map(|party| party.task).collect();
        for (at, &task) in parties.iter().cycle().skip(usize::from(b)).take(parties.len()).enumerate() {
            if (a >> (at % 16)) & 7 != 0 {
                let time_out = (b >> (at % 16) & 7 == 1).then(|| Ticks(u64::from(a % 70)));
                let arguments = [a.to_le_bytes()[0]; 8];
                self.ask(task, Request::Arrive { port, arguments, time_out }, counts);
            }
        }
    }

    fn ask(&mut self, task: TaskId, request: Request, counts: &mut Counts) {
        let at = self.table.location(task).expect("located");
        self.both(at.index(), NodeInput::Request(task, request), counts);
    }

    /// Compares a REPLY and a GET as one fused step with their small steps. The run continues after both.
    fn ask_both(&mut self, task: TaskId, requests: [Request; 2], counts: &mut Counts) {
        let at = self.table.location(task).expect("located").index();
        self.nodes[at].step(self.now, NodeInput::Time, &mut Did::default());
        let (mut fused, mut small) = (self.nodes[at].clone(), self.nodes[at].clone());
        let (mut expected, mut found) = (Did::default(), Did::default());
        let [reply, get] = &requests;
        if fused.reply_and_get(task, [reply, get], &mut found) {
            for request in requests {
                small.small_steps(self.now, NodeInput::Request(task, request), &mut expected);
            }
            *counts.entry("reply and get").or_default() += 1;
            let got = |effect: &Effect| matches!(effect, Effect::Told(_, Signal::Message(_)));
            *counts.entry("reply and message").or_default() += u32::from(found.0.iter().any(got));
            assert_eq!(state(&fused), state(&small), "{requests:?}");
            assert_eq!(times(&fused), times(&small), "{requests:?}");
            assert_eq!(found, expected, "{requests:?}");
        } else {
            assert_eq!(state(&fused), state(&self.nodes[at]), "{requests:?} changed the state");
            assert_eq!(found, Did::default(), "{requests:?} had effects");
        }
        requests.into_iter().for_each(|request| self.ask(task, request, counts));
    }

    /// Gives the input to a copy of the node by small steps, and to the node itself, and compares the two.
    fn both(&mut self, at: usize, input: NodeInput, counts: &mut Counts) {
        let node = &mut self.nodes[at];
        node.step(self.now, NodeInput::Time, &mut Did::default());
        let mut small = node.clone();
        let (mut expected, mut found) = (Did::default(), Did::default());
        small.small_steps(self.now, input, &mut expected);
        if let NodeInput::Request(task, request) = &input {
            let before = (self.inputs.is_multiple_of(16)).then(|| state(node));
            if node.clone().fuse(*task, request, &mut Did::default()) {
                *counts.entry(name(&self.table, request)).or_default() += 1;
                node.step(self.now, input, &mut found);
                let released = |effect: &Effect| matches!(effect, Effect::Told(_, Signal::Released { .. }));
                *counts.entry("meeting").or_default() += u32::from(found.0.iter().any(released));
                assert_eq!(state(node), state(&small), "{input:?}");
                assert_eq!(times(node), times(&small), "{input:?}");
            } else {
                if let Some(before) = before {
                    let mut same = node.clone();
                    same.fuse(*task, request, &mut Did::default());
                    assert_eq!(state(&same), before, "{input:?} was not fused, and has changed the state");
                }
                node.step(self.now, input, &mut found);
            }
            self.inputs += 1;
        } else {
            node.step(self.now, input, &mut found);
        }
        assert_eq!(found, expected, "{input:?}");
        let from = NodeId::from_index(at);
        for effect in found.0 {
            match effect {
                Effect::Sent(next, packet) => self.flying.push((from, next, packet)),
                Effect::Told(task, Signal::Message(message) | Signal::Interrupt(Call::Message(message))) => {
                    self.got[task.index()].push(message.from);
                }
                Effect::Told(..) | Effect::Seen(..) => {}
            }
        }
    }
}

/// The name of the port that the request concerns, or of the kind of request.
fn name(table: &CellTable, request: &Request) -> &'static str {
    let of = |port: PortId| table.port(port).map(|port| (port.decl.usage, port.decl.class));
    let queries = |usage| matches!(usage, Usage::Query | Usage::Response);
    match *request {
        Request::Send { port, .. } => match of(port) {
            Some((usage, _)) if queries(usage) => "query",
            Some((_, Class::Status)) => "status",
            _ => "command",
        },
        Request::Arrive { .. } => "arrival",
        Request::Get { .. } => "get",
        Request::Reply { to, .. } if of(to.port).is_some_and(|(usage, _)| queries(usage)) => "response",
        _ => "reply",
    }
}
