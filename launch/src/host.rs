//! What this room needs of the program that it is a part of.

use crate::node::error::NodeError;
use std::fmt::Display;
use std::io;

/// The program that launches nodes, and that runs a single node when it is called with the word `node`.
pub trait Host: Sync {
    /// Shows people a complaint.
    fn complain(&self, what: &dyn Display);

    /// From now on no complaint waits for its reader.
    ///
    /// # Errors
    /// The operating system refuses a thread.
    fn complain_aside(&self) -> io::Result<()>;

    /// The exit code of a process whose node failed; without an error: it panicked.
    fn exit_code(&self, error: Option<&NodeError>) -> i32;

    /// Whether a node's process with this exit code could not do what was asked, without a fault of this program.
    fn is_refusal(&self, exit_code: i32) -> bool;
}
