//! The node processes of a demo, seen from the launcher (D64).

use super::launcher::DemoError;
use super::lines::{Order, Setup, Word, hear, say};
use imrs_protocol::NodeId;
use signal_hook::consts::{SIGABRT, SIGBUS, SIGILL, SIGSEGV};
use std::fmt;
use std::io::BufReader;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::mpsc::Sender;
use std::thread;
use std::time::{Duration, Instant};

/// What reaches the launcher.
#[derive(Debug)]
pub enum Message {
    /// A node said something.
    Said(NodeId, Word),
    /// A node's pipe has ended: its process has, or soon will.
    Gone(NodeId),
    /// The user wants the run to end.
    Interrupted,
}

/// All node processes. Whatever happens to the launcher, none outlives it.
pub struct Children(Vec<Process>);

struct Process {
    name: String,
    child: Child,
    /// Here while orders can be given.
    orders: Option<ChildStdin>,
    killed: bool,
}

impl Children {
    /// Starts one process for each setup; what they say goes to `messages`.
    ///
    /// # Errors
    /// A process or a thread cannot be started.
    pub fn start(setups: &[Setup], messages: &Sender<Message>) -> Result<Self, DemoError> {
        let program = std::env::current_exe().map_err(DemoError::Start)?;
        let mut children = Self(Vec::new());
        for (i, setup) in setups.iter().enumerate() {
            let mut child = Command::new(&program)
                .arg("node")
                .stdin(Stdio::piped())
                .stdout(Stdio::piped())
                // Ctrl-C reaches the launcher alone, which ends its nodes in order.
                .process_group(0)
                .spawn()
                .map_err(DemoError::Start)?;
            let (mut orders, words) = (child.stdin.take(), child.stdout.take());
            let told = orders.as_mut().map(|pipe| say(pipe, setup));
            children.0.push(Process { name: setup.node.clone(), child, orders, killed: false });
            // A node that is gone already says so by the end of its pipe.
            drop(told);
            if let Some(words) = words {
                let messages = messages.clone();
                let reader = thread::Builder::new().name(format!("imrs {}", setup.node));
                reader
                    .spawn(move || listen(NodeId::from_index(i), words, &messages))
                    .map_err(DemoError::Start)?;
            }
        }
        Ok(children)
    }

    /// The process of a node.
    pub fn pid(&self, node: NodeId) -> u32 {
        self.0[node.index()].child.id()
    }

    /// The name of a node.
    pub fn name(&self, node: NodeId) -> &str {
        &self.0[node.index()].name
    }

    /// Gives all nodes an order. Those that are gone do not hear it.
    pub fn order_all(&mut self, order: &Order) {
        for process in &mut self.0 {
            process.order(order);
        }
    }

    /// Gives a node an order.
    pub fn order(&mut self, node: NodeId, order: &Order) {
        self.0[node.index()].order(order);
    }

    /// Kills a node, as a power cut would.
    pub fn kill(&mut self, node: NodeId) {
        let process = &mut self.0[node.index()];
        // It is gone already; that is seen later.
        let _ = process.child.kill();
        process.killed = true;
    }

    /// Waits until all processes have ended, at most so long; then kills those that have not. Returns how each ended.
    pub fn wait(mut self, patience: Duration) -> Vec<End> {
        let deadline = Instant::now() + patience;
        // Whoever has not heard the order sees the end of the pipe.
        self.0.iter_mut().for_each(|process| process.orders = None);
        self.0.iter_mut().map(|process| process.end(deadline)).collect()
    }
}

impl Process {
    fn order(&mut self, order: &Order) {
        let failed = self.orders.as_mut().is_some_and(|pipe| say(pipe, order).is_err());
        if failed {
            self.orders = None;
        }
    }

    fn end(&mut self, deadline: Instant) -> End {
        loop {
            match self.child.try_wait() {
                Ok(Some(status)) => return End::of(status, self.killed),
                Ok(None) if Instant::now() < deadline => thread::sleep(Duration::from_millis(2)),
                Ok(None) => {
                    let _ = self.child.kill();
                    let _ = self.child.wait();
                    return End::Hung;
                }
                Err(_) => return End::Hung,
            }
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if let Ok(None) = self.child.try_wait() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

/// How a node's process ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// As it should.
    Clean,
    /// Killed by the launcher, as the schedule of faults says.
    Killed,
    /// With a code that says what went wrong.
    Code(i32),
    /// By a signal of somebody else.
    Signal(i32),
    /// It did not, and was killed.
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

    /// `None` where it ended as it should; otherwise whether it is at fault itself.
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

fn listen(node: NodeId, words: ChildStdout, messages: &Sender<Message>) {
    let mut words = BufReader::new(words);
    loop {
        let message = match hear(&mut words) {
            Ok(Some(word)) => Message::Said(node, word),
            Ok(None) | Err(_) => Message::Gone(node),
        };
        let last = matches!(message, Message::Gone(_));
        if messages.send(message).is_err() || last {
            return;
        }
    }
}
