//! The capacity of links and transit buffers.

use super::{CellState, small};
use crate::state::Violation;
use imrs_protocol::NodeId;

impl CellState {
    /// For each link of a node, how many packets the link still takes.
    pub(super) fn open(&self, i: usize) -> Vec<(NodeId, u8)> {
        let links = self.links.iter().enumerate().filter(|(_, (from, ..))| from.index() == i);
        let left = |(at, &(_, to, _)): (usize, &(NodeId, NodeId, u8))| {
            let room = self.plan.room.map_or(u8::MAX, |room| room.saturating_sub(self.used[at]));
            (to, if self.plan.pressure { room.min(self.space(to)) } else { room })
        };
        links.map(left).collect()
    }

    /// How many more packets a node's transit buffer surely has space for. Packets in flight to this node count as stored.
    pub(super) fn space(&self, to: NodeId) -> u8 {
        let held = self.nodes[to.index()].node.parts().transit.len();
        let coming = self.in_flight.iter().filter(|c| self.links[usize::from(c.link)].1 == to).count();
        small(usize::from(self.plan.transit).saturating_sub(held + coming))
    }

    pub(super) fn flush(&mut self) -> Result<(), Violation> {
        if !self.plan.pressure {
            return Ok(());
        }
        for i in 0..self.nodes.len() {
            if self.nodes[i].up && !self.nodes[i].node.parts().transit.is_empty() {
                self.drive(i, |node, out| node.flush(out))?;
            }
        }
        Ok(())
    }
}
