//! The errors because of which a node ends.

use imrs_client::PlaceError;
use imrs_runtime::StartError;
use imrs_runtime::link::udp::UdpError;
use imrs_runtime::observer::ObserverError;
use imrs_wire::recording::WriteError;
use std::io;

/// Why a node failed.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    /// The pipes to the launcher failed.
    #[error("node: the launcher's pipe failed: {0}")]
    Pipe(#[from] io::Error),
    /// The setup that the launcher sent does not fit the cell.
    #[error("node: the launcher asked for {0}")]
    Setup(String),
    /// The UDP socket of the node cannot be opened.
    #[error("node: {0}")]
    Link(#[from] UdpError),
    /// The node cannot run on its own.
    #[error("node: {0}")]
    Place(#[from] PlaceError),
    /// The node did not start.
    #[error("node: {0}")]
    Start(#[from] StartError),
    /// The recording of the node cannot be written.
    #[error("node: cannot record: {0}")]
    Record(#[from] WriteError),
    /// Monitors cannot be served at the requested address.
    #[error("node: {0}")]
    Observe(#[from] ObserverError),
}
