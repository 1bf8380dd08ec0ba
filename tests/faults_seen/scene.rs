//! A running cell, and a monitor that watches it.

use super::starved::Starved;
use crate::support::live::{Live, Node};
use crate::support::program::Program;
use crate::support::stub::{Stub, Tells};
use crate::support::{PATIENCE, excused, imrs, is_quiet, runtime_dir, signal};
use rustix::process::Signal;
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// The promised delay of a finding on a quiet machine. It is asserted if `IMRS_QUIET=1` says that this machine is quiet.
const GOAL: Duration = Duration::from_secs(2);
/// How long any finding may take, however busy the machine is.
pub const LONG: Duration = PATIENCE;
/// The time between two samples of the monitor.
const EVERY: &str = "100ms";
/// For this long after the expected finding, no unrelated finding may come.
const AFTER: Duration = Duration::from_secs(1);

/// One sample of the monitor: when it came, and the codes of its findings.
pub struct Sample {
    at: Instant,
    pub codes: BTreeSet<String>,
    line: String,
}

impl Sample {
    /// Asserts that the sample has no findings except these codes.
    fn is_only(&self, expected: &[&str], why: &str) {
        let unrelated = self.codes.iter().find(|code| !expected.contains(&code.as_str()));
        assert!(unrelated.is_none(), "{unrelated:?} {why}: {}", self.line);
    }
}

/// A running cell, and a monitor that watches it.
pub struct Scene {
    pub monitor: Program,
    /// The launchers of the cells, which are dropped after the monitor.
    cells: Vec<Live>,
    starved: Starved,
    stub: Option<Stub>,
    /// When the nodes of the last cell had started.
    pub started: Instant,
    dir: TempDir,
}

impl Scene {
    pub fn start(text: &str, args: &[&str]) -> Self {
        Self::of(&[(text, args)])
    }

    /// Starts a cell whose action `go` ends on a call of [`go`](Self::go), so that the monitor sees everything that follows.
    pub fn waiting(text: &str) -> Self {
        let dir = runtime_dir();
        let wait = dir.path().join("wait");
        let script = format!("until [ -e {} ]; do sleep 0.05; done\n", dir.path().join("gone").display());
        std::fs::write(&wait, script).expect("the action is written");
        let action = format!("go=sh {}", wait.display());
        Self::within(dir, &[(text, &["--action", &action])])
    }

    /// Lets the action `go` end. Returns the instant at which it did so.
    pub fn go(&self) -> Instant {
        std::fs::write(self.dir.path().join("gone"), "").expect("a file");
        Instant::now()
    }

    /// Starts several cells in one folder.
    pub fn of(cells: &[(&str, &[&str])]) -> Self {
        Self::within(runtime_dir(), cells)
    }

    fn within(dir: TempDir, cells: &[(&str, &[&str])]) -> Self {
        let start = |(number, (text, args)): (usize, &(&str, &[&str]))| {
            let file = dir.path().join(format!("{number}.cell"));
            std::fs::write(&file, text).expect("the cell is written");
            let insecure = if args.contains(&"--node") { &["--insecure"][..] } else { &[] };
            let run = ["run", file.to_str().expect("UTF-8"), "--for", "10m", "--seed", "1"];
            Live::start(dir.path(), &[&run, *args, insecure].concat())
        };
        let cells: Vec<Live> = cells.iter().enumerate().map(start).collect();
        let (all, started) = (cells.iter().map(|cell| cell.nodes.len()).sum(), Instant::now());
        Self::seen(dir, cells, started, all)
    }

    /// Kills the node of this name, which has a launcher of its own. Returns the instant of the kill.
    pub fn kill(&mut self, name: &str) -> Instant {
        let at = self.place(name);
        signal(self.node(name).pid, Signal::KILL);
        let killed = Instant::now();
        let (_, code, errors) = self.cells.remove(at).finish();
        assert_eq!(code, Some(1), "{errors}");
        killed
    }

    /// Starts a node with a launcher of its own; a node that ran before gets its next incarnation.
    pub fn start_node(&mut self, text: &str, name: &str) {
        let file = self.dir.path().join("again.cell");
        std::fs::write(&file, text).expect("the cell is written");
        let args = ["run", file.to_str().expect("UTF-8"), "--for", "10m", "--insecure", "--node", name];
        self.cells.push(Live::start(self.dir.path(), &args));
    }

    fn place(&self, name: &str) -> usize {
        let has = |cell: &Live| cell.nodes.iter().any(|node| node.name == name);
        self.cells.iter().position(has).expect("a node of the cell")
    }

