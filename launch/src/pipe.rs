//! The messages between the launcher and its nodes: one JSON document per line, over pipes.

use crate::cells::Source;
use crate::checks::Change;
use crate::folds::links;
use crate::script_event::Did;
use imrs_client::keys::KeyText;
use imrs_protocol::{PortCounters, PortId, Round, TaskId};
use imrs_runtime::script::Ramp;
use imrs_wire::obs::{LinkReport, Token};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::{self, BufRead, Write};
use std::net::SocketAddr;
use std::path::PathBuf;
use zeroize::Zeroizing;

/// Room for most setups. If a buffer grows, a copy of the keys stays behind in memory. Other lines get a small
/// buffer, because erasing a large one would take longer than writing such a line.
const SETUP_BYTES: usize = 1 << 15;

/// The first line to a node: its identity and how it runs.
#[derive(Clone, PartialEq, Serialize, Deserialize)]
pub struct Setup {
    /// The cell to which the node belongs.
    pub cell: Source,
    /// The name of the node.
    pub node: String,
    /// The incarnation that starts.
    pub incarnation: u8,
    /// Whether an earlier incarnation may have taken requests (D49).
    pub restarted: bool,
    /// Whether the node counts its incarnations itself, because it is the only node that this launcher runs.
    pub counts: bool,
    /// The address of the node's socket; `None` means any free port of the loopback.
    pub bind: Option<SocketAddr>,
    /// The text of the node's key file, if the node has keys.
    pub keys: Option<KeyText>,
    /// Whether the node runs without keys, so that only checksums protect its datagrams.
    pub insecure: bool,
    /// The TCP address at which the node serves monitors.
    pub observe: Option<SocketAddr>,
    /// The token that monitors must have at that address.
    pub observe_token: Option<Token>,
    /// Whether the node runs under the real-time scheduler.
    pub rt: bool,
    /// The seed of the injected losses and of the durations of simulated actions.
    pub seed: u64,
    /// The share of outgoing datagrams that the node drops on purpose.
    pub loss: f64,
    /// The file in which the inputs of the node's communication tasks are recorded.
    pub record: Option<PathBuf>,
    /// Whether the recording may replace an existing file.
    pub force: bool,
    /// The command to execute for each action.
    pub actions: BTreeMap<String, Vec<String>>,
    /// The named pipe for notices to the launcher about commands, if there is one.
    pub notices: Option<PathBuf>,
    /// How results of simulated actions change with time.
    pub ramps: Vec<Ramp>,
}

/// Every later line to a node. When the pipe ends, the launcher has exited, and the node must stop.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Order {
    /// The addresses of nodes by name. The first such message starts the node; later messages have only changed
    /// addresses.
    Book(BTreeMap<String, SocketAddr>),
    /// The TCP addresses at which nodes serve monitors, by node name.
    Observed(BTreeMap<String, SocketAddr>),
    /// The node must stop sending to this node.
    Cut(String),
    /// The node must send to this node again.
    Heal(String),
    /// The node must stop in order, and report its final counters.
    Stop,
    /// The node must stop as after a power cut. Only for a node that shares its process with other nodes.
    Die,
}

/// A line from a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Word {
    /// The node has bound its link.
    Bound {
        /// The address of the node's socket, if it has one.
        address: Option<SocketAddr>,
        /// The TCP address at which the node serves monitors.
        observe: Option<SocketAddr>,
    },
    /// The node was restarted, and the scripts of these tasks do not begin yet: each waits for this many microseconds.
    HeldBack(Vec<(TaskId, u64)>),
    /// The node's tasks run.
    Started,
    /// Something happened at a waitfor.
    Event(Event),
    /// The node's counters since its start.
    Figures(Box<Figures>),
    /// A script did something that the event log shows.
    Did(Did),
    /// A script ended by itself.
    TaskEnded {
        /// The script's task.
        task: TaskId,
        /// How the script ended, in words for people.
        how: String,
        /// How the end of the script counts for the verdict.
        sort: EndSort,
    },
    /// Values of a task have changed that checks read.
    Stands(Change),
    /// The node has reported everything before this instant, in microseconds of the clock that all processes share.
    Told(u64),
    /// The node dropped script events, because the launcher did not read its pipe fast enough.
    Untold {
        /// When the first dropped event happened, in microseconds of the clock that all processes share.
        since: u64,
    },
    /// The last message: the node has reported everything.
    Done,
}

