//! The summary of a run: the contract of `--format json`.

use super::rounds::Rounds;
use crate::checks::Settlement;
use crate::pipe::{Outcomes, RefusalFigures};
use serde::Serialize;
use std::collections::BTreeMap;

/// The summary of a run: the contract of `--format json`.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// The version of this JSON format.
    pub version: u32,
    /// The name of the cell that ran.
    pub cell: String,
    /// How long the tasks ran.
    pub seconds: f64,
    /// The seed of the injected losses and of the durations of simulated actions.
    pub seed: u64,
    /// The share of datagrams that were dropped on purpose.
    pub loss: f64,
    /// The ports, each summed over all its ends.
    pub ports: Vec<PortSummary>,
    /// The figures of each `waitfor`.
    pub rendezvous: Vec<RendezvousSummary>,
    /// How the class-2 messages of the tasks ended.
    pub commands: Outcomes,
    /// The tasks that gave up because a node was killed: for each kill, the first time_out of each task that waited for a
    /// task there.
    pub after_kill: Vec<AfterKill>,
    /// The scripts that ended by themselves.
    pub tasks: Vec<TaskSummary>,
    /// The nodes that ran here.
    pub nodes: Vec<NodeSummary>,
    /// The verdicts on the checks of the cell.
    pub checks: Settlement,
    /// Missing evidence, one line each. Without findings, such a run proves nothing about what is missing.
    pub incomplete: Vec<String>,
    /// Whether the nodes ran under the real-time scheduler: asked for with `--rt`, and not refused.
    pub rt: bool,
    /// The outcome of a demo.
    pub outcome: Option<Outcome>,
}

/// A script that ended by itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct TaskSummary {
    /// The name of the script's task.
    pub name: String,
    /// How the script ended.
    pub end: String,
}

/// One port, summed over all its ends.
#[derive(Clone, Debug, Serialize)]
pub struct PortSummary {
    /// The port's name.
    pub name: String,
    /// What the owner does with the port.
    pub usage: &'static str,
    /// Messages sent; of a waitfor, arrivals.
    pub sent: u64,
    /// Copies sent again.
    pub resent: u64,
    /// Messages delivered at the receiving ends; of a waitfor, releases.
    pub delivered: u64,
    /// Messages whose TTL ended in a buffer or on a link.
    pub expired: u64,
    /// Messages refused, because there was no space.
    pub refused: u64,
    /// Requests that ended by time_out.
    pub timed_out: u64,
    /// Received copies of messages that had come before.
    pub duplicates: u64,
}

/// One waitfor.
#[derive(Clone, Debug, Serialize)]
pub struct RendezvousSummary {
    /// The name of the waitfor's port.
    pub port: String,
    /// The outcomes of the waitfor's rounds.
    #[serde(flatten)]
    pub rounds: Rounds,
    /// Releases before all members had arrived. `None` if only some nodes ran here, because arrivals elsewhere are not
    /// known.
    pub false_releases: Option<u64>,
}

/// A task that gave up because a node was killed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct AfterKill {
    /// The killed node.
    pub killed: String,
    /// The task that waited for a task on the killed node.
    pub task: String,
    /// How long the task had waited, in microseconds: its time_out plus the lateness of this machine.
    pub waited_us: u64,
    /// The time_out, in microseconds.
    pub time_out_us: u64,
    /// The time from the kill to the instant at which the task gave up, in microseconds.
    pub after_kill_us: u64,
}

/// One node.
#[derive(Clone, Debug, Serialize)]
pub struct NodeSummary {
    /// The node's name.
    pub name: String,
    /// How the node's process ended: `clean`, `killed` by the launcher, or what went wrong.
    pub exit: String,
    /// The number of the node's incarnations in this run: 1 plus one per restart.
    #[serde(rename = "lives")]
    pub incarnations: usize,
    /// Packets that the node sent over links: its own, and those that it relayed.
    pub forwarded: u64,
    /// Packets and messages that the node's state machines dropped, by reason.
    pub discards: BTreeMap<String, u64>,
    /// Packets that the node's link dropped, by reason.
    pub link_discards: BTreeMap<String, u64>,
    /// Other counters of the node's link.
    pub link: BTreeMap<String, u64>,
    /// The neighbours that the node refused at the end, because their cells differ.
    pub refusals: Vec<RefusalFigures>,
    /// Packets that the node's link dropped on purpose.
    pub lost_on_purpose: u64,
    /// Packets that the node's link dropped because of a cut.
    pub cut_off: u64,
}

/// The outcome of a demo.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Outcome {
    /// Whether the demo's promise was kept; `None` if it was not put to the test.
    pub held: Option<bool>,
    /// What happened in the demo, in sentences.
    pub words: Vec<String>,
}
