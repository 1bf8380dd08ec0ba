//! Rejection by rank, and how it ends (R61 to R63, D4, D58, D59): a message is rejected a bounded number of times, and no
//! port is bypassed for ever.

use crate::support::{NextExpiry, Solo, get, handle, order, send, send_for};
use imrs_protocol::aging::Service;
use imrs_protocol::rules::Aging;
use imrs_protocol::*;
use std::sync::Arc;

const X: TaskId = TaskId(0);
const Y: TaskId = TaskId(1);

/// The port for status messages of X to Y; it ranks lowest. A rejected message is offered again after 4
/// ticks.
const LOW: PortId = PortId(0);
const HIGH: PortId = PortId(1);
/// Three more ports, whose messages have no penalty when they are rejected.
const PLAIN: [PortId; 3] = [PortId(2), PortId(3), PortId(4)];

fn cell() -> Cell {
    let mut cell = Cell::new("aging", Ticks(2));
    let node = cell.node("n");
    let (x, y) = (cell.task("x", node), cell.task("y", node));
    for name in ["low", "high", "a", "b", "c"] {
        let port = PortDecl::new(name, x, Usage::Send, &[y], Ticks(100)).bounded_buffer(8);
        cell.port(if name.len() > 1 { port.penalty(Ticks(4)) } else { port });
    }
    cell
}

struct Room {
    x: Solo,
    y: Solo,
}

impl Room {
    fn new(change: impl FnOnce(&mut Cell)) -> Self {
        let mut cell = cell();
        change(&mut cell);
        let table: Arc<CellTable> = Arc::new(CellTable::new(cell).expect("a checked cell"));
        Self { x: Solo::new(&table, X), y: Solo::new(&table, Y) }
    }

    fn hear(&mut self, port: PortId, byte: u8) -> Vec<String> {
        let packet = self.x.ask(send(port, Y, byte)).packets[0];
        self.y.hear(packet).words()
    }

    fn hear_urgent(&mut self, port: PortId, byte: u8, ttl: u64) -> Vec<String> {
        let packet = self.x.ask(send_for(port, Y, byte, ttl)).packets[0];
        self.y.hear(packet).words()
    }

    /// Lets time pass tick by tick, until a handler interrupts the working thread.
    fn ticks_to_interrupt(&mut self, at_most: u64) -> Option<(u64, String)> {
        (1..=at_most).find_map(|tick| Some((tick, self.y.pass(1).words().first()?.clone())))
    }
}

#[test]
fn each_rejection_raises_the_rank_by_one_level() {
    let mut room = Room::new(|_| ());
    for request in [handle(LOW), order(&[Ranked::Own, Ranked::Port(HIGH), Ranked::Port(LOW)]), Request::Work]
    {
        room.y.ask(request);
    }
    // In the `order`, two levels rank above the message. The message is rejected at instant 0 and after 4 ticks, and
    // outranks the task's own thread after 8 ticks.
    assert!(room.hear(LOW, 1).is_empty());
    assert_eq!(room.y.task.next_expiry(), Some(Ticks(4)));
    assert_eq!(room.ticks_to_interrupt(50), Some((8, "interrupt [1] from T0 for 92".into())));
    assert_eq!(room.y.counters(LOW).rejected, 2);
}

#[test]
fn without_an_order_a_message_is_rejected_once() {
    let mut room = Room::new(|_| ());
    room.y.ask(handle(PLAIN[0]));
    room.y.ask(Request::Work);
    assert!(room.hear(PLAIN[0], 1).is_empty());
    assert_eq!(
        room.ticks_to_interrupt(50),
        Some((2, "interrupt [1] from T0 for 98".into())),
        "one tick of the cell"
    );
    // The penalty is at most half of the message's remaining time, and at least one tick.
    for request in [Request::Return, Request::Done, handle(LOW), Request::Work] {
        room.y.ask(request);
    }
    assert!(room.hear_urgent(LOW, 2, 5).is_empty());
    assert_eq!(room.y.task.next_expiry(), Some(Ticks(2)));
    assert!(room.hear_urgent(LOW, 3, 1).is_empty());
    assert_eq!(room.y.task.next_expiry(), Some(Ticks(1)));
}

