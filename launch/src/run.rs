//! The description of a run: which cell, which nodes, how long, and with what.

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
    /// How long the cell runs; none: without end.
    pub length: Option<Duration>,
    /// Whether the run ends when only tasks are left that serve for ever.
    pub until_idle: bool,
    /// The only node that runs here; none: all nodes.
    pub only: Option<NodeId>,
    /// Whether all nodes run in this process, joined without sockets.
    pub in_process: bool,
    /// The command to execute for each action.
    pub actions: BTreeMap<String, Vec<String>>,
    /// How results of simulated actions change with time.
    pub ramps: Vec<Ramp>,
    /// What closes the datagrams of the nodes. Nodes that share this process send none.
    pub keys: Keys,
    /// The TCP address at which the first node serves monitors; the others take the next ports.
    pub observe: Option<SocketAddr>,
    /// The token that monitors must present there.
    pub observe_token: Option<Token>,
    /// Whether the nodes are to run under the real-time scheduler.
    pub rt: bool,
    /// Whether the kernel refuses a part of the real-time settings ([`rt::refused`](crate::rt::refused)).
    pub rt_refused: bool,
    /// The seed of the lost packets and of the durations of simulated actions.
    pub seed: u64,
    /// The share of datagrams that are dropped on purpose.
    pub loss: f64,
    /// The faults to inject, by their time since the start.
    pub faults: Vec<(Duration, Fault)>,
    /// A fault that waits for an action to begin; none if there is no such fault.
    pub moment: Option<Moment>,
    /// The path from which the file name of each node's recording is made; none: no recordings.
    pub record: Option<PathBuf>,
    /// Whether a recording may replace an existing file.
    pub force: bool,
    /// Whether lines for people are kept ([`Launcher::lines`](crate::Launcher::lines)).
    pub has_lines: bool,
    /// Whether the run gets an explanation: events are kept for its [`Story`](crate::Story), and it judges the tasks that abort
    /// after a fault.
    pub is_explained: bool,
}

/// What closes the datagrams between nodes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Keys {
    /// Keys that the launcher draws for this run. They are in memory and in the pipes to the nodes, and in no file.
    Drawn,
    /// Those of the only node that runs here, in a file of this folder.
    Folder(PathBuf),
    /// Checksums: any process that reaches a node's socket can forge them.
    Checksums,
}

/// A fault that is injected when a task has begun an action for the given time.
#[derive(Clone, Debug)]
pub struct Moment {
    /// The task that runs the action.
    pub task: TaskId,
    /// The name of the task's action, as after `run`.
    pub action: String,
    /// At which beginning of the action the fault comes, counted from 1.
    pub time: usize,
    /// The delay from the beginning of the action to the fault.
    pub after: Duration,
    /// The fault and its end, each with its time after that delay.
    pub faults: Vec<(Duration, Fault)>,
}
