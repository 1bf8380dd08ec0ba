//! The communication tasks of a node, each behind its hand-off.

use crate::node::comm::Comm;
use crate::sync::handoff::{Handoff, ThreadWaker};
use crate::sync::{Mutex, lock};
use imrs_protocol::TaskId;
use imrs_wire::obs::Liveness;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::task::Waker;

/// The value of [`LocalTask::begins`] once the script has begun.
pub(crate) const BEGUN: u64 = u64::MAX;

/// A task of the node.
pub(crate) struct LocalTask {
    pub task: TaskId,
    pub handoff: Handoff<Comm>,
    pub waker: Arc<TaskWaker>,
    liveness: AtomicU8,
    /// Whether the task has a script. Set before anything happens.
    pub scripted: AtomicBool,
    /// Whether the task's program is a future. Set before anything happens.
    pub listens: AtomicBool,
    /// When the task's script may begin, in microseconds of the node's clock; [`BEGUN`] once it has begun.
    pub begins: AtomicU64,
    /// Whether a link is likely to end the task's next wait, because it ended the last one.
    pub by_link: AtomicBool,
}

impl LocalTask {
    /// `link` wakes the task's thread where it waits in the link.
    pub fn new(task: TaskId, comm: Comm, link: Option<Arc<dyn ThreadWaker>>) -> Self {
        let waker = Arc::new(TaskWaker { link, waker: Mutex::new(None) });
        Self {
            task,
            handoff: Handoff::new(comm, Some(Arc::clone(&waker) as Arc<dyn ThreadWaker>)),
            waker,
            liveness: AtomicU8::new(Liveness::Alive as u8),
            by_link: AtomicBool::new(true),
            scripted: AtomicBool::new(false),
            listens: AtomicBool::new(false),
            begins: AtomicU64::new(0),
        }
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

/// Wakes a task that waits elsewhere than on its word: in the link, or as a future.
pub(crate) struct TaskWaker {
    link: Option<Arc<dyn ThreadWaker>>,
    waker: Mutex<Option<Waker>>,
}

impl TaskWaker {
    /// From here on, a wake-up calls `waker`.
    pub fn listen(&self, waker: &Waker) {
        let mut own = lock(&self.waker);
        match &mut *own {
            Some(own) => own.clone_from(waker),
            None => *own = Some(waker.clone()),
        }
    }
}

impl ThreadWaker for TaskWaker {
    fn wake(&self) {
        let waker = lock(&self.waker).clone();
        match (waker, &self.link) {
            (Some(waker), _) => waker.wake(),
            (None, Some(link)) => link.wake(),
            (None, None) => {}
        }
    }
}

/// The tasks of a node.
pub(crate) struct LocalTasks {
    /// Ascending by task.
    pub list: Box<[LocalTask]>,
    /// For each task of the cell, its position in the list.
    places: Box<[Option<u16>]>,
}

impl LocalTasks {
    /// The given tasks, of a cell with `tasks` tasks.
    pub fn new(list: Box<[LocalTask]>, tasks: usize) -> Self {
        let mut places = vec![None; tasks];
        for (place, local) in list.iter().enumerate() {
            places[local.task.index()] = u16::try_from(place).ok();
        }
        Self { list, places: places.into() }
    }

    /// The member that runs `task`, if this node does.
    pub fn of(&self, task: TaskId) -> Option<&LocalTask> {
        self.list.get(self.place(task)?)
    }

    /// The position of `task` in the list.
    pub fn place(&self, task: TaskId) -> Option<usize> {
        self.places.get(task.index()).copied().flatten().map(usize::from)
    }
}
