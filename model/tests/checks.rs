//! Tests of the predicates that a cell's checks may use (D45).

use imrs_model::cell_state::Move;
use imrs_model::cell_state::explore_cell_state;
use imrs_model::cell_state::plan::{CellScenario, TaskPlan};
use imrs_model::{Exploration, Limits, Violation};
use imrs_protocol::script::{Binary, Outcomes, Predicate, ProgramBuilder, Term, Type};
use imrs_protocol::{Cell, CellTable, PortDecl, PortId, Target, TaskId, Ticks, Usage};
use std::sync::Arc;

fn explored(plan: &Arc<CellScenario>) -> Exploration<Move> {
    explore_cell_state(plan, Limits { states: 200_000, memory: 1 << 30 })
}

/// A cell in which `a` enters the shared place after each meeting (only after a release, if `honest`). `b` takes part
/// in the first `meetings` meetings.
fn entering(meetings: u8, honest: bool) -> Arc<CellScenario> {
    let mut cell = Cell::new("entering", Ticks(1));
    let nodes = ["left", "right"].map(|name| cell.node(name));
    cell.link(nodes[0], nodes[1], Ticks(1));
    let [a, b] = [("a", nodes[0]), ("b", nodes[1])].map(|(name, node)| cell.task(name, node));
    let port = cell.port(PortDecl::new("turn", a, Usage::Waitfor, &[b], Ticks(9)));
    let mut first = ProgramBuilder::new("a");
    let inside = first.variable("inside", Type::Bool);
    for _ in 0..2 {
        first.waitfor(port);
        if honest {
            first.when(Outcomes::TIME_OUT, |b| {
                b.abort("alone");
            });
        }
        first.set(inside, 1).run("use the place", Ticks(1), Ticks(1)).set(inside, 0);
    }
    first.end();
    let mut second = ProgramBuilder::new("b");
    for _ in 0..meetings {
        second.run("make ready", Ticks(0), Ticks(1)).waitfor(port);
    }
    second.end();
    let scripted = |b: ProgramBuilder| TaskPlan::scripted(Arc::new(b.finish().expect("a sound program")));
    let tasks = vec![scripted(first), scripted(second)];
    let mut plan = CellScenario::new(Arc::new(CellTable::new(cell).expect("a sound declaration")), tasks);
    let early = Term::Is(Predicate::Arrived { port, task: b });
    plan.checks =
        vec![vec![Term::Of { task: a, variable: 0 }, early, Term::Not, Term::Int(Binary::And), Term::Not]];
    Arc::new(plan)
}

#[test]
fn checks_ask_who_has_arrived_at_the_newest_meeting() {
    assert_eq!(explored(&entering(2, false)).violation, None);
    assert_eq!(explored(&entering(1, true)).violation, None);
    let alone = explored(&entering(1, false));
    assert_eq!(
        alone.violation,
        Some(Violation::Check),
        "its arrival at the first meeting is none at the second"
    );
    assert_eq!(explored(&entering(0, false)).violation, Some(Violation::Check));
}

/// A cell in which task `a` queries `b` once and then sets `done`. The check reads `done` and a predicate about that query.
fn asking(
    loss: u8,
    deaf: bool,
    predicate: impl Fn(TaskId, PortId) -> Predicate,
    holds: bool,
) -> Arc<CellScenario> {
    let mut cell = Cell::new("asking", Ticks(1));
    let nodes = ["left", "right"].map(|name| cell.node(name));
    cell.link(nodes[0], nodes[1], Ticks(1));
    let [a, b] = [("a", nodes[0]), ("b", nodes[1])].map(|(name, node)| cell.task(name, node));
    let port = cell.port(PortDecl::new("ask", a, Usage::Query, &[b], Ticks(5)));
    let mut first = ProgramBuilder::new("a");
    let done = first.variable("done", Type::Bool);
    first.send(port, Target::All, &[]).set(done, 1).delay(Ticks(1)).end();
    let mut second = ProgramBuilder::new("b");
    if deaf {
        second.delay(Ticks(9)).end();
    } else {
        second.receive(port, None, &[]).reply(&[]).end();
    }
    let scripted = |b: ProgramBuilder| TaskPlan::scripted(Arc::new(b.finish().expect("a sound program")));
    let tasks = vec![scripted(first), scripted(second)];
    let mut plan = CellScenario::new(Arc::new(CellTable::new(cell).expect("a sound declaration")), tasks);
    plan.faults.loss = loss;
    // The check: whenever `done` is true, the predicate has the value `holds`.
    let is = Term::Is(predicate(a, port));
    let mut check = vec![Term::Of { task: a, variable: 0 }, is];
    check.extend(holds.then_some(Term::Not));
    check.extend([Term::Int(Binary::And), Term::Not]);
    plan.checks = vec![check];
    Arc::new(plan)
}

#[test]
fn checks_ask_what_was_answered() {
    let answered = |task, port| Predicate::Answered { task, port };
    assert_eq!(explored(&asking(0, false, answered, true)).violation, None);
    assert_eq!(explored(&asking(1, false, answered, true)).violation, Some(Violation::Check));
    assert_eq!(explored(&asking(0, true, answered, false)).violation, None, "a time_out is no answer");
    let asked = |task, port| Predicate::Asked { task, port };
    assert_eq!(explored(&asking(1, false, asked, false)).violation, None, "who goes on asks no more");
}
