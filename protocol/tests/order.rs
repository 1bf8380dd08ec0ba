//! Interruption and `order` (R15 to R17, D15, D16): which handler runs, when, and which signals the interrupted activation
//! gets.

use crate::support::{NextExpiry, Solo, arrive, contents, get, get_on, handle, order, reply, send, send_for};
use imrs_protocol::*;
use std::sync::Arc;

const X: TaskId = TaskId(0);
const Y: TaskId = TaskId(1);
const Z: TaskId = TaskId(2);

/// The port for status messages of X and Z to Y.
const HALT: PortId = PortId(0);
/// The port for queries of X and Z to Y.
const HEARTBEAT: PortId = PortId(1);
/// The port for commands of Y to X.
const MOVE: PortId = PortId(2);
/// The port of the waitfor of Y and X.
const LIFT: PortId = PortId(3);
/// The port for status messages of X to Y that have no handler.
const NEWS: PortId = PortId(4);

fn cell() -> Cell {
    let mut cell = Cell::new("order", Ticks(1));
    let node = cell.node("n");
    let (x, y, z) = (cell.task("x", node), cell.task("y", node), cell.task("z", node));
    let penalty = |port: PortDecl| port.penalty(Ticks(4)).bounded_buffer(4);
    cell.port(penalty(PortDecl::new("halt", y, Usage::Receive, &[x, z], Ticks(40))));
    cell.port(penalty(PortDecl::new("beat", y, Usage::Response, &[x, z], Ticks(40))));
    cell.port(PortDecl::new("move", y, Usage::Send, &[x], Ticks(30)).command());
    cell.port(PortDecl::new("lift", x, Usage::Waitfor, &[y], Ticks(30)));
    cell.port(PortDecl::new("news", x, Usage::Send, &[y], Ticks(40)));
    cell
}

/// Task Y with handlers for HALT and HEARTBEAT and with an `order`, and tasks X and Z that send to it.
struct Room {
    y: Solo,
    x: Solo,
    z: Solo,
}

impl Room {
    fn new(named: &[Ranked]) -> Self {
        Self::of(cell(), named)
    }

    fn of(cell: Cell, named: &[Ranked]) -> Self {
        let table: Arc<CellTable> = Arc::new(CellTable::new(cell).expect("a checked cell"));
        let [x, mut y, z] = [X, Y, Z].map(|task| Solo::new(&table, task));
        for request in [handle(HALT), handle(HEARTBEAT), order(named)] {
            assert_eq!(y.ask(request).words(), ["accepted 0"]);
        }
        Self { y, x, z }
    }

    /// Lets a message of X arrive at Y.
    fn hear(&mut self, port: PortId, byte: u8) -> Vec<String> {
        self.x.ask(Request::Cancel);
        let packet = self.x.ask(send(port, Y, byte)).packets[0];
        self.y.hear(packet).words()
    }

    fn hear_of_z(&mut self, port: PortId, byte: u8) -> Vec<String> {
        self.z.ask(Request::Cancel);
        let packet = self.z.ask(send(port, Y, byte)).packets[0];
        self.y.hear(packet).words()
    }

    fn ask(&mut self, request: Request) -> Vec<String> {
        self.y.ask(request).words()
    }
}

const HALT_OVER_SELF: [Ranked; 3] = [Ranked::Port(HALT), Ranked::Own, Ranked::Port(HEARTBEAT)];

#[test]
fn a_handler_runs_only_if_it_outranks_the_thread() {
    let mut room = Room::new(&HALT_OVER_SELF);
    assert!(room.ask(Request::Work).is_empty());
    assert!(room.hear(HEARTBEAT, 1).is_empty(), "it is queued");
    assert_eq!(room.y.counters(HEARTBEAT).rejected, 1);
    assert_eq!(room.hear(HALT, 2), ["interrupt [2] from T0 for 40"]);
    assert_eq!(room.y.task.depth(), 1);
    assert_eq!(room.ask(Request::Done), ["fault Busy"]);
    assert!(room.ask(Request::Return).is_empty(), "the action goes on");
    assert_eq!(room.ask(Request::Done), ["accepted 0"]);
    assert_eq!(room.ask(Request::Done), ["fault WrongUsage"]);
    assert_eq!(room.ask(Request::Return), ["fault NotInterrupted"]);
}

#[test]
fn a_running_task_is_interrupted_between_statements_only() {
    let mut room = Room::new(&HALT_OVER_SELF);
    assert!(room.hear(HALT, 1).is_empty());
    assert!(room.hear_of_z(HALT, 2).is_empty());
    assert_eq!(room.y.counters(HALT).rejected, 0, "it was not offered");
    assert_eq!(room.ask(Request::Boundary), ["interrupt [1] from T0 for 40"]);
    assert_eq!(
        room.ask(Request::Return),
        ["interrupt [2] from T2 for 40"],
        "the next one at the same boundary"
    );
    assert_eq!(room.ask(Request::Return), ["accepted 0"]);
    assert_eq!(room.ask(Request::Boundary), ["accepted 0"]);
}

