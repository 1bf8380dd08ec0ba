//! End-to-end tests of `imrs verify CELL`: each runs the command on a cell file and judges its answer.

use crate::support::run;
use std::path::PathBuf;

/// A cell with two robots, one of which queries the other.
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

/// Writes `PAIR` to a file. `answer` replaces the answer of the task `teller`, and the declarations `more` are appended.
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
        "finding: assertion: asker: an assertion does not hold: at = 9",
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
    assert!(happened.contains("QUERY where #0 (1) from asker to teller arrives"), "{happened}");

    let refused = run(&["replay", saved]);
    assert_eq!(refused.code, Some(2), "{refused:?}");
    assert!(refused.err.contains(&format!("imrs monitor --replay {saved}")), "{refused:?}");
    let other = run(&["monitor", "--replay", name]);
    assert!(other.code == Some(2) && other.err.contains("not a recording"), "{other:?}");
    let none = run(&["verify", name, "--finding", "3", "--save", saved, "--force"]);
    assert!(none.code == Some(2) && none.err.contains("there are 2"), "{none:?}");
}

#[test]
fn statements_for_faults_that_did_not_come_about_are_told_as_untried() {
    let (_folder, path) = cell("7", "");
    let answer = run(&["verify", path.to_str().expect("text")]);
    let line = "statements never reached at these bounds: no fault, time_out or timer of theirs leads there";
    assert!(answer.code == Some(0) && answer.out.contains(line), "{answer:?}");
    assert!(answer.out.contains("    asker 9:39  at := 0"), "{answer:?}");
}

/// The lines of the chart that the command prints. They must fit a terminal of 80 columns.
fn chart_of(out: &str) -> Vec<&str> {
    let from = out.lines().skip_while(|line| !line.starts_with("  tick  "));
    from.take_while(|line| !line.starts_with("  step by step")).collect()
}

#[test]
fn a_finding_says_the_values_the_ports_and_what_the_others_do() {
    let (folder, path) = cell("9", "check small: never asker.at > 7;\n");
    let (name, file) = (path.to_str().expect("text"), folder.path().join("all.txt"));
    let answer = run(&["verify", name, "--trace", file.to_str().expect("text")]);
    for part in [
        "assertion: asker: an assertion does not hold: at = 9\n",
        "check: `small` does not hold: asker.at = 9; it became so at a step of asker\n",
        "  meanwhile asker has ended: its assertion did not hold (last at line 10: assert at < 9)\n",
        "   9  asker -> teller: QUERY where #0 (1)\n",
        "  16  teller: takes where #0 of asker\n",
        "  16  teller -> asker: RESPONSE where #0 (9)\n",
        "  10  asker: ASSERTION FAILS\n",
    ] {
        assert!(answer.out.contains(part), "{part}: {}", answer.out);
    }
    let drawn = chart_of(&answer.out);
    assert!(drawn.len() > 3 && drawn.iter().all(|line| line.chars().count() <= 80), "{drawn:?}");
    let whole = std::fs::read_to_string(file).expect("drawn");
    assert!(whole.contains("   9  asker -> teller: QUERY where #0 (1)\n"), "{whole}");
}

