//! Tests of texts on which a terminal would act, in a cell, in a recording and in a monitor's recording: no verb may print
//! them raw.

use super::{ended, fault_of};
use crate::support::tape::Tape;
use crate::support::{example, imrs, run_in, runtime_dir};
use imrs_wire::obs::ServerFrame;
use imrs_wire::recording::{Record, Shown};
use imrs_wire::text::acts;
use serde_json::Value;
use std::path::Path;

/// A text that ends a line, sets a title, clears the screen, and reverses the direction of writing.
const HOSTILE: &str = "x\u{1b}]0;t\u{7}\u{1b}[2J\u{9b}2J\u{202e}y\u{7f}\u{85}\u{2028}";

/// A cell with such a text in an abort, an address and an invalid statement.
fn cell() -> String {
    format!(
        "cell c; tick 1 msec; node n at \"{HOSTILE}\" port 7001; node m; link n -- m delay 1 msec;
        task t on n begin run work takes 1..2 msec; abort \"{HOSTILE}\"; end t;
        task u on m begin run more takes 1..2 msec; x := \"{HOSTILE}\"; end u;"
    )
}

/// The same cell without the invalid statement.
fn sound() -> String {
    cell().replace(&format!("x := \"{HOSTILE}\";"), "")
}

/// Asserts that no hostile text forges a line of an answer, and that a terminal would not act on anything in the answer.
fn is_plain(what: &[&str], text: &str) {
    let found = text.chars().find(|&c| acts(c) && c != '\n' && c != '\t');
    assert_eq!(found, None, "{what:?} lets it through: {text:?}");
    assert!(!text.lines().any(|line| line.starts_with("FORGED")), "{what:?}: {text}");
}

fn all_plain(folder: &Path, lines: &[Vec<&str>]) {
    for args in lines {
        let said = ended(imrs(folder, args));
        assert_eq!(fault_of(&said), None, "{args:?}: {said:?}");
        is_plain(args, &said.out);
        is_plain(args, &said.err);
    }
}

#[test]
fn texts_of_a_cell_reach_no_terminal() {
    let folder = runtime_dir();
    let at = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let (wrong, right, named) = (at("wrong.cell"), at("right.cell"), at("\u{1b}[2J\u{9b}.cell"));
    std::fs::write(&wrong, cell()).expect("written");
    std::fs::write(&right, sound()).expect("written");
    std::fs::write(&named, "cell c").expect("written");
    let (saved, chart, picture, plan) = (at("found.imrs"), at("chart.txt"), at("chart.svg"), at("plan.toml"));
    let lines: Vec<Vec<&str>> = vec![
        vec!["check", &wrong],
        vec!["check", &wrong, "--format", "json"],
        vec!["check", &right],
        vec!["check", &named],
        vec!["check", &named, "--format", "json"],
        vec!["fmt", "--check", &right],
        vec!["fmt", "--check", &wrong],
        vec!["graph", &right],
        vec!["graph", &right, "--to", "dot"],
        vec!["verify", &right, "--save", &saved, "--trace", &chart],
        vec!["verify", &right, "--trace", &picture, "--format", "json"],
        vec!["verify", &wrong],
        vec!["simulate", &right, "--seed", "1", "--save", &plan],
        vec!["simulate", &right, "--seed", "1", "--format", "json"],
        vec!["run", &right, "--in-process", "--for", "300ms"],
        vec!["run", &right, "--for", "300ms"],
        vec!["run", &right, "--for", "300ms", "--format", "json"],
        vec!["run", &right, "--node", "n"],
        vec!["monitor", "--replay", &saved, "--once"],
        vec!["monitor", "--replay", &saved, "--text"],
        vec!["monitor", "--replay", &saved, "--once", "--format", "json"],
        vec!["monitor", "--once", "--cell", HOSTILE],
        vec!["explain", HOSTILE],
        vec![HOSTILE],
        vec!["check", HOSTILE],
        vec!["check", &right, HOSTILE],
    ];
    all_plain(folder.path(), &lines);
    for file in [&chart, &picture] {
        is_plain(&[file], &std::fs::read_to_string(file).expect("drawn"));
    }
}

