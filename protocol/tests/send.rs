//! SEND, GET and REPLY between tasks (§4.1, §4.2, §5.2.1): class 1, and class 2 with each of its outcomes.

use crate::support::{self, NextExpiry, Solo, arrive, contents, get, reply, send, send_all, send_for};
use imrs_protocol::*;
use imrs_testkit::VirtualCell;
use std::sync::Arc;

const X: TaskId = TaskId(0);
const Y: TaskId = TaskId(1);
const Z: TaskId = TaskId(2);
const A: NodeId = NodeId(0);
const B: NodeId = NodeId(1);

/// The port for status messages from X to Y and Z.
const HALT: PortId = PortId(0);
/// The port for commands from X or Z to Y. Its buffer holds one message.
const MOVE: PortId = PortId(1);
/// The port for commands from X to Y or Z, retransmitted twice, 5 ticks apart.
const GRIP: PortId = PortId(2);

/// A cell with X on node A, and Y and Z on node B. The link delays a packet by at most two ticks.
fn cell() -> Cell {
    let mut cell = Cell::new("pair", Ticks(1));
    let (a, b) = (cell.node("a"), cell.node("b"));
    cell.link(a, b, Ticks(2));
    let (x, y, z) = (cell.task("x", a), cell.task("y", b), cell.task("z", b));
    cell.port(PortDecl::new("halt", x, Usage::Send, &[y, z], Ticks(20)));
    cell.port(PortDecl::new("move", y, Usage::Receive, &[x, z], Ticks(20)).command());
    cell.port(PortDecl::new("grip", x, Usage::Send, &[y, z], Ticks(20)).command().retry(2, Ticks(5)));
    cell
}

fn table() -> Arc<CellTable> {
    Arc::new(CellTable::new(cell()).expect("a checked cell"))
}

#[test]
fn status_to_all_is_a_copy_for_each_and_returns_at_once() {
    let mut net = VirtualCell::new(cell());
    net.ask(X, send_all(HALT, 7));
    assert_eq!(net.heard(X), ["accepted 2"]);
    net.ask(Y, get(9));
    net.run(2);
    net.ask(Z, get(9));
    assert_eq!(
        net.transcript(),
        [
            "0 T0: accepted 2",
            "0 N0>N1 SEND T0>T1 #0 [7] for 20",
            "0 N0>N1 SEND T0>T2 #1 [7] for 20",
            "2 T1: message [7] from T0 for 18",
            "2 T2: message [7] from T0 for 18",
        ]
    );
}

#[test]
fn status_to_one_reaches_only_that_one() {
    let mut net = VirtualCell::new(cell());
    net.ask(X, send(HALT, Z, 1));
    net.run(2);
    net.ask(Y, get(0));
    net.ask(Z, get(0));
    assert_eq!(net.heard(X), ["accepted 1"]);
    assert_eq!(net.heard(Y), ["nothing"]);
    assert_eq!(net.heard(Z), ["message [1] from T0 for 18"]);
}

#[test]
fn a_command_is_answered_with_the_way_back_reserved() {
    let mut net = VirtualCell::new(cell());
    net.ask(Y, get(9));
    net.ask(X, send(MOVE, Y, 3));
    net.run(5);
    let message = net.message(Y);
    // The execution budget is the TTL of 20 ticks, less 2 for the way there and 2 reserved for the way back (D18).
    assert_eq!((message.budget, message.class), (Ticks(16), Class::Command));
    net.ask(Y, reply(&message, 4));
    net.run(2);
    assert_eq!(
        net.transcript(),
        [
            "0 N0>N1 SEND T0>T1 #0 [3] for 20",
            "2 T1: message [3] from T0 for 16",
            "5 T1: accepted 1",
            "5 N1>N0 REPLY T1>T0 #0 [4] for 15",
            "7 T0: reply [4]",
        ]
    );
}

#[test]
fn a_reply_in_the_last_tick_of_the_budget_still_arrives_in_time() {
    let mut net = VirtualCell::new(cell());
    net.ask(Y, get(9));
    net.ask(X, send(MOVE, Y, 3));
    net.run(17);
    let message = net.message(Y);
    net.ask(Y, reply(&message, 4));
    net.run(2);
    assert_eq!(net.heard(X), ["reply [4]"]);
    assert_eq!(net.now(), 19);
}

