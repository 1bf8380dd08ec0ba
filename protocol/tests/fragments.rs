//! Messages and answers of several packets (D28): the receiver gets all packets before the message's one deadline, or drops
//! them.

use crate::support::{Effects, NextExpiry, Solo, contents, get, reply, send, send_for};
use imrs_protocol::*;
use imrs_testkit::VirtualCell;
use std::sync::Arc;

const X: TaskId = TaskId(0);
const Y: TaskId = TaskId(1);
const Z: TaskId = TaskId(2);

/// The port for commands of X and Z to Y in up to 3 packets, answers in up to 2; retransmitted once after 8 ticks.
const TEACH: PortId = PortId(0);
/// The port for status messages of X to Y in up to 4 packets.
const TRACE: PortId = PortId(1);
/// The port for commands of X to Y in one packet.
const MOVE: PortId = PortId(2);

fn cell() -> Cell {
    let mut cell = Cell::new("long", Ticks(1));
    let (a, b) = (cell.node("a"), cell.node("b"));
    cell.link(a, b, Ticks(2));
    let (x, y, z) = (cell.task("x", a), cell.task("y", b), cell.task("z", b));
    let teach = PortDecl::new("teach", y, Usage::Receive, &[x, z], Ticks(20)).command();
    cell.port(teach.retry(1, Ticks(8)).fragments(3, 2).bounded_buffer(2));
    cell.port(PortDecl::new("trace", x, Usage::Send, &[y], Ticks(20)).fragments(4, 1).bounded_buffer(2));
    cell.port(PortDecl::new("move", x, Usage::Send, &[y], Ticks(20)).command());
    cell
}

fn table() -> Arc<CellTable> {
    Arc::new(CellTable::new(cell()).expect("a checked cell"))
}

fn part(port: PortId, index: u8, byte: u8) -> Request {
    Request::Part { port, index, contents: contents(byte) }
}

fn staged(solo: &mut Solo, port: PortId, bytes: &[u8]) -> Effects {
    for (i, &byte) in bytes.iter().enumerate().skip(1) {
        assert_eq!(solo.ask(part(port, u8::try_from(i).unwrap(), byte)).words(), ["accepted 0"]);
    }
    solo.ask(send(port, Y, bytes[0]))
}

fn bytes(solo: &Solo, fragments: u8) -> Vec<u8> {
    (0..fragments).map(|i| solo.task.fragment(i).expect("a fragment").as_bytes()[0]).collect()
}

#[test]
fn a_long_message_and_its_long_answer_arrive_whole() {
    let mut net = VirtualCell::new(cell());
    net.ask(Y, get(50));
    net.ask(X, part(TEACH, 1, 11));
    net.ask(X, part(TEACH, 2, 12));
    net.ask(X, send(TEACH, Y, 10));
    net.run(3);
    let message = net.message(Y);
    assert_eq!((message.fragments, message.budget, message.contents), (3, Ticks(16), contents(10)));
    let receiver = net.task(Y);
    let taken: Vec<_> = (0..4).map(|i| receiver.fragment(i).map(|c| c.as_bytes()[0])).collect();
    assert_eq!(taken, [Some(10), Some(11), Some(12), None]);
    net.ask(Y, part(TEACH, 1, 21));
    net.ask(Y, reply(&message, 20));
    net.run(2);
    assert_eq!(net.heard(X), ["accepted 0", "accepted 0", "reply [20]"]);
    let sender = net.task(X);
    assert_eq!(sender.answer_fragment(TEACH, Y, 1), Some(&contents(21)));
    assert_eq!(sender.answer_fragment(TEACH, Y, 2), None);
    // The answer came before 8 ticks, so nothing was retransmitted.
    net.run(10);
    assert!(net.transcript().iter().all(|line| !line.contains("again")));
}

#[test]
fn fragments_may_come_in_any_order_and_twice() {
    let table = table();
    let packets = staged(&mut Solo::new(&table, X), TEACH, &[1, 2, 3]).packets;
    let shape: Vec<_> = packets.iter().map(|p| (p.fragment, p.more, p.id.sequence.get())).collect();
    assert_eq!(shape, [(0, true, 0), (1, true, 0), (2, false, 0)]);
    let mut y = Solo::new(&table, Y);
    assert!(y.hear(packets[2]).signals.is_empty());
    assert_eq!(y.hear(packets[2]).discards(), [Reason::Duplicate]);
    y.hear(Packet { remaining: Ticks(9), ..packets[0] });
    assert_eq!(y.task.next_expiry(), Some(Ticks(7)), "the least life of all, less the way back");
    let whole = y.hear(packets[1]);
    assert_eq!(whole.count(Event::Enqueued), 1);
    assert_eq!(y.ask(get(0)).words(), ["message [1] from T0 for 7"]);
    assert_eq!(bytes(&y, 3), [1, 2, 3]);
    // These are copies of the fragments of a message that the task has already taken.
    assert_eq!(y.hear(packets[0]).discards(), [Reason::Duplicate]);
    let to = ReplyTo { port: TEACH, source: X, id: packets[0].id };
    y.ask(part(TEACH, 1, 9));
    y.ask(Request::Reply { to, contents: contents(8) });
    let copies: Vec<_> = packets.iter().flat_map(|p| y.hear(*p).words()).collect();
    assert_eq!(copies, ["REPLY T1>T0 #0 [8] for 20", "REPLY T1>T0 #0 [9] for 20"]);
}

