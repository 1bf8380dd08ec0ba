//! End-to-end tests of `imrs check`, `fmt`, `explain` and `graph`.

use crate::support::live::{Live, figure};
use crate::support::{Said, example, finish, imrs, run, runtime_dir};
use std::fs;
use std::path::Path;
use std::process::Stdio;
use tempfile::TempDir;

const ESCAPE: char = '\u{1b}';

/// Writes a file with these bytes into a folder of its own.
fn file(bytes: &[u8]) -> (TempDir, String) {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("x.cell");
    fs::write(&path, bytes).expect("a file");
    let path = path.to_str().expect("UTF-8").to_owned();
    (dir, path)
}

fn check_bytes(bytes: &[u8]) -> Said {
    let (_dir, path) = file(bytes);
    run(&["check", &path, "--format", "json"])
}

/// Runs a command with this text on its standard input.
fn run_with(args: &[&str], input: &str) -> Said {
    let (_dir, path) = file(input.as_bytes());
    let dir = runtime_dir();
    let mut command = imrs(dir.path(), args);
    command.stdin(Stdio::from(fs::File::open(path).expect("the input")));
    finish(command)
}

#[test]
fn good_warned_and_faulty_cells_end_with_0_0_and_1() {
    let good = run(&["check", &example("beam_lift.cell")]);
    assert_eq!(good.code, Some(0), "{good:?}");
    assert!(good.out.contains("cell `beam_lift` with 3 nodes, 3 tasks, 3 ports"), "{}", good.out);
    let warned = run(&["check", &example("faulty/halt_unheard.cell"), "--format", "json"]);
    assert_eq!(warned.code, Some(0), "{warned:?}");
    let report = warned.last_json();
    assert_eq!((&report["errors"], &report["warnings"]), (&0.into(), &1.into()), "{report}");
    assert_eq!((&report["version"], &report["cell"]), (&1.into(), &"beam_lift".into()));
    let faulty = run(&["check", &example("faulty/hoist_never_arrives.cell")]);
    assert_eq!(faulty.code, Some(1), "{faulty:?}");
    assert!(faulty.out.contains("error[E104]") && faulty.out.contains("hoist_never_arrives.cell:20:50"));
    assert_eq!(faulty.err, "");
    let paper = run(&["check", "--paper", &example("beam_lift.cell"), "--format", "json"]);
    assert_eq!(paper.code, Some(1));
    let codes: Vec<_> = paper.last_json()["diagnostics"].as_array().unwrap().clone();
    assert!(codes.iter().any(|found| found["code"] == "E117"), "{codes:?}");
    for verb in ["verify", "run"] {
        let refused = run(&[verb, "--paper", &example("beam_lift.cell")]);
        let said = format!("{}{}", refused.out, refused.err);
        assert!(matches!(refused.code, Some(1 | 2)) && said.contains("E117"), "{verb}: {refused:?}");
    }
}

#[test]
fn what_cannot_be_read_ends_with_2_and_is_named() {
    let dir = tempfile::tempdir().expect("a folder");
    let (_large, large) = file(&vec![b' '; 20 << 20]);
    let (_binary, binary) = file(b"cell c;\n\xff\xfe");
    let missing = dir.path().join("missing.cell");
    let (missing, folder) = (missing.to_str().unwrap(), dir.path().to_str().unwrap());
    for verb in ["check", "fmt", "graph"] {
        for (path, hint) in [
            (missing, "no such file"),
            (folder, "one cell file in it"),
            (&large, "16 MiB"),
            (&binary, "byte 8 (line 2)"),
        ] {
            let said = run(&[verb, path]);
            assert_eq!(said.code, Some(2), "{verb} {path}: {said:?}");
            assert!(said.err.contains(path) && said.err.contains(hint), "{verb}: {}", said.err);
            assert_eq!(said.out, "", "{verb} {path}");
        }
    }
}

#[test]
fn a_pipe_is_no_cell_file_and_is_not_waited_for() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("pipe.cell");
    let made = std::process::Command::new("mkfifo").arg(&path).status().expect("mkfifo");
    assert!(made.success(), "{made}");
    for verb in ["check", "verify", "run"] {
        let said = run(&[verb, path.to_str().expect("UTF-8")]);
        assert_eq!(said.code, Some(2), "{verb}: {said:?}");
        assert!(said.err.contains("not a regular file"), "{verb}: {said:?}");
    }
}

