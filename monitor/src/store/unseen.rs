//! Nodes that a cell declares, but that never reported to this monitor.

use super::Store;
use crate::name::Name;
use imrs_protocol::NodeId;
use imrs_wire::obs::place;

/// A node of which only the name is known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unseen {
    /// Its id.
    pub node: NodeId,
    /// Its name.
    pub name: Name,
    /// Whether its socket was left behind, which means that it was killed.
    pub is_killed: bool,
}

/// The nodes of a cell without a known incarnation.
#[must_use]
pub fn unseen(store: &Store, cell: &Name) -> Vec<Unseen> {
    let Some(names) = store.names(cell) else { return Vec::new() };
    let folder = place::file_name(cell.raw());
    let is_killed = |name: &Name| store.killed.contains(&(folder.clone(), place::file_name(name.raw())));
    let nodes = names.nodes.iter().enumerate().map(|(i, name)| (NodeId::from_index(i), name));
    let unseen = nodes.filter(|(id, _)| store.latest(cell, *id).is_none());
    unseen.map(|(node, name)| Unseen { node, name: name.clone(), is_killed: is_killed(name) }).collect()
}
