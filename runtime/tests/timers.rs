//! Tests of how a node keeps time: every thread asks for exact sleeps, an answered time_out wakes no thread, and a
//! node that was stopped discards what has expired. These tests run alone, because they find threads by name and stop
//! the whole process.

use crate::alone;
use crate::common::{A, B, LONG, LONG_TICKS, ask, cell, report, table};
use imrs_protocol::{NodeId, Outcome, Packet, PortDecl, TaskId, Ticks, Usage};
use imrs_runtime::link::{Link, LinkBusy, PollEnd, Sink};
use imrs_runtime::record::{Log, OutputDigest, Recorder, Step};
use imrs_runtime::{Context, Runtime, Sent, TaskEnd, TaskError};
use std::process::Command;
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

/// How long the test stops the whole process.
const STOP: Duration = Duration::from_millis(500);
/// A TTL that ends while the process is stopped.
const SHORT: Ticks = Ticks(200_000);
const COMMANDS: u32 = 1_000;
const NEWS: u16 = 8;

/// For each thread that called this recorder or link: how late the kernel may end the thread's sleeps, in
/// nanoseconds.
#[derive(Default)]
struct Slacks {
    of: Mutex<Vec<(String, u64)>>,
    woken: Mutex<bool>,
    changed: Condvar,
}

impl Slacks {
    fn note(&self) {
        let slack = rustix::thread::current_timer_slack().expect("the kernel says");
        let name = std::thread::current().name().unwrap_or_default().to_owned();
        let mut of = self.of.lock().unwrap();
        if !of.iter().any(|(known, _)| *known == name) {
            of.push((name, slack));
        }
    }
}

/// The threads that run the state machines call the functions of this recorder.
impl Recorder for Slacks {
    fn log(self: Arc<Self>, _task: TaskId) -> Option<Box<dyn Log>> {
        Some(Box::new(NotesSlack(self)))
    }
}

struct NotesSlack(Arc<Slacks>);

impl Log for NotesSlack {
    fn step(&mut self, _step: &Step, _digest: OutputDigest) -> bool {
        self.0.note();
        false
    }
}

/// The receiving thread calls the functions of this link; the link does nothing else.
impl Link for Slacks {
    fn ready(&self, _next: NodeId) -> bool {
        false
    }

    fn send_at(&self, _next: NodeId, _packets: &[Packet], _at: Instant) -> Result<usize, LinkBusy> {
        Err(LinkBusy)
    }

    fn poll(&self, _sink: &dyn Sink, _until: Option<Instant>) -> PollEnd {
        self.note();
        let asleep = |woken: &mut bool| !std::mem::take(woken);
        drop(self.changed.wait_while(self.woken.lock().unwrap(), asleep).unwrap());
        PollEnd::Woken
    }

    fn wake(&self) {
        *self.woken.lock().unwrap() = true;
        self.changed.notify_all();
    }
}

