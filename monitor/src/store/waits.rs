//! The wait-for graph over every kind of wait: a `waitfor` with missing members, an unanswered request, and a receive
//! with a single possible sender. From the graph follow the tasks for which others wait, and the wait-for cycles.

use super::meeting::{Meeting, Standing, meetings};
use super::names::Names;
use super::trail::Seen;
use super::{NodeIncarnation, Presence, Store};
use crate::clock::Moment;
use crate::name::Name;
use imrs_protocol::{Event, NodeId, PortId, TaskId, TaskState, Usage};
use imrs_wire::obs::{Liveness, TaskSnapshot};
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

/// The greatest normal age of a node's state in the store: one snapshot period plus the transfer.
const PERIOD: Duration = Duration::from_millis(200);

/// An edge of the graph: one task waits for another.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wait {
    /// The waiting task.
    pub waiter: TaskId,
    /// The awaited task.
    pub on: TaskId,
    /// The port of the wait.
    pub port: PortId,
    /// The kind of wait: `waitfor lift`, `reply grip`, `receive beat`.
    pub why: String,
    /// How long the wait has lasted, in microseconds; `None` for a wait without a time_out.
    pub waited_us: Option<u64>,
    /// The time_out of the wait, in microseconds.
    pub time_out_us: Option<u64>,
}

/// A cycle of tasks in which each waits for the next. Only a time_out ends such a cycle.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cycle {
    /// The tasks, starting with the least id.
    pub tasks: Vec<TaskId>,
    /// For each task, why it waits for the next: `armL waits for hoist (waitfor lift)`.
    pub why: Vec<String>,
}

/// A task for which other tasks wait.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Awaited {
    /// The awaited task.
    pub task: TaskId,
    /// The tasks that wait for the awaited task, directly or indirectly, ascending.
    pub by: Vec<TaskId>,
    /// The longest of the waits for the awaited task.
    pub wait: Wait,
}

/// The waits of a cell that only the awaited task can end, sorted by waiting task.
#[must_use]
pub fn waits(store: &Store, cell: &Name, now: Moment) -> Vec<Wait> {
    let Some(names) = store.names(cell) else { return Vec::new() };
    let mut found = Vec::new();
    for meeting in meetings(store, cell, now) {
        at_meeting(&meeting, names, &mut found);
    }
    let nodes = (0..names.nodes.len()).filter_map(|i| store.latest(cell, NodeId::from_index(i)));
    for incarnation in nodes.filter(|incarnation| incarnation.presence(now) == Presence::Up) {
        for task in incarnation.tasks().iter().filter(|task| task.liveness == Liveness::Alive) {
            found.extend(at_port(incarnation, task, now));
        }
    }
    found.sort_by_key(|wait| (wait.waiter, wait.on, wait.port));
    found
}

/// A member waits for the members that have not arrived. An arrival that is still in flight counts as an arrival.
fn at_meeting(meeting: &Meeting, names: &Names, found: &mut Vec<Wait>) {
    let waiting = meeting.members.iter().filter(|m| m.standing == Standing::Arrived);
    for member in waiting {
        for awaited in member.waits_for.iter().filter_map(|&j| meeting.members.get(j)) {
            if !matches!(awaited.standing, Standing::Arrived | Standing::Released) {
                let why = format!("waitfor {}", names.port_name(meeting.port));
                let time_out_us = member.waited_us.zip(member.left).map(|(waited, left)| waited + left.us);
                found.push(Wait {
                    waiter: member.task,
                    on: awaited.task,
                    port: meeting.port,
                    why,
                    waited_us: member.waited_us,
                    time_out_us,
                });
            }
        }
    }
}

