//! Runs nodes of a cell file from a Rust program, with Rust functions for actions and extern tasks.

use crate::cells::{self, Loaded};
use crate::error::ProgramError;
use crate::incarnation::{self, Counted, State};
use crate::keys;
use crate::place;
use imrs_protocol::{Incarnation, NodeId};
use imrs_runtime::link::Link;
use imrs_runtime::link::in_process::{Faults, Network};
use imrs_runtime::observer::{Observer, Showing};
use imrs_runtime::script::{Actions, Call, Functions, Simulated};
use imrs_runtime::{AsyncContext, Builder, Context, Runtime, TaskEnd, TaskError};
use imrs_wire::obs::Token;
use imrs_wire::text::one_line;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// How long the tasks may take to end after the run has been stopped.
const PATIENCE: Duration = Duration::from_secs(2);
/// How often the run checks whether the tasks have ended.
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// Adds the program of an extern task to the builder of the task's node. The program waits for the [`Gate`] before it begins.
type Adds = Box<dyn FnOnce(Builder, Gate) -> Builder + Send>;

/// Nodes of a cell file, with Rust functions for its actions and its extern tasks.
///
/// All nodes run as threads of this process and exchange packets in memory. With [`node`](Self::node) only one of them
/// runs, over UDP at the address that the cell declares for it. Actions without a function are simulated. Monitors find
/// the nodes as they find those of `imrs run`.
///
/// Call [`open`](Self::open) or [`of_text`](Self::of_text) first, then the methods that add functions and
/// options, in any order, and last [`run`](Self::run), which starts the nodes and returns when they have
/// ended.
///
/// ```
/// use imrs_client::{Program, TaskEnd};
/// use std::time::Duration;
///
/// # fn main() -> Result<(), imrs_client::ProgramError> {
/// const CELL: &str = "cell lift;
/// tick 1 msec;
/// node here;
/// task watch on here extern
/// end watch;
/// task robot on here
/// begin
///   run grip 40 takes 10..5000 msec;
///   run rise takes 10..20 msec;
/// end robot;
/// ";
/// let ends = Program::of_text("lift.cell", CELL)?
///     .task("watch", |ctx| ctx.delay(Duration::from_millis(5)))
///     .action("grip", |call| if call.arguments[0] < 500 { Ok(0) } else { Err("too wide".into()) })
///     // `rise` has no function, so it is simulated: it takes 10 to 20 ms.
///     .seed(7)
///     .run(Some(Duration::from_secs(60)))?;
/// assert_eq!(ends[0], ("watch".to_owned(), TaskEnd::Returned));
/// assert!(matches!(ends[1].1, TaskEnd::Script(_)), "{ends:?}");
/// # Ok(())
/// # }
/// ```
#[must_use = "nothing runs before `run`"]
pub struct Program {
    loaded: Loaded,
    actions: Vec<(String, Function)>,
    tasks: BTreeMap<String, Adds>,
    node: Option<String>,
    insecure: bool,
    keys: Option<PathBuf>,
    /// The folder in which keys are looked for if the program names no folder.
    beside: Option<PathBuf>,
    observe: Option<SocketAddr>,
    token: Option<String>,
    seed: u64,
}

type Function = Box<dyn Fn(&Call) -> Result<i32, String> + Send + Sync>;

/// The gate says once whether the programs of extern tasks begin: true if all nodes of this process have started, false if
/// one of them has not.
type Gate = Arc<OnceLock<bool>>;

/// A running node.
struct Running {
    runtime: Runtime,
    /// The lock on the node's stored incarnation, if the node runs on its own.
    _state: Option<State>,
    /// The servers of the node's monitors, which end when these values are dropped.
    _observers: Vec<Observer>,
}

