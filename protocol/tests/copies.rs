//! Copies of one command that were charged different link delays (D5, D20, D52): no command runs twice, and none is lost
//! while a copy of it has time left.

use crate::support::{NextExpiry, Solo, contents, get, reply, send};
use imrs_protocol::*;
use std::sync::Arc;

const X: TaskId = TaskId(0);
const Y: TaskId = TaskId(1);
/// The port for commands of X to Y, retransmitted once after 10 ticks; in up to 2 packets.
const GO: PortId = PortId(0);

/// The tasks X and Y on two nodes, whose link delays a packet by at most two ticks, and two copies of a command of X. The
/// first copy was delayed: it has 4 ticks left, and its answer takes 2.
fn two_copies() -> (Solo, Solo, [Packet; 2]) {
    let mut cell = Cell::new("copies", Ticks(1));
    let (n, m) = (cell.node("n"), cell.node("m"));
    cell.link(n, m, Ticks(2));
    let (x, y) = (cell.task("x", n), cell.task("y", m));
    let go = PortDecl::new("go", x, Usage::Send, &[y], Ticks(40)).command();
    cell.port(go.retry(1, Ticks(10)).fragments(2, 1).bounded_buffer(2));
    let table = Arc::new(CellTable::new(cell).expect("a checked cell"));
    let (mut x, y) = (Solo::new(&table, X), Solo::new(&table, Y));
    let first = x.ask(send(GO, Y, 1)).packets[0];
    let second = x.pass(10).packets[0];
    (x, y, [Packet { remaining: Ticks(4), ..first }, Packet { remaining: Ticks(28), ..second }])
}

fn left(solo: &mut Solo) -> Option<Ticks> {
    solo.ask(get(0)).delivery().map(|message| message.budget)
}

#[test]
fn a_copy_with_time_left_takes_the_place_of_one_that_expired_unheard() {
    let (_, mut y, [first, second]) = two_copies();
    y.hear(first);
    assert_eq!(y.pass(2).discards(), [Reason::Expired]);
    assert!(y.hear(second).discards().is_empty());
    assert_eq!(left(&mut y), Some(Ticks(26)));
    // The command has run: no copy of it runs again, neither before nor after the answer.
    assert_eq!(y.hear(second).discards(), [Reason::Duplicate]);
    let to = ReplyTo { port: GO, source: X, id: first.id };
    y.ask(Request::Reply { to, contents: contents(7) });
    assert_eq!(y.hear(second).words(), ["REPLY T1>T0 #0 [7] for 28"]);
    assert_eq!(left(&mut y), None);
}

#[test]
fn a_copy_prolongs_the_one_that_waits() {
    let (_, mut y, [first, second]) = two_copies();
    y.hear(first);
    assert_eq!(y.hear(second).discards(), [Reason::Duplicate]);
    assert_eq!(y.hear(first).discards(), [Reason::Duplicate], "and never shortens it");
    assert_eq!(y.task.next_expiry(), Some(Ticks(26)));
    let message = y.ask(get(0)).delivery().expect("the command");
    assert_eq!(message.budget, Ticks(26));
    assert_eq!(y.ask(reply(&message, 7)).words(), ["REPLY T1>T0 #0 [7] for 28", "accepted 1"]);
}

#[test]
fn an_older_command_stays_over_when_a_newer_one_expired_unheard() {
    let (mut x, mut y, [first, second]) = two_copies();
    y.hear(first);
    assert_eq!(left(&mut y), Some(Ticks(2)));
    x.ask(Request::Cancel);
    let newer = x.ask(send(GO, Y, 2)).packets[0];
    y.hear(Packet { remaining: Ticks(3), ..newer });
    assert_eq!(y.pass(1).discards(), [Reason::Expired]);
    assert_eq!(y.hear(second).discards(), [Reason::Duplicate], "it ran");
    assert_eq!(left(&mut y), None);
    y.hear(newer);
    assert_eq!(left(&mut y), Some(Ticks(38)));
}

#[test]
fn a_packed_state_knows_what_expired_unheard() {
    let (_, mut y, [first, second]) = two_copies();
    y.hear(first);
    y.pass(2);
    y.task.bury();
    let sequences = [Frame::SEQUENCE; 2];
    let frame = Frame { rounds: &[Round(0)], sequences: &sequences, incarnations: false };
    let id = MessageId { sequence: Frame::SEQUENCE.plus(Seq24::MODULUS - 1), ..first.id };
    let mut task = CommTask::new(&y.table, Y, Incarnation(0), false);
    let mut other = Solo { table: y.table.clone(), task: task.clone() };
    other.hear(Packet { id, ..first });
    other.pass(2);
    let bytes = Encode::bytes(&frame, |w| other.task.walk(&y.table, w)).expect("it fits");
    assert_eq!(Decode::read(&bytes, false, |r| task.walk(&y.table, r)), bytes.len());
    let mut back = Solo { table: y.table.clone(), task };
    assert!(back.hear(Packet { id, ..second }).discards().is_empty());
    assert_eq!(left(&mut back), Some(Ticks(26)));
}

#[test]
fn a_long_command_is_put_together_again_when_it_expired_unheard() {
    let (mut x, mut y, _) = two_copies();
    x.ask(Request::Cancel);
    x.ask(Request::Part { port: GO, index: 1, contents: contents(2) });
    let first = x.ask(send(GO, Y, 1)).packets;
    let again = x.pass(10).packets;
    for packet in first {
        y.hear(Packet { remaining: Ticks(4), ..packet });
    }
    y.pass(2);
    for packet in again {
        assert!(y.hear(Packet { remaining: Ticks(20), ..packet }).discards().is_empty());
    }
    let message = y.ask(get(0)).delivery().expect("the command");
    assert_eq!((message.budget, message.fragments), (Ticks(18), 2));
}