/// How the end of a script counts for the verdict.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EndSort {
    /// The script finished, or lost its lease.
    Well,
    /// The script aborted.
    Aborted,
    /// An assertion of the script failed, or a statement could not be executed.
    Failed,
}

/// An event of one task at a waitfor (a rendezvous of tasks).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Event {
    /// The instant of the event, in microseconds of the boot-time clock that all processes of one machine share.
    pub at: u64,
    /// The task of the event.
    pub task: TaskId,
    /// The port of the waitfor.
    pub port: PortId,
    /// The round of the rendezvous.
    pub round: Round,
    /// What happened to the task at the waitfor.
    pub what: What,
}

/// What happened to a task at a waitfor (a rendezvous of tasks).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum What {
    /// The task's arrival in this round was announced.
    Announced,
    /// All members of the rendezvous had arrived, and the task goes on.
    Released,
    /// The task's time_out ended before all members had arrived.
    GaveUp {
        /// How long the task had waited, in microseconds.
        waited: u64,
        /// A bit mask: bit `i` says that party `i` of the port (the owner is party 0) had not arrived.
        missing: u64,
    },
}

/// Counters of a node since its start.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Counters of each port of each task.
    pub ports: Vec<(TaskId, PortId, PortCounters)>,
    /// How the class-2 messages of the node's tasks ended.
    pub outcomes: Outcomes,
    /// How many packets and messages the node's state machines dropped, by reason.
    pub discards: BTreeMap<String, u64>,
    /// How many packets the node's link dropped, by reason.
    pub link_discards: BTreeMap<String, u64>,
    /// Other counters of the node's link.
    pub link: BTreeMap<String, u64>,
    /// How many packets left through the node's transit buffer: its own, and those that it relayed.
    pub forwarded: u64,
    /// How many packets the node's link dropped on purpose, as a random loss.
    pub lost_on_purpose: u64,
    /// How many packets the node's link dropped because of a cut.
    pub cut_off: u64,
    /// How long datagrams took on the node's links, and how many were damaged.
    pub links: Vec<LinkReport>,
    /// The neighbours whose datagrams the node refuses, because their cells, keys or versions differ.
    pub refusals: Vec<RefusalFigures>,
    /// How many events were not reported: they came too fast, or the launcher did not read its pipe fast enough.
    pub untold: u64,
    /// What the node's recording lacks, in words for people.
    pub unrecorded: Vec<String>,
}

/// A neighbour whose cell, keys or version differ, so that the two nodes do not communicate. Digests are hexadecimal.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RefusalFigures {
    /// The neighbour whose datagrams the node refused.
    pub neighbour: String,
    /// `other_cell`, `other_statements`, `other_keys`, `other_mode` or `other_version`.
    pub reason: String,
    /// This node's digest, which differs from the neighbour's.
    pub ours: String,
    /// The neighbour's digest.
    pub theirs: String,
}

impl RefusalFigures {
    /// The refusal as text for people.
    pub fn words(&self, node: &str) -> String {
        let Self { neighbour, reason, ours, theirs } = self;
        let what = match reason.as_str() {
            "other_keys" => {
                return format!(
                    "node {node} and node {neighbour} do not talk: their keys differ; give both the files of one `imrs keygen`"
                );
            }
            "other_mode" => {
                return format!(
                    "node {node} and node {neighbour} do not talk: one of them has keys and the other has none; start both with keys (`imrs keygen`), or both with --insecure"
                );
            }
            "other_version" => {
                return format!(
                    "node {node} and node {neighbour} do not talk: their programs have different versions of the protocol between nodes; run the same version of imrs on both"
                );
            }
            "other_cell" => "declarations",
            _ => "statements",
        };
        format!(
            "node {node} and node {neighbour} do not talk: their {what} differ (digest {ours} here, {theirs} there); run the same cell file on both"
        )
    }
}