#[test]
fn in_a_plain_receive_every_handler_runs_and_the_receive_goes_on() {
    let mut room = Room::new(&HALT_OVER_SELF);
    assert!(room.ask(get(20)).is_empty());
    assert_eq!(room.hear(HEARTBEAT, 1), ["interrupt [1] from T0 for 40"]);
    // A message without a handler that arrives while a handler runs waits for a `receive`.
    assert!(room.hear(NEWS, 5).is_empty());
    assert_eq!(room.ask(Request::Return), ["message [5] from T0 for 40"]);
    assert!(room.ask(get(20)).is_empty());
    room.y.pass(5);
    assert_eq!(room.hear(HEARTBEAT, 2), ["interrupt [2] from T0 for 40"]);
    room.y.pass(16);
    assert_eq!(room.ask(Request::Return), ["nothing"], "its time ended meanwhile");
    assert!(room.ask(get(20)).is_empty());
    assert_eq!(room.hear(HEARTBEAT, 3), ["interrupt [3] from T0 for 40"]);
    assert!(room.ask(Request::Return).is_empty());
    assert_eq!(room.y.task.next_expiry(), Some(Ticks(20)), "with what is left of its time");
}

#[test]
fn a_get_takes_from_a_handled_port_only_if_it_names_it() {
    let mut room = Room::new(&[Ranked::Own]);
    room.hear(HALT, 1);
    assert_eq!(room.ask(get(0)), ["nothing"]);
    assert_eq!(room.ask(get_on(HALT, 0)), ["message [1] from T0 for 40"]);
    assert!(room.ask(get_on(HALT, 9)).is_empty());
    assert_eq!(room.hear(HALT, 2), ["message [2] from T0 for 40"]);
    assert_eq!(room.ask(Request::Handle { port: HALT, handled: false }), ["accepted 0"]);
    room.hear(HALT, 3);
    assert_eq!(room.ask(get(0)), ["message [3] from T0 for 40"]);
    assert_eq!(room.ask(handle(MOVE)), ["fault WrongUsage"]);
    assert_eq!(room.ask(handle(PortId(9))), ["fault NotYourPort"]);
}

#[test]
fn handlers_nest_by_rank_and_a_rank_never_grows() {
    let mut room = Room::new(&[Ranked::Port(HALT), Ranked::Port(HEARTBEAT), Ranked::Own]);
    room.ask(Request::Work);
    assert_eq!(room.hear(HEARTBEAT, 1), ["interrupt [1] from T0 for 40"]);
    assert!(room.ask(Request::Delay { id: TimeId(1), length: Ticks(9) }).is_empty());
    assert!(room.hear_of_z(HEARTBEAT, 2).is_empty(), "alike does not outrank");
    assert_eq!(room.hear(HALT, 3), ["interrupt [3] from T0 for 40"]);
    assert_eq!(room.y.task.depth(), 2);
    assert!(room.ask(Request::Delay { id: TimeId(2), length: Ticks(9) }).is_empty());
    assert!(room.hear_of_z(HALT, 4).is_empty());
    assert_eq!(room.y.input(Input::TimeOut { id: TimeId(2), turn: 1 }).words(), ["time_out 2"]);
    // The delay of the outer handler has ended, too. That handler gets the signal when it resumes.
    assert!(room.y.input(Input::TimeOut { id: TimeId(1), turn: 0 }).words().is_empty());
    assert_eq!(room.ask(Request::Return), ["time_out 1"]);
    // The thread itself runs again, in its action. Both messages are capped and outrank the thread; message 2 was rejected
    // first.
    room.y.pass(4);
    assert_eq!(room.ask(Request::Return), ["interrupt [2] from T2 for 36"]);
    assert_eq!(room.ask(Request::Return), ["interrupt [4] from T2 for 36"]);
    assert!(room.ask(Request::Return).is_empty());
    assert_eq!(room.ask(Request::Done), ["accepted 0"]);
}

#[test]
fn a_source_can_rank_above_another_on_the_same_port() {
    let mut room = Room::new(&[Ranked::Source(Z), Ranked::Own]);
    room.ask(Request::Work);
    assert!(room.hear(HALT, 1).is_empty());
    assert_eq!(room.hear_of_z(HALT, 2), ["interrupt [2] from T2 for 40"]);
}

