//! The nodes of a run as child processes of the launcher (D64), or as threads of its process.

use crate::error::LaunchError;
use crate::host::Host;
use crate::node::{self, NodeError};
use crate::pipe::{Order, Setup, Word, hear, say, say_setup};
use imrs_protocol::NodeId;
use imrs_runtime::link::in_process::Network;
use rustix::process::{Pid, Signal, kill_process};
use signal_hook::consts::{SIGABRT, SIGBUS, SIGILL, SIGSEGV};
use std::fmt;
use std::io::{self, BufReader, PipeReader, Read, Write};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::mpsc::SyncSender;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// A message that the launcher receives.
#[derive(Debug)]
pub enum Message {
    /// A message from a node.
    Said(NodeId, Word),
    /// The pipe of a node in this incarnation (counted from 0) has ended: its process has exited, or soon will.
    Gone(NodeId, usize),
    /// The user wants the run to end.
    Interrupted,
}

/// All node processes. No process outlives the launcher.
pub struct Children {
    processes: Vec<Process>,
    network: Option<Arc<Network>>,
    messages: SyncSender<Message>,
    host: &'static dyn Host,
}

struct Process {
    node: NodeId,
    name: String,
    /// The number of the node's incarnations before this one.
    incarnation: usize,
    body: Body,
    /// The pipe for orders to the node; `None` once the pipe has failed or was closed.
    orders: Option<Box<dyn Write + Send>>,
    killed: bool,
}

/// The process or thread in which a node runs.
enum Body {
    Process(Child),
    /// The thread of the node; `None` once it has been joined.
    Thread(Option<JoinHandle<Result<(), NodeError>>>),
}

/// The pipe from which the launcher reads a node's messages.
type Words = Box<dyn Read + Send>;

impl Children {
    /// Starts a node for each setup: a process of its own, or a thread if `network` joins the nodes. The nodes'
    /// messages go to `messages`.
    ///
    /// # Errors
    /// An error if a process or a thread cannot be started.
    pub fn start(
        setups: &[(NodeId, Setup)],
        network: Option<Arc<Network>>,
        messages: SyncSender<Message>,
        host: &'static dyn Host,
    ) -> Result<Self, LaunchError> {
        let mut children = Self { processes: Vec::new(), network, messages, host };
        for (node, setup) in setups {
            let process = children.begin(*node, setup, 0)?;
            children.processes.push(process);
        }
        Ok(children)
    }

    /// Restarts a killed node with this setup.
    ///
    /// # Errors
    /// An error if a process or a thread cannot be started.
    pub fn restart(&mut self, node: NodeId, setup: &Setup) -> Result<(), LaunchError> {
        let Some(at) = self.processes.iter().position(|process| process.node == node) else { return Ok(()) };
        let before = &mut self.processes[at];
        // The process or thread of the previous incarnation must end first.
        before.orders = None;
        before.end(Instant::now() + BURIAL, self.host);
        let incarnation = before.incarnation + 1;
        self.processes[at] = self.begin(node, setup, incarnation)?;
        Ok(())
    }

    fn begin(&self, node: NodeId, setup: &Setup, incarnation: usize) -> Result<Process, LaunchError> {
        let (body, mut orders, words) = match &self.network {
            Some(network) => as_thread(setup, network, self.host),
            None => as_process(),
        }
        .map_err(LaunchError::Start)?;
        // If the node has already exited, writing fails; the end of its pipe reports that.
        let _ = say_setup(&mut orders, setup);
        let messages = self.messages.clone();
        let reader = thread::Builder::new().name(format!("imrs {}", setup.node));
        reader.spawn(move || listen((node, incarnation), words, &messages)).map_err(LaunchError::Start)?;
        Ok(Process { node, name: setup.node.clone(), incarnation, body, orders: Some(orders), killed: false })
    }

