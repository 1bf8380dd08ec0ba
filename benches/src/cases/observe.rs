//! Measures what monitors cost a node (goals M3, M4, M6). The monitors are real, connected to the node's socket: fast,
//! slow, stopped, or sending garbage.

use super::cells;
use super::recording::{Onlooker, Watched};
use crate::sample::{Sample, worked};
use crate::suite::{Effort, Goal, Row, Stat, Suite};
use imrs_protocol::{
    Class, NodeId, PortCounters, PortId, PortView, TaskId, TaskState, TaskView, Ticks, Usage,
};
use imrs_runtime::observer::Observer;
use imrs_runtime::{Context, Node, Runtime, TaskError};
use imrs_wire::obs::{
    ClientFrame, Delta, EventFilter, FrameReader, FrameWriter, Handshake, Hello, Liveness, MAX_FRAME, Role,
    SCHEMA, ServerFrame, Snapshot, TaskSnapshot, VERSION, Want,
};
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::channel;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// How long a simulated monitor waits before it checks again whether it must end.
const LOOK: Duration = Duration::from_millis(20);
/// The time between two updates that the monitor's screen requests, in microseconds.
const PERIOD_US: u32 = 100_000;

/// The monitors that are connected in a case.
#[derive(Clone, Copy)]
enum Crowd {
    /// No monitor, and the node has no socket for monitors.
    Nobody,
    /// No monitor, but the node listens for monitors.
    Empty,
    /// This many monitors, each of which reads everything.
    Readers(usize),
    /// One monitor, which never reads.
    Stopped,
    /// One monitor, which reads a byte a second.
    Slow,
    /// Monitors that connect one after the other. Each of them sends garbage.
    Mad,
}

/// The suite that measures the cost of being observed, and the size of updates.
#[must_use]
pub fn observe() -> Suite {
    let mut suite = Suite::new("observe");
    let crowds = [
        ("nobody", Crowd::Nobody),
        ("no monitor", Crowd::Empty),
        ("one monitor", Crowd::Readers(1)),
        ("five monitors", Crowd::Readers(5)),
        ("a stopped monitor", Crowd::Stopped),
        ("a slow monitor", Crowd::Slow),
        ("a mad monitor", Crowd::Mad),
    ];
    for (name, crowd) in crowds {
        suite.case(
            format!("watched by {name}"),
            "send, receive, reply between two Rust tasks of a node that sleep before every message; monitors of the same process read 10 times a second, events too; counts how many \
             percent more processor time the node takes because of the thread that serves monitors: what other programs take is not in it",
            move |effort| watched(effort, crowd, Measured::Passed),
        );
    }
    for (name, crowd) in &crowds[..4] {
        let crowd = *crowd;
        suite.case(
            format!("asked, watched by {name}"),
            "the same round trip; of each the processor time of the thread that asks, so that its percentiles do not depend on when other programs run; and of the ten parts of a \
             run the one with the least 99.9th percentile, because other programs only add to it, and monitors read several times in each part",
            move |effort| watched(effort, crowd, Measured::Own),
        );
    }
    for (name, percent) in [("no monitor", 1.0), ("one monitor", 2.0), ("five monitors", 3.0)] {
        let what = format!("% more processor time of a node, watched by {name}");
        let more = Goal::AtMost(percent);
        suite.row(Row::bounded("M3", &what, &format!("watched by {name}"), Stat::Count, more));
        let (own, against) = (format!("asked, watched by {name}"), "asked, watched by nobody");
        suite.row(Row::new("M3", own, against, Stat::P999, Goal::AtMost(1.05)));
    }
    for name in ["a stopped monitor", "a slow monitor", "a mad monitor"] {
        let what = format!("% more processor time of a node, watched by {name}");
        suite.row(Row::bounded("M4", &what, &format!("watched by {name}"), Stat::Count, Goal::AtMost(2.0)));
    }
    changes(&mut suite);
    suite
}