#[test]
fn strange_texts_are_findings_and_no_faults() {
    let mut seed = 0x9E37_79B9_u32;
    for round in 0..20 {
        let bytes: Vec<u8> = (0..2_000)
            .map(|_| {
                seed ^= seed << 13;
                seed ^= seed >> 17;
                seed ^= seed << 5;
                // Every second round has ASCII text, because a text with other bytes is rejected at once.
                (seed >> 8) as u8 & if round % 2 == 0 { 0x7f } else { 0xff }
            })
            .collect();
        let said = check_bytes(&bytes);
        assert_eq!(said.code, Some(if round % 2 == 0 { 1 } else { 2 }), "{said:?}");
    }
    assert_eq!(check_bytes(b"").code, Some(1));
}

#[test]
fn what_is_larger_or_deeper_than_is_looked_at_ends_with_2() {
    let blocks = format!("cell c; node n; task t on n begin {} end t;", "if true then ".repeat(50_000));
    let signs = format!("cell c; task t on n begin x := {}1; end t;", "(".repeat(100_000));
    let name = format!("cell c; tick 1 msec; node {};", "n".repeat(65));
    let script = format!(
        "cell c; tick 1 msec; node n; task t on n var x: int8; begin {} run go x; end t;",
        "x := x + 1; ".repeat(14_000)
    );
    for (text, code) in [(blocks, "E012"), (signs, "E012"), (name, "E012"), (script, "E123")] {
        let said = check_bytes(text.as_bytes());
        assert_eq!(said.code, Some(2), "{code}");
        let found = said.last_json()["diagnostics"].clone();
        assert!(found.as_array().is_some_and(|all| all.len() == 1) && found[0]["code"] == code, "{found}");
        let (_dir, path) = file(text.as_bytes());
        for verb in ["verify", "graph", "run"] {
            let said = run(&[verb, &path]);
            assert_eq!(said.code, Some(2), "{verb}, {code}: {said:?}");
            assert!(format!("{}{}", said.out, said.err).contains(code), "{verb}, {code}");
        }
    }
}

/// A file with errors of each phase: each error is reported, and also that not everything was checked.
#[test]
fn ten_different_errors_are_ten_diagnostics() {
    let text = include_str!("../language/tests/text/ten.cell");
    let said = check_bytes(text.as_bytes());
    assert_eq!(said.code, Some(1));
    let report = said.last_json();
    assert_eq!((&report["errors"], &report["warnings"]), (&10.into(), &0.into()), "{report}");
    let found = report["diagnostics"].as_array().expect("diagnostics");
    let place = |found: &serde_json::Value| {
        format!("{} {}", found["labels"][0]["start"]["line"], found["code"].as_str().unwrap())
    };
    let wrong = text.lines().enumerate();
    let wrong =
        wrong.filter_map(|(at, line)| Some(format!("{} {}", at + 1, line.split_once("// wrong: ")?.1)));
    assert_eq!(found.iter().map(place).collect::<Vec<_>>(), wrong.collect::<Vec<_>>());
    let unchecked = report["unchecked"].as_str().expect("what was not checked");
    let (_dir, path) = file(text.as_bytes());
    let shown = run(&["check", &path]).out;
    let lines: Vec<&str> = shown.lines().rev().take(3).collect();
    assert!(lines.iter().any(|line| *line == format!("note: {unchecked}")), "{lines:?}");
    assert!(run(&["check", &example("belt.cell"), "--format", "json"]).last_json()["unchecked"].is_null());
}

#[test]
fn colours_are_for_terminals_or_on_demand() {
    let path = example("faulty/both_active.cell");
    assert!(!run(&["check", &path]).out.contains(ESCAPE));
    assert!(run(&["check", &path, "--color", "always"]).out.contains(ESCAPE));
    let dir = runtime_dir();
    let mut quiet = imrs(dir.path(), &["check", &path]);
    quiet.env("NO_COLOR", "1");
    assert!(!finish(quiet).out.contains(ESCAPE));
}