    /// The program that started the nodes and of which the launcher is a part.
    pub const fn host(&self) -> &'static dyn Host {
        self.host
    }

    /// How many nodes there are.
    pub fn len(&self) -> usize {
        self.processes.len()
    }

    /// Whether the nodes are threads of this process.
    pub const fn in_one_process(&self) -> bool {
        self.network.is_some()
    }

    /// The nodes that this launcher runs.
    pub fn nodes(&self) -> impl Iterator<Item = NodeId> {
        self.processes.iter().map(|process| process.node)
    }

    /// The id of the process in which a node runs.
    pub fn pid(&self, node: NodeId) -> u32 {
        match self.of(node).map(|process| &process.body) {
            Some(Body::Process(child)) => child.id(),
            Some(Body::Thread(_)) | None => std::process::id(),
        }
    }

    /// The name of a node.
    pub fn name(&self, node: NodeId) -> &str {
        self.of(node).map_or("?", |process| &process.name)
    }

    /// Whether this is the node's current incarnation, and the launcher has not killed it.
    pub fn runs(&self, node: NodeId, incarnation: usize) -> bool {
        self.of(node).is_some_and(|process| process.incarnation == incarnation && !process.killed)
    }

    /// The number of a node's current incarnation, from 0.
    pub fn incarnation(&self, node: NodeId) -> usize {
        self.of(node).map_or(0, |process| process.incarnation)
    }

    fn of(&self, node: NodeId) -> Option<&Process> {
        self.processes.iter().find(|process| process.node == node)
    }

    /// Sends an order to all nodes. Nodes that have exited do not receive it.
    pub fn order_all(&mut self, order: &Order) {
        for process in &mut self.processes {
            process.order(order);
        }
    }

    /// Sends an order to a node.
    pub fn order(&mut self, node: NodeId, order: &Order) {
        if let Some(process) = self.processes.iter_mut().find(|process| process.node == node) {
            process.order(order);
        }
    }

    /// Kills a node, as a power cut would.
    pub fn kill(&mut self, node: NodeId) {
        let Some(process) = self.processes.iter_mut().find(|process| process.node == node) else { return };
        match &mut process.body {
            // If this fails, the process has already exited; the end of its pipe reports that.
            Body::Process(child) => drop(child.kill()),
            Body::Thread(_) => process.order(&Order::Die),
        }
        process.killed = true;
    }

    /// Suspends the process of a node, or resumes it. Returns whether the node has a process of its own.
    pub fn stand_still(&mut self, node: NodeId, stands: bool) -> bool {
        let Some(process) = self.of(node) else { return false };
        let Body::Process(child) = &process.body else { return false };
        let signal = if stands { Signal::STOP } else { Signal::CONT };
        // If this fails, the process has already exited; the end of its pipe reports that.
        let _ = kill_process(Pid::from_child(child), signal);
        true
    }

    /// Waits for all nodes to end, at most for `patience`, then kills those that have not ended. Returns how each node ended.
    pub fn wait(&mut self, patience: Duration) -> Vec<(NodeId, End)> {
        let deadline = Instant::now() + patience;
        // A node that did not get the order to stop stops when its pipe ends.
        self.processes.iter_mut().for_each(|process| process.orders = None);
        let host = self.host;
        self.processes.iter_mut().map(|process| (process.node, process.end(deadline, host))).collect()
    }
}

impl Process {
    fn order(&mut self, order: &Order) {
        let failed = self.orders.as_mut().is_some_and(|pipe| say(pipe, order).is_err());
        if failed {
            self.orders = None;
        }
    }

    fn end(&mut self, deadline: Instant, host: &dyn Host) -> End {
        let killed = self.killed;
        match &mut self.body {
            Body::Process(child) => end_of_process(child, killed, deadline),
            Body::Thread(thread) => {
                while thread.as_ref().is_some_and(|thread| !thread.is_finished()) {
                    if Instant::now() >= deadline {
                        return End::Hung;
                    }
                    thread::sleep(Duration::from_millis(2));
                }
                match thread.take().map(JoinHandle::join) {
                    // The thread of a node whose restart failed was joined before, so there is none here.
                    Some(Ok(Ok(()))) | None if killed => End::Killed,
                    Some(Ok(Ok(()))) => End::Clean,
                    Some(Ok(Err(error))) => End::Code(host.exit_code(Some(&error))),
                    Some(Err(_)) | None => End::Code(host.exit_code(None)),
                }
            }
        }
    }
}

