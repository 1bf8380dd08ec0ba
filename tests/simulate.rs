//! End-to-end tests of `imrs simulate CELL`: random runs of a cell file, their answers, and replays of saved findings.

use crate::support::{imrs, run};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use std::fs;
use std::process::Stdio;
use std::time::Duration;

const TWICE: &str = "examples/faulty/part_placed_twice.cell";

/// Writes a file into a folder of its own.
fn file(name: &str, text: &str) -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(name);
    fs::write(&path, text).expect("written");
    let path = path.to_str().expect("text").to_owned();
    (folder, path)
}

fn json(args: &[&str]) -> Value {
    let said = run(&[args, &["--format", "json"]].concat());
    serde_json::from_str(&said.out).unwrap_or_else(|error| panic!("{error}: {said:?}"))
}

#[test]
fn a_faulty_cell_is_found_and_shrunk_to_what_it_takes() {
    let said = run(&["simulate", TWICE, "--seed", "1", "--seeds", "50"]);
    assert_eq!(said.code, Some(1), "{said:?}");
    for part in [
        "check: `one_each` does not hold: robot.placed = 2, feeder.parts = 1",
        &format!("--> {TWICE}:36:7"),
        "is LOST",
        "found with seed 1;",
        "  with: packet 1 of n2 -> n1 is lost\n",
        &format!("again: imrs simulate {TWICE} --seed 1\n"),
        "the runs of seeds 1 to 50",
        "1 finding",
    ] {
        assert!(said.out.contains(part), "no `{part}`: {said:?}");
    }
    let answer = json(&["simulate", TWICE, "--seed", "1", "--seeds", "50"]);
    let (found, ended) = (&answer["findings"][0], &answer["ended"]);
    assert_eq!((&found["kind"], &found["line"], &found["choices"]), (&"check".into(), &36.into(), &0.into()));
    assert_eq!(found["faults"], serde_json::json!(["packet 1 of n2 -> n1 is lost"]));
    assert_eq!(found["shrunk_from"]["whole"], true);
    assert_eq!((&answer["version"], &answer["seed"], &answer["runs"]), (&1.into(), &1.into(), &50.into()));
    let all: u64 = ["over", "finding", "steps", "crowded"].iter().filter_map(|end| ended[end].as_u64()).sum();
    assert!(all == 50 && ended["finding"] == found["runs"], "{answer}");
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    for form in ["text", "json"] {
        let with = |jobs: &str| {
            run(&[
                "simulate",
                "examples/weld_cell.cell",
                "--seed",
                "9",
                "--seeds",
                "60",
                "--jobs",
                jobs,
                "--format",
                form,
            ])
        };
        let (one, other) = (with("1"), with("3"));
        assert_eq!((one.code, other.code), (Some(0), Some(0)), "{one:?}");
        assert!(one.out == other.out && !one.out.is_empty(), "{one:?}\n{other:?}");
    }
    let clock = json(&["simulate", TWICE, "--seeds", "5"]);
    let seed = clock["seed"].as_u64().expect("the seed is said").to_string();
    assert_eq!(json(&["simulate", TWICE, "--seeds", "5", "--seed", &seed]), clock);
}

#[test]
fn one_seed_is_drawn_though_it_shows_nothing() {
    let said = run(&["simulate", "examples/weld_cell.cell", "--seed", "3"]);
    assert_eq!(said.code, Some(0), "{said:?}");
    assert!(said.out.contains("tick  dresser") && said.out.contains("the run of seed 3\n"), "{said:?}");
    assert!(said.out.contains("random runs prove nothing about others"), "{said:?}");
}

