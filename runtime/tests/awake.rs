//! Threads that wait briefly do not sleep where they have cores to themselves, and do where they have not (D110). Alone,
//! because the runtime counts by process which tasks run.

use crate::alone;
use crate::common::{LONG, LONG_TICKS, ask, cell, finish, one_node, report, table};
use imrs_protocol::Ticks;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use std::time::Duration;

const TRIPS: u32 = 400;
/// How many series may go by that the machine spoils: the kernel lets the answering thread run before the asking one has to
/// wait, or keeps it from running for longer than anybody looks.
const SERIES: usize = 20;

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
    // How often it slept in the first series that is as wanted.
    let series = |cores, spin, is_wanted: &dyn Fn(u64) -> bool| {
        let mut series = (0..SERIES).map(|_| sleeps_of_asking(cores, spin));
        let sleeps = series.find(|&sleeps| is_wanted(sleeps));
        println!("{sleeps:?} sleeps for {TRIPS} round trips, with a budget of {spin:?}");
        sleeps.is_some()
    };
    let trips = u64::from(TRIPS);
    // Where both are on one core, whoever waits lets the other one run: a wait is no shorter by looking. One that looked would
    // hardly ever sleep.
    let often = |sleeps| sleeps > trips / 4;
    assert!(series([first, first], Duration::ZERO, &often), "it looks though it must not");
    assert!(series([first, first], patient, &often), "it looks though both are on one core");
    if let Some(second) = own.next() {
        let both = [first, second];
        assert!(series(both, patient, &|sleeps| sleeps < trips / 10), "it sleeps on a core of its own");
        assert!(series(both, Duration::ZERO, &often), "it looks though it must not");
        assert!(
            series([all, all], patient, &|sleeps| sleeps < trips / 2),
            "it sleeps with two cores for two"
        );
    }
}