fn changes(suite: &mut Suite) {
    suite.case(
        "ten thousand ports, a change",
        "what changed of 10,000 ports of which a twentieth did, found and encoded; counts bytes a second at 10 Hz",
        |effort| change(effort, 20),
    );
    suite.case(
        "ten thousand ports, idle",
        "the same where nothing changed; counts bytes a second at 10 Hz",
        |effort| change(effort, usize::MAX),
    );
    suite.case("ten thousand ports, whole", "all of 10,000 ports, encoded; counts bytes", |effort| {
        let state = large();
        let (mut bytes, times) = (0, effort.of(20));
        let begins = Instant::now();
        for _ in 0..times {
            bytes = size(&Delta::whole(&state));
        }
        Sample::of_all(begins.elapsed(), times.into()).with(bytes as f64)
    });
    for (case, what, bound) in [
        ("ten thousand ports, a change", "bytes a second of 10,000 ports, 5 % of them dirty", 100_000.0),
        ("ten thousand ports, idle", "bytes a second of 10,000 idle ports", 1_000.0),
        ("ten thousand ports, whole", "bytes of a whole snapshot of 10,000 ports", 200_000.0),
    ] {
        suite.row(Row::bounded("M6", what, case, Stat::Count, Goal::AtMost(bound)));
    }
}

/// The measured time of a round trip.
#[derive(Clone, Copy)]
enum Measured {
    /// The wall-clock time. The sample also counts which share of the processor time serves monitors.
    Passed,
    /// The processor time of the thread that asks.
    Own,
}

fn watched(effort: Effort, crowd: Crowd, measured: Measured) -> Sample {
    let table = cells::asking(1, Usage::Send);
    let (tell, told) = channel();
    // The case is long enough for several updates of the monitors.
    let times = effort.of(30_000);
    let onlooker = Onlooker::of(Watched::Not, &table, NodeId(0));
    let node = onlooker.told_by(Runtime::builder(table, NodeId(0)));
    let (begin, begins) = channel::<()>();
    let node = node
        .task("t0", move |ctx| {
            begins.recv().expect("the harness says when");
            let sample = match measured {
                Measured::Passed => {
                    let before = Work::now();
                    let sample = cells::ask(ctx, &cells::FULL, times, 1)?;
                    sample.with(before.percent_since())
                }
                Measured::Own => asked(ctx, times)?,
            };
            tell.send(sample).expect("the harness listens");
            Ok(())
        })
        .task("t1", cells::answer)
        .start()
        .expect("a node that starts");
    let crowd = Monitors::come(crowd, node.node());
    begin.send(()).expect("the task waits");
    let sample = cells::hear(node, &told);
    crowd.leave();
    sample
}

/// Into how many parts the round trips of [`Measured::Own`] are divided.
const PARTS: u32 = 10;

/// Asks `times` times, and measures of each round trip the processor time of this thread. Returns the part of the run in
/// which the 99.9th percentile was the least.
fn asked(ctx: &mut Context, times: u32) -> Result<Sample, TaskError> {
    let each = (times / PARTS).max(1);
    let mut parts = Vec::new();
    for _ in 0..PARTS {
        let mut nanos = Vec::with_capacity(each as usize);
        for _ in 0..each {
            let before = worked();
            let sent = ctx.send(cells::ASK, &cells::FULL)?;
            nanos.push(worked().saturating_sub(before));
            assert!(sent.reply().is_some(), "no answer but {sent:?}");
        }
        parts.push(Sample::of(nanos, 1));
    }
    let least = parts.into_iter().min_by(|a, b| a.p999.total_cmp(&b.p999));
    Ok(least.expect("a run has parts"))
}

/// The processor time that threads of this process have used so far, in nanoseconds. The harness only waits, so its
/// time does not matter.
struct Work {
    /// The time of the thread that serves monitors.
    observer: u64,
    /// The time of all other threads, without those of the monitors.
    others: u64,
}

