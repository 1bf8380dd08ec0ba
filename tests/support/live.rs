//! Helpers that start nodes in processes of their own and watch them through a monitor.

use super::program::Program;
use super::{PATIENCE, example, imrs, is_alive, replays, runtime_dir};
use serde_json::Value;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Instant;
use tempfile::TempDir;

/// A running node, as the launcher describes it.
#[derive(Clone, Debug)]
pub struct Node {
    pub name: String,
    pub pid: u32,
    pub address: Option<SocketAddr>,
    /// The TCP address at which the node serves monitors.
    pub observe: Option<SocketAddr>,
}

/// The nodes of a running cell.
pub struct Live {
    dir: PathBuf,
    /// The launcher, dropped before its folder is removed.
    program: Program,
    /// The file name for the recordings, and the cell file if one was given. The recordings are replayed after the
    /// nodes have ended.
    record: Option<(PathBuf, Option<String>)>,
    pub nodes: Vec<Node>,
    _own: Option<TempDir>,
}

impl Live {
    /// Starts `imrs run` or `imrs demo` in this runtime folder, with these arguments and `--format json`. Waits until
    /// the nodes run.
    pub fn start(dir: &Path, args: &[&str]) -> Self {
        let record = args.iter().position(|arg| *arg == "--record").map(|at| {
            let cell = (args[0] == "run").then(|| args[1].to_owned());
            (PathBuf::from(args[at + 1]), cell)
        });
        let mut program = Program::start(imrs(dir, &[args, &["--format", "json"]].concat()));
        let started = program.json();
        let address = |text: &Value| text.as_str().map(|address| address.parse().expect("an address"));
        let node = |node: &Value| Node {
            name: node["name"].as_str().expect("a name").to_owned(),
            pid: u32::try_from(node["pid"].as_u64().expect("a process")).expect("32 bits"),
            address: address(&node["address"]),
            observe: address(&node["observe"]),
        };
        let nodes = started["started"].as_array().expect("nodes").iter().map(node).collect();
        Self { dir: dir.to_owned(), program, record, nodes, _own: None }
    }

    /// Starts `imrs demo beam-lift` with these arguments in a runtime folder of its own. The demo is always recorded,
    /// so that its run can be replayed.
    pub fn demo(args: &[&str]) -> Self {
        let dir = runtime_dir();
        let record = dir.path().join("own.imrs");
        let own = ["--record", record.to_str().expect("UTF-8")];
        let own = if args.contains(&"--record") { &[][..] } else { &own };
        let live = Self::start(dir.path(), &[&["demo", "beam-lift"], own, args].concat());
        assert_eq!(live.nodes.len(), 3, "{:?}", live.nodes);
        Self { _own: Some(dir), ..live }
    }

    /// Starts the demo's cell in a runtime folder of its own. Its tasks never give up, as [`Self::steady_in`] explains.
    pub fn steady() -> Self {
        Self::steady_with(&[])
    }

    /// Does the same as [`Self::steady`], with these additional arguments.
    pub fn steady_with(args: &[&str]) -> Self {
        let dir = runtime_dir();
        let live = Self::steady_in(dir.path(), args);
        Self { _own: Some(dir), ..live }
    }

    /// Starts the demo's cell with these arguments in this runtime folder. The tasks never give up, even if a busy
    /// machine or a dead node makes them wait long at the rendezvous. The run is recorded.
    pub fn steady_in(dir: &Path, args: &[&str]) -> Self {
        let (file, record) = (dir.join("beam_lift.cell"), dir.join("own.imrs"));
        let cell = std::fs::read_to_string(example("beam_lift.cell")).expect("an example");
        let patient = cell.replace("time_out = 2 sec", "time_out = 2000 sec");
        assert_ne!(patient, cell, "it gives up after 2 sec");
        std::fs::write(&file, patient).expect("the cell is written");
        let [file, record] = [&file, &record].map(|path| path.to_str().expect("UTF-8"));
        let own = ["--record", record];
        let own = if args.contains(&"--record") { &[][..] } else { &own };
        let live = Self::start(dir, &[&["run", file, "--for", "10m"], own, args].concat());
        assert_eq!(live.nodes.len(), 3, "{:?}", live.nodes);
        live
    }

    /// The runtime folder.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// The process id of the launcher.
    pub fn launcher(&self) -> u32 {
        self.program.pid()
    }

