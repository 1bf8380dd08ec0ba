//! How the command ends: its exit codes, and the errors that lead to them.

use imrs_language::Diagnostic;
use rustix::io::Errno;
use std::collections::BTreeSet;
use std::error::Error;
use std::io;
use std::process::ExitCode;

/// The exit codes of every verb.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// All well.
    Well = 0,
    /// A finding: a claim came out otherwise than expected, a run broke a promise.
    Finding = 1,
    /// Bad input or usage.
    Usage = 2,
    /// Nothing to attach to.
    Nothing = 3,
    /// Out of the given budget, with a partial answer.
    Budget = 4,
    /// Evidence is missing: nothing was found, and not everything could be judged.
    Incomplete = 5,
    /// A fault of this program.
    Internal = 70,
    /// The operating system has no memory, file descriptor or thread left for this program.
    System = 71,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

/// What keeps the command from doing what it was asked to.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// An argument names something that is not there, or does not fit the others.
    #[error("{0}")]
    Usage(String),
    /// A cell file cannot be read or written.
    #[error(transparent)]
    CellFile(#[from] crate::cell_file::CellFileError),
    /// What was asked for cannot be kept in a file.
    #[error(transparent)]
    Kept(#[from] crate::kept::KeptError),
    /// The cell has errors: the diagnostics of its compiler.
    #[error("{0}")]
    Cell(String),
    /// Standard output cannot be written to.
    #[error("cannot write the answer: {0}")]
    Output(#[source] io::Error),
    /// The cell could not be run.
    #[error(transparent)]
    Launch(#[from] crate::launch::LaunchError),
    /// A node of it could not do its part.
    #[error(transparent)]
    Node(#[from] crate::launch::NodeError),
    /// The recording cannot be replayed.
    #[error(transparent)]
    Replay(#[from] crate::replay::ReplayError),
    /// Nothing could be measured, or the answer not be kept.
    #[cfg(feature = "bench")]
    #[error(transparent)]
    Bench(#[from] imrs_bench::BenchError),
    /// The monitor could not do its work.
    #[error(transparent)]
    Monitor(#[from] imrs_monitor::MonitorError),
}

impl Failure {
    /// The exit code it leads to.
    pub fn exit(&self) -> Exit {
        // The stream is non-blocking and its reader slow: nothing has run out.
        if matches!(self, Self::Output(error) if error.kind() == io::ErrorKind::WouldBlock) {
            return Exit::Usage;
        }
        let mut cause: Option<&(dyn Error + 'static)> = Some(self);
        while let Some(error) = cause {
            if error.downcast_ref().is_some_and(is_exhausted) {
                return Exit::System;
            }
            cause = error.source();
        }
        match self {
            Self::Usage(_)
            | Self::CellFile(_)
            | Self::Kept(_)
            | Self::Cell(_)
            | Self::Output(_)
            | Self::Replay(_) => Exit::Usage,
            #[cfg(feature = "bench")]
            Self::Bench(_) => Exit::Usage,
            Self::Launch(error) => error.exit(),
            Self::Node(error) => error.exit(),
            Self::Monitor(error) => match error.exit_code() {
                2 => Exit::Usage,
                3 => Exit::Nothing,
                _ => Exit::Internal,
            },
        }
    }
}

/// Whether the operating system has run out of something.
fn is_exhausted(error: &io::Error) -> bool {
    error.raw_os_error().is_some_and(|code| EXHAUSTED.contains(&code))
}

/// What the operating system says then: no memory, no descriptors (of this process, of the system), no thread or process.
const EXHAUSTED: [i32; 4] = [
    Errno::NOMEM.raw_os_error(),
    Errno::MFILE.raw_os_error(),
    Errno::NFILE.raw_os_error(),
    Errno::AGAIN.raw_os_error(),
];

/// Whether a panic says so: libraries may not hand such an error on.
pub fn says_exhausted(panic: &str) -> bool {
    EXHAUSTED.iter().any(|code| panic.contains(&format!("Os {{ code: {code},")))
}

/// What a verb ends with where the compiler turned a cell down: what is larger or deeper than is looked at is bad input, like a
/// file that is too long.
pub fn turned_down(found: &[Diagnostic]) -> Exit {
    if found.iter().any(Diagnostic::is_limit) { Exit::Usage } else { Exit::Finding }
}

/// Of `names`, the one most like `wanted`, as the end of an error message: ": did you mean `x`?", or all of them.
pub fn did_you_mean<'a>(wanted: &str, names: impl IntoIterator<Item = &'a str>) -> String {
    let mut names: Vec<&str> = names.into_iter().collect();
    let mut seen = BTreeSet::new();
    names.retain(|name| seen.insert(*name));
    let likeness = |name: &&&str| (strsim::jaro_winkler(wanted, name) * 1000.0).round() as u32;
    match names.iter().max_by_key(likeness).filter(|best| likeness(best) > 700) {
        Some(best) => format!(": did you mean `{best}`?"),
        None if names.is_empty() => ": there are none".into(),
        None => format!(": there are {}", names.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::launch::LaunchError;

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

    #[test]
    fn a_slip_is_recognised_and_anything_else_gets_the_list() {
        let names = ["no-false-release", "pairing", "at-most-once"];
        assert_eq!(did_you_mean("no-false-relese", names), ": did you mean `no-false-release`?");
        let twice = names.into_iter().chain(names);
        assert_eq!(did_you_mean("xyz", twice), ": there are no-false-release, pairing, at-most-once");
        assert_eq!(did_you_mean("xyz", []), ": there are none");
        assert_eq!(did_you_mean("xyz", names), ": there are no-false-release, pairing, at-most-once");
    }
}
