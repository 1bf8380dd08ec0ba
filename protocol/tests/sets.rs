//! Class-2 messages to several tasks at once (R26, R40, D12): the sender gets one set of answers, in which each task
//! is marked as answered, refused or missing.

use crate::support::{NextExpiry, Solo, contents, get, handle, reply, send, send_all};
use imrs_protocol::*;
use imrs_testkit::VirtualCell;
use std::sync::Arc;

const P: TaskId = TaskId(0);
const A: TaskId = TaskId(1);
const B: TaskId = TaskId(2);
const C: TaskId = TaskId(3);

/// The port for queries of P to A, B and C, retransmitted once after 6 ticks.
const CHECK: PortId = PortId(0);
/// The port for commands of P to A.
const MOVE: PortId = PortId(1);

fn cell() -> Cell {
    let mut cell = Cell::new("parent", Ticks(1));
    let (n, m, o) = (cell.node("n"), cell.node("m"), cell.node("o"));
    cell.link(n, m, Ticks(1));
    cell.link(n, o, Ticks(1));
    let tasks = [cell.task("p", n), cell.task("a", m), cell.task("b", m), cell.task("c", o)];
    cell.port(PortDecl::new("check", P, Usage::Query, &tasks[1..], Ticks(20)).retry(1, Ticks(6)));
    cell.port(PortDecl::new("move", P, Usage::Send, &[A], Ticks(20)).command());
    cell
}

fn table() -> Arc<CellTable> {
    Arc::new(CellTable::new(cell()).expect("a checked cell"))
}

fn some(mask: u64) -> Request {
    Request::Send { port: CHECK, to: Target::Some(mask), contents: contents(7), time_out: None }
}

#[test]
fn all_children_are_asked_and_each_has_its_mark() {
    let mut net = VirtualCell::new(cell());
    for child in [A, B] {
        net.ask(child, handle(CHECK));
        net.ask(child, get(90));
    }
    net.lose(|_, to, packet| to == NodeId(2) && packet.kind == Kind::Query);
    net.ask(P, send_all(CHECK, 7));
    net.run(1);
    for (child, byte) in [(A, 1), (B, 2)] {
        let query = net.message(child);
        net.ask(child, reply(&query, byte));
    }
    net.run(6);
    let resent: Vec<String> = net.transcript().into_iter().filter(|line| line.contains("again")).collect();
    assert_eq!(
        resent,
        ["6 N0>N2 QUERY T0>T3 #2 [7] for 14 again LOST"],
        "only who did not answer is asked again"
    );
    net.run(20);
    assert_eq!(net.heard(P), ["answers of 0b1110: answered 0b110"]);
    let parent = net.task(P);
    let answer = |task| parent.answer_of(CHECK, task).map(|contents| contents.as_bytes()[0]);
    assert_eq!([A, B, C, P].map(answer), [Some(1), Some(2), None, None]);
}

#[test]
fn a_set_ends_with_the_last_answer() {
    let table = table();
    let mut p = Solo::new(&table, P);
    let asked = p.ask(some(0b1110)).packets;
    let ids: Vec<u32> = asked.iter().map(|packet| packet.id.sequence.get()).collect();
    assert_eq!(ids, [0, 1, 2], "an id of its own for each");
    let back = |i: usize, kind, contents| Packet {
        kind,
        source: asked[i].destination,
        destination: P,
        class: Class::Command,
        contents,
        ..asked[i]
    };
    assert_eq!(p.task.outstanding().count(), 3);
    assert!(p.hear(back(0, Kind::Response, contents(5))).signals.is_empty());
    assert_eq!(p.hear(back(0, Kind::Response, contents(6))).discards(), [Reason::Unexpected]);
    assert!(p.hear(back(1, Kind::Control, Control::Refused.to_contents())).signals.is_empty());
    // If a task answers with the id of the request to another task, the answer counts for neither of the two.
    let crossed = Packet { id: asked[2].id, ..back(1, Kind::Response, contents(9)) };
    assert_eq!(p.hear(crossed).discards(), [Reason::Unexpected]);
    assert_eq!(
        p.input(Input::PeerRestarted(NodeId(2))).words(),
        ["answers of 0b1110: answered 0b10 refused 0b100 restarted 0b1000"]
    );
    assert_eq!(p.task.answer_of(CHECK, A), Some(&contents(5)));
    assert!(p.task.is_idle());
    p.ask(some(0b1000));
    assert_eq!(p.task.answer_of(CHECK, A), None, "the next request on the port begins");
}

#[test]
fn some_are_asked_and_what_never_left_is_marked() {
    let table = table();
    let mut p = Solo::new(&table, P);
    let asked = p.ask(some(0b1010)).packets;
    assert_eq!(asked.iter().map(|packet| packet.destination).collect::<Vec<_>>(), [A, C]);
    p.input(Input::Unsent(asked[1].id));
    let again = p.pass(6);
    assert_eq!(again.packets.len(), 2);
    p.input(Input::Unsent(asked[1].id));
    let over = p.pass(14);
    assert_eq!(over.words(), ["answers of 0b1010: unsent 0b1000"]);
    assert_eq!((over.count(Event::TimedOut), over.count(Event::TimedOutUnsent)), (1, 1));
    assert_eq!(p.counters(CHECK).timed_out, 1);
}

#[test]
fn one_of_several_is_no_set() {
    let table = table();
    let mut p = Solo::new(&table, P);
    let query = p.ask(some(0b100)).packets[0];
    assert_eq!(query.destination, B);
    let answer = Packet { kind: Kind::Response, source: B, destination: P, contents: contents(4), ..query };
    assert_eq!(p.hear(answer).words(), ["reply [4]"]);
    let command = p.ask(send_all(MOVE, 1)).packets[0];
    assert_eq!(p.input(Input::PeerStopped(NodeId(1))).words(), ["PeerRestarted"]);
    assert_eq!(command.destination, A);
    assert_eq!(p.ask(some(0)).words(), ["fault NotAPeer"]);
    assert_eq!(p.ask(some(1)).words(), ["fault NotAPeer"]);
    assert_eq!(p.ask(some(0b10010)).words(), ["fault NotAPeer"]);
}

#[test]
fn a_cancelled_request_takes_no_answer() {
    let table = table();
    let mut p = Solo::new(&table, P);
    let asked = p.ask(send_all(CHECK, 1)).packets;
    assert_eq!(p.ask(Request::Cancel).words(), ["cancelled"]);
    let answer = Packet { kind: Kind::Response, source: A, destination: P, ..asked[0] };
    assert_eq!(p.hear(answer).discards(), [Reason::Unexpected]);
    assert_eq!(p.task.next_expiry(), None);
    assert_eq!(p.ask(send(MOVE, A, 1)).packets.len(), 1);
}
