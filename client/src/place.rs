//! The addresses of a node: its own, those of its neighbours, and the one at which monitors find it.

use crate::cells::Loaded;
use crate::error::PlaceError;
use imrs_protocol::NodeId;
use std::collections::BTreeMap;
use std::io;
use std::net::{SocketAddr, ToSocketAddrs};

/// Returns the declared address of a node.
///
/// # Errors
/// [`PlaceError`].
pub fn address(loaded: &Loaded, node: NodeId) -> Result<SocketAddr, PlaceError> {
    let name = || loaded.table.cell().nodes[node.index()].name.clone();
    let declared = &loaded.addresses[node.index()];
    let host = declared.host.clone().ok_or_else(|| PlaceError::NoHost(name()))?;
    let port = declared.port.ok_or_else(|| PlaceError::NoPort(name(), host.clone()))?;
    let unknown = |source| PlaceError::Unknown { node: name(), host: host.clone(), source };
    let mut found = (host.as_str(), port).to_socket_addrs().map_err(unknown)?;
    found.next().ok_or_else(|| unknown(io::Error::other("it has no address")))
}

/// Returns the declared addresses of a node's neighbours, by the neighbours' names.
///
/// # Errors
/// [`PlaceError`].
pub fn neighbours(loaded: &Loaded, node: NodeId) -> Result<BTreeMap<String, SocketAddr>, PlaceError> {
    let of =
        |peer: NodeId| Ok((loaded.table.cell().nodes[peer.index()].name.clone(), address(loaded, peer)?));
    loaded.table.neighbours(node).map(of).collect()
}

/// The observer address of node number `after`, counted from 0. The nodes get successive ports from the port of `first`
/// on. Port 0 means any free port for each node.
#[must_use]
pub fn observed_at(first: SocketAddr, after: usize) -> SocketAddr {
    let port = first.port();
    let after = u16::try_from(after).unwrap_or(u16::MAX);
    SocketAddr::new(first.ip(), if port == 0 { 0 } else { port.saturating_add(after) })
}
