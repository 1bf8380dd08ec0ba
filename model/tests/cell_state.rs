//! Tests of the checker's cell states: whole nodes, relays, links of limited capacity, handlers, scripts.

use imrs_model::cell_state::plan::{CellProperty, CellScenario, Faults, Goal, TaskPlan};
use imrs_model::cell_state::worlds::{
    Flood, Interrupted, Relay, Workshop, busy_neighbour, full_buffers, penalised, query_all,
};
use imrs_model::cell_state::{CellModel, Move, draw_cell_state, explore_cell_state};
use imrs_model::{Exploration, Limits, Violation};
use imrs_protocol::rules::{Aging, Eviction, JobRequest, Memory, Rules};
use imrs_protocol::script::{Binary, ProgramBuilder, Term, Type};
use imrs_protocol::{Cell, CellTable, PortDecl, Ticks, Usage};
use stateright::Model;
use std::collections::HashSet;
use std::sync::Arc;

fn explored(plan: &Arc<CellScenario>) -> Exploration<Move> {
    let found = explore_cell_state(plan, Limits { states: 1_000_000, memory: 4 << 30 });
    println!(
        "{:?}: {} states, {} transitions, depth {}, {} bytes, {:.2} s",
        plan.watches, found.states, found.transitions, found.depth, found.longest_state, found.seconds
    );
    if let Some(c) = draw_cell_state(plan, &found) {
        println!("{}", c.chart);
    }
    assert!(found.complete);
    found
}

/// Explores a cell that must fail, and then explores it again, level by level and with whole states. The counterexample
/// must be a run of the cell, and a shortest one.
fn fails(plan: &Arc<CellScenario>) -> Violation {
    let found = explored(plan);
    let drawn = draw_cell_state(plan, &found).expect("a chart");
    let (path, states) = (found.path.expect("fails"), found.states_on_path.expect("fails"));
    let model = CellModel::new(plan, Limits::default());
    assert_eq!(states[..1], model.init_states());
    for (i, step) in path.iter().enumerate() {
        let mut enabled = Vec::new();
        model.actions(&states[i], &mut enabled);
        assert!(enabled.contains(step), "{step:?} is not among {enabled:?}");
        assert_eq!(model.next_state(&states[i], *step).as_ref(), Some(&states[i + 1]));
    }
    let mut level = model.init_states();
    let mut seen: HashSet<_> = level.iter().cloned().collect();
    let mut depth = 0;
    while level.iter().all(|state| state.violation().is_none()) {
        let mut next = Vec::new();
        for state in &level {
            let mut steps = Vec::new();
            model.actions(state, &mut steps);
            let after = steps.into_iter().filter_map(|step| model.next_state(state, step));
            next.extend(after.filter(|state| seen.insert(state.clone())));
        }
        (level, depth) = (next, depth + 1);
        assert!(!level.is_empty(), "no violation");
    }
    assert_eq!(path.len(), depth);
    assert_eq!(drawn.length as usize, depth);
    assert!(drawn.chart.lines().all(|line| line.chars().count() <= 78), "{}", drawn.chart);
    found.violation.expect("fails")
}

fn loss(loss: u8) -> Faults {
    Faults { loss, ..Faults::default() }
}

#[test]
fn relays_keep_the_promises() {
    for watch in
        [CellProperty::Stale { slack: 0 }, CellProperty::Waits { slack: 0 }, CellProperty::AtMostOnce]
    {
        let relay = Relay { faults: loss(1), watches: vec![watch], ..Relay::default() };
        assert_eq!(explored(&relay.plan().expect("a sound declaration")).violation, None);
    }
}

#[test]
fn a_relay_forgets_nothing_that_memory_is_for() {
    let rules = Rules { memory: Memory::None, ..Rules::DEFAULT };
    let faults = Faults { dup: 1, ..Faults::default() };
    let relay = Relay { faults, rules, watches: vec![CellProperty::AtMostOnce], ..Relay::default() };
    assert_eq!(fails(&relay.plan().expect("a sound declaration")), Violation::ExecutedTwice);
}

