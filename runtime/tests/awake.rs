//! A thread that waits briefly spins if it has a core to itself, and sleeps otherwise (D110). These tests run alone, because the
//! runtime counts running tasks per process.
//!
//! No time is measured. A thread that may spin does so for longer than any test takes. A thread that may not spin
//! gets its answer only when it sleeps.

use crate::alone;
use crate::common::{LONG, LONG_TICKS, ask, cell, finish, one_node, report, table};
use imrs_protocol::Ticks;
use rustix::thread::{CpuSet, Pid, gettid, sched_getaffinity, sched_setaffinity};
use std::sync::Arc;
use std::sync::atomic::{AtomicI32, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// The number of round trips after which the spin history says that waits are brief.
const WARM_UP: u32 = 80;
const TRIPS: u32 = 120;
/// A spin budget that no wait uses up.
const ENDLESS: Duration = Duration::from_secs(3_600);

/// How often the calling thread went to sleep so far.
fn sleeps() -> u64 {
    let status = std::fs::read_to_string("/proc/thread-self/status").expect("a thread");
    let line = status.lines().find_map(|line| line.strip_prefix("voluntary_ctxt_switches:"));
    line.expect("counted").trim().parse().expect("a number")
}

fn bind(cores: &CpuSet) {
    sched_setaffinity(None, cores).expect("cores that the process may use");
}

/// Waits until a thread of this process sleeps.
fn sleeps_at_last(thread: i32) {
    let begin = Instant::now();
    let is_asleep = || {
        let stat = std::fs::read_to_string(format!("/proc/self/task/{thread}/stat")).expect("a thread");
        stat.rsplit_once(") ").is_some_and(|(_, state)| state.starts_with('S'))
    };
    while !is_asleep() {
        assert!(begin.elapsed() < LONG, "it looks though it must not");
        thread::sleep(Duration::from_micros(100));
    }
}

/// When the answering task answers.
#[derive(Clone, Copy, PartialEq)]
enum Answer {
    AtOnce,
    /// The answer comes once the asking thread sleeps.
    Asleep,
}

/// How often the asking task slept in the last round trips. `cores` has the cores that the thread of each task may
/// use.
fn sleeps_of_asking(cores: [CpuSet; 2], spin: Duration, answer: Answer) -> u64 {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(ask(Ticks(10 * LONG_TICKS.0)));
    let ((tell, told), (begin, begins)) = (report(), report());
    let asking = Arc::new(AtomicI32::new(0));
    let asks = Arc::clone(&asking);
    let node = one_node(&table(cell))
        .spin(spin)
        .task("a", move |ctx| {
            bind(&cores[0]);
            asks.store(Pid::as_raw(Some(gettid())), Ordering::Release);
            let ask = ctx.port("ask")?;
            begins.recv_timeout(LONG).expect("b begins");
            for _ in 0..WARM_UP {
                assert!(ctx.send(ask, b"?")?.reply().is_some());
            }
            let before = sleeps();
            for _ in 0..TRIPS {
                assert!(ctx.send(ask, b"?")?.reply().is_some());
            }
            tell.send(sleeps() - before).expect("the test listens");
            Ok(())
        })
        .task("b", move |ctx| {
            bind(&cores[1]);
            // During a task's first wait, the runtime learns which cores the task's thread may use.
            assert_eq!(ctx.receive(None, Some(Duration::from_millis(1)))?, None);
            begin.send(()).expect("a waits");
            for _ in 0..WARM_UP + TRIPS {
                let question = ctx.receive(None, None)?.expect("only a message ends it");
                if answer == Answer::Asleep {
                    sleeps_at_last(asking.load(Ordering::Acquire));
                }
                ctx.reply(&question.from, b"!")?;
            }
            Ok(())
        })
        .start()
        .unwrap();
    let slept = told.recv_timeout(10 * LONG).expect("all are answered");
    finish(node);
    println!("{slept} sleeps for {TRIPS} round trips, with a budget of {spin:?}");
    slept
}

#[test]
fn who_has_a_core_to_itself_looks_and_who_has_not_sleeps() {
    let _alone = alone();
    let all = sched_getaffinity(None).expect("the cores of this process");
    let mut own = (0..CpuSet::MAX_CPU).filter(|&core| all.is_set(core)).map(|core| {
        let mut set = CpuSet::new();
        set.set(core);
        set
    });
    let first = own.next().expect("it runs somewhere");
    let trips = u64::from(TRIPS);
    // If both threads are on one core, a waiting thread lets the other one run, because spinning makes no wait shorter.
    for spin in [Duration::ZERO, ENDLESS] {
        let slept = sleeps_of_asking([first, first], spin, Answer::Asleep);
        assert!(slept >= trips / 2, "{slept} sleeps");
    }
    if let Some(second) = own.next() {
        let both = [first, second];
        let slept = sleeps_of_asking(both, Duration::ZERO, Answer::Asleep);
        assert!(slept >= trips / 2, "{slept} sleeps");
        for cores in [both, [all, all]] {
            let slept = sleeps_of_asking(cores, ENDLESS, Answer::AtOnce);
            assert!(slept < trips / 10, "it sleeps on a core of its own: {slept} times");
        }
    }
}
