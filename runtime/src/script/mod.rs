//! Tasks whose behaviour is a script.
//!
//! A script has no thread. It is behind the lock of its communication task, which all scripts of the node share
//! (D186). The thread that brings input to the communication task also runs the script. So a step of the
//! communication task and the script's reaction are one step, as in the model. Messages between tasks of the node
//! take steps of their own, or fused steps (D176). A script's actions begin after the lock is released, and the end of an
//! action is an input.

mod actions;
mod command;
mod functions;
mod runner;
mod simulated;

pub use actions::{Act, Actions, Ending, HeldLease, Stop};
pub use command::{CommandError, Commands};
pub use functions::{Call, Functions};
pub use simulated::{Give, Ramp, Results, Simulated};

pub(crate) use actions::{OutsideEffect, Stage};
pub(crate) use runner::ScriptRunner;

use imrs_protocol::script::{Address, End, Script};
use imrs_protocol::{CommTask, ReplyTo, Request, Signal, TaskId, Ticks};

/// Receives notes about the acts of scripts. It is called under a lock that the node's messages need, so it must only
/// pass the note on and return.
pub trait Watch: Send + Sync {
    /// Takes a note about an act of the script of `task` at the instant `at`, in microseconds of the node's clock
    /// (`CLOCK_BOOTTIME`).
    fn note(&self, task: TaskId, at: u64, note: &Note);

    /// Takes the state of `task` from `at` on, in microseconds of the node's clock, once its script waits. This is a
    /// state between two steps of the cell, as checks see it. Called after every step.
    fn stands(&self, task: TaskId, at: u64, stands: &Stands<'_>) {
        let _ = (task, at, stands);
    }
}

/// The state of a task between two steps.
#[derive(Clone, Copy, Debug)]
pub struct Stands<'a> {
    /// The task's script.
    pub script: &'a Script,
    /// The task's communication task.
    pub machine: &'a CommTask,
}

/// An act of a script.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Note {
    /// A statement begins.
    Statement(Address),
    /// The script makes a request to its communication task.
    Asked(Request),
    /// The communication task answers the script.
    Answered(Signal),
    /// An action begins.
    Acts {
        /// The thread of the script that waits for the action.
        level: u8,
        /// The number of the action in [`Program::actions`](imrs_protocol::script::Program::actions).
        action: u16,
        /// The action's arguments.
        arguments: Vec<i64>,
        /// The longest time that the action may take.
        most: Ticks,
    },
    /// The action of this thread of the script has ended.
    Acted {
        /// The thread that waited for the action.
        level: u8,
        /// Whether the action succeeded.
        ok: bool,
        /// The action's result.
        value: i32,
    },
    /// The action of this thread of the script was cut short.
    CutShort(u8),
    /// The script forgets a class-2 message that it has not answered.
    Unanswered(ReplyTo),
    /// The script has ended.
    Ended(End),
}
