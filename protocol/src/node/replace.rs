//! Replacing the table of a running node (D184): what the node keeps, and what follows the new routes.
//!
//! The host of a cell makes a table that goes [around](CellTable::around) links and nodes that are out of order, and brings it to
//! the nodes in three rounds: each node [learns](Node::learn_table) the table, then each [replaces](Node::replace_table) its own,
//! and when the longest time_out of the cell has passed, each [retires](Node::retire_table) the former one. Then no packet is
//! dropped because two nodes route by different tables. Without the first round a node may drop such packets, which is as if a link
//! had lost them.

use super::{Node, NodeOutbox, Parts, TaskEffects};
use crate::table::{CellTable, TableError};
use alloc::sync::Arc;

impl Node {
    /// From now on the node also takes packets that come by the routes of `next`, and still sends by its own.
    ///
    /// # Errors
    /// The node keeps its own table if `next` has other positions, or no later epoch.
    pub fn learn_table(&mut self, next: Arc<CellTable>) -> Result<(), TableError> {
        self.parts.table.learn(next)
    }

    /// From now on the node sends by the routes of `next`, and still takes packets that come by the former routes.
    /// Requests, waiting messages and dedup entries stay. Waiting packets go by the new routes, and the budget of each
    /// waiting command reserves the new way back; a message or packet that then has no time left is dropped as expired.
    /// Call this between two inputs.
    ///
    /// # Errors
    /// The node keeps its own table if `next` has other positions, or no later epoch.
    pub fn replace_table(
        &mut self,
        next: Arc<CellTable>,
        out: &mut impl NodeOutbox,
    ) -> Result<(), TableError> {
        let former = self.parts.table.replace(next)?;
        self.with_transit(out, |transit, table, effects| transit.reroute(table, effects));
        let Parts { table, tasks, .. } = &mut self.parts;
        for task in tasks {
            let effects = &mut TaskEffects { task: task.task(), work: &mut self.work, out };
            task.reroute(&former, table, effects);
        }
        self.empty(out);
        self.flush(out);
        Ok(())
    }

    /// From now on the node takes packets by its own routes alone.
    pub fn retire_table(&mut self) {
        self.parts.table.retire();
    }
}
