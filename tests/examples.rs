//! Every cell of `examples/` is checked, verified within the faults that it declares, and run.

use crate::support::live::Live;
use crate::support::{example, is_well, is_whole, run, runtime_dir, side_by_side, was_late};
use serde_json::Value;
use std::path::Path;

/// Cells with a task in Rust. Other tests run these.
const RUN_APART: [&str; 1] = ["extern_task"];

/// The names and files of the cells.
fn cells() -> Vec<(String, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples");
    let files = std::fs::read_dir(folder).expect("the examples").map(|entry| entry.expect("an entry").path());
    let cells = files.filter(|path| path.extension().is_some_and(|extension| extension == "cell"));
    let text = |part: &std::ffi::OsStr| part.to_str().expect("UTF-8").to_owned();
    let mut all: Vec<_> =
        cells.map(|path| (text(path.file_stem().expect("a name")), text(path.as_os_str()))).collect();
    all.sort();
    assert!(all.len() >= 6, "{all:?}");
    all
}

#[test]
fn every_cell_is_formatted() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples");
    let (mut folders, mut files) = (vec![folder], Vec::new());
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).expect("a folder of examples").flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "cell") {
                files.push(path.to_str().expect("UTF-8").to_owned());
            }
        }
    }
    // The cells are those of the folder `examples`, and of `classes`, `faulty`, `futures` and `rules` in it.
    assert!(files.len() >= 90, "only {} cells", files.len());
    files.sort();
    let files: Vec<&str> = files.iter().map(String::as_str).collect();
    let said = run(&[&["fmt", "--check"], &files[..]].concat());
    assert_eq!((said.code, said.out.as_str()), (Some(0), ""), "{said:?}");
}

/// Cells whose declared faults take half a minute to verify: the cell, these faults, and faults that take less time to
/// verify. With `IMRS_WHOLE=1` the declared faults are verified.
const FEWER: [(&str, &str, &str); 7] = [
    ("beam_lift", "faults loss 2;", "faults loss 1;"),
    ("beam_lift", "faults cut nl -- nr loss 1;", "faults cut nl -- nr;"),
    ("beam_lift", "faults crash hoist;", ""),
    // The checker's own tests verify this cell with all its faults.
    ("press_line", "faults crash n2;", ""),
    ("shared_tool", "faults loss 1 crash weldA;", "faults crash weldA;"),
    ("weld_cell", "faults loss 3;", "faults loss 1;"),
    ("weld_cell", "faults cut n1 -- nt loss 1;", "faults cut n1 -- nt;"),
];

#[test]
fn every_cell_holds_under_the_faults_that_it_declares() {
    let folder = runtime_dir();
    for (name, file) in &cells() {
        let said = run(&["check", file]);
        assert_eq!(said.code, Some(0), "{said:?}");
        assert!(!said.out.contains("warn[") && !said.out.contains("error["), "{said:?}");
        let looked_at = folder.path().join(format!("{name}.cell"));
        let mut text = std::fs::read_to_string(file).expect("the cell");
        for (_, declared, fewer) in FEWER.iter().filter(|(of, ..)| of == name && !is_whole()) {
            assert!(text.contains(declared), "{name}: {declared}");
            text = text.replace(declared, fewer);
        }
        std::fs::write(&looked_at, text).expect("written");
        let looked_at = looked_at.to_str().expect("UTF-8");
        // The limit is far more time than needed, because the machine may be busy.
        let said = run(&["verify", looked_at, "--within", "300s", "--format", "json"]);
        assert_eq!(said.code, Some(0), "{said:?}");
        let verdict = said.last_json();
        assert_eq!(verdict["complete"], true, "{name}: {verdict}");
        assert_eq!(verdict["findings"].as_array().map(Vec::len), Some(0), "{name}: {verdict}");
    }
}

/// A correct part of a cell's text, and the mistake that replaces it.
type Slip = (&'static str, &'static str);

const BORROWED_TOO_SHORT: Slip = ("start lent 4 sec", "start lent 2 sec");
const BORROWED_TOO_LONG: Slip = ("start lent 4 sec", "start lent 5 sec");
const ASKED_ONCE: Slip = ("time_out = 400 msec retry = 2", "time_out = 400 msec retry = 0");
const LET_GO: Slip = ("if held then", "if held or p.x > 5 then");
const TOO_SLOW: Slip = ("drop_into_box takes 320 msec", "drop_into_box takes 3 sec");
const ANY_VERSION: Slip = ("s.version = now.version and ", "");
const ANY_SPEED: Slip = (" and s.mm_s <= 500", "");
const CHANGED_ONCE: Slip = ("time_out = 100 msec retry = 2", "time_out = 100 msec retry = 0");