#[test]
fn what_is_not_whole_in_time_is_dropped_whole() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let packets = staged(&mut x, TEACH, &[1, 2]).packets;
    let mut y = Solo::new(&table, Y);
    y.hear(packets[0]);
    assert_eq!(y.task.next_expiry(), Some(Ticks(18)));
    let over = y.pass(18);
    assert_eq!(over.discards(), [Reason::Incomplete]);
    // A newer message of the source, long or short, replaces a message that is not complete.
    for newer in [&[3_u8, 4, 5][..], &[6]] {
        x.ask(Request::Cancel);
        let old = staged(&mut x, TEACH, &[1, 2]).packets;
        x.ask(Request::Cancel);
        let new = staged(&mut x, TEACH, newer).packets;
        y.hear(old[0]);
        assert_eq!(y.hear(new[0]).discards(), [Reason::Incomplete]);
        if newer.len() > 1 {
            assert_eq!(y.hear(old[1]).discards(), [Reason::Incomplete]);
        }
        new[1..].iter().for_each(|packet| drop(y.hear(*packet)));
        let got = y.ask(get(0)).delivery().expect("the newer one");
        assert_eq!((got.contents.as_bytes()[0], usize::from(got.fragments)), (newer[0], newer.len()));
    }
}

#[test]
fn a_request_and_an_answer_keep_to_their_formats() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let cases = [
        (x.ask(part(MOVE, 1, 0)), "fault WrongLength"),
        (x.ask(part(TEACH, 3, 0)), "fault WrongLength"),
        (x.ask(part(TEACH, 0, 0)), "fault WrongLength"),
        (x.ask(part(PortId(9), 1, 0)), "fault NotYourPort"),
        (x.ask(part(TEACH, 2, 0)), "accepted 0"),
        (x.ask(send(TEACH, Y, 0)), "fault WrongLength"),
    ];
    for (effects, expected) in cases {
        assert_eq!(effects.words(), [expected]);
    }
    // After the refused send no fragment stays staged.
    let one = x.ask(send(TEACH, Y, 5)).packets;
    assert_eq!((one.len(), one[0].more), (1, false));
    let mut y = Solo::new(&table, Y);
    y.hear(one[0]);
    let message = y.ask(get(0)).delivery().expect("the message");
    assert_eq!(message.fragments, 1);
    assert_eq!(y.ask(part(TEACH, 2, 0)).words(), ["fault WrongLength"], "an answer takes two packets");
    // Packets beyond the declared number of fragments are not allowed.
    let forged =
        [(3, false), (2, true), (15, true)].map(|(fragment, more)| Packet { fragment, more, ..one[0] });
    forged.iter().for_each(|packet| assert_eq!(y.hear(*packet).discards(), [Reason::NotAllowed]));
    let answer = y.ask(reply(&message, 1)).packets[0];
    assert_eq!(x.hear(Packet { fragment: 2, ..answer }).discards(), [Reason::NotAllowed]);
    assert_eq!(x.hear(Packet { more: true, ..answer }).words(), Vec::<String>::new());
    assert_eq!(x.hear(Packet { more: true, ..answer }).discards(), [Reason::Duplicate]);
    assert_eq!(x.hear(answer).discards(), [Reason::Incomplete], "it cannot end where another one follows");
}

#[test]
fn fragments_of_a_message_that_is_not_sent_do_not_join_the_next_one() {
    let mut x = Solo::new(&table(), X);
    x.ask(part(TRACE, 1, 11));
    assert_eq!(x.ask(part(TRACE, 4, 14)).words(), ["fault WrongLength"]);
    assert_eq!(x.ask(send(TRACE, Y, 20)).packets.len(), 1, "after a fault");
    x.ask(part(TRACE, 1, 11));
    x.ask(Request::Abandon);
    assert_eq!(x.ask(send(TRACE, Y, 30)).packets.len(), 1, "after the task began anew");
}