#[test]
fn a_reply_after_the_budget_is_late_and_sends_nothing() {
    let mut net = VirtualCell::new(cell());
    net.ask(Y, get(9));
    net.ask(X, send(MOVE, Y, 3));
    net.run(18);
    let message = net.message(Y);
    net.transcript();
    for _ in 0..2 {
        net.ask(Y, reply(&message, 4));
        assert_eq!(net.transcript(), [format!("{} T1: fault Late", net.now())]);
        // Long afterwards, when the dedup entry of the message is gone, the same request still has the same
        // result.
        net.run(50);
        net.transcript();
    }
    assert_eq!(net.heard(X), ["TimedOutUnknown"]);
}

#[test]
fn a_command_without_space_is_refused_at_once() {
    let mut net = VirtualCell::new(cell());
    net.ask(X, send_for(MOVE, Y, 1, 10));
    net.run(2);
    net.ask(Z, send(MOVE, Y, 2));
    assert_eq!(net.heard(Z), ["Refused"]);
    assert_eq!(net.count(Event::Discarded(Reason::Refused)), 1);
    net.ask(Y, get(0));
    assert_eq!(net.heard(Y), ["message [1] from T0 for 6"]);
}

#[test]
fn a_command_whose_node_never_left_is_known_not_to_have_run() {
    let mut net = VirtualCell::new(cell());
    net.block(&[B]);
    net.ask(X, send(MOVE, Y, 3));
    net.run(19);
    assert_eq!(net.heard(X), Vec::<String>::new());
    net.run(1);
    assert_eq!(net.heard(X), ["TimedOutUnsent"]);
}

#[test]
fn a_lost_command_may_have_run() {
    let mut net = VirtualCell::new(cell());
    net.lose(|_, _, _| true);
    net.ask(X, send(MOVE, Y, 3));
    net.run(20);
    assert_eq!(net.transcript(), ["0 N0>N1 SEND T0>T1 #0 [3] for 20 LOST", "20 T0: TimedOutUnknown"]);
}

#[test]
fn a_retried_command_keeps_its_id_and_its_one_budget() {
    let mut net = VirtualCell::new(cell());
    net.lose(|_, _, packet| packet.kind == Kind::Send && !packet.resent);
    net.ask(Y, get(90));
    net.ask(X, send(GRIP, Y, 3));
    net.run(7);
    let message = net.message(Y);
    assert_eq!(message.budget, Ticks(11), "20 - 5 of waiting - 2 there - 2 back");
    net.ask(Y, reply(&message, 4));
    net.run(20);
    assert_eq!(
        net.transcript(),
        [
            "0 N0>N1 SEND T0>T1 #0 [3] for 20 LOST",
            "5 N0>N1 SEND T0>T1 #0 [3] for 15 again",
            "7 T1: message [3] from T0 for 11",
            "7 T1: accepted 1",
            "7 N1>N0 REPLY T1>T0 #0 [4] for 13",
            "9 T0: reply [4]",
        ]
    );
}

#[test]
fn a_command_is_sent_again_no_more_often_than_declared() {
    let mut net = VirtualCell::new(cell());
    net.lose(|_, _, _| true);
    net.ask(X, send(GRIP, Y, 3));
    net.run(40);
    assert_eq!(
        net.transcript(),
        [
            "0 N0>N1 SEND T0>T1 #0 [3] for 20 LOST",
            "5 N0>N1 SEND T0>T1 #0 [3] for 15 again LOST",
            "10 N0>N1 SEND T0>T1 #0 [3] for 10 again LOST",
            "20 T0: TimedOutUnknown",
        ]
    );
}

#[test]
fn a_late_driver_sends_again_once() {
    let mut x = Solo::new(&table(), X);
    x.ask(send(GRIP, Y, 3));
    assert_eq!(x.pass(12).words(), ["SEND T0>T1 #0 [3] for 8 again"]);
    assert_eq!(x.task.next_expiry(), Some(Ticks(5)));
    assert_eq!(x.pass(8).words(), ["TimedOutUnknown"]);
}