fn at_port(incarnation: &NodeIncarnation, task: &TaskSnapshot, now: Moment) -> Option<Wait> {
    let (names, waiter) = (&incarnation.names, task.view.task);
    let (port, on, kind, remaining) = match task.view.state {
        TaskState::AwaitingReply { port, from, remaining } => (port, from, "reply", Some(remaining)),
        TaskState::Receiving { port, remaining } => {
            let (port, on) = sole_sender(incarnation, waiter, port)?;
            (port, on, "receive", remaining)
        }
        TaskState::Running | TaskState::Waiting { .. } | TaskState::Delaying => return None,
    };
    let why = format!("{kind} {}", names.port_name(port));
    // A receive may have a shorter or longer time_out than the port declares, so its length is unknown.
    let declared = names.port(port).and_then(|info| info.time_out(waiter)).filter(|_| kind == "reply");
    let time_out_us = declared.map(|ticks| ticks.0.saturating_mul(incarnation.tick_us));
    let left = remaining.map(|ticks| incarnation.left(ticks, task.age_us, now).us);
    let waited_us = time_out_us.zip(left).map(|(whole, left)| whole.saturating_sub(left));
    Some(Wait { waiter, on, port, why, waited_us, time_out_us })
}

/// The only task that can end a receive, if there is exactly one such task and no message is queued.
fn sole_sender(
    incarnation: &NodeIncarnation,
    task: TaskId,
    port: Option<PortId>,
) -> Option<(PortId, TaskId)> {
    let view = &incarnation.task(task)?.view;
    let takes = |p: &&imrs_protocol::PortView| {
        p.capacity > 0 && p.usage != Usage::Waitfor && port.is_none_or(|wanted| wanted == p.port)
    };
    let mut senders = BTreeSet::new();
    for port in view.ports.iter().filter(takes) {
        if port.len > 0 {
            return None;
        }
        let parties = incarnation.names.port(port.port).map_or(&[][..], |info| &info.parties);
        let others = parties.iter().filter(|p| p.task != task && sends(p.usage));
        senders.extend(others.map(|p| (port.port, p.task)));
    }
    let only: BTreeSet<TaskId> = senders.iter().map(|(_, task)| *task).collect();
    if only.len() == 1 { senders.first().copied() } else { None }
}

const fn sends(usage: Usage) -> bool {
    match usage {
        Usage::Send | Usage::Query | Usage::Reply => true,
        Usage::Receive | Usage::Response | Usage::Waitfor => false,
    }
}

/// The cycles among the waits of a cell. A cycle that an in-flight message may still break is not reported: all
/// messages that the cycle's tasks sent must have arrived before the latest reports of the nodes.
#[must_use]
pub fn cycles(store: &Store, cell: &Name, now: Moment) -> Vec<Cycle> {
    let Some(names) = store.names(cell) else { return Vec::new() };
    let mut waits = waits(store, cell, now);
    settle(&mut waits);
    trim(&mut waits);
    if waits.is_empty() {
        return Vec::new();
    }
    let up: Vec<_> =
        store.incarnations_of(cell).filter(|incarnation| incarnation.presence(now) == Presence::Up).collect();
    let busy = busy(store, names, &up, now);
    let is_known = |task: TaskId| up.iter().any(|incarnation| incarnation.task(task).is_some());
    waits.retain(|wait| is_known(wait.waiter) && !busy.contains(&wait.waiter));
    trim(&mut waits);
    let mut cycles = Vec::new();
    while let Some(found) = waits.first().and_then(|wait| shortest(&waits, wait.waiter)) {
        let tasks: Vec<TaskId> = found.iter().map(|wait| wait.waiter).collect();
        let told = |wait: &&Wait| {
            format!("{} waits for {} ({})", names.task(wait.waiter), names.task(wait.on), wait.why)
        };
        let why = found.iter().map(told).collect();
        waits.retain(|wait| !tasks.contains(&wait.waiter));
        trim(&mut waits);
        cycles.push(Cycle { tasks, why });
    }
    cycles
}

/// Drops the waits of two tasks on one port if one task waits for an answer there and the other waits to receive there:
/// the request is in flight.
fn settle(waits: &mut Vec<Wait>) {
    let ends: BTreeSet<_> = waits.iter().map(|w| (w.waiter, w.on, w.port)).collect();
    waits.retain(|w| !ends.contains(&(w.on, w.waiter, w.port)));
}

