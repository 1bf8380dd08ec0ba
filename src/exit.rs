//! How the command ends: its exit codes.

use imrs_language::Diagnostic;
use rustix::io::Errno;
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

/// Whether the operating system has run out of something.
pub fn is_exhausted(error: &io::Error) -> bool {
    error.raw_os_error().is_some_and(|code| EXHAUSTED.contains(&code))
}

/// What the operating system says then: no memory, no descriptors (of this process, of the system), no thread or process.
pub(crate) const EXHAUSTED: [i32; 4] = [
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