#[test]
fn fmt_rewrites_checks_and_pipes() {
    let (_dir, path) = file(b"cell c;\nNODE   n;\n");
    let said = run(&["fmt", "--check", &path]);
    assert_eq!(said.code, Some(1), "{said:?}");
    assert!(said.out.contains("- NODE   n;\n+ node n;"), "{}", said.out);
    assert_eq!(fs::read_to_string(&path).unwrap(), "cell c;\nNODE   n;\n", "--check changes nothing");
    assert_eq!(run(&["fmt", &path]).code, Some(0));
    assert_eq!(fs::read_to_string(&path).unwrap(), "cell c;\nnode n;\n");
    let again = run(&["fmt", "--check", &path]);
    assert_eq!((again.code, again.out.as_str()), (Some(0), ""));
    let piped = run_with(&["fmt", "-"], "cell  c;\nnode n;\n");
    assert_eq!((piped.code, piped.out.as_str()), (Some(0), "cell c;\nnode n;\n"));
    // One file cannot be read. The command formats the other files nevertheless.
    let (_faulty, faulty) = file(b"cell c\nnode ;");
    let (_other, other) = file(b"cell  c;\n");
    let mixed = run(&["fmt", &faulty, &other]);
    assert_eq!(mixed.code, Some(1), "{mixed:?}");
    assert!(mixed.err.contains("error[E") && mixed.err.contains(&faulty), "{}", mixed.err);
    assert_eq!(fs::read_to_string(&faulty).unwrap(), "cell c\nnode ;", "what cannot be read is left alone");
    assert_eq!(fs::read_to_string(&other).unwrap(), "cell c;\n");
}

/// The cell's texts contain escapes that set a title, a one-byte control that clears the screen, and right-to-left text.
#[test]
fn what_a_cell_file_hides_reaches_no_terminal() {
    let hidden = "\u{1b}]0;owned\u{7} \u{9b}2J \u{202e}evil";
    let text = format!(
        "cell c; // {hidden}\ntick 1 msec;\nnode n at \"{hidden}\";\ntask t on n\n  var i: int8;\nbegin\n  \
         if i = 0 then abort \"{hidden}\"; end;\n  i := nosuch; // {hidden}\nend t;\n"
    );
    let (_dir, path) = file(text.as_bytes());
    let (_good, good) = file(text.replace("nosuch", "1").as_bytes());
    let raw = |said: &Said| {
        let shown = format!("{}{}", said.out, said.err);
        let styles_aside = shown.replace("\u{1b}[", "");
        styles_aside.chars().any(|c| matches!(c, '\u{1b}' | '\u{7}' | '\u{80}'..='\u{9f}' | '\u{202e}'))
    };
    for flags in [
        &["check", &path][..],
        &["check", &path, "--color", "always"],
        &["check", &path, "--format", "json"],
        &["verify", &good],
        &["verify", &good, "--color", "always"],
        &["verify", &good, "--format", "json"],
        &["run", &good, "--for", "1s"],
        &["run", &good, "--for", "1s", "--format", "json"],
        &["simulate", &good, "--seeds", "1"],
    ] {
        let said = run(flags);
        assert!(!raw(&said), "{flags:?} {said:?}");
        assert!(!said.out.contains("\\u{1b}["), "a style of its own: {flags:?} {said:?}");
        if flags.contains(&"json") {
            for line in said.out.lines() {
                serde_json::from_str::<serde_json::Value>(line).expect("JSON");
            }
        }
    }
    let piped = run_with(&["fmt", "-"], &text.replace("nosuch", "1"));
    assert!(piped.out.contains(hidden), "a file stays what it is: {piped:?}");
}

/// A limit on the size of files has the effect of a full disk.
#[test]
fn fmt_keeps_the_file_where_it_cannot_write_all_of_the_new_one() {
    let text = format!("cell  c;\nnode n;\n{}", "// a comment that takes room\n".repeat(500));
    let (dir, path) = file(text.as_bytes());
    let link = dir.path().join("link.cell");
    std::os::unix::fs::symlink(&path, &link).expect("a link");
    let limited = "trap '' XFSZ; ulimit -f 4; exec \"$0\" fmt \"$1\"";
    let own = runtime_dir();
    let mut command = std::process::Command::new("bash");
    command.args(["-c", limited, env!("CARGO_BIN_EXE_imrs"), &path]);
    command.env("XDG_RUNTIME_DIR", own.path()).stdin(Stdio::null());
    let said = finish(command);
    assert_eq!(said.code, Some(2), "{said:?}");
    assert!(said.err.contains("cannot be written"), "{said:?}");
    assert_eq!(fs::read_to_string(&path).unwrap(), text, "it is as it was");
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2, "and nothing is left beside it");
    // Root may write even a read-only file.
    fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o444)).unwrap();
    if fs::OpenOptions::new().write(true).open(&path).is_err() {
        assert_eq!(run(&["fmt", &path]).code, Some(2));
        assert_eq!(fs::read_to_string(&path).unwrap(), text, "it is as it was");
    }
    // A symbolic link stays a link, and its target keeps its permissions.
    fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o640)).unwrap();
    assert_eq!(run(&["fmt", link.to_str().unwrap()]).code, Some(0));
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    assert!(fs::read_to_string(&path).unwrap().starts_with("cell c;\n"));
    assert_eq!(
        std::os::unix::fs::PermissionsExt::mode(&fs::metadata(&path).unwrap().permissions()) & 0o777,
        0o640
    );
}