/// Keeps only the waits that can be in a cycle: another task waits for the waiting task, and the awaited task waits, too.
fn trim(waits: &mut Vec<Wait>) {
    loop {
        let waiters: BTreeSet<_> = waits.iter().map(|w| w.waiter).collect();
        let awaited: BTreeSet<_> = waits.iter().map(|w| w.on).collect();
        let before = waits.len();
        waits.retain(|w| waiters.contains(&w.on) && awaited.contains(&w.waiter));
        if waits.len() == before {
            return;
        }
    }
}

/// The tasks whose last message may still be in flight, or may have arrived since the last report of its receiver.
fn busy(store: &Store, names: &Names, incarnations: &[&NodeIncarnation], now: Moment) -> BTreeSet<TaskId> {
    let tick_us = incarnations.iter().map(|l| l.tick_us).max().unwrap_or(1);
    let link_us = names.links.iter().map(|l| l.delay.0.saturating_mul(tick_us)).max().unwrap_or(0);
    let settled = PERIOD.saturating_add(Duration::from_micros(link_us.saturating_mul(3)));
    // What a task sent arrives, and is reported, within `settled`. The report of a suspended or late node may be old, so
    // this interval ends with the oldest of the nodes' reports, and not now.
    let heard = incarnations.iter().map(|incarnation| incarnation.heard).min().unwrap_or(now);
    let since = heard.saturating_sub(settled);
    let acts = |seen: &Seen| {
        matches!(
            seen.what.event,
            Event::Sent | Event::Replied | Event::Reached | Event::Rejoined | Event::Confirmed
        )
    };
    let mut busy = BTreeSet::new();
    for batch in store.trail().batches().rev().take_while(|batch| batch.at >= since) {
        if incarnations.iter().any(|l| l.id == batch.incarnation) {
            let late = batch.seen.iter().filter(|seen| acts(seen) && batch.moment(seen) >= since);
            busy.extend(late.filter_map(|seen| seen.task));
        }
    }
    busy
}

/// The shortest cycle through `start`.
fn shortest(waits: &[Wait], start: TaskId) -> Option<Vec<&Wait>> {
    let mut came: BTreeMap<TaskId, &Wait> = BTreeMap::new();
    let mut next = VecDeque::from([start]);
    while let Some(at) = next.pop_front() {
        for wait in waits.iter().filter(|w| w.waiter == at) {
            if wait.on == start {
                let mut way = vec![wait];
                let mut back = at;
                while back != start {
                    let step = came.get(&back)?;
                    way.push(step);
                    back = step.waiter;
                }
                way.reverse();
                return Some(way);
            }
            if let Entry::Vacant(first) = came.entry(wait.on) {
                first.insert(wait);
                next.push_back(wait.on);
            }
        }
    }
    None
}

/// The tasks for which others wait and that wait for no task themselves. The task for which most others wait comes
/// first. Tasks in a cycle are not among them.
#[must_use]
pub fn awaited(store: &Store, cell: &Name, now: Moment) -> Vec<Awaited> {
    let waits = waits(store, cell, now);
    let waiters: BTreeSet<_> = waits.iter().map(|w| w.waiter).collect();
    let ends: BTreeSet<_> = waits.iter().map(|w| w.on).filter(|on| !waiters.contains(on)).collect();
    let mut found: Vec<Awaited> = Vec::new();
    for task in ends {
        let mut by = BTreeSet::new();
        let mut next = vec![task];
        while let Some(at) = next.pop() {
            let more: Vec<_> = waits.iter().filter(|w| w.on == at && by.insert(w.waiter)).collect();
            next.extend(more.iter().map(|w| w.waiter));
        }
        let longest = waits.iter().filter(|w| w.on == task).max_by_key(|w| w.waited_us);
        if let Some(wait) = longest.cloned() {
            found.push(Awaited { task, by: by.into_iter().collect(), wait });
        }
    }
    found.sort_by_key(|a| std::cmp::Reverse(a.by.len()));
    found
}
