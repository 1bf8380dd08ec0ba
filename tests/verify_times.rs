//! Tests of `imrs verify`: for which times a finding happens, and how far a search of all times came.

use crate::support::run;

#[test]
fn a_finding_says_for_which_times_it_happens_however_it_was_searched_for() {
    for times in ["auto", "ends", "every", "zones"] {
        let verify = ["verify", "examples/faulty/camera_looks_too_long.cell", "--times", times];
        let said = run(&verify);
        assert!(said.out.contains("\n  happens if `look` of camera takes 48..60 msec\n"), "{said:?}");
        let said = run(&[&verify[..], &["--format", "json"]].concat()).last_json();
        let happens = &said["findings"][0]["happens"][0];
        let range = ["least_us", "most_us", "declared_least_us"].map(|name| happens[name].as_u64());
        assert_eq!(range, [48_000, 60_000, 20_000].map(Some), "{said}");
    }
}

#[test]
fn a_standstill_says_for_which_times_it_happens() {
    let cell = "examples/faulty/robots_poll_for_each_others_zone.cell";
    let said = run(&["verify", cell, "--format", "json"]).last_json();
    let warning = &said["warnings"][0];
    assert_eq!(warning["kind"], "standstill", "{said}");
    assert!(warning["happens"][0]["name"] == "come" && warning["happens"][1]["name"] == "come", "{said}");
}

#[test]
fn an_answer_at_the_ends_says_how_far_the_search_by_zones_came() {
    // No machine finishes the search by zones in this time.
    let verify = ["verify", "examples/press_line.cell", "--loss", "2", "--within", "300ms"];
    let said = run(&verify);
    assert!(said.out.contains("\n  before, at every tick, by zones: "), "{said:?}");
    assert!(said.out.contains(" of these states were looked at ("), "{said:?}");
    let said = run(&[&verify[..], &["--format", "json"]].concat()).last_json();
    let finer = &said["phases"][1]["finer"];
    let [states, left] = [&finer["states"], &finer["unfinished"]["states"]].map(serde_json::Value::as_u64);
    assert!(finer["times"] == "zones" && finer["complete"] == false, "{said}");
    assert!(left > Some(0) && left < states, "{said}");
}