#[test]
fn a_finding_of_tasks_with_the_same_statements_is_told_once() {
    let (_folder, path) = cell("9", "");
    let asker = |name: &str| {
        PAIR.split("task ")
            .nth(1)
            .expect("the asker")
            .replace("asker", name)
            .replace("begin\n", "begin\n  run think takes 1..9 msec;\n")
    };
    let port =
        "port where(x: int8) -> int8  usage = query  user_list = {teller}  time_out = 40 msec  class = 2;";
    let uses = "use_port where(x: int8) -> int8  usage = query;";
    let teller = "task teller on n2
  port where(x: int8) -> int8  usage = response  user_list = {one, two}  time_out = 40 msec  bounded_buffer[2];
  var x: int8;
begin
  loop receive where(x); response(9); end;
end teller;
";
    let head = PAIR.split("task ").next().expect("the nodes");
    let text = format!("{head}task {}task {}{teller}", asker("one"), asker("two")).replace(port, uses);
    std::fs::write(&path, text).expect("written");
    let name = path.to_str().expect("text");
    let answer = run(&["verify", name]);
    assert_eq!(answer.code, Some(1), "{answer:?}");
    let told = "assertion: one: an assertion does not hold: at = 9\n";
    let also = "  also two (line 19), which has the same statements\n";
    assert!(answer.out.contains(told) && answer.out.contains(also), "{}", answer.out);
    assert!(answer.out.contains(": 1 finding\n"), "{}", answer.out);
    let said: serde_json::Value =
        serde_json::from_str(&run(&["verify", name, "--format", "json"]).out).expect("one line of JSON");
    assert_eq!(said["findings"][0]["also"], serde_json::json!(["two"]), "{said}");
}

#[test]
fn the_command_that_is_suggested_has_the_flags_that_led_there() {
    let (_folder, path) = cell("9", "");
    let name = path.to_str().expect("text").to_owned();
    let answer = run(&["verify", &name, "--loss", "1"]);
    let again = format!("step by step: imrs verify {name} --loss 1 --save FILE");
    assert!(answer.out.contains(&again), "{}", answer.out);
}

#[test]
fn a_check_of_what_never_changes_is_told() {
    let (_folder, path) = cell("0", "check small: never asker.at > 7;\n");
    let answer = run(&["verify", path.to_str().expect("text")]);
    assert_eq!(answer.code, Some(0), "{answer:?}");
    let told = "check `small`: asker.at = 0 in every state that was looked at";
    assert!(answer.out.contains(told), "{answer:?}");
    let answer = run(&["verify", path.to_str().expect("text"), "--format", "json"]);
    let said: serde_json::Value = serde_json::from_str(&answer.out).expect("one line of JSON");
    assert_eq!(said["claims"][0]["never_changed"][0], "asker.at = 0");
    let phase = &said["phases"][0];
    assert_eq!((&phase["with_faults"], &phase["bounds"]["loss"]), (&false.into(), &0.into()), "{said}");
}

#[test]
fn a_cell_that_the_checker_cannot_look_at_is_not_checked_and_not_found_wrong() {
    let cell = "examples/faulty/clerk_hands_a_ticket_on.cell";
    let answer = run(&["verify", cell]);
    assert_eq!(answer.code, Some(4), "{answer:?}");
    assert!(answer.out.contains("not checked: clerk keeps the number of a message"), "{answer:?}");
    assert!(answer.out.contains(&format!("  --> {cell}:27:5  receive ask()")), "{answer:?}");
    let answer = run(&["verify", cell, "--format", "json"]);
    let said: serde_json::Value = serde_json::from_str(&answer.out).expect("one line of JSON");
    assert_eq!(said["findings"], serde_json::json!([]), "{said}");
    assert_eq!((&said["not_checked"]["line"], &said["complete"]), (&27.into(), &false.into()), "{said}");
}

#[test]
fn a_search_that_is_cut_short_says_how_far_it_came() {
    // No machine finishes the search in this time.
    let answer = run(&["verify", "examples/shared_tool.cell", "--within", "1ms"]);
    assert_eq!(answer.code, Some(4), "{answer:?}");
    for told in [
        "cut short, out of time (0.001 s): ",
        " of these states were looked at (",
        " % of those found), and every order of events was looked at up to its choice ",
        "\n  to let it end: ",
        "give it more (`--within 10m`, `--memory 8G`)\n",
    ] {
        assert!(answer.out.contains(told), "{told}: {answer:?}");
    }
    let answer = run(&["verify", "examples/shared_tool.cell", "--within", "1ms", "--format", "json"]);
    let said: serde_json::Value = serde_json::from_str(&answer.out).expect("one line of JSON");
    let left = &said["phases"][0]["unfinished"];
    assert!(left["states"].as_u64() > Some(0) && left["sampled"].as_u64() > Some(0), "{said}");
}