#[test]
fn commands_stay_where_status_yields() {
    let watches = vec![CellProperty::Eviction];
    let relay =
        Relay { room: Some(1), time_out: (6, 4), transit: 1, sends: (1, 2), watches, ..Relay::default() };
    assert_eq!(explored(&relay.plan().expect("a sound declaration")).violation, None);
    let rules = Rules { eviction: Eviction::ByTime, ..Rules::DEFAULT };
    let relay = Relay { rules, ..relay };
    assert_eq!(fails(&relay.plan().expect("a sound declaration")), Violation::CommandEvicted);
}

#[test]
fn a_full_relay_tells_the_source() {
    let watches = vec![CellProperty::Reach(Goal::RefusedOnTheWay)];
    let relay =
        Relay { room: Some(1), transit: 1, commands: true, sends: (2, 2), watches, ..Relay::default() };
    let found = explored(&relay.plan().expect("a sound declaration"));
    assert_eq!(found.violation, Some(Violation::Reached));
}

#[test]
fn a_timer_that_waits_for_busy_tasks_stops_the_clock() {
    assert_eq!(explored(&busy_neighbour(Rules::DEFAULT).expect("a sound declaration")).violation, None);
    let rules = Rules { job_request: JobRequest::Blocking, ..Rules::DEFAULT };
    assert_eq!(fails(&busy_neighbour(rules).expect("a sound declaration")), Violation::NoOutcome);
}

#[test]
fn buffers_full_of_packets_for_each_other_come_free() {
    let plan = |watch| full_buffers(1, watch).expect("a sound declaration");
    let stuck = explored(&plan(CellProperty::Reach(Goal::BuffersFull)));
    assert_eq!(stuck.violation, Some(Violation::Reached));
    assert_eq!(explored(&plan(CellProperty::Waits { slack: 0 })).violation, None);
}

#[test]
fn clocks_apart_make_no_difference() {
    let drift = Faults { drift: 1, loss: 1, ..Faults::default() };
    let counts = [[0, 0, 0], [3, 0, 0], [200, 7, 99]].map(|clocks| {
        let watches = vec![CellProperty::Stale { slack: 1 }, CellProperty::Waits { slack: 0 }];
        let relay = Relay { clocks, faults: drift, sends: (1, 0), watches, ..Relay::default() };
        let found = explored(&relay.plan().expect("a sound declaration"));
        assert_eq!(found.violation, None);
        (found.states, found.transitions)
    });
    assert!(counts.iter().all(|count| *count == counts[0]));
    // If the receiver's node misses a tick while it holds a status message, the task gets the message at most one tick
    // late.
    let faults = Faults { drift: 1, ..Faults::default() };
    let late = |slack| {
        let watches = vec![CellProperty::Stale { slack }];
        Relay { faults, sends: (0, 1), watches, ..Relay::default() }.plan().expect("a sound declaration")
    };
    assert_eq!(fails(&late(0)), Violation::Stale);
    assert_eq!(explored(&late(1)).violation, None);
}

const INTERRUPTED: Interrupted = Interrupted {
    time_out: 6,
    queries: 1,
    relay: false,
    faults: Faults { loss: 0, dup: 0, crash: 0, drift: 0, late: 0, over: 0 },
    rules: Rules::DEFAULT,
    watches: Vec::new(),
};

#[test]
fn handlers_run_by_rank_and_the_thread_goes_on() {
    let watches = vec![CellProperty::Order, CellProperty::Waits { slack: 0 }];
    let plan = |rules, watches| Interrupted { rules, watches, ..INTERRUPTED }.plan().expect("sound");
    assert_eq!(explored(&plan(Rules::DEFAULT, watches.clone())).violation, None);
    let nested = plan(Rules::DEFAULT, vec![CellProperty::Reach(Goal::Nested)]);
    assert_eq!(fails(&nested), Violation::Reached);
    let careless = Rules { obey_order: false, ..Rules::DEFAULT };
    assert_eq!(fails(&plan(careless, watches)), Violation::NotOutranking);
}

#[test]
fn a_query_to_all_ends_once_with_a_mark_for_each() {
    let watches = vec![CellProperty::Waits { slack: 0 }, CellProperty::AtMostOnce];
    assert_eq!(explored(&query_all(loss(1), watches).expect("a sound declaration")).violation, None);
    let all = query_all(loss(0), vec![CellProperty::Reach(Goal::AllAnswered)]).expect("a sound declaration");
    assert_eq!(fails(&all), Violation::Reached);
}

