//! Fixtures that the tests of the protocol share: one communication task alone ([`Solo`]) and a cell driven at random
//! ([`world::World`]). Every step checks the invariants. A cell of nodes in virtual time is `imrs_testkit::VirtualCell`.

pub mod bytes;
pub mod fused;
pub mod packing;
pub mod plan;
pub mod shift;
pub mod world;

use imrs_protocol::*;
pub use imrs_testkit::words::{packet, signal};
use shift::Shift;
use std::sync::Arc;

/// Everything that one input of a task caused, in order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Effects {
    pub packets: Vec<Packet>,
    pub signals: Vec<Signal>,
    /// What the task asked of the node's Timer: for each entry, the length for which it was armed, or `None` if it was
    /// disarmed.
    pub timers: Vec<(TimeId, Option<Ticks>)>,
    /// The turn with which each timer was armed: the number of that start.
    pub turns: Vec<(TimeId, u8)>,
    pub observations: Vec<Observation>,
}

impl Outbox for Effects {
    fn transmit(&mut self, packet: Packet) {
        self.packets.push(packet);
    }
    fn signal(&mut self, signal: Signal) {
        self.signals.push(signal);
    }
    fn arm(&mut self, id: TimeId, turn: u8, length: Ticks) {
        self.turns.push((id, turn));
        self.timers.push((id, Some(length)));
    }
    fn disarm(&mut self, id: TimeId) {
        self.timers.push((id, None));
    }
    fn observe(&mut self, observation: Observation) {
        self.observations.push(observation);
    }
}

impl Effects {
    /// The packets, then the signals, each in words.
    pub fn words(&self) -> Vec<String> {
        self.packets.iter().map(packet).chain(self.signals.iter().map(signal)).collect()
    }

    /// The reasons of all messages that were dropped.
    pub fn discards(&self) -> Vec<Reason> {
        let reason = |o: &Observation| if let Event::Discarded(r) = o.event { Some(r) } else { None };
        self.observations.iter().filter_map(reason).collect()
    }

    /// The message that was handed over, to a GET or to a handler, if there is one.
    pub fn delivery(&self) -> Option<Delivery> {
        self.signals.iter().find_map(|s| match s {
            Signal::Message(d) | Signal::Interrupt(Call::Message(d)) => Some(*d),
            _ => None,
        })
    }

    /// How often this event was observed.
    pub fn count(&self, event: Event) -> usize {
        self.observations.iter().filter(|o| o.event == event).count()
    }

    pub fn is_nothing(&self) -> bool {
        self.packets.is_empty() && self.signals.is_empty() && self.timers.is_empty()
    }
}

/// One communication task, without a node.
#[derive(Clone)]
pub struct Solo {
    pub table: NodeTable,
    pub task: CommTask,
}

impl Solo {
    pub fn new(table: &Arc<CellTable>, task: TaskId) -> Self {
        Self::incarnation(table, task, 0, false)
    }

    /// The task in this incarnation of its node.
    pub fn incarnation(table: &Arc<CellTable>, task: TaskId, incarnation: u8, restarted: bool) -> Self {
        let node = table.location(task).expect("a task of the cell");
        let table = NodeTable::new(Arc::clone(table), node);
        let task = CommTask::new(&table, task, Incarnation(incarnation), restarted);
        Self { table, task }
    }

    pub fn input(&mut self, input: Input) -> Effects {
        self.input_after(0, input)
    }

    /// Gives the task an input, `ticks` after the last one.
    fn input_after(&mut self, ticks: u64, input: Input) -> Effects {
        let now = self.task.now() + Ticks(ticks);
        let mut out = Effects::default();
        self.task.handle(&self.table, now, &input, &mut out);
        if let Err(violation) = invariants::check(&self.task, &self.table) {
            panic!("after {input:?}: {violation}");
        }
        assert!(out.signals.len() <= 1, "one signal for {input:?}: {:?}", out.signals);
        packs_and_unpacks(&self.task, &self.table);
        out
    }

    pub fn ask(&mut self, request: Request) -> Effects {
        self.input(Input::Request(request))
    }

    pub fn hear(&mut self, packet: Packet) -> Effects {
        self.input(Input::Packet(packet))
    }

    pub fn pass(&mut self, ticks: u64) -> Effects {
        self.input_after(ticks, Input::Time)
    }

    /// Packs the state, reads it back and goes on from there.
    pub fn repack(&mut self) {
        self.task = packs_and_unpacks(&self.task, &self.table).expect("a state that fits its packed form");
    }

    /// The counters of a port.
    pub fn counters(&self, port: PortId) -> PortCounters {
        let view = self.task.view(&self.table, 0);
        view.ports.iter().find(|p| p.port == port).expect("a port of the task").counters
    }

    /// The waiting messages of a port in the order of service: source and remaining time.
    pub fn queue(&self, port: PortId) -> Vec<(TaskId, u64)> {
        let view = self.task.view(&self.table, usize::MAX);
        let port = view.ports.into_iter().find(|p| p.port == port).expect("a port of the task");
        port.queue.iter().map(|entry| (entry.source, entry.remaining.0)).collect()
    }
}

/// How long until time alone makes a machine act.
pub trait NextExpiry {
    fn next_expiry(&self) -> Option<Ticks>;
}

