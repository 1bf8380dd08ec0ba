//! The bounded_buffer of a port (§5.1.1) and the service order (R68, D14), expiry (D23) and eviction (D60).

use crate::support::{NextExpiry, Solo, get, get_on, send, send_for};
use imrs_protocol::*;
use proptest::prelude::*;
use std::sync::Arc;

/// The receiver in these tests. Three senders are on its node.
const R: TaskId = TaskId(0);
const A: TaskId = TaskId(1);
const B: TaskId = TaskId(2);
const C: TaskId = TaskId(3);

/// A port for status messages to R; its buffer holds two.
const HEARTBEAT: PortId = PortId(0);
/// The port for commands to R; its buffer holds two.
const MOVE: PortId = PortId(1);
/// Another port for status messages to R; its buffer holds two.
const HALT: PortId = PortId(2);

fn table() -> Arc<CellTable> {
    let mut cell = Cell::new("one node", Ticks(1));
    let node = cell.node("n");
    for name in ["r", "a", "b", "c"] {
        cell.task(name, node);
    }
    let port = |name: &str| PortDecl::new(name, R, Usage::Receive, &[A, B, C], Ticks(50)).bounded_buffer(2);
    cell.port(port("beat"));
    cell.port(port("move").command());
    cell.port(port("halt"));
    Arc::new(CellTable::new(cell).expect("a checked cell"))
}

struct Room {
    r: Solo,
    senders: Vec<Solo>,
}

impl Room {
    fn new() -> Self {
        let table = table();
        Self { r: Solo::new(&table, R), senders: [A, B, C].map(|t| Solo::new(&table, t)).into() }
    }

    fn packet(&mut self, port: PortId, from: TaskId, byte: u8, ttl: u64) -> Packet {
        let sender = &mut self.senders[from.index() - 1];
        let packet = sender.ask(send_for(port, R, byte, ttl)).packets[0];
        sender.ask(Request::Cancel);
        packet
    }

    /// Lets a message from the task `from` arrive. Returns in words what the receiver does.
    fn put(&mut self, port: PortId, from: TaskId, byte: u8, ttl: u64) -> Vec<String> {
        let packet = self.packet(port, from, byte, ttl);
        self.r.hear(packet).words()
    }

    /// Empties the buffers. Returns the contents in the order of service.
    fn served(&mut self) -> Vec<u8> {
        std::iter::from_fn(|| self.r.ask(get(0)).delivery().map(|d| d.contents.as_bytes()[0])).collect()
    }
}

#[test]
fn a_message_is_handed_over_at_once_or_stored() {
    let mut room = Room::new();
    room.r.ask(get(9));
    assert_eq!(room.put(HEARTBEAT, A, 1, 10), ["message [1] from T1 for 10"]);
    assert_eq!(room.put(HEARTBEAT, A, 2, 10), Vec::<String>::new());
    assert_eq!(room.r.queue(HEARTBEAT), [(A, 10)]);
    room.r.pass(4);
    assert_eq!(room.r.ask(get(9)).words(), ["message [2] from T1 for 6"]);
    let counters = room.r.counters(HEARTBEAT);
    assert_eq!((counters.enqueued, counters.delivered), (2, 2));
}

#[test]
fn the_smallest_time_out_goes_first_over_all_ports() {
    let mut room = Room::new();
    room.put(HEARTBEAT, A, 3, 30);
    room.put(HALT, B, 1, 10);
    room.put(HEARTBEAT, C, 4, 40);
    room.put(MOVE, A, 2, 20);
    assert_eq!(room.served(), [1, 2, 3, 4]);
}

#[test]
fn ties_go_by_class_then_order_then_port_then_source_then_arrival() {
    let mut room = Room::new();
    room.put(HALT, A, 4, 20);
    room.put(HEARTBEAT, B, 3, 20);
    room.put(HEARTBEAT, A, 2, 20);
    room.put(MOVE, C, 1, 20);
    assert_eq!(room.served(), [1, 2, 3, 4], "class, port, source");

    room.put(HALT, A, 2, 20);
    room.put(HEARTBEAT, A, 3, 20);
    room.put(MOVE, A, 1, 20);
    room.r.ask(Request::Order(
        ServiceOrder::new(&[Ranked::Port(HALT), Ranked::Port(HEARTBEAT)]).expect("two levels"),
    ));
    assert_eq!(room.served(), [1, 2, 3], "class before `order` before port");

    room.put(HEARTBEAT, A, 1, 20);
    room.put(HEARTBEAT, A, 2, 20);
    assert_eq!(room.served(), [1, 2], "arrival");
}