#[test]
fn waits_below_a_handler_end_and_are_told_once_when_it_returns() {
    let mut room = Room::new(&HALT_OVER_SELF);
    let command = room.y.ask(send_for(MOVE, X, 1, 9)).packets[0];
    assert_eq!(room.hear(HALT, 1), ["interrupt [1] from T0 for 40"]);
    assert_eq!(room.ask(send(MOVE, X, 2)), ["fault Busy"], "the thread below asks on this port");
    let answer = Packet { kind: Kind::Reply, source: X, destination: Y, contents: contents(7), ..command };
    assert!(room.y.hear(answer).signals.is_empty());
    assert_eq!(room.y.hear(answer).discards(), [Reason::Unexpected]);
    room.y.pass(10);
    // Y may send on the port again, because the answer has come.
    assert_eq!(room.y.ask(send_for(MOVE, X, 2, 9)).packets.len(), 1);
    assert_eq!(room.y.pass(9).words(), ["TimedOutUnknown"]);
    assert_eq!(room.ask(Request::Return), ["reply [7]"]);
    assert_eq!(room.ask(Request::Boundary), ["accepted 0"]);
}

#[test]
fn a_waitfor_below_a_handler_is_released_and_told_when_it_returns() {
    let mut room = Room::new(&HALT_OVER_SELF);
    let arrival = room.x.ask(arrive(LIFT)).packets[0];
    room.ask(arrive(LIFT));
    assert_eq!(room.hear(HALT, 1), ["interrupt [1] from T0 for 40"]);
    assert_eq!(room.ask(arrive(LIFT)), ["fault Busy"]);
    assert_eq!(room.y.hear(arrival).words(), ["CONFIRM T1>T0 r1 for 30"]);
    assert_eq!(room.ask(Request::Return), ["released r1 complete"]);
    // A waitfor that no other member reaches.
    room.ask(arrive(LIFT));
    room.hear(HALT, 2);
    assert_eq!(room.y.pass(30).words(), ["ABORT T1>T0 r2 next r3 for 30"]);
    assert_eq!(room.ask(Request::Return), ["gave up r2 missing 0b1"]);
}

#[test]
fn atomic_defers_and_belongs_to_its_thread() {
    let mut room = Room::new(&HALT_OVER_SELF);
    room.ask(Request::Atomic(true));
    room.ask(Request::Delay { id: TimeId(1), length: Ticks(9) });
    assert!(room.hear(HALT, 1).is_empty());
    assert_eq!(room.y.counters(HALT).rejected, 0);
    assert_eq!(room.y.task.next_expiry(), Some(Ticks(40)), "nothing is offered");
    room.y.input(Input::TimeOut { id: TimeId(1), turn: 0 });
    assert_eq!(room.ask(Request::Boundary), ["accepted 0"]);
    assert_eq!(room.ask(Request::Atomic(false)), ["accepted 0"]);
    assert_eq!(room.ask(Request::Boundary), ["interrupt [1] from T0 for 40"]);
    room.ask(Request::Atomic(true));
    room.ask(Request::Return);
    room.hear(HALT, 2);
    assert_eq!(room.ask(Request::Boundary), ["interrupt [2] from T0 for 40"], "the handler's ended with it");
}

#[test]
fn a_timer_may_have_a_rank_of_its_own() {
    let start = |id| Request::Start { id: TimeId(id), length: Ticks(5) };
    let over = |id, turn| Input::TimeOut { id: TimeId(id), turn };
    // The test has `order a > silence of a > self`, so other timers rank below `self`.
    let mut room = Room::new(&[Ranked::Port(PortId(0)), Ranked::Timer(TimeId(2)), Ranked::Own]);
    room.ask(start(1));
    room.ask(start(2));
    room.ask(Request::Work);
    assert!(room.y.input(over(1, 0)).is_nothing());
    assert_eq!(room.y.input(over(2, 1)).words(), ["interrupt Timer(TimeId(2))"]);
    assert!(room.ask(Request::Return).is_empty());
    // If several timers have ended, the timer first in rank goes first, whatever its name.
    let named = [Ranked::Timer(TimeId(2)), Ranked::Timers, Ranked::Own];
    room.ask(Request::Done);
    room.ask(order(&named));
    room.ask(start(2));
    assert!(room.y.input(over(2, 2)).is_nothing());
    assert_eq!(room.ask(Request::Boundary), ["interrupt Timer(TimeId(2))"]);
    assert_eq!(room.ask(Request::Return), ["interrupt Timer(TimeId(1))"]);
    assert_eq!(room.ask(Request::Return), ["accepted 0"]);
}