#[test]
fn a_rejected_message_never_keeps_an_idle_task_waiting() {
    let mut room = Room::new(|_| ());
    for request in [handle(LOW), order(&[Ranked::Own, Ranked::Port(LOW)]), Request::Work] {
        room.y.ask(request);
    }
    room.hear(LOW, 1);
    room.y.ask(Request::Done);
    assert_eq!(room.y.ask(Request::Boundary).words(), ["accepted 0"]);
    assert_eq!(room.y.ask(get(9)).words(), ["interrupt [1] from T0 for 100"]);
}

#[test]
fn among_messages_at_the_cap_the_first_rejected_goes_first() {
    let mut room = Room::new(|_| ());
    for request in [handle(LOW), handle(HIGH), order(&[Ranked::Own, Ranked::Port(HIGH), Ranked::Port(LOW)])] {
        room.y.ask(request);
    }
    room.y.ask(Request::Work);
    room.hear(LOW, 1);
    room.y.pass(1);
    room.hear_urgent(HIGH, 2, 20);
    room.y.ask(Request::Done);
    // While the thread of `y` works, no message is offered to it. So both messages wait until they have reached the highest rank.
    room.y.ask(Request::Work);
    room.y.pass(3);
    room.y.ask(Request::Done);
    room.y.pass(5);
    assert_eq!(room.y.ask(Request::Boundary).words(), ["interrupt [1] from T0 for 91"]);
    assert_eq!(room.y.ask(Request::Return).words(), ["interrupt [2] from T0 for 12"]);
}

#[test]
fn a_cap_does_not_lift_a_message_over_a_handler_of_the_first_rank() {
    let mut room = Room::new(|_| ());
    for request in [handle(LOW), handle(HIGH), order(&[Ranked::Port(HIGH), Ranked::Own, Ranked::Port(LOW)])] {
        room.y.ask(request);
    }
    room.y.ask(Request::Work);
    assert_eq!(room.hear(HIGH, 1), ["interrupt [1] from T0 for 100"]);
    room.y.ask(Request::Work);
    room.hear(LOW, 2);
    assert_eq!(room.ticks_to_interrupt(40), None);
    assert_eq!(room.y.counters(LOW).rejected, 11, "every 4 ticks");
    room.y.ask(Request::Done);
    // The message interrupts the thread itself as soon as its rank allows.
    room.y.pass(4);
    assert_eq!(room.y.ask(Request::Return).words(), ["interrupt [2] from T0 for 56"]);
}

#[test]
fn without_aging_a_message_is_rejected_until_it_expires() {
    for aging in [Aging::Off, Aging::Unbounded] {
        let mut room = Room::new(|cell| cell.rules.aging = aging);
        for request in [handle(LOW), order(&[Ranked::Own, Ranked::Port(LOW)]), Request::Work] {
            room.y.ask(request);
        }
        room.hear(LOW, 1);
        assert_eq!(room.ticks_to_interrupt(120), None);
        assert!(room.y.counters(LOW).rejected > 20);
        assert_eq!(room.y.counters(LOW).expired, 1);
    }
}

#[test]
fn the_literal_penalty_lengthens_the_remaining_time() {
    let mut room =
        Room::new(|cell| cell.ports[0].penalty = Some(Penalty { length: Ticks(4), literal: true }));
    for request in [handle(LOW), order(&[Ranked::Own, Ranked::Port(LOW)]), Request::Work] {
        room.y.ask(request);
    }
    room.hear_urgent(LOW, 1, 10);
    assert_eq!(room.ticks_to_interrupt(60), None);
    assert_eq!(room.y.queue(LOW), [(X, 14)], "alive long after its time_out");
    room.y.ask(Request::Done);
    assert_eq!(room.y.ask(get(5)).words(), ["interrupt [1] from T0 for 14"]);
}

