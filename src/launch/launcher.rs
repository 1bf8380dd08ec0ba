//! Runs a cell: one process per node, faults on time, and a summary at the end.

use super::children::{Children, Message};
use super::clock::now_us;
use super::deed::Did;
use super::diary::Diary;
use super::faults::{Fault, FaultError, Wanted, schedule};
use super::lines::{Order, Setup, Word};
use super::noticed::Noticed;
use super::place::{self, PlaceError};
use super::report;
use super::rt;
use super::story::{Moment, Story, Tale};
use super::summary::{Gatherer, Summary};
use crate::args::{Format, LaunchArgs};
use crate::cells::{Loaded, Source};
use crate::checks::Judge;
use crate::exit::{Exit, Failure};
use crate::output::{Output, complain};
use imrs_protocol::{Cell, CellTable, NodeId, TaskId};
use imrs_runtime::link::in_process::{self, Network};
use imrs_runtime::script::Course;
use imrs_wire::obs::Token;
use serde::Serialize;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

/// How long the nodes have to get ready.
const READY_WITHIN: Duration = Duration::from_secs(20);
/// How long they have to stop.
const STOP_WITHIN: Duration = Duration::from_secs(5);
/// How long after its last word a process has to end.
const EXIT_WITHIN: Duration = Duration::from_secs(1);

/// Why a cell could not be run.
#[derive(Debug, thiserror::Error)]
pub enum LaunchError {
    /// The faults do not fit the cell or the run.
    #[error(transparent)]
    Fault(#[from] FaultError),
    /// A process or thread cannot be started.
    #[error("cannot start the nodes: {0}")]
    Start(#[source] io::Error),
    /// A node did not get ready.
    #[error("node `{name}` did not get ready")]
    NotReady {
        /// Its name.
        name: String,
        /// Whether it said that it was asked for what cannot be had.
        refused: bool,
    },
    /// The node cannot run by itself.
    #[error(transparent)]
    Place(#[from] PlaceError),
}

impl LaunchError {
    /// The exit code it leads to.
    pub fn exit(&self) -> Exit {
        match self {
            Self::Fault(_) | Self::Place(_) | Self::NotReady { refused: true, .. } => Exit::Usage,
            Self::Start(_) | Self::NotReady { refused: false, .. } => Exit::Internal,
        }
    }
}

/// The first line of `--format json`: what runs where.
#[derive(Serialize)]
struct Started<'a> {
    version: u32,
    started: Vec<StartedNode<'a>>,
}

/// A node that runs.
#[derive(Clone, Debug, Serialize)]
pub struct StartedNode<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its tasks.
    pub tasks: Vec<&'a str>,
    /// Its process.
    pub pid: u32,
    /// Its socket, if it has one.
    pub address: Option<SocketAddr>,
    /// Where it serves monitors over TCP.
    pub observe: Option<SocketAddr>,
}

/// What is run, and how.
pub struct Run<'a> {
    /// Where the cell comes from.
    pub source: Source,
    /// The cell.
    pub loaded: &'a Loaded,
    /// How it is run.
    pub args: &'a LaunchArgs,
    /// How long; without end where there is none.
    pub length: Option<Duration>,
    /// By action, the command to execute for it.
    pub actions: BTreeMap<String, Vec<String>>,
    /// What simulated actions give as time goes on.
    pub courses: Vec<Course>,
    /// The only node that is run here, in place of all.
    pub only: Option<NodeId>,
    /// What a demo adds.
    pub tale: Option<Tale>,
}

