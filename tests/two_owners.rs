//! Two tasks share a tool, and never act at a time: their nodes are killed, stopped and frozen, and the log of the tool says who
//! acted when. The actions are commands: `examples/actuator.rs`, as this test program itself.

#[path = "../examples/actuator.rs"]
#[expect(dead_code, reason = "the start of the example as a program of its own")]
mod actuator;
mod freezer;

use crate::support::live::Live;
use crate::support::{Said, bound, finish, is_here, own_address, runtime_dir, signal, wait_until};
use freezer::Freezer;
use imrs_runtime::actuator::{Orders, now};
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

/// Two welders that share a tool. Nothing is late on a machine that is only busy.
const CELL: &str = "\
cell two_owners;
tick 1 msec;
node n1 at \"HOST\" port N1;  node n2 at \"HOST\" port N2;
link n1 -- n2 delay 2 msec;
task r1 on n1 module welders
  port alive()  usage = response  user_list = {r2}  time_out = 60 msec  class = 2;
begin
  loop run weld_primary takes 0 msec .. 60 sec; end;
end r1;
task r2 on n2 module welders standby of r1
  use_port alive()  usage = query  time_out = 60 msec;
begin
  loop delay 1 sec; end;
takeover
  loop run weld_standby takes 0 msec .. 60 sec; end;
end r2;
couple work r1 -> r2 lease 300 msec takeover 1000 msec every 30 msec via alive;
check one_active: never r1.active and r2.active;
";
const TAKEOVER: Duration = Duration::from_secs(1);
/// How long one action takes: longer than a take-over, so that the command of a dead node would act on.
const WELD: Duration = Duration::from_millis(2500);
/// How long the cell goes on after a node is there again.
const AFTERWARDS: Duration = Duration::from_millis(500);
/// Trials at a time.
const ABREAST: u64 = 6;

/// No test of its own: the command that a node of a trial starts for an action. Its last argument names the folder of the tool,
/// and the epoch where the runtime gives none.
#[test]
fn moves_the_tool() {
    let Some(tool) = std::env::args().find_map(|argument| argument.strip_prefix("tool=").map(PathBuf::from))
    else {
        return;
    };
    let Orders { epoch, deadline } = Orders::from_env().expect("numbers");
    let named = tool.file_name().and_then(|name| name.to_str()).expect("an epoch");
    let epoch = epoch.unwrap_or_else(|| named.parse().expect("an epoch"));
    if std::env::var_os(imrs_runtime::actuator::DEADLINE).is_some() {
        let said = deadline.clone();
        thread::spawn(move || said.follow(std::io::stdin().lock()));
    }
    // Refused in the middle of it, it fails: so does the action.
    actuator::weld(tool.parent().expect("a folder"), epoch, deadline, WELD).expect("it may act");
}

/// What happens to the node that acts.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Blow {
    /// It is killed; its command lives on.
    Killed,
    /// It is killed, and its command stands still for so long.
    KilledToolStopped(Duration),
    /// It stands still, and its command goes on.
    Stopped(Duration),
    /// It stands still, and its command too.
    AllStopped(Duration),
    /// The kernel's freezer holds both.
    Frozen(Duration),
}

impl Blow {
    /// That of a trial of so many. Many have long ones, too: up to half a minute.
    fn of(trial: u64, draws: &mut fastrand::Rng, are_many: bool) -> Self {
        let longest = if are_many && trial % 10 == 9 { 30_000 } else { 2_000 };
        let length = Duration::from_millis(draws.u64(100..=longest));
        match trial % 6 {
            0 => Self::Killed,
            1 => Self::Stopped(length),
            // As it was found.
            2 => Self::Stopped(3 * TAKEOVER / 2),
            3 => Self::AllStopped(length),
            4 => Self::KilledToolStopped(length),
            _ => Self::Frozen(length),
        }
    }

    fn is_death(self) -> bool {
        matches!(self, Self::Killed | Self::KilledToolStopped(_))
    }
}

/// One line of the tool's log.
#[derive(Clone, Debug)]
struct Line {
    at: u64,
    epoch: u8,
    acts: bool,
}

fn log_of(tool: &Path) -> Vec<Line> {
    let text = std::fs::read_to_string(tool.join("tool.log")).unwrap_or_default();
    // A line that crosses a page of the file may be seen while it is half written.
    let text = text.rsplit_once('\n').map_or("", |(whole, _)| whole);
    let line = |line: &str| {
        let mut words = line.split(' ');
        let mut next = || words.next().expect("three words");
        let at = next().parse().expect("an instant");
        Line { at, epoch: next().parse().expect("an epoch"), acts: next() != "end" }
    };
    text.lines().map(line).collect()
}