impl Work {
    fn now() -> Self {
        let mut work = Self { observer: 0, others: 0 };
        for thread in std::fs::read_dir("/proc/self/task").expect("a list of threads").flatten() {
            // A thread that has ended since it was listed has no files any more.
            let read = |name: &str| std::fs::read_to_string(thread.path().join(name)).unwrap_or_default();
            let nanos =
                read("schedstat").split_whitespace().next().and_then(|nanos| nanos.parse::<u64>().ok());
            match read("comm").trim_end() {
                MONITOR => {}
                "imrs observer" => work.observer += nanos.unwrap_or(0),
                _ => work.others += nanos.unwrap_or(0),
            }
        }
        work
    }

    /// By how many percent the thread that serves monitors has increased the node's processor time since then.
    fn percent_since(&self) -> f64 {
        let now = Self::now();
        let grown = |of: fn(&Self) -> u64| of(&now).saturating_sub(of(self)) as f64;
        100.0 * grown(|work| work.observer) / grown(|work| work.others).max(1.0)
    }
}

/// The name of the threads of the monitors.
const MONITOR: &str = "monitor";

/// Starts a thread of a monitor.
fn of_monitor(run: impl FnOnce() + Send + 'static) -> JoinHandle<()> {
    thread::Builder::new().name(MONITOR.into()).spawn(run).expect("a thread")
}

/// Running monitors.
struct Monitors {
    observer: Option<Observer>,
    /// The folder of the node's socket. A real node uses the folder of its cell.
    folder: Option<PathBuf>,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Monitors {
    fn come(crowd: Crowd, node: &Arc<Node>) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let mut monitors = Self { observer: None, folder: None, stop, threads: Vec::new() };
        if matches!(crowd, Crowd::Nobody) {
            return monitors;
        }
        let folder = folder();
        let path = folder.join("node-1.sock");
        monitors.folder = Some(folder);
        monitors.observer = Some(Observer::start_at(Arc::clone(node), &path).expect("a socket"));
        match crowd {
            Crowd::Nobody | Crowd::Empty => {}
            Crowd::Readers(count) => (0..count).for_each(|_| monitors.join(&path, read_all)),
            Crowd::Stopped => monitors.join(&path, |_, stop| wait(stop)),
            Crowd::Slow => monitors.join(&path, |mut stream, stop| {
                while !stop.load(Ordering::Relaxed) {
                    let _ = stream.read(&mut [0]);
                    (0..50).take_while(|_| !stop.load(Ordering::Relaxed)).for_each(|_| thread::sleep(LOOK));
                }
            }),
            Crowd::Mad => {
                let stop = Arc::clone(&monitors.stop);
                monitors.threads.push(of_monitor(move || {
                    while !stop.load(Ordering::Relaxed) {
                        if let Ok(mut stream) = UnixStream::connect(&path) {
                            let _ = stream.write_all(&[0xa5; 512]);
                        }
                        thread::sleep(LOOK);
                    }
                }));
            }
        }
        monitors
    }

    fn join(&mut self, path: &Path, watch: impl FnOnce(UnixStream, &AtomicBool) + Send + 'static) {
        let stream = attach(path);
        let stop = Arc::clone(&self.stop);
        self.threads.push(of_monitor(move || watch(stream, &stop)));
    }

    fn leave(self) {
        self.stop.store(true, Ordering::Relaxed);
        self.threads.into_iter().for_each(|thread| thread.join().expect("it only reads"));
        drop(self.observer);
        // If the empty folder cannot be removed, the measurement is still valid.
        let _ = self.folder.map(std::fs::remove_dir);
    }
}

