//! Splits a cell into independent parts. Each part is searched by itself, because no part notices what happens in another
//! part (D138).
//!
//! Two tasks are in one part if they share a node, port, couple or check, or if one node may pass packets of both. So a part
//! consists of whole nodes, and a node that relays for two ports joins their tasks. Every run of the cell, restricted to a part,
//! is a run of that part within the same fault budgets; and every run of a part is a run of the cell.
//!
//! A part keeps the numbers, tables and plans of the whole cell. Nodes outside the part stay down and are not packed. So
//! the same moves replay a finding if they are applied to the same part.

use super::plan::{CellPlan, Part, about, node_of};
use super::run_state::bit;
use imrs_protocol::{CellTable, NodeId};
use std::sync::Arc;

/// The plan, restricted to a part.
pub(super) fn only(plan: &Arc<CellPlan>, part: Option<&Part>) -> Arc<CellPlan> {
    match part {
        Some(part) => Arc::new(CellPlan { part: Some(part.clone()), ..CellPlan::clone(plan) }),
        None => Arc::clone(plan),
    }
}

/// The independent parts of a cell; empty if there is only one, or if the whole cell is to be searched at once.
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
    // For each check, the nodes of the tasks that it reads.
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
        // A check that reads no task belongs to the first part.
        checks: read
            .iter()
            .map(|nodes| nodes.first().map_or(number == 0, |&node| sets.root(node) == root))
            .collect(),
    };
    roots.iter().enumerate().map(part).collect()
}

/// Disjoint sets of nodes (union-find): each node points to a node with a lower number, and the root of a set points to
/// itself.
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

    /// Joins the sets of all nodes on the route of a packet.
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
