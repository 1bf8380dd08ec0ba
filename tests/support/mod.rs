//! What the end-to-end tests share: the command, bounded, in a runtime folder of its own.

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

/// No command takes this long, however busy the machine is.
pub const PATIENCE: Duration = Duration::from_secs(600);

/// Whether nothing is missing that a test needs. Otherwise it says what was not done, or fails where everything is required.
pub fn is_here(missing: Option<&str>, not_done: &str) -> bool {
    let Some(missing) = missing else { return true };
    let required = std::env::var_os("IMRS_REQUIRE_ALL").is_some_and(|value| value == "1");
    assert!(!required, "{missing} is missing, and IMRS_REQUIRE_ALL=1 requires it");
    eprintln!("\n*** SKIPPED: {missing} is missing, so {not_done}. Install it. ***\n");
    false
}

/// Whether the machine is said to be quiet: then times are asserted, too.
pub fn is_quiet() -> bool {
    std::env::var_os("IMRS_QUIET").is_some_and(|value| value == "1")
}

/// What a test does not ask for because this machine was late. It is said, and it is a failure of a machine that is said to
/// be quiet: so a fault that looks like lateness does not pass for ever.
pub fn excused(why: &str) {
    assert!(!is_quiet(), "{why}, on a quiet machine");
    println!("this machine was late: {why}");
}

/// How often something is tried that a late machine may spoil.
pub const TIMES: usize = 5;

/// Tries something that a late machine may spoil, a few times. If it is spoilt each time, the test is excused for this reason.
pub fn tried(why: &str, is_done: impl FnMut() -> bool) {
    if !std::iter::repeat_with(is_done).take(TIMES).any(|done| done) {
        excused(why);
    }
}

/// Tries something that a process that stands still may spoil, a few times. Only chance may spoil it: it fails if it is
/// spoilt each time.
pub fn tried_again(why: &str, mut is_done: impl FnMut() -> bool) {
    for _ in 0..TIMES {
        if is_done() {
            return;
        }
        excused(why);
    }
    panic!("each time {why}");
}

/// Tries something with a fault that comes soon after the start. If the machine is late for that, the next fault comes
/// later.
pub fn sooner_or_later(why: &str, is_done: impl FnMut(Duration) -> bool) {
    let mut faults = [3, 20, 100].map(Duration::from_secs).into_iter();
    assert!(faults.any(is_done), "{why}, though the fault came 100 s after the start");
}

/// Whether bounds are asked for that take minutes and not seconds.
pub fn is_whole() -> bool {
    std::env::var_os("IMRS_WHOLE").is_some_and(|value| value == "1")
}

/// A number that an environment variable may change, for long runs.
pub fn bound(variable: &str, usual: u64) -> u64 {
    std::env::var(variable).map_or(usual, |text| text.parse().unwrap_or_else(|e| panic!("{variable}: {e}")))
}

/// The file of an example.
pub fn example(name: &str) -> String {
    format!("{}/examples/{name}", env!("CARGO_MANIFEST_DIR"))
}

/// What cargo knows of this workspace.
pub fn metadata() -> Value {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--no-deps", "--offline"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo metadata");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// UDP ports of an address on the loopback that nobody else uses: the address is this process's, the ports are this call's,
/// and lie below those that the kernel hands out.
pub fn own_address<const N: usize>() -> (Ipv4Addr, [u16; N]) {
    static USED: AtomicU16 = AtomicU16::new(0);
    let [_, a, b, c] = std::process::id().to_be_bytes();
    let first = 20_000 + USED.fetch_add(u16::try_from(N).expect("a few"), Ordering::Relaxed);
    // 127.0.x.y is where everybody else is.
    let ports = std::array::from_fn(|i| first + u16::try_from(i).expect("a few"));
    (Ipv4Addr::new(127, 64 | a, b, c), ports)
}

