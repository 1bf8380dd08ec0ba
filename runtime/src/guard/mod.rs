//! The guard of a command: a process between a node and the command of an action, so that no command outlives its node.
//!
//! ```text
//!   node  ── standard input: `lease N`, or its end ──▶  guard  ── `deadline N` ──▶  command (its own process group)
//!   node  ◀── standard output: `began PID`, how it ended ──  guard  ◀── output ──  command
//!                                                             └── `ended KEY AT` ──▶ the launcher's notices
//! ```
//!
//! The guard kills the whole process group, and every descendant that left the group, when
//!
//! - its standard input ends: the node stopped the action, or the node is gone, however it ended;
//! - the lease of the task ends without a renewal, or the time of the action is over;
//! - the command itself has ended: nothing that the command started stays behind.
//!
//! After these processes have ended, the guard says how the command ended. If the guard itself is killed, the kernel kills
//! the command: the command asked for SIGKILL at the death of its parent, before the program of the action started.
//!
//! A guard is this same code in a process of its own: the program `imrs-guard`, or any program that calls [`entry`] at the start
//! of `main`.

pub mod actuator;
mod exec;
mod kin;
mod notices;
mod running;
mod watch;
mod words;

pub use notices::{Notice, Notices};
pub(crate) use running::Running;
pub(crate) use words::{Errand, Outcome};

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

/// The first argument of a program that is to be a guard.
const WORD: &str = "imrs-guard";
/// The second argument of the guard itself; the process that becomes the command has another one.
const WATCH: &str = "watch";
const EXEC: &str = "exec";
/// The path of this program's file, even if the file was replaced or removed since the start.
const OWN_FILE: &str = "/proc/self/exe";
/// The exit code of a guard that was called wrongly.
const USAGE: u8 = 2;

/// Does the work of a guard if this process was started as one, and returns its exit code; otherwise returns `None` at once.
///
/// A program whose [`Commands`](crate::script::Commands) use [`GuardProgram::This`] calls `entry` first in `main`,
/// before it starts any thread:
///
/// ```no_run
/// use std::process::ExitCode;
///
/// fn main() -> ExitCode {
///     if let Some(code) = imrs_runtime::guard::entry() {
///         return code;
///     }
///     // The program itself.
///     ExitCode::SUCCESS
/// }
/// ```
#[must_use = "a guard has nothing else to do"]
pub fn entry() -> Option<ExitCode> {
    let mut words = std::env::args_os().skip(1);
    if words.next()? != OsStr::new(WORD) {
        return None;
    }
    let stage = words.next().unwrap_or_default();
    let rest: Vec<_> = words.collect();
    Some(match (stage.to_str(), Errand::read(&rest)) {
        (Some(WATCH), Some(errand)) => watch::watch(&errand),
        (Some(EXEC), Some(errand)) => exec::exec(&errand),
        _ => {
            eprintln!(
                "{WORD}: nodes start this program for the commands of their actions; it does nothing by itself"
            );
            ExitCode::from(USAGE)
        }
    })
}

/// Which program guards the commands of a node.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum GuardProgram {
    /// `imrs-guard` beside the running program, else in the folders of PATH.
    #[default]
    Installed,
    /// The running program itself: it must call [`entry`] at the start of `main`.
    This,
    /// The program at this path: `imrs-guard`, or one that calls [`entry`].
    At(PathBuf),
}

impl GuardProgram {
    /// The path of the guard program, for messages.
    #[must_use]
    pub fn path(&self) -> PathBuf {
        match self {
            Self::Installed => {
                let beside = std::env::current_exe().ok().map(|own| own.with_file_name(WORD));
                beside.filter(|path| path.is_file()).unwrap_or_else(|| WORD.into())
            }
            Self::This => OWN_FILE.into(),
            Self::At(path) => path.clone(),
        }
    }

    pub(crate) fn command(&self, errand: &Errand) -> Command {
        stage(&self.path(), WATCH, errand)
    }
}

fn stage(program: &Path, stage: &str, errand: &Errand) -> Command {
    let mut command = Command::new(program);
    command.args([WORD, stage]).args(errand.words());
    command
}