#[test]
fn a_saved_finding_is_shown_again_of_its_own_cell_alone() {
    let (folder, _) = file("other", "");
    let saved = folder.path().join("found.toml").to_str().expect("text").to_owned();
    let cell = "examples/faulty/token_lost_on_the_way.cell";
    let first = run(&["simulate", cell, "--seed", "1", "--seeds", "100", "--save", &saved]);
    assert_eq!(first.code, Some(1), "{first:?}");
    assert!(first.out.contains(&format!("again: imrs simulate {cell} --plan {saved}\n")), "{first:?}");
    let again = run(&["simulate", cell, "--plan", &saved]);
    let story = |text: &str| text.split("  help:").next().map(str::to_owned);
    assert_eq!((again.code, story(&again.out)), (Some(1), story(&first.out)), "{again:?}");
    let shrunk = run(&["simulate", cell, "--plan", &saved, "--shrink"]);
    assert!(shrunk.out.contains("shrunk from 1 fault, 0 choices"), "{shrunk:?}");
    let other = run(&["simulate", TWICE, "--plan", &saved]);
    assert_eq!(other.code, Some(2), "{other:?}");
    assert!(other.err.contains("it was saved from the cell `token`, this is `twice`"), "{other:?}");
    // This text is the same cell with one more declaration.
    let text = fs::read_to_string(cell).expect("a cell");
    let (_folder, changed) = file("changed.cell", &text.replacen("node n1;", "node n1; node spare;", 1));
    let other = run(&["simulate", &changed, "--plan", &saved]);
    assert!(other.code == Some(2) && other.err.contains("have changed since it was saved"), "{other:?}");
    let twice = run(&["simulate", cell, "--plan", &saved, "--seed", "1"]);
    assert!(twice.code == Some(2) && twice.err.contains("leave out --seed"), "{twice:?}");
}

/// Without a finding the command says that it saved nothing, because a file of an earlier run could be taken for the answer.
#[test]
fn where_nothing_is_found_it_is_said_that_nothing_is_saved() {
    let sound = "cell sound;\ntick 1 msec;\nnode n;\ntask t on n\nbegin\n  run turn takes 3 msec;\nend t;\n";
    let (folder, cell) = file("sound.cell", sound);
    let at = |name: &str| folder.path().join(name).to_str().expect("text").to_owned();
    let (new, old) = (at("new"), at("old"));
    fs::write(&old, "of yesterday").expect("written");
    let verbs = [
        (&["simulate", &cell, "--seed", "1"][..], "--save"),
        (&["verify", &cell], "--save"),
        (&["verify", &cell], "--trace"),
    ];
    for (verb, flag) in verbs {
        for (path, rest) in [(&new, "\n"), (&old, "; what is there is of an earlier run\n")] {
            let args = [verb, &[flag, path, "--force"]].concat();
            let (text, json) = (run(&args), run(&[&args[..], &["--format", "json"]].concat()));
            let said = format!("nothing was saved to {path}: nothing was found{rest}");
            assert!(text.code == Some(0) && text.out.contains(&said), "{said}: {text:?}");
            assert!(json.code == Some(0) && json.err.contains(&said), "{said}: {json:?}");
        }
    }
    assert!(!fs::exists(&new).expect("a folder"));
    assert_eq!(fs::read_to_string(&old).expect("text"), "of yesterday");
}

#[test]
fn what_cannot_be_saved_is_shown_and_a_file_that_cannot_be_written_is_refused_before_the_runs() {
    let lost = "--> examples/faulty/part_placed_twice.cell:36:7";
    for verb in [&["simulate", TWICE, "--seed", "1", "--seeds", "50"][..], &["verify", TWICE]] {
        // Writing to `/dev/full` fails as on a full disk.
        let full = run(&[verb, &["--save", "/dev/full"]].concat());
        assert!(full.code == Some(2) && full.out.contains(lost), "{full:?}");
        assert!(full.err.contains("/dev/full: cannot be written: No space left"), "{full:?}");
        assert!(
            !full.out.contains("nothing was saved") && !full.out.contains("--plan /dev/full"),
            "{full:?}"
        );
        let beyond = run(&[verb, &["--save", "/dev/null", "--finding", "9"]].concat());
        assert!(beyond.code == Some(2) && beyond.out.contains(lost), "{beyond:?}");
        for file in ["no_such_folder/found", "examples"] {
            let refused = run(&[verb, &["--save", file]].concat());
            assert!(refused.code == Some(2) && refused.out.is_empty(), "{refused:?}");
            let said = format!("{file}: cannot be written: ");
            assert!(refused.err.contains(&said) && refused.err.contains("name another file"), "{refused:?}");
        }
    }
    let shown = run(&["simulate", TWICE, "--seed", "1", "--save", "/dev/full", "--format", "json"]);
    let answer: Value = serde_json::from_str(&shown.out).expect("JSON");
    assert!(shown.code == Some(2) && answer["findings"][0]["saved"] == false, "{shown:?}");
}

