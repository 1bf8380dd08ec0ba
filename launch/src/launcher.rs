//! The launcher: runs a cell with one process per node, injects faults on time, and sums up.

mod finish;
mod follow;

pub use finish::{Ended, Verdict};

use crate::children::{Children, End, Message};
use crate::clock::now_us;
use crate::error::LaunchError;
use crate::event_log::EventLog;
use crate::fact::Fact;
use crate::faults::Fault;
use crate::folds::timeline::Line;
use crate::host::Host;
use crate::noticed::Noticed;
use crate::pipe::{Order, Setup, Word};
use crate::run::{Moment, Run};
use crate::setups::setups;
use crate::signals::Interrupts;
use imrs_client::place;
use imrs_protocol::{Cell, NodeId};
use imrs_runtime::link::in_process::{self, Network};
use serde::Serialize;
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

/// How long all nodes together may take to become ready.
const READY_WITHIN: Duration = Duration::from_secs(20);
/// How long a process may take to end after its last message. After a second Ctrl-C the nodes get this time, too.
const EXIT_WITHIN: Duration = Duration::from_secs(1);
/// Capacity of the queue of messages from the nodes to the launcher. When it is full, nodes keep their own messages and
/// count those that they drop.
const WORDS: usize = 8_192;
/// The length of a run for which the user gave none.
const WITHOUT_END: Duration = Duration::from_secs(u32::MAX as u64);

/// A run whose nodes have started.
///
/// The program calls [`advance`](Self::advance) and [`wait`](Self::wait) in turns until the run is over, then
/// [`finish`](Self::finish).
pub struct Launcher<'a> {
    run: &'a Run<'a>,
    cell: &'a Cell,
    setups: Vec<(NodeId, Setup)>,
    children: Children,
    messages: Receiver<Message>,
    log: EventLog<'a>,
    /// The named pipe for notices about the commands of actions, if the run has such commands.
    noticed: Option<Noticed>,
    /// Messages of nodes that arrived before all nodes had started.
    early: Vec<Message>,
    /// The addresses of the nodes.
    book: BTreeMap<String, SocketAddr>,
    /// The TCP addresses at which nodes serve monitors.
    observed: BTreeMap<String, SocketAddr>,
    /// Faults that are still to be injected, each with its time since the start of the run.
    faults: Vec<(Duration, Fault)>,
    /// The fault that waits for an action to begin, and how often that action has begun so far.
    moment: Option<(Moment, usize)>,
    started: Instant,
    /// When each running node last sent a message.
    heard: BTreeMap<NodeId, Instant>,
    /// Whether the event log already has the fact that only tasks that serve for ever still run.
    idle_told: bool,
    interrupts: Interrupts,
    /// The earlier limit for the nodes to become ready, which the first Ctrl-C sets.
    ready_by: Option<Instant>,
}

/// A node that has started, as the program shows it to the user.
#[derive(Clone, Debug, Serialize)]
pub struct StartedNode<'a> {
    /// The node's name.
    pub name: &'a str,
    /// The node's tasks.
    pub tasks: Vec<&'a str>,
    /// The id of the node's process.
    pub pid: u32,
    /// The address of the node's UDP socket, if it has one.
    pub address: Option<SocketAddr>,
    /// The TCP address at which the node serves monitors.
    pub observe: Option<SocketAddr>,
}

impl<'a> Launcher<'a> {
    /// Starts the nodes of a run, and waits until all of them run.
    ///
    /// # Errors
    /// [`LaunchError`].
    pub fn start(run: &'a Run<'a>, host: &'static dyn Host) -> Result<Self, LaunchError> {
        let table = &run.loaded.table;
        let (sender, messages) = mpsc::sync_channel(WORDS);
        let interrupts = Interrupts::watch(sender.clone())?;
        let network = run.in_process.then(|| Network::new(Arc::clone(table), in_process::Faults::default()));
        let noticed = (!run.actions.is_empty()).then(Noticed::new).transpose().map_err(LaunchError::Start)?;
        let setups = setups(run, noticed.as_ref().map(Noticed::path))?;
        let children = Children::start(&setups, network, sender, host)?;
        let here: Vec<NodeId> = children.nodes().collect();
        let book = run.only.map(|only| place::neighbours(run.loaded, only)).transpose()?;
        let mut launcher = Self {
            run,
            cell: table.cell(),
            setups,
            children,
            messages,
            log: EventLog::new(run, here),
            noticed,
            early: Vec::new(),
            book: book.unwrap_or_default(),
            observed: BTreeMap::new(),
            faults: run.faults.clone(),
            moment: run.moment.clone().map(|moment| (moment, 0)),
            started: Instant::now(),
            heard: BTreeMap::new(),
            idle_told: false,
            interrupts,
            ready_by: None,
        };
        launcher.make_ready()?;
        launcher.started = Instant::now();
        launcher.heard = launcher.children.nodes().map(|node| (node, launcher.started)).collect();
        Ok(launcher)
    }

