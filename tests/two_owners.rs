//! Tests that two tasks which share a tool never act at the same time. The tasks' nodes are killed, stopped and frozen,
//! with and without the guards of their commands. The log of the tool shows which task acted when (D158). The commands
//! are `examples/actuator.rs`, which this test program itself runs.

mod fault;
pub mod freezer;
mod tally;
pub mod tool;
pub mod trial;

use crate::support::{Said, bound, excused, finish, is_here, runtime_dir};
use fault::FAULTS;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use tally::{Tally, Trials, tell};
use trial::{Plan, trial};

/// How many trials run at the same time. Trials mostly wait, so there can be more of them than processors.
const ABREAST: usize = 8;
/// A series with more trials than this is a long one. It has longer faults, and comparisons for every fault.
const MANY: u64 = 50;

/// Runs the planned trials, several at a time, and adds their results to the tally.
fn carry_out(plans: &[Plan], tally: &Tally) {
    let next = AtomicUsize::new(0);
    thread::scope(|scope| {
        for _ in 0..ABREAST {
            scope.spawn(|| {
                while let Some(plan) = plans.get(next.fetch_add(1, Ordering::Relaxed)) {
                    tally.add(trial(plan));
                }
            });
        }
    });
}

/// The comparisons of a series: trials in which only the guard limits the command. There are three, with faults after
/// which a command goes on. A long series has two for every fault.
fn comparisons(are_many: bool) -> Vec<Plan> {
    let faults = FAULTS.iter().filter(|fault| are_many || fault.lets_the_command_go_on());
    let faults: Vec<_> = faults.cycle().take(if are_many { 2 * FAULTS.len() } else { 3 }).collect();
    (0..).zip(faults).map(|(number, fault)| Plan::comparison(number, *fault)).collect()
}

#[test]
fn two_tasks_never_act_at_a_time() {
    // `.ci/long` runs 200 trials.
    let count = bound("IMRS_TRIALS", 20);
    let are_many = count > MANY;
    let tally = Tally::open(std::env::var_os("IMRS_TRIALS_DONE").map(Into::into));
    let mut plans = comparisons(are_many);
    plans.extend((0..count).map(|number| Plan::of(number, are_many)));
    plans.retain(|plan| !tally.has(plan.number, plan.bound == tool::Bound::Neither));
    carry_out(&plans, &tally);
    let (trials, comparisons) = tally.finish();
    tell(&trials, &comparisons);
    nobody_acted_beside_another(&trials, count);
    two_owners_are_seen(&comparisons, are_many);
}

fn nobody_acted_beside_another(trials: &Trials, count: u64) {
    for trial in &trials.0 {
        assert_eq!(trial.two_owners, 0, "{trial:?}");
        assert_ne!(trial.check, "broken", "{trial:?}");
    }
    assert_eq!(trials.0.len() as u64, count);
    // The least numbers below are for 200 trials. With fewer trials, the same share of them must be conclusive.
    let least = |of_200: u64| of_200 * count / 200;
    assert!(trials.count(|trial| trial.mid_action) >= least(100), "{}", trials.counts());
    assert!(trials.count(|trial| trial.guard_held) >= least(30), "{}", trials.counts());
    took_over(trials, least(if count > MANY { 150 } else { 100 }), count > MANY);
}

/// Asserts that the standby took over in at least `least` trials. A short series on a busy machine may have fewer: if
/// a primary loses its lease before the fault, the fault hits the standby that took over, and no other task takes
/// over from it.
fn took_over(trials: &Trials, least: u64, is_asked: bool) {
    let (took_over, counts) = (trials.count(|trial| trial.took_over.is_some()), trials.counts());
    assert!(took_over >= least || !is_asked, "{counts}");
    if took_over < least {
        excused(&format!("primaries lost their lease before the fault: {counts}"));
    }
}

