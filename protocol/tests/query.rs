//! Query and response (§4.2), replies of third parties (D11), and the dedup entry of each source on each port (D75).

use crate::support::{Solo, contents, get, get_on, handle, reply, send, send_for};
use imrs_protocol::*;
use imrs_testkit::VirtualCell;
use std::sync::Arc;

const X: TaskId = TaskId(0);
const Y: TaskId = TaskId(1);
const Z: TaskId = TaskId(2);

/// The port for queries of X and Z to Y.
const ASK: PortId = PortId(0);
/// The port for commands of X to Y.
const MOVE: PortId = PortId(1);
/// The port on which Z answers the questions of X for Y.
const FOR: PortId = PortId(2);
/// The port for status messages of X to Y, of which only the latest counts.
const SEEN: PortId = PortId(3);

fn cell() -> Cell {
    let mut cell = Cell::new("ask", Ticks(1));
    let (a, b) = (cell.node("a"), cell.node("b"));
    cell.link(a, b, Ticks(2));
    let (x, y, z) = (cell.task("x", a), cell.task("y", b), cell.task("z", b));
    cell.port(PortDecl::new("ask", y, Usage::Response, &[x, z], Ticks(20)).bounded_buffer(2));
    cell.port(PortDecl::new("move", x, Usage::Send, &[y], Ticks(30)).command());
    cell.port(PortDecl::new("for", z, Usage::Reply, &[x], Ticks(9)));
    cell.port(PortDecl::new("seen", x, Usage::Send, &[y], Ticks(30)).bounded_buffer(3).latest());
    cell
}

fn table() -> Arc<CellTable> {
    Arc::new(CellTable::new(cell()).expect("a checked cell"))
}

#[test]
fn a_query_interrupts_a_plain_receive_and_its_response_ends_it() {
    let mut net = VirtualCell::new(cell());
    net.ask(Y, handle(ASK));
    net.ask(Y, get(50));
    net.ask(X, send(ASK, Y, 3));
    net.run(3);
    let query = net.message(Y);
    net.ask(Y, reply(&query, 4));
    net.ask(Y, Request::Return);
    net.run(2);
    net.ask(X, send(MOVE, Y, 9));
    net.run(2);
    assert_eq!(
        net.transcript(),
        [
            "0 T1: accepted 0",
            "0 N0>N1 QUERY T0>T1 #0 [3] for 20",
            "2 T1: interrupt [3] from T0 for 16",
            "3 T1: accepted 1",
            "3 N1>N0 RESPONSE T1>T0 #0 [4] for 17",
            "5 T0: reply [4]",
            "5 N0>N1 SEND T0>T1 #1 [9] for 30",
            "7 T1: message [9] from T0 for 26",
        ]
    );
}

#[test]
fn the_newest_query_of_a_source_takes_the_place_of_its_older_one() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let old = x.ask(send(ASK, Y, 1)).packets[0];
    x.ask(Request::Cancel);
    let new = x.ask(send(ASK, Y, 2)).packets[0];
    let other = Solo::new(&table, Z).ask(send_for(ASK, Y, 3, 9)).packets[0];
    let mut y = Solo::new(&table, Y);
    y.hear(old);
    y.hear(other);
    let replaced = y.hear(new);
    assert_eq!(replaced.discards(), [Reason::Superseded], "each source has its own place");
    assert_eq!(y.queue(ASK).len(), 2);
    assert_eq!(y.ask(get(0)).words(), ["message [3] from T2 for 9"]);
    assert_eq!(y.ask(get(0)).words(), ["message [2] from T0 for 18"]);
}

#[test]
fn a_query_is_no_send_and_a_reply_no_response() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let query = x.ask(send(ASK, Y, 1)).packets[0];
    let mut y = Solo::new(&table, Y);
    assert_eq!(y.hear(Packet { kind: Kind::Send, ..query }).discards(), [Reason::NotAllowed]);
    let answer = Packet { kind: Kind::Reply, source: Y, destination: X, ..query };
    assert_eq!(x.hear(answer).discards(), [Reason::NotAllowed]);
    assert_eq!(x.hear(Packet { kind: Kind::Response, ..answer }).words(), ["reply [1]"]);
}