    /// Watches a stub node in this folder.
    pub fn watching(dir: TempDir, stub: Stub) -> Self {
        let mut scene = Self::seen(dir, Vec::new(), Instant::now(), 1);
        scene.starved.stub = Some(stub.beat.clone());
        Self { stub: Some(stub), ..scene }
    }

    /// Changes what the stub node reports: the change also gets the stub's clock. Returns the instant of the change.
    pub fn tell(&self, change: impl FnOnce(&mut Tells, u64)) -> Instant {
        let stub = self.stub.as_ref().expect("a stub node");
        let (since, now) = (Instant::now(), stub.mono_us());
        stub.change(|tells| change(tells, now));
        since
    }

    fn seen(dir: TempDir, cells: Vec<Live>, started: Instant, all: usize) -> Self {
        let monitor = Program::start(imrs(dir.path(), &["monitor", "--watch", EVERY, "--format", "json"]));
        let mut scene = Self { monitor, cells, starved: Starved::default(), stub: None, started, dir };
        let end = Instant::now() + LONG;
        let up = |report: Value| {
            report["nodes"].as_array().map_or(0, |nodes| nodes.iter().filter(|n| n["up"] == true).count())
        };
        while up(scene.report()) < all {
            assert!(Instant::now() < end, "the nodes never showed themselves");
        }
        scene
    }

    /// The folder of the nodes and the monitor.
    pub fn dir(&self) -> &Path {
        self.dir.path()
    }

    pub fn node(&self, name: &str) -> &Node {
        let mut nodes = self.cells.iter().flat_map(|cell| &cell.nodes);
        nodes.find(|node| node.name == name).expect("a node of the cell")
    }

    pub fn report(&mut self) -> Value {
        self.monitor.json()
    }

    /// The next sample, without findings about silent nodes if this machine keeps those nodes from reporting.
    pub fn sample(&mut self) -> Sample {
        let (at, report) = self.monitor.json_at();
        self.starved.look(at, &report);
        let found = report["findings"].as_array().expect("findings").iter();
        let is_starved = |f: &&Value| !is_quiet() && self.starved.now(&f["node"]);
        let found = found.filter(|f| f["code"] != "node-silent" || !is_starved(f));
        // A busy machine takes longer than the cells declare.
        let is_lateness = |f: &&Value| f["code"] == "link-late" || f["code"] == "link-near-bound";
        let found = found.filter(|f| is_quiet() || !is_lateness(f));
        let codes = found.map(|f| f["code"].as_str().expect("a code").to_owned()).collect();
        Sample { at, codes, line: report["findings"].to_string() }
    }

    /// Asserts that no finding comes for this long.
    pub fn is_calm_for(&mut self, length: Duration) {
        let end = Instant::now() + length;
        loop {
            let sample = self.sample();
            sample.is_only(&[], "was found where all is well");
            if sample.at >= end {
                return;
            }
        }
    }

    /// Waits until `none` accepts the codes of a sample, because the condition that caused them is over.
    pub fn is_over(&mut self, what: &str, none: impl Fn(&BTreeSet<String>) -> bool) {
        let end = Instant::now() + LONG;
        while !none(&self.sample().codes) {
            assert!(Instant::now() < end, "{what} for ever");
        }
    }

    /// Asserts that the fault at the instant `since` raises the finding `lint`. Until shortly afterwards there must be
    /// no findings but `lint` and its `consequences`.
    pub fn raises(&mut self, since: Instant, lint: &str, consequences: &[&str]) {
        let mut seen = None;
        let expected = [&[lint], consequences].concat();
        let unrelated = format!("has nothing to do with {lint}");
        loop {
            let sample = self.sample();
            sample.is_only(&expected, &unrelated);
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
        is_soon(lint, since, seen.expect("seen"));
    }

    /// Asserts that the short condition at the instant `since` raises the finding `lint` before the finding `end` is
    /// raised, unless the machine keeps the node from reporting in that time.
    pub fn raises_before(&mut self, since: Instant, lint: &str, end: &str, node: &str) {
        let give_up = since + LONG;
        loop {
            let sample = self.sample();
            sample.is_only(&[lint, end], "has nothing to do with it");
            if sample.codes.contains(lint) {
                return is_soon(lint, since, sample.at);
            }
            let is_over = sample.codes.contains(end) || sample.at > give_up;
            assert!(!is_over || self.starved.lately(node), "{lint} was never raised; last: {}", sample.line);
            if is_over {
                return excused(&format!("{lint} was never raised"));
            }
        }
    }
}

fn is_soon(lint: &str, since: Instant, seen: Instant) {
    let took = seen.saturating_duration_since(since);
    println!("{lint}: raised after {took:?}; goal {GOAL:?}");
    assert!(!is_quiet() || took <= GOAL, "{lint}: raised after {took:?}");
}
