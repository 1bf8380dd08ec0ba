//! The Timer of a node (Figure 3, §5.1.2) and the delays of its tasks.

use crate::support::{self, NextExpiry, Solo, get};
use imrs_protocol::*;
use imrs_testkit::VirtualCell;
use proptest::prelude::*;

const X: TaskId = TaskId(0);
const Y: TaskId = TaskId(1);

fn cell() -> Cell {
    let mut cell = Cell::new("two", Ticks(1));
    let node = cell.node("n");
    cell.task("x", node);
    cell.task("y", node);
    cell
}

fn delay(id: u8, length: u64) -> Request {
    Request::Delay { id: TimeId(id), length: Ticks(length) }
}

#[test]
fn delays_of_tasks_end_each_at_its_time() {
    let mut net = VirtualCell::new(cell());
    net.ask(X, delay(1, 7));
    net.ask(Y, delay(1, 3));
    net.run(10);
    assert_eq!(net.transcript(), ["3 T1: time_out 1", "7 T0: time_out 1"]);
    assert_eq!(net.nodes[0].node.next_expiry(), None);
}

#[test]
fn what_is_over_by_then_comes_before_what_comes_then() {
    let mut net = VirtualCell::new(cell());
    net.ask(X, delay(1, 5));
    net.step_after(6, NodeId(0), NodeInput::Request(Y, Request::Order(ServiceOrder::default())));
    assert_eq!(net.transcript(), ["0 T0: time_out 1", "0 T1: accepted 0"]);
}

#[test]
fn a_task_asks_for_nothing_else_while_it_delays() {
    let mut net = VirtualCell::new(cell());
    net.ask(X, delay(1, 5));
    net.ask(X, get(3));
    assert_eq!(net.heard(X), ["fault Busy"]);
    assert_eq!(net.task(X).state(), TaskState::Delaying);
    net.run(5);
    assert_eq!(net.heard(X), ["time_out 1"]);
}

#[test]
fn a_cancelled_delay_never_ends() {
    let mut net = VirtualCell::new(cell());
    net.ask(X, delay(1, 5));
    net.ask(X, Request::Cancel);
    assert_eq!(net.nodes[0].node.next_expiry(), None);
    net.ask(X, delay(2, 9));
    net.run(20);
    assert_eq!(net.transcript(), ["0 T0: cancelled", "9 T0: time_out 2"]);
}

#[test]
fn a_delay_of_no_length_ends_with_the_next_look_at_the_clock() {
    let mut net = VirtualCell::new(cell());
    net.ask(X, delay(1, 0));
    assert_eq!(net.nodes[0].node.next_expiry(), Some(Ticks::ZERO));
    net.pass(NodeId(0), 0);
    assert_eq!(net.heard(X), ["time_out 1"]);
}

#[test]
fn a_delay_that_finds_the_timer_full_ends_at_once() {
    // The Timer of a node has room for all entries of its tasks, so only a smaller Timer can be full.
    let mut timer = Timer::new(1);
    assert!(timer.arm(X, TimeId(0), 0, Ticks(9)));
    assert!(!timer.arm(Y, TimeId(0), 0, Ticks(1)));
    assert!(timer.arm(X, TimeId(0), 0, Ticks(4)), "its own entry makes room");
    assert_eq!(timer.entries(), [(X, TimeId(0), Ticks(4))]);
}

#[test]
fn an_unexpected_time_out_is_nothing() {
    let table = std::sync::Arc::new(CellTable::new(cell()).expect("a checked cell"));
    let mut x = Solo::new(&table, X);
    assert!(x.input(Input::TimeOut { id: TimeId(3), turn: 0 }).is_nothing());
    let out = x.ask(delay(1, 5));
    assert_eq!(out.timers, [(TimeId(1), Some(Ticks(5)))]);
    assert!(x.input(Input::TimeOut { id: TimeId(2), turn: 0 }).is_nothing());
    assert_eq!(x.input(Input::TimeOut { id: TimeId(1), turn: 0 }).words(), ["time_out 1"]);
    assert!(x.input(Input::TimeOut { id: TimeId(1), turn: 0 }).is_nothing());
    x.ask(delay(1, 5));
    // This time-out belongs to the first delay, and arrives after the second delay of the same name began.
    assert!(x.input(Input::TimeOut { id: TimeId(1), turn: 0 }).is_nothing());
    assert_eq!(x.ask(Request::Cancel).timers, [(TimeId(1), None)]);
}

/// The Timer of Figure 3 to the letter: an array of entries; every tick decrements each entry.
#[derive(Default)]
struct Figure3(Vec<(TaskId, TimeId, u64)>);

