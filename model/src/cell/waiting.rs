//! Detects tasks that wait for ever: for each other (deadlock), or for a task that will send nothing any more.

use super::judge::{Shown, name, position, program, statement};
use super::missed::{next, reached_from};
use super::run_state::RunState;
use super::verdict::Kind;
use imrs_protocol::script::{Activity, Op, Program, Term};
use imrs_protocol::{CellTable, Instant, Packet, PortId, TaskId, Usage};

/// The finding of tasks that wait for each other for ever. If there are none, the finding of a task that is left waiting.
/// `goes_on`: whether other moves are still possible.
pub(super) fn for_ever(run_state: &RunState, goes_on: bool) -> Option<Shown> {
    let closed = closed(run_state, goes_on);
    // In most states no task waits for ever, so this test ends most calls.
    if !closed.contains(&true) {
        return None;
    }
    ring(run_state, closed.clone(), goes_on).or_else(|| left(run_state, closed))
}

/// The finding of tasks that wait for each other for ever.
pub(super) fn deadlock(run_state: &RunState, goes_on: bool) -> Option<Shown> {
    ring(run_state, closed(run_state, goes_on), goes_on)
}

/// The waiting tasks that no task outside this set can help any more.
fn closed(run_state: &RunState, goes_on: bool) -> Vec<bool> {
    let waits = |task: usize| {
        run_state.is_up(task) && matches!(run_state.activity(task), Some(Activity::Waits | Activity::Acts))
    };
    let mut closed: Vec<bool> = (0..run_state.plan.tasks.len())
        .map(|task| if goes_on { waits_for_good(run_state, task) } else { waits(task) })
        .collect();
    if goes_on {
        keep_closed(run_state, &mut closed);
        // The scan of all packets comes second, because in most states the set is already empty here.
        closed
            .iter_mut()
            .enumerate()
            .for_each(|(task, closed)| *closed = *closed && !is_coming(run_state, task));
        keep_closed(run_state, &mut closed);
    }
    closed
}

/// A finding if some of the tasks `alive` wait for each other.
fn ring(run_state: &RunState, mut alive: Vec<bool>, goes_on: bool) -> Option<Shown> {
    let n = alive.len();
    // A helper of a waiting task is any task that could still send the message for which it waits.
    let helpers: Vec<Vec<usize>> =
        (0..n).map(|task| if alive[task] { senders(run_state, task) } else { Vec::new() }).collect();
    // A task whose helpers have all ended is at rest. The tasks that remain wait in a cycle.
    loop {
        let at_rest = (0..n).find(|&task| alive[task] && !helpers[task].iter().any(|&helper| alive[helper]));
        let Some(task) = at_rest else { break };
        alive[task] = false;
    }
    let first = alive.iter().position(|&alive| alive)?;
    let table = &run_state.plan.table;
    let ring: Vec<String> = (0..n)
        .filter(|&task| alive[task])
        .map(|task| {
            let whom: Vec<&str> = helpers[task].iter().map(|&helper| name(table, helper)).collect();
            format!("{} for {}", waits_at(run_state, task), whom.join(" or "))
        })
        .collect();
    Some(Shown {
        task: Some(first),
        address: Some(position(run_state, first)),
        others: (0..n).filter(|&task| alive[task]).collect(),
        last: !goes_on,
        ..Shown::whole(Kind::Deadlock, &ring.join("; "))
    })
}

/// Whether a task waits in a `receive` without a time_out, and no deadline or lease of its communication task ends the
/// wait.
fn waits_for_good(run_state: &RunState, task: usize) -> bool {
    let node_state = &run_state.cell.nodes[run_state.cell.node_state_of(task)];
    matches!(operation(run_state, task), Some(Op::Get { time_out: None, .. }))
        && run_state.is_up(task)
        && run_state.activity(task) == Some(Activity::Waits)
        && node_state
            .node
            .task(TaskId::from_index(task))
            .is_some_and(|machine| machine.next_deadline() == Instant::NEVER && machine.epoch().is_none())
}

/// Whether a packet for a task is in flight, or a timer of the task runs.
fn is_coming(run_state: &RunState, task: usize) -> bool {
    let id = TaskId::from_index(task);
    let for_it = |packet: &Packet| packet.destination == id;
    run_state.cell.in_flight.iter().any(|carried| for_it(&carried.packet))
        || run_state.cell.nodes.iter().filter(|node_state| node_state.up).any(|node_state| {
            let parts = node_state.node.parts();
            parts.transit.waiting().iter().any(for_it)
                || parts.timer.entries().iter().any(|(owner, ..)| *owner == id)
        })
}

/// Removes tasks from the set until no task outside of the set can help any task of the set.
fn keep_closed(run_state: &RunState, closed: &mut [bool]) {
    let has_ended =
        |task: usize| run_state.is_up(task) && matches!(run_state.activity(task), Some(Activity::Ended(_)));
    loop {
        let helped = (0..closed.len()).find(|&task| {
            closed[task] && heard_by(run_state, task).any(|helper| !closed[helper] && !has_ended(helper))
        });
        let Some(task) = helped else { return };
        closed[task] = false;
    }
}

/// The tasks that can send any message to a task, for its body or for a handler.
fn heard_by(run_state: &RunState, task: usize) -> impl Iterator<Item = usize> {
    let (table, id) = (&run_state.plan.table, TaskId::from_index(task));
    let ports = receives(table, id).into_iter().filter_map(move |port| table.port(port));
    ports.flat_map(move |port| port.peers(id)).map(TaskId::index)
}