/// In a comparison, only the guard limits the command. If the guard is stopped, the log must show two owners at a
/// time, which proves that the log would show two owners in the other trials, too. For such a comparison, the verdict
/// on the check must never be that it holds.
fn two_owners_are_seen(comparisons: &Trials, are_many: bool) {
    let unbound = comparisons.0.iter().filter(|trial| trial.guard_held && trial.took_over.is_some());
    let unbound = unbound.filter(|trial| {
        FAULTS.iter().any(|fault| fault.name == trial.fault && fault.lets_the_command_go_on())
    });
    for trial in unbound {
        assert!(trial.two_owners > 0, "{trial:?}");
        assert_ne!(trial.check, "held", "{trial:?}");
    }
    if are_many {
        assert!(comparisons.two_owners() > 0, "{}", comparisons.compared());
    }
    took_over(comparisons, 1, are_many);
}

/// Tests, several times, a primary that is suspended for longer than a take-over. The checks must never count it as
/// active after the end of its lease.
#[test]
fn a_stopped_owner_is_active_no_longer_than_its_lease() {
    let tally = Tally::open(None);
    carry_out(&(1..6).map(Plan::stopped).collect::<Vec<_>>(), &tally);
    let (trials, _) = tally.finish();
    for trial in &trials.0 {
        assert_ne!(trial.check, "broken", "{trial:?}");
    }
    took_over(&trials, 1, false);
}

/// Runs a cell with one node and this script in a time namespace. `grip` is the shell command for the script's action.
/// `None` if the machine has no such namespaces.
fn with_clocks_apart(offset: [&str; 2], script: &str, grip: &str, dir: &Path) -> Option<Said> {
    let cell = format!("cell waits;\ntick 1 msec;\nnode n;\ntask t on n\nbegin\n  {script}\nend t;\n");
    let (file, action) = (dir.join("waits.cell"), dir.join("grip.sh"));
    std::fs::write(&file, cell).expect("the cell is written");
    std::fs::write(&action, grip).expect("the command is written");
    let namespace = ["-T", offset[0], offset[1]];
    let works = std::process::Command::new("unshare").args(namespace).arg("true").status();
    let missing =
        (!works.is_ok_and(|status| status.success())).then_some("a time namespace (unshare -T, root)");
    if !is_here(missing, "nodes whose clocks are apart") {
        return None;
    }
    let mut command = std::process::Command::new("unshare");
    command.args(namespace).arg(env!("CARGO_BIN_EXE_imrs"));
    command.args(["run", file.to_str().expect("UTF-8"), "--for", "50s", "--format", "json"]);
    command.arg("--action").arg(format!("grip=sh {}", action.display()));
    command.env("XDG_RUNTIME_DIR", dir).stdin(std::process::Stdio::null());
    Some(finish(command))
}

/// The nodes' clock is far ahead of the clock that the kernel uses for sleeping, as after a suspend of a day.
#[test]
fn a_machine_that_was_suspended_keeps_its_times() {
    let dir = runtime_dir();
    let seen = dir.path().join("guard.stat");
    // The parent process of the command is its guard.
    let grip = format!("sleep 1; cat /proc/$PPID/stat > {}", seen.display());
    let script = "delay 300 msec; delay 300 msec; run grip takes 0..60 sec;";
    let Some(said) = with_clocks_apart(["--boottime", "86400"], script, &grip, dir.path()) else { return };
    let seconds = said.last_json()["seconds"].as_f64();
    assert!(said.is_well(), "{said:?}");
    assert!(seconds.is_some_and(|seconds| (1.6..40.0).contains(&seconds)), "{said:?}");
    let stat = std::fs::read_to_string(seen).expect("what the guard used");
    let (_, rest) = stat.rsplit_once(')').expect("a name");
    let spent = rest.split_whitespace().skip(11).take(2).map(|ticks| ticks.parse::<u64>().expect("ticks"));
    // This is the guard's processor time, in hundredths of a second. The guard must not wait in a busy loop if its
    // timer expires before the deadline.
    assert!(spent.sum::<u64>() < 30, "{stat}");
}

/// The nodes' clock is far behind the kernel's clock. The deadline of a command is a time on the nodes' clock.
#[test]
fn a_command_ends_at_its_deadline_where_the_clocks_are_apart() {
    let dir = runtime_dir();
    let script = "run grip takes 0..1 msec;";
    let Some(said) = with_clocks_apart(["--monotonic", "86400"], script, "exec sleep 600", dir.path()) else {
        return;
    };
    assert_eq!(said.code, Some(1), "{said:?}");
    assert!(said.err.contains("action `grip`: took longer than the declared 1ms"), "{said:?}");
}