#[test]
fn copies_are_answered_as_the_first_one_was() {
    let table = table();
    let command = Solo::new(&table, X).ask(send(MOVE, Y, 3)).packets[0];
    let copy = |ttl| Packet { resent: true, remaining: Ticks(ttl), ..command };
    let mut y = Solo::new(&table, Y);

    y.hear(copy(18));
    let held = y.hear(copy(17));
    assert_eq!((held.words(), held.discards()), (vec![], vec![Reason::Duplicate]));
    let message = y.ask(get(0)).delivery().expect("the message");
    let running = y.hear(copy(16));
    assert_eq!((running.words(), running.discards()), (vec![], vec![Reason::Duplicate]));
    y.ask(reply(&message, 9));
    assert_eq!(y.hear(copy(12)).words(), ["REPLY T1>T0 #0 [9] for 12"]);
    assert_eq!(y.ask(reply(&message, 8)).words(), ["fault NothingToAnswer"]);
    assert_eq!(y.counters(MOVE).duplicates, 3);
    assert_eq!(y.ask(get(0)).words(), ["nothing"], "it ran once");
}

#[test]
fn a_command_is_remembered_until_no_copy_can_be_on_the_way() {
    let table = table();
    let command = Solo::new(&table, X).ask(send(MOVE, Y, 3)).packets[0];
    let mut y = Solo::new(&table, Y);
    y.ask(get(9));
    let message = y.hear(Packet { remaining: Ticks(18), ..command }).delivery().expect("the message");
    y.ask(reply(&message, 9));
    // The sender no longer waits, but a copy that was charged too little may still arrive, up to the link's bound.
    y.pass(19);
    let copy = Packet { remaining: Ticks(3), ..command };
    assert_eq!(y.hear(copy).words(), ["REPLY T1>T0 #0 [9] for 3"]);
    assert_eq!(y.ask(get(0)).words(), ["nothing"]);
}

#[test]
fn a_refusal_is_repeated_and_older_ids_are_dropped() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let old = x.ask(send(MOVE, Y, 1)).packets[0];
    x.ask(Request::Cancel);
    let new = x.ask(send(MOVE, Y, 2)).packets[0];
    let urgent = Solo::new(&table, Z).ask(send_for(MOVE, Y, 3, 5)).packets[0];

    let mut y = Solo::new(&table, Y);
    y.hear(urgent);
    assert_eq!(y.hear(new).words(), ["REFUSED T1>T0 #1 for 20"]);
    assert_eq!(y.hear(Packet { remaining: Ticks(6), ..new }).words(), ["REFUSED T1>T0 #1 for 6"]);
    let dropped = y.hear(old);
    assert_eq!((dropped.words(), dropped.discards()), (vec![], vec![Reason::Duplicate]));
}

#[test]
fn a_newer_command_withdraws_the_one_its_sender_gave_up() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let first = x.ask(send(MOVE, Y, 1)).packets[0];
    x.ask(Request::Cancel);
    let second = x.ask(send(MOVE, Y, 2)).packets[0];
    let mut y = Solo::new(&table, Y);
    y.hear(first);
    y.hear(second);
    assert_eq!(y.ask(get(0)).words(), ["message [2] from T0 for 18"]);
    assert_eq!(y.ask(get(0)).words(), ["nothing"]);
}

#[test]
fn an_answer_to_a_newer_command_than_the_one_replied_to_is_late() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let first = x.ask(send(MOVE, Y, 1)).packets[0];
    let mut y = Solo::new(&table, Y);
    y.ask(get(9));
    let message = y.hear(first).delivery().expect("the first");
    x.ask(Request::Cancel);
    y.hear(x.ask(send(MOVE, Y, 2)).packets[0]);
    assert_eq!(y.ask(reply(&message, 0)).words(), ["fault Late"]);
}

#[test]
fn a_reply_that_comes_after_the_time_out_is_dropped() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let mut y = Solo::new(&table, Y);
    y.ask(get(9));
    let message = y.hear(x.ask(send(MOVE, Y, 1)).packets[0]).delivery().expect("the command");
    let answer = y.ask(reply(&message, 2)).packets[0];
    assert_eq!(x.pass(20).words(), ["TimedOutUnknown"]);
    let late = x.hear(answer);
    assert_eq!((late.words(), late.discards()), (vec![], vec![Reason::Unexpected]));
    let other = x.ask(send(MOVE, Y, 3));
    assert_eq!(other.words(), ["SEND T0>T1 #1 [3] for 20"]);
    assert_eq!(x.hear(answer).discards(), [Reason::Unexpected], "it answers another command");
}

