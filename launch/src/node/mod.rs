//! Runs one node of a cell under the orders of its launcher. The node has a process or a thread of its own.

pub mod error;
mod message_queue;
mod recorder;
mod reports;
pub mod rt;
mod scripted;
mod way;

pub use error::NodeError;

use crate::cells::{self, Loaded};
use crate::host::Host;
use crate::pipe::{Order, Setup, Word, hear, hear_setup};
use imrs_client::incarnation;
use imrs_protocol::{Incarnation, NodeId, NodeTable};
use imrs_runtime::guard::{GuardProgram, Notices};
use imrs_runtime::link::faulty::FaultyLink;
use imrs_runtime::link::in_process::Network;
use imrs_runtime::link::udp::UdpLink;
use imrs_runtime::observer::{AddressBook, Observer, Place, Showing};
use imrs_runtime::script::{Actions, Commands, Give, Simulated};
use imrs_runtime::{Builder, Observations, Runtime};
use imrs_wire::obs::RealTime;
use message_queue::MessageQueue;
use recorder::NodeRecording;
use rustix::process::{Signal, set_parent_process_death_signal};
use scripted::Narrator;
use std::collections::BTreeMap;
use std::io::{self, BufRead, BufReader, Write};
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::thread;
use std::time::{Duration, Instant};
use way::{Way, socket};

/// How often the node reports events to the launcher.
const TELL_EVERY: Duration = Duration::from_millis(20);
/// How often the node reports its counters. The counters of a killed node are at most this old.
const COUNT_EVERY: Duration = Duration::from_millis(200);
/// How many times a node greets a neighbour that does not answer: once with each report of the counters, so for two
/// seconds.
const GREETINGS: u32 = 10;
/// How long the tasks may take to end when the node stops.
const PATIENCE: Duration = Duration::from_secs(2);

type FaultyWay = FaultyLink<Way>;
/// The pipe to the launcher.
type Words = Box<dyn Write + Send>;

struct Process {
    table: NodeTable,
    link: Arc<FaultyWay>,
    /// Whether this launcher runs no other node of the cell.
    is_alone: bool,
    /// The lock on the node's stored incarnation, if the node runs on its own.
    _state: Option<incarnation::State>,
    /// How many more times the node greets silent neighbours.
    greetings: u32,
    /// The running node; `None` once it has been stopped.
    runtime: Option<Runtime>,
    node: Arc<imrs_runtime::Node>,
    /// The servers of monitors, which end when they are dropped. The first server, at the Unix socket, may be missing.
    _observer: Option<Observer>,
    over_tcp: Option<Observer>,
    /// The TCP addresses at which the other nodes serve monitors.
    observed_at: AddressBook,
    observations: Observations,
    recording: Option<NodeRecording>,
    /// Collects the events of the scripts.
    narrator: Arc<Narrator>,
    untold: u64,
    /// What the recording lacks, in words; known once the recording has ended.
    unrecorded: Option<String>,
    /// Whether the node has got the address book. The scripts begin then, unless they are held back.
    has_book: bool,
    /// When the next script may begin, of those that the restart of the node holds back; `None` if there is none.
    begins: Option<Instant>,
    out: MessageQueue,
}

/// Runs the node that the setup on standard input describes, until the launcher orders a stop, or exits.
///
/// # Errors
/// [`NodeError`].
pub fn run_process(host: &'static dyn Host) -> Result<(), NodeError> {
    // A killed launcher cannot stop its nodes, so the kernel kills them. If this call fails, the end of the pipe stops them.
    let _ = set_parent_process_death_signal(Some(Signal::KILL));
    run(host, BufReader::new(io::stdin()), Box::new(io::stdout()), None)
}