    pub fn node(&self, name: &str) -> &Node {
        self.nodes.iter().find(|node| node.name == name).expect("a node of the cell")
    }

    /// The process id of a node.
    pub fn pid(&self, node: &str) -> u32 {
        self.node(node).pid
    }

    /// The UDP address of a node.
    pub fn address(&self, node: &str) -> SocketAddr {
        self.node(node).address.expect("a node with a socket")
    }

    /// Waits until `is_so` accepts a monitor's sample, or the run ends by itself. Returns the last sample; `Null` if
    /// there was none.
    pub fn until(&self, what: &str, mut is_so: impl FnMut(&Value) -> bool) -> Value {
        let (end, mut seen, mut last) = (Instant::now() + PATIENCE, Seen::by_monitor(&self.dir), Value::Null);
        loop {
            let is_over = !is_alive(self.launcher());
            match seen.next() {
                Some(sample) if is_so(&sample) => return sample,
                Some(sample) => last = sample,
                // A monitor ends when no node runs any more. The launcher ends some time later.
                None => {}
            }
            if is_over {
                return last;
            }
            assert!(Instant::now() < end, "waited in vain until {what}: {last}");
        }
    }

    /// Ends the run in the normal way, with SIGINT, as Ctrl-C does.
    pub fn interrupt(&self) {
        self.program.interrupt();
    }

    /// Waits for the end of the run. Returns the run's summary, its exit code, and its complaints.
    pub fn finish(self) -> (Value, Option<i32>, String) {
        let said = self.program.finish();
        if let Some((file, cell)) = &self.record
            && matches!(said.code, Some(0 | 1 | 5))
        {
            replays(&self.dir, file, cell.as_deref());
        }
        (said.last_json(), said.code, said.err)
    }
}

/// The samples that a monitor prints.
pub struct Seen {
    dir: PathBuf,
    monitor: Program,
}

impl Seen {
    /// Starts a monitor of the nodes in this runtime folder.
    pub fn by_monitor(dir: &Path) -> Self {
        Self { dir: dir.to_owned(), monitor: Self::monitor(dir) }
    }

    fn monitor(dir: &Path) -> Program {
        Program::start(imrs(dir, &["monitor", "--watch", "50ms", "--format", "json"]))
    }

    /// The next sample. A monitor gives up if it finds no node for some seconds. On a busy machine a node may appear
    /// later, so another monitor is then started.
    pub fn sample(&mut self) -> Value {
        let end = Instant::now() + PATIENCE;
        loop {
            if let Some(sample) = self.next() {
                return sample;
            }
            assert!(Instant::now() < end, "no monitor finds a node in {}", self.dir.display());
        }
    }

    /// The next sample; `None` if this monitor has ended. The caller then starts another one.
    fn next(&mut self) -> Option<Value> {
        let sample = self.monitor.next_json();
        if sample.is_none() {
            self.monitor = Self::monitor(&self.dir);
        }
        sample
    }

    /// The first sample that `is_so` accepts.
    pub fn until(&mut self, what: &str, mut is_so: impl FnMut(&Value) -> bool) -> Value {
        let end = Instant::now() + PATIENCE;
        loop {
            let sample = self.sample();
            if is_so(&sample) {
                return sample;
            }
            assert!(Instant::now() < end, "waited in vain until {what}: {sample}");
        }
    }
}

/// The first entry of a JSON array with this name; `Null` if there is none.
pub fn named<'a>(all: &'a Value, name: &str) -> &'a Value {
    let mut all = all.as_array().into_iter().flatten();
    all.find(|one| one["name"] == name).unwrap_or(&Value::Null)
}

/// A task in a sample; `Null` if the sample does not contain it.
pub fn task<'a>(sample: &'a Value, name: &str) -> &'a Value {
    let nodes = sample["nodes"].as_array().into_iter().flatten();
    nodes.map(|node| named(&node["tasks"], name)).find(|task| !task.is_null()).unwrap_or(&Value::Null)
}

/// A counter of a task's port in a sample; 0 if the sample does not contain it.
pub fn figure(sample: &Value, at: &str, port: &str, name: &str) -> u64 {
    named(&task(sample, at)["ports"], port)[name].as_u64().unwrap_or(0)
}

/// The number of the last waitfor round that released this task, according to a sample; 0 if no round did.
pub fn released(sample: &Value, at: &str) -> u64 {
    task(sample, at)["waitfor"][0]["released"].as_u64().unwrap_or(0)
}
