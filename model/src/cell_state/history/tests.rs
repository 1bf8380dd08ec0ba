//! Tests each rule of the history, and what breaks the rule.

use super::*;
use crate::cell_state::CellState;
use crate::cell_state::plan::{Errand, TaskPlan};
use imrs_protocol::{Cell, Contents, Incarnation, Kind, NodeId, PortDecl, Ranked, Seal, Seq24, Usage};

const WRITER: TaskId = TaskId(0);
const OTHER: TaskId = TaskId(1);
const READER: TaskId = TaskId(2);

/// Two tasks send to two ports of a third task: a class-1 port and a class-2 port.
#[derive(Clone)]
struct Bench {
    history: History,
    node_state: NodeState,
    ports: [PortId; 2],
}

impl Bench {
    fn new() -> Self {
        let mut cell = Cell::new("bench", Ticks(1));
        let node = cell.node("n");
        let [writer, other, reader] = ["writer", "other", "reader"].map(|name| cell.task(name, node));
        let senders = [writer, other];
        let port = |name| PortDecl::new(name, reader, Usage::Receive, &senders, Ticks(9)).bounded_buffer(3);
        let ports = [cell.port(port("state")), cell.port(port("move").command())];
        let table = Arc::new(CellTable::new(cell).expect("a cell"));
        let plan = Arc::new(CellScenario::new(table, vec![TaskPlan::new(Errand::Rest); 3]));
        let node_state = CellState::new(&plan).nodes.remove(0);
        let history = History::new(&plan, std::slice::from_ref(&node_state));
        Self { history, node_state, ports }
    }

    fn ask(&mut self, request: Request) -> &mut Self {
        self.history.begin(0, Ticks::ZERO, &NodeInput::Request(READER, request));
        self
    }

    fn wait(&mut self, ticks: u64) -> &mut Self {
        self.history.begin(0, Ticks(ticks), &NodeInput::Time);
        self
    }

    fn see(
        &mut self,
        event: Event,
        port: usize,
        from: TaskId,
        number: u32,
        left: u64,
    ) -> Result<(), Violation> {
        let port = self.ports[port];
        let observation = Observation { event, port, peer: from, number, remaining: Ticks(left) };
        self.history.events += 1;
        self.history.seen(0, &self.node_state, READER, &observation)
    }

    /// The judgement if this message were handed over next.
    fn would_take(&self, port: usize, from: TaskId, number: u32, left: u64) -> Result<(), Violation> {
        self.clone().see(Event::Delivered, port, from, number, left)
    }

    /// Puts these messages into a buffer. Each has a number and a time left.
    fn hold(&mut self, port: usize, from: TaskId, messages: &[(u32, u64)]) -> &mut Self {
        for &(number, left) in messages {
            self.see(Event::Enqueued, port, from, number, left).expect("a new message");
        }
        self
    }

    fn get(&mut self, port: Option<usize>, source: Option<TaskId>) -> &mut Self {
        let port = port.map(|port| self.ports[port]);
        self.ask(Request::Get { port, source, time_out: None })
    }
}

#[test]
fn a_get_takes_the_most_urgent_message_of_what_it_asks_for() {
    let mut bench = Bench::new();
    bench.hold(0, WRITER, &[(1, 5), (2, 4)]).hold(0, OTHER, &[(1, 3)]).get(Some(0), None);
    let late = bench.see(Event::Delivered, 0, WRITER, 2, 4);
    assert_eq!(late, Err(Violation::NotMostUrgent));
    let mut bench = Bench::new();
    bench.hold(0, WRITER, &[(1, 5), (2, 4)]).hold(0, OTHER, &[(1, 3)]).get(Some(0), Some(WRITER));
    assert_eq!(bench.see(Event::Delivered, 0, WRITER, 2, 4), Ok(()));
}

#[test]
fn of_equal_ones_the_lower_source_goes_first_and_then_the_earlier_arrival() {
    let mut bench = Bench::new();
    bench.hold(0, OTHER, &[(1, 5)]).hold(0, WRITER, &[(1, 5), (2, 5)]).get(Some(0), None);
    assert_eq!(bench.would_take(0, OTHER, 1, 5), Err(Violation::NotMostUrgent));
    assert_eq!(bench.would_take(0, WRITER, 2, 5), Err(Violation::NotMostUrgent));
    assert_eq!(bench.see(Event::Delivered, 0, WRITER, 1, 5), Ok(()));
}

#[test]
fn over_all_ports_the_most_urgent_head_goes_first_or_who_was_passed_over_too_often() {
    let mut bench = Bench::new();
    bench.hold(0, WRITER, &[(1, 3)]).hold(1, OTHER, &[(1, 4)]).get(None, None);
    assert_eq!(bench.would_take(1, OTHER, 1, 4), Err(Violation::NotMostUrgent));
    let passed_over = &mut bench.history.tasks[READER.index()].buffers[1].bypassed;
    passed_over.0 = passed_over.1;
    assert_eq!(bench.would_take(1, OTHER, 1, 4), Ok(()));
    assert_eq!(bench.see(Event::Delivered, 0, WRITER, 1, 3), Err(Violation::NotMostUrgent));
}

