//! Nothing on the message path allocates after `new` (§5.2.3: no run-time allocation; D15).

use crate::allocations;
use imrs_protocol::*;
use std::sync::Arc;

const ARM: TaskId = TaskId(0);
const HOIST: TaskId = TaskId(1);
const N0: NodeId = NodeId(0);
const N1: NodeId = NodeId(1);
const MOVE: PortId = PortId(0);
const HEARTBEAT: PortId = PortId(1);
const LIFT: PortId = PortId(2);
const ASK: PortId = PortId(3);
const CHECK: PortId = PortId(4);

fn cell() -> Cell {
    let mut cell = Cell::new("two", Ticks(1));
    let (a, b) = (cell.node("a"), cell.node("b"));
    cell.link(a, b, Ticks(1));
    let (arm, hoist) = (cell.task("arm", a), cell.task("hoist", b));
    cell.port(PortDecl::new("move", arm, Usage::Send, &[hoist], Ticks(50)).command().retry(3, Ticks(4)));
    cell.port(PortDecl::new("beat", arm, Usage::Send, &[hoist], Ticks(50)).bounded_buffer(2));
    cell.port(PortDecl::new("lift", arm, Usage::Waitfor, &[hoist], Ticks(50)).resend(Ticks(4), 2));
    let ask = PortDecl::new("ask", hoist, Usage::Response, &[arm], Ticks(50));
    cell.port(ask.penalty(Ticks(2)).fragments(4, 3).bounded_buffer(2));
    let other = cell.task("other", b);
    cell.port(PortDecl::new("check", arm, Usage::Query, &[hoist, other], Ticks(50)).retry(1, Ticks(5)));
    cell
}

/// An outbox that stores the effects of a step in arrays of fixed size.
struct Room {
    packets: [Option<(NodeId, Packet)>; 16],
    signals: [Option<Signal>; 16],
    ready: bool,
}

impl NodeOutbox for Room {
    fn ready(&mut self, _: NodeId) -> bool {
        self.ready
    }
    fn link(&mut self, next: NodeId, packet: Packet) {
        *self.packets.iter_mut().find(|slot| slot.is_none()).expect("room") = Some((next, packet));
    }
    fn signal(&mut self, _: TaskId, signal: Signal) {
        *self.signals.iter_mut().find(|slot| slot.is_none()).expect("room") = Some(signal);
    }
}

struct Pair {
    nodes: [Node; 2],
    room: Room,
}

impl Pair {
    fn new() -> Self {
        let table = Arc::new(CellTable::new(cell()).expect("a checked cell"));
        let node = |n| Node::new(NodeTable::new(Arc::clone(&table), n), Incarnation(0), false, 4);
        Self {
            nodes: [node(N0), node(N1)],
            room: Room { packets: [None; 16], signals: [None; 16], ready: true },
        }
    }

    /// Gives a node an input, and delivers every packet that follows from it.
    fn step(&mut self, at: NodeId, input: NodeInput) {
        self.step_after(0, at, input);
    }

    fn step_after(&mut self, ticks: u64, at: NodeId, input: NodeInput) {
        let node = &mut self.nodes[at.index()];
        node.step(node.now() + Ticks(ticks), input, &mut self.room);
        while let Some(slot) = self.room.packets.iter_mut().find(|slot| slot.is_some()) {
            let (to, packet) = slot.take().expect("some");
            let from = NodeId::from_index(1 - to.index());
            let input = NodeInput::Packet { from, packet, charge: Ticks(1) };
            let node = &mut self.nodes[to.index()];
            node.step(node.now(), input, &mut self.room);
        }
    }

    fn ask(&mut self, task: TaskId, request: Request) {
        self.step(NodeId(task.0.min(1)), NodeInput::Request(task, request));
    }

    fn pass(&mut self, ticks: u64) {
        self.step_after(ticks, N0, NodeInput::Time);
        self.step_after(ticks, N1, NodeInput::Time);
    }

    fn told(&mut self, wanted: impl Fn(&Signal) -> bool) -> Signal {
        let found = self.room.signals.iter().flatten().find(|s| wanted(s)).copied();
        self.room.signals = [None; 16];
        found.expect("the signal")
    }
}