    /// Collects the addresses of the nodes, distributes them, and waits until all tasks run.
    fn make_ready(&mut self) -> Result<(), LaunchError> {
        let bound = self.wait_for_all(|word| match word {
            Word::Bound { address, observe } => Some((address, observe)),
            _ => None,
        })?;
        for (node, (address, observe)) in bound {
            let name = self.name(node);
            self.observed.extend(observe.map(|address| (name.clone(), address)));
            self.book.extend(address.map(|address| (name, address)));
        }
        self.children.order_all(&Order::Book(self.book.clone()));
        self.tell_observed();
        self.log.note(now_us(), &Fact::Began);
        self.wait_for_all(|word| matches!(word, Word::Started).then_some(()))?;
        Ok(())
    }

    /// Waits until every node has sent a message that `wanted` accepts. Returns the accepted values by node.
    fn wait_for_all<T>(
        &mut self,
        wanted: impl Fn(Word) -> Option<T>,
    ) -> Result<BTreeMap<NodeId, T>, LaunchError> {
        let deadline = Instant::now() + READY_WITHIN;
        let mut heard: BTreeMap<NodeId, T> = BTreeMap::new();
        while heard.len() < self.children.len() {
            // After Ctrl-C, nodes that are nearly ready still get time to stop in order.
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
                    let refused = ends.iter().any(|(of, end)| match end {
                        End::Code(code) => *of == node && self.children.host().is_refusal(*code),
                        End::Clean | End::Killed | End::Signal(_) | End::Hung => false,
                    });
                    return Err(LaunchError::NotReady { name: self.name(node), refused });
                }
                // This message only wakes the launcher: `interrupts` has already counted the signal.
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

    fn name(&self, node: NodeId) -> String {
        self.children.name(node).to_owned()
    }

    /// Sends every node the TCP addresses at which all nodes serve monitors, so that a monitor finds all
    /// nodes through one of them.
    fn tell_observed(&mut self) {
        if !self.observed.is_empty() {
            self.children.order_all(&Order::Observed(self.observed.clone()));
        }
    }

    /// The nodes that this launcher runs.
    pub fn nodes(&self) -> impl Iterator<Item = StartedNode<'_>> {
        self.children.nodes().map(|id| {
            let name = self.children.name(id);
            let tasks = self.cell.tasks.iter().filter(|task| task.node == id);
            StartedNode {
                name,
                tasks: tasks.map(|task| task.name.as_str()).collect(),
                pid: self.children.pid(id),
                address: self.book.get(name).copied(),
                observe: self.observed.get(name).copied(),
            }
        })
    }

    /// For how long the tasks have run.
    #[must_use]
    pub fn elapsed(&self) -> Duration {
        self.started.elapsed()
    }

    /// For how long the most silent of the running nodes has sent no message. A node that works sends its counters five times
    /// a second.
    #[must_use]
    pub fn silent_for(&self) -> Duration {
        self.heard.values().map(Instant::elapsed).max().unwrap_or_default()
    }

    /// How many rounds have released all members so far; `None` in a cell without waitfors.
    #[must_use]
    pub fn released(&self) -> Option<u64> {
        self.log.gatherer.released()
    }

    /// The count of signals that ask for the end of the run.
    #[must_use]
    pub fn interrupts(&self) -> Interrupts {
        self.interrupts.clone()
    }

    /// Whether there are lines for people that can be taken.
    #[must_use]
    pub fn has_lines(&self) -> bool {
        self.log.timeline.as_ref().is_some_and(|timeline| !timeline.is_empty())
    }

    /// Takes the lines for people that are old enough that no earlier line can still come.
    pub fn lines(&mut self) -> Vec<Line> {
        self.log.timeline.as_mut().map(|timeline| timeline.settled(now_us())).unwrap_or_default()
    }

    /// Takes all remaining lines for people.
    pub fn last_lines(&mut self) -> Vec<Line> {
        self.log.timeline.as_mut().map(|timeline| timeline.settled(u64::MAX)).unwrap_or_default()
    }
}
