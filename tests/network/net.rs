//! Runs a cell with one node on each host, as on separate machines.

use super::evidence::{Evidence, evidence};
use super::hosts::Hosts;
use crate::support::live::Seen;
use crate::support::program::Program;
use crate::support::{Said, imrs, is_alive, replays, run_in, runtime_dir, signal, wait_until};
use rustix::process::Signal;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

/// The nodes of a cell on hosts.
pub struct Net {
    nodes: Vec<Up>,
    pub hosts: Hosts,
    pub cell: PathBuf,
    /// The names of the cell's nodes. The node at position `i` runs on host `i`.
    pub names: &'static [&'static str],
    /// How often each node was started.
    starts: Vec<usize>,
    /// The recordings of all starts of nodes, each with its host.
    recordings: Vec<(usize, PathBuf)>,
    /// Why the model cannot follow the recordings, if that is known beforehand.
    pub not_followed: Option<&'static str>,
    /// A change that is made to the recordings of a host before they are judged.
    prepare: Option<(usize, Prepare)>,
    pub dir: TempDir,
}

/// Changes a recording.
type Prepare = fn(&Path);

/// A running node.
struct Up {
    host: usize,
    program: Option<Program>,
    /// The id of the node's own process. The process of `program` is the node's launcher.
    pid: u32,
}

impl Drop for Up {
    fn drop(&mut self) {
        // A stopped process does not notice that its launcher is gone, so it is killed.
        signal(self.pid, Signal::KILL);
    }
}

/// How a node is started.
#[derive(Clone, Debug, Default)]
pub struct How {
    /// A command, with its first arguments, that runs the node's command. Empty: the node's command runs directly.
    pub under: Vec<String>,
    /// Further arguments of the node's command.
    pub args: Vec<String>,
    /// The cell file, if this node has another one than the other nodes.
    pub cell: Option<PathBuf>,
    /// The file into which the node records, if the recording is moved to its usual place later.
    pub record: Option<PathBuf>,
    pub is_unrecorded: bool,
    /// Whether the node prints text instead of JSON.
    pub is_text: bool,
}

/// The end of a run.
pub struct Ended {
    /// For each start of a node, in the order in which the starts ended: the host, and the output, whose last line is
    /// the summary.
    pub said: Vec<(usize, Said)>,
    pub evidence: Evidence,
    /// The answer of `imrs replay --model` about all recordings together.
    pub model: Value,
    /// The folder of the run, which is removed with this value.
    pub dir: TempDir,
}

impl Drop for Ended {
    /// The recordings of a run that failed a check are kept, because the same faults may not come again.
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("the recordings are kept in {}", self.dir.path().display());
            self.dir.disable_cleanup(true);
        }
    }
}

