//! Tests communication tasks that compute with symbolic times instead of numbers.

use super::{Clock, Evaluate, Run, State, on_symbols, random_runs_are_alike, showing};
use crate::support::world::{Op, World};
use crate::support::{Effects, handle, order, send_for};
use imrs_protocol::*;
use std::collections::BTreeSet;
use std::sync::Arc;

impl State for World {
    fn bytes(mut self, evaluate: &mut Evaluate<'_>) -> Vec<Result<Vec<u8>, Overflow>> {
        for (task, table) in self.tasks.iter_mut().zip(&self.tables) {
            task.walk(table, evaluate);
        }
        (0..self.tasks.len()).map(|task| World::bytes(&self, task)).collect()
    }
}

fn run(world: &World, ops: &[Op], clock: Clock<'_>) -> Run<World> {
    let mut end = world.clone();
    let step = |(op, step): (&Op, u8)| {
        end.at = Some(clock(step));
        end.step(*op)
    };
    let effects = ops.iter().zip(1..).map(step).collect();
    Run { effects, end }
}

#[test]
fn symbols_stand_for_all_numbers_that_are_answered_alike() {
    random_runs_are_alike((1_500, 0..12), |world| world, run);
}

/// The effects of a message with a TTL of 9 ticks that a working thread rejects. The penalty of 4 ticks is cut to half of
/// the remaining time.
fn rejected(times: Clock<'_>) -> Vec<Effects> {
    let mut cell = Cell::new("rejected", Ticks(1));
    let node = cell.node("n");
    let [asker, worker] = ["asker", "worker"].map(|name| cell.task(name, node));
    let port = cell.port(PortDecl::new("p", asker, Usage::Send, &[worker], Ticks(100)).penalty(Ticks(4)));
    let mut world = World::new(&Arc::new(CellTable::new(cell).expect("a sound cell")), false);
    world.at = Some(times(1));
    for request in [handle(port), order(&[Ranked::Own, Ranked::Port(port)]), Request::Work] {
        world.input(worker.index(), Input::Request(request));
    }
    let sent = world.input(asker.index(), Input::Request(send_for(port, worker, 7, 9)));
    let deadline = times(1) + sent.packets[0].remaining;
    world.at = Some(times(2));
    let heard = world
        .input(worker.index(), Input::Packet(Packet { remaining: deadline - times(2), ..sent.packets[0] }));
    world.at = Some(times(3));
    vec![sent, heard, world.pass(worker.index(), 0)]
}

#[test]
fn a_penalty_is_cut_to_half_of_a_symbolic_rest() {
    let mut ends = BTreeSet::new();
    for (second, third) in (0..10).flat_map(|second| (0..6).map(move |more| (second, second + more))) {
        let values = [1_000, 1_000 + second, 1_000 + third];
        let (symbols, zone) = on_symbols(&values, || rejected(&symbolic::instant));
        let numbers = rejected(&showing(&values));
        let evaluate = Evaluate(&zone);
        let symbols: Vec<Effects> = symbols.iter().map(|effects| evaluate.effects(effects)).collect();
        assert_eq!(symbols, numbers, "at {values:?}");
        ends.insert(numbers[2].is_nothing());
    }
    assert_eq!(ends.len(), 2, "some are offered again by the end, and some are not");
}