/// Exercises handlers, rejections, fragments, answer sets and timers.
fn interrupt(pair: &mut Pair, contents: Contents) {
    let ask = Request::Send { port: ASK, to: Target::One(HOIST), contents, time_out: None };
    let order = [Ranked::Timers, Ranked::Own, Ranked::Port(ASK)];
    pair.ask(HOIST, Request::Order(ServiceOrder::new(&order).expect("few levels")));
    pair.ask(HOIST, Request::Handle { port: ASK, handled: true });
    pair.ask(HOIST, Request::Start { id: TimeId(7), length: Ticks(3) });
    pair.ask(HOIST, Request::Work);
    for index in 1..4 {
        pair.ask(ARM, Request::Part { port: ASK, index, contents });
    }
    pair.ask(ARM, ask);
    // The timer interrupts first, then the message, after enough rejections. No handler runs when the message's answer
    // comes.
    pair.pass(3);
    pair.told(|s| matches!(s, Signal::Interrupt(Call::Timer(_))));
    pair.ask(HOIST, Request::Return);
    pair.pass(2);
    let Signal::Interrupt(Call::Message(query)) = pair.told(|s| matches!(s, Signal::Interrupt(_))) else {
        return;
    };
    pair.ask(HOIST, Request::Part { port: ASK, index: 1, contents });
    pair.ask(HOIST, Request::Reply { to: query.from, contents });
    pair.told(|s| matches!(s, Signal::Outcome(Outcome::Reply(_))));
    pair.ask(HOIST, Request::Return);
    pair.ask(HOIST, Request::Done);
    // One of the two tasks answers, the other one never does.
    pair.ask(ARM, Request::Send { port: CHECK, to: Target::All, contents, time_out: None });
    pair.ask(HOIST, Request::Get { port: Some(CHECK), source: None, time_out: Some(Ticks(9)) });
    let Signal::Message(check) = pair.told(|s| matches!(s, Signal::Message(_))) else { return };
    pair.ask(HOIST, Request::Reply { to: check.from, contents });
    pair.pass(5);
    pair.pass(50);
    pair.told(|s| matches!(s, Signal::Answers { .. }));
    pair.ask(HOIST, Request::Abandon);
    pair.room.signals = [None; 16];
}

/// Exercises every kind of message path once.
fn exercise(pair: &mut Pair, contents: Contents) {
    let command = Request::Send { port: MOVE, to: Target::One(HOIST), contents, time_out: None };
    let status = Request::Send { port: HEARTBEAT, to: Target::All, contents, time_out: None };
    let get = Request::Get { port: None, source: None, time_out: Some(Ticks(20)) };
    let arrive = Request::Arrive { port: LIFT, arguments: [1; 8], time_out: None };

    // A send, a receive and a reply. The message waits in the bounded buffer, because it arrives before the task receives.
    pair.ask(ARM, command);
    pair.ask(HOIST, get);
    let Signal::Message(message) = pair.told(|s| matches!(s, Signal::Message(_))) else { return };
    pair.ask(HOIST, Request::Reply { to: message.from, contents });
    pair.told(|s| matches!(s, Signal::Outcome(Outcome::Reply(_))));
    interrupt(pair, contents);
    // Status messages are sent until the buffer evicts some of them. Then the others expire.
    for _ in 0..4 {
        pair.ask(ARM, status);
    }
    pair.pass(60);
    pair.room.signals = [None; 16];
    // A rendezvous, with copies of the arrival and of the CONFIRM.
    pair.ask(ARM, arrive);
    pair.pass(3);
    pair.ask(HOIST, arrive);
    pair.told(|s| matches!(s, Signal::Released { .. }));
    pair.pass(4);
    pair.pass(4);
    // The arm waits for the hoist, which does not arrive, and gives up.
    pair.ask(ARM, arrive);
    pair.pass(50);
    pair.told(|s| matches!(s, Signal::GaveUp { .. }));
    // Packets wait in the transit buffer, overflow it and expire. Then a command is retransmitted and never answered.
    pair.room.ready = false;
    for _ in 0..6 {
        pair.ask(ARM, status);
    }
    pair.ask(ARM, command);
    pair.pass(9);
    pair.pass(50);
    pair.told(|s| matches!(s, Signal::Outcome(Outcome::TimedOutUnsent)));
    pair.room.ready = true;
    // A delay, and a task whose clock is set back to zero.
    pair.ask(ARM, Request::Delay { id: TimeId(1), length: Ticks(5) });
    pair.pass(5);
    pair.told(|s| matches!(s, Signal::TimeOut(_)));
    for node in &mut pair.nodes {
        let parts = node.parts_mut();
        parts.tasks.iter_mut().for_each(|task| task.rebase(&parts.table));
        parts.transit.rebase(&parts.table);
        parts.timer.rebase();
    }
}

#[test]
fn the_message_path_allocates_nothing() {
    let mut pair = Pair::new();
    let contents = Contents::new(b"abc").expect("short");
    // The first handler of a port allocates the heap for the order of the port's offers (D108).
    exercise(&mut pair, contents);
    let before = allocations();
    for _ in 0..50 {
        exercise(&mut pair, contents);
    }
    assert_eq!(allocations() - before, 0, "allocations after `new`");
    let seen = pair.nodes[0].parts().transit.view();
    assert!(seen.forwarded > 500 && seen.discarded.iter().sum::<u64>() > 100, "{seen:?}");
}

#[test]
fn loading_a_state_in_place_allocates_nothing() {
    let mut pair = Pair::new();
    exercise(&mut pair, Contents::EMPTY);
    let table = pair.nodes[0].parts().table.clone();
    let task = &mut pair.nodes[0].parts_mut().tasks[0];
    let home = ([Frame::ROUND; 5], [Seq24::new(0); 3]);
    let frame = Frame { rounds: &home.0, sequences: &home.1, incarnations: false };
    // The ids of this frame are far from those of the state, so the packed form has no room for the
    // differences. Packing is an error, and no value saturates.
    assert_eq!(Encode::bytes(&frame, |w| task.walk(&table, w)), Err(Overflow));
    let before = allocations();
    Decode::read(&[0; 64], false, |r| task.walk(&table, r));
    invariants::check(task, &table).expect("an empty state");
    assert_eq!(allocations() - before, 0);
}