#[test]
fn a_copy_counts_as_sent_while_any_packet_of_it_left() {
    let table = table();
    let unsent = |times: usize| {
        let mut x = Solo::new(&table, X);
        let packets = staged(&mut x, TEACH, &[1, 2]).packets;
        let again = x.pass(8).packets;
        assert_eq!((packets.len(), again.len(), again[1].resent), (2, 2, true));
        for _ in 0..times {
            x.input(Input::Unsent(packets[0].id));
        }
        x.pass(12).words()
    };
    assert_eq!(unsent(3), ["TimedOutUnknown"]);
    assert_eq!(unsent(4), ["TimedOutUnsent"]);
}

#[test]
fn long_status_waits_in_the_buffer_with_all_its_fragments() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let mut y = Solo::new(&table, Y);
    let first = staged(&mut x, TRACE, &[1, 2, 3, 4]).packets;
    let second = staged(&mut x, TRACE, &[5, 6]).packets;
    let mixed = [first[0], second[0], first[1], second[1], first[2], first[3]];
    // The second message is complete first. It has overtaken the first message, whose other fragments come too late.
    let drops: Vec<_> = mixed.iter().flat_map(|p| y.hear(*p).discards()).collect();
    assert_eq!(drops.first(), Some(&Reason::Incomplete));
    first.iter().for_each(|packet| drop(y.hear(*packet)));
    let urgent = {
        x.ask(part(TRACE, 1, 8));
        x.ask(send_for(TRACE, Y, 7, 5)).packets
    };
    urgent.iter().for_each(|packet| drop(y.hear(*packet)));
    assert_eq!(y.queue(TRACE).len(), 2, "the buffer is full");
    let served: Vec<_> = (0..2)
        .map(|_| {
            let message = y.ask(get(0)).delivery().expect("a message");
            bytes(&y, message.fragments)
        })
        .collect();
    assert_eq!(served, [vec![7, 8], vec![5, 6]]);
    assert_eq!(y.task.fragment(2), None);
}

#[test]
fn a_restarted_task_turns_a_long_command_away_once() {
    let table = table();
    let packets = staged(&mut Solo::new(&table, X), TEACH, &[1, 2, 3]).packets;
    let mut y = Solo::incarnation(&table, Y, 1, true);
    let words: Vec<_> = packets.iter().flat_map(|p| y.hear(*p).words()).collect();
    assert_eq!(words, ["RESTARTED T1>T0 #0 for 20"]);
}

#[test]
fn two_sources_put_their_messages_together_side_by_side() {
    let table = table();
    let ours = staged(&mut Solo::new(&table, X), TEACH, &[1, 2]).packets;
    let theirs = staged(&mut Solo::new(&table, Z), TEACH, &[3, 4]).packets;
    let mut y = Solo::new(&table, Y);
    [ours[0], theirs[0], ours[1], theirs[1]].iter().for_each(|packet| drop(y.hear(*packet)));
    for expected in [[1, 2], [3, 4]] {
        let message = y.ask(get(0)).delivery().expect("a message");
        // Y and Z share a node, so no time for a way back is reserved for messages of Z: the message of X is the more
        // urgent one.
        assert_eq!(bytes(&y, message.fragments), expected);
    }
}

#[test]
fn a_fragment_of_an_older_message_does_not_disturb_a_newer_one() {
    let table = table();
    for (port, class) in [(TRACE, Class::Status), (TEACH, Class::Command)] {
        let mut x = Solo::new(&table, X);
        let old = staged(&mut x, port, &[1, 2]).packets;
        x.ask(Request::Cancel);
        let new = staged(&mut x, port, &[3, 4]).packets;
        assert_eq!(new[0].class, class);
        let mut y = Solo::new(&table, Y);
        y.hear(new[1]);
        assert!(old.iter().all(|&packet| y.hear(packet).signals.is_empty()));
        assert_eq!(y.queue(port), [], "neither is whole");
        y.hear(new[0]);
        let got = y.ask(get(0)).delivery().expect("the newer one");
        assert_eq!((got.contents, got.fragments, bytes(&y, 2)), (contents(3), 2, vec![3, 4]));
        assert_eq!(y.ask(get(0)).words(), ["nothing"]);
    }
}

#[test]
fn a_fragment_beyond_the_declared_ones_breaks_nothing() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let packets = staged(&mut x, TRACE, &[1, 2]).packets;
    let mut y = Solo::new(&table, Y);
    y.hear(packets[0]);
    // This last fragment has a wrong position.
    let beyond = Packet { fragment: 9, more: false, ..packets[1] };
    assert!(!y.hear(beyond).discards().is_empty());
    y.hear(packets[1]);
    assert_eq!(y.ask(get(0)).words(), ["message [1] from T0 for 20"]);
}