#[test]
fn of_two_that_the_literal_penalty_makes_live_alike_the_earlier_goes_first_packed_or_not() {
    let served = |packed: bool| {
        let literal = Some(Penalty { length: Ticks(4), literal: true });
        let mut room = Room::new(|cell| cell.ports[0].penalty = literal);
        for request in [handle(LOW), order(&[Ranked::Own, Ranked::Port(LOW)]), Request::Work] {
            room.y.ask(request);
        }
        room.hear_urgent(LOW, 1, 20);
        room.y.pass(2);
        room.hear_urgent(LOW, 2, 18);
        let left = |y: &Solo| y.queue(LOW).into_iter().map(|(_, left)| left).collect::<Vec<_>>();
        assert_eq!(left(&room.y), [22, 22]);
        room.y.pass(3);
        assert_eq!(left(&room.y), [19, 23], "the first one was rejected again");
        if packed {
            room.y.repack();
        }
        room.y.pass(1);
        assert_eq!(left(&room.y), [22, 22], "and the second one");
        room.y.ask(Request::Done);
        room.y.ask(get(5)).words()
    };
    assert_eq!(served(false), ["interrupt [1] from T0 for 22"]);
    assert_eq!(served(true), served(false));
}

/// How often the first message of the first port is bypassed while the other ports always have a more urgent message.
fn passed_over(aging: Aging, gets: u32) -> u32 {
    let mut room = Room::new(|cell| cell.rules.aging = aging);
    room.hear(LOW, 77);
    for n in 0..gets {
        for port in [HIGH, PLAIN[0], PLAIN[1]] {
            room.hear_urgent(port, 1, 50);
        }
        if room.y.ask(get(0)).words()[0].starts_with("message [77]") {
            return n;
        }
    }
    gets
}

#[test]
fn a_get_passes_over_a_port_a_bounded_number_of_times() {
    // Five ports and no order: the bypass limit G is 5.
    assert_eq!(passed_over(Aging::Bounded, 90), 5);
    assert_eq!(passed_over(Aging::Unbounded, 90), 5);
    assert_eq!(passed_over(Aging::Off, 90), 90);
}

#[test]
fn ports_passed_over_too_often_are_served_the_oldest_first() {
    let mut room = Room::new(|_| ());
    let mut served = Vec::new();
    for n in 0..12 {
        if n == 0 {
            room.hear(PLAIN[2], 3);
        }
        if n == 1 {
            room.hear(PLAIN[1], 2);
        }
        room.hear_urgent(HIGH, 1, 50);
        let got = room.y.ask(get(0)).delivery().expect("a message");
        served.push(got.contents.as_bytes()[0]);
    }
    assert_eq!(served, [1, 1, 1, 1, 1, 3, 2, 1, 1, 1, 1, 1]);
}

#[test]
fn handlers_of_one_rank_pass_over_a_port_a_bounded_number_of_times_too() {
    let calls = |aging: Aging| {
        let mut room = Room::new(|cell| cell.rules.aging = aging);
        for request in [handle(LOW), handle(HIGH), order(&[Ranked::Port(LOW)])] {
            room.y.ask(request);
        }
        room.y.ask(order(&[Ranked::Port(HIGH), Ranked::Port(LOW), Ranked::Own]));
        room.hear(LOW, 77);
        for n in 0..40 {
            room.hear_urgent(HIGH, 1, 50);
            room.hear_urgent(HIGH, 1, 50);
            let got = if n == 0 { room.y.ask(Request::Boundary) } else { room.y.ask(Request::Return) };
            if got.words()[0].starts_with("interrupt [77]") {
                return Some(n);
            }
        }
        None
    };
    // Five ports and three levels: the bypass limit G is 8.
    assert_eq!(calls(Aging::Bounded), Some(8));
    assert_eq!(calls(Aging::Off), None);
}

#[test]
fn a_flood_of_rejected_messages_keeps_the_first_rank_waiting_for_one_of_them_only() {
    let mut y = Solo::new(&Arc::new(CellTable::new(cell()).expect("a checked cell")), Y);
    let mut x = Solo::new(&Arc::new(CellTable::new(cell()).expect("a checked cell")), X);
    for request in [handle(HIGH), handle(LOW), order(&[Ranked::Port(HIGH), Ranked::Own])] {
        y.ask(request);
    }
    y.ask(Request::Work);
    let mut hear = |y: &mut Solo, port| {
        let packet = x.ask(send(port, Y, 1)).packets[0];
        y.hear(packet)
    };
    for _ in 0..5 {
        hear(&mut y, LOW);
    }
    let began = (0..8).any(|_| y.pass(1).delivery().is_some());
    assert!(began, "a message at its cap interrupts the thread");
    hear(&mut y, HIGH);
    hear(&mut y, LOW);
    y.pass(5);
    assert_eq!(y.ask(Request::Return).delivery().map(|d| d.from.port), Some(HIGH));
}