/// Tries all cases at once, each in a thread: they wait more than they work.
pub fn side_by_side<T: Send>(cases: impl IntoIterator<Item = T>, test: impl Fn(T) + Sync) {
    let test = &test;
    thread::scope(|scope| {
        for case in cases {
            scope.spawn(move || test(case));
        }
    });
}

/// A folder that only this test's nodes and monitors use.
pub fn runtime_dir() -> TempDir {
    // Unix sockets have short names: not under the build folder.
    tempfile::Builder::new().prefix("imrs-test").tempdir().expect("a folder for temporary files")
}

/// The command under test.
pub fn imrs(dir: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_imrs"));
    command.args(args).env("XDG_RUNTIME_DIR", dir).env("XDG_STATE_HOME", dir.join("state"));
    command.env_remove("NO_COLOR").env_remove("CLICOLOR_FORCE");
    command.stdin(Stdio::null());
    command
}

/// What a command said, and how it ended.
#[derive(Debug)]
pub struct Said {
    pub out: String,
    pub err: String,
    pub code: Option<i32>,
}

/// Whether a run ended well, or all that was wrong are checks that did not hold, or evidence that is missing: this machine may
/// have been later than the cell declares, or the fault more than it does.
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
    /// Whether it ended well, but for checks ([`is_well`]).
    pub fn is_well(&self) -> bool {
        is_well(self.code, &self.err)
    }

    /// The last line of standard output, as JSON.
    pub fn last_json(&self) -> Value {
        let line = self.out.lines().last().unwrap_or_else(|| panic!("no output: {self:?}"));
        serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}"))
    }
}

/// Runs a command to its end.
pub fn run(args: &[&str]) -> Said {
    let dir = runtime_dir();
    run_in(dir.path(), args)
}

/// Runs a command to its end, in this runtime folder. What it recorded of nodes replays.
pub fn run_in(dir: &Path, args: &[&str]) -> Said {
    recorded(dir, args, finish(imrs(dir, args)))
}

/// Runs a command that looks once, again and again, until what it says is so. On a busy machine a node may be silent for longer than
/// one look waits.
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

/// Runs a cell until its lines are enough, or until it ends by itself. What it recorded of nodes replays.
pub fn run_until(dir: &Path, args: &[&str], is_enough: impl FnMut(&str) -> bool) -> Said {
    let mut program = Program::start(imrs(dir, args));
    program.read_until(is_enough);
    program.interrupt();
    recorded(dir, args, program.finish())
}

/// Whether the recordings of a run say that this machine was later than the cell declares: then it may end otherwise than
/// it should.
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

/// What the nodes of a run recorded beside `file` is bit-equal when it is run again, and every state that it comes to is
/// sound. Of a killed node as far as its recording goes.
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
    // Of a killed node the recording has no end.
    let incomplete = answers.iter().any(|answer| answer["complete"] == false);
    assert_eq!(said.code, Some(if incomplete { 5 } else { 0 }), "{said:?}");
    let tasks: Vec<Value> =
        answers.iter().flat_map(|answer| answer["tasks"].as_array().expect("tasks").clone()).collect();
    // A disk that could not keep up is no fault of the machine: what is missing was told.
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

/// Sends a signal to a process that this test started.
pub fn signal(pid: u32, signal: Signal) {
    if let Some(pid) = i32::try_from(pid).ok().and_then(Pid::from_raw) {
        // A process that is gone cannot be told anything.
        let _ = kill_process(pid, signal);
    }
}

/// Whether a process is there and not a zombie.
pub fn is_alive(pid: u32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    stat.rsplit_once(')').is_some_and(|(_, rest)| !rest.trim_start().starts_with('Z'))
}

/// Waits until something is so.
pub fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let end = Instant::now() + PATIENCE;
    while !is_so() {
        assert!(Instant::now() < end, "waited in vain until {what}");
        thread::sleep(Duration::from_millis(20));
    }
}