/// Runs the node that the setup in `input` describes, until the launcher orders a stop, or exits. If several nodes
/// share this process, `network` connects them.
///
/// # Errors
/// [`NodeError`].
pub fn run(
    host: &'static dyn Host,
    mut input: impl BufRead + Send + 'static,
    out: Words,
    network: Option<&Arc<Network>>,
) -> Result<(), NodeError> {
    let Some(mut setup) = hear_setup(&mut input)? else { return Ok(()) };
    let (orders, ordered) = mpsc::channel();
    let mut node = Process::start(host, &mut setup, out, network)?;
    let address = node.link.inner().udp().map(UdpLink::local_address);
    let observe = node.over_tcp.as_ref().and_then(|observer| match observer.place() {
        Place::Tcp(address) => Some(*address),
        Place::Unix(_) => None,
    });
    node.out.say(Word::Bound { address, observe })?;
    thread::Builder::new().name("imrs orders".into()).spawn(move || listen(input, &orders))?;
    match node.serve(&ordered)? {
        Leave::InOrder => node.end(),
        Leave::AtOnce => {
            node.die();
            Ok(())
        }
    }
}

/// How a node ends: in order, or as in a power cut.
enum Leave {
    InOrder,
    AtOnce,
}

/// Reads the launcher's orders until the pipe of orders ends.
fn listen(mut input: impl BufRead, orders: &Sender<Order>) {
    while let Ok(Some(order)) = hear(&mut input) {
        if orders.send(order).is_err() {
            return;
        }
    }
}

impl Process {
    fn start(
        host: &'static dyn Host,
        setup: &mut Setup,
        out: Words,
        network: Option<&Arc<Network>>,
    ) -> Result<Self, NodeError> {
        let loaded = cells::load(&setup.cell).map_err(|error| NodeError::Setup(error.to_string()))?;
        let (cell, loaded) = (Arc::clone(&loaded.table), Arc::new(loaded));
        let id = cell.cell().nodes.iter().position(|n| n.name == setup.node).map(NodeId::from_index);
        let id = id.ok_or_else(|| NodeError::Setup(format!("the node `{}`", setup.node)))?;
        let table = NodeTable::new(Arc::clone(&cell), id);
        // Real-time scheduling is set before any other thread of the node starts, because threads inherit it.
        let real_time = if setup.rt { rt::begin(id.index()) } else { RealTime::NotAsked };
        if network.is_none() {
            // A slow reader of standard error must not block the node. If nodes are threads of the launcher, the
            // launcher has already done this.
            rt::behind(|| host.complain_aside())?;
        }

        let (link, state) = joined(host, setup, network, &loaded, &table)?;
        let narrator = Arc::new(Narrator::new(Arc::clone(&loaded)));
        let builder = Runtime::builder(Arc::clone(&cell), id)
            .incarnation(Incarnation(setup.incarnation), setup.restarted)
            .insecure(setup.insecure)
            .real_time(real_time)
            .link(Arc::clone(&link) as Arc<dyn imrs_runtime::link::Link>)
            .actions(actions(host, setup, &loaded)?)
            .watch(Arc::clone(&narrator) as Arc<dyn imrs_runtime::script::Watch>)
            .seed(setup.seed)
            .hold_scripts();
        let mut builder = with_scripts(builder, &loaded, id)?;
        let recording = match &setup.record {
            // The recorder's thread runs at a lower priority than the tasks, like the observer's.
            Some(path) => Some(rt::behind(|| NodeRecording::start(host, path, setup, &loaded, &table))?),
            None => None,
        };
        if let Some(recording) = &recording {
            builder = builder.recorder(recording.recorder());
        }
        let runtime = builder.start()?;
        let node = Arc::clone(runtime.node());
        let observations = node.observe();
        let observed_at = AddressBook::default();
        let mut showing = Showing::new(Arc::clone(&node)).book(observed_at.clone());
        if let (Some(recording), Some(path)) = (&recording, &setup.record) {
            showing = showing.recording(recording.watch(path));
        }
        let (_observer, over_tcp) = observers(host, setup, showing)?;
        Ok(Self {
            table,
            link,
            is_alone: setup.counts,
            _state: state,
            greetings: 0,
            runtime: Some(runtime),
            node,
            _observer,
            over_tcp,
            observed_at,
            observations,
            recording,
            narrator,
            untold: 0,
            unrecorded: None,
            has_book: false,
            begins: None,
            out: rt::behind(move || MessageQueue::start(out))?,
        })
    }

