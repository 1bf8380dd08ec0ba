//! Independent parts of a cell: each is searched by itself, because what happens in one is invisible to the others.
//!
//! Two tasks are in one part when they share a node, a port, a couple or a check, and when packets of both may pass one
//! node. So a part has whole nodes, and a node that relays for two ports joins the tasks of both. Every run of the cell,
//! seen from one part, is a run of that part within the same budgets of faults, and every run of a part is one of the cell.
//!
//! A part keeps the numbers, tables and plans of the whole cell. The nodes outside it are down for ever and are not
//! packed, so the same moves replay a finding with the same part.

use super::course::bit;
use super::plan::{CellPlan, Part, about, node_of};
use imrs_protocol::{CellTable, NodeId};
use std::sync::Arc;

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
    // The nodes of the tasks that each check reads.
    let nodes = |check| plan.terms(check).iter().filter_map(about).map(|task| node_of(table, task)).collect();
    let read: Vec<Vec<usize>> = (0..plan.checks.len()).map(nodes).collect();
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