pub(super) struct Launcher<'a> {
    pub(super) run: &'a Run<'a>,
    /// Whether the nodes are in real time: asked for, and not refused.
    real_time: bool,
    pub(super) cell: &'a Cell,
    pub(super) setups: Vec<(NodeId, Setup)>,
    pub(super) diary: Diary,
    /// Scripts that ended by themselves.
    pub(super) ended: Vec<TaskId>,
    pub(super) children: Children,
    pub(super) messages: Receiver<Message>,
    pub(super) gatherer: Gatherer,
    pub(super) judge: Judge<'a>,
    /// What is heard of commands, where there are any.
    pub(super) noticed: Option<Noticed>,
    /// What nodes said before all had started.
    pub(super) early: Vec<Message>,
    /// Nodes whose pipe has ended.
    pub(super) gone: Vec<NodeId>,
    /// The addresses of the nodes.
    pub(super) book: BTreeMap<String, SocketAddr>,
    /// Where they serve monitors over TCP.
    pub(super) observed: BTreeMap<String, SocketAddr>,
    /// Faults to come, by their time since the start.
    pub(super) faults: Vec<(Duration, Fault)>,
    /// Faults that came, on the common clock.
    pub(super) came: Vec<(u64, Fault)>,
    /// The fault that waits for the cell to come to a certain point, and how often it has been there.
    pub(super) moment: Option<(&'static Moment, usize)>,
    /// What the scripts did, where a story is told.
    pub(super) deeds: Vec<Did>,
    pub(super) started: Instant,
    pub(super) trouble: Vec<Trouble>,
    /// What was said of neighbours that do not talk.
    pub(super) refused: BTreeSet<String>,
    pub(super) stopping: bool,
    pub(super) interrupted: bool,
}

/// A length that no run reaches.
const WITHOUT_END: Duration = Duration::from_secs(u32::MAX as u64);

/// Runs a cell.
///
/// # Errors
/// [`Failure`].
pub fn run(run: &Run<'_>, out: &mut Output) -> Result<Exit, Failure> {
    let (args, table) = (run.args, &run.loaded.table);
    let cell = table.cell();
    let length = run.length.unwrap_or(WITHOUT_END);
    let wanted = Wanted { kill: &args.kill, restart: &args.restart, cut: &args.cut };
    let faults = schedule(cell, length, &wanted).map_err(LaunchError::Fault)?;
    if let Some(only) = run.only {
        here(cell, only, &faults).map_err(LaunchError::Fault)?;
    }
    let refused = if args.rt { rt::refused() } else { Vec::new() };
    for refused in &refused {
        complain(format_args!("{refused}; the nodes run without it"));
    }
    let seed = args.seed.unwrap_or_else(|| fastrand::u64(..1_000_000));

    let (sender, messages) = mpsc::channel();
    watch_signals(sender.clone())?;
    let network = args.in_process.then(|| Network::new(Arc::clone(table), in_process::Faults::default()));
    let token = args.observe_token.as_deref().map(crate::token::read).transpose()?;
    let noticed = (!run.actions.is_empty()).then(Noticed::new).transpose().map_err(LaunchError::Start)?;
    let setups = setups(run, seed, token.as_ref(), noticed.as_ref().map(Noticed::path))?;
    let children = Children::start(&setups, network, sender)?;
    let here: Vec<NodeId> = children.nodes().collect();
    let judge = Judge::new(run.loaded, &here);
    let gatherer = Gatherer::new(Arc::clone(table), here);
    let book = run.only.map(|only| place::neighbours(run.loaded, only)).transpose();
    let mut launcher = Launcher {
        run,
        real_time: args.rt && refused.is_empty(),
        cell,
        setups,
        diary: Diary::new(cell, now_us()),
        ended: Vec::new(),
        children,
        messages,
        gatherer,
        judge,
        noticed,
        early: Vec::new(),
        gone: Vec::new(),
        book: book.map_err(LaunchError::Place)?.unwrap_or_default(),
        observed: BTreeMap::new(),
        faults,
        came: Vec::new(),
        moment: run.tale.and_then(|tale| tale.moment).map(|moment| (moment, 0)),
        deeds: Vec::new(),
        started: Instant::now(),
        trouble: Vec::new(),
        refused: BTreeSet::new(),
        stopping: false,
        interrupted: false,
    };
    let bound = launcher.wait_for_all(|word| match word {
        Word::Bound { address, observe } => Some((address, observe)),
        _ => None,
    })?;
    let addresses = bound.iter().filter_map(|(node, (at, _))| Some((launcher.name(*node), (*at)?)));
    let addresses: Vec<_> = addresses.collect();
    launcher.book.extend(addresses);
    let book = Order::Book(launcher.book.clone());
    launcher.children.order_all(&book);
    for (&node, &(_, observe)) in &bound {
        launcher.observed.extend(observe.map(|address| (launcher.name(node), address)));
    }
    launcher.tell_observed();
    launcher.diary.begin(now_us());
    launcher.wait_for_all(|word| matches!(word, Word::Started).then_some(()))?;

    launcher.started = Instant::now();
    launcher.announce(seed, &bound, out)?;
    launcher.follow(length, out)?;
    let seconds = launcher.started.elapsed().as_secs_f64();
    let (summary, trouble) = launcher.finish(seconds, seed);
    match args.format {
        Format::Json => out.json(&summary)?,
        Format::Text => report::summary(&summary, table, run, out)?,
    }
    for trouble in &trouble {
        complain(&trouble.what);
    }
    Ok(verdict(&summary, &trouble))
}