#[test]
fn a_message_is_handed_over_once() {
    let mut bench = Bench::new();
    bench.hold(1, WRITER, &[(7, 5)]);
    assert_eq!(bench.see(Event::Enqueued, 1, WRITER, 7, 5), Err(Violation::HandedOverTwice));
    assert_eq!(bench.see(Event::Delivered, 1, WRITER, 7, 5), Ok(()));
    assert_eq!(bench.see(Event::Delivered, 1, WRITER, 7, 5), Err(Violation::HandedOverTwice));
    assert_eq!(bench.see(Event::Enqueued, 1, WRITER, 7, 5), Err(Violation::HandedOverTwice));
}

#[test]
fn only_what_was_taken_in_is_a_copy() {
    let copy = Event::Discarded(Reason::Duplicate);
    let mut bench = Bench::new();
    assert_eq!(bench.see(copy, 1, WRITER, 7, 5), Err(Violation::FalseCopy));
    bench.hold(1, WRITER, &[(7, 5)]);
    assert_eq!(bench.see(copy, 1, WRITER, 7, 5), Ok(()));
    assert_eq!(bench.see(copy, 1, OTHER, 7, 5), Err(Violation::FalseCopy));
    // A copy of a command that expired before it was handed over may come once more; a copy of a status counts as seen.
    bench.wait(5);
    assert_eq!(bench.see(Event::Discarded(Reason::Expired), 1, WRITER, 7, 0), Ok(()));
    assert_eq!(bench.see(copy, 1, WRITER, 7, 2), Err(Violation::FalseCopy));
    bench.hold(0, WRITER, &[(80, 5)]).wait(5);
    assert_eq!(bench.see(Event::Discarded(Reason::Expired), 0, WRITER, 80, 0), Ok(()));
    assert_eq!(bench.see(copy, 0, WRITER, 80, 2), Ok(()));
    // A number that is too old for the dedup window counts as seen.
    assert_eq!(bench.see(copy, 0, WRITER, 15, 2), Ok(()));
    assert_eq!(bench.see(copy, 0, WRITER, 16, 2), Err(Violation::FalseCopy));
}

#[test]
fn another_incarnation_of_a_source_begins_anew() {
    let mut bench = Bench::new();
    bench.hold(1, WRITER, &[(0, 5)]);
    assert_eq!(bench.see(Event::Delivered, 1, WRITER, 0, 5), Ok(()));
    let id = MessageId { incarnation: Incarnation(1), ..MessageId::default() };
    bench.history.arriving = Some((WRITER, id));
    assert_eq!(bench.see(Event::Discarded(Reason::Duplicate), 1, WRITER, 0, 5), Err(Violation::FalseCopy));
    assert_eq!(bench.see(Event::Enqueued, 1, WRITER, 0, 5), Ok(()));
}

#[test]
fn what_expires_is_over_and_what_a_full_buffer_loses_is_the_least_urgent() {
    let mut bench = Bench::new();
    bench.hold(1, WRITER, &[(1, 5), (2, 4)]).wait(4);
    assert_eq!(bench.see(Event::Discarded(Reason::Expired), 1, WRITER, 1, 0), Err(Violation::ExpiredEarly));
    let mut bench = Bench::new();
    bench.hold(1, WRITER, &[(1, 5), (2, 4), (3, 3)]);
    let evicted = Event::Discarded(Reason::Evicted);
    assert_eq!(bench.see(evicted, 1, WRITER, 2, 4), Err(Violation::LostMoreUrgent));
    let refused = Event::Discarded(Reason::Refused);
    assert_eq!(bench.see(refused, 1, OTHER, 4, 5), Ok(()));
    assert_eq!(bench.see(refused, 1, OTHER, 5, 2), Err(Violation::LostMoreUrgent));
}

#[test]
fn a_late_copy_takes_nothing_out_of_a_buffer() {
    let mut bench = Bench::new();
    bench.hold(1, WRITER, &[(1, 5)]);
    assert_eq!(bench.see(Event::Discarded(Reason::ExpiredOnTheWay), 1, WRITER, 1, 0), Ok(()));
    assert_eq!(bench.see(Event::Discarded(Reason::Duplicate), 1, WRITER, 1, 4), Ok(()));
    assert_eq!(bench.see(Event::Delivered, 1, WRITER, 1, 5), Ok(()));
}