impl Program {
    /// Compiles the cell of a file.
    ///
    /// # Errors
    /// [`ProgramError::Cell`], with the compiler's diagnostics.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, ProgramError> {
        let loaded = cells::open(path.as_ref(), false);
        let mut program = loaded.map(Self::of).map_err(|error| ProgramError::Cell(error.to_string()))?;
        program.beside = Some(keys::beside(path.as_ref()));
        Ok(program)
    }

    /// Compiles the cell of a text. Diagnostics show `name` as its file.
    ///
    /// # Errors
    /// [`ProgramError::Cell`], with the compiler's diagnostics.
    pub fn of_text(name: &str, text: &str) -> Result<Self, ProgramError> {
        cells::load(name, text, false).map(Self::of).map_err(|error| ProgramError::Cell(error.to_string()))
    }

    fn of(loaded: Loaded) -> Self {
        Self {
            loaded,
            actions: Vec::new(),
            tasks: BTreeMap::new(),
            node: None,
            insecure: false,
            keys: None,
            beside: None,
            observe: None,
            token: None,
            seed: 0,
        }
    }

    /// Sets the function that carries out an action of any task. The function returns the result (a `real` as its
    /// bits), or why the action failed. Each call runs on a thread of its own; a panic counts as a failure.
    pub fn action(
        mut self,
        name: &str,
        function: impl Fn(&Call) -> Result<i32, String> + Send + Sync + 'static,
    ) -> Self {
        self.actions.push((name.into(), Box::new(function)));
        self
    }

    /// Sets the program of an extern task. It runs once, on a thread of its own, as soon as all nodes of this program
    /// have started.
    pub fn task(
        self,
        name: &str,
        program: impl FnOnce(&mut Context) -> Result<(), TaskError> + Send + 'static,
    ) -> Self {
        let of = name.to_owned();
        self.adds(name, move |builder, gate| {
            builder.task(&of, move |ctx| begins(&gate).and_then(|()| program(ctx)))
        })
    }

    /// Sets the program of an extern task, as a future: see [`Builder::async_task`].
    pub fn async_task<F>(self, name: &str, program: impl FnOnce(AsyncContext) -> F + Send + 'static) -> Self
    where
        F: Future<Output = Result<(), TaskError>> + 'static,
    {
        let of = name.to_owned();
        self.adds(name, move |builder, gate| {
            builder.async_task(&of, move |ctx| async move {
                // This waits until all nodes have started, because no future of this node may begin before.
                begins(&gate)?;
                program(ctx).await
            })
        })
    }

    fn adds(mut self, name: &str, adds: impl FnOnce(Builder, Gate) -> Builder + Send + 'static) -> Self {
        self.tasks.insert(name.into(), Box::new(adds));
        self
    }

    /// Runs only this node, at the address that the cell declares for it; other programs run the other nodes, such as
    /// `imrs run --node`. The node's incarnation is stored in `$XDG_STATE_HOME/imrs` (else `~/.local/state/imrs`). The
    /// node needs [`keys`](Self::keys). If neighbours remember a later incarnation, or if no neighbour answers, a line
    /// on standard error says so.
    pub fn node(mut self, name: &str) -> Self {
        self.node = Some(name.into());
        self
    }

    /// Encrypts and authenticates the node's packets with the keys in this folder (see [`node`](Self::node)), so that
    /// no other process can read or forge them. `imrs keygen` makes the keys. Without this call the folder is the one
    /// beside the cell's file: `line.keys` for `line.cell`. The node's neighbours need keys of the same cell. The
    /// folder needs only this node's file.
    pub fn keys(mut self, folder: impl Into<PathBuf>) -> Self {
        self.keys = Some(folder.into());
        self
    }

    /// Runs the node without keys. Then any process that reaches its socket can forge its packets. The node's
    /// neighbours must run without keys, too.
    pub const fn insecure(mut self) -> Self {
        self.insecure = true;
        self
    }

    /// Also serves monitors at this TCP address; several nodes get successive ports. This requires
    /// [`observe_token`](Self::observe_token).
    pub const fn observe(mut self, address: SocketAddr) -> Self {
        self.observe = Some(address);
        self
    }

    /// Over TCP, serves only monitors that have this token, of 16 to 256 bytes.
    pub fn observe_token(mut self, token: &str) -> Self {
        self.token = Some(token.into());
        self
    }

    /// Sets the seed of everything that is simulated or random.
    pub const fn seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// Runs the nodes until all their tasks have ended, at most for `length`, then stops them. Returns how each task ended.
    ///
    /// # Errors
    /// [`ProgramError`]; then no node keeps running.
    pub fn run(mut self, length: Option<Duration>) -> Result<Vec<(String, TaskEnd)>, ProgramError> {
        let nodes = self.nodes()?;
        self.check(&nodes)?;
        let actions = self.all_actions()?;
        let table = Arc::clone(&self.loaded.table);
        let network = Network::new(table, Faults::default());
        let mut running = Vec::new();
        let gate = Gate::default();
        let started = nodes.into_iter().enumerate().try_for_each(|(after, node)| {
            running.push(self.start(node, after, &network, Arc::clone(&actions), &gate)?);
            Ok(())
        });
        if let Err(error) = started {
            let _ = gate.set(false);
            return Err(error);
        }
        // Scripts of a restarted node are held back at first (D94). `length` counts from the instant at which all scripts
        // have begun.
        let begin = || running.iter().filter_map(|node: &Running| node.runtime.begin()).min();
        let (mut begins, mut end) = (begin(), None);
        // The gate opens only when all nodes have started, because the network drops messages to a node that has not
        // joined it.
        let _ = gate.set(true);
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
        // The nodes of one program stop together. A node that runs on its own tells its neighbours that it stops.
        let stop = if self.node.is_some() { Runtime::leave } else { Runtime::stop };
        Ok(running.into_iter().flat_map(|node| stop(node.runtime, PATIENCE)).collect())
    }

    /// The nodes that run in this process.
    fn nodes(&self) -> Result<Vec<NodeId>, ProgramError> {
        let all = &self.loaded.table.cell().nodes;
        let Some(name) = &self.node else { return Ok((0..all.len()).map(NodeId::from_index).collect()) };
        let node = all.iter().position(|node| node.name == *name).map(NodeId::from_index);
        let node = node.ok_or_else(|| ProgramError::NoNode(name.clone()))?;
        place::address(&self.loaded, node)?;
        if !self.insecure && self.folder().is_none() {
            return Err(ProgramError::NoKeys(name.clone()));
        }
        Ok(vec![node])
    }

    /// The folder of the node's keys; `None` if the node runs without keys.
    fn folder(&self) -> Option<&Path> {
        let found = || self.beside.as_deref().filter(|folder| folder.is_dir());
        self.keys.as_deref().or_else(found).filter(|_| !self.insecure)
    }

    fn check(&self, nodes: &[NodeId]) -> Result<(), ProgramError> {
        let tasks = &self.loaded.table.cell().tasks;
        for name in self.tasks.keys() {
            let at = tasks.iter().position(|task| task.name == *name);
            let at = at.ok_or_else(|| ProgramError::NoTask(name.clone()))?;
            if self.loaded.scripts[at].is_some() {
                return Err(ProgramError::NotExtern(name.clone()));
            }
        }
        for (task, script) in tasks.iter().zip(&self.loaded.scripts) {
            let here = nodes.contains(&task.node);
            if here && script.is_none() && !self.tasks.contains_key(&task.name) {
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
        gate: &Gate,
    ) -> Result<Running, ProgramError> {
        let table = Arc::clone(&self.loaded.table);
        let mut builder = Runtime::builder(Arc::clone(&table), node)
            .insecure(self.node.is_some() && self.insecure)
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
            builder = match (&self.loaded.scripts[task.index()], self.tasks.remove(name)) {
                (Some(script), _) => builder.script(name, Arc::clone(&script.program)),
                (None, Some(adds)) => adds(builder, Arc::clone(gate)),
                // `check` has already returned an error for such a task.
                (None, None) => return Err(ProgramError::NoBody(name.clone())),
            };
        }
        let runtime = builder.start()?;
        let mut observers = vec![];
        // Serving monitors at the Unix socket may fail: the node runs nevertheless. But the user asked for the TCP
        // address, so failing to bind that is an error.
        observers.extend(Observer::start(Arc::clone(runtime.node())).ok());
        if let Some(first) = self.observe {
            let address = place::observed_at(first, after);
            let token = self.token.as_deref().map(Token::of).transpose()?;
            if token.is_none() {
                return Err(ProgramError::Watched(address));
            }
            observers.push(Showing::new(Arc::clone(runtime.node())).token(token).start_tcp(address)?);
        }
        Ok(Running { runtime, _state: state, _observers: observers })
    }

    fn link(&self, node: NodeId) -> Result<(Arc<dyn Link>, Counted), ProgramError> {
        let address = place::address(&self.loaded, node)?;
        let keys = self.folder().map(|folder| keys::read(folder, &self.loaded, node)).transpose()?;
        let keys = keys.as_ref().map(|(_, keys)| keys);
        let (link, counted) = incarnation::bind::<ProgramError>(&self.loaded, node, address, keys)?;
        if let Some(notice) = &counted.notice {
            // Standard error may be closed. The node runs nevertheless.
            let _ = writeln!(io::stderr(), "imrs: {}", one_line(notice));
        }
        link.greet();
        Ok((Arc::new(link), counted))
    }
}

/// Waits until the gate has its value. Returns an error if the programs of extern tasks must not begin.
fn begins(gate: &Gate) -> Result<(), TaskError> {
    if *gate.wait() { Ok(()) } else { Err(TaskError::Stopped) }
}
