//! This program in the two roles that the launcher needs: it launches nodes, and it runs as a node.

use crate::exit::Exit;
use crate::failure::exit_of_node;
use crate::output::{complain, complain_aside};
use imrs_launch::{Host, NodeError};
use indicatif::ProgressBar;
use std::fmt::Display;
use std::io;

/// This program, as the launcher sees it: it launches nodes, and `imrs node` runs one node.
pub struct NodeProgram;

impl Host for NodeProgram {
    fn complain(&self, what: &dyn Display) {
        complain(what);
    }

    fn complain_aside(&self) -> io::Result<()> {
        complain_aside(ProgressBar::hidden())
    }

    fn exit_code(&self, error: Option<&NodeError>) -> i32 {
        error.map_or(Exit::Internal, exit_of_node) as i32
    }

    fn is_refusal(&self, exit_code: i32) -> bool {
        [Exit::Usage, Exit::System].map(|exit| exit as i32).contains(&exit_code)
    }
}
