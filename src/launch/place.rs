//! Where a node is when it runs by itself: its address, and those of its neighbours.

use crate::cells::Loaded;
use imrs_protocol::NodeId;
use std::collections::BTreeMap;
use std::io;
use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;

/// Why a node cannot run by itself.
#[derive(Debug, thiserror::Error)]
pub enum PlaceError {
    /// The cell does not say on which host it is.
    #[error("node `{0}` has no address: write `node {0} at \"10.0.0.11\" port 7000;`")]
    NoHost(String),
    /// The cell does not say at which port it is.
    #[error("node `{0}` has no UDP port: write `node {0} at \"{1}\" port 7000;`")]
    NoPort(String, String),
    /// Its host has no address.
    #[error("node `{node}` at \"{host}\": {source}")]
    Unknown {
        /// The node.
        node: String,
        /// Its host.
        host: String,
        /// Why.
        source: io::Error,
    },
    /// The life of the node cannot be written down.
    #[error("cannot remember in {path} that the node ran: {source}")]
    Life {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// It runs already.
    #[error(
        "node `{node}` of this cell runs already on this machine, as process {process}: stop that first, or give this one a state of its own with XDG_STATE_HOME"
    )]
    Runs {
        /// The node.
        node: String,
        /// The number of the process that runs it.
        process: String,
    },
    /// There is no folder for what must be remembered.
    #[error("no folder to remember in that the node ran: set XDG_STATE_HOME or HOME")]
    NoFolder,
}

/// The declared address of a node.
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

/// The declared addresses of a node's neighbours, by their names.
///
/// # Errors
/// [`PlaceError`].
pub fn neighbours(loaded: &Loaded, node: NodeId) -> Result<BTreeMap<String, SocketAddr>, PlaceError> {
    let of =
        |peer: NodeId| Ok((loaded.table.cell().nodes[peer.index()].name.clone(), address(loaded, peer)?));
    loaded.table.neighbours(node).map(of).collect()
}
