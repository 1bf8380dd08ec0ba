//! What the end-to-end tests share: the command, bounded, in a runtime folder of its own.
#![allow(dead_code, reason = "every test binary uses a part of it")]

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use std::io::{BufRead, BufReader, Read};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// No command takes this long, however busy the machine is.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// A folder that only this test's nodes and monitors use.
pub fn runtime_dir() -> TempDir {
    // Unix sockets have short names: not under the build folder.
    tempfile::Builder::new().prefix("imrs-test").tempdir().expect("a folder for temporary files")
}

/// The command under test.
pub fn imrs(dir: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_imrs"));
    command.args(args).env("XDG_RUNTIME_DIR", dir).env_remove("NO_COLOR").env_remove("CLICOLOR_FORCE");
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

/// Whether a run ended well, or all that was wrong are checks that did not hold: this machine may have been later than the
/// cell declares, or the fault more than it does.
pub fn is_well(code: Option<i32>, errors: &str) -> bool {
    let mut lines = errors.lines().peekable();
    match code {
        Some(0) => true,
        Some(1) => lines.peek().is_some() && lines.all(|line| line.starts_with("imrs: check ")),
        Some(_) | None => false,
    }
}

impl Said {
    fn of(output: Output) -> Self {
        Self {
            out: String::from_utf8(output.stdout).expect("UTF-8"),
            err: String::from_utf8(output.stderr).expect("UTF-8"),
            code: output.status.code(),
        }
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
    let said = finish(imrs(dir, args));
    if let ["run", cell, ..] = args
        && let Some(at) = args.iter().position(|arg| *arg == "--record")
        && matches!(said.code, Some(0 | 1))
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
    assert_eq!(said.code, Some(0), "{said:?}");
    let answers = said.out.lines().map(|line| serde_json::from_str::<Value>(line).expect("JSON"));
    let tasks: Vec<Value> =
        answers.flat_map(|answer| answer["tasks"].as_array().expect("tasks").clone()).collect();
    // A disk that could not keep up is no fault of the machine: what is missing was told.
    let judged = |task: &&Value| task["verdict"] == "same" || number(&task["lost"]) > 0;
    assert!(!tasks.is_empty() && tasks.iter().filter(judged).count() == tasks.len(), "{tasks:?}");
}

fn number(value: &Value) -> u64 {
    value.as_u64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// Runs a command to its end.
pub fn finish(mut command: Command) -> Said {
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the command starts");
    let pid = child.id();
    let (done, ended) = mpsc::channel::<()>();
    let watchdog = thread::spawn(move || {
        if ended.recv_timeout(PATIENCE).is_err() {
            signal(pid, Signal::KILL);
        }
    });
    let output = child.wait_with_output().expect("the command's output");
    // The watchdog may have given up already: then the command was killed, and the test fails by what it said.
    let _ = done.send(());
    watchdog.join().expect("the watchdog");
    Said::of(output)
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

/// A running demo.
pub struct Demo {
    pub dir: TempDir,
    /// Where it records: every demo of a test is replayed when it is over.
    record: PathBuf,
    child: Child,
    lines: Receiver<String>,
    errors: Option<thread::JoinHandle<String>>,
    /// By node: name, process, address.
    pub nodes: Vec<(String, u32, SocketAddr)>,
}

impl Demo {
    /// Starts `imrs demo beam-lift --format json` with these arguments, and waits until its nodes run.
    pub fn start(args: &[&str]) -> Self {
        let dir = runtime_dir();
        let record = match args.iter().position(|arg| *arg == "--record") {
            Some(at) => PathBuf::from(args[at + 1]),
            None => dir.path().join("own.imrs"),
        };
        let own = ["--record", record.to_str().expect("UTF-8")];
        let own = if args.contains(&"--record") { &[][..] } else { &own };
        let all = [&["demo", "beam-lift", "--format", "json"], own, args].concat();
        let mut command = imrs(dir.path(), &all);
        let mut child =
            command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the demo starts");
        let (out, mut err) = (child.stdout.take().expect("a pipe"), child.stderr.take().expect("a pipe"));
        let (sender, lines) = mpsc::channel();
        thread::spawn(move || {
            for line in BufReader::new(out).lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        let errors = Some(thread::spawn(move || {
            let mut text = String::new();
            let _ = err.read_to_string(&mut text);
            text
        }));
        let mut demo = Self { dir, record, child, lines, errors, nodes: Vec::new() };
        let started: Value = serde_json::from_str(&demo.line()).expect("JSON");
        let node = |node: &Value| {
            let name = node["name"].as_str().expect("a name").to_owned();
            let pid = u32::try_from(node["pid"].as_u64().expect("a process")).expect("32 bits");
            (name, pid, node["address"].as_str().and_then(|a| a.parse().ok()).expect("an address"))
        };
        demo.nodes = started["started"].as_array().expect("nodes").iter().map(node).collect();
        assert_eq!(demo.nodes.len(), 3, "{started}");
        demo
    }

    fn line(&mut self) -> String {
        match self.lines.recv_timeout(PATIENCE) {
            Ok(line) => line,
            Err(_) => {
                // What it complained of can be read to its end only when it has ended.
                let _ = self.child.kill();
                let errors = self.errors.take().map(|thread| thread.join().unwrap_or_default());
                panic!("the demo said nothing more: {errors:?}");
            }
        }
    }

    /// The launcher's process.
    pub fn launcher(&self) -> u32 {
        self.child.id()
    }

    /// The process of a node.
    pub fn pid(&self, node: &str) -> u32 {
        self.nodes.iter().find(|(name, _, _)| name == node).expect("a node of the cell").1
    }

    /// The address of a node.
    pub fn address(&self, node: &str) -> SocketAddr {
        self.nodes.iter().find(|(name, _, _)| name == node).expect("a node of the cell").2
    }

    /// Waits for the end. Returns the summary, the exit code, and what it complained of.
    pub fn finish(mut self) -> (Value, Option<i32>, String) {
        let summary = self.line();
        let code = self.child.wait().expect("the demo ends").code();
        let errors = self.errors.take().map(|thread| thread.join().expect("its errors")).unwrap_or_default();
        if matches!(code, Some(0 | 1)) {
            replays(self.dir.path(), &self.record, None);
        }
        (serde_json::from_str(&summary).expect("JSON"), code, errors)
    }
}

impl Drop for Demo {
    fn drop(&mut self) {
        if let Ok(None) = self.child.try_wait() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}