impl NextExpiry for CommTask {
    fn next_expiry(&self) -> Option<Ticks> {
        until(self.next_deadline(), self.now())
    }
}

impl NextExpiry for Transit {
    fn next_expiry(&self) -> Option<Ticks> {
        until(self.next_deadline(), self.now())
    }
}

impl NextExpiry for Timer {
    fn next_expiry(&self) -> Option<Ticks> {
        until(self.next_deadline(), self.now())
    }
}

impl NextExpiry for Node {
    fn next_expiry(&self) -> Option<Ticks> {
        self.time_left()
    }
}

fn until(deadline: Instant, now: Instant) -> Option<Ticks> {
    (deadline != Instant::NEVER).then(|| deadline - now)
}

/// Checks that a state that was packed and read back packs to the same bytes. Returns the state that was read, with its
/// original ids, or `None` if the state does not fit its packed form.
fn packs_and_unpacks(task: &CommTask, table: &NodeTable) -> Option<CommTask> {
    struct Ids(Vec<Option<Round>>, Vec<Option<Seq24>>);
    impl Walk for Ids {
        const PASS: Pass = Pass::Look;

        fn round(&mut self, port: PortId, round: &mut Round) {
            let least = &mut self.0[port.index()];
            *least = Some(least.filter(|l| round.is_newer_than(*l)).unwrap_or(*round));
        }
        fn sequence(&mut self, source: TaskId, sequence: &mut Seq24) {
            let next = &mut self.1[source.index()];
            *next = Some(next.filter(|n| n.is_newer_than(*sequence)).unwrap_or(*sequence));
        }
    }
    let mut buried = task.clone();
    buried.bury();
    let mut ids = Ids(vec![None; table.ports().len()], vec![None; table.cell().tasks.len()]);
    buried.walk(table, &mut ids);
    let rounds: Vec<Round> = ids.0.iter().map(|round| round.unwrap_or_default()).collect();
    let sequences: Vec<Seq24> = ids.1.iter().map(|next| next.unwrap_or_default()).collect();
    let frame = Frame { rounds: &rounds, sequences: &sequences, incarnations: true };
    let bytes = Encode::bytes(&frame, |w| buried.walk(table, w)).ok()?;
    let mut loaded = task.clone();
    let read = Decode::read(&bytes, true, |r| loaded.walk(table, r));
    assert_eq!(read, bytes.len(), "not all bytes were read");
    invariants::check(&loaded, table).expect("a state read back is sound");
    let home = (vec![Frame::ROUND; rounds.len()], vec![Frame::SEQUENCE; sequences.len()]);
    let frame = Frame { rounds: &home.0, sequences: &home.1, incarnations: true };
    let again = Encode::bytes(&frame, |w| loaded.walk(table, w));
    assert_eq!(again, Ok(bytes), "other bytes after reading back");
    let shift = Shift {
        rounds: rounds.iter().map(|r| r.steps_from(Frame::ROUND)).collect(),
        sequences: sequences.iter().map(|s| s.steps_from(Frame::SEQUENCE)).collect(),
        ..Shift::default()
    };
    loaded.walk(table, &mut &shift);
    Some(loaded)
}

/// The request that sends a message to one task.
pub fn send(port: PortId, to: TaskId, byte: u8) -> Request {
    Request::Send { port, to: Target::One(to), contents: contents(byte), time_out: None }
}

/// The request that sends a message to one task with a TTL of its own.
pub fn send_for(port: PortId, to: TaskId, byte: u8, ttl: u64) -> Request {
    Request::Send { port, to: Target::One(to), contents: contents(byte), time_out: Some(Ticks(ttl)) }
}

/// The request that sends a message to all tasks at the other end.
pub fn send_all(port: PortId, byte: u8) -> Request {
    Request::Send { port, to: Target::All, contents: contents(byte), time_out: None }
}

/// The request that registers a handler for a port.
pub fn handle(port: PortId) -> Request {
    Request::Handle { port, handled: true }
}

/// The request for an `order` with these entries, first to last.
pub fn order(named: &[Ranked]) -> Request {
    Request::Order(ServiceOrder::new(named).expect("few levels"))
}

/// The request for a GET over all ports with this time_out; zero polls.
pub fn get(time_out: u64) -> Request {
    Request::Get { port: None, source: None, time_out: Some(Ticks(time_out)) }
}

/// The request for a GET on one port.
pub fn get_on(port: PortId, time_out: u64) -> Request {
    Request::Get { port: Some(port), source: None, time_out: Some(Ticks(time_out)) }
}

pub fn reply(to: &Delivery, byte: u8) -> Request {
    Request::Reply { to: to.from, contents: contents(byte) }
}

pub fn arrive(port: PortId) -> Request {
    Request::Arrive { port, arguments: [0; 8], time_out: None }
}

pub fn contents(byte: u8) -> Contents {
    Contents::new(&[byte]).expect("one byte fits")
}

/// The neighbour that delivers a packet to its destination node.
pub fn neighbour_before(table: &NodeTable, packet: &Packet) -> NodeId {
    let next = |&node: &NodeId| table.next_hop(node, table.node).filter(|&next| next != table.node);
    let way = std::iter::successors(table.location(packet.source), next);
    way.last().unwrap_or(table.node)
}
