//! Floors: whole nodes, relays, links that take only so much.

use imrs_model::floor::plan::{Faults, FloorPlan, FloorWatch, Goal};
use imrs_model::floor::worlds::{Relay, busy_neighbour, full_buffers};
use imrs_model::floor::{FloorModel, Move, draw_floor, explore_floor};
use imrs_model::{Exploration, Limits, Violation};
use imrs_protocol::rules::{Eviction, JobRequest, Memory, Rules};
use std::sync::Arc;

fn explored(plan: &Arc<FloorPlan>) -> Exploration<Move> {
    let found = explore_floor(plan, Limits { states: 1_000_000, memory: 4 << 30 });
    println!(
        "{:?}: {} states, {} transitions, depth {}, {} bytes, {:.2} s",
        plan.watches, found.states, found.transitions, found.depth, found.longest_state, found.seconds
    );
    if let Some(c) = draw_floor(plan, &found) {
        println!("{}", c.chart);
    }
    assert!(found.complete);
    found
}

fn loss(loss: u8) -> Faults {
    Faults { loss, ..Faults::default() }
}

#[test]
fn relays_keep_the_promises() {
    for watch in [FloorWatch::Stale { slack: 0 }, FloorWatch::Waits { slack: 0 }, FloorWatch::AtMostOnce] {
        let relay = Relay { faults: loss(1), watches: vec![watch], ..Relay::default() };
        assert_eq!(explored(&relay.plan().expect("a sound declaration")).violation, None);
    }
}

#[test]
fn a_relay_forgets_nothing_that_memory_is_for() {
    let rules = Rules { memory: Memory::None, ..Rules::DEFAULT };
    let faults = Faults { dup: 1, ..Faults::default() };
    let relay = Relay { faults, rules, watches: vec![FloorWatch::AtMostOnce], ..Relay::default() };
    let found = explored(&relay.plan().expect("a sound declaration"));
    assert_eq!(found.violation, Some(Violation::ExecutedTwice));
}

#[test]
fn commands_stay_where_status_yields() {
    let watches = vec![FloorWatch::Eviction];
    let relay =
        Relay { room: Some(1), time_out: (6, 4), transit: 1, sends: (1, 2), watches, ..Relay::default() };
    assert_eq!(explored(&relay.plan().expect("a sound declaration")).violation, None);
    let rules = Rules { eviction: Eviction::ByTime, ..Rules::DEFAULT };
    let found = explored(&Relay { rules, ..relay }.plan().expect("a sound declaration"));
    assert_eq!(found.violation, Some(Violation::CommandEvicted));
}

#[test]
fn a_full_relay_tells_the_source() {
    let watches = vec![FloorWatch::Reach(Goal::RefusedOnTheWay)];
    let relay =
        Relay { room: Some(1), transit: 1, commands: true, sends: (2, 2), watches, ..Relay::default() };
    let found = explored(&relay.plan().expect("a sound declaration"));
    assert_eq!(found.violation, Some(Violation::Reached));
}

#[test]
fn a_timer_that_waits_for_busy_tasks_stops_the_clock() {
    assert_eq!(explored(&busy_neighbour(Rules::DEFAULT).expect("a sound declaration")).violation, None);
    let rules = Rules { job_request: JobRequest::Blocking, ..Rules::DEFAULT };
    let found = explored(&busy_neighbour(rules).expect("a sound declaration"));
    assert_eq!(found.violation, Some(Violation::NoOutcome));
}

#[test]
fn buffers_full_of_packets_for_each_other_come_free() {
    let plan = |watch| full_buffers(1, watch).expect("a sound declaration");
    let stuck = explored(&plan(FloorWatch::Reach(Goal::BuffersFull)));
    assert_eq!(stuck.violation, Some(Violation::Reached));
    assert_eq!(explored(&plan(FloorWatch::Waits { slack: 0 })).violation, None);
}

#[test]
fn clocks_apart_make_no_difference() {
    let drift = Faults { drift: 1, loss: 1, ..Faults::default() };
    let counts = [[0, 0, 0], [3, 0, 0], [200, 7, 99]].map(|clocks| {
        let watches = vec![FloorWatch::Stale { slack: 1 }, FloorWatch::Waits { slack: 1 }];
        let relay = Relay { clocks, faults: drift, sends: (1, 0), watches, ..Relay::default() };
        let found = explored(&relay.plan().expect("a sound declaration"));
        assert_eq!(found.violation, None);
        (found.states, found.transitions)
    });
    assert!(counts.iter().all(|count| *count == counts[0]));
}
