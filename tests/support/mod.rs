//! Helpers of the end-to-end tests, which run the `imrs` command with a time limit and in a runtime folder of its own.

pub mod claims;
pub mod live;
pub mod program;
pub mod stub;
pub mod tape;

use program::Program;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU16, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// The time limit of every wait in the tests. No command takes this long, even on a very busy machine.
pub const PATIENCE: Duration = Duration::from_secs(600);

/// Whether a test has all programs that it needs: `missing` names one that is not installed. The function then prints
/// what is not tested, or fails if `IMRS_REQUIRE_ALL=1` is set.
pub fn is_here(missing: Option<&str>, not_done: &str) -> bool {
    let Some(missing) = missing else { return true };
    let required = std::env::var_os("IMRS_REQUIRE_ALL").is_some_and(|value| value == "1");
    assert!(!required, "{missing} is missing, and IMRS_REQUIRE_ALL=1 requires it");
    eprintln!("\n*** SKIPPED: {missing} is missing, so {not_done}. Install it. ***\n");
    false
}

/// Whether `IMRS_QUIET=1` says that nothing else runs on this machine. The tests then also assert times.
pub fn is_quiet() -> bool {
    std::env::var_os("IMRS_QUIET").is_some_and(|value| value == "1")
}

/// Skips an assertion because this machine was late, and prints the reason. Fails on a quiet machine. Otherwise a
/// defect that looks like lateness would pass for ever.
pub fn excused(why: &str) {
    assert!(!is_quiet(), "{why}, on a quiet machine");
    println!("this machine was late: {why}");
}

/// How often a test that a late machine may spoil is attempted.
pub const TIMES: usize = 5;

/// Attempts something that a late machine may spoil, up to `TIMES` times. If every attempt is spoilt, the test is excused.
pub fn tried(why: &str, is_done: impl FnMut() -> bool) {
    if !std::iter::repeat_with(is_done).take(TIMES).any(|done| done) {
        excused(why);
    }
}

/// Attempts something that a suspended process may spoil, up to `TIMES` times. Such a suspension is rare, so the test
/// fails if every attempt is spoilt.
pub fn tried_again(why: &str, mut is_done: impl FnMut() -> bool) {
    for _ in 0..TIMES {
        if is_done() {
            return;
        }
        excused(why);
    }
    panic!("each time {why}");
}

/// Runs a test whose fault comes soon after the start. If the machine is too slow for that, the fault comes later in
/// the next attempt.
pub fn sooner_or_later(why: &str, is_done: impl FnMut(Duration) -> bool) {
    let mut faults = [3, 20, 100].map(Duration::from_secs).into_iter();
    assert!(faults.any(is_done), "{why}, though the fault came 100 s after the start");
}

/// Whether `IMRS_WHOLE=1` asks for checks with bounds that take minutes instead of seconds.
pub fn is_whole() -> bool {
    std::env::var_os("IMRS_WHOLE").is_some_and(|value| value == "1")
}

/// A bound of a test. An environment variable may override the usual number, for long runs.
pub fn bound(variable: &str, usual: u64) -> u64 {
    std::env::var(variable).map_or(usual, |text| text.parse().unwrap_or_else(|e| panic!("{variable}: {e}")))
}

/// The path of a file in `examples/`.
pub fn example(name: &str) -> String {
    format!("{}/examples/{name}", env!("CARGO_MANIFEST_DIR"))
}

/// The metadata of this workspace, as `cargo metadata` prints it.
pub fn metadata() -> Value {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--no-deps", "--offline"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo metadata");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// A loopback address, and UDP ports on it that no other program or test uses. The address is unique to this process,
/// and the ports to this call. They lie below the kernel's ephemeral ports.
pub fn own_address<const N: usize>() -> (Ipv4Addr, [u16; N]) {
    static USED: AtomicU16 = AtomicU16::new(0);
    let [_, a, b, c] = std::process::id().to_be_bytes();
    let first = 20_000 + USED.fetch_add(u16::try_from(N).expect("a few"), Ordering::Relaxed);
    // Other programs on this machine use the addresses 127.0.x.y.
    let ports = std::array::from_fn(|i| first + u16::try_from(i).expect("a few"));
    (Ipv4Addr::new(127, 64 | a, b, c), ports)
}