fn end_of_process(child: &mut Child, killed: bool, deadline: Instant) -> End {
    loop {
        match child.try_wait() {
            Ok(Some(status)) => return End::of(status, killed),
            Ok(None) if Instant::now() < deadline => thread::sleep(Duration::from_millis(2)),
            Ok(None) => {
                let _ = child.kill();
                let _ = child.wait();
                return End::Hung;
            }
            Err(_) => return End::Hung,
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if let Body::Process(child) = &mut self.body
            && let Ok(None) = child.try_wait()
        {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

fn as_process() -> io::Result<(Body, Box<dyn Write + Send>, Words)> {
    let mut child = Command::new(std::env::current_exe()?)
        .arg("node")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        // In its own process group the node does not get Ctrl-C. The launcher gets it, and stops its nodes in order.
        .process_group(0)
        .spawn()?;
    let (orders, words) = (child.stdin.take(), child.stdout.take());
    let missing = || io::Error::other("no pipe");
    let orders = Box::new(orders.ok_or_else(missing)?);
    let words = Box::new(words.ok_or_else(missing)?);
    Ok((Body::Process(child), orders, words))
}

fn as_thread(
    setup: &Setup,
    network: &Arc<Network>,
    host: &'static dyn Host,
) -> io::Result<(Body, Box<dyn Write + Send>, Words)> {
    let (ordered, orders): (PipeReader, _) = io::pipe()?;
    let (words, told) = io::pipe()?;
    let network = Arc::clone(network);
    let run = move || {
        let ended = node::run(host, BufReader::new(ordered), Box::new(told), Some(&network));
        ended.inspect_err(|error| host.complain(error))
    };
    let thread = thread::Builder::new().name(format!("imrs node {}", setup.node)).spawn(run)?;
    Ok((Body::Thread(Some(thread)), Box::new(orders), Box::new(words)))
}

/// How long the process of a killed node may take to exit before the node's restart.
const BURIAL: Duration = Duration::from_secs(3);

/// How a node's process or thread ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The process ended with exit code 0.
    Clean,
    /// The launcher killed the process, as a scheduled fault.
    Killed,
    /// The process ended with this exit code, which names the problem.
    Code(i32),
    /// A signal that the launcher did not send ended the process.
    Signal(i32),
    /// The process did not exit in time, and was killed.
    Hung,
}

impl End {
    fn of(status: ExitStatus, killed: bool) -> Self {
        match (status.code(), status.signal()) {
            (Some(0), _) => Self::Clean,
            (Some(code), _) => Self::Code(code),
            (None, Some(_)) if killed => Self::Killed,
            (None, signal) => Self::Signal(signal.unwrap_or_default()),
        }
    }

    /// Returns `None` if the process ended as it should; otherwise whether the node itself is at fault.
    pub fn at_fault(self) -> Option<bool> {
        match self {
            Self::Clean | Self::Killed => None,
            Self::Code(_) | Self::Hung => Some(true),
            Self::Signal(signal) => Some(matches!(signal, SIGABRT | SIGSEGV | SIGILL | SIGBUS)),
        }
    }
}

impl fmt::Display for End {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Clean => f.write_str("clean"),
            Self::Killed => f.write_str("killed"),
            Self::Code(code) => write!(f, "exit code {code}"),
            Self::Signal(signal) => write!(f, "ended by signal {signal}"),
            Self::Hung => f.write_str("did not stop: killed"),
        }
    }
}

fn listen((node, incarnation): (NodeId, usize), words: Words, messages: &SyncSender<Message>) {
    let mut words = BufReader::new(words);
    loop {
        let message = match hear(&mut words) {
            Ok(Some(word)) => Message::Said(node, word),
            Ok(None) | Err(_) => Message::Gone(node, incarnation),
        };
        let last = matches!(message, Message::Gone(..));
        if messages.send(message).is_err() || last {
            return;
        }
    }
}
