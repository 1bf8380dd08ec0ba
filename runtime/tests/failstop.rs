//! A panic in the runtime itself ends the node at once, not only the thread in which it happened (D43).

use crate::alone;
use crate::common::{B, LONG, LONG_TICKS, ask, cell, one_node, table};
use imrs_protocol::script::{Program, ProgramBuilder, Type};
use imrs_protocol::{NodeId, Packet, PortId, Target, TaskId, Ticks};
use imrs_runtime::Runtime;
use imrs_runtime::link::{Link, LinkBusy, PollEnd, Sink};
use imrs_runtime::record::{Log, OutputDigest, Recorder, Step};
use std::io::Write;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::ExitStatusExt;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

const CHILD: &str = "IMRS_TEST_FAIL_STOP";

/// Runs this test's `node` in a process of its own, which the fail-stop must end. Returns the error output of that process.
fn said_at_its_end(test: &str, node: impl FnOnce() -> Runtime) -> String {
    let _alone = alone();
    if std::env::var_os(CHILD).is_some() {
        let survived = node().wait(LONG);
        panic!("the process went on; all programs ended: {survived}");
    }
    let output = child(test).output().expect("this test's own program");
    assert_eq!(output.status.signal(), Some(6), "{output:?}");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The command that runs the test `test` in a process of its own.
fn child(test: &str) -> Command {
    let (_program, module) = module_path!().split_once("::").expect("a module of the test program");
    let mut child = Command::new(std::env::current_exe().unwrap());
    child.args(["--exact", &format!("{module}::{test}"), "--nocapture"]).env(CHILD, "1");
    child
}

/// A recorder that panics. It is called under a communication task's lock, so its panic is a panic of the runtime itself.
struct Broken;

impl Recorder for Broken {
    fn log(self: Arc<Self>, _task: TaskId) -> Option<Box<dyn Log>> {
        Some(Box::new(Self))
    }
}

impl Log for Broken {
    fn step(&mut self, _step: &Step, _digest: OutputDigest) -> bool {
        panic!("this panic is part of the test");
    }
}

#[test]
fn a_panic_in_the_machinery_aborts_the_process() {
    let said = said_at_its_end("a_panic_in_the_machinery_aborts_the_process", broken);
    assert!(said.contains("a communication task panicked; the node stops"), "{said}");
}

/// A node with a communication task that panics at its first step.
fn broken() -> Runtime {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    let node = one_node(&table(cell)).recorder(Arc::new(Broken));
    node.task("a", |ctx| ctx.delay(Duration::ZERO)).task("b", |_| Ok(())).start().unwrap()
}

#[test]
fn a_standard_error_that_nobody_reads_does_not_hold_up_the_abort() {
    let _alone = alone();
    if std::env::var_os(CHILD).is_some() {
        // Rust's default panic hook also writes to standard error, and would block here.
        std::panic::set_hook(Box::new(|_| ()));
        let survived = broken().wait(LONG);
        unreachable!("the process went on; all programs ended: {survived}");
    }
    let (mut full, _reader) = UnixStream::pair().unwrap();
    full.set_nonblocking(true).unwrap();
    while full.write(&[b'x'; 4096]).is_ok() {}
    // Now the pipe is nearly full, but single bytes may still fit.
    while full.write(b"x").is_ok() {}
    full.set_nonblocking(false).unwrap();
    let mut child = child("a_standard_error_that_nobody_reads_does_not_hold_up_the_abort");
    let status = child.stderr(OwnedFd::from(full)).stdout(Stdio::null()).status().unwrap();
    assert_eq!(status.signal(), Some(6), "{status:?}");
}

/// A link that panics only if the Timer thread sends.
struct BreaksTheTimer;

impl Link for BreaksTheTimer {
    fn ready(&self, _next: NodeId) -> bool {
        true
    }

    fn send_at(&self, _next: NodeId, packets: &[Packet], _at: Instant) -> Result<usize, LinkBusy> {
        assert_ne!(std::thread::current().name(), Some("imrs timer"), "this panic is part of the test");
        Ok(packets.len())
    }

    fn poll(&self, _sink: &dyn Sink, _until: Option<Instant>) -> PollEnd {
        std::thread::sleep(Duration::from_millis(10));
        PollEnd::TimedOut
    }

    fn wake(&self) {}
}

/// A script that asks a task of another node after a delay. No thread of the script's own waits for the delay.
fn late_asker() -> Arc<Program> {
    let mut b = ProgramBuilder::new("late asker");
    let n = b.variable("n", Type::Int32);
    b.delay(Ticks(20_000));
    b.send(PortId(0), Target::One(B), &[(Type::Int32, n)]);
    b.end();
    Arc::new(b.finish().unwrap())
}

#[test]
fn a_panic_of_the_timer_aborts_the_process() {
    let said = said_at_its_end("a_panic_of_the_timer_aborts_the_process", || {
        let mut cell = cell(&[0, 1], Ticks(2_000));
        cell.port(ask(LONG_TICKS));
        let node = Runtime::builder(table(cell), NodeId(0)).link(Arc::new(BreaksTheTimer));
        node.script("a", late_asker()).start().unwrap()
    });
    assert!(
        said.contains("thread 'imrs timer'") && said.contains("this panic is part of the test"),
        "{said}"
    );
    assert!(said.contains("the route layer, the Timer or a link panicked; the node stops"), "{said}");
}
