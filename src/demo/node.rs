//! One node of a demo: a process that runs what its launcher says.

use super::beam_lift;
use super::lines::{Event, Figures, Order, Setup, What, Word, hear, say};
use super::probe::Probe;
use super::recorder::NodeRecording;
use crate::cells;
use crate::output::complain;
use imrs_protocol::{CellTable, Event as Observed, Incarnation, NodeId, NodeTable, TaskId};
use imrs_runtime::link::faulty::FaultyLink;
use imrs_runtime::link::udp::{UdpError, UdpLink, UdpOptions};
use imrs_runtime::observer::Observer;
use imrs_runtime::{Observations, Runtime, StartError, TaskEnd};
use imrs_wire::obs::{Count, TimedEvent};
use imrs_wire::recording::WriteError;
use rustix::process::{Signal, set_parent_process_death_signal};
use std::collections::BTreeMap;
use std::io::{self, BufReader, Stdout};
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::thread;
use std::time::{Duration, Instant};

/// How often the node tells what its machines observed.
const TELL_EVERY: Duration = Duration::from_millis(20);
/// How often it tells its figures: what a killed node did last is known this well.
const COUNT_EVERY: Duration = Duration::from_millis(200);
/// How many observations of each machine are read at once: all that are kept.
const ROOM: usize = usize::MAX;
/// How long the tasks have to end.
const PATIENCE: Duration = Duration::from_secs(2);

