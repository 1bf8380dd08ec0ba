//! The threads of a node: one per task, one for the tasks that are futures, the receiving thread, and the Timer thread.

use crate::api::context::{Caller, TaskError};
use crate::clock;
use crate::link::{Link, PollEnd};
use crate::lock::lock;
use crate::node::effects::Effects;
use crate::node::executor::Executor;
use crate::node::failstop::guarded;
use crate::node::local_task::BEGUN;
use crate::node::program::{StartError, TaskBody, TaskEnd, TaskProgram, message, spawn};
use crate::node::{Inlet, Node};
use crate::script::{Actions, Stage};
use crate::sync::awake;
use imrs_wire::obs::Liveness;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How long before its deadline a waiting thread wakes, by default: about the time from the thread's wake-up until its
/// program runs.
pub const SPIN_TAIL: Duration = Duration::from_micros(8);

/// A running node.
///
/// ```
/// use imrs_protocol::{Cell, CellTable, Ticks};
/// use imrs_runtime::{Runtime, TaskEnd};
/// use std::{sync::Arc, time::Duration};
///
/// let mut cell = Cell::new("two", Ticks(1_000));
/// let here = cell.node("here");
/// let (_quick, _endless) = (cell.task("quick", here), cell.task("endless", here));
/// let table = Arc::new(CellTable::new(cell).expect("a sound cell"));
/// let node = Runtime::builder(table, here)
///     .task("quick", |_ctx| Ok(()))
///     // Every call fails once the node stops, so that this loop ends.
///     .task("endless", |ctx| loop { ctx.delay(Duration::from_millis(10))? })
///     .start()
///     .expect("a node that starts");
/// assert!(!node.wait(Duration::from_millis(50)), "one task goes on");
/// let ends = node.stop(Duration::from_secs(10));
/// assert!(ends.iter().all(|(_, end)| *end == TaskEnd::Returned), "{ends:?}");
/// ```
///
/// Dropping it asks its threads to end without waiting for them; [`stop`](Self::stop) waits.
pub struct Runtime {
    node: Arc<Node>,
    shared: Arc<Shared>,
    /// The name of each task, and the task's thread if it has one.
    tasks: Vec<(String, Option<JoinHandle<()>>)>,
    helpers: Vec<JoinHandle<()>>,
    executor: Option<Executor>,
}

/// State that the threads of a node share: whether the node stops, and how the programs ended.
struct Shared {
    closing: AtomicBool,
    /// How each task's program ended; `None` while the program runs.
    ends: Mutex<Vec<Option<TaskEnd>>>,
    changed: Condvar,
}

impl Shared {
    fn ends(&self) -> MutexGuard<'_, Vec<Option<TaskEnd>>> {
        lock(&self.ends)
    }

    fn ended(&self, place: usize, end: TaskEnd) {
        // `ends` has no slot for this task if the node has stopped without waiting for it.
        if let Some(slot) = self.ends().get_mut(place) {
            *slot = Some(end);
        }
        self.changed.notify_all();
    }

    /// Notes that the script no longer runs.
    fn stopped(&self, place: usize) {
        if let Some(slot) = self.ends().get_mut(place) {
            slot.get_or_insert(TaskEnd::Returned);
        }
        self.changed.notify_all();
    }

    /// Waits until no program runs, or until `deadline`.
    fn wait_for_tasks(&self, deadline: Instant) -> bool {
        let mut ends = self.ends();
        while ends.iter().any(Option::is_none) {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            (ends, _) = self.changed.wait_timeout(ends, left).unwrap_or_else(PoisonError::into_inner);
        }
        true
    }
}

