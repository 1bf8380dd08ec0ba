//! The reverse-path check: whether a packet can have come from the neighbour that delivered it (insertion, masquerade).
//!
//! Routes are static (§5.2.3), so the path of every packet is known in advance. A neighbour that delivers a packet and is
//! not on its path is faulty, or forges the source. So a packet is accepted only from the neighbour through which packets
//! of its source come.
//!
//! While a table is replaced, the neighbour must be on a path on which each node routes by the one table or the other (D184).

use crate::cell::MAX_NODES;
use crate::ids::NodeId;
use crate::packet::{Control, Kind, Packet};
use crate::table::{CellTable, NodeTable};

/// Whether `packet`, delivered by the neighbour `from`, is on its path. Packets of tasks that the cell does not have pass
/// the check.
pub(super) fn can_come(table: &NodeTable, from: NodeId, packet: &Packet) -> bool {
    let Some((source, destination)) = table.location(packet.source).zip(table.location(packet.destination))
    else {
        return true;
    };
    if enters_from(table, from, source, destination) {
        return true;
    }
    // A relay without space refuses a command in the name of the command's destination (D19). The relay's path back may
    // differ from the destination's, where two paths have the same length.
    let of_a_relay = packet.kind == Kind::Control && packet.control() == Some(Control::RefusedOnTheWay);
    if of_a_relay && table.path(destination, source).any(|relay| enters_from(table, from, relay, destination))
    {
        return true;
    }
    let Some(other) = &table.other else { return false };
    // While nodes of two tables run, each node that a packet passes may route by either of them (D184).
    let tables = [&*table.cell, &**other];
    let sources =
        if of_a_relay { Nodes::of(destination).followed(tables, source) } else { Nodes::of(source) };
    let hands_over = |table_of: &&CellTable| table_of.next_hop(from, destination) == Some(table.node);
    tables.iter().any(hands_over) && sources.followed(tables, destination).has(from)
}

/// Whether packets that `source` sends to `destination` reach this node through the neighbour `from`.
///
/// It would be wrong to compare `from` with the next hop back to the source: if two paths have the same length, the two
/// directions may use different ones.
fn enters_from(table: &NodeTable, from: NodeId, source: NodeId, destination: NodeId) -> bool {
    let mut last = None;
    for node in table.path(source, destination) {
        if node == table.node {
            return last == Some(from);
        }
        last = Some(node);
    }
    false
}

/// A set of nodes.
#[derive(Clone, Copy)]
struct Nodes([u64; MAX_NODES.div_ceil(64)]);

impl Nodes {
    fn of(node: NodeId) -> Self {
        let mut nodes = Self([0; MAX_NODES.div_ceil(64)]);
        nodes.insert(node);
        nodes
    }

    fn has(&self, node: NodeId) -> bool {
        self.0[node.index() / 64] >> (node.index() % 64) & 1 == 1
    }

    /// Whether the node was not in the set before.
    fn insert(&mut self, node: NodeId) -> bool {
        let is_new = !self.has(node);
        self.0[node.index() / 64] |= 1 << (node.index() % 64);
        is_new
    }

    fn take(&mut self) -> Option<NodeId> {
        let at = self.0.iter().position(|&word| word != 0)?;
        let bit = self.0[at].trailing_zeros() as usize;
        self.0[at] &= self.0[at] - 1;
        Some(NodeId::from_index(at * 64 + bit))
    }

