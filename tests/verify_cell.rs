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
    assert!(answer.out.contains("everything within these bounds was looked at; 1 check hold"), "{answer:?}");
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