/// How often the Timer thread went to sleep.
fn sleeps_of_the_timer() -> u64 {
    let of = |path: std::path::PathBuf| {
        let status = std::fs::read_to_string(path.join("status")).ok()?;
        let field = |name: &str| status.lines().find_map(|l| l.strip_prefix(name).map(str::trim));
        (field("Name:")? == "imrs timer").then(|| field("voluntary_ctxt_switches:")?.parse().ok()).flatten()
    };
    let end = Instant::now() + LONG;
    loop {
        let threads = std::fs::read_dir("/proc/self/task").expect("the threads of this process");
        if let Some(slept) = threads.flatten().find_map(|thread| of(thread.path())) {
            return slept;
        }
        // A thread sets its name only once it runs.
        assert!(Instant::now() < end, "there is no thread of the Timer");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Stops this process for [`STOP`], and returns once the process goes on.
fn stand_still() {
    let me = std::process::id();
    let script = format!("kill -STOP {me}; sleep {}; kill -CONT {me}", STOP.as_secs_f64());
    assert!(Command::new("sh").args(["-c", &script]).status().expect("a shell").success());
}

/// The program of `a`: it sends commands that are answered at once, each with a time_out. Then it sends statuses that
/// no task takes in time.
fn a(ctx: &mut Context, answered: &std::sync::mpsc::Sender<()>) -> Result<(), TaskError> {
    let (ask, news) = (ctx.port("ask")?, ctx.port("news")?);
    for _ in 0..COMMANDS {
        assert!(matches!(ctx.send(ask, b"?")?, Sent::Outcome(Outcome::Reply(_))));
    }
    for _ in 0..NEWS {
        assert_eq!(ctx.send(news, b"!")?, Sent::Copies(1));
    }
    answered.send(()).expect("the test listens");
    Ok(())
}

/// The program of `b`: it answers the commands. After the stop it must find no expired status.
fn b(ctx: &mut Context, gate: &Receiver<()>) -> Result<(), TaskError> {
    let ask = ctx.port("ask")?;
    for _ in 0..COMMANDS {
        let question = ctx.receive(Some(ask), None)?.expect("without a time_out only a message ends it");
        ctx.reply(&question.from, b".")?;
    }
    gate.recv_timeout(LONG).expect("the test goes on");
    assert_eq!(ctx.poll(None)?, None, "news from before the stop");
    Ok(())
}

/// The program of `c`: it makes delays, and the process is stopped during one of them. Each delay takes its full
/// time: the one that the stop interrupts, and those after it.
fn c(ctx: &mut Context) -> Result<(), TaskError> {
    const LENGTH: Duration = Duration::from_millis(20);
    let begin = Instant::now();
    while begin.elapsed() < 3 * STOP {
        let start = Instant::now();
        ctx.delay(LENGTH)?;
        assert!(start.elapsed() >= LENGTH, "early: {:?}", start.elapsed());
    }
    Ok(())
}

#[test]
fn time_is_kept_by_threads_that_sleep_exactly_and_seldom() {
    let _alone = alone();
    let mut cell = cell(&[0, 0, 0, 1], Ticks(100));
    cell.port(ask(LONG_TICKS));
    cell.port(PortDecl::new("news", A, Usage::Send, &[B], SHORT).bounded_buffer(NEWS));
    let slacks = Arc::new(Slacks::default());
    let (answered, all_answered) = report();
    let (open, gate) = report();
    let node = Runtime::builder(table(cell), NodeId(0))
        .recorder(Arc::clone(&slacks) as Arc<dyn Recorder>)
        .link(Arc::clone(&slacks) as Arc<dyn Link>)
        .task("a", move |ctx| a(ctx, &answered))
        .task("b", move |ctx| b(ctx, &gate))
        .task("c", c)
        .start()
        .unwrap();
    let before = sleeps_of_the_timer();
    all_answered.recv_timeout(LONG).expect("every command is answered");
    let slept = sleeps_of_the_timer() - before;
    assert!(slept < u64::from(COMMANDS / 10), "the Timer's thread woke {slept} times for {COMMANDS} answers");

    let start = Instant::now();
    stand_still();
    assert!(start.elapsed() >= STOP);
    let expired = || {
        let snapshot = node.node().snapshot(NEWS.into());
        snapshot.tasks[1].view.ports.iter().map(|port| port.counters.expired).sum::<u64>()
    };
    let start = Instant::now();
    while expired() < u64::from(NEWS) {
        assert!(start.elapsed() < LONG, "only {} expired", expired());
        std::thread::sleep(Duration::from_millis(1));
    }
    open.send(()).expect("b waits");
    assert!(node.wait(LONG), "a program did not end");
    let ends = node.stop(LONG);
    assert!(ends.iter().all(|(_, end)| *end == TaskEnd::Returned), "{ends:?}");

    let mut seen = std::mem::take(&mut *slacks.of.lock().unwrap());
    let own = std::thread::current();
    seen.retain(|(name, _)| own.name() != Some(name));
    seen.sort();
    let exact = ["a", "b", "c", "imrs receive", "imrs timer"].map(|name| (name.to_owned(), 1));
    assert_eq!(seen, exact);
}
