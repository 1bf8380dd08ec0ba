//! Independent parts of a cell: each is searched by itself, because what happens in one is invisible to the others.
//!
//! Two tasks are in one part when they share a node, a port, a couple or a check, and when packets of both may pass one
//! node. So a part has whole nodes, and a node that relays for two ports joins the tasks of both. Every run of the cell,
//! seen from one part, is a run of that part within the same budgets of faults, and every run of a part is one of the cell.
//!
//! A part keeps the numbers, tables and plans of the whole cell. The nodes outside it are down for ever and are not
//! packed, so the same moves replay a finding with the same part.

use super::context::about;
use super::course::{Course, bit};
use super::judge::nothing_reached;
use super::plan::{CellCheck, CellFaults, CellPlan, Holds};
use super::search::Done;
use super::story::Note;
use crate::floor::chart::Lanes;
use imrs_protocol::{CellTable, NodeId, TaskId};
use std::sync::Arc;

/// A set of nodes that no packet and no check connects with the others.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Part {
    /// Its place among the parts of the cell.
    pub number: usize,
    /// Bit by bit.
    nodes: u64,
    checks: Vec<bool>,
}

impl Part {
    pub const fn has_node(&self, node: usize) -> bool {
        node < 64 && self.nodes >> node & 1 == 1
    }

    pub fn has_check(&self, check: usize) -> bool {
        self.checks.get(check).copied().unwrap_or(false)
    }

    /// The nodes outside it, bit by bit.
    pub const fn left_out(&self) -> u64 {
        !self.nodes
    }

    /// Whether a fault of this hypothesis can happen in it.
    fn is_touched_by(&self, plan: &CellPlan, faults: &CellFaults) -> bool {
        let cell = plan.table.cell();
        let links = faults.cut.iter().filter_map(|&link| cell.links.get(link));
        [faults.loss, faults.dup, faults.reorder, faults.fail, faults.drift].iter().any(|&budget| budget > 0)
            || faults.crash.iter().any(|node| self.has_node(node.index()))
            || faults.pause.iter().any(|pause| pause.node.is_none_or(|node| self.has_node(node.index())))
            || links.into_iter().any(|link| self.has_node(link.a.index()) && self.has_node(link.b.index()))
    }
}

impl CellPlan {
    /// Whether a node takes part in the search.
    pub(super) fn has_node(&self, node: usize) -> bool {
        self.part.as_ref().is_none_or(|part| part.has_node(node))
    }

    pub(super) fn has_task(&self, task: usize) -> bool {
        self.part.is_none() || self.has_node(node_of(&self.table, task))
    }

    pub(super) fn has_check(&self, check: usize) -> bool {
        self.part.as_ref().is_none_or(|part| part.has_check(check))
    }
}

/// The same cell, of which only this part is searched.
pub(super) fn only(plan: &Arc<CellPlan>, part: Option<&Part>) -> Arc<CellPlan> {
    match part {
        Some(part) => Arc::new(CellPlan { part: Some(part.clone()), ..CellPlan::clone(plan) }),
        None => Arc::clone(plan),
    }
}

/// The independent parts of a cell; none where it has one only, and where all of it is to be searched at once.
pub(super) fn parts(plan: &CellPlan) -> Vec<Part> {
    if plan.everything {
        return Vec::new();
    }
    let table = &plan.table;
    let mut sets = Sets((0..table.cell().nodes.len()).collect());
    for port in table.ports() {
        for party in &port.parties {
            for peer in port.peers(party.task) {
                sets.join_route(table, node_of(table, party.task.index()), node_of(table, peer.index()));
            }
        }
    }
    for couple in &table.cell().couples {
        sets.join(node_of(table, couple.primary.index()), node_of(table, couple.standby.index()));
    }
    let read: Vec<Vec<usize>> = plan.checks.iter().map(|check| nodes_read(table, check)).collect();
    for nodes in &read {
        nodes.windows(2).for_each(|pair| sets.join(pair[0], pair[1]));
    }
    let mut roots: Vec<usize> =
        (0..table.cell().tasks.len()).map(|task| sets.root(node_of(table, task))).collect();
    roots.sort_unstable();
    roots.dedup();
    if roots.len() < 2 {
        return Vec::new();
    }
    let part = |(number, &root): (usize, &usize)| Part {
        number,
        nodes: (0..sets.0.len()).filter(|&node| sets.root(node) == root).fold(0, |all, node| all | bit(node)),
        // What reads no task belongs to the first part.
        checks: read
            .iter()
            .map(|nodes| nodes.first().map_or(number == 0, |&node| sets.root(node) == root))
            .collect(),
    };
    roots.iter().enumerate().map(part).collect()
}

fn node_of(table: &CellTable, task: usize) -> usize {
    table.location(TaskId::from_index(task)).map_or(0, NodeId::index)
}

/// The nodes of the tasks that a check reads.
fn nodes_read(table: &CellTable, check: &CellCheck) -> Vec<usize> {
    let both = match &check.holds {
        Holds::Always(terms) => [&terms[..], &[]],
        Holds::Leads { when, then, .. } => [&when[..], &then[..]],
    };
    both.into_iter().flatten().filter_map(about).map(|task| node_of(table, task)).collect()
}