const FLOOD: Flood = Flood {
    flooded: 1,
    room: 1,
    urgent: 2,
    ttl: 9,
    buffer: 1,
    every: 9,
    service: 1,
    rules: Rules::DEFAULT,
    served: false,
};

#[test]
fn ports_are_bypassed_only_so_often() {
    assert_eq!(explored(&FLOOD.plan().expect("a sound declaration")).violation, None);
    let rules = Rules { aging: Aging::Off, ..Rules::DEFAULT };
    let starving = Flood { flooded: 2, ttl: 20, rules, ..FLOOD };
    assert_eq!(fails(&starving.plan().expect("a sound declaration")), Violation::Bypassed);
    let bound = FLOOD.service().bound_by_gets().0;
    let served = |ttl| Flood { ttl, every: 9, served: true, ..FLOOD }.plan().expect("a sound declaration");
    assert_eq!(explored(&served(bound)).violation, None);
    assert_eq!(fails(&served(2)), Violation::NotServed);
}

#[test]
fn a_message_is_refused_only_so_often() {
    let workshop = Workshop {
        ttl: 9,
        every: 9,
        buffer: 1,
        rivals: 0,
        rank: 2,
        penalty: (2, false),
        service: 1,
        urgent: true,
        rules: Rules::DEFAULT,
        served: false,
    };
    assert_eq!(explored(&workshop.plan().expect("a sound declaration")).violation, None);
    let unbounded = Workshop { rules: Rules { aging: Aging::Unbounded, ..Rules::DEFAULT }, ..workshop };
    assert_eq!(fails(&unbounded.plan().expect("a sound declaration")), Violation::RefusedTooOften);
    let literal = Workshop { penalty: (2, true), ..workshop };
    assert_eq!(fails(&literal.plan().expect("a sound declaration")), Violation::RefusedTooOften);
    let served = Workshop { ttl: workshop.service().bound().0, served: true, ..workshop };
    assert_eq!(explored(&served.plan().expect("a sound declaration")).violation, None);
}

#[test]
fn a_script_shows_that_the_literal_penalty_revives_commands() {
    assert_eq!(explored(&penalised(false).expect("a sound declaration")).violation, None);
    assert_eq!(fails(&penalised(true).expect("a sound declaration")), Violation::Stale);
}

/// A cell of two tasks that each enter a shared place once, and note whether they are in it. With `meet`, the two tasks
/// first meet at a waitfor, which orders them.
fn sharing(meet: bool) -> Arc<CellScenario> {
    let mut cell = Cell::new("sharing", Ticks(1));
    let nodes = ["left", "right"].map(|name| cell.node(name));
    cell.link(nodes[0], nodes[1], Ticks(1));
    let [a, b] = [("a", nodes[0]), ("b", nodes[1])].map(|(name, node)| cell.task(name, node));
    let port = cell.port(PortDecl::new("turn", a, Usage::Waitfor, &[b], Ticks(9)));
    let program = |name: &str, first: bool| {
        let mut script = ProgramBuilder::new(name);
        let inside = script.variable("inside", Type::Bool);
        if meet && !first {
            script.waitfor(port);
        }
        script.set(inside, 1);
        script.run("use the place", Ticks(1), Ticks(2));
        script.set(inside, 0);
        if meet && first {
            script.waitfor(port);
        }
        script.end();
        TaskPlan::scripted(Arc::new(script.finish().expect("a sound program")))
    };
    let tasks = vec![program("a", true), program("b", false)];
    let mut plan = CellScenario::new(Arc::new(CellTable::new(cell).expect("a sound declaration")), tasks);
    let inside = |task| Term::Of { task, variable: 0 };
    plan.checks = vec![vec![inside(a), inside(b), Term::Int(Binary::And), Term::Not]];
    Arc::new(plan.watching(CellProperty::Waits { slack: 0 }))
}

#[test]
fn checks_look_at_the_variables_of_scripts() {
    assert_eq!(explored(&sharing(true)).violation, None);
    assert_eq!(explored(&sharing(false)).violation, Some(Violation::Check));
}