#[test]
fn timers_interrupt_by_their_rank_and_wait_without_growing() {
    let start = |id, length| Request::Start { id: TimeId(id), length: Ticks(length) };
    let over = |id, turn| Input::TimeOut { id: TimeId(id), turn };
    let mut room = Room::new(&[Ranked::Timers, Ranked::Own]);
    let out = room.y.ask(start(1, 5));
    assert_eq!((out.words(), out.timers), (vec!["accepted 0".into()], vec![(TimeId(1), Some(Ticks(5)))]));
    room.ask(start(1, 9));
    room.ask(Request::Work);
    assert!(room.y.input(over(1, 0)).is_nothing(), "an earlier start of it");
    assert_eq!(room.y.input(over(1, 1)).words(), ["interrupt Timer(TimeId(1))"]);
    room.ask(Request::Return);
    room.ask(Request::Done);
    // If `self` ranks above the timers, the ends of timers wait until the task waits in a plain `receive`, and the lowest
    // timer id goes first.
    room.ask(order(&[Ranked::Own, Ranked::Timers]));
    room.ask(start(2, 5));
    room.ask(start(1, 5));
    room.ask(start(3, 5));
    room.ask(Request::Work);
    for (id, turn) in [(2, 2), (1, 3), (3, 4)] {
        assert!(room.y.input(over(id, turn)).is_nothing());
    }
    room.ask(Request::Done);
    assert_eq!(room.ask(Request::Boundary), ["accepted 0"]);
    let stopped = room.y.ask(Request::Stop { id: TimeId(3) });
    assert_eq!((stopped.words(), stopped.timers.len()), (vec!["accepted 0".into()], 0), "it had ended");
    assert_eq!(room.ask(get(50)), ["interrupt Timer(TimeId(1))"]);
    assert_eq!(room.ask(Request::Return), ["interrupt Timer(TimeId(2))"]);
    assert!(room.ask(Request::Return).is_empty());
    room.ask(Request::Cancel);
    // The loop tests how many timers may run at once, and which names exclude each other.
    for id in 0..8 {
        assert_eq!(room.ask(start(id, 5)), ["accepted 0"]);
    }
    assert_eq!(room.ask(start(9, 5)), ["fault TooManyTimers"]);
    assert_eq!(room.ask(Request::Delay { id: TimeId(3), length: Ticks(1) }), ["fault Busy"]);
    assert_eq!(room.y.ask(Request::Stop { id: TimeId(3) }).timers, [(TimeId(3), None)]);
}

#[test]
fn to_abandon_is_to_begin_anew() {
    let mut room = Room::new(&[Ranked::Port(HALT), Ranked::Port(HEARTBEAT), Ranked::Own]);
    room.ask(Request::Start { id: TimeId(5), length: Ticks(9) });
    room.ask(arrive(LIFT));
    room.hear(HEARTBEAT, 1);
    let command = room.y.ask(send(MOVE, X, 1)).packets[0];
    room.hear(HALT, 2);
    room.ask(Request::Delay { id: TimeId(1), length: Ticks(9) });
    assert!(room.hear_of_z(HEARTBEAT, 3).is_empty());
    let out = room.y.ask(Request::Abandon);
    assert_eq!(out.words(), ["ABORT T1>T0 r1 next r2 for 30", "cancelled"]);
    assert_eq!(out.timers, [(TimeId(1), None), (TimeId(5), None)]);
    assert_eq!((room.y.task.depth(), room.y.task.is_idle()), (0, true));
    let answer = Packet { kind: Kind::Reply, source: X, destination: Y, ..command };
    assert_eq!(room.y.hear(answer).discards(), [Reason::Unexpected]);
    room.y.pass(4);
    assert_eq!(room.ask(Request::Boundary), ["interrupt [3] from T2 for 36"], "what waits stays");
    assert_eq!(room.ask(send(MOVE, X, 1)).len(), 1);
}

#[test]
fn a_handler_that_waits_cannot_return_and_its_query_can_be_answered_later() {
    let mut room = Room::new(&HALT_OVER_SELF);
    room.ask(get(90));
    let query = room.x.ask(send(HEARTBEAT, Y, 1)).packets[0];
    let asked = room.y.hear(query).delivery().expect("the query");
    room.ask(get_on(NEWS, 9));
    assert_eq!(room.ask(Request::Return), ["fault Busy"]);
    assert_eq!(room.y.pass(9).words(), ["nothing"]);
    assert!(room.ask(Request::Return).is_empty());
    assert_eq!(room.ask(reply(&asked, 6)), ["RESPONSE T1>T0 #0 [6] for 31", "accepted 1"]);
}

#[test]
fn under_the_variant_without_order_everything_interrupts_as_deep_as_may_be() {
    let mut free = cell();
    free.rules.obey_order = false;
    free.ports[0].bounded_buffer = 20;
    let mut room = Room::of(free, &[Ranked::Own, Ranked::Port(HALT)]);
    room.ask(Request::Work);
    let mut depth = 0;
    for byte in 0..20 {
        room.x.ask(Request::Cancel);
        if !room.hear(HALT, byte).is_empty() {
            depth += 1;
            room.ask(Request::Work);
        }
    }
    assert_eq!(depth, ServiceOrder::LEVELS + 2);
    assert_eq!(usize::from(room.y.task.depth()), depth);
}
