//! Runs nodes of a cell file from a Rust program, with Rust functions for actions and extern tasks.

use crate::cells::{self, Loaded, Source};
use crate::launch::error::PlaceError;
use crate::launch::incarnation::{self, Counted, State};
use crate::launch::place;
use imrs_protocol::{Incarnation, NodeId};
use imrs_runtime::link::Link;
use imrs_runtime::link::in_process::{Faults, Network};
use imrs_runtime::link::udp::UdpError;
use imrs_runtime::observer::{Observer, ObserverError, Showing};
use imrs_runtime::script::{Actions, Call, Functions, Simulated};
use imrs_runtime::{Context, Runtime, StartError, TaskEnd, TaskError};
use imrs_wire::obs::{Token, TokenError};
use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How long the tasks have to end after the run has been stopped.
const PATIENCE: Duration = Duration::from_secs(2);
/// Poll interval for the ends of the tasks.
const LOOK_EVERY: Duration = Duration::from_millis(10);

type Body = Box<dyn FnOnce(&mut Context) -> Result<(), TaskError> + Send>;

/// Why a program cannot run its nodes.
#[derive(Debug, thiserror::Error)]
pub enum ProgramError {
    /// The file cannot be read, or the cell has errors.
    #[error("{0}")]
    Cell(String),
    /// The cell has no task of this name.
    #[error("the cell has no task `{0}`")]
    NoTask(String),
    /// The cell has no action of this name.
    #[error("the cell has no action `{0}`")]
    NoAction(String),
    /// The cell has no node of this name.
    #[error("the cell has no node `{0}`")]
    NoNode(String),
    /// The task has a script in the cell. Only an extern task takes a body in Rust.
    #[error(
        "task `{0}` has a script in the cell; write `task {0} on … extern` there to give it a body in Rust"
    )]
    NotExtern(String),
    /// The extern task runs on a node of this program, and has no body.
    #[error("task `{0}` is extern and was given no body: call `body(\"{0}\", …)`")]
    NoBody(String),
    /// The node's address is no loopback address, and nothing authenticates its packets.
    #[error(
        "node `{0}` at {1}: nothing authenticates its packets; call `insecure()` on a network of your own"
    )]
    Insecure(String, SocketAddr),
    /// The observer address is reachable from other machines, and no token is required of monitors.
    #[error(
        "monitors at {0}: any machine that reaches this address could watch, because no token is asked for; call `observe_token(…)`, or take a loopback address"
    )]
    Watched(SocketAddr),
    /// The text is not a valid token.
    #[error(transparent)]
    Token(#[from] TokenError),
    /// The node cannot run on its own: it has no address, or runs already, or cannot store its incarnation.
    #[error(transparent)]
    Place(#[from] PlaceError),
    /// The UDP socket of the node cannot be opened.
    #[error(transparent)]
    Link(#[from] UdpError),
    /// A node did not start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// Monitors cannot be served.
    #[error(transparent)]
    Observe(#[from] ObserverError),
    /// The operating system refused a thread.
    #[error("cannot start the actions: {0}")]
    Actions(io::Error),
}

/// Nodes of a cell file, with Rust functions for its actions and Rust bodies for its extern tasks.
///
/// All nodes run as threads of this process and exchange packets in memory. With [`node`](Self::node) one of them runs,
/// over UDP at the address that the cell declares for it. Actions without a function are simulated. Monitors find the nodes
/// as they find those of `imrs run`.
///
/// ```no_run
/// # fn main() -> Result<(), imrs::ProgramError> {
/// let ends = imrs::Program::open("examples/extern_task.cell")?
///     .action("pick", |call| if call.arguments[0] < 500 { Ok(0) } else { Err("out of reach".into()) })
///     .body("camera", |ctx| ctx.delay(std::time::Duration::from_secs(1)))
///     .run(Some(std::time::Duration::from_secs(5)))?;
/// for (task, end) in ends {
///     println!("{task}: {end:?}");
/// }
/// # Ok(())
/// # }
/// ```
#[must_use = "nothing runs before `run`"]
pub struct Program {
    loaded: Loaded,
    actions: Vec<(String, Function)>,
    bodies: BTreeMap<String, Body>,
    node: Option<String>,
    insecure: bool,
    observe: Option<SocketAddr>,
    token: Option<String>,
    seed: u64,
}

type Function = Box<dyn Fn(&Call) -> Result<i32, String> + Send + Sync>;

/// A running node.
struct Running {
    runtime: Runtime,
    /// The lock on the node's stored incarnation, if the node runs on its own.
    _state: Option<State>,
    /// Monitors are served until these are dropped.
    _observers: Vec<Observer>,
}

impl Program {
    /// The cell of a file.
    ///
    /// # Errors
    /// [`ProgramError::Cell`], with the compiler's diagnostics.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, ProgramError> {
        let (_, loaded) =
            cells::open(path.as_ref(), false).map_err(|error| ProgramError::Cell(error.to_string()))?;
        Ok(Self::of(loaded))
    }

    /// The cell of a text; `name` stands for its file in diagnostics.
    ///
    /// # Errors
    /// [`ProgramError::Cell`], with the compiler's diagnostics.
    pub fn of_text(name: &str, text: &str) -> Result<Self, ProgramError> {
        let source = Source { name: name.into(), text: text.into(), paper: false };
        cells::load(&source).map(Self::of).map_err(|error| ProgramError::Cell(error.to_string()))
    }

    fn of(loaded: Loaded) -> Self {
        Self {
            loaded,
            actions: Vec::new(),
            bodies: BTreeMap::new(),
            node: None,
            insecure: false,
            observe: None,
            token: None,
            seed: 0,
        }
    }

    /// The function that carries out an action of any task. It returns the result (a `real` as its bits), or why the action
    /// failed. Each call runs on a thread of its own; a panic counts as a failure.
    pub fn action(
        mut self,
        name: &str,
        function: impl Fn(&Call) -> Result<i32, String> + Send + Sync + 'static,
    ) -> Self {
        self.actions.push((name.into(), Box::new(function)));
        self
    }

    /// The body of an extern task. It runs once, on a thread of its own.
    pub fn body(
        mut self,
        task: &str,
        body: impl FnOnce(&mut Context) -> Result<(), TaskError> + Send + 'static,
    ) -> Self {
        self.bodies.insert(task.into(), Box::new(body));
        self
    }

    /// Runs only this node, at the address that the cell declares; the others run elsewhere, as by `imrs run --node`.
    pub fn node(mut self, name: &str) -> Self {
        self.node = Some(name.into());
        self
    }

    /// Lets the node's packets leave this machine though nothing authenticates them.
    pub const fn insecure(mut self) -> Self {
        self.insecure = true;
        self
    }

    /// Also serves monitors at this TCP address; several nodes take successive ports. An address off the loopback requires
    /// [`observe_token`](Self::observe_token).
    pub const fn observe(mut self, address: SocketAddr) -> Self {
        self.observe = Some(address);
        self
    }

    /// Over TCP, serves only monitors that present this token, of 16 to 256 bytes.
    pub fn observe_token(mut self, token: &str) -> Self {
        self.token = Some(token.into());
        self
    }

    /// The seed of everything that is simulated or random.
    pub const fn seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// Runs the nodes until all their tasks have ended, at most for `length`, then stops them. Returns how each task ended.
    ///
    /// # Errors
    /// [`ProgramError`]; then nothing keeps running.
    pub fn run(mut self, length: Option<Duration>) -> Result<Vec<(String, TaskEnd)>, ProgramError> {
        let nodes = self.nodes()?;
        self.check(&nodes)?;
        let actions = self.all_actions()?;
        let table = Arc::clone(&self.loaded.table);
        let network = Network::new(table, Faults::default());
        let mut running = Vec::new();
        for (after, node) in nodes.into_iter().enumerate() {
            running.push(self.start(node, after, &network, Arc::clone(&actions))?);
        }
        // Scripts of a restarted node are held back at first (D94). `length` counts from when all have begun.
        let begin = || running.iter().filter_map(|node: &Running| node.runtime.begin()).min();
        let (mut begins, mut end) = (begin(), None);
        loop {
            if begins.is_some_and(|at| at <= Instant::now()) {
                begins = begin();
            }
            if begins.is_none() && end.is_none() {
                end = length.map(|length| Instant::now() + length);
            }
            let is_over = end.is_some_and(|end| Instant::now() >= end);
            if is_over || running.iter().all(|node| node.runtime.wait(Duration::ZERO)) {
                break;
            }
            let next = begins.into_iter().chain(end).min();
            let left = next.map_or(LOOK_EVERY, |next| next.saturating_duration_since(Instant::now()));
            std::thread::sleep(left.min(LOOK_EVERY));
        }
        Ok(running.into_iter().flat_map(|node| node.runtime.stop(PATIENCE)).collect())
    }

    /// The nodes that run here.
    fn nodes(&self) -> Result<Vec<NodeId>, ProgramError> {
        let all = &self.loaded.table.cell().nodes;
        let Some(name) = &self.node else { return Ok((0..all.len()).map(NodeId::from_index).collect()) };
        let node = all.iter().position(|node| node.name == *name).map(NodeId::from_index);
        let node = node.ok_or_else(|| ProgramError::NoNode(name.clone()))?;
        let address = place::address(&self.loaded, node)?;
        if !self.insecure && !address.ip().is_loopback() {
            return Err(ProgramError::Insecure(name.clone(), address));
        }
        Ok(vec![node])
    }

    fn check(&self, nodes: &[NodeId]) -> Result<(), ProgramError> {
        let tasks = &self.loaded.table.cell().tasks;
        for name in self.bodies.keys() {
            let at = tasks.iter().position(|task| task.name == *name);
            let at = at.ok_or_else(|| ProgramError::NoTask(name.clone()))?;
            if self.loaded.scripts[at].is_some() {
                return Err(ProgramError::NotExtern(name.clone()));
            }
        }
        for (task, script) in tasks.iter().zip(&self.loaded.scripts) {
            let here = nodes.contains(&task.node);
            if here && script.is_none() && !self.bodies.contains_key(&task.name) {
                return Err(ProgramError::NoBody(task.name.clone()));
            }
        }
        let unknown = self.actions.iter().find(|(name, _)| !self.loaded.actions().any(|known| known == name));
        unknown.map_or(Ok(()), |(name, _)| Err(ProgramError::NoAction(name.clone())))
    }

    fn all_actions(&mut self) -> Result<Arc<dyn Actions>, ProgramError> {
        let simulated = Simulated::start(self.seed, self.loaded.results(), Vec::new());
        let mut functions = Functions::new(simulated.map_err(ProgramError::Actions)?);
        for (name, function) in std::mem::take(&mut self.actions) {
            functions = functions.action(&name, function);
        }
        Ok(Arc::new(functions))
    }

    fn start(
        &mut self,
        node: NodeId,
        after: usize,
        network: &Arc<Network>,
        actions: Arc<dyn Actions>,
    ) -> Result<Running, ProgramError> {
        let table = Arc::clone(&self.loaded.table);
        let mut builder = Runtime::builder(Arc::clone(&table), node)
            .insecure(true)
            .actions(actions)
            .seed(self.seed)
            .hold_scripts();
        let mut state = None;
        builder = match &self.node {
            Some(_) => {
                let (link, counted) = self.link(node)?;
                builder = builder.incarnation(counted.incarnation, counted.restarted).link(link);
                state = Some(counted.state);
                builder
            }
            None => builder.link(Arc::new(network.join(node, Incarnation(0), false))),
        };
        for task in table.tasks_on(node) {
            let name = &table.cell().tasks[task.index()].name;
            builder = match (&self.loaded.scripts[task.index()], self.bodies.remove(name)) {
                (Some(script), _) => builder.script(name, Arc::clone(&script.program)),
                (None, Some(body)) => builder.task(name, body),
                // `check` has refused this already.
                (None, None) => return Err(ProgramError::NoBody(name.clone())),
            };
        }
        let runtime = builder.start()?;
        let mut observers = vec![];
        // A node runs without its Unix socket, too. A TCP address was asked for, so failing to bind it is an error.
        observers.extend(Observer::start(Arc::clone(runtime.node())).ok());
        if let Some(first) = self.observe {
            let address = crate::launch::observed_at(first, after);
            let token = self.token.as_deref().map(Token::of).transpose()?;
            if token.is_none() && !address.ip().is_loopback() {
                return Err(ProgramError::Watched(address));
            }
            observers.push(Showing::new(Arc::clone(runtime.node())).token(token).start_tcp(address)?);
        }
        Ok(Running { runtime, _state: state, _observers: observers })
    }

    fn link(&self, node: NodeId) -> Result<(Arc<dyn Link>, Counted), ProgramError> {
        let address = place::address(&self.loaded, node)?;
        let (link, counted) = incarnation::bind::<ProgramError>(&self.loaded, node, address)?;
        link.greet();
        Ok((Arc::new(link), counted))
    }
}
