//! Scripts that never wait, beside other scripts on one node.

use imrs_protocol::script::*;
use imrs_protocol::*;
use imrs_testkit::VirtualCell;

const A: TaskId = TaskId(0);
const B: TaskId = TaskId(1);
const C: TaskId = TaskId(2);
const D: TaskId = TaskId(3);

fn finish(b: ProgramBuilder) -> Program {
    b.finish().expect("a checked program")
}

/// A cell with tasks `a` to `d` on one node.
fn together() -> Cell {
    let mut cell = Cell::new("one", Ticks(1));
    let node = cell.node("node");
    for name in ["a", "b", "c", "d"] {
        cell.task(name, node);
    }
    cell
}

/// The program of a task that only waits.
fn waiting() -> Program {
    let mut b = ProgramBuilder::new("waits");
    b.forever(|b| {
        b.delay(Ticks(1));
    });
    finish(b)
}

fn ran_on(activity: Activity) -> bool {
    matches!(activity, Activity::Ended(End::Fault { fault: ScriptFault::Runaway, .. }))
}

#[test]
fn a_task_that_never_waits_stops_no_other_one() {
    let mut cell = together();
    let news = cell.port(PortDecl::new("news", A, Usage::Send, &[B], Ticks(9)));
    let mut a = ProgramBuilder::new("a");
    a.forever(|b| {
        b.send(news, Target::All, &[]);
    });
    let mut b = ProgramBuilder::new("b");
    b.forever(|b| {
        b.receive(news, None, &[]);
    });
    let mut virtual_cell = VirtualCell::new(cell).begin([(A, finish(a)), (B, finish(b)), (C, waiting())]);
    virtual_cell.run(3);
    assert_eq!(
        virtual_cell.activities().into_iter().map(ran_on).collect::<Vec<_>>(),
        [true, false, false],
        "{:?}",
        virtual_cell.activities()
    );
}

#[test]
fn who_answers_one_that_never_waits_is_not_the_one_that_is_stopped() {
    let mut cell = together();
    let ask = cell.port(PortDecl::new("ask", A, Usage::Query, &[B], Ticks(9)));
    let mut a = ProgramBuilder::new("a");
    a.forever(|b| {
        b.send(ask, Target::All, &[]);
    });
    let mut b = ProgramBuilder::new("b");
    b.forever(|b| {
        b.receive(ask, None, &[]).statement().reply(&[]);
    });
    // Because two tasks only wait, the scripts of the node may take so many steps together that the asking script reaches
    // its own limit first.
    let scripts = [(A, finish(a)), (B, finish(b)), (C, waiting()), (D, waiting())];
    let mut virtual_cell = VirtualCell::new(cell).begin(scripts);
    virtual_cell.run(3);
    assert_eq!(
        virtual_cell.activities().into_iter().map(ran_on).collect::<Vec<_>>(),
        [true, false, false, false],
        "{:?}",
        virtual_cell.activities()
    );
}

#[test]
fn of_two_that_keep_each_other_going_one_is_stopped() {
    let mut cell = together();
    let ping = cell.port(PortDecl::new("ping", A, Usage::Send, &[B], Ticks(9)));
    let pong = cell.port(PortDecl::new("pong", B, Usage::Send, &[A], Ticks(9)));
    let turns = |hears, says, first: bool| {
        let mut b = ProgramBuilder::new("turns");
        if first {
            b.send(says, Target::All, &[]);
        }
        b.forever(|b| {
            b.receive(hears, None, &[]).send(says, Target::All, &[]);
        });
        finish(b)
    };
    let mut virtual_cell =
        VirtualCell::new(cell).begin([(A, turns(pong, ping, true)), (B, turns(ping, pong, false))]);
    virtual_cell.run(3);
    let stopped = virtual_cell.activities().into_iter().map(ran_on).collect::<Vec<_>>();
    assert_eq!(stopped.iter().filter(|&&ran| ran).count(), 1, "{:?}", virtual_cell.activities());
}
