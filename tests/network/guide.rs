//! The guide's chapter on three machines, on three hosts: each has a folder of its own with what the chapter says that a machine needs.

use super::hosts::{Hosts, are_possible};
use super::net::wait_until_gone;
use crate::front_door::blocks;
use crate::support::program::Program;
use crate::support::{Said, imrs, number, runtime_dir, signal};
use rustix::process::Signal;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

const NODES: [&str; 3] = ["feeding", "pressing", "watching"];

/// The cell of the chapter.
pub fn cell_of_the_chapter() -> String {
    let chapter = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/guide/three-machines.md");
    let chapter = fs::read_to_string(chapter).expect("the chapter");
    let blocks = blocks(&chapter);
    let block = blocks.iter().find(|block| block.kind == "cell line.cell").expect("its cell");
    block.lines.join("\n") + "\n"
}

/// The cell of the chapter, at the addresses of the hosts.
fn cell() -> String {
    let placed = |text: String, host: usize| {
        let loopback = format!("127.77.83.{}", host + 1);
        assert!(text.contains(&loopback), "{text}");
        text.replace(&loopback, &Hosts::address(host).to_string())
    };
    (0..NODES.len()).fold(cell_of_the_chapter(), placed)
}

/// A machine: the cell file, and the key file of its own node alone.
fn machine(own: &str, text: &str, keys: &Path) -> TempDir {
    let dir = runtime_dir();
    fs::write(dir.path().join("line.cell"), text).expect("the cell");
    let folder = dir.path().join("line.keys");
    fs::create_dir(&folder).expect("a folder");
    let file = format!("{own}.keys");
    fs::copy(keys.join(&file), folder.join(&file)).expect("its keys");
    dir
}

/// The command with these arguments, typed in this folder.
fn typed(folder: &TempDir, args: &[&str]) -> Program {
    let mut command = imrs(folder.path(), args);
    command.current_dir(folder.path());
    Program::start(command)
}

/// The three machines of the chapter, and the desk at which the keys are made and the reports are collected.
struct Site {
    hosts: Hosts,
    desk: TempDir,
    machines: [TempDir; 3],
}

impl Site {
    fn new() -> Self {
        let (hosts, text, desk) = (Hosts::new(NODES.len(), 1), cell(), runtime_dir());
        fs::write(desk.path().join("line.cell"), &text).expect("the cell");
        let made = typed(&desk, &["keygen", "line.cell"]).finish();
        assert_eq!(made.code, Some(0), "{made:?}");
        let machines = NODES.map(|node| machine(node, &text, &desk.path().join("line.keys")));
        Self { hosts, desk, machines }
    }

    /// Types a command on the machine of a node.
    fn on(&self, node: &str, args: &[&str]) -> Program {
        let host = NODES.iter().position(|other| *other == node).expect("a node");
        self.hosts.on(host, || typed(&self.machines[host], args))
    }

    /// Starts a node as the chapter does.
    fn start(&self, node: &str) -> Program {
        self.on(node, &["run", "line.cell", "--node", node, "--report", &format!("{node}.json")])
    }

    /// The number of the last incarnation of `watching`, as its machine keeps it.
    fn incarnation(&self) -> String {
        let file = self.machines[2].path().join("state/imrs/line/watching.life");
        fs::read_to_string(file).expect("its file").trim().to_owned()
    }

    /// Copies the reports of all machines to the desk. Returns what `imrs summary` says of them.
    fn summary(&self) -> Said {
        let files = NODES.map(|node| format!("{node}.json"));
        for (file, machine) in files.iter().zip(&self.machines) {
            fs::copy(machine.path().join(file), self.desk.path().join(file)).expect("its report");
        }
        let [a, b, c] = files.each_ref().map(String::as_str);
        typed(&self.desk, &["summary", "line.cell", a, b, c, "--format", "json"]).finish()
    }
}