#[test]
fn a_cell_that_is_refused_is_answered_in_json() {
    let nodes: String = (0..70).map(|n| format!("node n{n};\n")).collect();
    let large = format!("cell large;\ntick 1 msec;\n{nodes}task t on n0\nbegin\nend t;\n");
    let (_folder, large) = file("large.cell", &large);
    let (_folder, broken) = file("broken.cell", "cell broken;\ntick 1 msec;\nnode n1\n");
    for (verb, why) in [("simulate", "not_simulated"), ("verify", "not_checked")] {
        let said = run(&[verb, &large, "--format", "json"]);
        let answer: Value = serde_json::from_str(&said.out).unwrap_or_else(|e| panic!("{e}: {said:?}"));
        let reason = answer[why]["why"].as_str().expect("a reason");
        assert!(
            said.code == Some(4) && reason.starts_with("70 nodes") && answer["complete"] == false,
            "{said:?}"
        );
        let said = run(&[verb, &broken, "--format", "json"]);
        let answer: Value = serde_json::from_str(&said.out).unwrap_or_else(|e| panic!("{e}: {said:?}"));
        let checked = run(&["check", &broken, "--format", "json"]);
        assert!(said.code == Some(1) && answer["errors"] != 0 && said.out == checked.out, "{said:?}");
    }
}

#[test]
fn faults_of_a_file_happen_in_every_run() {
    let plan = "version = 2\n[[fault]]\nlose = 1\nlink = \"n2 -> n1\"\n";
    let (_folder, plan) = file("one.toml", plan);
    let answer = json(&["simulate", TWICE, "--plan", &plan, "--seeds", "20", "--seed", "1"]);
    assert_eq!(
        (&answer["with_faults"], &answer["findings"][0]["runs"]),
        (&20.into(), &20.into()),
        "{answer}"
    );
    let again = answer["findings"][0]["again"].as_str().expect("a command");
    assert_eq!(again, format!("imrs simulate {TWICE} --plan {plan} --seed 1"));
}

#[test]
fn there_are_at_most_256_threads() {
    for verb in ["simulate", "verify"] {
        for jobs in ["0", "257", "65535"] {
            let said = run(&[verb, TWICE, "--jobs", jobs]);
            assert!(said.code == Some(2) && said.err.contains("1..=256"), "{said:?}");
        }
    }
}

#[test]
fn times_that_were_rounded_are_named() {
    let (_folder, cell) = file("busy.cell", &BUSY.replace("time_out = 30 msec", "time_out = 30500 usec"));
    let args = ["simulate", &cell, "--seed", "1", "--seeds", "5"];
    let said = run(&args);
    let note = format!("  note[N101]: {cell}:10:");
    for part in
        [note.as_str(), "counts 30500 usec as 30000 usec", "not confirmed: these findings may come from"]
    {
        assert!(said.out.contains(part), "no `{part}`: {said:?}");
    }
    assert_eq!(json(&args)["rounded"][0]["line"], 10);
}

/// A cell in which every run has two findings, because two queries are never answered in time.
const BUSY: &str = "cell busy;
tick 1 msec;
node n1; node n2;
link n1 -- n2 delay 1 msec;
task one on n1
  port first() -> int8 usage = query user_list = {busy} time_out = 20 msec;
  var n: int8;
