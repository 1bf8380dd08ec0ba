//! The programs of a node's tasks: which kinds there are, where they run, and how they ended.

use crate::api::context::{Caller, TaskError};
use crate::node::Node;
use crate::node::home::RunBy;
use imrs_protocol::NodeId;
use imrs_protocol::script::{End, Program as Script, ProgramError};
use std::any::Any;
use std::future::Future;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::thread::{self, JoinHandle};

/// Runs a task's program with a context for the task at this position on the node.
pub(crate) type TaskBody = Box<dyn FnOnce(Arc<Node>, usize) -> Result<(), TaskError> + Send>;

/// The running program of a task that is a future. It never moves to another thread.
pub(crate) type Running = Pin<Box<dyn Future<Output = Result<(), TaskError>>>>;
/// Makes the program of a task; the program reaches its communication task through the `Caller`.
pub(crate) type AsyncBody = Box<dyn FnOnce(Caller) -> Running + Send>;

/// The program of a task.
pub(crate) enum TaskProgram {
    /// A Rust program, on a thread of its own.
    Body(TaskBody),
    /// A Rust program that is a future, on the thread of the node's futures.
    Async(AsyncBody),
    /// A script. The thread that brings input for it runs it.
    Script(Arc<Script>),
}

impl TaskProgram {
    pub const fn run_by(&self) -> RunBy {
        match self {
            Self::Body(_) => RunBy::ItsThread,
            Self::Async(_) => RunBy::TheThreadOfFutures,
            Self::Script(_) => RunBy::AnyThread,
        }
    }
}

/// How a task's program ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TaskEnd {
    /// The program returned, by itself or because the node stops.
    Returned,
    /// The program returned an error.
    Failed(TaskError),
    /// The program panicked with this message: a crash of this task alone.
    Panicked(String),
    /// The program was a script, and ended by itself.
    Script(End),
    /// The program was still running when `patience` ended. Its thread goes on, but its requests fail. A future is
    /// dropped when it next waits.
    Unfinished,
}

/// Why a node was not started.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The cell has no such node.
    #[error("the cell has no node {0}")]
    NoNode(NodeId),
    /// The cell has no such task.
    #[error("the cell has no task `{0}`")]
    NoTask(String),
    /// The task is assigned to another node.
    #[error("task `{task}` runs on node `{node}`, not here")]
    Elsewhere {
        /// The name of the task.
        task: String,
        /// The name of the node on which the task runs.
        node: String,
    },
    /// The task was given two programs.
    #[error("task `{0}` was given two programs")]
    Twice(String),
    /// The task was given no program.
    #[error("task `{0}` was given no program")]
    NoProgram(String),
    /// The node has neighbours, and no link was given.
    #[error("node `{0}` has neighbours but was given no link")]
    NoLink(String),
    /// The script of this task is malformed.
    #[error("the script of task `{0}` is malformed: {1:?}")]
    Script(String, ProgramError),
    /// The operating system refused a thread.
    #[error("cannot start a thread for `{name}`: {source}")]
    Thread {
        /// The name of the thread that was to be started.
        name: String,
        /// The error of the operating system.
        source: io::Error,
    },
}

pub(crate) fn spawn(name: &str, run: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, StartError> {
    // A thread's name must contain no zero byte. The kernel keeps 15 bytes of the name.
    let kernel_name = name.replace('\0', " ");
    let started = thread::Builder::new().name(kernel_name).spawn(run);
    started.map_err(|source| StartError::Thread { name: name.into(), source })
}

pub(crate) fn message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(ToString::to_string);
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "no message".into())
}