#[test]
fn the_guide_s_cell_runs_on_three_machines_and_gives_one_summary() {
    if !are_possible() {
        return;
    }
    let site = Site::new();
    let [feeding, pressing, mut watching] = NODES.map(|node| site.start(node));
    let [feeding, pressing] = [feeding, pressing].map(Program::finish);
    // The panel serves for ever.
    watching.read_until(|line| line.contains("node pressing has stopped in order"));
    watching.interrupt();
    let said: [Said; 3] = [feeding, pressing, watching.finish()];
    assert!(said.iter().all(|said| said.code == Some(0)), "{said:?}");
    let whole = site.summary();
    assert_eq!(whole.code, Some(0), "{whole:?}");
    let whole = whole.last_json();
    let meet = &whole["rendezvous"][0];
    assert_eq!((number(&meet["released"]), number(&meet["false_releases"])), (1, 0), "{whole}");
    let part = &whole["ports"][1];
    assert_eq!((part["name"].as_str(), number(&part["delivered"])), (Some("part"), 6), "{whole}");
    let measured = |node: &serde_json::Value| node["links"].as_array().is_some_and(|links| !links.is_empty());
    let nodes = whole["nodes"].as_array().expect("nodes");
    assert!(nodes.len() == 3 && nodes.iter().all(measured), "{whole}");
}

/// The chapter's section on a second start: the panel's machine loses its power while parts come.
#[test]
fn a_machine_of_the_guide_starts_again_in_its_next_incarnation() {
    if !are_possible() {
        return;
    }
    let site = Site::new();
    let [feeding, pressing, mut watching] = NODES.map(|node| site.start(node));
    let mut pid = None;
    watching.read_until(|line| {
        let named =
            line.split_once(" pid ").and_then(|(_, rest)| rest.split_whitespace().next()?.parse().ok());
        pid = pid.or(named);
        line.contains("begins show")
    });
    let pid: u32 = pid.expect("the node names its process");
    assert_eq!(site.incarnation(), "0");
    // Neither the node nor its launcher says goodbye.
    for pid in [watching.pid(), pid] {
        signal(pid, Signal::KILL);
    }
    drop(watching);
    wait_until_gone(pid);
    let mut again = site.start("watching");
    again.read_until(|line| line.contains("held back "));
    assert_eq!(site.incarnation(), "1");
    let [feeding, pressing] = [feeding, pressing].map(Program::finish);
    again.interrupt();
    let said: [Said; 3] = [feeding, pressing, again.finish()];
    assert!(said.iter().all(|said| said.code == Some(0)), "{said:?}");
    assert!(said[0].out.contains("robot line 22  finished"), "{said:?}");
    assert!(said[1].out.contains("press line 41  finished"), "{said:?}");
    // No neighbour is there any more. So the node goes on with its file.
    let alone = site.on("watching", &["run", "line.cell", "--node", "watching", "--for", "3s"]).finish();
    let words = "node watching: no neighbour said within 1 s which incarnation it remembers; this is 2";
    assert!(alone.code == Some(0) && format!("{}{}", alone.out, alone.err).contains(words), "{alone:?}");
    assert_eq!(site.incarnation(), "2");
}

/// The chapter's sections on an old file and on keys: two machines that do not fit refuse each other by name.
#[test]
fn machines_of_the_guide_that_do_not_fit_refuse_each_other_by_name() {
    if !are_possible() {
        return;
    }
    let site = Site::new();
    let old: String =
        cell().lines().filter(|line| !line.contains("run show")).map(|line| format!("{line}\n")).collect();
    let other: String = cell().replace("time_out = 1 sec", "time_out = 2 sec");
    for (file, text) in [("old.cell", &old), ("other.cell", &other)] {
        fs::write(site.machines[2].path().join(file), text).expect("the cell");
    }
    let without = site.on("watching", &["run", "old.cell", "--node", "watching"]).finish();
    let words = ["node `watching` has no keys", "Type `imrs keygen old.cell` once"];
    assert!(without.code == Some(2) && words.iter().all(|words| without.err.contains(words)), "{without:?}");
    let keys = ["--keys", "line.keys"];
    let cases: [(&str, &[&str], &str); 3] = [
        ("old.cell", &keys, "their statements differ (digest "),
        // The chapter's exercise.
        ("other.cell", &keys, "their declarations differ (digest "),
        ("line.cell", &["--insecure"], "one of them has keys and the other has none"),
    ];
    for (file, args, words) in cases {
        let args = [&["run", file, "--node", "watching"], args].concat();
        let both = [("watching", &args[..]), ("pressing", &["run", "line.cell", "--node", "pressing"])];
        let both = both.map(|(node, args)| site.on(node, args));
        let both = both.map(|mut node| {
            node.read_until(|line| line.contains("do not talk"));
            node
        });
        for node in both {
            node.interrupt();
            let said = node.finish();
            let all = format!("{}{}", said.out, said.err);
            let line = all.lines().find(|line| line.contains("do not talk")).unwrap_or_default();
            assert!(line.contains(words) && said.code == Some(1), "{file}: {said:?}");
        }
    }
}
