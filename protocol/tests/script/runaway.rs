//! Scripts that never wait, beside others on one node.

use imrs_protocol::script::*;
use imrs_protocol::*;
use imrs_testkit::VirtualCell;

const A: TaskId = TaskId(0);
const B: TaskId = TaskId(1);
const C: TaskId = TaskId(2);

fn finish(b: ProgramBuilder) -> Program {
    b.finish().expect("a checked program")
}

/// Tasks `a`, `b` and `c` on one node.
fn together() -> Cell {
    let mut cell = Cell::new("one", Ticks(1));
    let node = cell.node("node");
    for name in ["a", "b", "c"] {
        cell.task(name, node);
    }
    cell
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
    let mut c = ProgramBuilder::new("c");
    c.forever(|b| {
        b.delay(Ticks(1));
    });
    let mut virtual_cell = VirtualCell::new(cell).begin([(A, finish(a)), (B, finish(b)), (C, finish(c))]);
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
    let mut virtual_cell = VirtualCell::new(cell).begin([(A, finish(a)), (B, finish(b))]);
    virtual_cell.run(3);
    assert_eq!(
        virtual_cell.activities().into_iter().map(ran_on).collect::<Vec<_>>(),
        [true, false],
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
