//! A cell that runs, and a monitor that watches it.

use crate::support::{imrs, runtime_dir};
use serde_json::Value;
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Read};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// What is promised of a machine that is quiet; asserted where `IMRS_QUIET=1` says that this one is.
const GOAL: Duration = Duration::from_secs(2);
/// No fault takes longer to be seen, however busy the machine is.
pub const LONG: Duration = Duration::from_secs(30);
/// How often the monitor prints.
const EVERY: &str = "100ms";
/// How long after its lint nothing unrelated may follow.
const AFTER: Duration = Duration::from_secs(1);
/// What a busy machine does by itself.
pub const AMBIENT: &[&str] = &[];

/// One sample: when it came, and the codes of what was found.
pub struct Sample {
    at: Instant,
    pub codes: BTreeSet<String>,
    line: String,
}

/// A program whose lines are read as they come, ended with this.
pub struct Program {
    pub child: Child,
    lines: Receiver<(Instant, String)>,
    errors: thread::JoinHandle<String>,
}

impl Program {
    fn start(mut command: Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
        let (out, mut err) = (child.stdout.take().expect("a pipe"), child.stderr.take().expect("a pipe"));
        let (sender, lines) = mpsc::channel();
        thread::spawn(move || {
            for line in BufReader::new(out).lines().map_while(Result::ok) {
                if sender.send((Instant::now(), line)).is_err() {
                    return;
                }
            }
        });
        let errors = thread::spawn(move || {
            let mut text = String::new();
            let _ = err.read_to_string(&mut text);
            text
        });
        Self { child, lines, errors }
    }

    fn line(&mut self) -> (Instant, String) {
        match self.lines.recv_timeout(LONG) {
            Ok(line) => line,
            Err(_) => {
                let _ = self.child.kill();
                let errors = std::mem::replace(&mut self.errors, thread::spawn(String::new));
                panic!("it said nothing more: {:?}", errors.join());
            }
        }
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A node, as the launcher tells of it.
pub struct Node {
    name: String,
    pub pid: u32,
    pub address: SocketAddr,
}

/// A cell that runs, and a monitor that watches it.
pub struct Scene {
    pub monitor: Program,
    /// Ended after the monitor.
    _cells: Vec<Program>,
    pub nodes: Vec<Node>,
    /// When the nodes of the last cell had started.
    pub started: Instant,
    _dir: TempDir,
}

impl Scene {
    pub fn start(text: &str, args: &[&str]) -> Self {
        Self::of(&[(text, args)])
    }

    /// Cells that run in one folder.
    pub fn of(cells: &[(&str, &[&str])]) -> Self {
        let dir = runtime_dir();
        let (mut started, mut nodes, mut programs) = (Instant::now(), Vec::new(), Vec::new());
        for (number, (text, args)) in cells.iter().enumerate() {
            let file = dir.path().join(format!("{number}.cell"));
            std::fs::write(&file, text).expect("the cell is written");
            let mut program = Program::start(launch(dir.path(), &file, args));
            let (at, line) = program.line();
            started = at;
            nodes.extend(told(&line));
            programs.push(program);
        }
        let all = nodes.len();
        Self::seen(dir, programs, nodes, started, all)
    }

    /// Nodes that others have started in this folder: so many.
    pub fn watching(dir: TempDir, nodes: usize) -> Self {
        Self::seen(dir, Vec::new(), Vec::new(), Instant::now(), nodes)
    }

    fn seen(dir: TempDir, cells: Vec<Program>, nodes: Vec<Node>, started: Instant, all: usize) -> Self {
        let monitor = Program::start(imrs(dir.path(), &["monitor", "--watch", EVERY, "--format", "json"]));
        let mut scene = Self { monitor, _cells: cells, nodes, started, _dir: dir };
        let end = Instant::now() + LONG;
        let up = |report: Value| {
            report["nodes"].as_array().map_or(0, |nodes| nodes.iter().filter(|n| n["up"] == true).count())
        };
        while up(scene.report()) < all {
            assert!(Instant::now() < end, "the nodes never showed themselves");
        }
        scene
    }

    pub fn node(&self, name: &str) -> &Node {
        self.nodes.iter().find(|node| node.name == name).expect("a node of the cell")
    }

    pub fn report(&mut self) -> Value {
        let (_, line) = self.monitor.line();
        serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: {line}"))
    }

    pub fn sample(&mut self) -> Sample {
        let (at, line) = self.monitor.line();
        let report: Value = serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: {line}"));
        let found = report["findings"].as_array().expect("findings");
        let codes = found.iter().map(|f| f["code"].as_str().expect("a code").to_owned()).collect();
        Sample { at, codes, line: report["findings"].to_string() }
    }

    /// Nothing is found for so long.
    pub fn is_calm_for(&mut self, length: Duration) {
        let end = Instant::now() + length;
        loop {
            let sample = self.sample();
            let unexpected = sample.codes.iter().find(|code| !AMBIENT.contains(&code.as_str()));
            assert!(unexpected.is_none(), "found where all is well: {}", sample.line);
            if sample.at >= end {
                return;
            }
        }
    }

    /// What happened at `since` raises `lint`, and until then and a little longer nothing but that and its `consequences`.
    pub fn raises(&mut self, since: Instant, lint: &str, consequences: &[&str]) {
        let mut seen = None;
        loop {
            let sample = self.sample();
            let related = |code: &&String| {
                *code == lint || consequences.contains(&code.as_str()) || AMBIENT.contains(&code.as_str())
            };
            let unrelated = sample.codes.iter().find(|code| !related(code));
            assert!(unrelated.is_none(), "{unrelated:?} has nothing to do with {lint}: {}", sample.line);
            if seen.is_none() && sample.codes.contains(lint) {
                seen = Some(sample.at);
            }
            let now = sample.at;
            match seen {
                Some(at) if now >= at + AFTER => break,
                Some(_) => {}
                None => assert!(now < since + LONG, "{lint} was never raised; last: {}", sample.line),
            }
        }
        let took = seen.expect("seen").saturating_duration_since(since);
        println!("{lint}: raised after {took:?}; goal {GOAL:?}");
        let quiet = std::env::var_os("IMRS_QUIET").is_some_and(|value| value == "1");
        assert!(!quiet || took <= GOAL, "{lint}: raised after {took:?}");
    }
}

fn launch(dir: &Path, file: &Path, args: &[&str]) -> Command {
    let file = file.to_str().expect("UTF-8");
    imrs(dir, &[&["run", file, "--for", "10m", "--format", "json", "--seed", "1"], args].concat())
}

/// The nodes that the launcher says it has started.
fn told(line: &str) -> Vec<Node> {
    let started: Value = serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"));
    let node = |node: &Value| Node {
        name: node["name"].as_str().expect("a name").to_owned(),
        pid: u32::try_from(node["pid"].as_u64().expect("a process")).expect("32 bits"),
        address: node["address"].as_str().and_then(|a| a.parse().ok()).expect("an address"),
    };
    started["started"].as_array().expect("nodes").iter().map(node).collect()
}