/// For how long steps of an older epoch came after the first one of a newer, in microseconds.
fn two_owners(log: &[Line]) -> u64 {
    let mut of: BTreeMap<u8, (u64, u64)> = BTreeMap::new();
    for line in log.iter().filter(|line| line.acts) {
        let (first, last) = of.entry(line.epoch).or_insert((line.at, line.at));
        (*first, *last) = (line.at.min(*first), line.at.max(*last));
    }
    let overlap = |(&older, &(_, last)): (&u8, &(u64, u64))| {
        let newer = of.range(older + 1..).map(|(_, &(first, _))| first).min();
        newer.map_or(0, |first| (last + 1).saturating_sub(first))
    };
    of.iter().map(overlap).max().unwrap_or(0)
}

#[test]
fn the_log_of_two_owners_is_told_from_that_of_one() {
    let line = |(at, epoch, acts)| Line { at, epoch, acts };
    let one =
        [(1, 1, true), (2, 1, true), (3, 1, false), (3, 2, true), (4, 2, true), (5, 1, false)].map(line);
    assert_eq!(two_owners(&one), 0, "an end is no act");
    let two = [(1, 1, true), (3, 2, true), (7, 1, true), (9, 2, true)].map(line);
    assert_eq!(two_owners(&two), 5);
}

/// What came of a trial.
#[derive(Debug)]
struct Trial {
    blow: Blow,
    two_owners: u64,
    /// The owner was in the middle of an action.
    mid_action: bool,
    /// From the blow until the standby acted.
    took_over: Option<u64>,
}

/// The processes that this one started.
fn children(pid: u32) -> Vec<u32> {
    let all = std::fs::read_dir("/proc").expect("/proc").flatten();
    let all = all.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    let parent = |pid: &u32| {
        let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
        stat.rsplit_once(')')?.1.split_whitespace().nth(1)?.parse::<u32>().ok()
    };
    all.filter(|child| parent(child) == Some(pid)).collect()
}

fn strike(blow: Blow, node: u32) {
    let tools = children(node);
    let all = || tools.iter().copied().chain([node]);
    let hold = |pids: &[u32], length: Duration| {
        pids.iter().for_each(|&pid| signal(pid, Signal::STOP));
        thread::sleep(length);
        pids.iter().for_each(|&pid| signal(pid, Signal::CONT));
    };
    match blow {
        Blow::Killed => signal(node, Signal::KILL),
        Blow::KilledToolStopped(length) => {
            tools.iter().for_each(|&tool| signal(tool, Signal::STOP));
            signal(node, Signal::KILL);
            hold(&tools, length);
        }
        Blow::Stopped(length) => hold(&[node], length),
        Blow::AllStopped(length) => hold(&all().collect::<Vec<_>>(), length),
        Blow::Frozen(length) => match Freezer::of(all()) {
            Ok(frozen) => {
                thread::sleep(length);
                frozen.thaw();
            }
            Err(why) => {
                println!("SKIPPED the freezer ({why}): the processes are stopped instead");
                hold(&all().collect::<Vec<_>>(), length);
            }
        },
    }
}

fn trial(number: u64, are_many: bool) -> Trial {
    let mut draws = fastrand::Rng::with_seed(number);
    let blow = Blow::of(number, &mut draws, are_many);
    let dir = runtime_dir();
    let (host, [n1, n2]) = own_address();
    let cell = CELL.replace("HOST", &host.to_string());
    let cell = cell.replace("port N1", &format!("port {n1}")).replace("port N2", &format!("port {n2}"));
    let file = dir.path().join("two_owners.cell");
    std::fs::write(&file, cell).expect("the cell is written");
    let program = std::env::current_exe().expect("this program");
    let act = |name: &str, epoch: u8| {
        let (program, tool) = (program.display(), dir.path().join(epoch.to_string()));
        format!("{name}={program} --exact two_owners::moves_the_tool --nocapture tool={}", tool.display())
    };
    let (primary, standby, seed) = (act("weld_primary", 1), act("weld_standby", 2), number.to_string());
    let run = ["run", file.to_str().expect("UTF-8"), "--for", "10m", "--seed", &seed];
    let live = Live::start(dir.path(), &[&run[..], &["--action", &primary, "--action", &standby]].concat());
    let acts = |least: usize| log_of(dir.path()).iter().filter(|line| line.acts).count() >= least;
    wait_until("the primary acts", || acts(20));
    // At any moment of the lease.
    thread::sleep(Duration::from_millis(draws.u64(0..600)));
    let before = log_of(dir.path());
    let owner = before.last().expect("it acts").epoch;
    let at = now();
    strike(blow, live.pid(if owner % 2 == 1 { "n1" } else { "n2" }));
    let took_over = || {
        let log = log_of(dir.path());
        log.iter().find(|line| line.acts && line.epoch > owner && line.at > at).map(|line| line.at - at)
    };
    if blow.is_death() && owner % 2 == 1 {
        wait_until("the standby acts", || took_over().is_some());
    }
    thread::sleep(AFTERWARDS);
    live.interrupt();
    let (summary, ..) = live.finish();
    assert_ne!(summary["checks"][0]["outcome"], "broken", "trial {number}, {blow:?}: {summary}");
    // A command that stood in the middle of the run's end is over soon.
    let log = log_of(dir.path());
    let mid_action =
        log.iter().rev().find(|line| line.at <= at && line.epoch == owner).is_some_and(|line| line.acts);
    Trial { blow, two_owners: two_owners(&log), mid_action, took_over: took_over() }
}

