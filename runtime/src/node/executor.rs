//! The thread that runs those tasks of a node whose programs are futures (D113).

use crate::api::context::{Caller, TaskError};
use crate::clock;
use crate::node::domain::{Answers, Domain};
use crate::node::effects::Effects;
use crate::node::failstop::guarded;
use crate::node::local_task::Marking;
use crate::node::program::{AsyncBody, StartError, TaskEnd, message, spawn};
use crate::node::{Inlet, Node};
use crate::sync::lead::Led;
use crate::sync::park::Park;
use crate::sync::ready::ReadyFutures;
use imrs_wire::obs::Liveness;
use std::cell::RefCell;
use std::future::{Future, poll_fn};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::pin::{Pin, pin};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::task::{Context, Poll, Wake, Waker};
use std::thread::JoinHandle;

/// After this many waits in a row that no datagram ended, the thread stops waiting in the socket until a datagram
/// comes for a future. A wake-up in the socket costs two syscalls more than one elsewhere. One wait is too few,
/// because each delay of a future ends a wait.
const ELSEWHERE: u32 = 8;

impl Node {
    /// Wakes the futures for which there is an answer.
    #[inline]
    pub(crate) fn call_futures(&self, effects: &mut Effects) {
        while let Some(place) = effects.called.pop() {
            guarded("the waker of a future", || self.locals.list[place].call(effects));
        }
    }

    /// Lets the thread of the futures work on the communication task of one future. Also returns whether the
    /// node stops.
    pub(crate) fn look_in<R>(
        &self,
        place: usize,
        work: impl FnOnce(&mut Domain, usize, &mut Effects) -> R,
        effects: &mut Effects,
    ) -> (R, bool) {
        let local = &self.locals.list[place];
        // `work` is code of the runtime, so a panic in it ends the process, although a future is being polled.
        let work = |domain: &mut Domain, effects: &mut Effects| {
            guarded("a communication task", || work(domain, local.home.member(), effects))
        };
        let entered = local.handoff.enter_shared(work, effects);
        self.carry_out(effects);
        entered
    }
}

/// A callback: it gets the position of a program among the node's tasks, and how that program ended.
type Ended = Arc<dyn Fn(usize, TaskEnd) + Send + Sync>;

pub(crate) struct Executor {
    thread: JoinHandle<()>,
    shared: Arc<Shared>,
}

/// The state that the executor shares with its thread. The thread ends when no program is left or the node closes.
struct Shared {
    /// How many programs still run.
    left: AtomicUsize,
    closing: AtomicBool,
    ready: Arc<ReadyFutures>,
}

impl Executor {
    /// Starts the thread. The thread calls `ended` with how each program ended.
    pub fn start(
        node: &Arc<Node>,
        bodies: Vec<(usize, AsyncBody)>,
        ended: impl Fn(usize, TaskEnd) + Send + Sync + 'static,
    ) -> Result<Self, StartError> {
        let ready = Arc::new(ReadyFutures::new(bodies.len(), Park::new(node.waker())));
        let left = AtomicUsize::new(bodies.len());
        let shared = Arc::new(Shared { left, closing: AtomicBool::new(false), ready: Arc::clone(&ready) });
        for (index, (place, _)) in bodies.iter().enumerate() {
            let waker = Waker::from(Arc::new(Mark { ready: Arc::clone(&ready), index }));
            let marking = Marking { ready: Arc::clone(&ready), index, waker };
            let _ = node.locals.list[*place].marking.set(marking);
        }
        let (node, own) = (Arc::clone(node), Arc::clone(&shared));
        let ended: Ended = Arc::new(ended);
        let thread = spawn("imrs async", move || run(&node, bodies, &ended, &own))?;
        Ok(Self { thread, shared })
    }

    /// Tells the thread to end. The thread drops the programs that still run as soon as all of them wait.
    pub fn close(&self) {
        self.shared.closing.store(true, Ordering::Release);
        self.shared.ready.park.call();
    }

    /// Waits for the thread to end, unless a program may keep it busy.
    pub fn join(self) {
        if self.shared.left.load(Ordering::Acquire) == 0 {
            // A panic of a program has ended only that program, not this thread.
            let _ = self.thread.join();
        }
    }
}

