//! The functions that the launcher needs from the program of which it is a part.

use crate::node::error::NodeError;
use std::fmt::Display;
use std::io;

/// The program that launches nodes, and that runs a single node when it is called with the word `node`.
pub trait Host: Sync {
    /// Shows a complaint to the user.
    fn complain(&self, what: &dyn Display);

    /// Makes the program write complaints on a thread of its own from now on, so that no complaint waits for its reader.
    fn complain_aside(&self) -> io::Result<()>;

    /// The exit code of a process whose node failed with this error. `None` means that the node panicked.
    fn exit_code(&self, error: Option<&NodeError>) -> i32;

    /// Whether this exit code of a node's process says that the node could not do what the user asked for, without a fault
    /// of this program.
    fn is_refusal(&self, exit_code: i32) -> bool;
}