impl Runtime {
    pub(crate) fn start(
        node: Arc<Node>,
        programs: Vec<(String, TaskProgram)>,
        actions: Arc<dyn Actions>,
        holds: bool,
    ) -> Result<Self, StartError> {
        let shared = Arc::new(Shared {
            closing: AtomicBool::new(false),
            ends: Mutex::new(programs.iter().map(|_| None).collect()),
            changed: Condvar::new(),
        });
        awake::quota();
        // If an error returns early from here on, the runtime is dropped, and this ends the threads that already run.
        let mut runtime = Self { node, shared, tasks: Vec::new(), helpers: Vec::new(), executor: None };
        let (weak, ends) = (Arc::downgrade(&runtime.node), Arc::clone(&runtime.shared));
        let ended = move |place: usize, end| ends.ended(place, TaskEnd::Script(end));
        let _ = runtime.node.stage.set(Stage::new(weak, actions, Box::new(ended)));
        runtime.start_timer()?;
        runtime.start_receiver()?;
        let mut futures = Vec::new();
        for (place, (name, program)) in programs.into_iter().enumerate() {
            let thread = match program {
                TaskProgram::Async(body) => {
                    futures.push((place, body));
                    None
                }
                TaskProgram::Body(body) => Some(runtime.start_task(place, &name, body)?),
                TaskProgram::Script(_) => None,
            };
            runtime.tasks.push((name, thread));
        }
        if !futures.is_empty() {
            let ends = Arc::clone(&runtime.shared);
            let ended = move |place, end| ends.ended(place, end);
            runtime.executor = Some(Executor::start(&runtime.node, futures, ended)?);
        }
        if !holds {
            runtime.begin();
        }
        Ok(runtime)
    }

    /// Starts the scripts that [`Builder::hold_scripts`](crate::Builder::hold_scripts) held back, each once. In a
    /// restarted node a script waits for as long as its task needs after the restart. Returns when the next script
    /// may begin, so that the caller can call this again then; `None` if all scripts have begun.
    pub fn begin(&self) -> Option<Instant> {
        let mut effects = Effects::new(None);
        let (now, here) = (clock::now(), Instant::now());
        let mut next: Option<u64> = None;
        for local in &self.node.locals.list {
            let begins = local.begins.load(Ordering::Relaxed);
            if begins > now {
                next = next.into_iter().chain((begins != BEGUN).then_some(begins)).min();
                continue;
            }
            local.begins.store(BEGUN, Ordering::Relaxed);
            local.with_runner(&mut effects, |runner, comm, effects| runner.begin(comm, effects));
            self.node.carry_out(&mut effects);
        }
        next.map(|next| here + Duration::from_micros(next - now))
    }

    /// The running node. Observers need it.
    #[must_use]
    pub fn node(&self) -> &Arc<Node> {
        &self.node
    }

    /// Waits until every task's program has ended, but at most `patience`. Returns whether all have ended.
    #[must_use]
    pub fn wait(&self, patience: Duration) -> bool {
        self.shared.wait_for_tasks(Instant::now() + patience)
    }

    /// Stops the node: every wait of its tasks ends with [`TaskError::Stopped`], and the other members of a `waitfor` get an
    /// ABORT. Then the other threads end. Waits at most `patience` for the tasks. Returns how each program ended.
    #[must_use = "says which programs did not end"]
    pub fn stop(mut self, patience: Duration) -> Vec<(String, TaskEnd)> {
        self.stop_tasks();
        self.shared.wait_for_tasks(Instant::now() + patience);
        self.close();
        for helper in self.helpers.drain(..) {
            // A panic of a helper thread would have ended the process.
            let _ = helper.join();
        }
        if let Some(executor) = self.executor.take() {
            executor.join();
        }
        let mut ends = std::mem::take(&mut *self.shared.ends());
        let tasks = std::mem::take(&mut self.tasks).into_iter().zip(ends.drain(..));
        let join = |thread: Option<JoinHandle<()>>, end: Option<TaskEnd>| match thread {
            Some(thread) => join(thread, end),
            None => end.unwrap_or(TaskEnd::Unfinished),
        };
        tasks.map(|((name, thread), end)| (name, join(thread, end))).collect()
    }

    /// Stops as [`stop`](Self::stop) does, and then tells the neighbours (over UDP this takes some 10 ms). Their
    /// requests to this node then end at once with [`Outcome::PeerRestarted`](imrs_protocol::Outcome::PeerRestarted),
    /// instead of waiting for their time_outs. Use this if the neighbours go on.
    #[must_use = "says which programs did not end"]
    pub fn leave(self, patience: Duration) -> Vec<(String, TaskEnd)> {
        let link = self.node.link.clone();
        let ends = self.stop(patience);
        if let Some(link) = link {
            link.goodbye();
        }
        ends
    }