/// Whether the faults are of this node.
fn here(cell: &Cell, only: NodeId, faults: &[(Duration, Fault)]) -> Result<(), FaultError> {
    for (_, fault) in faults {
        match *fault {
            Fault::Kill(node) | Fault::Restart(node) | Fault::Pause(node) | Fault::Resume(node)
                if node != only =>
            {
                return Err(FaultError::NotHere(cell.nodes[node.index()].name.clone()));
            }
            Fault::Cut(a, b) | Fault::Heal(a, b) if a != only && b != only => {
                return Err(FaultError::NotHere(cell.nodes[a.index()].name.clone()));
            }
            Fault::Kill(_)
            | Fault::Restart(_)
            | Fault::Cut(..)
            | Fault::Heal(..)
            | Fault::Pause(_)
            | Fault::Resume(_) => {}
        }
    }
    Ok(())
}

const fn resumed(fault: Fault) -> Option<NodeId> {
    match fault {
        Fault::Resume(node) => Some(node),
        Fault::Kill(_) | Fault::Restart(_) | Fault::Cut(..) | Fault::Heal(..) | Fault::Pause(_) => None,
    }
}

/// Something that no run should have, besides what is in its summary.
pub(super) struct Trouble {
    /// Whether it is this program's fault; otherwise somebody interfered.
    pub(super) at_fault: bool,
    pub(super) what: String,
}

/// Broken promises are a finding, and so is a node that somebody else ended. What faults do to a run is not.
fn verdict(summary: &Summary, trouble: &[Trouble]) -> Exit {
    let false_release = summary.rendezvous.iter().any(|r| r.false_releases.is_some_and(|n| n > 0));
    let broken = summary.outcome.as_ref().is_some_and(|outcome| outcome.held == Some(false))
        || summary.checks.is_broken();
    if trouble.iter().any(|t| t.at_fault) {
        Exit::Internal
    } else if false_release || broken || !trouble.is_empty() {
        Exit::Finding
    } else {
        Exit::Well
    }
}