/// Nodes in disjoint sets: each points to one with a lower or the same number, the lowest of its set to itself.
struct Sets(Vec<usize>);

impl Sets {
    fn root(&self, mut node: usize) -> usize {
        while self.0[node] != node {
            node = self.0[node];
        }
        node
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b)] = a.min(b);
    }

    /// Joins all nodes that a packet passes on its way.
    fn join_route(&mut self, table: &CellTable, from: usize, to: usize) {
        let mut at = from;
        while at != to {
            let next = table.next_hop(NodeId::from_index(at), NodeId::from_index(to));
            let Some(next) = next.map(NodeId::index) else { return };
            self.join(at, next);
            at = next;
        }
    }
}

/// Searches each part by itself and joins what was found. A part that a hypothesis cannot touch was searched without
/// faults: `plain` is what that came to.
///
/// A clock that drifts does so between two events, a pause ends after one, and events of other parts lie between those of
/// this one. So with drift and with pauses the cell is searched as a whole.
pub(super) fn look_at_each(
    plan: &Arc<CellPlan>,
    parts: &[Part],
    faults: &CellFaults,
    plain: Option<&Done>,
    look: impl Fn(&Arc<CellPlan>) -> Done,
) -> Done {
    if parts.is_empty() || !faults.may_be_apart() {
        return look(plan);
    }
    // An `abort` ends ways of the search without faults, and none of those with them: so what lies behind it was not seen yet.
    let is_seen = plain.is_some_and(|plain| !plain.coverage.pruned);
    let touched = |part: &&Part| !is_seen || part.is_touched_by(plan, faults);
    let mut searched: Vec<&Part> = parts.iter().filter(touched).collect();
    if searched.is_empty() {
        searched.push(&parts[0]);
    }
    let done = searched.iter().map(|part| (part.number, look(&only(plan, Some(part)))));
    let Some((_, mut all)) =
        done.reduce(|(at, mine), (number, other)| (at, mine.beside(other, &parts[number])))
    else {
        return look(plan);
    };
    for part in parts.iter().filter(|part| !searched.contains(part)) {
        let still = match plain {
            Some(plain) => plain.reached.still.clone(),
            None => nothing_reached(&Course::new(&only(plan, Some(part)), faults)).still,
        };
        take_checks(&mut all.reached.still, still, part);
    }
    all.coverage.parts = u32::try_from(parts.len()).unwrap_or(u32::MAX);
    all
}

fn take_checks<T>(all: &mut [T], other: Vec<T>, part: &Part) {
    for (check, (mine, other)) in all.iter_mut().zip(other).enumerate() {
        if part.has_check(check) {
            *mine = other;
        }
    }
}

impl Done {
    /// Both of what two parts came to; `part` is that of the other.
    fn beside(mut self, other: Self, part: &Part) -> Self {
        let (all, one) = (&mut self.coverage, other.coverage);
        let whole = match (all.complete, one.complete) {
            (true, true) => all.whole_depth.max(one.whole_depth),
            (true, false) => one.whole_depth,
            (false, true) => all.whole_depth,
            (false, false) => all.whole_depth.min(one.whole_depth),
        };
        all.whole_depth = whole;
        all.times = all.times.min(one.times);
        all.states += one.states;
        all.moves += one.moves;
        all.depth = all.depth.max(one.depth);
        all.ticks = all.ticks.max(one.ticks);
        all.complete &= one.complete;
        all.pruned |= one.pruned;
        all.ended_by = all.ended_by.take().or(one.ended_by);
        all.longest_state = all.longest_state.max(one.longest_state);
        all.seconds += one.seconds;
        self.findings.extend(other.findings);
        self.standstills.extend(other.standstills);
        let reached = other.reached.statements.into_iter().flatten();
        self.reached.statements.iter_mut().flatten().zip(reached).for_each(|(all, one)| *all |= one);
        take_checks(&mut self.reached.still, other.reached.still, part);
        take_checks(&mut self.mattered, other.mattered, part);
        self
    }
}

/// The names of the lanes of a part, and notes of it with their lanes renumbered. Without a part, those of the whole cell.
#[must_use]
pub fn drawn(plan: &CellPlan, part: Option<usize>, notes: Vec<Note>) -> (Vec<String>, Vec<Note>) {
    let part = part.and_then(|number| parts(plan).into_iter().nth(number));
    within(plan, part.as_ref(), notes)
}

/// The same, of a part at hand.
pub(super) fn within(plan: &CellPlan, part: Option<&Part>, mut notes: Vec<Note>) -> (Vec<String>, Vec<Note>) {
    let lanes = Lanes::of(&plan.table);
    let Some(part) = part else { return (lanes.names, notes) };
    let kept = lanes.on_nodes(|node| part.has_node(node));
    let place = |lane: &mut usize| *lane = kept.iter().position(|kept| kept == lane).unwrap_or(0);
    for note in &mut notes {
        match note {
            Note::Event { lane, .. } => place(lane),
            Note::Packet { from, to, .. } => [from, to].into_iter().for_each(place),
            Note::Remark { .. } => {}
        }
    }
    (kept.into_iter().map(|lane| lanes.names[lane].clone()).collect(), notes)
}
