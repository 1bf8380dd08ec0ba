//! End-to-end tests of `imrs run`: cells on real processes and sockets, with real faults. A run ends by itself or once the
//! expected output has come. Results that must not depend on the machine are asserted exactly.

use crate::support::live::{Live, named, released};
use crate::support::program::{Program, one_after_the_other, times};
use crate::support::{
    Said, example, finish, imrs, is_alive, is_here, is_well, look_until, number, run_in, run_until,
    runtime_dir, side_by_side, tried_again, wait_until,
};
use serde_json::Value;
use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::{Command, Stdio};

/// A cell of two tasks that meet and query each other through a third node, which only relays packets. The tasks' time_outs are
/// longer than any delay of a process on a busy machine.
const RELAYED: &str = "\
cell relayed;
tick 1 msec;
node na;  node nb;  node nm;
link na -- nm delay 1 msec;  link nb -- nm delay 1 msec;
type N is record n: int16; end;
task a on na
  port meet()     usage = waitfor  user_list = {b}  time_out = 600 sec  class = 2  retry = 8  resend = 20 msec;
  port ask(q: N) -> N  usage = query  message_format = N  user_list = {b}  time_out = 600 sec  class = 2  retry = 20  resend = 30 msec;
  var q: N;  var r: N;
begin
  while q.n < 5 do
    run grip takes 100..120 msec;
    waitfor meet() on time_out do abort \"nobody came\"; end;
    query ask(q) -> r on time_out do abort \"no answer\"; end;
    if r.n <> q.n + 1 then abort \"a wrong answer\"; end;
    q.n := r.n;
  end;
end a;
task b on nb
  use_port meet()    usage = waitfor   time_out = 600 sec;
  use_port ask(q: N) usage = response  time_out = 600 sec;
begin
  on query ask(q) do response(q.n + 1); end;
  loop
    waitfor meet() on time_out do abort \"nobody came\"; end;
  end;
end b;
";

/// A cell with a task that ends, and a task that serves for ever.
const SERVED: &str = "\
cell served;
tick 1 msec;
node na;  node nb;
link na -- nb delay 1 msec;
type N is record n: int16; end;
task a on na
  port ask(q: N) -> N  usage = query  message_format = N  user_list = {b}  time_out = 60 sec  class = 2  retry = 20  resend = 30 msec;
  var q: N;  var r: N;
begin
  run grip takes 10..20 msec;
  query ask(q) -> r on time_out do abort \"no answer\"; end;
end a;
task b on nb
  use_port ask(q: N) usage = response  time_out = 60 sec;
begin
  on query ask(q) do response(q.n + 1); end;
  loop
    delay 100 msec;
  end;
end b;
";

pub struct Bench(pub tempfile::TempDir);

impl Bench {
    pub fn new() -> Self {
        Self::of(RELAYED)
    }

    /// The cell of `new`, with time_outs of this many seconds.
    pub fn that_waits(seconds: u32) -> Self {
        Self::of(&RELAYED.replace("time_out = 600 sec", &format!("time_out = {seconds} sec")))
    }

    fn of(text: &str) -> Self {
        let bench = Self(runtime_dir());
        std::fs::write(bench.cell(), text).expect("the cell is written");
        bench
    }

    pub fn cell(&self) -> PathBuf {
        self.0.path().join("relayed.cell")
    }

    /// Runs the cell until it ends by itself: `b` aborts when `a` does not arrive.
    fn run(&self, args: &[&str]) -> Said {
        self.run_until(args, |_| false)
    }

    fn run_until(&self, args: &[&str], is_enough: impl FnMut(&str) -> bool) -> Said {
        let cell = self.cell();
        let cell = cell.to_str().expect("UTF-8");
        run_until(self.0.path(), &[&["run", cell, "--seed", "3"], args].concat(), is_enough)
    }
}

pub fn port<'a>(summary: &'a Value, name: &str) -> &'a Value {
    named(&summary["ports"], name)
}

fn node<'a>(summary: &'a Value, name: &str) -> &'a Value {
    named(&summary["nodes"], name)
}

fn exit<'a>(summary: &'a Value, name: &str) -> &'a Value {
    &node(summary, name)["exit"]
}

