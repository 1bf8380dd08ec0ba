//! The summary of a run, in the form that `--format json` prints and keeps stable.

use super::links::SecuritySummary;
use super::rounds::Rounds;
use crate::checks::Settlement;
use crate::pipe::{Outcomes, RefusalFigures};
use imrs_wire::obs::LinkSummary;
use serde::Serialize;
use std::collections::BTreeMap;

/// The summary of a run, in the form that `--format json` prints and keeps stable.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// The version of this JSON format.
    pub version: u32,
    /// The name of the cell that ran.
    pub cell: String,
    /// How long the tasks ran, in seconds.
    pub seconds: f64,
    /// The seed of the injected losses and of the durations of simulated actions.
    pub seed: u64,
    /// The share of datagrams that were dropped on purpose.
    pub loss: f64,
    /// The ports, each summed over all its ends.
    pub ports: Vec<PortSummary>,
    /// The results of each `waitfor`.
    pub rendezvous: Vec<RendezvousSummary>,
    /// How the class-2 messages of the tasks ended.
    pub commands: Outcomes,
    /// The tasks that gave up because a node was killed: for each kill, the first time_out of each task that waited for
    /// a task on the killed node.
    pub after_kill: Vec<AfterKill>,
    /// The scripts that ended by themselves.
    pub tasks: Vec<TaskSummary>,
    /// The nodes that this launcher ran.
    pub nodes: Vec<NodeSummary>,
    /// The verdicts on the checks of the cell.
    pub checks: Settlement,
    /// What the run could not observe, one line each. If there are such lines, a run without findings proves nothing
    /// about these parts.
    pub incomplete: Vec<String>,
    /// Whether the nodes ran under the real-time scheduler: `--rt` asked for it, and the kernel did not refuse.
    pub rt: bool,
    /// The outcome of a demo; `None` for any other run.
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
    /// How many messages were sent; of a waitfor, how many arrivals.
    pub sent: u64,
    /// How many copies were sent again.
    pub resent: u64,
    /// How many messages were delivered at the receiving ends; of a waitfor, how many releases.
    pub delivered: u64,
    /// How many messages expired in a buffer or on a link.
    pub expired: u64,
    /// How many messages were refused, because there was no room.
    pub refused: u64,
    /// How many requests ended by time_out.
    pub timed_out: u64,
    /// How many received messages were copies of messages that had arrived before.
    pub duplicates: u64,
}

/// The results of one waitfor.
#[derive(Clone, Debug, Serialize)]
pub struct RendezvousSummary {
    /// The name of the waitfor's port.
    pub port: String,
    /// The outcomes of the waitfor's rounds.
    #[serde(flatten)]
    pub rounds: Rounds,
    /// How many releases came before all members had arrived. `None` if only some nodes ran here, because arrivals on
    /// other nodes are not known.
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
    /// The time_out of the waitfor, in microseconds.
    pub time_out_us: u64,
    /// The time from the kill to the instant at which the task gave up, in microseconds.
    pub after_kill_us: u64,
}

/// The results of one node.
#[derive(Clone, Debug, Serialize)]
pub struct NodeSummary {
    /// The node's name.
    pub name: String,
    /// How the node's process ended: `clean`, `killed` by the launcher, or what went wrong.
    pub exit: String,
    /// The number of the node's incarnations in this run: 1 plus one per restart.
    #[serde(rename = "lives")]
    pub incarnations: usize,
    /// How many packets the node sent over links: its own, and those that it relayed.
    pub forwarded: u64,
    /// How many packets and messages the node's state machines dropped, by reason.
    pub discards: BTreeMap<String, u64>,
    /// How many packets the node's link dropped, by reason.
    pub link_discards: BTreeMap<String, u64>,
    /// Other counters of the node's link.
    pub link: BTreeMap<String, u64>,
    /// The links from the node's neighbours, as this node measured them; empty if nodes are joined without sockets.
    pub links: Vec<LinkSummary>,
    /// The datagrams that the node dropped, and that no node of the cell sent in this form.
    pub security: SecuritySummary,
    /// The neighbours that the node refused at the end of the run, because their cells differ.
    pub refusals: Vec<RefusalFigures>,
    /// How many packets the node's link dropped on purpose, as a random loss.
    pub lost_on_purpose: u64,
    /// How many packets the node's link dropped because of a cut.
    pub cut_off: u64,
}

impl NodeSummary {
    /// Whether a link to this node was faulty, or too many datagrams came that no node of the cell sent.
    #[must_use]
    pub fn is_suspect(&self) -> bool {
        self.security.alarms > 0 || self.links.iter().any(|link| link.integrity.faults > 0)
    }
}

/// The outcome of a demo.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Outcome {
    /// Whether the demo's promise was kept; `None` if the run did not test it.
    pub held: Option<bool>,
    /// What happened in the demo, in sentences.
    pub words: Vec<String>,
}
