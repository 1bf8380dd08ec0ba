//! Builds and starts a node: its tasks with their programs, and its link.

use crate::api::context::{AsyncContext, Context, TaskError};
use crate::clock;
use crate::link::Link;
use crate::node::program::{Running, StartError, TaskProgram};
use crate::node::threads::{Runtime, SPIN_TAIL};
use crate::node::{Node, Plan};
use crate::record::Recorder;
use crate::script::{Actions, ScriptRunner, Simulated, Watch};
use imrs_protocol::script::{HOST_LIMIT, Program};
use imrs_protocol::{CellTable, Incarnation, NodeId, NodeTable};
use imrs_wire::obs::RealTime;
use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// How many packets the transit buffer of a node holds, unless the program sets another number.
pub const TRANSIT_CAPACITY: u16 = 1024;

/// For how long a waiting thread spins before it sleeps, by default: about the time that it takes to wake a thread on
/// another core.
pub const SPIN: Duration = Duration::from_micros(50);

/// Collects everything that a node needs before it starts. [`Runtime::builder`] makes one, each method sets one thing, and
/// [`start`](Self::start) starts the node. Every task of the node needs a program: a function, a future or a script.
///
/// ```
/// use imrs_protocol::{Cell, CellTable, Ticks};
/// use imrs_runtime::{Runtime, TaskEnd};
/// use std::{sync::Arc, time::Duration};
///
/// let mut cell = Cell::new("two", Ticks(1_000));
/// let here = cell.node("here");
/// cell.task("thread", here);
/// cell.task("future", here);
/// let table = Arc::new(CellTable::new(cell).expect("a sound cell"));
///
/// let node = Runtime::builder(table, here)
///     .spin(Duration::ZERO)
///     .task("thread", |ctx| ctx.delay(Duration::from_millis(1)))
///     .async_task("future", |mut ctx: imrs_runtime::AsyncContext| async move {
///         ctx.delay(Duration::from_millis(1)).await
///     })
///     .start()
///     .expect("a node that starts");
/// assert!(node.wait(Duration::from_secs(10)), "both tasks end");
/// let ends = node.stop(Duration::from_secs(10));
/// assert!(ends.iter().all(|(_, end)| *end == TaskEnd::Returned));
/// ```
#[must_use = "a node runs only once started"]
pub struct Builder {
    cell: Arc<CellTable>,
    node: NodeId,
    incarnation: Incarnation,
    restarted: bool,
    insecure: bool,
    real_time: RealTime,
    capacity: u16,
    link: Option<Arc<dyn Link>>,
    recorder: Option<Arc<dyn Recorder>>,
    programs: Vec<(String, TaskProgram)>,
    actions: Option<Arc<dyn Actions>>,
    watch: Option<Arc<dyn Watch>>,
    seed: u64,
    spin: Duration,
    spin_tail: Option<Duration>,
    holds: bool,
}

impl Runtime {
    /// Begins to describe a node of a cell.
    pub fn builder(cell: Arc<CellTable>, node: NodeId) -> Builder {
        Builder::new(cell, node)
    }
}

impl Builder {
    fn new(cell: Arc<CellTable>, node: NodeId) -> Self {
        Self {
            cell,
            node,
            incarnation: Incarnation(0),
            restarted: false,
            insecure: false,
            real_time: RealTime::NotAsked,
            capacity: TRANSIT_CAPACITY,
            link: None,
            recorder: None,
            programs: Vec::new(),
            actions: None,
            watch: None,
            seed: 0,
            spin: SPIN,
            spin_tail: None,
            holds: false,
        }
    }

    /// Sets the incarnation of the node, and whether an earlier incarnation may have taken commands. If so, tasks of the
    /// node answer commands with RESTARTED for as long as a command to the earlier incarnation may still be in flight.
    pub fn incarnation(mut self, incarnation: Incarnation, restarted: bool) -> Self {
        (self.incarnation, self.restarted) = (incarnation, restarted);
        self
    }

    /// Sets the link to the neighbours.
    pub fn link(mut self, link: Arc<dyn Link>) -> Self {
        self.link = Some(link);
        self
    }

    /// Says that the links do not authenticate packets. Every display of the node shows this.
    pub fn insecure(mut self, insecure: bool) -> Self {
        self.insecure = insecure;
        self
    }

    /// Says whether the calling thread has a real-time scheduling policy, which the node's threads inherit. Every
    /// display of the node shows this.
    pub fn real_time(mut self, real_time: RealTime) -> Self {
        self.real_time = real_time;
        self
    }

