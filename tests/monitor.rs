//! End-to-end tests of `imrs monitor` in scripts and pipes: its output and exit codes.

use crate::support::live::Live;
use crate::support::{PATIENCE, Said, imrs, look_until, run, run_in, runtime_dir, signal, wait_until};
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::process::Stdio;
use std::time::Instant;

const ESCAPE: char = '\u{1b}';

/// Asserts the exit code, and that the complaint contains these words.
fn fails(said: &Said, code: i32, words: &[&str]) {
    assert_eq!(said.code, Some(code), "{said:?}");
    for word in words {
        assert!(said.err.contains(word), "`{word}` is missing: {said:?}");
    }
}

#[test]
fn one_demo_seen_through_pipes() {
    let demo = Live::steady();
    let monitor = |args: &[&str]| run_in(demo.dir(), &[&["monitor"], args].concat());

    let once_up = |args: &[&str], is_so: &dyn Fn(&Said) -> bool| {
        look_until(demo.dir(), &[&["monitor"], args].concat(), "all nodes are up", is_so)
    };

    // In a pipe, the monitor prints one sample as text without escapes, and ends.
    let piped = once_up(&[], &|said| said.out.contains("node nh: up"));
    assert!(matches!(piped.code, Some(0 | 1)), "{piped:?}");
    assert!(!piped.out.contains(ESCAPE), "{piped:?}");

    let three =
        |said: &Said| said.code != Some(3) && said.last_json()["nodes"].as_array().map(Vec::len) == Some(3);
    let once = once_up(&["--once", "--format", "json"], &three);
    assert_eq!(once.out.lines().count(), 1, "{once:?}");
    let report = once.last_json();
    assert_eq!(report["version"], 1, "{report}");

    // The three assertions are true, false, and malformed.
    once_up(&["--assert", "up==3 and nodes==3"], &|said| said.code == Some(0));
    let all = |said: &Said| format!("{}{}", said.out, said.err).contains("up = 3");
    let wrong = once_up(&["--assert", "up>=4"], &all);
    assert_eq!(wrong.code, Some(1), "{wrong:?}");
    fails(&monitor(&["--assert", "up >== 4"]), 2, &["up >== 4", "column 6"]);
    once_up(&["--assert", "up==3", "--for", "500ms"], &|said| said.code == Some(0));

    // With `--cell` the monitor shows only the requested cell.
    let other = once_up(&["--cell", "no-such-cell", "--once"], &|said| said.err.contains("no-such-cell"));
    fails(&other, 3, &["no node of cell `no-such-cell`", "beam_lift"]);
    fails(&monitor(&["--filter", "slakc<5ms", "--once"]), 2, &["did you mean `slack`"]);
}

#[test]
fn samples_come_until_the_reader_has_enough() {
    let demo = Live::steady();
    let cell = demo.dir().join("beam_lift.cell");
    let judge = ["--judge", cell.to_str().expect("UTF-8")];
    let args = [&["monitor", "--watch", "100ms", "--format", "json"], &judge[..]].concat();
    let mut child =
        imrs(demo.dir(), &args).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().expect("it starts");
    let mut lines = BufReader::new(child.stdout.take().expect("a pipe")).lines();
    let end = Instant::now() + PATIENCE;
    // Once a sample has all nodes, every later sample has them, too.
    let mut whole = 0;
    while whole < 5 {
        let line = lines.next().expect("a sample").expect("text");
        let report: Value = serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: {line}"));
        let nodes = report["nodes"].as_array().map(Vec::len);
        assert!(whole == 0 || nodes == Some(3), "{line}");
        assert!(Instant::now() < end, "{line}");
        whole += usize::from(nodes == Some(3));
    }
    // Each node records its inputs. The monitor replays them while the node runs, and they conform to the verified machine.
    loop {
        let line = lines.next().expect("a sample").expect("text");
        let report: Value = serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: {line}"));
        let nodes = report["nodes"].as_array().expect("nodes");
        assert!(nodes.iter().all(|node| node["conformance"] != "violates"), "{line}");
        let steps = |node: &Value| node["conforming_steps"].as_u64().unwrap_or(0);
        if nodes.iter().all(|node| node["conformance"] == "conforms" && steps(node) > 0) {
            break;
        }
        assert!(Instant::now() < end, "{line}");
    }
    drop(lines);
    let mut ended = None;
    wait_until("the monitor has noticed", || {
        ended = child.try_wait().expect("its state");
        ended.is_some()
    });
    assert!(matches!(ended.and_then(|status| status.code()), Some(0 | 1)), "{ended:?}");
}