#[test]
fn a_refusal_on_the_way_counts_only_when_no_other_copy_left() {
    let table = table();
    let refused = |p: &Packet| Packet {
        kind: Kind::Control,
        destination: X,
        source: Y,
        contents: Control::RefusedOnTheWay.to_contents(),
        ..*p
    };
    let mut x = Solo::new(&table, X);
    let command = x.ask(send(GRIP, Y, 1)).packets[0];
    assert_eq!(x.hear(refused(&command)).words(), Vec::<String>::new(), "the copy had left this node");
    x.input(Input::Unsent(command.id));
    assert_eq!(x.hear(refused(&command)).words(), ["Refused"]);
}

#[test]
fn requests_that_do_not_fit_are_faults_and_do_nothing() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let mut z = Solo::new(&table, Z);
    let nobody = ReplyTo { port: MOVE, source: X, id: MessageId::default() };
    let cases = [
        (x.ask(send(PortId(9), Y, 0)), "fault NotYourPort"),
        (z.ask(send(HALT, X, 0)), "fault WrongUsage"),
        (x.ask(send(HALT, X, 0)), "fault NotAPeer"),
        (x.ask(support::get_on(HALT, 0)), "fault WrongUsage"),
        (z.ask(support::get_on(PortId(9), 0)), "fault NotYourPort"),
        (x.ask(arrive(HALT)), "fault WrongUsage"),
        (x.ask(Request::Reply { to: nobody, contents: contents(0) }), "fault NothingToAnswer"),
    ];
    for (effects, fault) in cases {
        assert_eq!(effects.words(), [fault]);
    }
    assert_eq!(x.ask(send(MOVE, Y, 0)).packets.len(), 1);
    assert_eq!(x.ask(send_all(HALT, 0)).words(), ["fault Busy"]);
    assert_eq!(x.ask(get(3)).words(), ["fault Busy"]);
    assert_eq!(x.ask(Request::Cancel).words(), ["cancelled"]);
    assert_eq!(x.ask(send_all(HALT, 0)).words().last().map(String::as_str), Some("accepted 2"));
}

#[test]
fn tasks_of_one_node_exchange_messages_without_a_link() {
    let mut net = VirtualCell::new(cell());
    net.ask(Y, get(9));
    net.ask(Z, send(MOVE, Y, 1));
    let message = net.message(Y);
    assert_eq!(message.budget, Ticks(20));
    net.ask(Y, reply(&message, 2));
    assert_eq!(net.heard(Z), ["reply [2]"]);
    assert!(net.transcript().iter().all(|line| !line.contains("N1>")));
    assert_eq!(net.table().path_bound(A, A), Some(Ticks::ZERO));
}

#[test]
fn a_user_re_sends_as_often_as_it_says_itself() {
    let mut cell = Cell::new("two", Ticks(1));
    let nodes = ["a", "b"].map(|name| cell.node(name));
    cell.link(nodes[0], nodes[1], Ticks(1));
    let (owner, user) = (cell.task("owner", nodes[0]), cell.task("user", nodes[1]));
    let mut port = PortDecl::new("order", owner, Usage::Receive, &[user], Ticks(20)).command();
    port.resend = Ticks(4);
    port.users[0].retry = Some(2);
    cell.port(port);
    let mut net = VirtualCell::new(cell);
    net.lose(|_, _, _| true);
    net.ask(user, send(PortId(0), owner, 1));
    net.run(20);
    let sent: Vec<_> = net.transcript().into_iter().filter(|line| line.contains("SEND")).collect();
    assert_eq!(sent.len(), 3, "{sent:?}");
}

#[test]
fn a_status_overtaken_by_more_than_the_window_counts_as_seen() {
    // A one-to-many send uses a sequence number of its source for each destination (D75).
    let overtaken = |users: usize| {
        let mut cell = Cell::new("many", Ticks(1));
        let node = cell.node("n");
        let x = cell.task("x", node);
        let all: Vec<_> = (0..users).map(|i| cell.task(&format!("y{i}"), node)).collect();
        let port = cell.port(PortDecl::new("p", x, Usage::Send, &all, Ticks(50)).bounded_buffer(4));
        let table = Arc::new(CellTable::new(cell).expect("a checked cell"));
        let (mut a, mut b) = (Solo::new(&table, x), Solo::new(&table, all[0]));
        let first = a.ask(support::send_all(port, 1)).packets[0];
        let second = a.ask(support::send_all(port, 2)).packets[0];
        b.hear(second);
        b.hear(first).discards()
    };
    assert_eq!(overtaken(64), []);
    assert_eq!(overtaken(65), [Reason::Duplicate]);
}