    /// Sets how many packets for other nodes may wait in the transit buffer at once.
    pub fn transit_capacity(mut self, packets: u16) -> Self {
        self.capacity = packets;
        self
    }

    /// Sets the recorder, which gets every input of every communication task.
    pub fn recorder(mut self, recorder: Arc<dyn Recorder>) -> Self {
        self.recorder = Some(recorder);
        self
    }

    /// Sets the program of a task. The program runs once, on a thread of its own. [`Context::with_state`] gives the
    /// program a state.
    pub fn task(
        mut self,
        name: &str,
        program: impl FnOnce(&mut Context) -> Result<(), TaskError> + Send + 'static,
    ) -> Self {
        let body = move |node, place| program(&mut Context::new(node, place, ()));
        self.programs.push((name.into(), TaskProgram::Body(Box::new(body))));
        self
    }

    /// Sets the program of a task that is a future. One thread of the node runs all futures, so none of them may block
    /// that thread. The future waits by `await`, for its communication task or for anything else, and any thread may
    /// wake it. If the future panics, only this task crashes. [`AsyncContext::with_state`] gives the program a state.
    ///
    /// ```
    /// use imrs_protocol::{Cell, CellTable, PortDecl, Ticks, Usage};
    /// use imrs_runtime::{Asked, AsyncContext, Runtime};
    /// use std::{sync::Arc, time::Duration};
    ///
    /// let mut cell = Cell::new("greeting", Ticks(1_000));
    /// let here = cell.node("here");
    /// let (asker, answerer) = (cell.task("asker", here), cell.task("answerer", here));
    /// cell.port(PortDecl::new("ask", asker, Usage::Send, &[answerer], Ticks(500_000)).command());
    /// let table = Arc::new(CellTable::new(cell).expect("a sound cell"));
    ///
    /// let node = Runtime::builder(table, here)
    ///     .async_task("asker", |mut ctx: AsyncContext| async move {
    ///         let ask = ctx.port("ask")?;
    ///         match ctx.query::<i16, i16>(ask, &20).await? {
    ///             Asked::Reply(sum) => assert_eq!(sum, 21),
    ///             Asked::Refused | Asked::TimedOutUnsent => panic!("it was not asked"),
    ///             Asked::TimedOutUnknown | Asked::PeerRestarted => panic!("it may have answered"),
    ///         }
    ///         Ok(())
    ///     })
    ///     .async_task("answerer", |mut ctx: AsyncContext| async move {
    ///         let ask = ctx.port("ask")?;
    ///         if let Some(question) = ctx.take::<i16>(ask, None).await? {
    ///             ctx.answer(&question.from, &(question.message + 1))?;
    ///         }
    ///         Ok(())
    ///     })
    ///     .start()
    ///     .expect("a node that starts");
    /// assert!(node.wait(Duration::from_secs(10)));
    /// # let ends = node.stop(Duration::from_secs(10));
    /// # assert!(ends.iter().all(|(_, end)| *end == imrs_runtime::TaskEnd::Returned), "{ends:?}");
    /// ```
    pub fn async_task<F>(
        mut self,
        name: &str,
        program: impl FnOnce(AsyncContext) -> F + Send + 'static,
    ) -> Self
    where
        F: Future<Output = Result<(), TaskError>> + 'static,
    {
        let body = move |caller| -> Running { Box::pin(program(AsyncContext::new(caller, ()))) };
        self.programs.push((name.into(), TaskProgram::Async(Box::new(body))));
        self
    }

    /// Sets the script of a task, with durations in microseconds. A script has no thread of its own: the thread that
    /// brings input for the task runs the script.
    pub fn script(mut self, name: &str, program: Arc<Program>) -> Self {
        self.programs.push((name.into(), TaskProgram::Script(program)));
        self
    }

    /// Sets the driver that carries out the actions of the scripts [default: a simulation that knows no results].
    pub fn actions(mut self, actions: Arc<dyn Actions>) -> Self {
        self.actions = Some(actions);
        self
    }

    /// Sets the watch, which gets every event of the scripts.
    pub fn watch(mut self, watch: Arc<dyn Watch>) -> Self {
        self.watch = Some(watch);
        self
    }

    /// Sets the seed of the scripts' random choices.
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// Sets how long the waiting thread of a task spins before it sleeps [default: [`SPIN`]]; zero means that it does
    /// not spin. The thread spins only if its last wait of that kind was brief, and while no other task's thread
    /// needs the core. So of several long waits only the first one spins, and idle tasks use no processor time.
    pub fn spin(mut self, budget: Duration) -> Self {
        self.spin = budget;
        self
    }

