//! The launcher: runs a cell with one process per node, injects faults on time, and sums up.

mod follow;

use super::children::{Children, Message};
use super::clock::now_us;
use super::error::LaunchError;
use super::event_log::EventLog;
use super::faults::{Fault, FaultError, Wanted, schedule};
use super::lines::{Order, Setup, Word};
use super::noticed::Noticed;
use super::report::{self, StartedNode};
use super::rt;
use super::run::Run;
use super::script_event::Did;
use super::setups::setups;
use super::signals::Interrupts;
use super::story::{Moment, Story};
use super::summary::{Gatherer, Summary};
use crate::args::Format;
use crate::checks::Judge;
use crate::exit::Exit;
use crate::failure::Failure;
use crate::output::{Output, Untaken, complain, count, notice};
use follow::progress_line;
use imrs_client::place;
use imrs_protocol::{Cell, CellTable, NodeId, TaskId};
use imrs_runtime::link::in_process::{self, Network};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

/// Time limit for all nodes to become ready.
const READY_WITHIN: Duration = Duration::from_secs(20);
/// Time limit for the nodes to stop.
const STOP_WITHIN: Duration = Duration::from_secs(5);
/// How long a process may take to end after its last message; also how long nodes have after a second Ctrl-C.
const EXIT_WITHIN: Duration = Duration::from_secs(1);
/// How long the summary waits for a slow reader of standard output.
const READ_WITHIN: Duration = Duration::from_secs(5);
/// Capacity of the queue from the nodes to the launcher. When it is full, nodes keep their own messages and count the dropped.
const WORDS: usize = 8_192;

/// The first line of `--format json`: what runs where.
#[derive(Serialize)]
struct Started<'a> {
    version: u32,
    started: Vec<StartedNode<'a>>,
}

pub(super) struct Launcher<'a> {
    pub(super) run: &'a Run<'a>,
    /// Whether the nodes run under the real-time scheduler: asked for, and not refused by the kernel.
    real_time: bool,
    pub(super) cell: &'a Cell,
    pub(super) setups: Vec<(NodeId, Setup)>,
    pub(super) event_log: EventLog,
    /// Tasks whose scripts have ended by themselves.
    pub(super) ended: Vec<TaskId>,
    pub(super) children: Children,
    pub(super) messages: Receiver<Message>,
    pub(super) gatherer: Gatherer,
    pub(super) judge: Judge<'a>,
    /// The pipe with notices about commands of actions, if there are any.
    pub(super) noticed: Option<Noticed>,
    /// Messages that nodes sent before all nodes had started.
    pub(super) early: Vec<Message>,
    /// Nodes whose pipe has ended.
    pub(super) gone: Vec<NodeId>,
    /// The addresses of the nodes.
    pub(super) book: BTreeMap<String, SocketAddr>,
    /// The TCP addresses at which nodes serve monitors.
    pub(super) observed: BTreeMap<String, SocketAddr>,
    /// Faults that are still to be injected, by their time since the start.
    pub(super) faults: Vec<(Duration, Fault)>,
    /// Faults that were injected, with microseconds of the shared clock.
    pub(super) came: Vec<(u64, Fault)>,
    /// The fault that a demo injects at a certain action, and how often that action has begun so far.
    pub(super) moment: Option<(&'static Moment, usize)>,
    /// What the scripts did, kept only for a demo's explanation.
    pub(super) events: Vec<Did>,
    pub(super) started: Instant,
    pub(super) trouble: Vec<Trouble>,
    /// Refusals between neighbours that have been shown already.
    pub(super) refused: BTreeSet<String>,
    /// Whether the notice that only servers are left has been shown.
    pub(super) idle_told: bool,
    pub(super) stopping: bool,
    pub(super) interrupts: Interrupts,
    /// The earlier deadline for readiness, set by the first Ctrl-C.
    ready_by: Option<Instant>,
}