/// For each case: a cell, a mistake in it, the faults that are declared in place of its own, and the checks that then fail.
const SPOILT: [(&str, Slip, &str, &[&str]); 8] = [
    ("shared_tool", BORROWED_TOO_SHORT, "", &["one_holder"]),
    ("shared_tool", BORROWED_TOO_LONG, "faults crash weldA;", &["dead_holder"]),
    ("shared_tool", ASKED_ONCE, "faults loss 1;", &["b_is_heard", "c_is_heard"]),
    ("conveyor", LET_GO, "", &["no_drop"]),
    ("conveyor", TOO_SLOW, "", &["not_jammed"]),
    ("belt", ANY_VERSION, "", &["r2_has_seen"]),
    ("belt", ANY_SPEED, "", &["limits"]),
    ("belt", CHANGED_ONCE, "faults loss 1;", &["r1_is_told"]),
];

#[test]
fn every_check_can_fail() {
    let folder = runtime_dir();
    for (name, (says, instead), faults, checks) in SPOILT {
        let text = std::fs::read_to_string(example(&format!("{name}.cell"))).expect("the cell");
        assert!(text.contains(says), "{name}: {says}");
        let (before, declared) = text.split_once("\nfaults ").expect("the faults of the cell");
        let (_, after) = declared.split_once(';').expect("their end");
        let text = format!("{before}\n{faults}{after}").replacen(says, instead, 1);
        let spoilt = folder.path().join(format!("{name}.cell"));
        std::fs::write(&spoilt, text).expect("written");
        let spoilt = spoilt.to_str().expect("UTF-8");
        let said = run(&["verify", spoilt, "--jobs", "1", "--within", "300s", "--format", "json"]);
        assert_eq!(said.code, Some(1), "{name}, {instead}: {said:?}");
        let verdict = said.last_json();
        let claims = verdict["claims"].as_array().expect("claims");
        for check in checks {
            let fails = claims.iter().any(|claim| claim["name"] == *check && claim["outcome"] == "fails");
            assert!(fails, "{name}, {instead}: {check} holds: {verdict}");
        }
    }
}

#[test]
fn every_cell_runs() {
    let cells = cells().into_iter().filter(|(name, _)| !RUN_APART.contains(&name.as_str()));
    side_by_side(cells, |(name, file)| {
        let dir = runtime_dir();
        let record = dir.path().join("run.imrs");
        let record = ["--record", record.to_str().expect("UTF-8")];
        let run = ["run", &file, "--seed", "3", "--in-process"];
        let live = Live::start(dir.path(), &[&run[..], &record].concat());
        live.until("something is delivered", |seen| {
            let nodes = seen["nodes"].as_array().expect("nodes").iter();
            let tasks = nodes.clone().flat_map(|node| node["tasks"].as_array().expect("tasks"));
            let mut ports = tasks.flat_map(|task| task["ports"].as_array().expect("ports"));
            ports.any(|port| port["delivered"].as_u64() > Some(0))
                && nodes.filter_map(|node| node["uptime_us"].as_u64()).max() >= Some(1_500_000)
        });
        live.interrupt();
        let nodes: Vec<String> = live.nodes.iter().map(|node| node.name.clone()).collect();
        let nodes: Vec<&str> = nodes.iter().map(String::as_str).collect();
        let (summary, code, errors) = live.finish();
        let is_excused = || code == Some(1) && was_late(dir.path(), &file, record[1].as_ref(), &nodes);
        assert!(is_well(code, &errors) || is_excused(), "{name}: {summary} {errors}");
        let ports = summary["ports"].as_array().expect("ports");
        let delivered: u64 = ports.iter().filter_map(|port| port["delivered"].as_u64()).sum();
        assert!(delivered > 0, "{name}: {summary}");
        // If this machine is later than the cell declares, a buffer may be full, and so messages may be refused.
        let refused: u64 = ports.iter().filter_map(|port| port["refused"].as_u64()).sum();
        assert!(refused == 0 || was_late(dir.path(), &file, record[1].as_ref(), &nodes), "{name}: {summary}");
        for node in summary["nodes"].as_array().expect("nodes") {
            assert_eq!(node["exit"], Value::from("clean"), "{name}: {summary}");
        }
    });
}
