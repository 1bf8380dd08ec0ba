//! Runs a cell: one process per node, faults on time, and a summary at the end.

use super::children::{Children, Message};
use super::clock::now_us;
use super::diary::Diary;
use super::faults::{Fault, FaultError, schedule};
use super::lines::{Order, Setup, Word};
use super::report;
use super::summary::{Gatherer, Summary};
use crate::args::{Format, LaunchArgs};
use crate::cells::{Loaded, Source};
use crate::exit::{Exit, Failure};
use crate::output::{Output, complain};
use imrs_protocol::{Cell, NodeId, TaskId};
use imrs_runtime::link::in_process::{self, Network};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
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
/// How often lines about what scripts do are looked through.
const SHOW_EVERY: Duration = Duration::from_millis(50);
/// How often the progress line changes.
const PROGRESS_EVERY: Duration = Duration::from_millis(250);

/// Why a cell could not be run.
#[derive(Debug, thiserror::Error)]
pub enum LaunchError {
    /// The faults do not fit the cell or the run.
    #[error(transparent)]
    Fault(#[from] FaultError),
    /// A process or thread cannot be started.
    #[error("cannot start the nodes: {0}")]
    Start(io::Error),
    /// A node did not get ready.
    #[error("node `{0}` did not get ready")]
    NotReady(String),
}

impl LaunchError {
    /// The exit code it leads to.
    pub fn exit(&self) -> Exit {
        match self {
            Self::Fault(_) => Exit::Usage,
            Self::Start(_) | Self::NotReady(_) => Exit::Internal,
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
    /// What a person should know before.
    pub introduction: Option<&'static str>,
}

struct Launcher<'a> {
    run: &'a Run<'a>,
    cell: &'a Cell,
    diary: Diary,
    /// Scripts that ended by themselves.
    ended: Vec<TaskId>,
    children: Children,
    messages: Receiver<Message>,
    gatherer: Gatherer,
    /// What nodes said before all had started.
    early: Vec<Message>,
    /// Nodes whose pipe has ended.
    gone: Vec<NodeId>,
    trouble: Vec<Trouble>,
    stopping: bool,
    interrupted: bool,
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
    let faults = schedule(cell, length, &args.kill, &args.cut).map_err(LaunchError::Fault)?;
    let seed = args.seed.unwrap_or_else(|| fastrand::u64(..1_000_000));

    let (sender, messages) = mpsc::channel();
    watch_signals(sender.clone())?;
    let network = args.in_process.then(|| Network::new(Arc::clone(table), in_process::Faults::default()));
    let children = Children::start(&setups(run, seed), network.as_ref(), &sender)?;
    drop(sender);
    let gatherer = Gatherer::new(Arc::clone(table));
    let mut launcher = Launcher {
        run,
        cell,
        diary: Diary::new(cell, now_us()),
        ended: Vec::new(),
        children,
        messages,
        gatherer,
        early: Vec::new(),
        gone: Vec::new(),
        trouble: Vec::new(),
        stopping: false,
        interrupted: false,
    };
    let addresses = launcher.wait_for_all(|word| if let Word::Bound(at) = word { Some(at) } else { None })?;
    let book = cell.nodes.iter().zip(&addresses).filter_map(|(n, at)| Some((n.name.clone(), (*at)?)));
    launcher.children.order_all(&Order::Book(book.collect()));
    launcher.diary.begin(now_us());
    launcher.wait_for_all(|word| matches!(word, Word::Started).then_some(()))?;

    let started = Instant::now();
    launcher.announce(seed, &addresses, out)?;
    launcher.follow(started, length, &faults, out)?;
    let seconds = started.elapsed().as_secs_f64();
    let (summary, trouble) = launcher.finish(seconds, seed, args.loss.0);
    match args.format {
        Format::Json => out.json(&summary)?,
        Format::Text => report::summary(&summary, table, run, out)?,
    }
    for trouble in &trouble {
        complain(&trouble.what);
    }
    Ok(verdict(&summary, &trouble))
}

/// Something that no run should have, besides what is in its summary.
struct Trouble {
    /// Whether it is this program's fault; otherwise somebody interfered.
    at_fault: bool,
    what: String,
}

/// Broken promises are a finding, and so is a node that somebody else ended. What faults do to a run is not.
fn verdict(summary: &Summary, trouble: &[Trouble]) -> Exit {
    let false_release = summary.rendezvous.iter().any(|r| r.rounds.false_releases > 0);
    if trouble.iter().any(|t| t.at_fault) {
        Exit::Internal
    } else if false_release || summary.acted.is_some_and(|a| a.executed_late > 0) || !trouble.is_empty() {
        Exit::Finding
    } else {
        Exit::Well
    }
}

fn setups(run: &Run<'_>, seed: u64) -> Vec<Setup> {
    let setup = |name: &str| Setup {
        cell: run.source.clone(),
        node: name.into(),
        incarnation: 0,
        seed,
        loss: run.args.loss.0,
        record: run.args.record.as_ref().map(|file| record_file(file, name)),
        actions: run.actions.clone(),
    };
    run.loaded.table.cell().nodes.iter().map(|node| setup(&node.name)).collect()
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
    fn wait_for_all<T>(&mut self, wanted: impl Fn(Word) -> Option<T>) -> Result<Vec<T>, LaunchError> {
        let deadline = Instant::now() + READY_WITHIN;
        let mut heard: BTreeMap<NodeId, T> = BTreeMap::new();
        while heard.len() < self.cell.nodes.len() {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.messages.recv_timeout(left) {
                Ok(Message::Said(node, word @ (Word::Event(_) | Word::Did(_) | Word::TaskEnded { .. }))) => {
                    self.early.push(Message::Said(node, word));
                }
                Ok(Message::Said(node, word)) => {
                    if let Some(value) = wanted(word) {
                        heard.insert(node, value);
                    }
                }
                Ok(Message::Gone(node)) => {
                    return Err(LaunchError::NotReady(self.children.name(node).into()));
                }
                Ok(Message::Interrupted) => self.interrupted = true,
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {
                    let late =
                        (0..self.cell.nodes.len()).map(NodeId::from_index).find(|n| !heard.contains_key(n));
                    let name = late.map(|node| self.children.name(node).to_owned());
                    return Err(LaunchError::NotReady(name.unwrap_or_default()));
                }
            }
        }
        Ok(heard.into_values().collect())
    }

    fn announce(&self, seed: u64, addresses: &[Option<SocketAddr>], out: &mut Output) -> Result<(), Failure> {
        let node = |(i, &address): (usize, &Option<SocketAddr>)| {
            let id = NodeId::from_index(i);
            let tasks = self.cell.tasks.iter().filter(|t| t.node == id).map(|t| t.name.as_str());
            StartedNode {
                name: &self.cell.nodes[i].name,
                tasks: tasks.collect(),
                pid: self.children.pid(id),
                address,
            }
        };
        let started: Vec<_> = addresses.iter().enumerate().map(node).collect();
        match self.run.args.format {
            Format::Json => out.json(&Started { version: 1, started }),
            Format::Text => report::started(self.run, seed, &started, out),
        }
    }

    /// Follows the run until its end, carrying out the faults on time.
    fn follow(
        &mut self,
        started: Instant,
        length: Duration,
        faults: &[(Duration, Fault)],
        out: &mut Output,
    ) -> Result<(), Failure> {
        for message in std::mem::take(&mut self.early) {
            self.take(message);
        }
        let mut faults = faults.iter().peekable();
        let progress = progress_line(self.run.args.format);
        let mut progress_at = started;
        while !self.interrupted && !self.is_over() {
            let now = started.elapsed();
            if now >= length {
                break;
            }
            while let Some((_, fault)) = faults.next_if(|(at, _)| *at <= now) {
                self.carry_out(*fault);
            }
            let shows = !self.diary.is_empty();
            if shows {
                progress.suspend(|| self.diary.show(self.cell, now_us(), out))?;
            }
            if progress_at <= Instant::now() {
                let of = self.run.length.map(|all| format!(" of {}", humantime::format_duration(all)));
                let (so_far, of) = (now.as_secs(), of.unwrap_or_default());
                progress.set_message(format!("{so_far} s{of}: {} rounds", self.gatherer.released()));
                progress.tick();
                progress_at = Instant::now() + PROGRESS_EVERY;
            }
            let next_fault = faults.peek().map_or(length, |(at, _)| *at);
            let mut until = (started + next_fault.min(length)).min(progress_at);
            if shows {
                until = until.min(Instant::now() + SHOW_EVERY);
            }
            match self.messages.recv_timeout(until.saturating_duration_since(Instant::now())) {
                Ok(message) => self.take(message),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        progress.finish_and_clear();
        self.diary.close(self.cell, out)?;
        Ok(())
    }

    /// Whether nothing can happen any more: all nodes are gone, or every task is a script and has ended.
    fn is_over(&self) -> bool {
        let scripts = self.run.loaded.scripts.iter().all(Option::is_some);
        self.gone.len() == self.cell.nodes.len() || scripts && self.ended.len() == self.cell.tasks.len()
    }

    fn carry_out(&mut self, fault: Fault) {
        let name = |node: NodeId| self.cell.nodes[node.index()].name.clone();
        match fault {
            Fault::Kill(node) => {
                let at = now_us();
                self.children.kill(node);
                self.gatherer.killed(node, at);
            }
            Fault::Cut(a, b) => {
                self.children.order(a, &Order::Cut(name(b)));
                self.children.order(b, &Order::Cut(name(a)));
            }
            Fault::Heal(a, b) => {
                self.children.order(a, &Order::Heal(name(b)));
                self.children.order(b, &Order::Heal(name(a)));
            }
        }
    }

    fn take(&mut self, message: Message) {
        match message {
            Message::Said(_, Word::Event(event)) => self.gatherer.event(&event),
            Message::Said(node, Word::Figures(figures)) => self.gatherer.figures(node, *figures),
            Message::Said(_, Word::TaskFailed { task, how }) => {
                self.trouble.push(Trouble { at_fault: true, what: format!("task `{task}` {how}") });
            }
            Message::Said(_, Word::Did(did)) => {
                if self.run.args.format == Format::Text && !self.stopping {
                    self.diary.add(did);
                }
            }
            Message::Said(_, Word::TaskEnded { task, how, wrong }) => {
                self.ended.push(task);
                if wrong {
                    let what = format!("task `{}` {how}", self.cell.tasks[task.index()].name);
                    self.trouble.push(Trouble { at_fault: false, what });
                }
                self.gatherer.script_ended(task, how);
            }
            Message::Said(_, Word::Bound(_) | Word::Started | Word::Done) => {}
            Message::Gone(node) => {
                // One that was not killed by this launcher: somebody else did, or it is at fault. Its last words are missing.
                if !self.stopping {
                    self.gatherer.killed(node, now_us());
                }
                self.gone.push(node);
            }
            Message::Interrupted => self.interrupted = true,
        }
    }

    /// Stops the nodes, hears the rest of what they say, and sums up.
    fn finish(mut self, seconds: f64, seed: u64, loss: f64) -> (Summary, Vec<Trouble>) {
        self.gatherer.ended(now_us());
        self.stopping = true;
        self.children.order_all(&Order::Stop);
        self.interrupted = false;
        let deadline = Instant::now() + STOP_WITHIN;
        while self.gone.len() < self.cell.nodes.len() && !self.interrupted {
            match self.messages.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
                Ok(message) => self.take(message),
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => break,
            }
        }
        let ends = self.children.wait(deadline.saturating_duration_since(Instant::now()) + EXIT_WITHIN);
        for (node, end) in self.cell.nodes.iter().zip(&ends) {
            if let Some(at_fault) = end.at_fault() {
                self.trouble.push(Trouble { at_fault, what: format!("node `{}`: {end}", node.name) });
            }
        }
        let exits: Vec<String> = ends.iter().map(ToString::to_string).collect();
        (self.gatherer.summary(seconds, seed, loss, &exits), self.trouble)
    }
}

/// A line on standard error while the run lasts, if a person may be looking.
fn progress_line(format: Format) -> ProgressBar {
    let target = match format {
        Format::Text => ProgressDrawTarget::stderr(),
        Format::Json => ProgressDrawTarget::hidden(),
    };
    ProgressBar::with_draw_target(None, target).with_style(ProgressStyle::default_spinner())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn every_node_records_into_a_file_of_its_own() {
        assert_eq!(record_file(Path::new("/r/run.imrs"), "nl"), Path::new("/r/run.nl.imrs"));
        assert_eq!(record_file(Path::new("run"), "nr"), Path::new("run.nr.imrs"));
    }
}