#[test]
fn scripts_meet_and_ask_through_a_node_that_only_relays() {
    side_by_side([&["--format", "json"][..], &["--format", "json", "--in-process"]], |how: &[&str]| {
        // The time_out is long enough for any machine. When `a` has ended, `b` waits this long and then gives up.
        let said = Bench::that_waits(10).run(how);
        let summary = said.last_json();
        // After `a` has ended, `b` waits for `a` until the time_out. The abort of `b` is the finding.
        assert_eq!(said.code, Some(1), "{said:?}");
        assert!(said.err.contains("task `b` aborted: nobody came (line"), "{said:?}");
        assert!(!said.err.contains("task `a`"), "{said:?}");
        assert_eq!(number(&port(&summary, "ask")["delivered"]), 5, "{summary}");
        assert_eq!(number(&summary["rendezvous"][0]["released"]), 5, "{summary}");
        assert_eq!(number(&summary["rendezvous"][0]["false_releases"]), 0, "{summary}");
        assert_eq!(summary["tasks"][0]["name"], "a", "{summary}");
        assert_eq!(summary["tasks"][0]["end"], "finished", "{summary}");
        for node in ["na", "nb", "nm"] {
            assert_eq!(exit(&summary, node), "clean", "{summary}");
        }
        assert!(number(&node(&summary, "nm")["forwarded"]) >= 20, "{summary}");
    });
}

#[test]
fn a_run_says_when_only_servers_are_left_and_can_end_then() {
    side_by_side([&[][..], &["--in-process"]], |how: &[&str]| {
        let bench = Bench::new();
        let cell = bench.0.path().join("served.cell");
        std::fs::write(&cell, SERVED).expect("the cell is written");
        let cell = cell.to_str().expect("UTF-8");
        let run = ["run", cell, "--seed", "3"];
        let words = "only servers are left: b; Ctrl-C ends the run, or use --until-idle";
        // Without `--until-idle` this run would go on for ever.
        let said = run_until(bench.0.path(), &[&run[..], how].concat(), times(1, words));
        assert!(said.code == Some(0) && said.out.contains(words), "{said:?}");
        let idle = [&run[..], &["--until-idle"], how].concat();
        let said = run_in(bench.0.path(), &[&idle[..], &["--format", "json"]].concat());
        let summary = said.last_json();
        assert_eq!(said.code, Some(0), "{said:?}");
        assert_eq!(
            (&summary["tasks"][0]["name"], &summary["tasks"][1]),
            (&"a".into(), &Value::Null),
            "{summary}"
        );
        // A task whose node is dead for good does not count as running either.
        let said = run_in(bench.0.path(), &[&idle[..], &["--kill", "na@1ms"]].concat());
        assert!(said.code == Some(0) && said.out.contains("only servers are left: b"), "{said:?}");
        let serves = SERVED.replace("run grip takes 10..20 msec;", "loop run grip takes 10..20 msec; end;");
        std::fs::write(cell, serves).expect("the cell is written");
        let said = run_in(bench.0.path(), &idle);
        assert!(said.code == Some(2) && said.err.contains("every task here serves for ever"), "{said:?}");
    });
}

#[test]
fn what_every_node_recorded_under_loss_replays_bit_equal() {
    let bench = Bench::that_waits(2);
    let file = bench.0.path().join("run.imrs");
    let file = file.to_str().expect("UTF-8");
    let said = bench.run(&["--loss", "20%", "--record", file, "--format", "json"]);
    assert_eq!(number(&said.last_json()["rendezvous"][0]["false_releases"]), 0, "{said:?}");
    let cell = bench.cell();
    for (node, tasks) in [("na", 1), ("nb", 1), ("nm", 0)] {
        let file = file.replace("run.imrs", &format!("run.{node}.imrs"));
        let cell = cell.to_str().expect("UTF-8");
        let said = run_in(bench.0.path(), &["replay", &file, "--cell", cell, "--format", "json"]);
        assert_eq!(said.code, Some(0), "{said:?}");
        let replayed = said.last_json();
        let replayed = replayed["tasks"].as_array().expect("tasks");
        assert_eq!(replayed.len(), tasks, "{said:?}");
        assert!(replayed.iter().all(|task| task["verdict"] == "same"), "{said:?}");
    }
}

