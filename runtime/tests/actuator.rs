//! Tests of a tool's gate: programs of only one epoch act at a time.

use crate::common::report;
use imrs_runtime::actuator::{Deadline, Gate, GateError, Refused};
use std::fs;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use tempfile::TempDir;

fn place() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("tool.gate");
    (folder, path)
}

/// The epoch of the refused program, and the newest epoch in the gate that refused it.
fn over(refused: Refused) -> (u8, u8) {
    match refused {
        Refused::Epoch { shown, newest } => (shown, newest),
        other => panic!("{other}"),
    }
}

#[test]
fn older_epochs_are_refused_around_the_wrap_and_after_a_start() {
    let (_folder, path) = place();
    let gate = Gate::open(&path).unwrap();
    let admit = |epoch| gate.admit(epoch, Deadline::none());
    let mut first = admit(250).unwrap();
    assert!(first.may_act() && admit(250).unwrap().may_act(), "the same task may act twice");
    assert_eq!(over(admit(249).unwrap_err()), (249, 250));
    let second = admit(3).unwrap();
    assert!(second.may_act() && !first.may_act());
    assert_eq!(over(first.act(|| ()).unwrap_err()), (250, 3));
    let again = Gate::open(&path).unwrap();
    assert_eq!(over(again.admit(255, Deadline::none()).unwrap_err()), (255, 3));
    assert_eq!(fs::read_to_string(&path).unwrap(), "imrs gate 1 epoch 003\n");
}

#[test]
fn a_gate_that_is_reset_admits_anybody_and_nobody_from_before() {
    let (_folder, path) = place();
    let gate = Gate::open(&path).unwrap();
    let before = gate.admit(7, Deadline::none()).unwrap();
    gate.reset().unwrap();
    assert!(!before.may_act());
    let after = gate.admit(1, Deadline::none()).unwrap();
    assert!(after.may_act() && !before.may_act());
}

#[test]
fn a_file_of_something_else_is_refused_and_left_alone() {
    let (_folder, path) = place();
    for text in [
        "imrs gate 1 epoch 300\n",
        "imrs gate 1 epoch 003",
        "imrs gate 2 epoch 003\n",
        "\n",
        "imrs gate 1 epoch 003\nx",
    ] {
        fs::write(&path, text).unwrap();
        assert!(matches!(Gate::open(&path), Err(GateError::Foreign(_))), "{text:?}");
        assert_eq!(fs::read_to_string(&path).unwrap(), text);
    }
    let folder = path.parent().unwrap();
    assert!(Gate::open(folder).unwrap_err().to_string().contains(folder.to_str().unwrap()));
}

#[test]
fn a_deadline_ends_unless_it_is_renewed_and_for_good_when_the_runtime_says_no_more() {
    let (_folder, path) = place();
    let gate = Gate::open(&path).unwrap();
    assert!(matches!(gate.admit(1, Deadline::at(1)), Err(Refused::Deadline)), "long ago");
    assert_eq!(fs::read_to_string(&path).unwrap(), "", "it was not admitted");
    // This instant is a century ahead, so no test reaches it.
    let far = 3_153_600_000_000_000_u64;
    let deadline = Deadline::at(far);
    let mut permit = gate.admit(1, deadline.clone()).unwrap();
    assert!(permit.act(|| ()).is_ok());
    let said = format!("deadline 5\nanything else\ndeadline x\ndeadline {}\n", 2 * far);
    let seen = Mutex::new(Vec::new());
    let lines =
        Lines { text: said.as_bytes(), after: &mut || seen.lock().unwrap().push(deadline.is_ahead()) };
    deadline.follow(std::io::BufReader::with_capacity(1, lines));
    assert!(seen.lock().unwrap().iter().all(|&ahead| ahead), "an earlier deadline shortens nothing");
    assert!(matches!(permit.act(|| ()), Err(Refused::Deadline)), "the input has ended");
    deadline.renew(2 * far);
    assert!(!permit.may_act() && !deadline.is_ahead());
}

/// A reader that calls `after` before each byte that is read, and before the end.
struct Lines<'a> {
    text: &'a [u8],
    after: &'a mut dyn FnMut(),
}

impl std::io::Read for Lines<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        (self.after)();
        self.text.read(bytes)
    }
}

#[test]
fn whoever_has_a_newer_epoch_waits_for_the_step_of_an_older_one() {
    let (_folder, path) = place();
    let gate = Gate::open(&path).unwrap();
    let mut first = gate.admit(1, Deadline::none()).unwrap();
    let (tell, told) = report();
    let ended = AtomicBool::new(false);
    thread::scope(|scope| {
        let acts = scope.spawn(|| {
            let step = || {
                tell.send(()).unwrap();
                // On most machines the other thread reaches its next step within this time. On other machines the test
                // proves nothing.
                thread::sleep(std::time::Duration::from_millis(50));
                ended.store(true, Ordering::SeqCst);
            };
            first.act(step).unwrap();
            first
        });
        told.recv().unwrap();
        let second = Gate::open(&path).unwrap().admit(2, Deadline::none()).unwrap();
        assert!(ended.load(Ordering::SeqCst), "the step was over first");
        let mut first = acts.join().unwrap();
        assert!(second.may_act() && first.act(|| ()).is_err());
    });
}

#[test]
fn steps_that_follow_each_other_closely_keep_no_newer_epoch_out() {
    let (_folder, path) = place();
    let gate = Gate::open(&path).unwrap();
    let (tell, told) = report();
    thread::scope(|scope| {
        // Two threads take steps, so that one of them is always in the middle of a step.
        for _ in 0..2 {
            let (gate, tell) = (&gate, tell.clone());
            scope.spawn(move || {
                let mut permit = gate.admit(1, Deadline::none()).unwrap();
                permit.act(|| tell.send(()).unwrap()).unwrap();
                while permit.act(|| thread::sleep(std::time::Duration::from_millis(5))).is_ok() {}
            });
        }
        told.recv().unwrap();
        told.recv().unwrap();
        // Without the queue at the gate, this call and the two threads would wait for ever.
        let second = gate.admit(2, Deadline::none()).unwrap();
        assert!(second.may_act());
    });
    assert!(path.with_extension("gate.next").exists());
}

#[test]
fn steps_of_two_epochs_never_overlap() {
    let (_folder, path) = place();
    let order = Mutex::new(Vec::new());
    thread::scope(|scope| {
        for epoch in 1..=8 {
            let (path, order) = (&path, &order);
            scope.spawn(move || {
                let Ok(mut permit) = Gate::open(path).unwrap().admit(epoch, Deadline::none()) else { return };
                let step = || {
                    let begin = |what| order.lock().unwrap().push((epoch, what));
                    begin("begins");
                    thread::yield_now();
                    begin("ends");
                };
                for _ in 0..50 {
                    if permit.act(step).is_err() {
                        return;
                    }
                }
            });
        }
    });
    let order = order.into_inner().unwrap();
    assert!(!order.is_empty());
    assert!(order.is_sorted_by_key(|(epoch, _)| *epoch), "{order:?}");
    assert!(order.chunks(2).all(|step| step[0].0 == step[1].0 && step[1].1 == "ends"), "{order:?}");
}
