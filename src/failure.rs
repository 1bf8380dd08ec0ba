//! The errors of the command, and their exit codes.

use crate::exit::{Exit, is_exhausted};
use imrs_launch::{LaunchError, NodeError};
use std::io;

/// Why the command cannot do what was asked.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// An argument names something that does not exist, or contradicts another argument.
    #[error("{0}")]
    Usage(String),
    /// A cell file cannot be read.
    #[error(transparent)]
    CellFile(#[from] crate::cell_file::CellFileError),
    /// A cell file cannot be written.
    #[error(transparent)]
    Unwritable(#[from] crate::cell_file::Unwritable),
    /// An output file cannot be written.
    #[error(transparent)]
    Kept(#[from] crate::kept::KeptError),
    /// The cell cannot be used.
    #[error(transparent)]
    Cell(#[from] imrs_client::cells::CellError),
    /// Standard output cannot be written to.
    #[error("cannot write the answer: {0}")]
    Output(#[source] io::Error),
    /// The cell could not be run.
    #[error(transparent)]
    Launch(#[from] LaunchError),
    /// The requested faults do not fit the cell or the run.
    #[error(transparent)]
    Fault(#[from] crate::faults::FaultError),
    /// A node failed.
    #[error(transparent)]
    Node(#[from] NodeError),
    /// The recording cannot be replayed.
    #[error(transparent)]
    Replay(#[from] crate::replay::error::ReplayError),
    /// The measurements failed, or their answer cannot be written.
    #[cfg(feature = "bench")]
    #[error(transparent)]
    Bench(#[from] imrs_bench::BenchError),
    /// The claims were checked, but too few fused steps were compared for that to mean anything.
    #[error(
        "only {times} {kind} were compared in fused and in small steps, and 1,000 are the least: report this"
    )]
    TooFewCompared { kind: &'static str, times: u64 },
    /// The monitor failed.
    #[error(transparent)]
    Monitor(#[from] imrs_monitor::MonitorError),
}

impl Failure {
    /// The exit code for this error.
    pub fn exit(&self) -> Exit {
        // On a non-blocking stream this error means that the reader is slow, not that the system has run out of a resource.
        if matches!(self, Self::Output(error) if error.kind() == io::ErrorKind::WouldBlock) {
            return Exit::Usage;
        }
        if is_exhausted(self) {
            return Exit::System;
        }
        match self {
            Self::Usage(_)
            | Self::CellFile(_)
            | Self::Unwritable(_)
            | Self::Kept(_)
            | Self::Cell(_)
            | Self::Fault(_)
            | Self::Output(_)
            | Self::Replay(_) => Exit::Usage,
            #[cfg(feature = "bench")]
            Self::Bench(_) => Exit::Usage,
            Self::Launch(error) => match error {
                LaunchError::Place(_) | LaunchError::NotReady { refused: true, .. } => Exit::Usage,
                LaunchError::Interrupted(_) => Exit::Incomplete,
                LaunchError::Start(_) | LaunchError::NotReady { refused: false, .. } => Exit::Internal,
            },
            Self::Node(error) => exit_of_node(error),
            Self::TooFewCompared { .. } => Exit::Internal,
            Self::Monitor(error) => match error.exit_code() {
                2 => Exit::Usage,
                3 => Exit::Nothing,
                _ => Exit::Internal,
            },
        }
    }
}

/// The exit code for an error of a node.
pub fn exit_of_node(error: &NodeError) -> Exit {
    match error {
        _ if is_exhausted(error) => Exit::System,
        // This machine cannot provide a thing for which the command line asked.
        NodeError::Link(_) | NodeError::Place(_) | NodeError::Record(_) | NodeError::Observe(_) => {
            Exit::Usage
        }
        NodeError::Pipe(_) | NodeError::Setup(_) | NodeError::Start(_) => Exit::Internal,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exit::{EXHAUSTED, says_exhausted};
    use rustix::io::Errno;

    #[test]
    fn a_system_that_has_run_out_of_something_is_no_fault_of_the_program() {
        let refused = |code: i32| LaunchError::Start(io::Error::from_raw_os_error(code));
        assert_eq!(EXHAUSTED.map(|code| Failure::from(refused(code)).exit()), [Exit::System; 4]);
        let unwritten = |errno: Errno| Failure::Output(errno.into()).exit();
        assert_eq!(unwritten(Errno::NOMEM), Exit::System);
        assert_eq!([Errno::NOSPC, Errno::AGAIN].map(unwritten), [Exit::Usage; 2]);
        let panic = format!("{:?}", io::Error::from_raw_os_error(Errno::AGAIN.raw_os_error()));
        assert!(says_exhausted(&panic), "{panic}");
        assert!(!says_exhausted("index out of bounds"));
    }
}
