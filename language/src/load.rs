//! The traffic that a cell puts on its links, estimated from its text (§5.2.3).
//!
//! A declared `rate` says how often a task sends at most. Without a rate, the estimate assumes one message in each
//! `time_out`: tasks hardly ask more often than that. So such an estimate is no bound.

use crate::checks::starters;
use crate::hir::{CoupleKind, Duration, Field, Hir, Port, StatementKind};
use crate::walk;
use imrs_protocol::{CONTENTS_BYTES, Class, NodeId, PortId, TaskId, Usage};

/// The bytes of a packet on the wire, alone in its datagram: 32 bytes, its envelope, IP and UDP, Ethernet and the gap.
pub const WIRE_BYTES: f64 = 138.0;
/// The capacity of a link that declares none, in packets per second: 100 Mbit/s.
const USUAL: f64 = 100e6 / (WIRE_BYTES * 8.0);
/// A move of a task is advised only if it lowers the traffic on all links together by more than this share.
const WORTH: f64 = 0.1;

/// The packets per second on a link, in both directions together.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkLoad {
    /// The most packets per second that the declared rates allow.
    pub declared: f64,
    /// The estimated packets per second of ports without a rate, from their time_outs.
    pub estimated: f64,
    /// The packets per second that the link can carry.
    pub capacity: f64,
}

/// A task that would cause less traffic on another node. A task with actions cannot move away from its robot, so it is
/// left out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move {
    /// The task.
    pub task: TaskId,
    /// The node on which the task would cause the least traffic.
    pub to: NodeId,
    /// How many packets per second the move saves, over all links together.
    pub saves: f64,
}

impl LinkLoad {
    /// The declared and the estimated packets per second together.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.declared + self.estimated
    }

    /// Whether the link gets more packets than it can carry.
    #[must_use]
    pub fn is_congested(&self) -> bool {
        self.total() > self.capacity
    }
}

/// Packets from one task to another.
struct Flow {
    from: TaskId,
    to: TaskId,
    rate: f64,
    is_declared: bool,
}

/// Estimates the load of each link of a cell that has no errors, by its position in [`Hir::links`].
#[must_use]
pub fn of_links(hir: &Hir) -> Vec<LinkLoad> {
    let own = |task: TaskId| hir.tasks[task.index()].node;
    let unused = |capacity: Option<_>| LinkLoad {
        capacity: capacity.map_or(USUAL, per_second),
        ..LinkLoad::default()
    };
    let mut links: Vec<LinkLoad> = hir.links.iter().map(|link| unused(link.capacity)).collect();
    for flow in flows(hir) {
        for link in hir.way(own(flow.from), own(flow.to)) {
            let load = &mut links[link];
            let sum = if flow.is_declared { &mut load.declared } else { &mut load.estimated };
            *sum += flow.rate;
        }
    }
    links
}

fn per_second((count, per): (u16, Duration)) -> f64 {
    f64::from(count) * 1e6 / per.usec.max(1) as f64
}

fn flows(hir: &Hir) -> Vec<Flow> {
    let mut flows = Vec::new();
    for (at, port) in hir.ports.iter().enumerate() {
        for from in starters(port) {
            let Some((rate, is_declared)) = rate(hir, PortId::from_index(at), port, from) else { continue };
            for to in port.peers(from) {
                flows.push(Flow { from, to, rate: rate * packets(port), is_declared });
            }
        }
    }
    flows
}

/// How often a task uses a port per second, and whether the cell declares that rate.
fn rate(hir: &Hir, id: PortId, port: &Port, from: TaskId) -> Option<(f64, bool)> {
    let heartbeats = hir.couples.iter().find_map(|couple| match couple.kind {
        CoupleKind::Work { via, every, .. } if via == id => Some(every),
        _ => None,
    });
    let user = port.user(from);
    let declared = user.and_then(|user| user.rate).or(port.rate).or(heartbeats.map(|every| (1, every)));
    let time_out = || user.and_then(|user| user.time_out).or(port.time_out).map(|time_out| (1, time_out));
    let of_time_out = || time_out().map(|once| (per_second(once), false));
    declared.map(|rate| (per_second(rate), true)).or_else(of_time_out)
}

/// How many packets pass between two tasks for one message with its answer, or for one round.
fn packets(port: &Port) -> f64 {
    let of = |fields: &[Field]| {
        let bytes: usize = fields.iter().map(|field| field.of.bytes()).sum();
        bytes.div_ceil(CONTENTS_BYTES).max(1) as f64
    };
    match port.usage {
        // Each member sends an ARRIVE and a CONFIRM.
        Usage::Waitfor => 2.0,
        _ if port.class == Class::Command => of(&port.message) + of(&port.answer),
        _ => of(&port.message),
    }
}

/// The tasks that would cause less traffic on another node, by descending savings. Each task without actions is tried
/// on the nodes of the tasks with which it exchanges messages.
#[must_use]
pub fn moves(hir: &Hir) -> Vec<Move> {
    let flows = flows(hir);
    let cost = |moved: Option<(TaskId, NodeId)>| -> f64 {
        let place = |task: TaskId| match moved {
            Some((which, to)) if which == task => to,
            _ => hir.tasks[task.index()].node,
        };
        flows.iter().map(|flow| flow.rate * hir.way(place(flow.from), place(flow.to)).len() as f64).sum()
    };
    let now = cost(None);
    let mut moves = Vec::new();
    for (at, task) in hir.tasks.iter().enumerate() {
        let id = TaskId::from_index(at);
        let mut is_bound = task.is_extern || task.standby_of.is_some();
        walk::of_task(task, &mut |statement| is_bound |= matches!(statement.kind, StatementKind::Run { .. }));
        if is_bound {
            continue;
        }
        let partners = flows.iter().filter_map(|flow| match id {
            id if id == flow.from => Some(flow.to),
            id if id == flow.to => Some(flow.from),
            _ => None,
        });
        let mut nodes: Vec<NodeId> = partners.map(|partner| hir.tasks[partner.index()].node).collect();
        nodes.sort_unstable();
        nodes.dedup();
        let best = nodes.into_iter().map(|to| Move { task: id, to, saves: now - cost(Some((id, to))) });
        moves.extend(
            best.filter(|there| there.saves > WORTH * now).max_by(|a, b| a.saves.total_cmp(&b.saves)),
        );
    }
    moves.sort_by(|a, b| b.saves.total_cmp(&a.saves));
    moves
}