#[test]
fn a_replayed_finding_is_told_step_by_step_as_text() {
    let (folder, path) = cell("9", "");
    let saved = folder.path().join("found.imrs");
    let (name, saved) = (path.to_str().expect("text"), saved.to_str().expect("text"));
    assert_eq!(run(&["verify", name, "--save", saved]).code, Some(1));
    let all = run(&["monitor", "--replay", saved, "--text"]);
    assert_eq!(all.code, Some(1), "{all:?}");
    let steps: Vec<&str> = all.out.split("\n\n").collect();
    assert!(steps[0].starts_with("  finding: assertion: asker"), "{}", all.out);
    assert!(steps[1].starts_with("step 0/") && steps[1].contains("happened: the start"), "{}", all.out);
    let last = steps.last().expect("the last step");
    assert!(last.contains("asker begins line 10: assert at < 9"), "{}", all.out);
    assert!(last.contains("happened: asker ASSERTION FAILS"), "{}", all.out);
    let number = format!("step {0}/{0} ", steps.len() - 2);
    assert!(last.starts_with(&number), "each step is there: {}", all.out);

    let once = run(&["monitor", "--replay", saved, "--text", "--once"]);
    assert!(once.out.starts_with("replay at ") && !once.out.contains("step 0/"), "{}", once.out);
    let one = run(&["monitor", "--replay", saved, "--text", "--at", "1"]);
    assert!(one.out.contains("tick 1\n") && !one.out.contains("ASSERTION"), "{}", one.out);
}