/// The length of a run without a declared end.
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
    if args.until_idle && !finishes(run) {
        return Err(Failure::Usage(
            "--until-idle: every task here serves for ever (`loop` without `exit`, or handlers only): end the run with --for or Ctrl-C".into(),
        ));
    }
    let progress = progress_line(args.format);
    let notice = if args.format == Format::Json { json_notice } else { notice };
    out.step_aside(notice, progress)?;
    let refused = if args.rt { rt::refused() } else { Vec::new() };
    for refused in &refused {
        complain(format_args!("{refused}; the nodes run without it"));
    }
    let seed = args.seed.unwrap_or_else(|| fastrand::u64(..1_000_000));

    let (sender, messages) = mpsc::sync_channel(WORDS);
    let interrupts = Interrupts::watch(sender.clone())?;
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
        event_log: EventLog::new(cell, now_us()),
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
        moment: run.demo.and_then(|demo| demo.moment).map(|moment| (moment, 0)),
        events: Vec::new(),
        started: Instant::now(),
        trouble: Vec::new(),
        refused: BTreeSet::new(),
        idle_told: false,
        stopping: false,
        interrupts: interrupts.clone(),
        ready_by: None,
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
    launcher.event_log.begin(now_us());
    launcher.wait_for_all(|word| matches!(word, Word::Started).then_some(()))?;

    launcher.started = Instant::now();
    // Even if following the run fails, its nodes are stopped in order and its summary is shown.
    let followed = launcher.announce(seed, &bound, out).and_then(|()| launcher.follow(length, out));
    let seconds = launcher.started.elapsed().as_secs_f64();
    let (summary, trouble) = launcher.finish(seconds, seed);
    let shown = match args.format {
        Format::Json => out.json(&summary),
        Format::Text => report::summary(&summary, table, run, out),
    };
    let interrupted = interrupts.count();
    let untaken = out.settle(READ_WITHIN, || interrupts.count() > interrupted);
    for trouble in &trouble {
        complain(&trouble.what);
    }
    for missing in &summary.incomplete {
        complain(format_args!("incomplete: {missing}"));
    }
    let verdict = verdict(&summary, &trouble);
    let is_written = told(&untaken);
    followed.and(shown)?;
    Ok(if verdict == Exit::Well && !is_written { Exit::Usage } else { verdict })
}

/// Complains about lines of the answer that no reader took. False if writing failed; a slow or vanished reader is no error.
fn told(untaken: &Untaken) -> bool {
    let lines = count(untaken.lines, "line");
    match untaken {
        Untaken { lines: 0, .. } => return true,
        Untaken { failed: None, .. } => {
            complain(format_args!("{lines} of the answer were not read, and are left out"));
            return true;
        }
        Untaken { failed: Some(why), .. } => {
            complain(format_args!("cannot write the answer: {why}: {lines} of it are missing"));
        }
    }
    false
}

/// The notice about dropped lines, for `--format json`.
fn json_notice(lines: u64, why: &str) -> String {
    serde_json::json!({ "version": 1, "not_shown": lines, "why": why }).to_string()
}

/// Whether any task that runs here can reach the end of its script.
fn finishes(run: &Run<'_>) -> bool {
    let tasks = run.loaded.table.cell().tasks.iter().enumerate();
    let here = tasks.filter(|(_, task)| run.only.is_none_or(|only| task.node == only));
    here.map(|(at, _)| TaskId::from_index(at)).any(|task| run.loaded.can_finish(task))
}

/// Checks that all faults concern this node.
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

/// A problem that makes the run a finding, beyond those in its summary.
pub(super) struct Trouble {
    /// Whether this program is at fault; if not, the cause lies outside.
    pub(super) at_fault: bool,
    pub(super) what: String,
}

/// Broken promises are a finding, and so is a node that something else killed. The effects of injected faults are not.
/// Without a finding, missing evidence makes the run incomplete: exit code 0 means that everything was judged.
fn verdict(summary: &Summary, trouble: &[Trouble]) -> Exit {
    let false_release = summary.rendezvous.iter().any(|r| r.false_releases.is_some_and(|n| n > 0));
    let broken = summary.outcome.as_ref().is_some_and(|outcome| outcome.held == Some(false))
        || summary.checks.is_broken();
    if trouble.iter().any(|t| t.at_fault) {
        Exit::Internal
    } else if false_release || broken || !trouble.is_empty() {
        Exit::Finding
    } else if summary.incomplete.is_empty() {
        Exit::Well
    } else {
        Exit::Incomplete
    }
}

