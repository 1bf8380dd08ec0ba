//! Tests that an idle node, in which no task has work, sleeps: none of its threads wakes.

use crate::alone;
use crate::common::{A, B, LONG, cell, network, on, report, table};
use imrs_protocol::{Incarnation, NodeId, NodeTable, PortDecl, Ticks, Usage};
use imrs_runtime::TaskEnd;
use imrs_runtime::link::in_process::Faults;
use imrs_runtime::observer::Observer;
use imrs_runtime::record::{About, FileRecorder};
use std::time::{Duration, Instant};

const THREADS: [&str; 5] = ["idle-task", "imrs timer", "imrs receive", "imrs observer", "recording"];

/// A time after which every thread that still had something to do has done it.
const SETTLED: Duration = Duration::from_millis(300);

/// A thread of the node: its name, whether it sleeps, and how often it went to sleep.
type Sleeps = (String, bool, u64);

fn sleeps() -> Vec<Sleeps> {
    let of = |path: std::path::PathBuf| {
        let status = std::fs::read_to_string(path.join("status")).ok()?;
        let field = |name: &str| status.lines().find_map(|line| line.strip_prefix(name).map(str::trim));
        let name = field("Name:")?.to_owned();
        let count = field("voluntary_ctxt_switches:")?.parse().ok()?;
        let is_asleep = field("State:")?.starts_with('S');
        THREADS.contains(&name.as_str()).then_some((name, is_asleep, count))
    };
    let tasks = std::fs::read_dir("/proc/self/task").expect("the threads of this process");
    let mut counts: Vec<_> = tasks.flatten().filter_map(|task| of(task.path())).collect();
    counts.sort();
    counts
}

/// Waits until all threads sleep and none has been woken from its last wait. A thread that was woken may not run yet,
/// because the machine is busy; it does not count as asleep.
fn settled() -> Vec<Sleeps> {
    let start = Instant::now();
    let mut before = sleeps();
    loop {
        std::thread::sleep(SETTLED);
        let now = sleeps();
        if now == before && now.len() == THREADS.len() && now.iter().all(|(_, is_asleep, _)| *is_asleep) {
            return now;
        }
        assert!(start.elapsed() < LONG, "the node does not come to rest: {now:?}");
        before = now;
    }
}

#[test]
fn a_node_with_nothing_pending_never_wakes() {
    let _alone = alone();
    let mut cell = cell(&[0, 1], Ticks(100));
    cell.tasks[0].name = "idle-task".into();
    cell.port(PortDecl::new("news", B, Usage::Send, &[A], Ticks(100_000)));
    let table = table(cell);
    let network = network(&table, Faults::default());
    let _neighbour = network.join(NodeId(1), Incarnation(1), false);
    let (begin, begun) = report::<()>();
    let about =
        About { incarnation: (Incarnation(0), false), insecure: false, build: "a test", statements: 0 };
    let here = NodeTable::new(table.clone(), NodeId(0));
    let recorder = FileRecorder::start(std::io::sink(), &here, &about, |error| panic!("{error}")).unwrap();
    let node = on(&network, &table, 0)
        .recorder(recorder.clone())
        .task("idle-task", move |ctx| {
            // The task first makes a delay and a wait with a time_out, which must leave no later wake-up
            // behind.
            ctx.delay(Duration::from_millis(20))?;
            assert_eq!(ctx.receive(None, Some(Duration::from_millis(20)))?, None);
            begin.send(()).expect("the test listens");
            ctx.receive(None, None).map(|_| ())
        })
        .start()
        .unwrap();
    let socket = std::env::temp_dir().join(format!("imrs-runtime-idle-{}.sock", std::process::id()));
    let observer = Observer::start_at(node.node().clone(), &socket).unwrap();
    begun.recv_timeout(LONG).expect("the task gets that far");
    let before = settled();
    std::thread::sleep(Duration::from_millis(1_000));
    assert_eq!(sleeps(), before, "a thread woke");
    drop(observer);
    let ends = node.stop(LONG);
    assert_eq!(ends[0].1, TaskEnd::Returned);
    let recorded = recorder.stop(LONG).expect("it is stopped once");
    assert!(recorded.records > 2 && recorded.lost == 0, "{recorded:?}");
}
