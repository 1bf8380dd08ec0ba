//! A node of an unpacked state: the part that a world and a cell state have in common.

use imrs_protocol::{Incarnation, Node, NodeId, NodeTable, Walk};
use std::cmp::Ordering;

/// The state of a node.
#[derive(Clone, Debug)]
pub(crate) struct NodeState {
    pub node: Node,
    pub table: NodeTable,
    pub up: bool,
    pub incarnation: Incarnation,
    /// The incarnation in which this node knows each other node.
    pub known: Vec<Incarnation>,
    /// Ticks that have passed and that the node has not noticed yet.
    pub owed: u8,
    /// Ticks since the node was paused; `None` if it is not paused. Only used in the search of a cell: see
    /// `cell::run_state::pause`.
    pub asleep: Option<u32>,
}

impl NodeState {
    /// A node at its first start, in a cell with `nodes` nodes.
    pub fn new(table: NodeTable, nodes: usize, transit: u16) -> Self {
        let first = Incarnation(0);
        let node = Node::new(table.clone(), first, false, transit);
        Self { node, table, up: true, incarnation: first, known: vec![first; nodes], owed: 0, asleep: None }
    }

    /// Starts the node again, in its next incarnation.
    pub fn restart(&mut self, transit: u16) {
        self.incarnation = Incarnation(self.incarnation.0 + 1);
        self.up = true;
        self.node = Node::new(self.table.clone(), self.incarnation, true, transit);
    }

    /// Compares the incarnation in an envelope with the one that the node knows of its sender. An envelope of a new
    /// incarnation is reported before any packet of that incarnation is handed on (D49). Packets of an older incarnation
    /// are dropped.
    pub fn hears(&mut self, from: NodeId, incarnation: Incarnation) -> Heard {
        let known = std::mem::replace(&mut self.known[from.index()], incarnation);
        match incarnation.0.cmp(&known.0) {
            Ordering::Equal => Heard::Known,
            Ordering::Greater => Heard::New,
            Ordering::Less => {
                self.known[from.index()] = known;
                Heard::Old
            }
        }
    }

    /// Encodes, decodes or visits whether the node is up and which incarnations it knows. Both are packed only if nodes
    /// can restart.
    pub fn walk_incarnations<W: Walk>(&mut self, w: &mut W) {
        let Self { up, incarnation, known, node: _, table: _, owed: _, asleep: _ } = self;
        w.flag(up);
        w.byte(&mut incarnation.0);
        known.iter_mut().for_each(|incarnation| w.byte(&mut incarnation.0));
    }
}

/// How the incarnation in an envelope relates to the incarnation that the receiving node knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Heard {
    Old,
    Known,
    New,
}