    /// Carries out the launcher's orders, and reports events and counters.
    fn serve(&mut self, orders: &Receiver<Order>) -> Result<Leave, NodeError> {
        let mut counted = Instant::now();
        let mut tell_at = Instant::now() + TELL_EVERY;
        loop {
            let wake = self.begins.map_or(tell_at, |begins| begins.min(tell_at));
            let order = orders.recv_timeout(wake.saturating_duration_since(Instant::now()));
            if self.begins.is_some_and(|begins| begins <= Instant::now()) {
                self.begins = self.runtime.as_ref().and_then(Runtime::begin);
            }
            match order {
                Ok(Order::Book(book)) => self.begin(&book)?,
                Ok(Order::Observed(places)) => self.observed(&places),
                Ok(Order::Cut(name)) => self.set_cut(&name, true),
                Ok(Order::Heal(name)) => self.set_cut(&name, false),
                Ok(Order::Stop) | Err(RecvTimeoutError::Disconnected) => return Ok(Leave::InOrder),
                Ok(Order::Die) => return Ok(Leave::AtOnce),
                Err(RecvTimeoutError::Timeout) if tell_at > Instant::now() => {}
                Err(RecvTimeoutError::Timeout) => {
                    tell_at = Instant::now() + TELL_EVERY;
                    // A stopped launcher must not block the node. While the queue to the launcher is full, events stay
                    // in bounded buffers, which count the events that they drop.
                    if !self.out.has_room() {
                        continue;
                    }
                    self.tell()?;
                    if counted.elapsed() >= COUNT_EVERY {
                        counted = Instant::now();
                        self.count()?;
                        self.greet();
                    }
                }
            }
        }
    }

    fn begin(&mut self, book: &BTreeMap<String, SocketAddr>) -> Result<(), NodeError> {
        for (name, &address) in book {
            if let Some(node) = self.node_named(name).filter(|&node| node != self.table.node) {
                // This gives an error for a node without a link to this one. The error is ignored, because this node
                // does not need that address.
                let _ = self.link.inner().udp().map(|udp| udp.set_address(node, Some(address)));
            }
        }
        self.greetings = GREETINGS;
        self.greet();
        if !std::mem::replace(&mut self.has_book, true) {
            self.begins = self.runtime.as_ref().and_then(Runtime::begin);
            let held = self.node.held_back().tasks;
            if !held.is_empty() {
                let held = held.into_iter().map(|held| (held.task, held.remaining.0)).collect();
                self.out.say(Word::HeldBack(held))?;
            }
        }
        Ok(self.out.say(Word::Started)?)
    }

    /// Greets the neighbours from which nothing was received yet, so that both sides learn early whether they can
    /// communicate.
    fn greet(&mut self) {
        if self.greetings > 0 {
            self.greetings -= 1;
            self.link.inner().udp().map(UdpLink::greet);
        }
    }

    /// Stores the TCP addresses of the other nodes' observers, for monitors.
    fn observed(&self, places: &BTreeMap<String, SocketAddr>) {
        for (name, &address) in places {
            if let Some(node) = self.node_named(name).filter(|&node| node != self.table.node) {
                self.observed_at.put(node, address);
            }
        }
    }

    fn set_cut(&self, name: &str, cut: bool) {
        if let Some(node) = self.node_named(name) {
            self.link.set_cut(node, cut);
        }
    }

    fn node_named(&self, name: &str) -> Option<NodeId> {
        self.table.cell().nodes.iter().position(|n| n.name == name).map(NodeId::from_index)
    }

    /// Stops the node as a power cut would: all links are cut first, so that nothing more leaves the node.
    fn die(mut self) {
        for neighbour in self.table.neighbours(self.table.node) {
            self.link.set_cut(neighbour, true);
        }
        drop(self.runtime.take().map(|runtime| runtime.stop(PATIENCE)));
    }