begin query first() -> n on time_out do skip; end; end one;
task other on n1
  port second() -> int8 usage = query user_list = {busy} time_out = 30 msec;
  var n: int8;
begin run think takes 1..9 msec; query second() -> n on time_out do skip; end; end other;
task busy on n2
  use_port first() -> int8 usage = response;
  use_port second() -> int8 usage = response;
begin run think takes 100 msec; receive first(); response(1); receive second(); response(2); end busy;
";

/// The command that each finding suggests shows that finding with its whole chart.
#[test]
fn the_command_of_a_finding_shows_it_again() {
    let (_folder, cell) = file("busy.cell", BUSY);
    let saved = cell.replace("busy.cell", "saved.toml");
    let found = |args: &[&str]| json(args)["findings"].as_array().expect("findings").clone();
    let shows_again = |one: &Value| {
        let again = one["again"].as_str().expect("a command");
        let words: Vec<&str> = again.split(' ').skip(1).collect();
        let number = words.iter().position(|word| *word == "--finding").map_or("1", |at| words[at + 1]);
        let other = &found(&words)[number.parse::<usize>().expect("a number") - 1];
        for part in ["kind", "line", "cause", "chart", "faults", "choices", "steps"] {
            assert_eq!(one[part], other[part], "{again}: {part}");
        }
        let (whole, chart) = (run(&words).out, one["chart"].as_str().expect("a chart"));
        assert!(chart.lines().all(|line| whole.contains(line)), "{again}: {whole}");
    };
    let seeds = ["simulate", &cell, "--seed", "1", "--seeds", "20"];
    let all = found(&[&seeds[..], &["--save", &saved, "--finding", "2"]].concat());
    let again: Vec<_> = all.iter().map(|one| one["again"].as_str().unwrap_or_default()).collect();
    let kept = format!("imrs simulate {cell} --plan {saved} --finding 2");
    assert_eq!(again, [format!("imrs simulate {cell} --seed 1"), kept]);
    all.iter().chain(&found(&seeds)).for_each(shows_again);
    for one in found(&["simulate", &cell, "--plan", &saved, "--shrink"]) {
        assert!(one["again"].as_str().is_some_and(|again| again.contains(" --shrink")), "{one}");
        shows_again(&one);
    }
}

#[test]
fn a_fault_of_a_file_that_happens_in_no_run_is_named() {
    let plan =
        "version = 2\n[[fault]]\nlose = 9\nlink = \"n2 -> n1\"\n[[fault]]\ncopy = 1\nlink = \"n1 -> n2\"\n";
    let (_folder, plan) = file("never.toml", plan);
    let args = ["simulate", TWICE, "--plan", &plan, "--seeds", "5", "--seed", "1"];
    let said = run(&args);
    let note = "  this fault happened in none of these runs: packet 9 of n2 -> n1 is lost\n";
    assert!(said.out.contains(note) && said.out.matches("this fault").count() == 1, "{said:?}");
    assert_eq!(json(&args)["idle"], serde_json::json!(["packet 9 of n2 -> n1 is lost"]));
}

