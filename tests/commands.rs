//! Tests that the commands of actions, with everything that they started, end with their node, however the node ends (D141).
//! The nodes are processes of `imrs run`. The action is a shell script that starts a child and a process in another session,
//! and writes their ids to files.

use crate::support::program::Program;
use crate::support::{
    Said, example, imrs, is_alive, is_here, number, runtime_dir, signal, sooner_or_later, tried_again,
    wait_until,
};
use rustix::process::Signal;
use rustix::thread::sched_getaffinity;
use rustix::time::{ClockId, clock_gettime};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// A cell of one task, whose action may take ten minutes.
const HELD: &str = "\
cell held;
tick 1 msec;
node n;
task t on n
begin
  run grip takes 0..600 sec;
end t;
";

/// The same cell, except that the action must end at once.
const SHORT: &str = "\
cell short;
tick 1 msec;
node n;
task t on n
begin
  run grip takes 0..1 msec;
end t;
";

/// A command that starts a child, and a process in a session of its own. `setsid` forks no further process in this
/// script, because its parent is a shell.
const FAMILY: &str = "\
note() { echo $2 > $DIR/$1.new; mv $DIR/$1.new $DIR/$1; }
echo \"$IMRS_EPOCH\" > $DIR/epoch
echo \"$IMRS_DEADLINE_US\" > $DIR/deadline
sleep 600 & note child $!
setsid sh -c 'echo $$ > $DIR/left.new; mv $DIR/left.new $DIR/left; exec sleep 600' &
note command $$
[ -z \"$IMRS_EPOCH\" ] || note by$((IMRS_EPOCH % 2)) $$
exec cat > $DIR/orders
";

/// The processes whose ids [`FAMILY`] writes to files.
const ALL: [&str; 3] = ["command", "child", "left"];

struct Scene {
    dir: TempDir,
    program: Option<Program>,
    /// The process ids of the nodes, in the order of the cell.
    nodes: Vec<u32>,
}

impl Scene {
    /// Starts a run of a cell whose action is this script.
    fn start(cell: &str, action: &str, script: &str, args: &[&str]) -> Self {
        let dir = runtime_dir();
        let file = dir.path().join("cell.cell");
        std::fs::write(&file, cell).expect("the cell is written");
        let action = format!("{action}={}", written(dir.path(), script));
        let run = ["run", file.to_str().expect("UTF-8"), "--format", "json", "--action", &action];
        let mut program = Program::start(imrs(dir.path(), &[&run, args].concat()));
        let started = program.json();
        let nodes = started["started"].as_array().expect("nodes").iter();
        let nodes = nodes.map(|node| u32::try_from(number(&node["pid"])).expect("32 bits")).collect();
        Self { dir, program: Some(program), nodes }
    }

    /// Starts a run whose action is [`FAMILY`], and waits until all its processes run.
    fn with_family(args: &[&str]) -> (Self, [u32; 3]) {
        let scene = Self::start(HELD, "grip", FAMILY, args);
        let family = ALL.map(|name| scene.process(name));
        assert!(family.iter().all(|&pid| is_alive(pid)), "{family:?}");
        (scene, family)
    }

    /// As `with_family`, but the launcher kills the node after this time. `None` if not all processes ran before the
    /// kill.
    fn with_doomed_family(killed_after: Duration) -> Option<(Self, [u32; 3])> {
        let begin = Instant::now();
        let scene = Self::start(HELD, "grip", FAMILY, &["--kill", &format!("n@{}s", killed_after.as_secs())]);
        let is_late = || begin.elapsed() >= killed_after;
        let are_written = || ALL.iter().all(|name| scene.path(name).exists());
        wait_until("the family is there, or its node may be dead", || are_written() || is_late());
        if !are_written() {
            return None;
        }
        let family = ALL.map(|name| scene.process(name));
        let are_alive = family.iter().all(|&pid| is_alive(pid));
        // This clock reading comes after the check, so it shows that the check came before the kill.
        (!is_late()).then(|| {
            assert!(are_alive, "{family:?}");
            (scene, family)
        })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// The text of a file; waits until the file exists.
    fn text(&self, name: &str) -> String {
        wait_until(&format!("the action has written `{name}`"), || self.path(name).exists());
        std::fs::read_to_string(self.path(name)).expect("a text")
    }

    /// The process id in a file.
    fn process(&self, name: &str) -> u32 {
        self.text(name).trim().parse().expect("the number of a process")
    }

    fn program(&self) -> &Program {
        self.program.as_ref().expect("it runs")
    }

    fn finish(&mut self) -> Said {
        self.program.take().expect("it runs").finish()
    }

    /// Interrupts the run and returns its summary.
    fn summary(&mut self) -> Value {
        self.program().interrupt();
        self.finish().last_json()
    }
}

impl Drop for Scene {
    /// Kills the processes that still run if a test fails.
    fn drop(&mut self) {
        for name in ALL {
            let text = std::fs::read_to_string(self.path(name)).unwrap_or_default();
            if let Ok(pid) = text.trim().parse() {
                signal(pid, Signal::KILL);
            }
        }
    }
}

/// Writes a script to a file. Returns the command that runs the script.
fn written(dir: &Path, script: &str) -> String {
    let file = dir.join("action.sh");
    std::fs::write(&file, format!("export DIR={}\n{script}", dir.display())).expect("the script is written");
    format!("sh {}", file.display())
}

fn parent(pid: u32) -> u32 {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).expect("a process");
    let (_, rest) = stat.rsplit_once(')').expect("a name");
    rest.split_whitespace().nth(1).and_then(|word| word.parse().ok()).expect("a parent")
}

fn all_end(family: [u32; 3]) {
    wait_until("the command and all that it started have ended", || !family.iter().any(|&pid| is_alive(pid)));
}

/// The present instant of `CLOCK_BOOTTIME`, the clock of deadlines, in microseconds.
fn boottime() -> u64 {
    let now = clock_gettime(ClockId::Boottime);
    u64::try_from(now.tv_sec).expect("positive") * 1_000_000
        + u64::try_from(now.tv_nsec).expect("positive") / 1_000
}

#[test]
fn a_killed_node_takes_its_command_and_all_that_it_started_with_it() {
    let (mut scene, family) = Scene::with_family(&[]);
    signal(scene.nodes[0], Signal::KILL);
    all_end(family);
    assert_eq!(scene.finish().code, Some(1), "somebody interfered");
    sooner_or_later("the family was never there before the launcher killed its node", |killed_after| {
        let Some((mut scene, family)) = Scene::with_doomed_family(killed_after) else { return false };
        all_end(family);
        assert_eq!(scene.finish().code, Some(0));
        true
    });
}

#[test]
fn an_orderly_stop_takes_the_command_and_all_that_it_started_with_it() {
    for how in [&[][..], &["--in-process"]] {
        let (mut scene, family) = Scene::with_family(how);
        scene.program().interrupt();
        all_end(family);
        assert_eq!(scene.finish().code, Some(0));
    }
}

#[test]
fn a_killed_launcher_takes_the_commands_of_its_nodes_with_it() {
    for how in [&[][..], &["--in-process"]] {
        let (scene, family) = Scene::with_family(how);
        signal(scene.program().pid(), Signal::KILL);
        all_end(family);
    }
}

#[test]
fn a_killed_guard_takes_its_command_with_it_and_that_is_told() {
    let (mut scene, family) = Scene::with_family(&[]);
    let [command, child, left] = family;
    signal(parent(command), Signal::KILL);
    wait_until("the group of the command has ended", || !is_alive(command) && !is_alive(child));
    // The guard that should kill this process is dead. So the process stays, and the run reports that.
    signal(left, Signal::KILL);
    let said = scene.finish();
    assert_eq!(said.code, Some(1), "{said:?}");
    assert!(said.err.contains("action `grip`: its guard was killed"), "{said:?}");
    assert!(said.err.contains("failure of `grip`"), "{said:?}");
}

#[test]
fn a_command_learns_by_when_it_must_be_over_and_no_epoch_without_a_couple() {
    let before = boottime();
    let (mut scene, family) = Scene::with_family(&[]);
    let deadline: u64 = scene.text("deadline").trim().parse().expect("microseconds");
    // The time until the deadline is the sum of the declared time and the margin.
    let length = 602_000_000;
    assert!((before + length..=boottime() + length).contains(&deadline), "{deadline}");
    assert_eq!(scene.text("epoch").trim(), "");
    wait_until("the deadline is told", || !scene.text("orders").is_empty());
    assert_eq!(scene.text("orders"), format!("deadline {deadline}\n"));
    scene.summary();
    all_end(family);
}

/// Runs [`HELD`] with this script as its action, to the end.
fn ended(script: &str) -> (Scene, Said) {
    let mut scene = Scene::start(HELD, "grip", script, &[]);
    let said = scene.finish();
    (scene, said)
}

#[test]
fn a_command_may_say_any_amount_and_leave_a_child_that_holds_its_output() {
    let (_, said) = ended("echo 7; seq 200000");
    assert_eq!(
        (said.code, said.last_json()["tasks"][0]["end"].as_str()),
        (Some(0), Some("finished")),
        "{said:?}"
    );
    let (scene, said) = ended("sleep 600 & echo $! > $DIR/child; exit 0");
    assert_eq!(
        (said.code, said.last_json()["tasks"][0]["end"].as_str()),
        (Some(0), Some("finished")),
        "{said:?}"
    );
    // The end of the command is reported only after the end of its descendants.
    assert!(!is_alive(scene.process("child")));
}

#[test]
fn a_command_that_takes_too_long_is_killed_and_its_action_fails_by_name() {
    // The guard kills the command two seconds after its start, even if the script has not written all ids by then.
    tried_again("the command was killed before it had written down all that it started", || {
        let mut scene = Scene::start(SHORT, "grip", FAMILY, &[]);
        let said = scene.finish();
        assert_eq!(said.code, Some(1), "{said:?}");
        assert!(said.err.contains("action `grip`: took longer than the declared 1ms"), "{said:?}");
        assert!(said.err.contains("task `t` aborted: failure of `grip`"), "{said:?}");
        let written: Vec<_> = ALL.iter().filter(|name| scene.path(name).exists()).collect();
        assert!(!written.iter().any(|name| is_alive(scene.process(name))), "{said:?}");
        written.len() == ALL.len()
    });
}

/// Starts the weld cell with [`FAMILY`] as the weld action; all other actions take no time. The node of the lease's
/// owner is the first one.
fn weld(lease: &str, args: &[&str]) -> Scene {
    let cell = std::fs::read_to_string(example("weld_cell.cell")).expect("the example");
    let usual = "lease 100 msec takeover 400 msec every 20 msec";
    assert!(cell.contains(usual));
    let others = ["--action", "dress=true", "--action", "inspect=true", "--action", "recheck=true"];
    let cell = cell.replace(usual, lease).replace("takes 2400..2500 msec", "takes 0..600 sec");
    // A busy machine may answer late, so the time_out is longer here.
    let cell = cell.replace("time_out = 15 msec", "time_out = 1 sec");
    Scene::start(&cell, "weld", FAMILY, &[&others, args].concat())
}

/// A lease that is long enough not to end on a busy machine.
const LEASE: &str = "lease 4000 msec takeover 9000 msec every 100 msec";

#[test]
fn a_stopped_node_keeps_its_command_no_longer_than_its_lease() {
    let mut scene = weld(LEASE, &[]);
    let family = ALL.map(|name| scene.process(name));
    let first: u64 = scene.text("deadline").trim().parse().expect("microseconds");
    let epoch: u8 = scene.text("epoch").trim().parse().expect("an epoch");
    assert_eq!(epoch % 2, 1, "one of the primary's");
    let last =
        || scene.text("orders").lines().last().and_then(|line| line.strip_prefix("deadline ")?.parse().ok());
    wait_until("the lease is renewed", || last().is_some_and(|last: u64| last > first));
    signal(scene.nodes[0], Signal::STOP);
    all_end(family);
    assert!(is_alive(scene.nodes[0]));
    // The command must not end before the end of the last lease that it was told.
    let last = last().expect("a deadline");
    assert!(boottime() >= last, "{last}");
    assert!(last < first + 600_000_000, "the end of a lease, not that of the action");
    signal(scene.nodes[0], Signal::CONT);
    scene.summary();
}

/// The check that at most one of both robots is active.
fn one_active(summary: &Value) -> &Value {
    let checks = summary["checks"].as_array().expect("checks");
    checks.iter().find(|check| check["name"] == "one_active").expect("the check")
}

#[test]
fn a_check_is_unknown_while_the_command_of_a_killed_node_may_go_on() {
    // The guard dies with its node. So no guard confirms the end of the command, and its descendants go on.
    let mut scene = weld(LEASE, &[]);
    let family = ALL.map(|name| scene.process(name));
    let guard = parent(family[0]);
    signal(scene.nodes[0], Signal::STOP);
    signal(guard, Signal::KILL);
    signal(scene.nodes[0], Signal::KILL);
    // By now the standby has taken over and welds.
    let second = scene.process("by0");
    assert!(is_alive(second) && is_alive(family[1]));
    scene.program().interrupt();
    let launcher = scene.program().pid();
    wait_until("the run has ended", || !is_alive(launcher));
    // These processes keep the standard error of the run open while they run, so they are killed.
    family[1..].iter().for_each(|&pid| signal(pid, Signal::KILL));
    let said = scene.finish();
    // The kill of the node is a finding, which outranks an unknown check (D148).
    assert_eq!(said.code, Some(1), "{said:?}");
    let summary = said.last_json();
    let check = one_active(&summary);
    assert_eq!(check["outcome"], "unknown", "{summary}");
    let mut incomplete = summary["incomplete"].as_array().expect("lines").iter().filter_map(Value::as_str);
    let why = ": the command of `r1` was not confirmed to have ended";
    assert!(incomplete.any(|line| line.starts_with("check one_active ") && line.ends_with(why)), "{summary}");
    assert!(check["unvouched"]["seconds"].as_f64().expect("seconds") > 0.0, "{summary}");
    assert_eq!(check["unvouched"]["why"], "the command of `r1` was not confirmed to have ended", "{summary}");
    all_end(family);
}

#[test]
fn a_check_holds_when_the_guard_has_confirmed_the_end_before_the_standby_acts() {
    let mut scene = weld(LEASE, &[]);
    let family = ALL.map(|name| scene.process(name));
    signal(scene.nodes[0], Signal::KILL);
    let second = scene.process("by0");
    assert!(is_alive(second) && !family.iter().any(|&pid| is_alive(pid)));
    assert_eq!(one_active(&scene.summary())["outcome"], "held");
}

/// A field of `/proc/PID/stat`, numbered as in `man proc_pid_stat`.
fn stat(pid: u32, field: usize) -> String {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).expect("a process");
    let (_, rest) = stat.rsplit_once(')').expect("a name");
    rest.split_whitespace().nth(field - 3).expect("the field").to_owned()
}

#[test]
fn a_command_of_a_node_in_real_time_is_an_ordinary_process() {
    let (mut scene, family) = Scene::with_family(&["--rt"]);
    let process = |pid: u32| rustix::process::Pid::from_raw(i32::try_from(pid).expect("31 bits"));
    let cores = |pid: u32| sched_getaffinity(process(pid)).expect("the cores").count();
    let (policy, guard) = (stat(family[0], 41), parent(family[0]));
    let (own, of_command, of_guard) =
        (sched_getaffinity(None).expect("the cores").count(), cores(family[0]), cores(guard));
    let guarded = stat(guard, 41);
    let summary = scene.summary();
    all_end(family);
    let missing = (summary["rt"] != true).then_some("the right to real time");
    if !is_here(missing, "a command in real time was NOT looked at") {
        return;
    }
    assert_eq!((of_command, policy.as_str()), (own, "0"), "SCHED_OTHER on all cores");
    assert_eq!((of_guard, guarded.as_str()), (1, "1"), "the guard must be in time, too");
}