impl Net {
    /// Makes hosts for the nodes of a cell, and keys for the nodes. Starts no node.
    pub fn new(text: &str, names: &'static [&'static str], seed: u64) -> Self {
        Self::on(Hosts::new(names.len(), seed), text, names)
    }

    /// Makes keys for the nodes of a cell. There may be more hosts than nodes.
    pub fn on(hosts: Hosts, text: &str, names: &'static [&'static str]) -> Self {
        let dir = runtime_dir();
        let cell = dir.path().join("own.cell");
        std::fs::write(&cell, text).expect("the cell is written");
        let net = Self {
            nodes: Vec::new(),
            hosts,
            cell,
            names,
            starts: vec![0; names.len()],
            recordings: Vec::new(),
            not_followed: None,
            prepare: None,
            dir,
        };
        let made = run_in(net.dir.path(), &["keygen", net.cell()]);
        assert_eq!(made.code, Some(0), "{made:?}");
        net
    }

    /// Makes hosts for a cell, and starts all its nodes.
    pub fn started(text: &str, names: &'static [&'static str], seed: u64) -> Self {
        let mut net = Self::new(text, names, seed);
        net.start_all(&How::default());
        net
    }

    pub fn start_all(&mut self, how: &How) {
        // Node `a` begins last, because its commands are counted.
        let programs: Vec<_> =
            (0..self.names.len()).rev().map(|host| (host, self.launch(host, how))).collect();
        programs.into_iter().for_each(|(host, program)| self.add(host, program));
    }

    /// Starts the node of this host, and waits until it runs.
    pub fn start(&mut self, host: usize, how: &How) {
        let program = self.launch(host, how);
        self.add(host, program);
    }

    fn cell(&self) -> &str {
        self.cell.to_str().expect("UTF-8")
    }

    /// Starts the node of this host, without reading its output.
    pub fn launch(&mut self, host: usize, how: &How) -> Program {
        self.starts[host] += 1;
        let name = self.names[host];
        let record = self.dir.path().join(format!("start-{}.imrs", self.starts[host]));
        let own = record.with_extension(format!("{name}.imrs"));
        let record = how.record.clone().unwrap_or(record);
        let keys = self.cell.with_extension("keys");
        let cell = how.cell.as_ref().unwrap_or(&self.cell);
        let [cell, keys, record] = [cell, &keys, &record].map(|path| path.to_str().expect("UTF-8"));
        let format = if how.is_text { "text" } else { "json" };
        let args = ["run", cell, "--node", name, "--keys", keys, "--for", "10m", "--format", format];
        let more: Vec<&str> = how.args.iter().map(String::as_str).collect();
        let recorded = if how.is_unrecorded { &[][..] } else { &["--record", record] };
        let plain = imrs(self.dir.path(), &[&args[..], recorded, &more[..]].concat());
        if !how.is_unrecorded {
            self.recordings.push((host, own));
        }
        let command = match how.under.split_first() {
            None => plain,
            Some((program, first)) => {
                let mut command = Command::new(program);
                command.args(first).arg(plain.get_program()).args(plain.get_args());
                command.envs(plain.get_envs().filter_map(|(name, value)| Some((name, value?))));
                command
            }
        };
        self.hosts.on(host, || Program::start(command))
    }

    fn add(&mut self, host: usize, mut program: Program) {
        let started = program.json();
        let pid = started["started"][0]["pid"].as_u64().and_then(|pid| u32::try_from(pid).ok());
        let pid = pid.unwrap_or_else(|| panic!("no node started: {started}"));
        self.nodes.push(Up { host, program: Some(program), pid });
    }

    /// The process of the node on this host.
    pub fn pid(&self, host: usize) -> u32 {
        self.nodes.iter().rev().find(|node| node.host == host).expect("it runs").pid
    }

    /// Kills the node on this host and its launcher, as a power cut does.
    pub fn kill(&mut self, host: usize) {
        let at = self.nodes.iter().position(|node| node.host == host).expect("it runs");
        let node = self.nodes.remove(at);
        node.program.iter().for_each(|launcher| signal(launcher.pid(), Signal::KILL));
        signal(node.pid, Signal::KILL);
        wait_until_gone(node.pid);
    }

    /// Stops the node on this host in order. Returns its output.
    pub fn stop(&mut self, host: usize) -> Said {
        let at = self.nodes.iter().position(|node| node.host == host).expect("it runs");
        let node = self.nodes.remove(at);
        node.interrupt();
        node.finish()
    }

    /// Waits until `is_so` accepts a monitor's sample of the nodes.
    pub fn until(&self, what: &str, is_so: impl FnMut(&Value) -> bool) -> Value {
        Seen::by_monitor(self.dir.path()).until(what, is_so)
    }

    /// Changes the recordings of a host before they are judged.
    pub fn before_judging(&mut self, host: usize, prepare: Prepare) {
        self.prepare = Some((host, prepare));
    }

    /// Stops all nodes, and judges all recordings.
    pub fn finish(mut self) -> Ended {
        let nodes = std::mem::take(&mut self.nodes);
        nodes.iter().for_each(|node| node.interrupt());
        let said: Vec<(usize, Said)> = nodes.into_iter().map(|node| (node.host, node.finish())).collect();
        let recordings = std::mem::take(&mut self.recordings);
        if let Some((host, prepare)) = self.prepare {
            recordings.iter().filter(|(of, _)| *of == host).for_each(|(_, file)| prepare(file));
        }
        let files: Vec<PathBuf> = recordings.into_iter().map(|(_, file)| file).collect();
        let model = match self.not_followed {
            Some(why) => serde_json::json!({ "unknown": why }),
            None => self.model(&files),
        };
        for number in 1..=*self.starts.iter().max().expect("hosts") {
            replays(
                self.dir.path(),
                &self.dir.path().join(format!("start-{number}.imrs")),
                Some(self.cell()),
            );
        }
        Ended { said, evidence: evidence(&self.cell, &files), model, dir: self.dir }
    }

    /// Replays all recordings, each by itself.
    pub fn replay(&self) {
        for number in 1..=*self.starts.iter().max().expect("hosts") {
            let file = self.dir.path().join(format!("start-{number}.imrs"));
            replays(self.dir.path(), &file, Some(self.cell()));
        }
    }

    /// The answer of `imrs replay --model` about these recordings.
    fn model(&self, files: &[PathBuf]) -> Value {
        let files: Vec<&str> = files.iter().map(|file| file.to_str().expect("UTF-8")).collect();
        let told = |within: &str| {
            let how = ["--cell", self.cell(), "--model", "--within", within, "--format", "json"];
            let said = run_in(self.dir.path(), &[&["replay"], &files[..], &how[..]].concat());
            assert!(matches!(said.code, Some(0 | 1 | 4 | 5)), "{said:?}");
            said.last_json()
        };
        // This time limit also bounds random walks through the model, which say nothing about these runs.
        let first = told("1s");
        if first["ended_by"].is_null() { first } else { told("60s") }
    }
}

impl Up {
    /// Ends the node in the normal way. The process that the test started may be a command that runs the launcher, so
    /// the signal goes to the launcher itself.
    fn interrupt(&self) {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.pid)).unwrap_or_default();
        let parent = stat.rsplit_once(')').and_then(|(_, rest)| rest.split_whitespace().nth(1)?.parse().ok());
        parent.into_iter().for_each(|launcher| signal(launcher, Signal::INT));
    }

    /// Waits for the end of the node. No second interrupt is sent, because it would make the launcher wait no longer
    /// for the node.
    fn finish(mut self) -> Said {
        self.program.take().expect("a program").finish()
    }
}

/// Waits until a killed node has left its port and the lock of its state. The threads of a killed process end one by one, and only the
/// last one leaves them.
pub fn wait_until_gone(pid: u32) {
    let threads = || std::fs::read_dir(format!("/proc/{pid}/task")).map_or(0, Iterator::count);
    wait_until("the node is gone", || !is_alive(pid) && threads() <= 1);
}
