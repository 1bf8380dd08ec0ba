//! Errors that keep a cell from running.

use super::faults::FaultError;
use crate::exit::Exit;
use imrs_client::PlaceError;
use std::io;

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
