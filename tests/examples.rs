//! Every cell of `examples/`: checked, verified within the faults that it declares, and run.

mod support;

use serde_json::Value;
use std::path::Path;
use support::{is_well, run};

/// Its camera is a Rust program, which its own test runs.
const RUN_APART: [&str; 1] = ["extern_task"];

/// The cells: their names and files.
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
fn every_cell_holds_under_the_faults_that_it_declares() {
    for (name, file) in &cells() {
        let said = run(&["check", file]);
        assert_eq!(said.code, Some(0), "{said:?}");
        assert!(!said.out.contains("warn[") && !said.out.contains("error["), "{said:?}");
        assert_eq!(run(&["fmt", "--check", file]).code, Some(0), "{name}");
        // Far more than it takes: the machine may be busy.
        let said = run(&["verify", file, "--within", "300s", "--format", "json"]);
        assert_eq!(said.code, Some(0), "{said:?}");
        let verdict = said.last_json();
        assert_eq!(verdict["complete"], true, "{name}: {verdict}");
        assert_eq!(verdict["findings"].as_array().map(Vec::len), Some(0), "{name}: {verdict}");
    }
}

/// What a cell says, what it must not say, and the check that notices.
const SPOILT: [(&str, &str, &str, &str); 9] = [
    ("shared_tool", "start lent 4 sec", "start lent 2 sec", "one_holder"),
    ("shared_tool", "start lent 4 sec", "start lent 5 sec", "dead_holder"),
    ("shared_tool", "time_out = 400 msec retry = 2", "time_out = 400 msec retry = 0", "b_is_heard"),
    ("shared_tool", "time_out = 400 msec retry = 2", "time_out = 400 msec retry = 0", "c_is_heard"),
    ("conveyor", "if held then", "if held or p.x > 5 then", "no_drop"),
    ("conveyor", "drop_into_box takes 320 msec", "drop_into_box takes 3 sec", "not_jammed"),
    ("belt", "s.version = now.version and ", "", "r2_has_seen"),
    ("belt", " and s.mm_s <= 500", "", "limits"),
    ("belt", "time_out = 100 msec retry = 2", "time_out = 100 msec retry = 0", "r1_is_told"),
];

#[test]
fn every_check_can_fail() {
    let folder = support::runtime_dir();
    for (name, says, instead, check) in SPOILT {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("examples/{name}.cell"));
        let text = std::fs::read_to_string(file).expect("the cell");
        assert!(text.contains(says), "{name}: {says}");
        let spoilt = folder.path().join(format!("{name}.cell"));
        std::fs::write(&spoilt, text.replacen(says, instead, 1)).expect("written");
        let spoilt = spoilt.to_str().expect("UTF-8");
        let said = run(&["verify", spoilt, "--jobs", "1", "--within", "50s", "--format", "json"]);
        assert_eq!(said.code, Some(1), "{name}, {instead}: {said:?}");
        let verdict = said.last_json();
        let claims = verdict["claims"].as_array().expect("claims");
        let fails = claims.iter().any(|claim| claim["name"] == check && claim["outcome"] == "fails");
        assert!(fails, "{name}, {instead}: {check} holds: {verdict}");
    }
}

#[test]
fn every_cell_runs() {
    for (name, file) in cells().iter().filter(|(name, _)| !RUN_APART.contains(&name.as_str())) {
        let said = run(&["run", file, "--for", "1500ms", "--seed", "3", "--in-process", "--format", "json"]);
        assert!(is_well(said.code, &said.err), "{name}: {said:?}");
        let summary = said.last_json();
        let ports = summary["ports"].as_array().expect("ports");
        let delivered: u64 = ports.iter().filter_map(|port| port["delivered"].as_u64()).sum();
        assert!(delivered > 0, "{name}: {summary}");
        assert_eq!(
            ports.iter().filter_map(|port| port["refused"].as_u64()).sum::<u64>(),
            0,
            "{name}: {summary}"
        );
        for node in summary["nodes"].as_array().expect("nodes") {
            assert_eq!(node["exit"], Value::from("clean"), "{name}: {summary}");
        }
    }
}
