//! Tests of the packed form of cell states: it loses nothing on which later behaviour depends, and fused steps reach the
//! same quiescent states.

use imrs_model::cell_state::plan::{CellProperty, CellScenario, Errand, Faults, TaskPlan, Times, Transfer};
use imrs_model::cell_state::worlds::{Flood, Interrupted, Relay, Workshop, penalised, query_all};
use imrs_model::cell_state::{CellModel, LiveCellState, Move, explore_cell_state};
use imrs_model::{Limits, Packed};
use imrs_protocol::rules::Rules;
use imrs_protocol::{Cell, CellTable, PortDecl, Target, Ticks, Usage};
use stateright::Model;
use std::collections::HashSet;
use std::sync::Arc;

fn successors(model: &CellModel, state: &Packed) -> HashSet<Packed> {
    let mut moves: Vec<Move> = Vec::new();
    model.actions(state, &mut moves);
    moves.into_iter().filter_map(|step| model.next_state(state, step)).collect()
}

/// Explores the cell with unpacked copies of its states, and checks that the packed form of every state has the same
/// successors. Returns how many states there are.
fn live_and_packed_agree(plan: &Arc<CellScenario>) -> usize {
    let model = CellModel::new(plan, Limits::default());
    let start = LiveCellState::new(plan);
    assert_eq!(model.init_states(), [start.packed()]);
    let mut seen = HashSet::from([start.packed()]);
    // The search goes depth first, because a whole copy takes kilobytes, and a breadth-first queue would keep thousands of
    // such copies.
    let mut open = vec![(start.packed(), start)];
    while let Some((packed, live)) = open.pop() {
        if packed.is_final() {
            continue;
        }
        assert_eq!(model.rewritten(&packed), packed, "written again it is the same");
        assert!(packed.len() <= 256);
        let next: Vec<_> = live.next().into_iter().map(|live| (live.packed(), live)).collect();
        let after: HashSet<Packed> = next.iter().map(|(packed, _)| packed.clone()).collect();
        assert_eq!(after, successors(&model, &packed));
        open.extend(next.into_iter().filter(|(packed, _)| seen.insert(packed.clone())));
    }
    let violations: Vec<_> = seen.iter().filter_map(Packed::violation).collect();
    assert_eq!(violations, []);
    let found = explore_cell_state(plan, Limits::default());
    assert_eq!((found.states as usize, found.complete), (seen.len(), true));
    seen.len()
}

fn every_watch() -> Vec<CellProperty> {
    vec![CellProperty::Stale { slack: 0 }, CellProperty::Waits { slack: 0 }, CellProperty::AtMostOnce]
}

#[test]
fn a_relay_with_losses_and_copies() {
    let faults = Faults { loss: 1, dup: 1, ..Faults::default() };
    let relay = Relay { faults, time_out: (5, 3), watches: every_watch(), ..Relay::default() };
    println!("{} states", live_and_packed_agree(&relay.plan().expect("a sound declaration")));
}

#[test]
fn a_relay_whose_links_take_one_packet_a_tick() {
    let relay = Relay {
        room: Some(1),
        transit: 1,
        commands: true,
        time_out: (5, 5),
        watches: every_watch(),
        ..Relay::default()
    };
    println!("{} states", live_and_packed_agree(&relay.plan().expect("a sound declaration")));
}

#[test]
fn a_relay_with_drift_lateness_and_a_crash() {
    let faults = Faults { drift: 1, late: 1, over: 1, ..Faults::default() };
    let watches = vec![CellProperty::Stale { slack: 3 }];
    let relay = Relay { faults, sends: (1, 0), watches: watches.clone(), ..Relay::default() };
    println!("{} states", live_and_packed_agree(&relay.plan().expect("a sound declaration")));
    let faults = Faults { crash: 1, ..Faults::default() };
    let relay = Relay { faults, sends: (2, 0), watches, ..Relay::default() };
    println!("{} states", live_and_packed_agree(&relay.plan().expect("a sound declaration")));
}

#[test]
fn handlers_sets_floods_and_scripts() {
    let plan = |plan: Result<_, _>| plan.expect("a sound declaration");
    let interrupted = Interrupted {
        time_out: 6,
        queries: 1,
        relay: false,
        faults: Faults::default(),
        rules: Rules::DEFAULT,
        watches: vec![CellProperty::Order, CellProperty::Waits { slack: 0 }],
    };
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
    let flood = Flood {
        flooded: 1,
        room: 1,
        urgent: 2,
        ttl: 9,
        buffer: 2,
        every: 9,
        service: 1,
        rules: Rules::DEFAULT,
        served: false,
    };
    let faults = Faults { loss: 1, ..Faults::default() };
    let plans = [
        plan(interrupted.plan()),
        plan(workshop.plan()),
        plan(flood.plan()),
        plan(query_all(faults, every_watch())),
        plan(penalised(false)),
    ];
    for plan in plans {
        println!("{} states", live_and_packed_agree(&plan));
    }
}

