//! Nodes that a cell declares, but that have never reported to this monitor.

use super::Store;
use crate::name::Name;
use imrs_protocol::NodeId;
use imrs_wire::obs::place;

/// A node of which only the name is known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unseen {
    /// The id of the node.
    pub node: NodeId,
    /// The name of the node.
    pub name: Name,
    /// Whether the node's socket was left behind, which means that the node was killed.
    pub is_killed: bool,
}

/// The nodes of a cell without a known incarnation.
#[must_use]
pub fn unseen(store: &Store, cell: &Name) -> Vec<Unseen> {
    let Some(names) = store.names(cell) else { return Vec::new() };
    let nodes = names.nodes.iter().enumerate().map(|(i, name)| (NodeId::from_index(i), name));
    let unseen = nodes.filter(|(id, _)| store.latest(cell, *id).is_none());
    unseen
        .map(|(node, name)| Unseen { node, name: name.clone(), is_killed: is_killed(store, cell, name) })
        .collect()
}

/// Whether the socket of a node of this name was left behind.
#[must_use]
pub fn is_killed(store: &Store, cell: &Name, node: &Name) -> bool {
    let is = |name: &Name, file: &String| place::file_name(name.raw()) == *file;
    store.killed.iter().any(|(folder, file)| is(cell, folder) && is(node, file))
}