    /// The nodes of this set, and all nodes that packets from them to `to` may pass if each node routes by any of the
    /// tables.
    fn followed(mut self, tables: [&CellTable; 2], to: NodeId) -> Self {
        let mut open = self;
        while let Some(node) = open.take() {
            for next in tables.iter().filter_map(|table| table.next_hop(node, to)) {
                if self.insert(next) {
                    open.insert(next);
                }
            }
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::{Cell, PortDecl, Usage};
    use crate::ids::{Incarnation, MessageId, Seq24, TaskId};
    use crate::table::CellTable;
    use crate::ticks::Ticks;
    use alloc::format;
    use alloc::sync::Arc;
    use alloc::vec::Vec;
    use proptest::prelude::*;

    fn packet(source: u16, destination: u16) -> Packet {
        Packet {
            destination: TaskId(destination),
            source: TaskId(source),
            id: MessageId { incarnation: Incarnation(1), sequence: Seq24::new(1) },
            remaining: Ticks(1_000_000),
            ..Packet::BLANK
        }
    }

    /// A cell of `nodes` nodes with a task on each.
    fn table(nodes: u16, links: &[(u16, u16, u64)]) -> Arc<CellTable> {
        let mut cell = Cell::new("paths", Ticks(1));
        for n in 0..nodes {
            let node = cell.node(&format!("n{n}"));
            cell.task(&format!("t{n}"), node);
        }
        for &(a, b, bound) in links {
            cell.link(NodeId(a), NodeId(b), Ticks(bound));
        }
        cell.port(PortDecl::new("p", TaskId(0), Usage::Send, &[TaskId(nodes - 1)], Ticks(1_000_000)));
        Arc::new(CellTable::new(cell).unwrap())
    }

    fn at(table: &Arc<CellTable>, node: u16) -> NodeTable {
        NodeTable::new(Arc::clone(table), NodeId(node))
    }

    #[test]
    fn a_neighbour_speaks_for_those_behind_it_only() {
        // 0 - 1 - 2 - 3, and 4 linked to 2. All links have the delay zero, because the check must not depend on delays.
        let table = table(5, &[(0, 1, 0), (1, 2, 0), (2, 3, 0), (2, 4, 0)]);
        let two = at(&table, 2);
        let from = |from, source, destination| can_come(&two, NodeId(from), &packet(source, destination));
        assert!(from(1, 1, 2) && from(1, 0, 2) && from(1, 0, 3) && from(3, 3, 0) && from(4, 4, 1));
        assert!(!from(4, 0, 2), "the task lies behind another neighbour");
        assert!(!from(4, 1, 3) && !from(3, 4, 0) && !from(1, 3, 0));
        assert!(!from(1, 2, 3) && !from(4, 2, 2), "no packet of this node's own task comes from outside");
        assert!(!from(1, 0, 1) && !from(3, 4, 3), "its route does not pass this node");
        assert!(from(1, 99, 2) && from(1, 0, 99), "a task that does not exist has no route");
    }

    #[test]
    fn two_ways_of_one_length_are_told_apart_by_direction() {
        // A ring of six: 0 - 1 - 4 - 5 and 0 - 2 - 3 - 5. Routes prefer the lower next node: 1 from 0, and 3 from 5.
        let table = table(6, &[(0, 1, 10), (1, 4, 10), (4, 5, 10), (0, 2, 10), (2, 3, 10), (3, 5, 10)]);
        let (first, last) = (at(&table, 0), at(&table, 5));
        assert!(can_come(&last, NodeId(4), &packet(0, 5)) && !can_come(&last, NodeId(3), &packet(0, 5)));
        assert!(can_come(&first, NodeId(2), &packet(5, 0)) && !can_come(&first, NodeId(1), &packet(5, 0)));
        // The relay 4 refuses a command from 0 to 5: its refusal comes through 1, in the name of 5.
        let word = |control: Control| Packet {
            kind: Kind::Control,
            contents: control.to_contents(),
            ..packet(5, 0)
        };
        assert!(can_come(&first, NodeId(1), &word(Control::RefusedOnTheWay)));
        assert!(!can_come(&first, NodeId(1), &word(Control::Refused)), "only 5 itself says this");
        assert!(can_come(&first, NodeId(2), &word(Control::Refused)));
    }

    proptest! {
        /// In any cell every node on the path accepts the packets that a node sends, and the refusals of relays.
        #[test]
        fn nothing_that_keeps_to_its_way_is_dropped(
            tree in proptest::collection::vec((any::<u16>(), 0..3_u64), 6),
            more in proptest::collection::vec((0..7_u16, 0..7_u16, 0..3_u64), 0..8),
        ) {
            let mut links: Vec<_> = (1..).zip(tree).map(|(n, (to, bound))| (n, to % n, bound)).collect();
            links.extend(more.into_iter().filter(|(a, b, _)| a != b));
            let table = table(7, &links);
            let passes = |start: NodeId, packet: &Packet| {
                let end = table.location(packet.destination).unwrap();
                let nodes: Vec<NodeId> = table.path(start, end).collect();
                nodes.windows(2).all(|hop| can_come(&at(&table, hop[1].0), hop[0], packet))
            };
            for (a, b) in (0..7).flat_map(|a| (0..7).map(move |b| (a, b))) {
                prop_assert!(passes(NodeId(a), &packet(a, b)), "{} to {}", a, b);
                let word = Packet {
                    kind: Kind::Control,
                    contents: Control::RefusedOnTheWay.to_contents(),
                    ..packet(b, a)
                };
                for relay in table.path(NodeId(a), NodeId(b)) {
                    prop_assert!(passes(relay, &word), "refused by {} between {} and {}", relay, a, b);
                }
            }
        }
    }
}
