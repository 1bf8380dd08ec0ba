//! The communication tasks of a node, each behind its hand-off: a lock with an inbox for the input of other threads.

use crate::node::comm::Comm;
use crate::node::domain::{Domain, Turn};
use crate::node::effects::{Addressed, Effects, Stamped};
use crate::node::home::{Home, Homes, RunBy};
use crate::script::ScriptRunner;
use crate::sync::handoff::{Handoff, ThreadWaker};
use crate::sync::ready::ReadyFutures;
use crate::sync::task_waker::TaskWaker;
use imrs_protocol::{NodeTable, TaskId};
use imrs_wire::obs::Liveness;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::task::Waker;

/// The value of [`LocalTask::begins`] once the script has begun.
pub(crate) const BEGUN: u64 = u64::MAX;

/// A task of the node, with its access to its communication task.
pub(crate) struct LocalTask {
    pub task: TaskId,
    pub home: Home,
    /// The hand-off of the task's domain: the lock that its tasks share, with an inbox for input.
    pub handoff: Arc<Handoff<Domain>>,
    waker: TaskWaker,
    liveness: AtomicU8,
    /// How a future is marked as ready. Set when the thread of the futures starts; empty if the task is no future.
    pub marking: OnceLock<Marking>,
    /// Whether the registered `waker` only sets the mark of `marking`. Only the thread of the futures reads and
    /// writes this.
    pub is_plain: AtomicBool,
    /// When the task's script may begin, in microseconds of the node's clock; [`BEGUN`] once it has begun.
    pub begins: AtomicU64,
    /// Whether a link is likely to end the task's next wait, because it ended the last one.
    pub by_link: AtomicBool,
}

impl LocalTask {
    pub fn new(task: TaskId, home: Home, handoff: Arc<Handoff<Domain>>) -> Self {
        Self {
            task,
            home,
            handoff,
            waker: TaskWaker::new(),
            liveness: AtomicU8::new(Liveness::Alive as u8),
            by_link: AtomicBool::new(true),
            marking: OnceLock::new(),
            is_plain: AtomicBool::new(false),
            begins: AtomicU64::new(0),
        }
    }

    /// Whether the task's program is a future.
    pub fn is_future(&self) -> bool {
        self.home.run_by == RunBy::TheThreadOfFutures
    }

    /// Whether the task's program is a script.
    pub fn is_script(&self) -> bool {
        self.home.run_by == RunBy::AnyThread
    }

    /// Registers `waker`, which is called whenever the task's future has an answer to take. Only the thread of the
    /// futures calls this function.
    pub fn listen(&self, waker: &Waker) {
        let is_plain = self.marking.get().is_some_and(|marking| marking.waker.will_wake(waker));
        self.is_plain.store(is_plain, Ordering::Relaxed);
        self.waker.listen(waker);
    }

    /// Calls the waker of the task's future, because there is an answer for it.
    pub fn call(&self, effects: &Effects) {
        match self.marking.get() {
            Some(marking) if effects.of_the_futures && self.is_plain.load(Ordering::Relaxed) => {
                marking.ready.mark_own(marking.index);
            }
            _ => self.waker.wake(),
        }
    }

    fn addressed(&self, stamped: Stamped) -> Addressed {
        Addressed { member: self.home.member(), stamped }
    }

    /// Delivers an input from any thread: see [`Handoff::deliver`].
    pub fn deliver(&self, stamped: Stamped, effects: &mut Effects) {
        self.handoff.deliver(self.addressed(stamped), effects);
    }

    /// As [`deliver`](Self::deliver), but when this returns, the task has taken the input.
    pub fn deliver_now(&self, stamped: Stamped, effects: &mut Effects) {
        self.handoff.deliver_now(self.addressed(stamped), effects);
    }

    /// Keeps an input in `effects`, so that it is delivered together with other inputs of this task.
    pub fn hold(&self, stamped: Stamped, effects: &mut Effects) {
        effects.bundles.push(self.home.place(), self.addressed(stamped));
    }

    /// Puts an input into the inbox of the task without taking the lock: see [`Handoff::leave`].
    pub fn leave(&self, stamped: Stamped) -> Result<(), Stamped> {
        self.handoff.leave(self.addressed(stamped)).map_err(|input| input.stamped)
    }

    /// Calls `work` with the task's script, if it has one. Any thread may call this.
    pub fn with_runner(
        &self,
        effects: &mut Effects,
        work: impl FnOnce(&mut ScriptRunner, &mut Turn<'_>, &mut Effects),
    ) {
        let visit = |domain: &mut Domain, effects: &mut Effects| {
            domain.with_runner(self.home.member(), effects, work);
        };
        self.handoff.visit(visit, effects);
    }

    /// Calls `look` with the communication task after draining the inbox: see [`Handoff::with`].
    pub fn look<R>(&self, look: impl FnOnce(&mut Comm) -> R, effects: &mut Effects) -> R {
        self.handoff.with(|domain| look(domain.member(self.home.member())), effects)
    }

    pub fn liveness(&self) -> Liveness {
        match self.liveness.load(Ordering::Relaxed) {
            0 => Liveness::Alive,
            1 => Liveness::Ended,
            _ => Liveness::Crashed,
        }
    }

    pub fn set_liveness(&self, liveness: Liveness) {
        self.liveness.store(liveness as u8, Ordering::Relaxed);
    }
}

/// Makes the tasks of a node from their communication tasks, with one hand-off for each domain. `link` wakes a thread
/// that waits in the link's socket.
pub(crate) fn local_tasks(
    comms: impl Iterator<Item = Comm>,
    table: &NodeTable,
    homes: &Arc<Homes>,
    link: Option<&Arc<dyn ThreadWaker>>,
) -> Box<[LocalTask]> {
    let mut domains: BTreeMap<usize, Vec<Comm>> = BTreeMap::new();
    let mut tasks = Vec::new();
    for comm in comms {
        tasks.push((comm.machine().task(), comm.home));
        domains.entry(comm.home.domain()).or_default().push(comm);
    }
    let handoff = |(id, members)| {
        let domain = Domain::new(id, members, table.clone(), Arc::clone(homes));
        (id, Arc::new(Handoff::new(domain, link.cloned())))
    };
    let domains: BTreeMap<usize, _> = domains.into_iter().map(handoff).collect();
    let local =
        |(task, home): (TaskId, Home)| LocalTask::new(task, home, Arc::clone(&domains[&home.domain()]));
    tasks.into_iter().map(local).collect()
}

/// How the thread of the futures marks one of the futures as ready.
pub(crate) struct Marking {
    pub ready: Arc<ReadyFutures>,
    /// The future's position in `ready`.
    pub index: usize,
    /// The waker with which the thread polls the future.
    pub waker: Waker,
}

/// The tasks of a node.
pub(crate) struct LocalTasks {
    /// The tasks in ascending order.
    pub list: Box<[LocalTask]>,
    homes: Arc<Homes>,
}

impl LocalTasks {
    pub const fn new(list: Box<[LocalTask]>, homes: Arc<Homes>) -> Self {
        Self { list, homes }
    }

    /// The local task `task`, if this node runs it.
    pub fn of(&self, task: TaskId) -> Option<&LocalTask> {
        self.list.get(self.place(task)?)
    }

    /// The position of `task` in the list.
    pub fn place(&self, task: TaskId) -> Option<usize> {
        Some(self.homes.of(task)?.place())
    }
}