#[test]
fn a_broken_plan_says_what_is_wrong_with_it() {
    let cases = [
        ("version = 1\n", "version 1: this imrs reads version 2"),
        ("[[fault]]\n", "missing field `version`"),
        ("version = 2\n[[fault]]\nloose = 1\n", "unknown field `loose`"),
        ("version = 2\n[[fault]]\nlink = \"n1 -> n2\"\n", "fault 1: it says 0 of lose, copy,"),
        ("version = 2\n[[fault]]\nlose = 1\ncopy = 1\nlink = \"n1 -> n2\"\n", "fault 1: it says 2 of lose,"),
        ("version = 2\n[[fault]]\nlose = 1\n", "fault 1: `lose` needs `link`"),
        ("version = 2\n[[fault]]\nlose = 0\nlink = \"n1 -> n2\"\n", "fault 1: `lose` counts from 1"),
        ("version = 2\n[[fault]]\nlose = 1\nlink = \"n1 -> n9\"\n", "no node `n9`"),
        ("version = 2\n[[fault]]\nlose = 1\nlink = \"n1 -> n1\"\n", "no link joins n1 and n1"),
        ("version = 2\n[[fault]]\nlose = 1\nlink = \"n1 -> n2\"\nat = \"1s\"\n", "`lose` has no `at`"),
        ("version = 2\n[[fault]]\nstop = \"n1\"\nat = \"soon\"\n", "write a number and a unit"),
        ("version = 2\n[[fault]]\nstop = \"n1\"\nat = \"1500us\"\n", "the tick of the cell is 1ms"),
        (
            "version = 2\n[[fault]]\ndrift = \"n1\"\nat = \"1s\"\ntick = \"slow\"\n",
            "write \"twice\" or \"missed\"",
        ),
        ("version = 2\n[[fault]]\nfail = 1\ntask = \"robo\"\n", "no task `robo`: did you mean `robot`?"),
        ("version = 2\n[choices.task]\nrobo = [1]\n", "no task `robo`"),
        ("version = 2\n[choices.node]\nn1 = [-1]\n", "invalid value"),
        ("version = 2\n[choices.node]\nn1 = [1]\nn1 = [2]\n", "duplicate key"),
        (
            "version = 2\n[choices.link]\n\"n1 -> n2\" = [1]\n\"n1->n2\" = [2]\n",
            "choices.link has `n1 -> n2` twice: write it once",
        ),
        ("not a plan", "TOML parse error"),
    ];
    for (text, wrong) in cases {
        let (_folder, plan) = file("plan.toml", text);
        let said = run(&["simulate", TWICE, "--plan", &plan]);
        assert_eq!(said.code, Some(2), "{text}: {said:?}");
        assert!(said.err.contains(wrong) && said.err.contains("plan.toml"), "{text}: {said:?}");
    }
    for plan in ["no_such.toml", "examples"] {
        let said = run(&["simulate", TWICE, "--plan", plan]);
        assert!(said.code == Some(2) && said.err.contains(plan), "{said:?}");
    }
    for flags in [&["--shrink"][..], &["--seeds", "0"], &["--steps", "0"], &["--finding", "0"]] {
        let said = run(&[&["simulate", TWICE], flags].concat());
        assert_eq!(said.code, Some(2), "{said:?}");
    }
}

/// Sends Ctrl-C once the command has its second thread, which starts after the signal handlers are installed. An earlier signal
/// could end the process, or be lost. Returns the exit code and the answer.
fn stopped(args: &[&str]) -> (Option<i32>, Value) {
    let folder = tempfile::tempdir().expect("a folder");
    let mut command = imrs(folder.path(), &[args, &["--jobs", "2", "--format", "json"]].concat());
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("started");
    let threads = format!("/proc/{}/task", child.id());
    while fs::read_dir(&threads).expect("it runs").count() < 2 {
        std::thread::sleep(Duration::from_millis(10));
    }
    let pid = Pid::from_raw(i32::try_from(child.id()).expect("a number")).expect("a process");
    kill_process(pid, Signal::INT).expect("told");
    let said = child.wait_with_output().expect("ended");
    (said.status.code(), serde_json::from_slice(&said.stdout).expect("JSON"))
}

#[test]
fn ctrl_c_ends_it_with_what_it_has() {
    let conveyor = "examples/conveyor.cell";
    let (code, answer) = stopped(&["simulate", conveyor, "--seeds", "100000000", "--seed", "1"]);
    assert_eq!((code, &answer["complete"]), (Some(4), &false.into()), "{answer}");
    // A batch of these runs takes minutes. The command must not wait for the end of the batch.
    let long = ["simulate", conveyor, "--seeds", "1000", "--seed", "1", "--steps", "1000000"];
    let (code, answer) = stopped(&long);
    assert_eq!((code, &answer["complete"]), (Some(4), &false.into()), "{answer}");
    assert!(answer["runs"].as_u64().is_some_and(|runs| runs < 64), "{answer}");
}