/// Tests all cases at once, each in a thread of its own: the tests mostly wait, and rarely need a processor.
pub fn side_by_side<T: Send>(cases: impl IntoIterator<Item = T>, test: impl Fn(T) + Sync) {
    let test = &test;
    thread::scope(|scope| {
        for case in cases {
            scope.spawn(move || test(case));
        }
    });
}

/// A runtime folder for the nodes and monitors of one test.
pub fn runtime_dir() -> TempDir {
    // The folder is not in cargo's build folder, because the paths of Unix sockets must be short.
    tempfile::Builder::new().prefix("imrs-test").tempdir().expect("a folder for temporary files")
}

/// The `imrs` command under test, which runs in this folder with these arguments.
pub fn imrs(dir: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_imrs"));
    command.args(args).env("XDG_RUNTIME_DIR", dir).env("XDG_STATE_HOME", dir.join("state"));
    command.env_remove("NO_COLOR").env_remove("CLICOLOR_FORCE");
    command.stdin(Stdio::null());
    command
}

/// The output and the exit code of a command.
#[derive(Debug)]
pub struct Said {
    pub out: String,
    pub err: String,
    pub code: Option<i32>,
}

/// Whether a run ended well, or complained only of broken checks or missing evidence. The machine may have been later,
/// or the fault larger, than the cell file declares, and a check may then break.
pub fn is_well(code: Option<i32>, errors: &str) -> bool {
    let starts = |words: &str| errors.lines().any(|line| line.starts_with(words));
    let (checks, incomplete) = ("imrs: check ", "imrs: incomplete: ");
    let all = errors.lines().all(|line| line.starts_with(checks) || line.starts_with(incomplete));
    match code {
        Some(0) => true,
        Some(1) => all && starts(checks),
        Some(5) => all && starts(incomplete),
        Some(_) | None => false,
    }
}

impl Said {
    /// Whether the command ended well, apart from broken checks (see [`is_well`]).
    pub fn is_well(&self) -> bool {
        is_well(self.code, &self.err)
    }

    /// The last line of standard output, as JSON.
    pub fn last_json(&self) -> Value {
        let line = self.out.lines().last().unwrap_or_else(|| panic!("no output: {self:?}"));
        serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}"))
    }
}

/// Runs the command with these arguments to its end, in a runtime folder of its own.
pub fn run(args: &[&str]) -> Said {
    let dir = runtime_dir();
    run_in(dir.path(), args)
}

/// Runs the command with these arguments to its end, in this runtime folder. If the command recorded nodes, their
/// recordings must replay.
pub fn run_in(dir: &Path, args: &[&str]) -> Said {
    recorded(dir, args, finish(imrs(dir, args)))
}

/// Repeats a command that samples nodes only once, until `is_so` accepts its output. On a busy machine a node may be
/// silent for longer than the command waits.
pub fn look_until(dir: &Path, args: &[&str], what: &str, is_so: impl Fn(&Said) -> bool) -> Said {
    let mut said = run_in(dir, args);
    wait_until(what, || {
        let is_there = is_so(&said);
        if !is_there {
            said = run_in(dir, args);
        }
        is_there
    });
    said
}

/// Runs a cell until `is_enough` accepts a line of its output, or until the cell ends by itself. If nodes were
/// recorded, their recordings must replay.
pub fn run_until(dir: &Path, args: &[&str], is_enough: impl FnMut(&str) -> bool) -> Said {
    let mut program = Program::start(imrs(dir, args));
    program.read_until(is_enough);
    program.interrupt();
    recorded(dir, args, program.finish())
}

/// Whether the recordings of a run show that this machine was later than the cell file declares. The run may then fail
/// although the program has no defect.
pub fn was_late(dir: &Path, cell: &str, file: &Path, nodes: &[&str]) -> bool {
    let files: Vec<_> = nodes.iter().map(|node| file.with_extension(format!("{node}.imrs"))).collect();
    let files: Vec<&str> = files.iter().map(|file| file.to_str().expect("UTF-8")).collect();
    let how = ["--cell", cell, "--model", "--format", "json"];
    let told = run_in(dir, &[&["replay"], &files[..], &how[..]].concat()).last_json();
    let breaches = told["breaches"].as_array().expect("breaches");
    let late = breaches.iter().any(|breach| breach["kind"] == "late" || breach["kind"] == "delay");
    if late {
        excused(&told.to_string());
    }
    late
}