/// A cell of two nodes with two tasks each: commands within a node, and a waitfor across the nodes.
fn neighbours(fused: bool) -> Arc<CellScenario> {
    let mut cell = Cell::new("neighbours", Ticks(1));
    let [here, there] = ["here", "there"].map(|name| cell.node(name));
    cell.link(here, there, Ticks(1));
    let [a, b] = ["a", "b"].map(|name| cell.task(name, here));
    let c = cell.task("c", there);
    let ask = cell.port(PortDecl::new("ask", a, Usage::Send, &[b, c], Ticks(4)).command());
    let meet = cell.port(PortDecl::new("meet", b, Usage::Waitfor, &[c], Ticks(5)));
    let send = Errand::Send { port: ask, to: Target::One(b), times: Times::Most(2), every: 0 };
    let meeting = Errand::Meet { port: meet, times: Times::Most(1) };
    let receive = Errand::Receive { port: None, time_out: None };
    let tasks = vec![TaskPlan::new(send), TaskPlan::new(receive), TaskPlan::new(meeting)];
    let mut plan = CellScenario::new(Arc::new(CellTable::new(cell).expect("a sound declaration")), tasks);
    plan.fused = fused;
    plan.jumps = false;
    plan.transfer = Transfer::Any;
    plan.faults.loss = 1;
    Arc::new(plan.watching(CellProperty::Waits { slack: 0 }).watching(CellProperty::Stale { slack: 0 }))
}

/// A cell of three members of a waitfor, two of them on one node.
fn members(fused: bool) -> Arc<CellScenario> {
    let mut cell = Cell::new("members", Ticks(1));
    let [here, there] = ["here", "there"].map(|name| cell.node(name));
    cell.link(here, there, Ticks(1));
    let [a, b] = ["a", "b"].map(|name| cell.task(name, here));
    let c = cell.task("c", there);
    let meet = cell.port(PortDecl::new("meet", a, Usage::Waitfor, &[b, c], Ticks(4)));
    let meeting = TaskPlan::new(Errand::Meet { port: meet, times: Times::Most(1) });
    let table = Arc::new(CellTable::new(cell).expect("a sound declaration"));
    let mut plan = CellScenario::new(table, vec![meeting.clone(), meeting.clone(), meeting]);
    (plan.fused, plan.jumps, plan.transfer) = (fused, false, Transfer::Any);
    Arc::new(plan.watching(CellProperty::Waits { slack: 0 }))
}

fn reachable(plan: &Arc<CellScenario>) -> (CellModel, HashSet<Packed>) {
    let model = CellModel::new(plan, Limits::default());
    let mut seen: HashSet<Packed> = model.init_states().into_iter().collect();
    let mut queue: Vec<Packed> = seen.iter().cloned().collect();
    while let Some(state) = queue.pop() {
        queue.extend(successors(&model, &state).into_iter().filter(|next| seen.insert(next.clone())));
    }
    (model, seen)
}

/// The quiescent states that a cell reaches by fused steps, and the quiescent states that it reaches if the tasks of a node
/// take their inputs in every order.
fn both_ways(plan: fn(bool) -> Arc<CellScenario>) -> [HashSet<Packed>; 2] {
    let (fused_model, fused) = reachable(&plan(true));
    let (model, unfused) = reachable(&plan(false));
    assert!(!unfused.iter().any(Packed::is_final), "a watch found something, or a state outgrew its form");
    // The unfused form also packs queued inputs. To compare states, a cell with fused steps packs them again.
    let quiet = unfused.iter().filter(|s| model.is_quiescent(s)).map(|s| model.as_fused(s)).collect();
    println!("{} fused, {} unfused", fused.len(), unfused.len());
    assert!(unfused.len() > fused.len() && fused.iter().all(|s| fused_model.is_quiescent(s)));
    [fused, quiet]
}

/// The small steps commute: the tasks of a node may take their inputs in any order.
#[test]
fn fused_and_unfused_steps_reach_the_same_quiescent_states() {
    let [fused, quiet] = both_ways(neighbours);
    assert_eq!(quiet, fused);
    live_and_packed_agree(&neighbours(false));
}

/// Arrivals of two members on one node may cross: then each member is released by the other's arrival, and neither by a
/// CONFIRM. So the unfused steps reach all states that the fused steps reach, and more, and violate no property.
#[test]
fn arrivals_that_cross_within_a_node_reach_states_of_their_own() {
    let [fused, quiet] = both_ways(members);
    assert!(fused.is_subset(&quiet) && quiet.len() > fused.len(), "{} of {}", fused.len(), quiet.len());
}
