//! The description of a run: which cell and which nodes run, how long, and with which options.

use crate::cells::{Loaded, Source};
use crate::faults::Fault;
use imrs_protocol::{NodeId, TaskId};
use imrs_runtime::script::Ramp;
use imrs_wire::obs::Token;
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

/// A cell to run, and how to run it.
pub struct Run<'a> {
    /// The text of the cell.
    pub source: Source,
    /// The cell that runs.
    pub loaded: &'a Loaded,
    /// How long the cell runs; `None` if the run has no declared end.
    pub length: Option<Duration>,
    /// Whether the run ends when the only tasks that still run serve for ever.
    pub until_idle: bool,
    /// The only node that this launcher runs; `None` if it runs all nodes.
    pub only: Option<NodeId>,
    /// Whether all nodes run in this process, connected without sockets.
    pub in_process: bool,
    /// The command to execute for each action.
    pub actions: BTreeMap<String, Vec<String>>,
    /// How results of simulated actions change with time.
    pub ramps: Vec<Ramp>,
    /// How the datagrams of the nodes are protected. Nodes that share this process send no datagrams.
    pub keys: Keys,
    /// The TCP address at which the first node serves monitors; the other nodes take the next ports.
    pub observe: Option<SocketAddr>,
    /// The token that monitors must have at these addresses.
    pub observe_token: Option<Token>,
    /// Whether the nodes are to run under the real-time scheduler.
    pub rt: bool,
    /// Whether the kernel refuses a part of the real-time settings ([`rt::refused`](crate::rt::refused)).
    pub rt_refused: bool,
    /// The seed of the lost packets and of the durations of simulated actions.
    pub seed: u64,
    /// The share of datagrams that are dropped on purpose.
    pub loss: f64,
    /// The faults to inject, each with its time since the start of the run.
    pub faults: Vec<(Duration, Fault)>,
    /// A fault that waits for the beginning of an action; `None` if there is no such fault.
    pub moment: Option<Moment>,
    /// The path from which the file names of the nodes' recordings are made; `None` if there are no recordings.
    pub record: Option<PathBuf>,
    /// Whether a recording may replace an existing file.
    pub force: bool,
    /// Whether lines for people are kept ([`Launcher::lines`](crate::Launcher::lines)).
    pub has_lines: bool,
    /// Whether the run gets an explanation: events are kept for its [`Story`](crate::Story), and the explanation judges
    /// the tasks that abort after a fault.
    pub is_explained: bool,
}

/// How the datagrams between nodes are protected.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Keys {
    /// Keys that the launcher draws for this run. They are in memory and in the pipes to the nodes, and in no file.
    Drawn,
    /// The keys of the only node that this launcher runs, in a file of this folder.
    Folder(PathBuf),
    /// Checksums: any process that reaches a node's socket can forge them.
    Checksums,
}

/// A fault that the launcher injects some time after a task has begun an action.
#[derive(Clone, Debug)]
pub struct Moment {
    /// The task that runs the action.
    pub task: TaskId,
    /// The name of the task's action, as the cell writes it after `run`.
    pub action: String,
    /// The fault is injected at this beginning of the action, counted from 1.
    pub time: usize,
    /// The delay from the beginning of the action to the fault.
    pub after: Duration,
    /// The fault and its end, each with its time after `after`.
    pub faults: Vec<(Duration, Fault)>,
}
