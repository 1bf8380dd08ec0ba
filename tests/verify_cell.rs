//! `imrs verify CELL`: a cell's own scripts under the checker, from the file to the answer.

mod support;

use std::path::PathBuf;
use support::run;

/// Two robots, one of which asks the other.
const PAIR: &str = r#"cell pair;
tick 1 msec;
node n1 at "10.0.0.1";  node n2 at "10.0.0.2";
link n1 -- n2 delay 1 msec;
task asker on n1
  port where(x: int8) -> int8  usage = query  user_list = {teller}  time_out = 40 msec  class = 2;
  var at: int8;
begin
  query where(1) -> at on time_out do at := 0; end;
  assert at < 9;
end asker;
task teller on n2
  use_port where(x: int8) -> int8  usage = response;
  var x: int8;
begin
  receive where(x); response({answer});
end teller;
"#;

/// The pair where the answer is this, with more declarations behind it.
fn cell(answer: &str, more: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("pair.cell");
    std::fs::write(&path, PAIR.replace("{answer}", answer) + more).expect("written");
    (folder, path)
}

#[test]
fn a_sound_cell_holds_within_its_bounds() {
    let (_folder, path) = cell("7", "faults loss 2;\ncheck small: never asker.at > 7;\n");
    let answer = run(&["verify", path.to_str().expect("text"), "--dup", "1"]);
    assert_eq!(answer.code, Some(0), "{answer:?}");
    assert!(
        answer.out.contains("everything within these bounds was looked at; the check holds"),
        "{answer:?}"
    );
}

#[test]
fn a_finding_stands_on_its_line_and_is_drawn() {
    let (folder, path) = cell("9", "check small: never asker.at > 7;\n");
    let picture = folder.path().join("found.svg");
    let name = path.to_str().expect("text");
    let answer = run(&["verify", name, "--format", "json", "--trace", picture.to_str().expect("text")]);
    assert_eq!(answer.code, Some(1), "{answer:?}");
    let said: serde_json::Value = serde_json::from_str(&answer.out).expect("one line of JSON");
    let found = said["findings"].as_array().expect("findings");
    let at =
        |kind: &str| found.iter().find(|f| f["kind"] == kind).map(|f| (f["task"].clone(), f["line"].clone()));
    assert_eq!(at("assertion"), Some(("asker".into(), 10.into())), "{said}");
    assert_eq!(at("check").map(|(_, line)| line), Some(18.into()), "{said}");
    assert_eq!(said["claims"][0]["outcome"], "fails");
    assert!(std::fs::read_to_string(picture).expect("drawn").starts_with("<svg"));
}

#[test]
fn faults_are_of_things_that_are_there() {
    let answer = run(&["verify", "examples/weld_cell.cell", "--crash", "n3"]);
    assert_eq!(answer.code, Some(2), "{answer:?}");
    assert!(answer.err.contains("no node and no task `n3`: there are n1, n2, nt"), "{answer:?}");
    let answer = run(&["verify", "no_such.cell"]);
    assert_eq!(answer.code, Some(2), "{answer:?}");
    let answer = run(&["verify", "--loss", "1"]);
    assert_eq!(answer.code, Some(2), "flags of a cell want a cell: {answer:?}");
}

#[test]
fn a_saved_finding_is_shown_step_by_step_by_the_monitor_alone() {
    let (folder, path) = cell("9", "check small: never asker.at > 7;\n");
    let saved = folder.path().join("found.imrs");
    let (name, saved) = (path.to_str().expect("text"), saved.to_str().expect("text"));
    let answer = run(&["verify", name, "--loss", "1", "--reorder", "--save", saved]);
    assert_eq!(answer.code, Some(1), "{answer:?}");
    let again = format!("imrs verify {name} --loss 1 --reorder 1 --finding 2 --save FILE");
    for part in [
        format!("step by step: imrs monitor --replay {saved}\n").as_str(),
        &again,
        "With at most 1 packet lost, 1 packet overtaking another",
    ] {
        assert!(answer.out.contains(part), "{part}: {}", answer.out);
    }

    let shown = run(&["monitor", "--replay", saved]);
    assert_eq!(shown.code, Some(1), "its end is the finding: {shown:?}");
    for part in [
        "finding: assertion: asker: an assertion does not hold",
        "pair.cell:10:3  assert at < 9",
        "happened: asker begins line 10: assert at < 9",
        "happened: asker ASSERTION FAILS",
        "task asker: CRASHED",
    ] {
        assert!(shown.out.contains(part), "{part}: {}", shown.out);
    }
    let begins = shown.out.find("begins line 10").expect("the statement");
    assert!(begins < shown.out.find("ASSERTION FAILS").expect("its end"), "{}", shown.out);

    let shown = run(&["monitor", "--replay", saved, "--at", "1", "--format", "json"]);
    assert_eq!(shown.code, Some(0), "{shown:?}");
    let said = shown.last_json();
    assert_eq!((&said["replay"]["tick"], &said["replay"]["story"]["line"]), (&1.into(), &10.into()));
    assert_eq!(said["nodes"][0]["tasks"][0]["state"], "await_reply", "{said}");
    let happened = said["replay"]["happened"].to_string();
    assert!(happened.contains("QUERY #0 from asker to teller arrives"), "{happened}");

    let refused = run(&["replay", saved]);
    assert_eq!(refused.code, Some(2), "{refused:?}");
    assert!(refused.err.contains(&format!("imrs monitor --replay {saved}")), "{refused:?}");
    let other = run(&["monitor", "--replay", name]);
    assert!(other.code == Some(2) && other.err.contains("not a recording"), "{other:?}");
    let none = run(&["verify", name, "--finding", "3", "--save", saved]);
    assert!(none.code == Some(2) && none.err.contains("there are 2"), "{none:?}");
}

#[test]
fn statements_for_faults_that_did_not_come_about_are_told_as_untried() {
    let (_folder, path) = cell("7", "");
    let answer = run(&["verify", path.to_str().expect("text")]);
    let line = "statements only for faults that did not come about within these bounds, so not tried";
    assert!(answer.code == Some(0) && answer.out.contains(line), "{answer:?}");
    assert!(answer.out.contains("asker line 9"), "{answer:?}");
}

#[test]
fn a_finding_that_no_steps_lead_to_is_not_saved_and_that_is_said() {
    let (folder, path) = cell("7", "check idle: asker.at = 99 leads teller.x = 1 within 5 msec;\n");
    let saved = folder.path().join("found.imrs");
    let answer = run(&["verify", path.to_str().expect("text"), "--save", saved.to_str().expect("text")]);
    assert_eq!(answer.code, Some(1), "{answer:?}");
    assert!(answer.out.contains("nothing was saved to "), "{answer:?}");
    assert!(!answer.out.contains("step by step") && !saved.exists(), "{answer:?}");
}
