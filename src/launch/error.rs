//! Errors that keep a cell, or a node of it, from running.

use super::faults::FaultError;
use crate::exit::Exit;
use std::io;
use std::path::PathBuf;

/// Why a cell could not be run.
#[derive(Debug, thiserror::Error)]
pub enum LaunchError {
    /// The requested faults do not fit the cell or the run.
    #[error(transparent)]
    Fault(#[from] FaultError),
    /// A process or thread cannot be started.
    #[error("cannot start the nodes: {0}")]
    Start(#[source] io::Error),
    /// A node failed before all were ready.
    #[error("node `{name}` did not get ready")]
    NotReady {
        /// Its name.
        name: String,
        /// Whether the node exited because of the request or the system, not by a fault of this program.
        refused: bool,
    },
    /// Ctrl-C came before all nodes were ready.
    #[error("interrupted before node `{0}` was ready: nothing has run")]
    Interrupted(String),
    /// The node cannot run on its own.
    #[error(transparent)]
    Place(#[from] PlaceError),
}

impl LaunchError {
    /// The exit code it leads to.
    pub fn exit(&self) -> Exit {
        match self {
            Self::Fault(_) | Self::Place(_) | Self::NotReady { refused: true, .. } => Exit::Usage,
            Self::Interrupted(_) => Exit::Incomplete,
            Self::Start(_) | Self::NotReady { refused: false, .. } => Exit::Internal,
        }
    }
}

/// Why a node cannot run on its own.
#[derive(Debug, thiserror::Error)]
pub enum PlaceError {
    /// The cell declares no host for it.
    #[error("node `{0}` has no address: write `node {0} at \"10.0.0.11\" port 7000;`")]
    NoHost(String),
    /// The cell declares no port for it.
    #[error("node `{0}` has no UDP port: write `node {0} at \"{1}\" port 7000;`")]
    NoPort(String, String),
    /// Its host name does not resolve.
    #[error("node `{node}` at \"{host}\": {source}")]
    Unknown {
        /// The node.
        node: String,
        /// Its host.
        host: String,
        /// Why.
        source: io::Error,
    },
    /// The incarnation of the node cannot be stored.
    #[error("cannot remember in {path} that the node ran: {source}")]
    Life {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Another process runs this node.
    #[error(
        "node `{node}` of this cell runs already on this machine, as process {process}: stop that first, or give this one a state of its own with XDG_STATE_HOME"
    )]
    Runs {
        /// The node.
        node: String,
        /// The id of the process that runs it.
        process: String,
    },
    /// There is no folder in which the incarnation can be stored.
    #[error("no folder to remember in that the node ran: set XDG_STATE_HOME or HOME")]
    NoFolder,
}