fn setups(
    run: &Run<'_>,
    seed: u64,
    token: Option<&Token>,
    notices: Option<&Path>,
) -> Result<Vec<(NodeId, Setup)>, LaunchError> {
    let cell = run.loaded.table.cell();
    let mut all = Vec::new();
    for (i, node) in cell.nodes.iter().enumerate() {
        let id = NodeId::from_index(i);
        if run.only.is_some_and(|only| only != id) {
            continue;
        }
        let mut setup = Setup {
            cell: run.source.clone(),
            node: node.name.clone(),
            incarnation: 0,
            restarted: false,
            // Its neighbours may have heard of an earlier incarnation of it (D49).
            counts: run.only.is_some(),
            bind: None,
            // One after the other, where there are several.
            observe: run.args.observe.map(|first| observed_at(first, all.len())),
            observe_token: token.cloned(),
            rt: run.args.rt,
            seed,
            loss: run.args.loss.0,
            record: run.args.record.as_ref().map(|file| record_file(file, &node.name)),
            actions: run.actions.clone(),
            notices: notices.map(Path::to_owned),
            courses: run.courses.clone(),
        };
        if run.only.is_some() {
            setup.bind = Some(place::address(run.loaded, id)?);
        }
        all.push((id, setup));
    }
    Ok(all)
}

/// The address of the node that comes after so many others; port 0 is any free one for each.
pub fn observed_at(first: SocketAddr, after: usize) -> SocketAddr {
    let port = first.port();
    let after = u16::try_from(after).unwrap_or(u16::MAX);
    SocketAddr::new(first.ip(), if port == 0 { 0 } else { port.saturating_add(after) })
}

/// Each node writes a file of its own: `run.imrs` becomes `run.nl.imrs`.
pub fn record_file(file: &std::path::Path, node: &str) -> PathBuf {
    let extension = file.extension().map_or_else(|| "imrs".into(), |e| e.to_string_lossy());
    file.with_extension(format!("{node}.{extension}"))
}

/// Ctrl-C and the like end the run in order, with its summary.
fn watch_signals(messages: mpsc::Sender<Message>) -> Result<(), LaunchError> {
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP]).map_err(LaunchError::Start)?;
    let watch = move || {
        for _ in signals.forever() {
            if messages.send(Message::Interrupted).is_err() {
                return;
            }
        }
    };
    thread::Builder::new().name("imrs signals".into()).spawn(watch).map_err(LaunchError::Start)?;
    Ok(())
}