    /// Sets the spin tail: how long before the end of a delay or a time_out a task's thread wakes, to spin until the
    /// end. The default, [`SPIN_TAIL`], covers the time from the thread's wake-up until its program runs; zero means
    /// no spinning. A longer tail also covers the kernel's delay of the wake-up, tens of microseconds. Each wait that
    /// ends by its deadline costs at most this much of a core. A wait shorter than the tail spins from its beginning,
    /// unless the tail is the default. The Timer thread, which serves scripts and futures, spins for at most the
    /// default. Waits in the socket have no tail. A thread waits there for messages; it waits there for a delay only
    /// if the program has not set this length.
    pub fn spin_tail(mut self, length: Duration) -> Self {
        self.spin_tail = Some(length);
        self
    }

    /// Keeps the scripts from beginning until [`Runtime::begin`]. After a restart of the node, scripts wait until no
    /// command to the earlier incarnation can arrive any more.
    pub fn hold_scripts(mut self) -> Self {
        self.holds = true;
        self
    }

    /// Starts the node.
    ///
    /// # Errors
    /// [`StartError`]. No thread of the node runs then.
    pub fn start(self) -> Result<Runtime, StartError> {
        let decl = self.cell.cell().nodes.get(self.node.index()).ok_or(StartError::NoNode(self.node))?;
        if self.link.is_none() && self.cell.neighbours(self.node).next().is_some() {
            return Err(StartError::NoLink(decl.name.clone()));
        }
        let programs = assign(&self.cell, self.node, self.programs)?;
        let table = NodeTable::new(self.cell, self.node);
        let machine = imrs_protocol::Node::new(table, self.incarnation, self.restarted, self.capacity);
        let node = Node::new(Plan {
            machine,
            run_by: programs.iter().map(|(_, program)| program.run_by()).collect(),
            incarnation: self.incarnation,
            insecure: self.insecure,
            real_time: self.real_time,
            link: self.link,
            recorder: self.recorder,
            spin: clock::micros(self.spin),
            spin_tail: clock::micros(self.spin_tail.unwrap_or(SPIN_TAIL)),
            is_exact: self.spin_tail.is_some_and(|tail| !tail.is_zero()),
        });
        let scripts =
            programs.iter().filter(|(_, program)| matches!(program, TaskProgram::Script(_))).count();
        let together = HOST_LIMIT.saturating_mul(u32::try_from(scripts).unwrap_or(u32::MAX));
        for (place, (name, program)) in programs.iter().enumerate() {
            if let TaskProgram::Script(program) = program {
                program.check().map_err(|error| StartError::Script(name.clone(), error))?;
                let runner =
                    ScriptRunner::new(place, Arc::clone(program), self.watch.clone(), self.seed, together);
                let local = &node.locals.list[place];
                if self.restarted && self.holds {
                    let held_back = node.table.held_back(local.task);
                    local.begins.store(node.started.saturating_add(held_back.0), Ordering::Relaxed);
                }
                node.look(local, |comm| comm.runner(runner));
            }
        }
        let seed = self.seed;
        let actions = self.actions.map_or_else(|| Simulated::start(seed, Vec::new(), Vec::new()), Ok);
        let actions = actions.map_err(|source| StartError::Thread { name: "imrs actions".into(), source })?;
        Runtime::start(Arc::new(node), programs, actions, self.holds)
    }
}

/// Puts the programs into the order of the node's tasks. Fails if a program's task is not on this node, or a task has
/// no program.
fn assign(
    cell: &CellTable,
    node: NodeId,
    programs: Vec<(String, TaskProgram)>,
) -> Result<Vec<(String, TaskProgram)>, StartError> {
    let tasks = &cell.cell().tasks;
    let mut bodies: Vec<Option<TaskProgram>> = tasks.iter().map(|_| None).collect();
    for (name, body) in programs {
        let Some(at) = tasks.iter().position(|task| task.name == name) else {
            return Err(StartError::NoTask(name));
        };
        if tasks[at].node != node {
            let node = cell.cell().nodes[tasks[at].node.index()].name.clone();
            return Err(StartError::Elsewhere { task: name, node });
        }
        if bodies[at].replace(body).is_some() {
            return Err(StartError::Twice(name));
        }
    }
    let own = tasks.iter().zip(bodies).filter(|(task, _)| task.node == node);
    own.map(|(task, body)| {
        let name = task.name.clone();
        body.map(|body| (name.clone(), body)).ok_or(StartError::NoProgram(name))
    })
    .collect()
}
