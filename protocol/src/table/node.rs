//! The table of one node.

use super::{CellTable, Hop};
use crate::ids::{NodeId, TaskId};
use crate::rules::Rules;
use alloc::sync::Arc;

/// The table as one node sees it.
#[derive(Clone, Debug)]
pub struct NodeTable {
    /// The cell's table.
    pub cell: Arc<CellTable>,
    /// The node to which the table belongs.
    pub node: NodeId,
    /// Another table of the cell: the one that will replace the node's table, or that the node's table replaced. The
    /// node also accepts packets that follow the routes of this table (D184).
    pub(crate) other: Option<Arc<CellTable>>,
}

impl NodeTable {
    /// The table of `node`.
    #[must_use]
    pub const fn new(cell: Arc<CellTable>, node: NodeId) -> Self {
        Self { cell, node, other: None }
    }

    /// The rules that this cell runs.
    #[must_use]
    pub fn rules(&self) -> &Rules {
        &self.cell.cell().rules
    }

    /// The next hop and the delay of packets to a task of another node.
    pub(crate) fn way_to(&self, task: TaskId) -> Option<Hop> {
        self.hop(self.node, self.location(task)?)
    }

    /// The position of `task` among the tasks of this node, if it is one of them.
    #[inline]
    pub(crate) fn place(&self, task: TaskId) -> Option<usize> {
        let &(node, place) = self.locations.get(task.index())?;
        (node == self.node).then_some(place.into())
    }

    /// Whether `task` runs on this node.
    #[must_use]
    pub fn is_here(&self, task: TaskId) -> bool {
        self.location(task) == Some(self.node)
    }
}

impl core::ops::Deref for NodeTable {
    type Target = CellTable;
    fn deref(&self) -> &CellTable {
        &self.cell
    }
}
