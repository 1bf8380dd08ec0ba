//! Replacing the table of a running node by one of a later epoch, with other routes (D184).

use super::{CellTable, NodeTable};
use alloc::sync::Arc;
use core::fmt;
use core::mem;

/// Why a running node does not take a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableError {
    /// The table does not have a later epoch than the node's own.
    NotNewer {
        /// The epoch of the node's table.
        held: u32,
        /// The epoch of the table that the node does not take.
        given: u32,
    },
    /// The two tables declare different nodes, tasks, ports or the like, so positions in them mean different things.
    OtherSlots(&'static str),
}

impl fmt::Display for TableError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotNewer { held, given } => {
                write!(
                    f,
                    "the table has epoch {given}, and the node knows epoch {held}: give it a later epoch"
                )
            }
            Self::OtherSlots(what) => write!(
                f,
                "the table has other {what}: a running node changes only its routes, so restart it with the new cell"
            ),
        }
    }
}

impl core::error::Error for TableError {}

impl NodeTable {
    /// Whether this node may take `next` while it runs. All entries must have the same positions. The epoch must be later
    /// than that of the node's table, and not before that of a table that the node has learned.
    ///
    /// # Errors
    /// What differs, or the two epochs.
    pub fn check(&self, next: &CellTable) -> Result<(), TableError> {
        let (own, other) = (self.cell.cell(), next.cell());
        let alike = [
            ("nodes", own.nodes == other.nodes),
            ("links", own.links == other.links),
            ("tasks", own.tasks == other.tasks),
            ("ports", own.ports == other.ports),
            ("couples", own.couples == other.couples),
            ("rules", (&own.name, own.tick, own.rules) == (&other.name, other.tick, other.rules)),
        ];
        if let Some((what, _)) = alike.into_iter().find(|(_, is_alike)| !is_alike) {
            return Err(TableError::OtherSlots(what));
        }
        let (held, given) = (self.cell.epoch(), next.epoch());
        // A table that arrives late must not replace a later one that this node has learned, because all other nodes may
        // already route by the learned table.
        let latest = self.other.as_ref().map_or(held, |other| other.epoch().max(held));
        if given > held && given >= latest {
            Ok(())
        } else {
            Err(TableError::NotNewer { held: latest, given })
        }
    }

    /// From now on the node also takes packets that come by the routes of `next`, and still sends by its own. If every node
    /// learns a table before the first one [replaces](Self::replace) its own, no packet is dropped for its route. A node
    /// knows two tables: a learned table takes the place of a former table that was not [retired](Self::retire) yet.
    ///
    /// # Errors
    /// See [`check`](Self::check). After an error nothing has changed.
    pub fn learn(&mut self, next: Arc<CellTable>) -> Result<(), TableError> {
        self.check(&next)?;
        self.other = Some(next);
        Ok(())
    }

    /// From now on the node sends by the routes of `next`, and still takes packets that come by the former routes. Returns
    /// the former table. The caller passes it to [`Transit::reroute`](crate::Transit::reroute) and
    /// [`CommTask::reroute`](crate::CommTask::reroute).
    ///
    /// # Errors
    /// See [`check`](Self::check). After an error nothing has changed.
    pub fn replace(&mut self, next: Arc<CellTable>) -> Result<Arc<CellTable>, TableError> {
        self.check(&next)?;
        let former = mem::replace(&mut self.cell, next);
        self.other = Some(Arc::clone(&former));
        Ok(former)
    }

    /// From now on the node takes packets that come by its own routes alone. Call this once the longest time_out of the
    /// cell has passed since the last node replaced its table: then no packet of the former routes is left.
    pub fn retire(&mut self) {
        self.other = None;
    }
}