#[test]
fn times_are_written_as_in_cells_and_never_longer_than_a_century() {
    let cell = example("extern_task.cell");
    for time in ["1ms", "1 msec", "1 s", "1sec"] {
        let said = run(&["verify", &cell, "--within", time]);
        assert_ne!(said.code, Some(70), "{said:?}");
        assert!(!said.err.contains("invalid value"), "{said:?}");
    }
    for time in ["101years", "584942417355years", "18446744073709551615s", "soon"] {
        for flags in [
            &["verify", &cell, "--within", time][..],
            &["run", &cell, "--for", time],
            &["run", &cell, "--kill", &format!("a@{time}")],
        ] {
            let said = run(flags);
            assert_eq!(said.code, Some(2), "{flags:?} {said:?}");
            assert!(
                said.err.contains("century") || said.err.contains("write a number and a unit"),
                "{said:?}"
            );
        }
    }
}

#[test]
fn explain_lists_shows_and_guesses() {
    let list = run(&["explain"]);
    assert_eq!(list.code, Some(0));
    for code in ["E005", "E104", "W303", "N201"] {
        assert!(list.out.lines().any(|line| line.starts_with(code)), "{code} is not in the list");
        assert!(run(&["explain", code]).out.starts_with(&format!("{code}: ")));
    }
    let page = run(&["explain", "e104"]).out;
    assert!(page.contains("\nWrong:\n    cell c;\n") && page.contains("\nRight:\n    cell c;\n"), "{page}");
    assert!(!page.contains("```") && !page.contains("# ") && !page.contains(ESCAPE), "no Markdown:\n{page}");
    assert!(run(&["explain", "e104", "--color", "always"]).out.contains(ESCAPE));
    let misspelt = run(&["explain", "E1O4"]);
    assert_eq!(misspelt.code, Some(2), "{misspelt:?}");
    assert!(misspelt.err.contains("did you mean `E104`?"), "{}", misspelt.err);
    let unknown = run(&["explain", "zzz"]);
    assert!(unknown.code == Some(2) && unknown.err.contains("imrs explain"), "{unknown:?}");
    let json = run(&["explain", "W301", "--format", "json"]).last_json();
    assert_eq!(json["codes"][0]["code"], "W301");
    assert!(json["codes"][0]["explanation"].as_str().expect("a text").contains("```cell,right"));
}

#[test]
fn graphs_show_nodes_tasks_and_ports_and_are_the_same_each_time() {
    let path = example("weld_cell.cell");
    let svg = run(&["graph", &path]);
    assert_eq!(svg.code, Some(0), "{svg:?}");
    assert!(svg.out.starts_with("<svg ") && svg.out.ends_with("</svg>\n"), "{}", svg.out);
    for word in ["dresser", "r1", "n2", "grab: query, class 2, 200 ms", "links: n1 -- nt"] {
        assert!(svg.out.contains(word), "no {word}:\n{}", svg.out);
    }
    assert_eq!(svg.out, run(&["graph", &path, "--to", "svg"]).out);
    let dot = run(&["graph", &path, "--to", "dot"]);
    assert!(dot.out.starts_with("digraph \"weld\" {") && dot.out.ends_with("}\n"), "{}", dot.out);
    let (asked, told) = (2 + 1, 2 + 1);
    assert_eq!(dot.out.matches(" -> ").count(), 2 * asked + told, "there and back:\n{}", dot.out);
    assert_eq!(dot.out.matches('{').count(), dot.out.matches('}').count());
    let faulty = run(&["graph", &example("faulty/both_active.cell")]);
    assert_eq!((faulty.code, faulty.out.as_str()), (Some(1), ""));
    assert!(faulty.err.contains("error[E305]"), "{}", faulty.err);
}

