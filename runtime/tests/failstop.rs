//! A panic in the machinery ends the node at once, not only the thread it happened in (D43).

mod common;

use common::{LONG_TICKS, ask, cell, one_node, table};
use imrs_protocol::{TaskId, Ticks};
use imrs_runtime::record::{OutputDigest, Recorder, Step};
use std::os::unix::process::ExitStatusExt;
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

const CHILD: &str = "IMRS_TEST_FAIL_STOP";

/// Called under a communication task's lock, so its panic is one in the machinery.
struct Broken;

impl Recorder for Broken {
    fn step(&self, _task: TaskId, _step: Step, _digest: OutputDigest) -> bool {
        panic!("this panic is part of the test");
    }
}

#[test]
fn a_panic_in_the_machinery_aborts_the_process() {
    if std::env::var_os(CHILD).is_some() {
        let mut cell = cell(&[0, 0], Ticks(0));
        cell.port(ask(LONG_TICKS));
        let node = one_node(&table(cell))
            .recorder(Arc::new(Broken))
            .task("a", |ctx| ctx.delay(Duration::ZERO))
            .task("b", |_| Ok(()))
            .start()
            .unwrap();
        let survived = node.wait(common::LONG);
        panic!("the process went on; all programs ended: {survived}");
    }
    let mut child = Command::new(std::env::current_exe().unwrap());
    child.args(["--exact", "a_panic_in_the_machinery_aborts_the_process", "--nocapture"]).env(CHILD, "1");
    let output = child.output().expect("this test's own program");
    assert_eq!(output.status.signal(), Some(6), "{output:?}");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("a communication task panicked; the node stops"), "{said}");
}
