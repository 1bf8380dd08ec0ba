//! Tests that a run judges the checks of its cell. The verdicts are the same if this machine is late.

use crate::support::{Said, example, own_address, run_in, runtime_dir, side_by_side, tried, was_late};
use serde_json::Value;

/// A cell whose checks `apart` and `soon` must break; the premise of `quiet` is never true. Both tasks end after some
/// rounds, and then the run ends.
const OVERLAP: &str = "\
cell overlap;
tick 1 msec;
node na at \"HOST\" port NA;  node nb at \"HOST\" port NB;
link na -- nb delay 1 msec;
task a on na
  var busy: bool; var n: int16;
begin
  while n < 40 do busy := true; run work takes 60 msec; busy := false; delay 20 msec; n := n + 1; end;
end a;
task b on nb
  var busy, never_so: bool; var n: int16;
begin
  while n < 40 do
    delay 20 msec; busy := true; run work takes 60 msec; busy := false;
    n := n + 1; never_so := n < 0;
  end;
end b;
check apart: never a.busy and b.busy;
check soon: a.busy leads not a.busy within 30 msec;
check in_time: a.busy leads not a.busy within 50 sec;
check quiet: b.never_so leads a.busy within 1 msec;
check b_counts: always b.n >= 0;
";

struct Bench {
    folder: tempfile::TempDir,
    cell: String,
}

impl Bench {
    fn new() -> Self {
        let (host, [a, b]) = own_address();
        let cell = OVERLAP.replace("HOST", &host.to_string());
        let cell = cell.replace("port NA", &format!("port {a}")).replace("port NB", &format!("port {b}"));
        let bench = Self { folder: runtime_dir(), cell };
        std::fs::write(bench.path("overlap.cell"), &bench.cell).expect("the cell is written");
        bench
    }

    fn path(&self, name: &str) -> String {
        self.folder.path().join(name).to_str().expect("UTF-8").into()
    }

    fn run(&self, args: &[&str]) -> Said {
        run_in(self.folder.path(), &[&["run", &self.path("overlap.cell")], args].concat())
    }
}

fn outcomes(answer: &Value) -> Vec<(&str, &str)> {
    let checks = answer["checks"].as_array().expect("checks").iter();
    checks
        .map(|check| (check["name"].as_str().expect("a name"), check["outcome"].as_str().expect("a word")))
        .collect()
}

const EXPECTED: [(&str, &str); 5] = [
    ("apart", "broken"),
    ("soon", "broken"),
    ("in_time", "held"),
    ("quiet", "untested"),
    ("b_counts", "held"),
];

#[test]
fn a_check_that_a_run_breaks_is_told_with_its_line_and_values() {
    side_by_side([&[][..], &["--in-process"]], |how: &[&str]| {
        let said = Bench::new().run(how);
        assert_eq!(said.code, Some(1), "{said:?}");
        let words = "check apart (line 18) does not hold: a.busy = true, b.busy = true";
        assert!(said.out.contains(words), "{said:?}");
        // The complaint quotes the line of the check, because it may be read without the cell file.
        assert!(
            said.err.contains(words) && said.err.contains("`check apart: never a.busy and b.busy;`"),
            "{said:?}"
        );
        assert!(said.err.contains("check soon (line 19) does not hold"), "{said:?}");
        assert!(!said.err.contains("in_time") && !said.err.contains("b_counts"), "{said:?}");
        for line in [
            "check in_time (line 20): held",
            "check quiet (line 21): not put to the test",
            "check b_counts (line 22): held",
        ] {
            assert!(said.out.contains(line), "{said:?}");
        }
    });
}

#[test]
fn a_recording_is_judged_as_the_run_was() {
    let bench = Bench::new();
    let said = bench.run(&["--record", &bench.path("o.imrs"), "--format", "json"]);
    assert_eq!(said.code, Some(1), "{said:?}");
    assert_eq!(outcomes(&said.last_json()), EXPECTED, "{said:?}");
    let (cell, na, nb) = (bench.path("overlap.cell"), bench.path("o.na.imrs"), bench.path("o.nb.imrs"));
    let replay = ["replay", &na, &nb, "--cell", &cell, "--model", "--format", "json"];
    let said = run_in(bench.folder.path(), &replay);
    assert_eq!(said.code, Some(1), "{said:?}");
    let answer = said.last_json();
    assert_eq!(answer["path"], true, "{said:?}");
    assert_eq!(outcomes(&answer), EXPECTED, "{said:?}");
    assert_eq!(answer["checks"][0]["line"], 18, "{said:?}");
    assert_eq!(answer["checks"][0]["first"]["values"][1], "b.busy = true", "{said:?}");
    // The text output for people shows the verdicts, too.
    let said = run_in(bench.folder.path(), &replay[..6]);
    assert!(said.out.contains("check apart (line 18): DID NOT HOLD"), "{said:?}");
}