#[test]
fn standard_input_is_a_file_like_any_other() {
    let text = fs::read_to_string(Path::new(&example("beam_lift.cell"))).unwrap();
    assert_eq!(run_with(&["check", "-"], &text).code, Some(0));
    let said = run_with(&["check", "-"], "cell c");
    assert_eq!(said.code, Some(1));
    assert!(said.out.contains("<stdin>"), "{}", said.out);
}

/// Two cells: a task that is busy when it gets a query, and two tasks that meet in loops of different speeds.
const BUSY: &str = "cell busy; tick 1 msec; node na; node nb; link na -- nb delay 1 msec;
task a on na port q() -> int8 usage = response user_list = {b} time_out = 30 msec;
begin on query q() do response(1); end; loop delay 1 sec; end; end a;
task b on nb use_port q() usage = query; var n: int8;
begin query q() -> n on time_out do skip; end; end b;
";
const LOOPS: &str = "cell loops; tick 1 msec; node na; node nb; link na -- nb delay 1 msec;
task a on na port m() usage = waitfor user_list = {b} time_out = 50 msec; var n: int8;
begin while n < 3 do waitfor m() on time_out do skip; end; n := n + 1; end; end a;
task b on nb use_port m() usage = waitfor; var n: int8;
begin while n < 3 do waitfor m() on time_out do skip; end; n := n + 1; delay 7 msec; end; end b;
";

#[test]
fn the_papers_own_rules_fail_where_the_decisions_hold() {
    for (cell, finding) in [(BUSY, "`q` starves: rejected"), (LOOPS, "waitfor `m` waits in vain for a")] {
        let (_dir, path) = file(cell.as_bytes());
        let decided = run(&["verify", &path, "--jobs", "1"]);
        assert_eq!(decided.code, Some(0), "{decided:?}");
        let literal = run(&["verify", &path, "--jobs", "1", "--paper"]);
        assert_eq!(literal.code, Some(1), "{literal:?}");
        assert!(literal.out.contains(finding), "{}", literal.out);
        assert!(
            literal.out.contains(" --paper --save FILE"),
            "the way to it takes the flag: {}",
            literal.out
        );
    }
}

/// A cell in which a tool lets one task wait while another task holds the tool.
const LATER: &str = r"cell later;
tick 1 msec;
node na; node nb; node nd;
link na -- nb delay 1 msec; link na -- nd delay 1 msec;
task tool on na
  port grab(n: int8) -> bool  usage = response  user_list = {b, d}  time_out = 3 sec  bounded_buffer[2];
  port free()  usage = receive  user_list = {b, d}  time_out = 1 sec  class = 2  bounded_buffer[2];
  var busy: bool; var b_waits, d_waits: bool;
begin
  order grab > free > self;
  on query grab(n) do
    if not busy then busy := true; response(true);
    elsif sender = b then b_waits := true;
    else d_waits := true;
    end;
  end;
  on receive free() do
    reply();
    if b_waits then b_waits := false; response grab(true) for b on failed do busy := false; end;
    elsif d_waits then d_waits := false; response grab(true) for d on failed do busy := false; end;
    else busy := false;
    end;
  end;
end tool;
task b on nb
  use_port grab(n: int8)  usage = query;  use_port free()  usage = send;
  var holds: bool;
begin
  query grab(1) -> holds;
  run weld takes 10..20 msec;
  holds := false;
  use_send free();
end b;
task d on nd
  use_port grab(n: int8)  usage = query;  use_port free()  usage = send;
  var holds: bool;
begin
  query grab(1) -> holds;
  run weld takes 10..20 msec;
  holds := false;
  use_send free();
end d;
check one: never b.holds and d.holds;
";