/// The reference must quote a finding exactly as the command prints it.
#[test]
fn the_finding_in_the_reference_is_what_is_said() {
    let page = std::fs::read_to_string("specs/language/faults-and-checks.md").expect("the page");
    let quoted = page.split("says first:\n\n```text\n").nth(1).and_then(|rest| rest.split("```").next());
    let answer = run(&["verify", "examples/faulty/camera_looks_too_long.cell"]);
    let printed = answer.out.split("  step by step").next().expect("a finding");
    assert_eq!(quoted, Some(printed), "{}", answer.out);
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

/// A model tick that is longer than an action does not lengthen the action. If the cell has times that are not
/// multiples of its tick, the findings say so.
#[test]
fn the_model_tick_rounds_nothing() {
    let text = |tick: &str| {
        let pair = PAIR
            .replace("tick 1 msec;", tick)
            .replace("receive where(x); ", "receive where(x); run halt takes 1..20 msec; ");
        pair.replace("{answer}", "x")
    };
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("pair.cell");
    let verify = |text: String| {
        std::fs::write(&path, text).expect("written");
        run(&["verify", path.to_str().expect("UTF-8")])
    };
    let whole = verify(text("tick 1 msec;"));
    assert_eq!(whole.code, Some(0), "{whole:?}");
    let coarse = verify(text("tick 1 msec; model tick 100 msec;"));
    assert_eq!(coarse.code, Some(0), "{coarse:?}");
    assert!(coarse.out.contains("at every tick"), "{coarse:?}");
    let some = run(&["verify", path.to_str().expect("UTF-8"), "--times", "every"]);
    assert_eq!(some.code, Some(0), "{some:?}");
    assert!(some.out.contains("of the times between the ends every 100 msec is looked at"), "{some:?}");

    let odd = text("tick 1 msec;").replace("time_out = 40 msec", "time_out = 22500 usec");
    let found = verify(odd);
    assert_eq!(found.code, Some(1), "{found:?}");
    assert!(found.out.contains("the model counts 22500 usec as 22000 usec"), "{found:?}");
    assert!(found.out.contains("not confirmed: these findings may come from the rounding"), "{found:?}");
}

/// The JSON answer also lists the statements that the search did not reach.
#[test]
fn statements_that_were_not_reached_are_told_to_programs() {
    let json = |text: &str, more: &[&str]| -> serde_json::Value {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("open.cell");
        std::fs::write(&path, text).expect("written");
        let args = [&["verify", path.to_str().expect("UTF-8"), "--format", "json"], more].concat();
        serde_json::from_str(&run(&args).out).expect("one line of JSON")
    };
    let lines = |list: &serde_json::Value| -> Vec<(String, u64)> {
        let places = list.as_array().expect("a list").iter();
        places
            .map(|of| (of["task"].as_str().expect("a name").to_owned(), of["line"].as_u64().expect("a line")))
            .collect()
    };
    let none: Vec<(String, u64)> = Vec::new();
    let sound = PAIR.replace("{answer}", "7");
    let said = json(&sound, &[]);
    assert_eq!(lines(&said["not_exercised"]), [("asker".to_owned(), 9)], "{said}");
    assert_eq!((lines(&said["not_tried"]), lines(&said["not_seen"])), (none.clone(), none.clone()), "{said}");
    assert_eq!(said["outside"], serde_json::json!([]), "{said}");
    // The search tries only some of the answers of an extern task, so some statements are not reached.
    let (head, _) = sound.split_once("  var x: int8;").expect("the variable of the teller");
    let outside = format!(
        "{}end teller;\n",
        head.replace("task teller on n2", "task teller on n2 extern rate = 1/10 msec")
    );
    let outside = outside
        .replace("  assert at < 9;", "  if at > 50 and at < 60 and at <> 51 and at <> 59 then skip; end;");
    let said = json(&outside, &[]);
    assert_eq!(lines(&said["not_tried"]), [("asker".to_owned(), 10)], "{said}");
    assert!(said["outside"].as_array().is_some_and(|values| values.contains(&0.into())), "{said}");
    // The search does not go on behind a finding that ends a path, so the verdict on the check stays unknown here.
    let failing = format!(
        "{}\ncheck c: always asker.at < 99;\n",
        sound.replace("assert at < 9;", "assert at < 7; skip;")
    );
    assert_eq!(json(&failing, &[])["claims"][0]["outcome"], "unknown");
    let said = json(&sound.replace("assert at < 9;", "assert at < 7; skip;"), &[]);
    assert!(lines(&said["not_seen"]).contains(&("asker".to_owned(), 10)), "{said}");
    assert_eq!(lines(&said["not_exercised"]), none, "{said}");
}

/// The third robot does not communicate with the pair. It is therefore searched, drawn and saved as a separate part of
/// the cell.
#[test]
fn independent_parts_are_told_and_replayed_one_by_one() {
    let alone = "node n3 at \"10.0.0.3\";\ntask loner on n3\n  var n: int8;\nbegin\n\
                 run turn takes 3 msec; n := n + 1; assert n < 1;\nend loner;\n";
    let (folder, path) = cell("7", alone);
    let name = path.to_str().expect("text");
    let [picture, film] = ["found.svg", "found.rec"].map(|name| folder.path().join(name));
    let [picture_name, film_name] = [&picture, &film].map(|path| path.to_str().expect("text"));
    let answer = run(&["verify", name, "--trace", picture_name, "--save", film_name]);
    assert_eq!(answer.code, Some(1), "{answer:?}");
    assert!(answer.out.contains("2 independent parts, each by itself: "), "{answer:?}");
    let drawn = std::fs::read_to_string(&picture).expect("a picture");
    assert!(drawn.contains(">loner</text>") && !drawn.contains(">asker</text>"), "{drawn}");
    let shown = run(&["monitor", "--replay", film_name, "--text"]);
    assert_eq!(shown.code, Some(1), "{shown:?}");
    assert!(shown.out.contains("loner ASSERTION FAILS"), "{shown:?}");
    assert!(shown.out.contains("is not looked at: it is in another part of the cell"), "{shown:?}");
    let json = run(&["verify", name, "--format", "json"]);
    assert!(json.out.contains("\"parts\":2"), "{json:?}");
}