/// A program on the thread of the futures, and the waker that marks the program as ready.
struct Polled {
    program: Pin<Box<dyn Future<Output = ()>>>,
    waker: Waker,
}

fn run(node: &Arc<Node>, bodies: Vec<(usize, AsyncBody)>, ended: &Ended, shared: &Arc<Shared>) {
    clock::sleep_exactly();
    let answers = Rc::new(RefCell::new(Answers::default()));
    let program = |(place, body): (usize, AsyncBody)| {
        let (own_node, answers) = (Arc::clone(node), Rc::clone(&answers));
        let (node, ended, own) = (Arc::clone(node), Arc::clone(ended), Arc::clone(shared));
        let program = Box::pin(async move {
            let end = to_its_end(&node, place, body, &answers).await;
            let crashed = matches!(end, TaskEnd::Panicked(_));
            node.locals.list[place].set_liveness(if crashed { Liveness::Crashed } else { Liveness::Ended });
            Caller::of_a_future(node, place, answers).end();
            ended(place, end);
            own.left.fetch_sub(1, Ordering::Release);
        });
        let waker = own_node.locals.list[place].marking.get().map(|marking| marking.waker.clone());
        Some(Polled { program, waker: waker? })
    };
    let mut programs: Vec<Option<Polled>> = bodies.into_iter().map(program).collect();
    let mut waits = Waits { node, park: &shared.ready.park, inlet: None, elsewhere: 0 };
    loop {
        shared.ready.poll_ready(|index| poll(&mut programs[index]));
        if shared.left.load(Ordering::Acquire) == 0 || shared.closing.load(Ordering::Acquire) {
            return;
        }
        if !shared.ready.any() {
            waits.wait();
        }
    }
}

/// Polls a program, unless the program has ended: a waker may outlive its program.
fn poll(place: &mut Option<Polled>) {
    if let Some(Polled { program, waker }) = place
        && program.as_mut().poll(&mut Context::from_waker(waker)).is_ready()
    {
        *place = None;
    }
}

/// The waker of a future: it marks the future as ready, and wakes the thread of the futures.
struct Mark {
    ready: Arc<ReadyFutures>,
    index: usize,
}

impl Wake for Mark {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        self.ready.wake(self.index);
    }
}

/// How the thread of the futures waits while all its futures wait.
struct Waits<'a> {
    node: &'a Arc<Node>,
    park: &'a Park,
    /// The buffers with which the thread receives. Made when the thread first leads.
    inlet: Option<Inlet>,
    /// How many waits in a row ended without a datagram for a future.
    elsewhere: u32,
}

impl Waits<'_> {
    /// Waits in the link's socket if a datagram is likely to bring the next answer; otherwise sleeps.
    fn wait(&mut self) {
        let node = self.node;
        let by_link = node.futures_by_link.swap(false, Ordering::Relaxed);
        self.elsewhere = if by_link { 0 } else { self.elsewhere.saturating_add(1) };
        let leading =
            node.link.as_ref().filter(|_| self.elsewhere < ELSEWHERE).and_then(|link| link.leading());
        if let Some(leading) = leading {
            let inlet = self.inlet.get_or_insert_with(|| Inlet::new(Arc::clone(node)));
            let take_in = || guarded("the thread of the futures, which receives", || leading.take_in(inlet));
            if node.lead.wait(self.park, || leading.wait(None), take_in) != Led::No {
                return;
            }
        }
        self.park.sleep();
    }
}

/// Runs a program to its end. Its panic is the crash of this task alone (D43).
async fn to_its_end(
    node: &Arc<Node>,
    place: usize,
    body: AsyncBody,
    answers: &Rc<RefCell<Answers>>,
) -> TaskEnd {
    let (node, answers) = (Arc::clone(node), Rc::clone(answers));
    let mut whole = pin!(async move { body(Caller::of_a_future(node, place, answers)).await });
    let end = poll_fn(|context| {
        let polled = catch_unwind(AssertUnwindSafe(|| whole.as_mut().poll(context)));
        polled.map_or_else(|panic| Poll::Ready(Err(panic)), |polled| polled.map(Ok))
    });
    match end.await {
        Ok(Ok(()) | Err(TaskError::Stopped)) => TaskEnd::Returned,
        Ok(Err(error)) => TaskEnd::Failed(error),
        Err(panic) => TaskEnd::Panicked(message(panic.as_ref())),
    }
}
