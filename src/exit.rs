//! The exit codes of the command.

use imrs_language::Diagnostic;
use imrs_launch::Verdict;
use rustix::io::Errno;
use std::error::Error;
use std::io;
use std::process::ExitCode;

/// The exit codes of all verbs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// Everything is as it should be: there is no finding.
    Well = 0,
    /// A finding: a claim did not come out as expected, or a run broke a promise.
    Finding = 1,
    /// Bad input or usage.
    Usage = 2,
    /// No node was found to attach to.
    Nothing = 3,
    /// The given budget is used up; the answer is partial.
    Budget = 4,
    /// Nothing was found, but evidence is missing, so not everything could be judged.
    Incomplete = 5,
    /// There is no finding, but links were faulty, or too many datagrams came that no node of the cell sent.
    Suspect = 6,
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

impl From<Verdict> for Exit {
    fn from(verdict: Verdict) -> Self {
        match verdict {
            Verdict::Well => Self::Well,
            Verdict::Finding => Self::Finding,
            Verdict::Suspect => Self::Suspect,
            Verdict::Incomplete => Self::Incomplete,
            Verdict::Fault => Self::Internal,
        }
    }
}

/// Whether an error says that the operating system has run out of memory, file descriptors or threads.
pub fn is_exhausted(error: &(dyn Error + 'static)) -> bool {
    let of_system = |error: &io::Error| error.raw_os_error().is_some_and(|code| EXHAUSTED.contains(&code));
    std::iter::successors(Some(error), |error| (*error).source())
        .any(|error| error.downcast_ref().is_some_and(of_system))
}

/// The operating system's error codes for a lack of memory, of file descriptors (of this process, of the system), and
/// of threads or processes.
pub(crate) const EXHAUSTED: [i32; 4] = [
    Errno::NOMEM.raw_os_error(),
    Errno::MFILE.raw_os_error(),
    Errno::NFILE.raw_os_error(),
    Errno::AGAIN.raw_os_error(),
];

/// Whether a panic message says that the operating system has run out of one of the resources of `EXHAUSTED`, in one of
/// the two forms of an [`io::Error`]. Libraries may panic on such an error, as the standard library does when a new
/// thread gets no memory for its signal stack.
pub fn says_exhausted(panic: &str) -> bool {
    let says = |code| {
        [format!("Os {{ code: {code},"), format!("(os error {code})")].map(|form| panic.contains(&form))
    };
    EXHAUSTED.iter().any(|code| says(code).contains(&true))
}

/// The exit code if the compiler rejects a cell. A cell that exceeds a limit of the compiler is bad input, like a file that
/// is too long.
pub fn turned_down(found: &[Diagnostic]) -> Exit {
    if found.iter().any(Diagnostic::is_limit) { Exit::Usage } else { Exit::Finding }
}