#[test]
fn two_tasks_never_act_at_a_time() {
    // A node that is killed or stopped anywhere: 200 of them in `.ci/long`.
    let count = bound("IMRS_TRIALS", 20);
    let (next, done) = (AtomicU64::new(0), Mutex::new(Vec::new()));
    thread::scope(|scope| {
        for _ in 0..ABREAST.min(count) {
            scope.spawn(|| {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= count {
                        return;
                    }
                    let trial = trial(number, count > 50);
                    done.lock().expect("no trial panicked").push((number, trial));
                }
            });
        }
    });
    let trials = done.into_inner().expect("no trial panicked");
    tell(&trials);
    for (number, trial) in &trials {
        assert_eq!(trial.two_owners, 0, "trial {number}: {trial:?}");
    }
    assert_eq!(trials.len() as u64, count);
}

fn tell(trials: &[(u64, Trial)]) {
    let count = |is: &dyn Fn(&Trial) -> bool| trials.iter().filter(|(_, trial)| is(trial)).count();
    let mut times: Vec<u64> = trials.iter().filter_map(|(_, trial)| trial.took_over).collect();
    times.sort_unstable();
    let at = |share: usize| times.get(times.len() * share / 100).or(times.last()).map_or(0, |us| us / 1_000);
    println!(
        "total: {} trials, two owners for {} us at most; the standby took over in {}, the owner was in the middle of an action in {}; \
         take-over after {} ms (median), {} ms (9 of 10), {} ms (longest)",
        trials.len(),
        trials.iter().map(|(_, trial)| trial.two_owners).max().unwrap_or(0),
        times.len(),
        count(&|trial| trial.mid_action),
        at(50),
        at(90),
        at(100),
    );
}

/// The primary stands still for longer than the take-over takes, again and again: what checks see of it is no longer active than its lease
/// lasts.
#[test]
fn a_stopped_owner_is_active_no_longer_than_its_lease() {
    let stopped = |number: u64| {
        let trial = trial(6 * number + 2, false);
        assert_eq!(trial.blow, Blow::Stopped(3 * TAKEOVER / 2));
        trial.took_over.is_some()
    };
    let done: Vec<bool> = thread::scope(|scope| {
        let trials: Vec<_> = (1..6).map(|number| scope.spawn(move || stopped(number))).collect();
        trials.into_iter().map(|trial| trial.join().expect("a trial")).collect()
    });
    assert!(done.contains(&true), "no standby took over");
}

/// Runs a cell of one node with this script in a time namespace. `grip` is the command of its action. `None` where the machine has no
/// such namespaces.
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

/// The clock of the nodes is far ahead of the one that the kernel sleeps by, as after a suspend of a day.
#[test]
fn a_machine_that_was_suspended_keeps_its_times() {
    let dir = runtime_dir();
    let seen = dir.path().join("guard.stat");
    // The command's parent is its guard.
    let grip = format!("sleep 1; cat /proc/$PPID/stat > {}", seen.display());
    let script = "delay 300 msec; delay 300 msec; run grip takes 0..60 sec;";
    let Some(said) = with_clocks_apart(["--boottime", "86400"], script, &grip, dir.path()) else { return };
    let seconds = said.last_json()["seconds"].as_f64();
    assert!(said.is_well(), "{said:?}");
    assert!(seconds.is_some_and(|seconds| (1.6..40.0).contains(&seconds)), "{said:?}");
    let stat = std::fs::read_to_string(seen).expect("what the guard used");
    let (_, rest) = stat.rsplit_once(')').expect("a name");
    let spent = rest.split_whitespace().skip(11).take(2).map(|ticks| ticks.parse::<u64>().expect("ticks"));
    // Of 100 in a second. A guard whose timer has expired before the deadline must not spin.
    assert!(spent.sum::<u64>() < 30, "{stat}");
}

/// The other way round. The deadline of a command is on the clock of the nodes.
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