#[test]
fn texts_of_the_recording_of_a_node_reach_no_terminal() {
    let folder = runtime_dir();
    let at = |name: &str| folder.path().join(name);
    let file = at("run.imrs").to_str().expect("UTF-8").to_owned();
    let cell = example("beam_lift.cell");
    let run = ["run", &cell, "--in-process", "--for", "200ms", "--seed", "1", "--record", &file];
    assert!(matches!(run_in(folder.path(), &run).code, Some(0 | 1 | 5)));
    let mut tape = Tape::read(&at("run.nl.imrs"));
    let forged = format!("{HOSTILE}\nFORGED: every output the same");
    (tape.header.build, tape.header.cell) = (forged.clone(), forged);
    let (hostile, other) = (at("hostile.imrs"), at("other.imrs"));
    tape.write(&hostile);
    tape.header.digest ^= 1;
    tape.write(&other);
    let [hostile, other] = [&hostile, &other].map(|path| path.to_str().expect("UTF-8"));
    let mut lines = Vec::new();
    for file in [hostile, other] {
        lines.push(vec!["replay", file]);
        lines.push(vec!["replay", file, "--cell", &cell]);
        lines.push(vec!["replay", file, "--cell", &cell, "--format", "json"]);
        lines.push(vec!["replay", file, "--cell", &cell, "--model"]);
        lines.push(vec!["monitor", "--once", "--replay", file]);
        lines.push(vec!["export", file, "--to", "jsonl", "--out", "-"]);
    }
    all_plain(folder.path(), &lines);
}

/// Replaces every string of a JSON value with a hostile text.
fn poison(value: &mut Value, text: &str) {
    match value {
        Value::String(old) => *old = text.to_owned(),
        Value::Array(all) => all.iter_mut().for_each(|one| poison(one, text)),
        Value::Object(all) => all.values_mut().for_each(|one| poison(one, text)),
        Value::Null | Value::Bool(_) | Value::Number(_) => {}
    }
}

/// The frame `shown` with hostile texts in it.
fn poisoned(shown: Shown, text: &str) -> Shown {
    match shown {
        Shown::Attached { version, mut hello } => {
            hello.build = text.into();
            if let imrs_wire::obs::Role::Node(node) = &mut hello.role {
                (node.cell, node.node) = (text.into(), text.into());
            }
            Shown::Attached { version, hello }
        }
        Shown::Said(ServerFrame::Table(mut table)) => {
            table.cell = text.into();
            table.nodes.iter_mut().for_each(|node| node.name = text.into());
            table.tasks.iter_mut().for_each(|task| task.name = text.into());
            table.ports.iter_mut().for_each(|port| port.name = text.into());
            Shown::Said(ServerFrame::Table(table))
        }
        Shown::Lost { .. } => Shown::Lost { why: text.into() },
        Shown::Story(story) => {
            let mut value = serde_json::to_value(story).expect("a value");
            poison(&mut value, text);
            Shown::Story(serde_json::from_value(value).expect("a story"))
        }
        Shown::Step(step) => {
            let mut value = serde_json::to_value(step).expect("a value");
            poison(&mut value, text);
            Shown::Step(serde_json::from_value(value).expect("a step"))
        }
        other => other,
    }
}

#[test]
fn texts_that_a_monitor_recorded_reach_no_terminal() {
    let folder = runtime_dir();
    let at = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let (found, hostile) = (at("found.imrs"), at("hostile.imrs"));
    let faulty = example("faulty/feeder_and_press_wait_for_each_other.cell");
    assert_eq!(run_in(folder.path(), &["verify", &faulty, "--save", &found]).code, Some(1));
    let mut tape = Tape::read(Path::new(&found));
    let text = format!("{HOSTILE}\nFORGED");
    tape.header.cell.clone_from(&text);
    for record in &mut tape.records {
        if let Record::Frame { bytes, .. } = record {
            *bytes = poisoned(Shown::decode(bytes).expect("shown"), &text).encode();
        }
    }
    tape.write(Path::new(&hostile));
    let mut lines = vec![
        vec!["monitor", "--once", "--replay", &hostile],
        vec!["monitor", "--text", "--replay", &hostile],
        vec!["monitor", "--text", "--format", "json", "--replay", &hostile],
        vec!["monitor", "--once", "--replay", &hostile, "--cell", HOSTILE],
        vec!["monitor", "--assert", "up>=3", "--replay", &hostile],
        vec!["replay", &hostile],
    ];
    // An MCAP file is not shown on a terminal, so it is not tested.
    lines.extend(
        ["jsonl", "svg", "asciicast"].map(|form| vec!["export", &hostile, "--to", form, "--out", "-"]),
    );
    all_plain(folder.path(), &lines);
}