#[test]
fn a_death_breaks_an_assertion() {
    let demo = Live::steady();
    let sees = |condition: &str| run_in(demo.dir(), &["monitor", "--assert", condition]).code == Some(0);
    wait_until("all are seen", || sees("up==3"));
    signal(demo.pid("nh"), rustix::process::Signal::KILL);
    wait_until("the death is seen", || sees("up==2"));
    look_until(demo.dir(), &["monitor", "--assert", "up==3"], "one is missing", |said| {
        assert_ne!(said.code, Some(0), "{said:?}");
        said.code == Some(1)
    });
}

#[test]
fn the_file_of_settings_is_read_and_its_slips_are_told() {
    let dir = runtime_dir();
    let example = run(&["monitor", "--config-example"]);
    assert_eq!(example.code, Some(0), "{example:?}");
    let file = |name: &str, text: &str| {
        let path = dir.path().join(name);
        std::fs::write(&path, text).expect("a file");
        path.to_str().expect("UTF-8").to_owned()
    };
    let monitor = |config: &str| run_in(dir.path(), &["monitor", "--config", config, "--once"]);
    // The example file is accepted, but there is no node to show.
    fails(&monitor(&file("example.toml", &example.out)), 3, &["no running node found"]);
    // If every line is uncommented, the only error is that the token file is missing.
    let all: String = example.out.lines().map(|line| uncommented(line) + "\n").collect();
    fails(&monitor(&file("all.toml", &all)), 2, &["/etc/imrs/observe.token"]);
    fails(
        &monitor(&file("slip.toml", "mouse = false\ncolour = true\n")),
        2,
        &["line 2", "colour", "slip.toml"],
    );
    fails(&monitor(&file("theme.toml", "theme = \"nonsense\"\n")), 2, &["nonsense", "contrast"]);
    fails(&monitor(&file("filter.toml", "filter = \"slakc<5ms\"\n")), 2, &["slakc"]);
    fails(&monitor("no-such-file.toml"), 2, &["no-such-file.toml"]);
    fails(&run_in(dir.path(), &["monitor", "--theme", "nonsense", "--once"]), 2, &["nonsense", "contrast"]);
    let schema = run(&["monitor", "--config-schema"]);
    assert!(schema.code == Some(0) && schema.out.contains("reduced_motion"), "{schema:?}");
}

/// For a line `#key = value`, the line without its `#`.
fn uncommented(line: &str) -> String {
    let key = line.strip_prefix('#').filter(|rest| rest.starts_with(|c: char| c.is_ascii_lowercase()));
    key.unwrap_or(line).to_owned()
}

#[test]
fn recordings_that_are_none_are_told() {
    let dir = runtime_dir();
    let none = dir.path().join("none.imrs");
    std::fs::write(&none, "this is no recording").expect("a file");
    let none = none.to_str().expect("UTF-8");
    fails(&run(&["monitor", "--replay", none, "--once"]), 2, &["none.imrs"]);
    fails(&run(&["export", none, "--to", "jsonl"]), 2, &["none.imrs"]);
    fails(&run(&["monitor", "--connect", "nowhere", "--once"]), 2, &["unix:PATH"]);
}
