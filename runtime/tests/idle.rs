//! A node with nothing to wait for sleeps: no thread of it wakes. A program of its own, for the kernel counts by thread and
//! other tests have threads of the same names.

mod common;

use common::{LONG, cell, network, on, report, table};
use imrs_protocol::{Incarnation, NodeId, NodeTable, PortDecl, Ticks, Usage};
use imrs_runtime::TaskEnd;
use imrs_runtime::link::in_process::Faults;
use imrs_runtime::observer::Observer;
use imrs_runtime::record::{About, FileRecorder};
use std::time::Duration;

const THREADS: [&str; 5] = ["idle-task", "imrs timer", "imrs receive", "imrs observer", "recording"];

/// How often each thread of the node went to sleep.
fn sleeps() -> Vec<(String, u64)> {
    let of = |path: std::path::PathBuf| {
        let status = std::fs::read_to_string(path.join("status")).ok()?;
        let field =
            |name: &str| status.lines().find_map(|l| l.strip_prefix(name).map(|rest| rest.trim().to_owned()));
        let name = field("Name:")?;
        let count = field("voluntary_ctxt_switches:")?.parse().ok()?;
        THREADS.contains(&name.as_str()).then_some((name, count))
    };
    let tasks = std::fs::read_dir("/proc/self/task").expect("the threads of this process");
    let mut counts: Vec<_> = tasks.flatten().filter_map(|task| of(task.path())).collect();
    counts.sort();
    counts
}

#[test]
fn a_node_with_nothing_pending_never_wakes() {
    let mut cell = cell(&[0, 1], Ticks(100));
    cell.tasks[0].name = "idle-task".into();
    cell.port(PortDecl::new("news", common::B, Usage::Send, &[common::A], Ticks(100_000)));
    let table = table(cell);
    let network = network(&table, Faults::default());
    let _neighbour = network.join(NodeId(1), Incarnation(1), false);
    let (begin, begun) = report::<()>();
    let about = About { life: (Incarnation(0), false), insecure: false, build: "a test", statements: 0 };
    let here = NodeTable::new(table.clone(), NodeId(0));
    let recorder = FileRecorder::start(std::io::sink(), &here, &about, |error| panic!("{error}")).unwrap();
    let node = on(&network, &table, 0)
        .recorder(recorder.clone())
        .task("idle-task", move |ctx| {
            // Something has been timed before: nothing of it is left.
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
    std::thread::sleep(Duration::from_millis(300));
    let before = sleeps();
    assert_eq!(before.len(), THREADS.len(), "{before:?}");
    std::thread::sleep(Duration::from_millis(1_000));
    assert_eq!(sleeps(), before, "a thread woke");
    drop(observer);
    let ends = node.stop(LONG);
    assert_eq!(ends[0].1, TaskEnd::Returned);
    let recorded = recorder.stop(LONG).expect("it is stopped once");
    assert!(recorded.records > 2 && recorded.lost == 0, "{recorded:?}");
}
