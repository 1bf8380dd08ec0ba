//! The guide's chapter on three machines, on three hosts: each has a folder of its own with what the chapter says that a machine needs.

use super::hosts::{Hosts, are_possible};
use crate::front_door::blocks;
use crate::support::program::Program;
use crate::support::{Said, imrs, number, runtime_dir};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

const NODES: [&str; 3] = ["feeding", "pressing", "watching"];

/// The cell of the chapter, at the addresses of the hosts.
fn cell() -> String {
    let chapter = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/guide/three-machines.md");
    let chapter = fs::read_to_string(chapter).expect("the chapter");
    let blocks = blocks(&chapter);
    let block = blocks.iter().find(|block| block.kind == "cell line.cell").expect("its cell");
    let placed = |text: String, host: usize| {
        let loopback = format!("127.77.83.{}", host + 1);
        assert!(text.contains(&loopback), "{text}");
        text.replace(&loopback, &Hosts::address(host).to_string())
    };
    (0..NODES.len()).fold(block.lines.join("\n") + "\n", placed)
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

#[test]
fn the_guide_s_cell_runs_on_three_machines_and_gives_one_summary() {
    if !are_possible() {
        return;
    }
    let (hosts, text, desk) = (Hosts::new(NODES.len(), 1), cell(), runtime_dir());
    fs::write(desk.path().join("line.cell"), &text).expect("the cell");
    let made = typed(&desk, &["keygen", "line.cell"]).finish();
    assert_eq!(made.code, Some(0), "{made:?}");
    let machines = NODES.map(|node| machine(node, &text, &desk.path().join("line.keys")));
    let start = |host: usize| {
        let report = format!("{}.json", NODES[host]);
        let args = ["run", "line.cell", "--node", NODES[host], "--report", &report];
        hosts.on(host, || typed(&machines[host], &args))
    };
    let [feeding, pressing, watching] = [0, 1, 2].map(start);
    let [feeding, pressing] = [feeding, pressing].map(Program::finish);
    // The panel serves for ever.
    watching.interrupt();
    let said: [Said; 3] = [feeding, pressing, watching.finish()];
    assert!(said.iter().all(|said| said.code == Some(0)), "{said:?}");

    for (node, machine) in NODES.iter().zip(&machines) {
        let report = format!("{node}.json");
        fs::copy(machine.path().join(&report), desk.path().join(&report)).expect("its report");
    }
    let files = NODES.map(|node| format!("{node}.json"));
    let [a, b, c] = files.each_ref().map(String::as_str);
    let whole = typed(&desk, &["summary", "line.cell", a, b, c, "--format", "json"]).finish();
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
