//! The thread that runs those tasks of a node whose programs are futures (D113).

use crate::builder::StartError;
use crate::clock;
use crate::context::{Caller, TaskError};
use crate::node::Node;
use crate::threads::{TaskEnd, message, spawn};
use futures_executor::LocalPool;
use futures_util::FutureExt;
use futures_util::task::LocalSpawnExt;
use imrs_wire::obs::Liveness;
use std::future::{Future, poll_fn};
use std::panic::AssertUnwindSafe;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Poll, Waker};
use std::thread::JoinHandle;

/// A task's program, for its thread alone.
pub(crate) type Program = Pin<Box<dyn Future<Output = Result<(), TaskError>>>>;
/// Makes the program of a task, with a context for this place of the node.
pub(crate) type AsyncBody = Box<dyn FnOnce(Arc<Node>, usize) -> Program + Send>;

pub(crate) struct Executor {
    thread: JoinHandle<()>,
    shared: Arc<Shared>,
}

/// When the thread ends.
#[derive(Default)]
struct Shared {
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    /// How many programs run.
    left: usize,
    closing: bool,
    waker: Option<Waker>,
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn change(&self, change: impl FnOnce(&mut State)) {
        let mut state = self.state();
        change(&mut state);
        let waker = state.waker.take();
        drop(state);
        waker.into_iter().for_each(Waker::wake);
    }
}

impl Executor {
    /// Starts the thread. `ended` is told how each program ended.
    pub fn start(
        node: &Arc<Node>,
        bodies: Vec<(usize, AsyncBody)>,
        ended: impl Fn(usize, TaskEnd) + Send + Sync + 'static,
    ) -> Result<Self, StartError> {
        let shared = Arc::new(Shared::default());
        shared.state().left = bodies.len();
        let (node, own) = (Arc::clone(node), Arc::clone(&shared));
        let ended: Arc<dyn Fn(usize, TaskEnd) + Send + Sync> = Arc::new(ended);
        let thread = spawn("imrs async", move || run(&node, bodies, &ended, &own))?;
        Ok(Self { thread, shared })
    }

    /// Programs that still run are dropped, unless they keep the thread: between two of their waits.
    pub fn close(&self) {
        self.shared.change(|state| state.closing = true);
    }

    /// Waits for the thread, unless a program may keep it.
    pub fn join(self) {
        if self.shared.state().left == 0 {
            // A panic of a program has ended that alone.
            let _ = self.thread.join();
        }
    }
}

fn run(
    node: &Arc<Node>,
    bodies: Vec<(usize, AsyncBody)>,
    ended: &Arc<dyn Fn(usize, TaskEnd) + Send + Sync>,
    shared: &Arc<Shared>,
) {
    clock::sleep_exactly();
    let mut pool = LocalPool::new();
    for (place, body) in bodies {
        let (node, ended, shared) = (Arc::clone(node), Arc::clone(ended), Arc::clone(shared));
        let program = async move {
            let end = to_its_end(&node, place, body).await;
            let crashed = matches!(end, TaskEnd::Panicked(_));
            node.members.list[place].set_liveness(if crashed { Liveness::Crashed } else { Liveness::Ended });
            Caller::of_a_future(node, place).end();
            ended(place, end);
            shared.change(|state| state.left -= 1);
        };
        // Refused only where the pool is gone.
        let _ = pool.spawner().spawn_local(program);
    }
    pool.run_until(poll_fn(|poller| {
        let mut state = shared.state();
        if state.closing || state.left == 0 {
            return Poll::Ready(());
        }
        state.waker = Some(poller.waker().clone());
        Poll::Pending
    }));
}

/// Runs a program. What it panics with is its crash, and no other's (D43).
async fn to_its_end(node: &Arc<Node>, place: usize, body: AsyncBody) -> TaskEnd {
    let node = Arc::clone(node);
    let whole = async move { body(node, place).await };
    match AssertUnwindSafe(whole).catch_unwind().await {
        Ok(Ok(()) | Err(TaskError::Stopped)) => TaskEnd::Returned,
        Ok(Err(error)) => TaskEnd::Failed(error),
        Err(panic) => TaskEnd::Panicked(message(panic.as_ref())),
    }
}