#[test]
fn what_one_port_remembers_another_does_not_forget() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let query = x.ask(send(ASK, Y, 1)).packets[0];
    x.ask(Request::Cancel);
    let command = x.ask(send(MOVE, Y, 2)).packets[0];
    let mut y = Solo::new(&table, Y);
    y.hear(query);
    let asked = y.ask(get(0)).delivery().expect("the query");
    y.hear(command);
    let told = y.ask(get(0)).delivery().expect("the command");
    // Both messages have dedup entries, and each can be answered once.
    assert_eq!(y.hear(query).discards(), [Reason::Duplicate]);
    assert_eq!(y.hear(command).discards(), [Reason::Duplicate]);
    assert_eq!(y.ask(reply(&told, 3)).words(), ["REPLY T1>T0 #1 [3] for 30", "accepted 1"]);
    assert_eq!(y.ask(reply(&asked, 4)).words(), ["RESPONSE T1>T0 #0 [4] for 20", "accepted 1"]);
    assert_eq!(y.hear(query).words(), ["RESPONSE T1>T0 #0 [4] for 20"]);
    assert_eq!(y.hear(command).words(), ["REPLY T1>T0 #1 [3] for 30"]);
}

#[test]
fn another_task_may_answer_in_place_of_the_one_that_was_asked() {
    let mut net = VirtualCell::new(cell());
    net.ask(Y, get(90));
    net.ask(X, send(MOVE, Y, 3));
    net.run(2);
    let message = net.message(Y);
    let to = ReplyTo { port: FOR, ..message.from };
    net.ask(Z, Request::Reply { to, contents: contents(8) });
    net.run(2);
    assert_eq!(net.heard(X), ["reply [8]"]);
    assert_eq!(net.heard(Z), ["accepted 1"]);
    // The answer has ended the request, so a further answer is late.
    net.ask(Z, Request::Reply { to, contents: contents(9) });
    net.run(2);
    assert_eq!(net.heard(X), Vec::<String>::new());
    assert_eq!(net.count(Event::Discarded(Reason::Unexpected)), 1);
    net.ask(Z, Request::Reply { to: ReplyTo { source: Y, ..to }, contents: contents(9) });
    assert_eq!(net.heard(Z).last().map(String::as_str), Some("fault NotAPeer"));
    net.ask(X, get_on(FOR, 0));
    net.ask(X, send(FOR, Z, 0));
    assert_eq!(net.heard(X), ["fault WrongUsage", "fault WrongUsage"]);
}

#[test]
fn only_the_latest_status_waits() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let seen: Vec<Packet> = (0..3).map(|i| x.ask(send(SEEN, Y, i)).packets[0]).collect();
    let mut y = Solo::new(&table, Y);
    y.hear(seen[0]);
    assert_eq!(y.hear(seen[2]).discards(), [Reason::Superseded]);
    let overtaken = y.hear(seen[1]);
    assert_eq!(overtaken.discards(), [Reason::Superseded]);
    assert_eq!(y.queue(SEEN).len(), 1);
    assert_eq!(y.ask(get(0)).words(), ["message [2] from T0 for 30"]);
    assert_eq!(y.counters(SEEN).dropped, 2);
}

#[test]
fn a_query_that_finds_no_place_is_refused() {
    let mut small = cell();
    small.ports[0].bounded_buffer = 1;
    let table = Arc::new(CellTable::new(small).expect("a checked cell"));
    let query = |task: TaskId, ttl| Solo::new(&table, task).ask(send_for(ASK, Y, 1, ttl)).packets[0];
    let mut y = Solo::new(&table, Y);
    y.hear(query(Z, 9));
    assert_eq!(y.hear(query(X, 20)).words(), ["REFUSED T1>T0 #0 for 20"]);
    // A more urgent query takes the place of the waiting query, whose source gets REFUSED.
    assert_eq!(
        y.hear(Packet { id: MessageId { sequence: Seq24::new(1), ..MessageId::default() }, ..query(X, 8) })
            .words(),
        ["REFUSED T1>T2 #0 for 20"]
    );
}

#[test]
fn what_can_be_answered_is_told_before_the_answer() {
    let table = table();
    let (mut x, mut y) = (Solo::new(&table, X), Solo::new(&table, Y));
    let command = x.ask(send(MOVE, Y, 1)).packets[0];
    let to = ReplyTo { port: MOVE, source: X, id: command.id };
    assert!(!y.task.can_answer(&to), "it has not come");
    y.hear(command);
    assert!(!y.task.can_answer(&to), "it has not been taken");
    let delivery = y.ask(get(0)).delivery().expect("the command");
    assert!(y.task.can_answer(&to));
    assert!(
        !y.task.can_answer(&ReplyTo { source: Z, ..to }) && !y.task.can_answer(&ReplyTo { port: SEEN, ..to })
    );
    y.ask(reply(&delivery, 2));
    assert!(!y.task.can_answer(&to), "it is answered");
    // A task that answers for another one cannot know whether the message can still be answered, so it may try.
    // A task that only sends or receives has nothing to answer.
    assert!(Solo::new(&table, Z).task.can_answer(&ReplyTo { port: FOR, ..to }));
    assert!(!x.task.can_answer(&to) && !x.task.can_answer(&ReplyTo { port: FOR, ..to }));
}