/// A connection of a monitor that requests everything.
fn attach(path: &Path) -> UnixStream {
    let stream = UnixStream::connect(path).expect("the node listens");
    stream.set_read_timeout(Some(LOOK)).expect("a socket");
    let mut writer = FrameWriter::new(stream.try_clone().expect("a socket"));
    let hello = Hello { schema: SCHEMA, pid: 1, build: "bench".into(), mono_us: 0, role: Role::Monitor };
    writer.push_bytes(&Handshake::Hello(hello).encode(VERSION)).expect("a short frame");
    let want = Want {
        period_us: PERIOD_US,
        queue_limit: 64,
        watched: Vec::new(),
        events: Some(EventFilter::ALL),
        vitals_us: 1_000_000,
        whole_us: 0,
        credit: u16::MAX,
    };
    writer.push(&ClientFrame::Want(want)).expect("a short frame");
    writer.flush().expect("it is read");
    stream
}

/// Reads frames as the monitor does, but shows nothing.
fn read_all(stream: UnixStream, stop: &AtomicBool) {
    let mut reader = FrameReader::new(stream, MAX_FRAME);
    let mut frames = 0;
    while !stop.load(Ordering::Relaxed) {
        // A failed read means that nothing has arrived, or that the node has ended.
        frames += u64::from(reader.read_frame().is_ok());
    }
    std::hint::black_box(frames);
}

fn wait(stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        thread::sleep(LOOK);
    }
}

/// A new folder. A node searches its folder for the sockets of other nodes, so in a shared folder it would find
/// foreign files.
fn folder() -> PathBuf {
    static FOLDERS: AtomicU32 = AtomicU32::new(0);
    let number = FOLDERS.fetch_add(1, Ordering::Relaxed);
    let folder = std::env::temp_dir().join(format!("imrs-bench-{}-{number}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    folder
}

/// The state of a node with 100 tasks of 100 ports each.
fn large() -> Snapshot {
    let port = |id: u16| PortView {
        port: PortId(id),
        usage: Usage::Receive,
        class: Class::Status,
        len: 1,
        capacity: 8,
        min_slack: Some(Ticks(100_000 + u64::from(id))),
        queue: Vec::new(),
        counters: PortCounters { enqueued: 9_120, delivered: 9_041, ..PortCounters::default() },
    };
    let task = |id: u16| TaskSnapshot {
        liveness: Liveness::Alive,
        age_us: 0,
        view: TaskView {
            task: TaskId(id),
            state: TaskState::Running,
            ports: (id * 100..(id + 1) * 100).map(port).collect(),
            meetings: Vec::new(),
        },
    };
    Snapshot { mono_us: 1 << 32, tasks: (0..100).map(task).collect(), ..Snapshot::default() }
}

/// Measures updates in which one of `apart` ports has changed; with `usize::MAX`, no port.
fn change(effort: Effort, apart: usize) -> Sample {
    let old = large();
    let mut new = old.clone();
    new.mono_us += u64::from(PERIOD_US);
    new.uptime_us += u64::from(PERIOD_US);
    new.transit_age_us += u64::from(PERIOD_US);
    for task in &mut new.tasks {
        if apart == usize::MAX {
            task.age_us += u64::from(PERIOD_US);
            continue;
        }
        for (at, port) in task.view.ports.iter_mut().enumerate() {
            port.min_slack = port.min_slack.map(|left| left - Ticks(PERIOD_US.into()));
            if at % apart == 0 {
                port.counters.enqueued += 20;
                port.counters.delivered += 20;
                port.len = 3;
                port.min_slack = Some(Ticks(171_000));
            }
        }
    }
    let (mut bytes, times) = (0, effort.of(100));
    let begins = Instant::now();
    for _ in 0..times {
        bytes = size(&Delta::between(&old, &new));
    }
    Sample::of_all(begins.elapsed(), times.into()).with(bytes as f64 * 1e6 / f64::from(PERIOD_US))
}

/// The size of an encoded update, in bytes.
fn size(delta: &Delta) -> usize {
    let mut writer = FrameWriter::new(Vec::new());
    writer.push(&ServerFrame::Delta(delta.clone())).expect("it fits a frame");
    writer.flush().expect("memory takes everything");
    writer.get_ref().len()
}