fn recorded(dir: &Path, args: &[&str], said: Said) -> Said {
    if let ["run", cell, ..] = args
        && let Some(at) = args.iter().position(|arg| *arg == "--record")
        && matches!(said.code, Some(0 | 1 | 5))
    {
        replays(dir, Path::new(args[at + 1]), Some(cell));
    }
    said
}

/// Asserts that the recordings beside `file` replay with exactly the recorded outputs, and that no state in between
/// breaks a law. The recording of a killed node is replayed as far as it goes.
pub fn replays(dir: &Path, file: &Path, cell: Option<&str>) {
    let stem = file.file_stem().expect("a name").to_str().expect("UTF-8");
    let beside = file.parent().expect("a folder").read_dir().expect("the folder of the recordings");
    let beside = beside.map(|entry| entry.expect("an entry").path());
    let is_one = |path: &PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str()).expect("UTF-8");
        name.strip_prefix(stem).is_some_and(|rest| rest.starts_with('.'))
            && name.ends_with(".imrs")
            && path != file
    };
    let files: Vec<PathBuf> = beside.filter(is_one).collect();
    assert!(!files.is_empty(), "{} has no recordings", file.display());
    let files: Vec<&str> = files.iter().map(|file| file.to_str().expect("UTF-8")).collect();
    let cell = cell.map_or(Vec::new(), |cell| vec!["--cell", cell]);
    let said = finish(imrs(dir, &[&["replay"], &files[..], &cell[..], &["--format", "json"]].concat()));
    let answers = said.out.lines().map(|line| serde_json::from_str::<Value>(line).expect("JSON"));
    let answers: Vec<Value> = answers.collect();
    // The recording of a killed node has no end record.
    let incomplete = answers.iter().any(|answer| answer["complete"] == false);
    assert_eq!(said.code, Some(if incomplete { 5 } else { 0 }), "{said:?}");
    let tasks: Vec<Value> =
        answers.iter().flat_map(|answer| answer["tasks"].as_array().expect("tasks").clone()).collect();
    // A slow disk may have lost inputs, and the recording then says so. The state machine is not at fault.
    let judged = |task: &&Value| task["verdict"] == "same" || number(&task["lost"]) > 0;
    assert!(!tasks.is_empty() && tasks.iter().filter(judged).count() == tasks.len(), "{tasks:?}");
}

pub fn number(value: &Value) -> u64 {
    value.as_u64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// Runs a command to its end.
pub fn finish(command: Command) -> Said {
    Program::start(command).finish()
}

/// Sends a signal to a process that this test started. After [`Signal::STOP`] this waits until all threads of the process are
/// stopped. The kernel stops them one by one, and a thread that still runs could react to the next step of the test.
pub fn signal(pid: u32, signal: Signal) {
    if let Some(target) = i32::try_from(pid).ok().and_then(Pid::from_raw) {
        // The process may already have exited.
        let _ = kill_process(target, signal);
    }
    if signal == Signal::STOP {
        wait_until("the process stands still", || !is_alive(pid) || threads_stand_still(pid));
    }
}

fn threads_stand_still(pid: u32) -> bool {
    let threads = std::fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten();
    let mut states = threads.filter_map(|thread| std::fs::read_to_string(thread.path().join("stat")).ok());
    states.all(|stat| stat.rsplit_once(')').is_some_and(|(_, rest)| rest.trim_start().starts_with('T')))
}

/// Whether a process exists and is not a zombie.
pub fn is_alive(pid: u32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    stat.rsplit_once(')').is_some_and(|(_, rest)| !rest.trim_start().starts_with('Z'))
}

/// Waits until `is_so` is true.
pub fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let end = Instant::now() + PATIENCE;
    while !is_so() {
        assert!(Instant::now() < end, "waited in vain until {what}");
        thread::sleep(Duration::from_millis(20));
    }
}
