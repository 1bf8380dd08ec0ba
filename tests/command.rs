//! End-to-end tests of the command line: help, exit codes, JSON, pipes.

use crate::support::{finish, imrs, run, runtime_dir};
use serde_json::Value;
use std::process::Stdio;

const ESCAPE: char = '\u{1b}';

#[test]
fn every_verb_explains_itself_with_an_example() {
    let help = run(&["--help"]);
    assert_eq!(help.code, Some(0), "{help:?}");
    let verbs = [
        "verify",
        "simulate",
        "check",
        "fmt",
        "explain",
        "graph",
        "run",
        "demo",
        "monitor",
        "replay",
        "bench",
        "completions",
        "keygen",
        "summary",
        "unit",
        "man",
    ];
    for verb in verbs {
        assert!(help.out.contains(verb), "{verb} is missing in\n{}", help.out);
        let help = run(&[verb, "--help"]);
        assert_eq!(help.code, Some(0), "{help:?}");
        assert!(help.out.contains("Example"), "`{verb} --help` shows no example:\n{}", help.out);
        assert!(!help.out.contains(ESCAPE), "escapes in a pipe");
    }
    assert!(!help.out.contains("\n  node "), "a hidden verb is offered");
    assert!(run(&["--version"]).out.starts_with("imrs "));
}

#[test]
fn what_makes_no_sense_is_a_usage_error_that_names_it() {
    for (args, named) in [
        (&["launch"][..], "launch"),
        (&["verify", "--claim", "no-false-relase"], "did you mean `no-false-release`?"),
        (&["verify", "--memory", "4X"], "unknown unit"),
        (&["verify", "--jobs", "0"], "--jobs"),
        (&["--full", "monitor"], "behind the verb"),
        (&["demo", "beam-lift", "--loss", "120%"], "from 0% to 100%"),
        (&["demo", "beam-lift", "--kill", "hoit@1s"], "did you mean `hoist`?"),
        (&["demo", "beam-lift", "--kill", "hoist@20s"], "after the end"),
        (&["demo", "beam-lift", "--cut", "nl-nr@1s+1s"], "nl--nr@1s+40ms"),
        (&["replay", "/no/such/file"], "/no/such/file"),
        (&["bench", "queues", "--quick"], "cargo run --release --features bench -- bench queues --quick"),
    ] {
        let said = run(args);
        assert_eq!(said.code, Some(2), "{args:?}: {said:?}");
        assert!(said.err.contains(named), "{args:?} does not name `{named}`: {}", said.err);
        assert_eq!(said.out, "", "{args:?}");
    }
}

#[test]
fn a_monitor_without_nodes_ends_with_3_and_says_where_it_looked() {
    let dir = runtime_dir();
    let said = finish(imrs(dir.path(), &["monitor", "--once"]));
    assert_eq!(said.code, Some(3), "{said:?}");
    assert!(said.err.contains(dir.path().to_str().unwrap()), "{}", said.err);
    assert!(said.err.contains("imrs demo beam-lift"), "{}", said.err);
}

#[test]
fn a_claim_is_checked_and_its_json_keeps_the_contract() {
    let said = run(&["verify", "--claim", "rendezvous-under-loss", "--format", "json"]);
    assert_eq!(said.code, Some(0), "{said:?}");
    let report = said.last_json();
    assert_eq!((&report["version"], &report["cell"]), (&Value::from(1), &Value::Null));
    let claims = report["claims"].as_array().expect("claims");
    assert!(!claims.is_empty());
    for claim in claims {
        assert_eq!(claim["name"], "rendezvous-under-loss");
        for word in ["expect", "outcome"] {
            assert!(["holds", "fails", "unknown"].contains(&claim[word].as_str().unwrap()), "{claim}");
        }
        for number in ["parties", "states", "transitions", "depth", "seconds", "states_per_second"] {
            assert!(claim[number].is_number(), "{number} of {claim}");
        }
        for flag in ["as_expected", "complete"] {
            assert!(claim[flag].is_boolean(), "{flag} of {claim}");
        }
        for bound in ["loss", "dup", "delay", "crash", "rounds"] {
            assert!(claim["bounds"].get(bound).is_some(), "{bound} of {claim}");
        }
        for figure in ["least_losses_to_strand", "least_safe_margin", "bound_ticks"] {
            assert!(claim["found"].get(figure).is_some(), "{figure} of {claim}");
        }
        assert_eq!(claim["as_expected"], true, "{claim}");
        if claim["outcome"] == "fails" {
            let steps = claim["counterexample"]["steps"].as_array().expect("the steps of a counterexample");
            assert!(!steps.is_empty() && claim["counterexample"]["length"].is_number(), "{claim}");
        }
    }
}

#[test]
fn a_report_in_a_pipe_has_no_escapes_and_a_verdict_at_its_end() {
    let said = run(&["verify", "--claim", "pairing"]);
    assert_eq!(said.code, Some(0), "{said:?}");
    assert!(!said.out.contains(ESCAPE) && !said.err.contains(ESCAPE), "{said:?}");
    assert!(said.out.lines().last().is_some_and(|line| line.contains("as expected")), "{}", said.out);
    let forced = run(&["verify", "--claim", "pairing", "--color", "always"]);
    assert!(forced.out.contains(ESCAPE), "--color always has no colour");
}

#[test]
fn a_reader_that_goes_away_is_no_fault() {
    let dir = runtime_dir();
    let mut child = imrs(dir.path(), &["man"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0));
    assert_eq!(String::from_utf8_lossy(&output.stderr), "");
}

#[test]
fn completions_and_manual_are_generated() {
    for shell in ["bash", "zsh", "fish"] {
        let said = run(&["completions", shell]);
        assert_eq!(said.code, Some(0), "{said:?}");
        assert!(said.out.contains("monitor"), "{shell}: {}", said.out);
    }
    let manual = run(&["man"]);
    assert!(manual.out.contains(".TH imrs") && manual.out.contains("demo"), "{}", manual.out);
    let manual = run(&["man", "run"]);
    let plain = manual.out.replace('\\', "");
    for flag in ["--node", "--observe", "--insecure", "--rt", "--restart"] {
        assert!(plain.contains(flag), "{flag} is missing in\n{}", manual.out);
    }
    assert_eq!(run(&["man", "rnu"]).code, Some(2));
}
