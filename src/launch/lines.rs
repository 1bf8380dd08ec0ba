//! What the launcher and the nodes say to each other: one JSON document per line, over the pipes between them.

use super::deed::Did;
use crate::cells::Source;
use crate::checks::Change;
use imrs_protocol::{PortCounters, PortId, Round, TaskId};
use imrs_runtime::script::Course;
use imrs_wire::obs::Token;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::{self, BufRead, Write};
use std::net::SocketAddr;
use std::path::PathBuf;

/// The first line to a node: who it is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Setup {
    /// The cell.
    pub cell: Source,
    /// The name of the node.
    pub node: String,
    /// Which incarnation of the node this is.
    pub incarnation: u8,
    /// Whether an earlier one may have taken requests (D49).
    pub restarted: bool,
    /// Whether the node counts its incarnations itself: it is the only one that this launcher runs.
    pub counts: bool,
    /// Where its socket is; any free port of the loopback where nothing is said.
    pub bind: Option<SocketAddr>,
    /// Where it serves monitors over TCP.
    pub observe: Option<SocketAddr>,
    /// What monitors must show it there.
    pub observe_token: Option<Token>,
    /// Whether it runs under the real-time scheduler.
    pub rt: bool,
    /// Seeds the injected loss and the lengths of the tasks' work.
    pub seed: u64,
    /// The share of its datagrams that the node loses on purpose.
    pub loss: f64,
    /// The file for what goes into the node's communication tasks.
    pub record: Option<PathBuf>,
    /// Whether that file replaces one of its name.
    pub force: bool,
    /// By action, the command to execute for it.
    pub actions: BTreeMap<String, Vec<String>>,
    /// The pipe in which the launcher is told of commands; where there are any.
    pub notices: Option<PathBuf>,
    /// What simulated actions give as time goes on.
    pub courses: Vec<Course>,
}

/// Every later line to a node. The end of the pipe is the end of the launcher, and of the node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Order {
    /// The address book: by the name of the node. With the first one the node starts; a later one says what is new.
    Book(BTreeMap<String, SocketAddr>),
    /// Where the nodes serve monitors over TCP: by the name of the node.
    Observed(BTreeMap<String, SocketAddr>),
    /// From now on, sends nothing to this node.
    Cut(String),
    /// Sends to it again.
    Heal(String),
    /// Stop, and say how it went.
    Stop,
    /// Be gone, as after a power cut: for a node that shares its process with others.
    Die,
}

/// A line from a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Word {
    /// The node has its way to the others.
    Bound {
        /// Its socket, if it has a process of its own.
        address: Option<SocketAddr>,
        /// Where it serves monitors over TCP.
        observe: Option<SocketAddr>,
    },
    /// The scripts of these tasks begin only after so many microseconds: the node was restarted.
    HeldBack(Vec<(TaskId, u64)>),
    /// The node's tasks run.
    Started,
    /// Something happened at a waitfor.
    Event(Event),
    /// The node's figures since its start.
    Figures(Box<Figures>),
    /// A script did something worth a line.
    Did(Did),
    /// A script ended by itself.
    TaskEnded {
        /// Its task.
        task: TaskId,
        /// How, in words.
        how: String,
        /// What to think of it.
        sort: EndSort,
    },
    /// What checks ask of a task has changed.
    Stands(Change),
    /// Everything that was before this instant has been told, in microseconds of the clock that all processes share.
    Told(u64),
    /// The node could not keep everything that its scripts did from this instant on, because the launcher did not read.
    Untold {
        /// In microseconds of the clock that all processes share.
        since: u64,
    },
    /// Everything has been said.
    Done,
}

/// What to think of the end of a script.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EndSort {
    /// It came to its end, or lost its lease.
    Well,
    /// It gave up, as its text says.
    Aborted,
    /// It did what must not be.
    Failed,
}

/// Something that happened at a waitfor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Event {
    /// When, on the monotonic clock that all processes of one machine share, in microseconds.
    pub at: u64,
    /// To which task.
    pub task: TaskId,
    /// On which port.
    pub port: PortId,
    /// In which round.
    pub round: Round,
    /// What.
    pub what: What,
}

/// What happened at a waitfor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum What {
    /// The task's arrival in this round was announced.
    Announced,
    /// The task runs on.
    Released,
    /// The task's time_out ended first.
    GaveUp {
        /// How long it waited, in microseconds.
        waited: u64,
        /// Bit `i`: party `i` of the port (owner first) had not arrived.
        missing: u64,
    },
}

/// What a node has counted since its start.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// By task and port.
    pub ports: Vec<(TaskId, PortId, PortCounters)>,
    /// How the class-2 messages of its tasks ended.
    pub outcomes: Outcomes,
    /// What its machines dropped, by reason.
    pub discards: BTreeMap<String, u64>,
    /// What its link dropped, by reason.
    pub link_discards: BTreeMap<String, u64>,
    /// What its link counted besides.
    pub link: BTreeMap<String, u64>,
    /// Packets that left by its transit buffer: its own and those that it relayed.
    pub forwarded: u64,
    /// Packets that its link lost on purpose.
    pub lost_on_purpose: u64,
    /// Packets that its link held back because of a cut.
    pub cut_off: u64,
    /// The neighbours that it cannot talk to at the end.
    pub refusals: Vec<RefusalFigures>,
    /// What happened and could not be told: it came too fast, or the launcher did not read.
    pub untold: u64,
    /// What its recording misses, in words.
    pub unrecorded: Vec<String>,
}

/// A neighbour that a node cannot talk to, because their cells differ. Digests in hexadecimal digits.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RefusalFigures {
    /// The neighbour.
    pub neighbour: String,
    /// `other_cell` or `other_statements`.
    pub reason: String,
    /// The digest that differs, of this node.
    pub ours: String,
    /// The same of the neighbour.
    pub theirs: String,
}

impl RefusalFigures {
    /// What a person should know.
    pub fn words(&self, node: &str) -> String {
        let Self { neighbour, reason, ours, theirs } = self;
        let what = if reason == "other_cell" { "declarations" } else { "statements" };
        format!(
            "node {node} and node {neighbour} do not talk: their {what} differ (digest {ours} here, {theirs} there); run the same cell file on both"
        )
    }
}

/// How class-2 messages ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Outcomes {
    /// Answered.
    pub replies: u64,
    /// Refused for space.
    pub refused: u64,
    /// Timed out before any copy left.
    pub timed_out_unsent: u64,
    /// Timed out; they may have run.
    pub timed_out_unknown: u64,
    /// The peer restarted meanwhile; they may have run.
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
    /// Adds those of another incarnation of the node.
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
        self.refusals.clone_from(&other.refusals);
    }
}

/// Writes a line.
///
/// # Errors
/// The pipe's: most likely the other side has gone.
pub fn say(pipe: &mut impl Write, line: &impl Serialize) -> io::Result<()> {
    let mut text = serde_json::to_vec(line)?;
    text.push(b'\n');
    pipe.write_all(&text)?;
    pipe.flush()
}

/// Reads a line; `None` at the end of the pipe. A last line without an end, of a process that was killed, is the end.
///
/// # Errors
/// The pipe's, or a line that is not one of these.
pub fn hear<T: for<'de> Deserialize<'de>>(pipe: &mut impl BufRead) -> io::Result<Option<T>> {
    let mut text = String::new();
    pipe.read_line(&mut text)?;
    if !text.ends_with('\n') {
        return Ok(None);
    }
    Ok(Some(serde_json::from_str(&text)?))
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
