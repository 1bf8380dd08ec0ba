//! Errors that keep the nodes of a program from running.

use imrs_runtime::StartError;
use imrs_runtime::link::udp::UdpError;
use imrs_runtime::observer::ObserverError;
use imrs_wire::obs::TokenError;
use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;

/// Why a [`Program`](crate::Program) cannot run its nodes. Its text says what to do.
///
/// ```
/// use imrs_client::{Program, ProgramError};
///
/// const CELL: &str = "cell alone;
/// tick 1 msec;
/// node here;
/// task camera on here extern
/// end camera;
/// ";
/// # fn main() -> Result<(), ProgramError> {
/// let error = Program::of_text("alone.cell", CELL)?.run(None).expect_err("the camera has no body");
/// assert!(matches!(&error, ProgramError::NoBody(task) if task == "camera"));
/// assert_eq!(error.to_string(), "task `camera` is extern and was given no body: call `task(\"camera\", …)`");
///
/// // The compiler's diagnostics, with the name that the text was given.
/// let error = Program::of_text("faulty.cell", "cell faulty;\nnode a\n").err().expect("an error");
/// assert!(error.to_string().contains("faulty.cell:2:"), "{error}");
/// # Ok(())
/// # }
/// ```
#[derive(Debug, thiserror::Error)]
pub enum ProgramError {
    /// The file cannot be read, or the cell has errors.
    #[error("{0}")]
    Cell(String),
    /// The cell has no task of this name.
    #[error("the cell has no task `{0}`")]
    NoTask(String),
    /// The cell has no action of this name.
    #[error("the cell has no action `{0}`")]
    NoAction(String),
    /// The cell has no node of this name.
    #[error("the cell has no node `{0}`")]
    NoNode(String),
    /// The task has a script in the cell. Only an extern task takes a body in Rust.
    #[error(
        "task `{0}` has a script in the cell; write `task {0} on … extern` there to give it a body in Rust"
    )]
    NotExtern(String),
    /// The extern task runs on a node of this program, and has no body.
    #[error("task `{0}` is extern and was given no body: call `task(\"{0}\", …)`")]
    NoBody(String),
    /// Neither keys nor another means authenticate the packets of the node.
    #[error(
        "node `{0}` has no keys, and without them other processes could forge its packets: `imrs keygen CELL` makes them beside the cell file; call `keys(…)` if they are elsewhere, or `insecure()` for all nodes on a network of your own"
    )]
    NoKeys(String),
    /// Monitors at this TCP address need no token.
    #[error(
        "monitors at {0}: all who reach this address could watch, on a loopback address each user of this machine, because no token is asked for; call `observe_token(…)`, or leave `observe(…)` out: `imrs monitor` on this machine finds the node"
    )]
    Watched(SocketAddr),
    /// The text is not a valid token.
    #[error(transparent)]
    Token(#[from] TokenError),
    /// The node cannot run on its own: for example, it has no address, it runs already, or its incarnation cannot be stored.
    #[error(transparent)]
    Place(#[from] PlaceError),
    /// The UDP socket of the node cannot be opened.
    #[error(transparent)]
    Link(#[from] UdpError),
    /// A node did not start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// Monitors cannot be served.
    #[error(transparent)]
    Observe(#[from] ObserverError),
    /// The operating system could not start the threads that carry out actions.
    #[error("cannot start the actions: {0}")]
    Actions(io::Error),
}

/// Why a node cannot run on its own ([`Program::node`](crate::Program::node)).
///
/// ```
/// use imrs_client::{PlaceError, Program, ProgramError};
///
/// const CELL: &str = "cell two;
/// tick 1 msec;
/// node na;
/// node nb at \"127.0.0.1\" port 7412;
/// link na -- nb delay 1 msec;
/// task left on na extern
/// end left;
/// task right on nb extern
/// end right;
/// ";
/// # fn main() -> Result<(), ProgramError> {
/// let error = Program::of_text("two.cell", CELL)?.task("left", |_| Ok(())).node("na").run(None);
/// assert!(matches!(error, Err(ProgramError::Place(PlaceError::NoHost(node))) if node == "na"));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, thiserror::Error)]
pub enum PlaceError {
    /// The cell declares no host for the node.
    #[error("node `{0}` has no address: write `node {0} at \"10.0.0.11\" port 7000;`")]
    NoHost(String),
    /// The cell declares no port for the node.
    #[error("node `{0}` has no UDP port: write `node {0} at \"{1}\" port 7000;`")]
    NoPort(String, String),
    /// The node's host name does not resolve.
    #[error("node `{node}` at \"{host}\": {source}")]
    Unknown {
        /// The node whose host name does not resolve.
        node: String,
        /// The node's host.
        host: String,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The incarnation of the node cannot be stored on the disk.
    #[error("cannot remember in {path} that the node ran: {source}")]
    Unstored {
        /// The file in which the incarnation should be stored.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// Another process runs this node.
    #[error(
        "node `{node}` of this cell runs already on this machine, as process {process}: stop that first, or give this one a state of its own with XDG_STATE_HOME"
    )]
    Runs {
        /// The node that already runs.
        node: String,
        /// The id of the process that runs the node.
        process: String,
    },
    /// The keys of the node cannot be used.
    #[error("the keys {}: {why}; `imrs keygen` makes keys", path.display())]
    Keys {
        /// The file of the keys.
        path: PathBuf,
        /// The reason, as text.
        why: String,
    },
    /// The operating system does not let this program make new keys.
    #[error("no keys can be made: {0}")]
    NoNewKeys(String),
    /// There is no folder in which the incarnation can be stored.
    #[error("no folder to remember in that the node ran: set XDG_STATE_HOME or HOME")]
    NoFolder,
}