    fn stop_tasks(&self) {
        let mut effects = Effects::of_an_onlooker();
        for local in &self.node.locals.list {
            local.handoff.stop(&mut effects);
            if local.is_future() {
                local.call(&effects);
            }
            local.with_runner(&mut effects, |runner, comm, effects| runner.stop(comm, effects));
            self.node.carry_out(&mut effects);
        }
        for (place, local) in self.node.locals.list.iter().enumerate() {
            if local.is_script() {
                self.shared.stopped(place);
            }
        }
    }

    fn close(&self) {
        self.shared.closing.store(true, Ordering::SeqCst);
        self.node.alarm.ring();
        if let Some(link) = &self.node.link {
            link.wake();
        }
        if let Some(executor) = &self.executor {
            executor.close();
        }
    }

    fn start_task(&self, place: usize, name: &str, program: TaskBody) -> Result<JoinHandle<()>, StartError> {
        let (node, shared) = (Arc::clone(&self.node), Arc::clone(&self.shared));
        spawn(name, move || shared.ended(place, run_task(&node, place, program)))
    }

    fn start_timer(&mut self) -> Result<(), StartError> {
        let (node, shared) = (Arc::clone(&self.node), Arc::clone(&self.shared));
        self.helpers.push(spawn("imrs timer", move || run_timer(&node, &shared.closing))?);
        Ok(())
    }

    fn start_receiver(&mut self) -> Result<(), StartError> {
        let Some(link) = self.node.link.clone() else { return Ok(()) };
        let (node, shared) = (Arc::clone(&self.node), Arc::clone(&self.shared));
        self.helpers.push(spawn("imrs receive", move || run_receiver(node, link.as_ref(), &shared.closing))?);
        Ok(())
    }
}

impl Drop for Runtime {
    fn drop(&mut self) {
        self.stop_tasks();
        self.close();
    }
}

fn run_task(node: &Arc<Node>, place: usize, program: TaskBody) -> TaskEnd {
    clock::sleep_exactly();
    let thread_state = node.locals.list[place].handoff.thread_state();
    thread_state.returns();
    let end = match catch_unwind(AssertUnwindSafe(|| program(Arc::clone(node), place))) {
        Ok(Ok(()) | Err(TaskError::Stopped)) => TaskEnd::Returned,
        Ok(Err(error)) => TaskEnd::Failed(error),
        Err(panic) => TaskEnd::Panicked(message(panic.as_ref())),
    };
    let crashed = matches!(end, TaskEnd::Panicked(_));
    node.locals.list[place].set_liveness(if crashed { Liveness::Crashed } else { Liveness::Ended });
    Caller::new(Arc::clone(node), place).end();
    thread_state.goes();
    end
}

/// The Timer thread serves expiries for which no task's thread sleeps. It sleeps until just before the next one, and
/// then spins (D131). While there is none, it sleeps until a deadline is published.
fn run_timer(node: &Node, closing: &AtomicBool) {
    clock::sleep_exactly();
    let mut effects = Effects::new(None);
    guarded("the Timer's thread", || {
        let tail = node.spin_tail.min(clock::micros(SPIN_TAIL));
        while let Some(now) = node.alarm.next(tail, || closing.load(Ordering::SeqCst), clock::now) {
            node.lateness.note(now.saturating_sub(node.alarm.target()));
            node.tend(now, &mut effects);
        }
    });
}

fn run_receiver(node: Arc<Node>, link: &dyn Link, closing: &AtomicBool) {
    clock::sleep_exactly();
    let inlet = Inlet::new(node);
    guarded("the thread that receives", || {
        while !closing.load(Ordering::SeqCst) {
            match link.poll(&inlet, None) {
                PollEnd::Ready => inlet.ready(),
                PollEnd::Received | PollEnd::TimedOut | PollEnd::Woken => {}
            }
        }
    });
}

/// Joins a thread whose program has ended, because it returns soon. Does not wait for any other thread.
fn join(thread: JoinHandle<()>, end: Option<TaskEnd>) -> TaskEnd {
    let Some(end) = end else { return TaskEnd::Unfinished };
    match thread.join() {
        Ok(()) => end,
        Err(panic) => TaskEnd::Panicked(message(panic.as_ref())),
    }
}