#[test]
fn a_new_order_counts_for_what_waits_already() {
    let mut room = Room::new();
    room.put(HEARTBEAT, A, 2, 20);
    room.put(HALT, A, 1, 20);
    room.r.ask(Request::Order(ServiceOrder::new(&[Ranked::Port(HALT)]).expect("one level")));
    assert_eq!(room.served(), [1, 2]);
}

#[test]
fn order_never_overrules_a_deadline() {
    let mut room = Room::new();
    room.r.ask(Request::Order(ServiceOrder::new(&[Ranked::Port(HALT)]).expect("one level")));
    room.put(HALT, A, 2, 21);
    room.put(HEARTBEAT, A, 1, 20);
    assert_eq!(room.served(), [1, 2]);
}

#[test]
fn get_can_name_a_source_or_a_port() {
    let mut room = Room::new();
    room.put(HEARTBEAT, A, 1, 10);
    room.put(HEARTBEAT, B, 2, 20);
    room.put(HALT, B, 3, 15);
    let of_b = Request::Get { port: None, source: Some(B), time_out: Some(Ticks(0)) };
    assert_eq!(room.r.ask(of_b).words(), ["message [3] from T2 for 15"]);
    let heartbeat_of_b = Request::Get { port: Some(HEARTBEAT), source: Some(B), time_out: Some(Ticks(0)) };
    assert_eq!(room.r.ask(heartbeat_of_b).words(), ["message [2] from T2 for 20"]);
    assert_eq!(room.r.ask(get_on(HALT, 0)).words(), ["nothing"]);
    assert_eq!(room.r.ask(get_on(HEARTBEAT, 0)).words(), ["message [1] from T1 for 10"]);
}

#[test]
fn a_waiting_get_takes_only_what_it_asked_for() {
    let mut room = Room::new();
    room.r.ask(Request::Get { port: Some(HALT), source: Some(B), time_out: Some(Ticks(30)) });
    assert_eq!(room.put(HEARTBEAT, B, 1, 20), Vec::<String>::new());
    assert_eq!(room.put(HALT, A, 2, 20), Vec::<String>::new());
    assert_eq!(room.put(HALT, B, 3, 20), ["message [3] from T2 for 20"]);
    assert_eq!(room.served(), [1, 2]);
}

#[test]
fn a_get_ends_with_nothing_and_a_zero_time_out_polls() {
    let mut r = Solo::new(&table(), R);
    assert_eq!(r.ask(get(0)).words(), ["nothing"]);
    r.ask(get(5));
    assert_eq!(r.task.next_expiry(), Some(Ticks(5)));
    assert!(r.pass(4).is_nothing());
    assert_eq!(r.pass(1).words(), ["nothing"]);
    r.ask(Request::Get { port: None, source: None, time_out: None });
    assert_eq!(r.task.next_expiry(), None);
    assert!(r.pass(u64::MAX / 4).is_nothing());
    assert_eq!(r.ask(Request::Cancel).words(), ["cancelled"]);
}

#[test]
fn a_message_with_no_time_left_is_removed_and_never_delivered() {
    let mut room = Room::new();
    room.put(HEARTBEAT, A, 1, 10);
    room.put(HEARTBEAT, B, 2, 11);
    assert_eq!(room.r.task.next_expiry(), Some(Ticks(10)));
    room.r.pass(9);
    assert_eq!(room.r.queue(HEARTBEAT), [(A, 1), (B, 2)]);
    assert_eq!(room.r.pass(1).discards(), [Reason::Expired]);
    assert_eq!(room.served(), [2]);
    assert_eq!(room.r.counters(HEARTBEAT).expired, 1);
    let none_left = Packet { remaining: Ticks(0), ..room.packet(HEARTBEAT, A, 3, 10) };
    assert_eq!(room.r.hear(none_left).discards(), [Reason::ExpiredOnTheWay]);
}

#[test]
fn of_status_the_message_with_most_time_left_goes() {
    let mut room = Room::new();
    room.put(HEARTBEAT, A, 1, 20);
    room.put(HEARTBEAT, B, 2, 30);
    let newcomer = room.packet(HEARTBEAT, C, 3, 40);
    assert_eq!(room.r.hear(newcomer).discards(), [Reason::Refused], "the newcomer itself");
    let urgent = room.packet(HEARTBEAT, C, 4, 10);
    let out = room.r.hear(urgent);
    assert_eq!((out.words(), out.discards()), (vec![], vec![Reason::Evicted]));
    assert_eq!(room.served(), [4, 1]);
    let counters = room.r.counters(HEARTBEAT);
    assert_eq!((counters.refused, counters.evicted, counters.enqueued), (1, 1, 3));
}