impl Launcher<'_> {
    /// Waits until every node has sent a message that `wanted` accepts. Returns the accepted values by node.
    fn wait_for_all<T>(
        &mut self,
        wanted: impl Fn(Word) -> Option<T>,
    ) -> Result<BTreeMap<NodeId, T>, LaunchError> {
        let deadline = Instant::now() + READY_WITHIN;
        let mut heard: BTreeMap<NodeId, T> = BTreeMap::new();
        while heard.len() < self.children.len() {
            // After Ctrl-C, nodes that are nearly ready still get the time to stop in order.
            if self.interrupts.count() > 0 {
                self.ready_by.get_or_insert_with(|| Instant::now() + EXIT_WITHIN);
            }
            let deadline = self.ready_by.map_or(deadline, |by| by.min(deadline));
            match self.messages.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
                Ok(Message::Said(
                    node,
                    word @ (Word::Event(_)
                    | Word::Did(_)
                    | Word::TaskEnded { .. }
                    | Word::Stands(_)
                    | Word::HeldBack(_)
                    | Word::Told(_)
                    | Word::Untold { .. }),
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
                // Only a wake-up: `interrupts` has counted the signal.
                Ok(Message::Interrupted) => {}
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {
                    let late = self.children.nodes().find(|node| !heard.contains_key(node));
                    let name = late.map(|node| self.name(node)).unwrap_or_default();
                    return Err(match self.interrupts.count() {
                        0 => LaunchError::NotReady { name, refused: false },
                        _ => LaunchError::Interrupted(name),
                    });
                }
            }
        }
        Ok(heard)
    }

    pub(super) fn name(&self, node: NodeId) -> String {
        self.children.name(node).to_owned()
    }

    /// Tells every node the TCP addresses of all, so that a monitor finds all nodes through one of them.
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

    /// Stops the nodes, takes their remaining messages, and sums up.
    fn finish(mut self, seconds: f64, seed: u64) -> (Summary, Vec<Trouble>) {
        let end = now_us();
        self.gatherer.ended(end);
        self.judge.over(end);
        self.stopping = true;
        // A process that is stopped by SIGSTOP cannot read the order.
        for node in std::mem::take(&mut self.faults).into_iter().filter_map(|(_, fault)| resumed(fault)) {
            self.children.stand_still(node, false);
        }
        self.children.order_all(&Order::Stop);
        let interrupts = self.interrupts.count();
        let mut deadline = Instant::now() + STOP_WITHIN;
        while self.gone.len() < self.children.len() {
            if self.interrupts.count() > interrupts {
                deadline = Instant::now();
                break;
            }
            match self.messages.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
                // No message at this point starts anything, so errors do not matter.
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
        summary.checks = self.judge.settlement(self.event_log.began());
        summary.incomplete.extend(summary.checks.unjudged());
        if self.judge.is_missing() && summary.incomplete.is_empty() {
            summary
                .incomplete
                .push("changes that checks look at came faster than they could be judged".into());
        }
        let complaints = summary.checks.complaints();
        self.trouble.extend(complaints.map(|what| Trouble { at_fault: false, what }));
        if let Some(demo) = self.run.demo {
            self.events.sort_by_key(|did| did.at);
            let is_missing = demo.moment.is_some() && self.came.is_empty();
            let story = Story {
                loaded: self.run.loaded,
                began: self.event_log.began(),
                ended: end,
                events: self.events,
                faults: self.came,
                summary: &summary,
            };
            let mut outcome = (demo.explain)(&story);
            if is_missing {
                outcome.words.push(
                    "The fault never came: the run ended before its moment (--for gives more time).".into(),
                );
            }
            summary.outcome = Some(outcome);
        }
        (summary, self.trouble)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::beam_lift;
    use crate::launch::lines::Figures;

    #[test]
    fn a_node_that_could_not_tell_everything_leaves_the_verdict_open() {
        let nodes = [0, 1, 2].map(NodeId);
        let mut gatherer = Gatherer::new(beam_lift(), nodes.to_vec());
        let summary = |gatherer: &Gatherer| gatherer.summary(1.0, 7, 0.0, &[]);
        assert_eq!(verdict(&summary(&gatherer), &[]), Exit::Well);
        gatherer.figures(NodeId(0), Figures { untold: 3, ..Figures::default() });
        let summary = summary(&gatherer);
        assert_eq!(summary.incomplete, ["node nl could not report 3 happenings: too many at once"]);
        assert_eq!(verdict(&summary, &[]), Exit::Incomplete);
        let unrecorded = vec!["the recording run.nr.imrs misses 2 inputs".to_owned()];
        gatherer.figures(NodeId(0), Figures::default());
        gatherer.figures(NodeId(1), Figures { unrecorded: unrecorded.clone(), ..Figures::default() });
        assert_eq!(gatherer.summary(1.0, 7, 0.0, &[]).incomplete, unrecorded);
        // A finding outranks missing evidence.
        let trouble = Trouble { at_fault: false, what: "a task failed".into() };
        assert_eq!(verdict(&summary, &[trouble]), Exit::Finding);
    }
}