#[test]
fn a_killed_node_and_a_cut_link_are_found_by_their_time_outs() {
    // A node that is killed before it has reported anything causes no false release.
    let faults =
        [&["--kill", "a@1ms"][..], &["--cut", "na--nm@0s+10m"], &["--kill", "nm@1ms", "--in-process"]];
    side_by_side(faults, |fault: &[&str]| {
        // The run ends when the other tasks have given up.
        let said = Bench::that_waits(2).run(fault);
        assert_eq!(said.code, Some(1), "{said:?}");
        assert!(said.err.contains(" aborted: no"), "{said:?}");
        assert!(said.out.contains("false releases: 0"), "{said:?}");
    });
}

/// The checker, simulated actions and commands that print a number agree on the value of a `real` result.
#[test]
fn a_real_result_is_a_real() {
    let dir = runtime_dir();
    let file = dir.path().join("level.cell");
    let cell = |range: &str, least: &str| {
        format!(
            "cell level;\ntick 1 msec;\nnode n;\ntask t on n\nvar r: real;\nbegin\n  run look -> r {range} takes 0..600 sec;\n  \
             assert r > {least} and r <= 3.0;\nend t;\n"
        )
    };
    let run = |cell: &str, args: &[&str]| {
        std::fs::write(&file, cell).expect("written");
        run_in(dir.path(), &[&["run", file.to_str().expect("text")], args].concat())
    };
    let look = dir.path().join("look");
    std::fs::write(&look, "#!/bin/sh\necho 2.5\n").expect("written");
    std::fs::set_permissions(&look, Permissions::from_mode(0o700)).expect("set");
    let bound = format!("look={}", look.display());
    let said = run(&cell("", "2.4"), &["--action", &bound]);
    assert_eq!(said.code, Some(0), "{said:?}");
    let said = run(&cell("", "2.6"), &["--action", &bound]);
    assert!(said.code == Some(1) && said.err.contains("an assertion does not hold"), "{said:?}");
    let said = run(&cell("in 1 .. 3", "0.9").replace("0..600 sec", "1 msec"), &[]);
    assert_eq!(said.code, Some(0), "{said:?}");
}

#[test]
fn an_action_is_a_command_where_one_is_bound() {
    let bench = Bench::new();
    let said = bench.run_until(&["--action", "grip=false"], times(1, " aborted: "));
    assert_eq!(said.code, Some(1), "{said:?}");
    assert!(said.err.contains("task `a` aborted: failure of `grip`"), "{said:?}");
    assert!(said.out.contains("FAILED: grip"), "{said:?}");
    let line = said.err.lines().find(|line| line.contains("task `a` aborted")).expect("told");
    assert_eq!(line.matches("line ").count(), 1, "{line}");
    let said = bench.run(&["--for", "0s"]);
    assert_eq!(said.code, Some(2), "{said:?}");
    assert!(said.err.contains("nothing would run"), "{said:?}");
    let said = bench.run(&["--action", "gripp=true"]);
    assert_eq!(said.code, Some(2), "{said:?}");
    assert!(said.err.contains("did you mean `grip`?"), "{said:?}");
    let said = bench.run(&["--action", "grip=no-such-gripper --slow"]);
    assert_eq!(said.code, Some(2), "{said:?}");
    assert!(said.err.contains("there is no program `no-such-gripper`"), "{said:?}");
}

#[test]
fn what_the_tasks_do_is_told_line_by_line() {
    let bench = Bench::new();
    let said = bench.run_until(&["--in-process"], times(1, " finished"));
    for words in [
        "begins grip",
        "ends grip",
        "waits at `meet`",
        "all arrived at `meet`",
        "b line 25  all arrived",
        "finished",
    ] {
        assert!(said.out.contains(words), "`{words}` is missing in\n{}", said.out);
    }
    assert!(!said.out.contains('\u{1b}'), "{}", said.out);
}

#[test]
fn the_examples_run() {
    let dir = runtime_dir();
    tried_again("a node stood still for longer than the time_out of the lift", || {
        let lift = Live::start(dir.path(), &["run", &example("beam_lift.cell"), "--seed", "3"]);
        lift.until("a lift", |seen| released(seen, "armL") >= 1);
        lift.interrupt();
        let (summary, _, errors) = lift.finish();
        let met = &summary["rendezvous"][0];
        assert_eq!(number(&met["false_releases"]), 0, "{summary} {errors}");
        assert!(number(&met["released"]) >= 1 || errors.contains(" aborted: "), "{summary} {errors}");
        number(&met["released"]) >= 1
    });
    let weld = ["run", &example("weld_cell.cell"), "--kill", "n1@1s", "--seed", "3"];
    let said = run_until(dir.path(), &weld, one_after_the_other(&["TAKES OVER", "begins weld"]));
    assert!(said.is_well(), "{said:?}");
    let welds = said.out.lines().filter(|line| line.contains("r2") && line.contains("begins weld"));
    assert!(welds.count() >= 1, "the standby takes over\n{}", said.out);
}