#[test]
fn a_command_that_makes_room_for_a_more_urgent_one_is_refused() {
    let mut room = Room::new();
    assert_eq!(room.put(MOVE, A, 1, 20), Vec::<String>::new());
    assert_eq!(room.put(MOVE, B, 2, 30), Vec::<String>::new());
    assert_eq!(room.put(MOVE, C, 3, 25), ["REFUSED T0>T2 #0 for 50"]);
    assert_eq!(room.put(MOVE, B, 4, 40), ["REFUSED T0>T2 #1 for 50"], "less urgent than those held");
    assert_eq!(room.served(), [1, 3]);
}

#[test]
fn a_status_message_is_taken_once_out_of_order_too() {
    let mut room = Room::new();
    let packets: Vec<Packet> = (0..70).map(|byte| room.packet(HEARTBEAT, A, byte, 50)).collect();
    room.r.ask(get(9));
    let take = |room: &mut Room, p: Packet| {
        let out = room.r.hear(p);
        if out.delivery().is_some() {
            room.r.ask(get(9));
        }
        (out.delivery().is_some(), out.discards())
    };
    assert_eq!(take(&mut room, packets[66]), (true, vec![]));
    assert_eq!(take(&mut room, packets[66]), (false, vec![Reason::Duplicate]));
    assert_eq!(take(&mut room, packets[3]), (true, vec![]));
    assert_eq!(take(&mut room, packets[3]), (false, vec![Reason::Duplicate]));
    assert_eq!(take(&mut room, packets[2]), (true, vec![]));
    assert_eq!(take(&mut room, packets[1]), (false, vec![Reason::Duplicate]), "too old to tell");
    assert_eq!(take(&mut room, packets[69]), (true, vec![]));
}

#[test]
fn only_the_parties_of_a_port_are_heard_and_only_in_its_class() {
    let mut room = Room::new();
    let good = room.packet(HEARTBEAT, A, 1, 50);
    let cases = [
        Packet { source: R, ..good },
        Packet { source: TaskId(9), ..good },
        Packet { port: PortId(7), ..good },
        Packet { class: Class::Command, ..good },
        Packet { kind: Kind::Query, ..good },
        Packet { kind: Kind::Reply, ..good },
        Packet { kind: Kind::Arrive, ..good },
    ];
    for bad in cases {
        let out = room.r.hear(bad);
        assert_eq!((out.words(), out.discards()), (vec![], vec![Reason::NotAllowed]), "{bad:?}");
    }
    assert!(room.r.hear(good).discards().is_empty());
    assert_eq!(room.r.counters(HEARTBEAT).dropped, 6, "one of the seven names no port");
}

proptest! {
    /// Compares the buffer with a sorted list: the buffer keeps the most urgent messages, and serves them in order.
    #[test]
    fn a_full_buffer_keeps_the_most_urgent(ttls in proptest::collection::vec(1..50_u64, 1..12)) {
        let mut room = Room::new();
        let mut model: Vec<(u64, u8)> = Vec::new();
        for (n, &ttl) in ttls.iter().enumerate() {
            let byte = u8::try_from(n).unwrap();
            room.put(HEARTBEAT, A, byte, ttl);
            model.push((ttl, byte));
            model.sort_unstable();
            model.truncate(2);
        }
        prop_assert_eq!(room.served(), model.iter().map(|&(_, byte)| byte).collect::<Vec<_>>());
    }
}

#[test]
fn a_view_shows_the_queue_in_the_order_of_service() {
    let mut room = Room::new();
    room.put(HEARTBEAT, A, 1, 20);
    room.put(HEARTBEAT, B, 2, 10);
    room.r.pass(3);
    let view = room.r.task.view(&room.r.table, 1);
    let heartbeat = &view.ports[0];
    assert_eq!((heartbeat.len, heartbeat.capacity, heartbeat.min_slack), (2, 2, Some(Ticks(7))));
    assert_eq!(heartbeat.queue.len(), 1);
    assert_eq!((heartbeat.queue[0].source, heartbeat.queue[0].remaining), (B, Ticks(7)));
    assert_eq!(view.state, TaskState::Running);
    room.senders[0].ask(send(MOVE, R, 0));
    let waiting = room.senders[0].task.state();
    assert_eq!(waiting, TaskState::AwaitingReply { port: MOVE, from: R, remaining: Ticks(50) });
}