/// Why a node could not do its part.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    /// The pipes to the launcher failed.
    #[error("node: the launcher's pipe failed: {0}")]
    Pipe(#[from] io::Error),
    /// The launcher said something that makes no sense.
    #[error("node: the launcher asked for {0}")]
    Setup(String),
    /// The node has no socket.
    #[error("node: {0}")]
    Link(#[from] UdpError),
    /// The node did not start.
    #[error("node: {0}")]
    Start(#[from] StartError),
    /// The node cannot record.
    #[error("node: cannot record: {0}")]
    Record(#[from] WriteError),
}

type FaultyUdp = FaultyLink<UdpLink>;

struct Process {
    table: NodeTable,
    link: Arc<FaultyUdp>,
    /// Here until it is stopped.
    runtime: Option<Runtime>,
    node: Arc<imrs_runtime::Node>,
    /// Monitors are served while this is here. A node runs without, too.
    _observer: Option<Observer>,
    observations: Observations,
    recording: Option<NodeRecording>,
    probe: Probe,
    told: Receiver<Event>,
    untold: u64,
    out: Stdout,
}

/// Runs the node that standard input describes until it is told to stop, or until the launcher has gone.
///
/// # Errors
/// [`NodeError`].
pub fn run() -> Result<(), NodeError> {
    // A launcher that is killed cannot tell its nodes. Without the call, the end of the pipe tells them.
    let _ = set_parent_process_death_signal(Some(Signal::KILL));
    let mut input = BufReader::new(io::stdin());
    let Some(setup) = hear::<Setup>(&mut input)? else { return Ok(()) };
    let (orders, ordered) = mpsc::channel();
    let mut node = Process::start(&setup)?;
    say(&mut node.out, &Word::Bound(node.link.inner().local_address()))?;
    thread::Builder::new().name("imrs orders".into()).spawn(move || listen(input, &orders))?;
    node.serve(&ordered)?;
    node.end()
}

/// Reads the launcher's orders until it has gone.
fn listen(mut input: BufReader<io::Stdin>, orders: &Sender<Order>) {
    while let Ok(Some(order)) = hear(&mut input) {
        if orders.send(order).is_err() {
            return;
        }
    }
}

impl Process {
    fn start(setup: &Setup) -> Result<Self, NodeError> {
        if setup.cell != cells::beam_lift::NAME {
            return Err(NodeError::Setup(format!("the cell `{}`", setup.cell)));
        }
        let cell = CellTable::new(cells::beam_lift::cell());
        let cell = Arc::new(cell.map_err(|_| NodeError::Setup("a cell with faults".into()))?);
        let id = cell.cell().nodes.iter().position(|n| n.name == setup.node).map(NodeId::from_index);
        let id = id.ok_or_else(|| NodeError::Setup(format!("the node `{}`", setup.node)))?;
        let table = NodeTable::new(Arc::clone(&cell), id);

        let life = Incarnation(setup.incarnation);
        let any_port = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
        let udp = UdpLink::bind(table.clone(), any_port, UdpOptions::new(life, false))?;
        // Of all links of the cell, no two lose the same datagrams.
        let link = Arc::new(FaultyLink::new(udp, setup.seed.wrapping_add(u64::from(id.0))));
        link.set_loss(setup.loss);

        let (tell, told) = mpsc::channel();
        let probe = Probe::new(&cell, tell);
        let mut builder = Runtime::builder(Arc::clone(&cell), id)
            .incarnation(life, false)
            .insecure(true)
            .link(Arc::clone(&link) as Arc<dyn imrs_runtime::link::Link>);
        for task in cell.tasks_on(id) {
            let name = &cell.cell().tasks[task.index()].name;
            let program = beam_lift::program(name, probe.clone(), setup.seed)
                .ok_or_else(|| NodeError::Setup(format!("the task `{name}`")))?;
            builder = builder.task(name, program);
        }
        let recording = match &setup.record {
            Some(path) => Some(NodeRecording::start(path, setup, &NodeTable::new(Arc::clone(&cell), id))?),
            None => None,
        };
        if let Some(recording) = &recording {
            builder = builder.recorder(recording.recorder());
        }
        let runtime = builder.start()?;
        let node = Arc::clone(runtime.node());
        let observations = node.observe();
        let observer = Observer::start(Arc::clone(&node));
        if let Err(error) = &observer {
            complain(format_args!("node {} runs, but no monitor can see it: {error}", setup.node));
        }
        let out = io::stdout();
        let (runtime, _observer) = (Some(runtime), observer.ok());
        Ok(Self {
            table,
            link,
            runtime,
            node,
            _observer,
            observations,
            recording,
            probe,
            told,
            untold: 0,
            out,
        })
    }

    /// Does what the launcher orders, and tells it what happens.
    fn serve(&mut self, orders: &Receiver<Order>) -> Result<(), NodeError> {
        let mut counted = Instant::now();
        let mut tell_at = Instant::now() + TELL_EVERY;
        loop {
            match orders.recv_timeout(tell_at.saturating_duration_since(Instant::now())) {
                Ok(Order::Book(book)) => self.begin(&book)?,
                Ok(Order::Cut(name)) => self.set_cut(&name, true),
                Ok(Order::Heal(name)) => self.set_cut(&name, false),
                Ok(Order::Stop) | Err(RecvTimeoutError::Disconnected) => return Ok(()),
                Err(RecvTimeoutError::Timeout) => {
                    tell_at = Instant::now() + TELL_EVERY;
                    self.tell()?;
                    if counted.elapsed() >= COUNT_EVERY {
                        counted = Instant::now();
                        self.count()?;
                    }
                }
            }
        }
    }

    fn begin(&mut self, book: &BTreeMap<String, SocketAddr>) -> Result<(), NodeError> {
        for (name, &address) in book {
            if let Some(node) = self.node_named(name).filter(|&node| node != self.table.node) {
                // A node without a link to this one needs no address here.
                let _ = self.link.inner().set_address(node, Some(address));
            }
        }
        self.probe.start();
        Ok(say(&mut self.out, &Word::Started)?)
    }

    fn set_cut(&self, name: &str, cut: bool) {
        if let Some(node) = self.node_named(name) {
            self.link.set_cut(node, cut);
        }
    }

    fn node_named(&self, name: &str) -> Option<NodeId> {
        self.table.cell().nodes.iter().position(|n| n.name == name).map(NodeId::from_index)
    }

    /// Stops the tasks, and tells the rest.
    fn end(mut self) -> Result<(), NodeError> {
        // Tasks that still wait for the start can end, too.
        self.probe.start();
        let ends = self.runtime.take().map(|runtime| runtime.stop(PATIENCE)).unwrap_or_default();
        self.tell()?;
        self.count()?;
        let recorded = self.recording.take().and_then(|recording| recording.stop(PATIENCE));
        if let Some(status) = recorded.filter(|status| !status.ended || status.lost > 0) {
            let (name, lost) = (self.node.name(), status.lost);
            complain(format_args!("the recording of node {name} misses {lost} inputs"));
        }
        for (task, how) in ends.into_iter().filter_map(|(task, end)| Some((task, trouble(&end)?))) {
            say(&mut self.out, &Word::TaskFailed { task, how })?;
        }
        Ok(say(&mut self.out, &Word::Done)?)
    }

    fn tell(&mut self) -> Result<(), NodeError> {
        // Taken before the observations, and told after them: no release is told whose announcement is not.
        let events: Vec<Event> = self.told.try_iter().collect();
        let mut observed = Vec::new();
        self.untold += self.observations.drain(ROOM, &mut observed);
        for event in observed.iter().filter_map(announcement).chain(events) {
            say(&mut self.out, &Word::Event(event))?;
        }
        Ok(())
    }

    fn count(&mut self) -> Result<(), NodeError> {
        let snapshot = self.node.snapshot(0);
        let (outcomes, acted) = self.probe.counts();
        let injected = self.link.injected();
        let ports = snapshot.tasks.iter().flat_map(|task| {
            let of = task.view.task;
            task.view.ports.iter().map(move |port| (of, port.port, port.counters))
        });
        let dropped = named(&snapshot.link_discards);
        let counted = self.link.inner().counts().filter(|&(_, count)| count > 0);
        let figures = Figures {
            ports: ports.collect(),
            outcomes,
            acted,
            discards: named(&snapshot.discards),
            link_discards: dropped,
            link: counted.map(|(name, count)| (name.to_owned(), count)).collect(),
            lost_on_purpose: injected.lost_packets,
            cut_off: injected.cut_packets,
            untold: self.untold,
        };
        Ok(say(&mut self.out, &Word::Figures(Box::new(figures)))?)
    }
}

/// The counters that counted anything.
fn named(counts: &[Count]) -> BTreeMap<String, u64> {
    counts.iter().filter(|c| c.count > 0).map(|c| (c.name.clone(), c.count)).collect()
}

/// The announcement of a round, if that is what was observed.
fn announcement(event: &TimedEvent) -> Option<Event> {
    let task: TaskId = event.task?;
    let announced = matches!(event.what.event, Observed::Reached | Observed::Rejoined);
    let round = imrs_protocol::Round(u16::try_from(event.what.number).ok()?);
    announced.then_some(Event {
        at: event.mono_us,
        task,
        port: event.what.port,
        round,
        what: What::Announced,
    })
}

/// What is wrong with how a task ended. A program that returns by itself is wrong here, too: all of these run until stopped.
fn trouble(end: &TaskEnd) -> Option<String> {
    match end {
        TaskEnd::Returned => None,
        TaskEnd::Failed(error) => Some(error.to_string()),
        TaskEnd::Panicked(message) => Some(format!("panicked: {message}")),
        TaskEnd::Unfinished => Some("did not end when it was stopped".into()),
    }
}
