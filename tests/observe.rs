//! Tests of what a monitor shows of nodes that appear, die and come back (goal M8). The nodes are real processes, which
//! are killed as by a power cut.

use crate::support::{bound, is_quiet};
use imrs_monitor::Watch;
use imrs_monitor::clock::Clock;
use imrs_monitor::source::live::Which;
use imrs_monitor::store::{Condition, NodeIncarnation};
use imrs_protocol::{Cell, CellTable, NodeId, PortDecl, Ticks, Usage};
use imrs_runtime::Runtime;
use imrs_runtime::observer::Observer;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

/// The environment variable with the folder in which the node of the child process puts its socket.
const FOLDER: &str = "IMRS_TEST_NODE_IN";
/// How long every wait may take on a busy machine.
const LONG: Duration = Duration::from_secs(60);
/// The promised times on a quiet machine, for the best of several trials: to attach, to show a death, to show a return.
/// These times are asserted if `IMRS_QUIET=1` says that this machine is quiet.
const GOALS: [(&str, Duration); 3] = [
    ("attach to first full frame", Duration::from_millis(150)),
    ("death shown", Duration::from_secs(1)),
    ("reattach after restart", Duration::from_secs(1)),
];

/// The body of a child process. The other test starts and kills that process.
#[test]
fn the_node_of_the_other_process() {
    let Some(folder) = std::env::var_os(FOLDER) else { return };
    let mut cell = Cell::new("watched", Ticks(1_000));
    let node = cell.node("n0");
    let (a, b) = (cell.task("a", node), cell.task("b", node));
    cell.port(PortDecl::new("news", a, Usage::Send, &[b], Ticks(60_000_000)).bounded_buffer(16));
    let runtime = Runtime::builder(Arc::new(CellTable::new(cell).unwrap()), NodeId(0))
        .task("a", |ctx| {
            let news = ctx.port("news")?;
            loop {
                let _copies = ctx.send(news, b"news")?;
                ctx.delay(Duration::from_millis(5))?;
            }
        })
        .task("b", |ctx| {
            let news = ctx.port("news")?;
            while ctx.receive(Some(news), None)?.is_some() {}
            Ok(())
        })
        .start()
        .unwrap();
    let path = PathBuf::from(folder).join(format!("n0-{}.sock", std::process::id()));
    let _observer = Observer::start_at(Arc::clone(runtime.node()), &path).unwrap();
    // The other test of this file needs this node for a shorter time.
    thread::sleep(2 * LONG);
}

/// A node in a child process. Dropping this value kills the process.
struct Node(Child);

impl Node {
    fn start(folder: &Path) -> Self {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", "observe::the_node_of_the_other_process", "--test-threads", "1"]);
        let command = command.env(FOLDER, folder).stdin(Stdio::null()).stdout(Stdio::null());
        let node = Self(command.stderr(Stdio::null()).spawn().unwrap());
        let socket = folder.join(format!("n0-{}.sock", node.0.id()));
        let start = Instant::now();
        while UnixStream::connect(&socket).is_err() {
            assert!(start.elapsed() < LONG, "it never listened");
            thread::sleep(Duration::from_millis(1));
        }
        node
    }

    /// Kills the process, as `kill -9` does.
    fn kill(mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn until(watch: &mut Watch, what: &str, done: impl Fn(&[NodeIncarnation]) -> bool) -> Duration {
    let start = Instant::now();
    while !done(watch.store().incarnations()) {
        assert!(start.elapsed() < LONG, "{what}: never");
        watch.watch(Duration::from_millis(2));
    }
    start.elapsed()
}

#[test]
fn a_killed_node_is_shown_dead_and_shown_again_when_it_is_back() {
    let times = usize::try_from(bound("IMRS_KILLS", 10)).expect("a number");
    let temp = tempfile::tempdir().unwrap();
    let folder = temp.path().join("watched");
    std::fs::create_dir(&folder).unwrap();
    let mut took: [Vec<Duration>; 3] = Default::default();
    for _ in 0..times {
        let node = Node::start(&folder);
        let start = Instant::now();
        let mut watch = Watch::start(Which::Under(temp.path().to_owned()), Clock::start()).unwrap();
        until(&mut watch, "attached", |incarnations| {
            incarnations.iter().any(|incarnation| incarnation.last.is_some())
        });
        took[0].push(start.elapsed());
        let shown = |incarnation: &NodeIncarnation| {
            incarnation.condition == Condition::Attached && incarnation.last.is_some()
        };
        assert_eq!(watch.store().incarnations().iter().filter(|incarnation| shown(incarnation)).count(), 1);
        node.kill();
        took[1].push(until(&mut watch, "dead", |incarnations| {
            incarnations.iter().all(|incarnation| matches!(incarnation.condition, Condition::Dead { .. }))
        }));
        let again = Node::start(&folder);
        took[2].push(until(&mut watch, "back", |incarnations| incarnations.iter().any(shown)));
        again.kill();
    }
    for (took, (what, goal)) in took.iter_mut().zip(GOALS) {
        took.sort();
        let (least, half, most) = (took[0], took[times / 2], took[times - 1]);
        println!(
            "{what}: {least:?} at least, {half:?} in the middle, {most:?} at most of {times}; goal {goal:?}"
        );
        assert!(!is_quiet() || least <= goal, "{what}: {least:?} at best");
    }
}