#[test]
fn what_is_no_cell_is_said_so() {
    let dir = runtime_dir();
    let said = run_in(dir.path(), &["run", "/no/such.cell"]);
    assert_eq!(said.code, Some(2), "{said:?}");
    let file = dir.path().join("faulty.cell");
    std::fs::write(&file, "cell faulty;\nnode a\nnode b;\n").expect("the file is written");
    let said = run_in(dir.path(), &["run", file.to_str().expect("UTF-8")]);
    assert_eq!(said.code, Some(2), "{said:?}");
    assert!(said.err.contains("error[E006]") && said.err.contains("faulty.cell:2:"), "{said:?}");
}

#[test]
fn an_interrupt_ends_all_nodes_and_gives_the_summary() {
    let dir = runtime_dir();
    let cell = example("beam_lift.cell");
    let live = Live::start(dir.path(), &["run", &cell]);
    let pids: Vec<u32> = live.nodes.iter().map(|node| node.pid).collect();
    live.interrupt();
    let (summary, code, errors) = live.finish();
    assert_eq!(summary["nodes"].as_array().expect("nodes").len(), 3);
    // After such a short run the verdicts on some checks may be unknown.
    assert!(is_well(code, &errors), "{errors}");
    wait_until("all nodes are gone", || pids.iter().all(|&pid| !is_alive(pid)));
}

#[test]
fn robots_that_reach_each_other_through_a_third_node_are_relayed() {
    let weld = example("weld_cell.cell");
    side_by_side([&[][..], &["--in-process"]], |how: &[&str]| {
        let dir = runtime_dir();
        let live = Live::start(dir.path(), &[&["run", &weld, "--seed", "3"], how].concat());
        // r1 and r2 exchange queries every few milliseconds, and only nt connects them. On a late machine both give up soon.
        let is_passed = |seen: &Value, node: &str, least: u64| {
            named(&seen["nodes"], node)["transit"]["forwarded"].as_u64() >= Some(least)
        };
        live.until("packets are passed on", |seen| {
            is_passed(seen, "nt", 5) && is_passed(seen, "n1", 1) && is_passed(seen, "n2", 1)
        });
        live.interrupt();
        let (summary, ..) = live.finish();
        assert!(number(&node(&summary, "nt")["forwarded"]) >= 5, "{summary}");
        for robot in ["n1", "n2"] {
            assert!(number(&node(&summary, robot)["forwarded"]) > 0, "{summary}");
        }
    });
}

/// A monitor that knows one address and the run's token sees the whole cell. Without the token it only learns why it may not look.
#[test]
fn nodes_are_watched_over_tcp() {
    let dir = runtime_dir();
    let [token, other] = ["token", "other"].map(|name| dir.path().join(name).display().to_string());
    std::fs::write(&token, "the token of this run\n").expect("a file");
    std::fs::write(&other, "the token of another run\n").expect("a file");
    for secret in [&token, &other] {
        std::fs::set_permissions(secret, Permissions::from_mode(0o600)).expect("it is this test's");
    }
    let live = Live::steady_in(dir.path(), &["--observe", "127.0.0.1:0", "--observe-token", &token]);
    let endpoint = format!("tcp:{}", live.nodes[1].observe.expect("an address"));
    let once = ["monitor", "--connect", &endpoint, "--once", "--format", "json"];
    let with_token = [&once[..], &["--token", &token]].concat();
    look_until(dir.path(), &with_token, "the whole cell is seen", |seen| {
        assert!(matches!(seen.code, Some(0 | 1 | 3)), "{seen:?}");
        let names = seen.out.lines().last().map_or(Vec::new(), names_of_nodes);
        names.len() == 3 && ["nl", "nr"].iter().all(|name| names.iter().any(|seen| seen == name))
    });
    let is_denied = |why: &'static str| {
        move |said: &Said| {
            assert_eq!(said.code, Some(3), "{said:?}");
            said.err.contains(why)
        }
    };
    look_until(dir.path(), &once, "a token is asked for", is_denied("asks for a token"));
    let with_other = [&once[..], &["--token", &other]].concat();
    look_until(dir.path(), &with_other, "the token is wrong", is_denied("another token"));
    live.interrupt();
    live.finish();
}

