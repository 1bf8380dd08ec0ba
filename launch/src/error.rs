//! Errors that keep a cell from running.

use imrs_client::PlaceError;
use std::io;

/// Why a cell could not be run.
#[derive(Debug, thiserror::Error)]
pub enum LaunchError {
    /// A process or thread cannot be started.
    #[error("cannot start the nodes: {0}")]
    Start(#[source] io::Error),
    /// A node failed before all were ready.
    #[error("node `{name}` did not get ready")]
    NotReady {
        /// The node's name.
        name: String,
        /// Whether the node exited because of the user's request or the system, not because of a fault of this program.
        refused: bool,
    },
    /// The user pressed Ctrl-C before all nodes were ready.
    #[error("interrupted before node `{0}` was ready: nothing has run")]
    Interrupted(String),
    /// The node cannot run on its own.
    #[error(transparent)]
    Place(#[from] PlaceError),
}