impl Launcher<'_> {
    /// Waits until every node has said what `wanted` picks out. Returns that by node.
    fn wait_for_all<T>(
        &mut self,
        wanted: impl Fn(Word) -> Option<T>,
    ) -> Result<BTreeMap<NodeId, T>, LaunchError> {
        let deadline = Instant::now() + READY_WITHIN;
        let mut heard: BTreeMap<NodeId, T> = BTreeMap::new();
        while heard.len() < self.children.len() {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.messages.recv_timeout(left) {
                Ok(Message::Said(
                    node,
                    word @ (Word::Event(_)
                    | Word::Did(_)
                    | Word::TaskEnded { .. }
                    | Word::Stands(_)
                    | Word::HeldBack(_)
                    | Word::Told(_)),
                )) => self.early.push(Message::Said(node, word)),
                Ok(Message::Said(node, word)) => {
                    if let Some(value) = wanted(word) {
                        heard.insert(node, value);
                    }
                }
                Ok(Message::Gone(node, _)) => {
                    let ends = self.children.wait(EXIT_WITHIN);
                    let ended = |exit: Exit| ends.contains(&(node, super::children::End::Code(exit as i32)));
                    let refused = ended(Exit::Usage) || ended(Exit::System);
                    return Err(LaunchError::NotReady { name: self.name(node), refused });
                }
                Ok(Message::Interrupted) => self.interrupted = true,
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {
                    let late = self.children.nodes().find(|node| !heard.contains_key(node));
                    let name = late.map(|node| self.name(node)).unwrap_or_default();
                    return Err(LaunchError::NotReady { name, refused: false });
                }
            }
        }
        Ok(heard)
    }

    pub(super) fn name(&self, node: NodeId) -> String {
        self.children.name(node).to_owned()
    }

    /// Every node hears where the others serve monitors over TCP, so that one address finds all.
    pub(super) fn tell_observed(&mut self) {
        if !self.observed.is_empty() {
            self.children.order_all(&Order::Observed(self.observed.clone()));
        }
    }

    fn all_nodes(&self) -> Vec<NodeId> {
        (0..self.cell.nodes.len()).map(NodeId::from_index).collect()
    }

    pub(super) fn table(&self) -> &CellTable {
        &self.run.loaded.table
    }

    fn announce(
        &self,
        seed: u64,
        bound: &BTreeMap<NodeId, (Option<SocketAddr>, Option<SocketAddr>)>,
        out: &mut Output,
    ) -> Result<(), Failure> {
        let node = |(&id, &(address, observe)): (&NodeId, &(Option<SocketAddr>, Option<SocketAddr>))| {
            let tasks = self.cell.tasks.iter().filter(|t| t.node == id).map(|t| t.name.as_str());
            StartedNode {
                name: &self.cell.nodes[id.index()].name,
                tasks: tasks.collect(),
                pid: self.children.pid(id),
                address,
                observe,
            }
        };
        let started: Vec<_> = bound.iter().map(node).collect();
        match self.run.args.format {
            Format::Json => out.json(&Started { version: 1, started }),
            Format::Text => report::started(self.run, (seed, self.real_time), &started, out),
        }
    }

    /// Stops the nodes, hears the rest of what they say, and sums up.
    fn finish(mut self, seconds: f64, seed: u64) -> (Summary, Vec<Trouble>) {
        let end = now_us();
        self.gatherer.ended(end);
        self.judge.over(end);
        self.stopping = true;
        // Who stands still hears nothing.
        for node in std::mem::take(&mut self.faults).into_iter().filter_map(|(_, fault)| resumed(fault)) {
            self.children.stand_still(node, false);
        }
        self.children.order_all(&Order::Stop);
        self.interrupted = false;
        let deadline = Instant::now() + STOP_WITHIN;
        while self.gone.len() < self.children.len() && !self.interrupted {
            match self.messages.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
                // Nothing that is heard now starts anything.
                Ok(message) => drop(self.take(message)),
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => break,
            }
        }
        let ends = self.children.wait(deadline.saturating_duration_since(Instant::now()) + EXIT_WITHIN);
        for (node, end) in &ends {
            if let Some(at_fault) = end.at_fault() {
                let what = format!("node `{}`: {end}", self.cell.nodes[node.index()].name);
                self.trouble.push(Trouble { at_fault, what });
            }
        }
        let exits: Vec<(NodeId, String)> = ends.iter().map(|(node, end)| (*node, end.to_string())).collect();
        let mut summary = self.gatherer.summary(seconds, seed, self.run.args.loss.0, &exits);
        summary.rt = self.real_time;
        for node in &summary.nodes {
            let refusals = node.refusals.iter().map(|refusal| refusal.words(&node.name));
            self.trouble.extend(refusals.map(|what| Trouble { at_fault: false, what }));
        }
        self.hear_of_commands();
        for node in self.run.only.map_or_else(|| self.all_nodes(), |only| vec![only]) {
            self.judge.gone(node);
        }
        self.judge.settle();
        summary.checks = self.judge.settlement(self.diary.began());
        let complaints = summary.checks.complaints();
        self.trouble.extend(complaints.map(|what| Trouble { at_fault: false, what }));
        if let Some(tale) = self.run.tale {
            self.deeds.sort_by_key(|did| did.at);
            let story = Story {
                loaded: self.run.loaded,
                began: self.diary.began(),
                ended: end,
                deeds: self.deeds,
                faults: self.came,
                summary: &summary,
            };
            summary.outcome = Some((tale.explain)(&story));
        }
        (summary, self.trouble)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_node_records_into_a_file_of_its_own() {
        assert_eq!(record_file(Path::new("/r/run.imrs"), "nl"), Path::new("/r/run.nl.imrs"));
        assert_eq!(record_file(Path::new("run"), "nr"), Path::new("run.nr.imrs"));
    }
}
