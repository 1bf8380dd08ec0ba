//! The errors with which the monitor ends.

use imrs_wire::obs::place::PlaceError;
use std::io;
use std::path::PathBuf;
use thiserror::Error;

/// An error with which the monitor ends.
#[derive(Debug, Error)]
pub enum MonitorError {
    /// The monitor found no node, or none of the named nodes answered.
    #[error("no running node found{}", reasons(.looked, .failed))]
    NothingFound {
        /// The folder that was searched; `None` if the user named the addresses of nodes.
        looked: Option<PathBuf>,
        /// The failed attempts, one text each.
        failed: Vec<String>,
    },
    /// Nodes run, but of other cells.
    #[error("no node of cell `{}` runs; there are nodes of {}", crate::name::shown(.name), .cells.join(", "))]
    NoSuchCell {
        /// The cell that the user named.
        name: String,
        /// The cells whose nodes run.
        cells: Vec<String>,
    },
    /// The folder of the sockets cannot be read.
    #[error(transparent)]
    Place(#[from] PlaceError),
    /// A recording cannot be read or written.
    #[error("{}: {why}", crate::name::shown_line(&.path.display().to_string()))]
    Recording {
        /// The path of the recording.
        path: PathBuf,
        /// The reason, as text.
        why: String,
    },
    /// The terminal failed, or standard output did.
    #[error("the terminal failed: {0}")]
    Terminal(#[source] io::Error),
    /// The signal handlers cannot be installed.
    #[error("cannot handle signals: {0}")]
    Signals(#[source] io::Error),
    /// An internal fault, such as a panic in a thread of the monitor.
    #[error("an internal fault ended the monitor")]
    Internal,
}

impl MonitorError {
    /// The exit code of a command that ends with this error: 3 if there is nothing to attach to, 2 for bad input, 70
    /// for an internal fault.
    #[must_use]
    pub const fn exit_code(&self) -> u8 {
        match self {
            Self::NothingFound { .. } | Self::NoSuchCell { .. } => 3,
            Self::Place(_) | Self::Recording { .. } => 2,
            Self::Terminal(_) | Self::Signals(_) | Self::Internal => 70,
        }
    }
}

fn reasons(looked: &Option<PathBuf>, failed: &[String]) -> String {
    let mut text = String::new();
    if let Some(dir) = looked {
        text.push_str(&format!(" under {}", crate::name::shown(&dir.display().to_string())));
    }
    for one in failed {
        text.push_str("\n  ");
        text.push_str(one);
    }
    text + "\nstart one with `imrs demo beam-lift`, look at `imrs monitor --demo`, or name one with `--connect unix:PATH`"
}