    /// Stops the tasks, tells the neighbours that the node stops if they go on, reports all remaining events, and ends
    /// the recording.
    fn end(mut self) -> Result<(), NodeError> {
        // The events have already reported how the scripts ended, so the returned values are not needed.
        let stop = if self.is_alone { Runtime::leave } else { Runtime::stop };
        drop(self.runtime.take().map(|runtime| stop(runtime, PATIENCE)));
        self.tell()?;
        self.count()?;
        // The recording stops only now, after the counters were sent, because the counters must reach the launcher even
        // if the disk is slow.
        self.unrecorded = self.recording.take().and_then(|recording| recording.stop(PATIENCE));
        if self.unrecorded.is_some() {
            self.count()?;
        }
        self.out.say(Word::Done)?;
        Ok(self.out.end()?)
    }
}

/// Makes the link of a node to its neighbours. Also returns the lock on the node's stored incarnation, if it runs on its own.
fn joined(
    host: &'static dyn Host,
    setup: &mut Setup,
    network: Option<&Arc<Network>>,
    loaded: &Loaded,
    table: &NodeTable,
) -> Result<(Arc<FaultyWay>, Option<incarnation::State>), NodeError> {
    let (way, state) = match network {
        Some(network) => {
            let joined = network.join(table.node, Incarnation(setup.incarnation), setup.restarted);
            (Way::InProcess(joined), None)
        }
        None => {
            let (link, state) = socket(host, setup, loaded, table)?;
            (Way::Udp(Box::new(link)), state)
        }
    };
    // Each node has another seed for its losses, so that no two links lose the same datagrams.
    let link = Arc::new(FaultyLink::new(way, setup.seed.wrapping_add(u64::from(table.node.0))));
    link.set_loss(setup.loss);
    Ok((link, state))
}

/// Adds the scripts of the node's tasks.
fn with_scripts(mut builder: Builder, loaded: &Loaded, node: NodeId) -> Result<Builder, NodeError> {
    for task in loaded.table.tasks_on(node) {
        let name = &loaded.table.cell().tasks[task.index()].name;
        let program = loaded.program(task);
        let program = program.ok_or_else(|| NodeError::Setup(format!("the extern task `{name}`")))?;
        builder = builder.script(name, Arc::clone(program));
    }
    Ok(builder)
}

/// Starts the servers of monitors: at the Unix socket, which may fail, and over TCP if the setup asks for that.
fn observers(
    host: &'static dyn Host,
    setup: &Setup,
    showing: Showing,
) -> Result<(Option<Observer>, Option<Observer>), NodeError> {
    let showing = showing.token(setup.observe_token.clone());
    let (observer, over_tcp) = rt::behind(|| {
        let over_tcp = setup.observe.map(|address| showing.clone().start_tcp(address));
        (showing.start(), over_tcp)
    });
    if let Err(error) = &observer {
        host.complain(&format_args!("node {} runs, but no monitor can see it: {error}", setup.node));
    }
    Ok((observer.ok(), over_tcp.transpose()?))
}

/// Makes the executor of the scripts' actions: commands for actions that have one, a simulation for all others.
fn actions(host: &'static dyn Host, setup: &Setup, loaded: &Loaded) -> Result<Arc<dyn Actions>, NodeError> {
    let results = loaded.results();
    let reals = results.iter().filter(|result| matches!(result.give, Give::Real(..)));
    let reals: Vec<String> = reals.map(|result| result.name.clone()).collect();
    let simulated = Simulated::start(setup.seed, results, setup.ramps.clone())?;
    let commands = Commands::new(setup.actions.clone(), simulated).guard(GuardProgram::This);
    let mut commands = commands.cores(rt::cores()).reals(reals);
    if let Some(path) = &setup.notices {
        let of = format!("{}-{}", setup.node, setup.incarnation);
        commands = commands.notices(Notices::open(path)?, &of);
    }
    let failed = |action: &str, error: &_| host.complain(&format_args!("action `{action}`: {error}"));
    Ok(Arc::new(commands.tell(failed)))
}