impl Figure3 {
    fn pass(&mut self, ticks: u64) -> Vec<(TaskId, TimeId)> {
        let mut over = Vec::new();
        for (task, id, length) in &mut self.0 {
            if *length <= ticks {
                over.push((*length, *task, *id));
            }
            *length = length.saturating_sub(ticks);
        }
        self.0.retain(|&(_, _, length)| length > 0);
        over.sort_by_key(|&(length, ..)| length);
        over.into_iter().map(|(_, task, id)| (task, id)).collect()
    }
}

proptest! {
    #[test]
    fn the_timer_does_what_figure_3_does(steps in proptest::collection::vec((0..4_u8, 0..3_u16, 0..3_u8, 1..30_u64), 1..80)) {
        let mut timer = Timer::new(5);
        let mut figure = Figure3::default();
        for (what, task, id, length) in steps {
            let (task, id) = (TaskId(task), TimeId(id));
            let same = |e: &(TaskId, TimeId, u64)| (e.0, e.1) == (task, id);
            match what {
                0 | 1 => {
                    figure.0.retain(|e| !same(e));
                    let space = figure.0.len() < 5;
                    prop_assert_eq!(timer.arm(task, id, 0, Ticks(length)), space);
                    if space {
                        figure.0.push((task, id, length));
                    }
                }
                2 => {
                    let had = figure.0.iter().any(same);
                    figure.0.retain(|e| !same(e));
                    prop_assert_eq!(timer.disarm(task, id), had);
                }
                _ => {
                    let mut over = Vec::new();
                    timer.advance(timer.now() + Ticks(length), |task, id, _| over.push((task, id)));
                    prop_assert_eq!(over, figure.pass(length));
                    if id.0 == 0 {
                        timer.rebase();
                    }
                }
            }
            let least = figure.0.iter().map(|e| e.2).min();
            prop_assert_eq!(timer.next_expiry(), least.map(Ticks));
        }
    }
}

#[test]
fn the_timer_says_which_start_of_an_entry_is_over() {
    let mut timer = Timer::new(4);
    timer.arm(X, TimeId(1), 3, Ticks(5));
    timer.arm(Y, TimeId(1), 8, Ticks(6));
    timer.arm(X, TimeId(1), 4, Ticks(9));
    let mut over = Vec::new();
    timer.advance(Instant(20), |task, id, turn| over.push((task, id, turn)));
    assert_eq!(over, [(Y, TimeId(1), 8), (X, TimeId(1), 4)], "the first start of X is no more");
}

fn start(id: u8, length: u64) -> Request {
    Request::Start { id: TimeId(id), length: Ticks(length) }
}

/// A net in which task X works, and its timers outrank its thread.
fn working() -> VirtualCell {
    let mut net = VirtualCell::new(cell());
    net.ask(X, support::order(&[Ranked::Timers, Ranked::Own]));
    net
}

#[test]
fn a_timer_that_is_started_again_interrupts_once_at_its_new_time() {
    let mut net = working();
    net.ask(X, start(1, 5));
    net.run(3);
    net.ask(X, start(1, 5));
    net.ask(X, Request::Work);
    net.transcript();
    net.run(20);
    assert_eq!(net.transcript(), ["8 T0: interrupt Timer(TimeId(1))"]);
}

#[test]
fn a_stopped_timer_never_interrupts_and_leaves_nothing_behind() {
    let mut net = working();
    net.ask(X, start(1, 5));
    net.ask(X, start(2, 9));
    net.ask(X, Request::Stop { id: TimeId(1) });
    let entries = net.nodes[0].node.parts().timer.entries();
    assert_eq!(entries, [(X, TimeId(2), Ticks(9))]);
    // A stopped timer that has already ended does not call its handler any more, if the handler has not begun.
    net.run(9);
    net.ask(X, Request::Stop { id: TimeId(2) });
    net.ask(X, Request::Work);
    net.transcript();
    net.run(9);
    assert_eq!(net.transcript(), Vec::<String>::new());
    assert_eq!(net.nodes[0].node.next_expiry(), None);
}

#[test]
fn a_name_serves_one_delay_or_timer_at_a_time() {
    let mut net = working();
    net.ask(X, start(1, 5));
    net.ask(X, delay(1, 5));
    assert_eq!(net.heard(X), ["accepted 0", "accepted 0", "fault Busy"], "a timer runs under it");
    net.ask(X, delay(2, 50));
    net.run(5);
    assert_eq!(net.heard(X), ["interrupt Timer(TimeId(1))"]);
    net.ask(X, start(2, 5));
    net.ask(X, delay(2, 5));
    assert_eq!(net.heard(X), ["fault Busy", "fault Busy"], "the interrupted thread delays under it");
    net.ask(X, start(3, 5));
    assert_eq!(net.heard(X), ["accepted 0"]);
}
