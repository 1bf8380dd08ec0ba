//! How the command ends: its exit codes, and the errors that lead to them.

use imrs_language::Diagnostic;
use std::collections::BTreeSet;
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
    /// The cell has errors: the diagnostics of its compiler.
    #[error("{0}")]
    Cell(String),
    /// Standard output cannot be written to.
    #[error("cannot write the answer: {0}")]
    Output(io::Error),
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
        match self {
            Self::Usage(_) | Self::CellFile(_) | Self::Cell(_) | Self::Output(_) | Self::Replay(_) => {
                Exit::Usage
            }
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