/// How class-2 messages ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Outcomes {
    /// How many commands were answered.
    pub replies: u64,
    /// How many commands were refused, because there was no room.
    pub refused: u64,
    /// How many commands timed out before any copy left the node.
    pub timed_out_unsent: u64,
    /// How many commands timed out after a copy left the node: they may have run.
    pub timed_out_unknown: u64,
    /// How many commands ended because the receiver's node restarted before it answered: they may have run.
    pub peer_restarted: u64,
}

impl std::ops::AddAssign for Outcomes {
    fn add_assign(&mut self, other: Self) {
        self.replies += other.replies;
        self.refused += other.refused;
        self.timed_out_unsent += other.timed_out_unsent;
        self.timed_out_unknown += other.timed_out_unknown;
        self.peer_restarted += other.peer_restarted;
    }
}

impl Figures {
    /// Adds the counters of another incarnation of the same node.
    pub fn add(&mut self, other: &Self) {
        self.ports.extend_from_slice(&other.ports);
        self.outcomes += other.outcomes;
        let maps = [
            (&mut self.discards, &other.discards),
            (&mut self.link_discards, &other.link_discards),
            (&mut self.link, &other.link),
        ];
        for (sum, more) in maps {
            for (name, count) in more {
                *sum.entry(name.clone()).or_default() += count;
            }
        }
        self.forwarded += other.forwarded;
        self.lost_on_purpose += other.lost_on_purpose;
        self.cut_off += other.cut_off;
        self.untold += other.untold;
        self.unrecorded.extend_from_slice(&other.unrecorded);
        links::join(&mut self.links, &other.links);
        self.refusals.clone_from(&other.refusals);
    }
}

/// Writes a value as one line.
///
/// # Errors
/// An error if the pipe failed: most likely the other process has exited.
pub fn say(pipe: &mut impl Write, line: &impl Serialize) -> io::Result<()> {
    write_line(pipe, line, &mut Vec::new())
}

/// Writes a setup, which may contain keys, as one line. The written bytes are then erased from memory.
///
/// # Errors
/// The errors of [`say`].
pub fn say_setup(pipe: &mut impl Write, setup: &Setup) -> io::Result<()> {
    write_line(pipe, setup, &mut Zeroizing::new(Vec::with_capacity(SETUP_BYTES)))
}

fn write_line(pipe: &mut impl Write, line: &impl Serialize, text: &mut Vec<u8>) -> io::Result<()> {
    serde_json::to_writer(&mut *text, line)?;
    text.push(b'\n');
    pipe.write_all(text)?;
    pipe.flush()
}

/// Reads one line; `None` at the end of the pipe. An unfinished last line counts as the end, because it comes from a
/// killed process.
///
/// # Errors
/// An error if the pipe failed, or the line cannot be parsed.
pub fn hear<T: for<'de> Deserialize<'de>>(pipe: &mut impl BufRead) -> io::Result<Option<T>> {
    read_line(pipe, &mut String::new())
}

/// Reads a setup as [`hear`] does. The bytes that were read are then erased from memory.
///
/// # Errors
/// The errors of [`hear`].
pub fn hear_setup(pipe: &mut impl BufRead) -> io::Result<Option<Setup>> {
    read_line(pipe, &mut Zeroizing::new(String::with_capacity(SETUP_BYTES)))
}

fn read_line<T: for<'de> Deserialize<'de>>(
    pipe: &mut impl BufRead,
    text: &mut String,
) -> io::Result<Option<T>> {
    pipe.read_line(text)?;
    if !text.ends_with('\n') {
        return Ok(None);
    }
    Ok(Some(serde_json::from_str(text)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_a_killed_process_left_unfinished_is_the_end() {
        let mut pipe = Vec::new();
        let event = Event { at: 7, task: TaskId(1), port: PortId(0), round: Round(3), what: What::Released };
        say(&mut pipe, &Word::Event(event)).unwrap();
        let whole = pipe.len();
        say(&mut pipe, &Word::Started).unwrap();
        for cut in whole..pipe.len() - 1 {
            let mut reader = &pipe[..cut];
            assert_eq!(hear(&mut reader).unwrap(), Some(Word::Event(event)));
            assert_eq!(hear::<Word>(&mut reader).unwrap(), None);
        }
        assert!(hear::<Word>(&mut &b"garbage\n"[..]).is_err());
    }
}
