//! Replacing the tables of the running nodes (D184).

use super::VirtualCell;
use imrs_protocol::{CellTable, NodeId, Parts, TableError, invariants};
use std::sync::Arc;

impl VirtualCell {
    /// From now on a node also takes packets that come by the routes of `next`.
    ///
    /// # Errors
    /// See [`Node::learn_table`](imrs_protocol::Node::learn_table).
    pub fn learn_table(&mut self, id: NodeId, next: &Arc<CellTable>) -> Result<(), TableError> {
        self.nodes[id.index()].node.learn_table(Arc::clone(next))
    }

    /// From now on a node sends by the routes of `next`.
    ///
    /// # Errors
    /// See [`Node::replace_table`](imrs_protocol::Node::replace_table).
    ///
    /// # Panics
    /// If an invariant does not hold afterwards.
    pub fn replace_table(&mut self, id: NodeId, next: &Arc<CellTable>) -> Result<(), TableError> {
        self.out.from = id;
        let node = &mut self.nodes[id.index()].node;
        let replaced = node.replace_table(Arc::clone(next), &mut self.out);
        let Parts { table, tasks, .. } = node.parts();
        for task in tasks {
            if let Err(violation) = invariants::check(task, table) {
                panic!("{} after its node replaced its table: {violation}", task.task());
            }
        }
        replaced
    }

    /// From now on a node takes packets by its own routes alone.
    pub fn retire_table(&mut self, id: NodeId) {
        self.nodes[id.index()].node.retire_table();
    }
}