#[test]
fn an_answer_that_comes_later_is_checked_and_runs() {
    let (_dir, path) = file(LATER.as_bytes());
    let verified = run(&["verify", &path, "--jobs", "1"]);
    assert!(verified.code == Some(0) && verified.out.contains("the check holds"), "{verified:?}");
    // Both tasks return the tool, whichever of them had to wait, and however long this machine suspends their nodes.
    let dir = runtime_dir();
    let patient = LATER.replace("time_out = 1 sec", "time_out = 1000 sec");
    let (_patient_dir, path) = file(patient.replace("time_out = 3 sec", "time_out = 1000 sec").as_bytes());
    let ran = Live::start(dir.path(), &["run", &path, "--in-process"]);
    ran.until("the tool is back", |seen| figure(seen, "tool", "free", "delivered") >= 2);
    ran.interrupt();
    let (summary, code, errors) = ran.finish();
    assert_eq!(code, Some(0), "{summary} {errors}");
    let ports = summary["ports"].as_array().expect("ports");
    assert!(ports.len() == 2 && ports.iter().all(|port| port["delivered"] == 2), "{summary}");
}

#[test]
fn the_first_cell_of_the_reference_holds() {
    let page = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("specs/language/README.md"));
    let page = page.expect("the reference");
    let cell = page.split("```cell\n").nth(1).and_then(|rest| rest.split("```").next()).expect("a cell");
    let (_dir, path) = file(cell.as_bytes());
    let verified = run(&["verify", &path, "--jobs", "1", "--within", "5min"]);
    assert_eq!(verified.code, Some(0), "{verified:?}");
    assert!(verified.out.contains("nothing found, everything within these bounds"), "{}", verified.out);
}

/// The first message of an exchange goes to its receiver, and an answer goes back. At a waitfor each member sends to all others.
#[test]
fn the_arrows_of_a_graph_go_as_messages_do() {
    let expected: [(&str, &[&str]); 6] = [
        (
            "beam_lift",
            &[
                "t0 -> t1 lift: waitfor both",
                "t0 -> t2 lift: waitfor both",
                "t0 -> t1 beat: query",
                "t1 -> t0 beat: answer dashed",
                "t0 -> t1 halt: send",
                "t0 -> t2 halt: send",
            ],
        ),
        (
            "weld_cell",
            &[
                "t1 -> t0 grab: query",
                "t0 -> t1 grab: answer dashed",
                "t2 -> t0 grab: query",
                "t0 -> t2 grab: answer dashed",
                "t1 -> t0 free: send",
                "t2 -> t0 free: send",
                "t1 -> t2 prog: send",
                "t2 -> t1 alive: query",
                "t1 -> t2 alive: answer dashed",
            ],
        ),
        (
            "shared_tool",
            &[
                "t1 -> t0 grab: query",
                "t0 -> t1 grab: answer dashed",
                "t2 -> t0 grab: query",
                "t0 -> t2 grab: answer dashed",
                "t3 -> t0 grab: query",
                "t0 -> t3 grab: answer dashed",
                "t1 -> t0 free: send",
                "t2 -> t0 free: send",
                "t3 -> t0 free: send",
                "t0 -> t2 idle: send",
                "t0 -> t3 idle: send",
            ],
        ),
        (
            "conveyor",
            &[
                "t0 -> t1 pose: send",
                "t1 -> t2 coming: send",
                "t1 -> t2 give: waitfor both",
                "t2 -> t1 release: send",
            ],
        ),
        (
            "belt",
            &[
                "t0 -> t1 speed: send",
                "t0 -> t2 speed: send",
                "t1 -> t0 set_speed: query",
                "t0 -> t1 set_speed: answer dashed",
                "t2 -> t0 set_speed: query",
                "t0 -> t2 set_speed: answer dashed",
            ],
        ),
        ("extern_task", &["t0 -> t1 pose: send"]),
    ];
    for (name, expected) in expected {
        let dot = run(&["graph", &example(&format!("{name}.cell")), "--to", "dot"]).out;
        let edge = |line: &str| {
            let (ends, rest) = line.trim().split_once(" [label=\"")?;
            let (label, rest) = rest.split_once('"')?;
            let label = label.split(',').next()?;
            let dashed = if rest.contains("style=dashed") { " dashed" } else { "" };
            let both = if rest.contains("dir=both") { " both" } else { "" };
            ends.contains("->").then(|| format!("{ends} {label}{dashed}{both}"))
        };
        assert_eq!(dot.lines().filter_map(edge).collect::<Vec<_>>(), expected, "{name}");
        // In the SVG picture the heads of answers are white.
        let svg = run(&["graph", &example(&format!("{name}.cell"))]).out;
        let answers = expected.iter().any(|edge| edge.contains("answer"));
        assert_eq!(svg.contains("fill=\"white\" stroke=\"black\""), answers, "{name}");
    }
}
