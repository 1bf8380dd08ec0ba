//! Threads that wait briefly do not sleep where they have cores to themselves, and do where they have not (D110). Alone, for the
//! runtime counts who runs by process.

use crate::alone;
use crate::common::{LONG, LONG_TICKS, ask, cell, finish, one_node, report, table};
use imrs_protocol::Ticks;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use std::time::Duration;

const TRIPS: u32 = 1_000;

/// How often the calling thread went to sleep so far.
fn sleeps() -> u64 {
    let status = std::fs::read_to_string("/proc/thread-self/status").expect("a thread");
    let line = status.lines().find_map(|line| line.strip_prefix("voluntary_ctxt_switches:"));
    line.expect("counted").trim().parse().expect("a number")
}

fn bind(cores: &CpuSet) {
    sched_setaffinity(None, cores).expect("cores that the process may use");
}

/// How often the asking task slept for so many round trips with an answering one. The threads may use these cores.
fn sleeps_of_asking(cores: [CpuSet; 2], spin: Duration) -> u64 {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    let (tell, told) = report();
    let node = one_node(&table(cell))
        .spin(spin)
        .task("a", move |ctx| {
            bind(&cores[0]);
            let ask = ctx.port("ask")?;
            let before = sleeps();
            for _ in 0..TRIPS {
                assert!(ctx.send(ask, b"?")?.reply().is_some());
            }
            tell.send(sleeps() - before).expect("the test listens");
            Ok(())
        })
        .task("b", move |ctx| {
            bind(&cores[1]);
            for _ in 0..TRIPS {
                let question = ctx.receive(None, None)?.expect("only a message ends it");
                ctx.reply(&question.from, b"!")?;
            }
            Ok(())
        })
        .start()
        .unwrap();
    let slept = told.recv_timeout(LONG).expect("all are answered");
    finish(node);
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
    // Longer than a thread has to wait for its turn on a busy machine.
    let patient = Duration::from_millis(200);
    let shared = sleeps_of_asking([first, first], Duration::ZERO);
    let budget = sleeps_of_asking([first, first], patient);
    // Where both are on one core, whoever waits lets the other one run: a wait is no shorter by looking.
    assert!(shared > u64::from(TRIPS) / 10 && budget > shared / 2, "{shared}, with a budget {budget}");
    if let Some(second) = own.next() {
        let apart = sleeps_of_asking([first, second], patient);
        println!("sleeps: {shared} on one core, {budget} with a budget, {apart} on two");
        assert!(apart < u64::from(TRIPS) / 10, "{apart} sleeps for {TRIPS} round trips");
        assert!(sleeps_of_asking([first, second], Duration::ZERO) > apart);
        let anywhere = sleeps_of_asking([all, all], patient);
        println!("{anywhere} anywhere");
        assert!(anywhere < u64::from(TRIPS) / 2, "{anywhere} sleeps for {TRIPS} round trips");
    }
}
