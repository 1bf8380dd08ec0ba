//! Answers of several packets (D28): they reach the activation that asked, complete and from one task only.

use crate::support::{Effects, Solo, contents, get_on, handle, order, reply, send};
use imrs_protocol::*;
use std::sync::Arc;

const X: TaskId = TaskId(0);
const Y: TaskId = TaskId(1);

/// The port for commands of X to Y, answered in up to 2 packets.
const TEACH: PortId = PortId(0);
/// The port for status messages of Y to X, for a handler.
const HALT: PortId = PortId(1);
/// The port for answers that Z gives in the place of Y, in up to 2 packets.
const THIRD: PortId = PortId(2);

fn three() -> [Solo; 3] {
    let mut cell = Cell::new("answers", Ticks(1));
    let node = cell.node("n");
    let (x, y, z) = (cell.task("x", node), cell.task("y", node), cell.task("z", node));
    let teach = PortDecl::new("teach", y, Usage::Receive, &[x], Ticks(50)).command();
    cell.port(teach.retry(1, Ticks(20)).fragments(1, 2));
    cell.port(PortDecl::new("halt", y, Usage::Send, &[x], Ticks(50)));
    cell.port(PortDecl::new("third", z, Usage::Reply, &[x], Ticks(50)).fragments(1, 2));
    let table = Arc::new(CellTable::new(cell).expect("a checked cell"));
    [x, y, z].map(|task| Solo::new(&table, task))
}

fn part(port: PortId, byte: u8) -> Request {
    Request::Part { port, index: 1, contents: contents(byte) }
}

/// Lets Y answer the question of X with these two packets. Returns the packets.
fn teach(y: &mut Solo, question: Packet, bytes: [u8; 2]) -> Vec<Packet> {
    y.hear(question);
    let message = y.ask(get_on(TEACH, 0)).delivery().expect("the question");
    y.ask(part(TEACH, bytes[1]));
    y.ask(reply(&message, bytes[0])).packets
}

/// Lets Z answer the question in Y's place. Returns the packets.
fn third(z: &mut Solo, question: Packet, bytes: [u8; 2]) -> Vec<Packet> {
    z.ask(part(THIRD, bytes[1]));
    let to = ReplyTo { port: THIRD, source: X, id: question.id };
    z.ask(Request::Reply { to, contents: contents(bytes[0]) }).packets
}

fn rest(x: &Solo) -> Option<u8> {
    x.task.answer_fragment(TEACH, Y, 1).map(|contents| contents.as_bytes()[0])
}

/// The tasks X and Y while X waits for Y's answer: the complete answer has arrived while a handler of X ran.
fn answered_below_a_handler() -> [Solo; 2] {
    let [mut x, mut y, _] = three();
    for request in [handle(HALT), order(&[Ranked::Port(HALT), Ranked::Own])] {
        x.ask(request);
    }
    let question = x.ask(send(TEACH, Y, 1)).packets[0];
    let answer = teach(&mut y, question, [11, 12]);
    let halt = y.ask(send(HALT, X, 5)).packets[0];
    assert!(x.hear(halt).delivery().is_some());
    for packet in answer {
        assert!(x.hear(packet).is_nothing());
    }
    [x, y]
}

#[test]
fn a_handler_does_not_take_the_place_of_an_answer_that_its_thread_was_not_told() {
    let [mut x, mut y] = answered_below_a_handler();
    assert_eq!(x.ask(send(TEACH, Y, 2)).words(), ["fault Busy"], "the desk still holds the answer");
    assert_eq!(x.ask(Request::Return).words(), ["reply [11]"]);
    assert_eq!(rest(&x), Some(12));
    // The answer was delivered, so the next request drops the stored answer.
    let question = x.ask(send(TEACH, Y, 3)).packets[0];
    assert_eq!(rest(&x), None);
    let words: Vec<_> =
        teach(&mut y, question, [21, 22]).into_iter().flat_map(|p| x.hear(p).words()).collect();
    assert_eq!((words, rest(&x)), (vec!["reply [21]".to_owned()], Some(22)));
}

/// The task as it is after it was packed and read back.
fn packed(solo: &Solo) -> Solo {
    let mut task = solo.task.clone();
    task.bury();
    let sequences = [Seq24::new(100); 3];
    let frame = Frame { rounds: &[Round(0); 3], sequences: &sequences, incarnations: true };
    let bytes = Encode::bytes(&frame, |w| task.walk(&solo.table, w)).expect("it fits");
    assert_eq!(Decode::read(&bytes, true, |r| task.walk(&solo.table, r)), bytes.len());
    Solo { table: solo.table.clone(), task }
}

#[test]
fn a_packed_state_keeps_the_whole_answer_that_was_not_told() {
    let [mut x, _] = answered_below_a_handler();
    let mut back = packed(&x);
    assert_eq!(back.ask(Request::Return).words(), x.ask(Request::Return).words());
    assert_eq!((rest(&back), rest(&x)), (Some(12), Some(12)));
}

#[test]
fn what_ended_without_an_answer_below_a_handler_leaves_the_port_free() {
    let [mut x, mut y, _] = three();
    for request in [handle(HALT), order(&[Ranked::Port(HALT), Ranked::Own])] {
        x.ask(request);
    }
    x.ask(send(TEACH, Y, 1));
    let halt = y.ask(send(HALT, X, 5)).packets[0];
    x.hear(halt);
    x.pass(50);
    assert_eq!(x.ask(send(TEACH, Y, 2)).packets.len(), 1);
    x.ask(Request::Cancel);
    assert_eq!(x.ask(Request::Return).words(), ["TimedOutUnknown"]);
}

fn hear_all(x: &mut Solo, packets: &[Packet]) -> Vec<Effects> {
    packets.iter().map(|&packet| x.hear(packet)).collect()
}

#[test]
fn fragments_of_two_who_answer_make_no_message() {
    let [mut x, mut y, mut z] = three();
    let question = x.ask(send(TEACH, Y, 1)).packets[0];
    let of_y = teach(&mut y, question, [11, 12]);
    let of_z = third(&mut z, question, [21, 22]);
    let effects = hear_all(&mut x, &[of_y[0], of_z[1], of_z[0]]);
    assert!(effects.iter().all(|e| e.signals.is_empty()), "{effects:?}");
    assert_eq!(effects[1].discards(), [Reason::Unexpected]);
    let mut back = packed(&x);
    let sequence = Frame::SEQUENCE.plus(Seq24::MODULUS - 100);
    let moved = |packet: Packet| Packet { id: MessageId { sequence, ..packet.id }, ..packet };
    assert_eq!(back.hear(moved(of_z[1])).discards(), [Reason::Unexpected], "after reading back, too");
    assert_eq!(back.hear(moved(of_y[1])).words(), ["reply [11]"]);
    assert_eq!(x.hear(of_y[1]).words(), ["reply [11]"]);
    assert_eq!(rest(&x), Some(12));
}

#[test]
fn who_answers_in_one_packet_need_not_wait_for_the_rest_of_another() {
    let [mut x, mut y, mut z] = three();
    let question = x.ask(send(TEACH, Y, 1)).packets[0];
    let of_y = teach(&mut y, question, [11, 12]);
    let to = ReplyTo { port: THIRD, source: X, id: question.id };
    let of_z = z.ask(Request::Reply { to, contents: contents(21) }).packets;
    x.hear(of_y[1]);
    assert_eq!(x.hear(of_z[0]).words(), ["reply [21]"]);
    assert_eq!(rest(&x), None);
}