/// The names of the nodes in a sample.
fn names_of_nodes(sample: &str) -> Vec<String> {
    let sample: Value = serde_json::from_str(sample).expect("JSON");
    let nodes = sample["nodes"].as_array().expect("nodes").iter();
    nodes.map(|node| node["name"].as_str().expect("a name").to_owned()).collect()
}

/// A thread of a process, from `/proc`.
#[derive(Debug)]
struct Thread {
    name: String,
    /// The number of the thread's scheduling policy; 1 is SCHED_FIFO.
    policy: String,
    /// The thread's real-time priority: higher values run first; 0 for ordinary threads.
    priority: u32,
    cores: String,
}

/// The names of the threads that serve monitors, write complaints and report to the launcher, all at a lower priority.
const BEHIND: [&str; 3] = ["imrs observer", "imrs printer", "imrs teller"];

impl Thread {
    fn is_behind(&self) -> bool {
        BEHIND.contains(&&*self.name)
    }
}

/// Whether the observer thread is among these threads. A node starts that thread last.
fn are_watched(threads: &[Thread]) -> bool {
    threads.iter().any(|thread| thread.name == BEHIND[0])
}

fn threads(pid: u64) -> Vec<Thread> {
    let threads = std::fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten();
    let of = |thread: std::fs::DirEntry| {
        let text = |file: &str| std::fs::read_to_string(thread.path().join(file)).ok();
        let status = text("status")?;
        let cores = status.lines().find_map(|line| line.strip_prefix("Cpus_allowed_list:"))?.trim();
        let stat = text("stat")?;
        let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(37);
        let (priority, policy) = (fields.next()?.parse().ok()?, fields.next()?.to_owned());
        Some(Thread { name: text("comm")?.trim().to_owned(), policy, priority, cores: cores.to_owned() })
    };
    threads.filter_map(of).collect()
}

#[test]
fn real_time_is_had_or_refused_with_what_to_do() {
    for rights in [true, false] {
        let bench = Bench::new();
        let cell = bench.cell();
        let args = ["run", cell.to_str().expect("UTF-8"), "--rt", "--for", "10m", "--format", "json"];
        let mut command = imrs(bench.0.path(), &args);
        if !rights {
            // Without root, the first case has already tested the refusal, so the test ends here.
            if !rustix::process::geteuid().is_root() {
                return;
            }
            let is_missing = Command::new("setpriv").arg("--version").output().is_err();
            if !is_here(is_missing.then_some("setpriv"), "real time was NOT refused") {
                return;
            }
            let without = "-sys_nice,-ipc_lock";
            let program = command.get_program().to_owned();
            command = Command::new("setpriv");
            command.args(["--bounding-set", without, "--inh-caps", without, "--"]).arg(program).args(args);
            command.env("XDG_RUNTIME_DIR", bench.0.path()).stdin(Stdio::null());
        }
        let mut nodes = Program::start(command);
        let started = nodes.json();
        // A thread gets its name only when it begins to run.
        let mut all = Vec::new();
        wait_until("somebody serves monitors", || {
            all = threads(number(&started["started"][0]["pid"]));
            are_watched(&all)
        });
        let threads = all;
        let works = || threads.iter().filter(|thread| !thread.is_behind());
        let once = ["monitor", "--once", "--format", "json"];
        let seen =
            look_until(bench.0.path(), &once, "a node is seen", |seen| seen.code != Some(3)).last_json();
        nodes.interrupt();
        let said = nodes.finish();
        let (summary, said) = (said.last_json(), said.err);
        let shown = seen["nodes"][0]["real_time"].as_str().unwrap_or_default();
        assert!(works().all(|thread| thread.cores.parse::<u32>().is_ok()), "one core: {threads:?}");
        let mut behind: Vec<_> = threads.iter().filter(|thread| thread.is_behind()).collect();
        behind.sort_unstable_by_key(|thread| &thread.name);
        assert!(behind.iter().map(|thread| &*thread.name).eq(BEHIND), "one of each: {threads:?}");
        if summary["rt"] == true {
            // These threads run below all tasks and above ordinary programs, because they hold locks for which tasks wait.
            let comes_last = |thread: &&Thread| (&*thread.policy, thread.priority) == ("1", 1);
            assert!(behind.iter().all(comes_last), "{threads:?}");
            assert!(works().all(|thread| thread.priority > 1), "{threads:?}");
            assert!(works().count() > 3 && works().all(|thread| thread.policy == "1"), "{threads:?}");
            assert_eq!((shown, said.contains("--rt")), ("had", false), "{seen} {said}");
            assert!(rights, "rights that were taken away");
        } else {
            // The refusal is reported once, and not once per node.
            assert_eq!(said.matches("SCHED_FIFO").count(), 1, "{said}");
            assert!(said.contains("limits.conf") && said.contains("setcap"), "{said}");
            assert!(shown.starts_with("refused") && shown.contains("scheduler"), "{seen}");
            assert!(threads.iter().all(|thread| thread.policy == "0"), "{threads:?}");
        }
    }
}