#[test]
fn of_messages_at_their_cap_the_one_that_was_rejected_first_begins_its_handler() {
    let mut bench = Bench::new();
    let ports = bench.ports;
    let order = ServiceOrder::new(&[Ranked::Own, Ranked::Port(ports[0]), Ranked::Port(ports[1])]);
    bench.ask(Request::Order(order.expect("an order")));
    bench.hold(0, WRITER, &[(1, 9)]).hold(0, OTHER, &[(1, 8)]);
    bench.history.tasks[READER.index()].buffers[0].handled = true;
    for source in [WRITER, OTHER] {
        bench.history.steps += 1;
        assert_eq!(bench.see(Event::Rejected, 0, source, 1, 8), Ok(()));
    }
    bench.wait(2);
    assert_eq!(bench.see(Event::Interrupted, 0, OTHER, 1, 6), Err(Violation::NotMostUrgent));
    assert_eq!(bench.see(Event::Interrupted, 0, WRITER, 1, 7), Ok(()));
}

#[test]
fn messages_that_one_step_rejects_are_rejected_first_alike() {
    let mut bench = Bench::new();
    bench.history.tasks[READER.index()].buffers.iter_mut().for_each(|buffer| buffer.handled = true);
    bench.hold(0, WRITER, &[(1, 9)]).hold(1, OTHER, &[(1, 8)]);
    bench.history.steps += 1;
    for (port, source) in [(0, WRITER), (1, OTHER)] {
        assert_eq!(bench.see(Event::Rejected, port, source, 1, 8), Ok(()));
    }
    bench.wait(2);
    assert_eq!(bench.see(Event::Interrupted, 1, OTHER, 1, 6), Ok(()), "the more urgent one of the two");
}

#[test]
fn a_message_that_this_step_rejects_goes_before_nothing_in_it() {
    let mut bench = Bench::new();
    let [a, b] = bench.ports;
    let order = ServiceOrder::new(&[Ranked::Port(a), Ranked::Own, Ranked::Port(b)]).expect("an order");
    bench.ask(Request::Order(order));
    bench.history.tasks[READER.index()].buffers.iter_mut().for_each(|buffer| buffer.handled = true);
    bench.hold(1, WRITER, &[(1, 9)]).hold(0, OTHER, &[(1, 8)]);
    for (port, source) in [(1, WRITER), (0, OTHER)] {
        bench.history.steps += 1;
        assert_eq!(bench.see(Event::Rejected, port, source, 1, 8), Ok(()));
    }
    bench.wait(2);
    bench.history.steps += 1;
    // The second rejection brings this message to its cap of two. It happens in the step that takes the other message.
    assert_eq!(bench.see(Event::Rejected, 1, WRITER, 1, 7), Ok(()));
    assert_eq!(bench.see(Event::Interrupted, 0, OTHER, 1, 6), Ok(()));
}

#[test]
fn an_evicted_message_says_nothing_of_the_incarnation_of_its_source() {
    let mut bench = Bench::new();
    let earlier = MessageId { incarnation: Incarnation(3), ..MessageId::default() };
    bench.history.arriving = Some((OTHER, earlier));
    bench.hold(1, OTHER, &[(0, 5)]);
    bench.history.arriving = None;
    assert_eq!(bench.see(Event::Discarded(Reason::Evicted), 1, OTHER, 0, 5), Ok(()));
    bench.history.arriving = Some((OTHER, earlier));
    assert_eq!(bench.see(Event::Discarded(Reason::Duplicate), 1, OTHER, 0, 4), Ok(()));
}

#[test]
fn a_packet_that_leaves_is_the_same_after_its_bytes() {
    let mut bench = Bench::new();
    let packet = Packet {
        kind: Kind::Send,
        class: Class::Command,
        more: false,
        resent: true,
        hops: 7,
        fragment: 0,
        destination: READER,
        source: WRITER,
        port: bench.ports[1],
        id: MessageId { incarnation: Incarnation(3), sequence: Seq24::new(70_000) },
        remaining: Ticks(0),
        contents: Contents::new(b"twelve bytes").expect("twelve bytes fit"),
        seal: Seal::NONE,
    };
    let mut sends = |packet| {
        let Bench { history, node_state, .. } = &mut bench;
        history.judge(0, node_state, &[Effect::Sent(NodeId(0), packet)])
    };
    for remaining in [0, 7, 10, 12_345, 400_000_000, 1 << 37, (1 << 42) - 1, 1 << 60, u64::MAX] {
        assert_eq!(sends(Packet { remaining: Ticks(remaining), ..packet }), Ok(()), "{remaining}");
    }
    // Packets with values that do not fit into their bits, or with a port that does not exist.
    for garbled in [
        Packet { hops: 8, ..packet },
        Packet { fragment: 16, ..packet },
        Packet { port: PortId(99), ..packet },
    ] {
        assert_eq!(sends(garbled), Err(Violation::Garbled), "{garbled:?}");
    }
}