/// How many ticks a status message of the first port waits for its handler, and the computed bound of this wait. Before the
/// message, `each` messages of this port and of another port are rejected, and every handler takes `longest`.
fn behind_rivals(each: u16, longest: u64) -> (u64, Ticks) {
    let mut room = Room::new(|cell| cell.ports.iter_mut().for_each(|port| port.time_out = Ticks(1000)));
    let ports = [PLAIN[0], PLAIN[1], HIGH];
    for port in ports {
        room.y.ask(handle(port));
    }
    // From here on messages that outrank the thread arrive all the time.
    room.y.ask(order(&[Ranked::Port(HIGH), Ranked::Own]));
    room.y.ask(Request::Work);
    for port in [PLAIN[1], PLAIN[0]] {
        (0..each).for_each(|_| drop(room.hear(port, 1)));
    }
    room.hear(PLAIN[0], 77);
    let mut waited = 0;
    let mut running = false;
    loop {
        let effects = if running { room.y.ask(Request::Return) } else { room.y.pass(1) };
        waited += u64::from(!running);
        running = match effects.delivery().map(|d| d.contents.as_bytes()[0]) {
            Some(77) => break,
            Some(_) => true,
            None => false,
        };
        if running {
            room.hear(HIGH, 2);
            room.y.pass(longest);
            waited += longest;
        }
    }
    let service = Service {
        ports: 5,
        levels: 2,
        rank: 2,
        ahead: each,
        rivals: each,
        longest: Ticks(longest),
        penalty: Ticks(2),
    };
    (waited, service.bound())
}

#[test]
fn the_bound_counts_what_was_refused_before_on_other_ports() {
    for (each, longest) in [(0, 5), (1, 5), (3, 4), (7, 3)] {
        let (waited, bound) = behind_rivals(each, longest);
        assert!(Ticks(waited) <= bound, "{each} of each port before it: {waited} of {bound}");
        // A bound that counted only the messages of the port itself would be too small.
        assert!(waited >= 4 * u64::from(each) * longest, "{each}: {waited}");
    }
}

#[test]
fn a_new_order_takes_no_turn_away() {
    let mut room = Room::new(|_| ());
    room.y.ask(handle(LOW));
    room.y.ask(Request::Work);
    room.hear(LOW, 1);
    room.y.ask(Request::Done);
    // The message has reached its cap of one rejection. The new `order` would allow three rejections.
    let levels = [Ranked::Own, Ranked::Timers, Ranked::Port(HIGH), Ranked::Port(LOW)];
    room.y.ask(order(&levels));
    room.y.ask(Request::Work);
    assert_eq!(room.ticks_to_interrupt(9), Some((4, "interrupt [1] from T0 for 96".into())));
}

#[test]
fn a_get_that_names_a_source_goes_by_urgency_alone() {
    let of_x = Request::Get { port: None, source: Some(X), time_out: Some(Ticks(0)) };
    let mut room = Room::new(|_| ());
    room.hear(LOW, 77);
    // A GET that names a source counts no bypass: after many such GETs a GET over all ports still takes the more urgent
    // message.
    for _ in 0..20 {
        room.hear_urgent(HIGH, 1, 50);
        assert_eq!(room.y.ask(of_x).words(), ["message [1] from T0 for 50"]);
    }
    for _ in 0..5 {
        room.hear_urgent(HIGH, 2, 50);
        assert_eq!(room.y.ask(get(0)).words(), ["message [2] from T0 for 50"]);
    }
    // Now the port has reached its bypass limit, which matters only to a GET over all ports.
    room.hear_urgent(HIGH, 3, 50);
    assert_eq!(room.y.ask(of_x).words(), ["message [3] from T0 for 50"]);
    room.hear_urgent(HIGH, 4, 50);
    assert_eq!(room.y.ask(get(0)).words(), ["message [77] from T0 for 100"]);
}