#[test]
fn without_rt_all_threads_stay_ordinary_ones() {
    for how in [&[][..], &["--in-process"]] {
        let bench = Bench::new();
        let (cell, file) = (bench.cell(), bench.0.path().join("run.imrs"));
        let args = ["run", cell.to_str().expect("UTF-8"), "--for", "10m", "--format", "json", "--record"];
        let args = [&args[..], &[file.to_str().expect("UTF-8")], how].concat();
        let mut launcher = Program::start(imrs(bench.0.path(), &args));
        let started = launcher.json();
        let nodes = started["started"].as_array().expect("nodes").iter();
        let mut pids: Vec<u64> = nodes.map(|node| number(&node["pid"])).collect();
        pids.push(launcher.pid().into());
        pids.sort_unstable();
        pids.dedup();
        // A process with a node has an observer and a recorder thread.
        for pid in pids {
            let mut all = Vec::new();
            let launches = pid == u64::from(launcher.pid()) && how.is_empty();
            wait_until("the threads of a node", || {
                all = threads(pid);
                launches || (are_watched(&all) && all.len() > 3)
            });
            assert!(!all.is_empty(), "nobody is there");
            let ordinary = |thread: &Thread| (&*thread.policy, thread.priority) == ("0", 0);
            assert!(all.iter().all(ordinary), "{how:?} {all:?}");
        }
        launcher.interrupt();
        assert!(launcher.finish().code.is_some());
    }
}

#[path = "../examples/extern_task.rs"]
mod extern_task;

/// The environment variable that makes the test program run as the other process.
const OTHER: &str = "IMRS_TEST_EXTERN_TASK";

/// The body of a child process. The next test starts that process.
#[test]
fn the_program_of_the_other_process() {
    if std::env::var_os(OTHER).is_some() {
        // The test harness has printed the name of this test on the line, so the line is ended first.
        println!();
        extern_task::main().expect("it runs");
    }
}

#[test]
fn an_extern_task_is_a_rust_program() {
    let dir = runtime_dir();
    let cell = example("extern_task.cell");
    let said = run_in(dir.path(), &["run", &cell]);
    assert_eq!(said.code, Some(2), "{said:?}");
    assert!(said.err.contains("task `camera` is extern") && said.err.contains("--node"), "{said:?}");
    // All nodes run in one process, which is this test program again.
    let mut program = Command::new(std::env::current_exe().expect("this program"));
    program.args(["--exact", "run::the_program_of_the_other_process", "--nocapture", "--test-threads", "1"]);
    program.env(OTHER, "1").env("XDG_RUNTIME_DIR", dir.path());
    let said = finish(program);
    let text = &said.out;
    assert_eq!(said.code, Some(0), "{said:?}");
    assert_eq!(text.lines().filter(|line| line.starts_with("pick picks the part at (")).count(), 3, "{text}");
    assert!(text.contains("camera: returned") && text.contains("pick: done"), "{text}");
}

#[test]
fn the_library_of_the_command_is_that_of_a_robot() {
    let open: fn(&str) -> Result<imrs::Program, imrs::ProgramError> = |path| imrs_client::Program::open(path);
    assert!(open(&example("extern_task.cell")).is_ok());
}
