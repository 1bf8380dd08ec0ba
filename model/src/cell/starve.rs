//! Detects starvation: a request waits all the time, and is rejected or bypassed more often than aging allows (§5.1.1, D58,
//! D59).
//!
//! A request that ended by its time_out may have arrived late, or may have been bypassed while it waited. So the path to
//! the finding is replayed, and two numbers are counted at each receiver of the request: how often it is rejected by rank,
//! and how many other messages are taken before it. Aging bounds both numbers. A request that exceeds a bound would not
//! have been served in time with any time_out.

use super::judge::{Shown, name, statement};
use super::plan::{CellFaults, CellPlan, Conduct};
use super::story;
use super::verdict::Kind;
use imrs_protocol::aging::bypass_limit;
use imrs_protocol::script::{Address, Op, ScriptInput};
use imrs_protocol::{PortId, Signal, TaskId};
use std::sync::Arc;

/// What has happened to a request at one of its receivers.
#[derive(Clone, Copy, Default)]
struct Wait {
    /// The number of rejections that the receiver's port has counted so far.
    counted: u64,
    /// How often the port has rejected messages since the request arrived, because they did not outrank what the task did.
    rejected: u64,
    /// The number of messages of other tasks that were taken since the request arrived.
    passed: u64,
    /// How many messages the buffer of the receiver's port holds.
    capacity: u64,
}

/// Turns the finding of a time_out into one of starvation, if the path shows that the request starved. `shown` is the
/// finding of the last move.
pub(super) fn decided(plan: &Arc<CellPlan>, moves: &[super::CellMove], shown: Shown) -> Shown {
    match (shown.kind, shown.task.zip(shown.address)) {
        (Kind::TimeOut, Some(place)) => match starved(plan, moves, place) {
            Some(cause) => Shown { kind: Kind::Starves, cause, ..shown },
            None => shown,
        },
        _ => shown,
    }
}

/// How a request that ended by its time_out starved; `None` if it did not starve.
fn starved(
    plan: &Arc<CellPlan>,
    moves: &[super::CellMove],
    (task, address): (usize, Address),
) -> Option<String> {
    let Conduct::Program { program, .. } = &plan.tasks[task] else { return None };
    let Some(Op::Send { port, .. }) = program.code.get(usize::from(address)) else { return None };
    let source = TaskId::from_index(task);
    let peers: Vec<usize> = plan.table.port(*port)?.peers(source).map(TaskId::index).collect();
    let mut waits = vec![Wait::default(); peers.len()];
    let mut last = Vec::new();
    story::walk(plan, &CellFaults::default(), moves, |walked| {
        last.clone_from(&waits);
        for (wait, &peer) in waits.iter_mut().zip(&peers) {
            let node_state = &walked.run_state.cell.nodes[walked.run_state.cell.node_state_of(peer)];
            let machine = node_state.node.task(TaskId::from_index(peer));
            let view = machine.map(|machine| machine.view(&node_state.table, usize::MAX));
            let view = view.as_ref().and_then(|view| view.ports.iter().find(|view| view.port == *port));
            let Some(view) = view else { continue };
            let rejected = wait.rejected + view.counters.rejected.saturating_sub(wait.counted);
            let waits = view.queue.iter().any(|held| held.source == source);
            let passed = if waits { wait.passed } else { 0 };
            let rejected = if waits { rejected } else { 0 };
            let capacity = u64::from(view.capacity);
            *wait = Wait { counted: view.counters.rejected, rejected, passed, capacity };
            if !waits {
                continue;
            }
            let took = |turn: &&crate::cell_state::script::ScriptReaction| {
                let taken = |signal: &Signal| matches!(signal, Signal::Message(_) | Signal::Interrupt(_));
                turn.task == peer && matches!(&turn.input, ScriptInput::Signal(signal) if taken(signal))
            };
            wait.passed += walked.turns.iter().filter(took).count() as u64;
        }
    });
    let found = last.iter().zip(&peers).find_map(|(wait, &peer)| {
        let (refusals, bypasses) = bounds(plan, peer, *port, source);
        let bypasses = (bypasses + 1) * wait.capacity.max(1);
        let (times, most, how) = match (wait.rejected > refusals, wait.passed > bypasses) {
            (true, _) => (wait.rejected, refusals, "rejected"),
            (false, true) => (wait.passed, bypasses, "bypassed"),
            (false, false) => return None,
        };
        Some((peer, times, most, how))
    });
    let (peer, times, most, how) = found?;
    let (asker, asked) = (name(&plan.table, task), name(&plan.table, peer));
    let what = statement(&plan.table, program, address);
    Some(format!("{asker}: {what} starves: {how} {times} times at {asked}, where aging allows K = {most}"))
}

/// How often aging lets a message be rejected by rank, and bypassed by GETs (D58, D59).
fn bounds(plan: &CellPlan, task: usize, port: PortId, source: TaskId) -> (u64, u64) {
    let orders = match &plan.tasks[task] {
        Conduct::Program { program, .. } => program.orders.as_slice(),
        Conduct::Extern(_) => &[],
    };
    let rank = orders.iter().map(|order| u64::from(order.rank(port, source))).max().unwrap_or(1).max(1);
    let levels = orders.iter().map(|order| order.ranked().len()).max().unwrap_or(0);
    let ports = u16::try_from(plan.table.ports_of(TaskId::from_index(task)).len()).unwrap_or(u16::MAX);
    let limit = bypass_limit(ports, u8::try_from(levels).unwrap_or(u8::MAX));
    (rank, u64::from(limit.saturating_add(ports.saturating_sub(1))))
}