#[test]
fn a_recording_of_another_text_of_the_cell_is_refused_as_that() {
    let bench = Bench::new();
    bench.run(&["--record", &bench.path("o.imrs"), "--in-process"]);
    let (na, changed) = (bench.path("o.na.imrs"), bench.path("changed.cell"));
    let replay = |text: &str| {
        std::fs::write(&changed, text).expect("the cell is written");
        run_in(bench.folder.path(), &["replay", &na, "--cell", &changed])
    };
    let overlap = &bench.cell;
    // The exit code may be 5, if the disk was so slow that the recording has no end.
    let is_same = |said: &Said| matches!(said.code, Some(0 | 5)) && said.err.is_empty();
    let same = replay(overlap);
    assert!(is_same(&same), "{same:?}");
    let other = replay(&overlap.replace("delay 1 msec", "delay 2 msec"));
    assert_eq!(other.code, Some(2), "{other:?}");
    assert!(other.err.contains("was made from another text of cell `overlap`"), "{other:?}");
    let digests = other.err.split("digest").count() + other.err.split("file have").count();
    assert_eq!(digests, 2 + 2, "both digests: {other:?}");
    let foreign = replay(&overlap.replace("cell overlap", "cell overlay"));
    assert_eq!(foreign.code, Some(2), "{foreign:?}");
    assert!(
        foreign.err.contains("is a recording of cell `overlap`") && foreign.err.contains("is cell `overlay`"),
        "{foreign:?}"
    );
    let statements = replay(
        &overlap
            .replace("n := n + 1", "n := n + 2")
            .replace("busy := true; run", "busy := not busy; delay 1 msec; run"),
    );
    assert_eq!(statements.code, Some(2), "{statements:?}");
    assert!(statements.err.contains("its statements have digest"), "{statements:?}");
    // A comment changes no statement of `na`.
    let commented = replay(&overlap.replace("cell overlap;", "cell overlap;  // the same"));
    assert!(is_same(&commented), "{commented:?}");
    let none = run_in(bench.folder.path(), &["replay", &na]);
    assert_eq!(none.code, Some(2), "{none:?}");
    assert!(none.err.contains("name its file with --cell"), "{none:?}");
}

#[test]
fn a_node_by_itself_judges_what_it_can_see() {
    let bench = Bench::new();
    let said = bench.run(&["--node", "nb", "--insecure"]);
    assert_eq!(said.code, Some(0), "{said:?}");
    assert!(said.out.contains("check apart (line 18): not evaluated here: `a` runs elsewhere"), "{said:?}");
    assert!(said.out.contains("check b_counts (line 22): held"), "{said:?}");
}

#[test]
fn of_a_killed_node_nothing_is_made_up() {
    // `b` is killed before it is ever busy, so no task is busy with it at the same time. The run ends when `a` has ended. On
    // a late machine `b` may have been busy before the kill.
    tried("b was killed too late each time", || {
        let bench = Bench::new();
        let said = bench.run(&["--kill", "b@1ms", "--format", "json"]);
        let summary = said.last_json();
        let outcomes = outcomes(&summary);
        let in_time = outcomes[0].1 != "broken";
        if in_time {
            assert_eq!(outcomes[1].1, "broken", "{said:?}");
        }
        in_time
    });
}

/// If this machine is later than the cell declares, a check may break. The recording must then show the lateness.
#[test]
fn the_runs_of_the_examples_break_no_check_in_time() {
    side_by_side(["beam_lift", "belt", "conveyor", "shared_tool", "weld_cell"], |name| {
        let dir = runtime_dir();
        let (cell, file) = (example(&format!("{name}.cell")), dir.path().join("run.imrs"));
        let file = file.to_str().expect("UTF-8");
        let run = ["run", &cell, "--for", "3s", "--seed", "7", "--record", file, "--format", "json"];
        let said = run_in(dir.path(), &run);
        let summary = said.last_json();
        assert!(
            !outcomes(&summary).is_empty()
                && outcomes(&summary).iter().all(|(_, outcome)| *outcome != "unknown"),
            "{said:?}"
        );
        // Exit code 1 reports a broken check, or a task that gave up. A node that could not report all events breaks no
        // check.
        if said.code != Some(1) {
            assert!(said.is_well(), "{said:?}");
            assert!(outcomes(&summary).iter().all(|(_, outcome)| *outcome != "broken"), "{said:?}");
            return;
        }
        let nodes = summary["nodes"].as_array().expect("nodes").iter();
        let nodes: Vec<&str> = nodes.map(|node| node["name"].as_str().expect("a name")).collect();
        assert!(was_late(dir.path(), &cell, file.as_ref(), &nodes), "{said:?}");
    });
}
