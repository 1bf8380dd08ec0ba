//! Where a node is when it runs by itself: its address, those of its neighbours, and which of its lives this is.

use crate::cells::Loaded;
use imrs_protocol::{CellTable, Incarnation, NodeId};
use imrs_wire::obs::place::file_name;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Write};
use std::net::{SocketAddr, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::time::Duration;

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

/// How long the scripts of a restarted node are held back.
pub fn quarantine(table: &CellTable, node: NodeId) -> Duration {
    Duration::from_micros(table.quarantine(node).0)
}

/// Begins the next life of a node (D49): which one it is, and whether there was one before. What it is counted by lies in
/// `$XDG_STATE_HOME/imrs/<cell>/<node>.life`.
///
/// # Errors
/// [`PlaceError`]: a node that cannot remember its lives could pass for an earlier one of its own.
pub fn next_life(cell: &str, node: &str) -> Result<(Incarnation, bool), PlaceError> {
    let named = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let base = named("XDG_STATE_HOME").or_else(|| Some(named("HOME")?.join(".local/state")));
    let folder = base.ok_or(PlaceError::NoFolder)?.join("imrs").join(file_name(cell));
    next_life_in(&folder, node)
}

fn next_life_in(folder: &Path, node: &str) -> Result<(Incarnation, bool), PlaceError> {
    let path = folder.join(format!("{}.life", file_name(node)));
    let failed = |source| PlaceError::Life { path: path.clone(), source };
    let before = match fs::read_to_string(&path) {
        Ok(text) => Some(text.trim().parse::<u8>().map_err(|error| failed(io::Error::other(error)))?),
        Err(error) if error.kind() == io::ErrorKind::NotFound => None,
        Err(error) => return Err(failed(error)),
    };
    let life = before.map_or(0, |before| before.wrapping_add(1));
    // Whole or not at all, and before anything is sent in this life.
    let new = folder.join(format!("{}.life.new", file_name(node)));
    let written = fs::create_dir_all(folder).and_then(|()| {
        let mut file = File::create(&new)?;
        writeln!(file, "{life}")?;
        file.sync_all()?;
        fs::rename(&new, &path)
    });
    written.map_err(failed)?;
    Ok((Incarnation(life), before.is_some()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_lives_of_a_node_are_the_same_until_they_come_round() {
        let folder = tempfile::tempdir().unwrap();
        let mut last = None;
        for life in 0..300_u32 {
            let (next, restarted) = next_life_in(folder.path(), "n/1").unwrap();
            assert_eq!((u32::from(next.0), restarted), (life % 256, life > 0));
            assert_ne!(last, Some(next));
            last = Some(next);
        }
        fs::write(folder.path().join(format!("{}.life", file_name("n/1"))), "x").unwrap();
        assert!(next_life_in(folder.path(), "n/1").unwrap_err().to_string().contains("remember"));
        assert_eq!(next_life_in(folder.path(), "other").unwrap(), (Incarnation(0), false));
    }
}