/// The tasks that could send what this task waits for: a message for its GET, or a heartbeat for its lease.
fn senders(run_state: &RunState, task: usize) -> Vec<usize> {
    let table = &run_state.plan.table;
    let at = TaskId::from_index(task);
    let (ports, from): (Vec<PortId>, Option<TaskId>) = match operation(run_state, task) {
        Some(Op::Get { port: Some(port), source, .. }) => (vec![*port], *source),
        Some(Op::Get { port: None, source, .. }) => (receives(table, at), *source),
        // The primary waits for the lease, which the standby's heartbeats grant.
        Some(Op::Lease) => {
            let couples = table.cell().couples.iter();
            (couples.filter(|couple| couple.primary == at).map(|couple| couple.via).collect(), None)
        }
        _ => return Vec::new(),
    };
    let peers = ports.iter().filter_map(|&port| table.port(port)).flat_map(|port| port.peers(at));
    let peers = peers.filter(|peer| from.is_none_or(|from| from == *peer));
    let mut peers: Vec<usize> = peers.map(TaskId::index).collect();
    peers.sort_unstable();
    peers.dedup();
    peers
}

/// The ports on which a task receives messages.
fn receives(table: &CellTable, task: TaskId) -> Vec<PortId> {
    let usage = |port: &PortId| table.port(*port)?.party(task).map(|party| party.usage);
    let takes = |port: &PortId| matches!(usage(port), Some(Usage::Receive | Usage::Response));
    table.ports_of(task).iter().copied().filter(takes).collect()
}

/// A task of the set that is left waiting: its body waits in a `receive` in the middle of its work, or waits for its lease.
/// All tasks that could help have ended or wait for messages themselves. A task of a node that is down may help after a
/// restart.
///
/// A server at the head of its endless loop is at rest, because it has done all its work. A primary whose standby has taken
/// over and ended is at rest, too.
fn left(run_state: &RunState, mut closed: Vec<bool>) -> Option<Shown> {
    keep_closed(run_state, &mut closed);
    let is_left = |&task: &usize| {
        let at = usize::from(position(run_state, task));
        closed[task]
            && run_state.activity(task) == Some(Activity::Waits)
            && !run_state.plan.outside.contains(&task)
            && program(run_state, task).is_some_and(|program| !is_served_at(program, at))
            && !is_relieved(run_state, task)
    };
    let left: Vec<usize> = (0..closed.len()).filter(is_left).collect();
    let &task = left.first()?;
    let (at, table) = (position(run_state, task), &run_state.plan.table);
    let helpers = senders(run_state, task);
    let state = |&helper: &usize| {
        let ended = matches!(run_state.activity(helper), Some(Activity::Ended(_)));
        format!("{} {}", name(table, helper), if ended { "has ended" } else { "sends nothing any more" })
    };
    let why: Vec<String> = helpers.iter().map(state).collect();
    let cause = format!("{} for ever: {}", waits_at(run_state, task), why.join(", "));
    let mut others: Vec<usize> = left[1..].iter().chain(&helpers).copied().collect();
    others.sort_unstable();
    others.dedup();
    let (task, address) = (Some(task), Some(at));
    Some(Shown { task, address, others, last: false, ..Shown::whole(Kind::WaitsForEver, &cause) })
}

/// Whether a task waits for its lease while its standby has taken over and ended.
fn is_relieved(run_state: &RunState, task: usize) -> bool {
    matches!(operation(run_state, task), Some(Op::Lease))
        && senders(run_state, task).into_iter().any(|standby| {
            matches!(run_state.activity(standby), Some(Activity::Ended(_)))
                && has_taken_over(run_state, standby)
        })
}

/// Whether a task that has ended must have taken over before, because its body has no end.
fn has_taken_over(run_state: &RunState, task: usize) -> bool {
    program(run_state, task).is_some_and(|Program { code, takeover, .. }| {
        let body = reached_from(code, [0], |at| next(&code[at], at));
        let has_end = (0..code.len()).any(|at| body[at] && matches!(code[at], Op::End | Op::Abort(_)));
        takeover.is_some() && !has_end
    })
}

/// Whether the `receive` at this address is a first wait of an endless loop.
fn is_served_at(program: &Program, at: usize) -> bool {
    let code = &program.code;
    // Follows one iteration of the loop up to its first waits. If a path leaves the loop before them, the loop is a
    // `while`, which may end.
    let is_first_wait = |head: usize, end: usize| {
        let is_inside = |at: usize| (head..=end).contains(&at);
        let round = reached_from(code, [head], |at| match code[at] {
            op if waits(&op) || !is_inside(at) => [None; 2],
            // In `while true` the condition never ends the loop.
            Op::Unless(_) if at > head && code[at - 1] == Op::Term(Term::Push(1)) => [None, Some(at + 1)],
            op => next(&op, at),
        });
        round[at] && (0..code.len()).all(|at| is_inside(at) || !round[at])
    };
    matches!(code.get(at), Some(Op::Get { .. }))
        && (0..code.len()).any(|end| match code[end] {
            Op::Jump(head) if usize::from(head) <= end => is_first_wait(head.into(), end),
            _ => false,
        })
}

/// Whether an operation waits for something.
const fn waits(op: &Op) -> bool {
    matches!(
        op,
        Op::Send { .. } | Op::Get { .. } | Op::Arrive { .. } | Op::Delay(_) | Op::Run { .. } | Op::Lease
    )
}

/// The operation at which a task's own thread is.
fn operation(run_state: &RunState, task: usize) -> Option<&Op> {
    program(run_state, task)?.code.get(usize::from(position(run_state, task)))
}

/// Where a task waits, in words: `arm waits at receive `part``.
fn waits_at(run_state: &RunState, task: usize) -> String {
    let table = &run_state.plan.table;
    let what = program(run_state, task)
        .map_or_else(String::new, |program| statement(table, program, position(run_state, task)));
    format!("{} waits at {what}", name(table, task))
}
