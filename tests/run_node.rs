//! Tests of `imrs run CELL --node NAME`: nodes that are started one by one, at the addresses that their cell declares.

use crate::run::{Bench, port};
use crate::support::program::Program;
use crate::support::tape::Tape;
use crate::support::{imrs, look_until, number, own_address, run_in, signal};
use rustix::process::Signal;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::os::unix::process::ExitStatusExt;
use std::process::{Command, Stdio};

/// The cell of [`Bench`] with addresses for its two nodes, which are neighbours in this cell. The keys of the nodes are
/// in the folder beside it.
fn placed(bench: &Bench, host: Option<&str>) -> String {
    let cell = without_keys(bench, host);
    let made = run_in(bench.0.path(), &["keygen", &cell, "--force"]);
    assert_eq!(made.code, Some(0), "{made:?}");
    cell
}

fn without_keys(bench: &Bench, host: Option<&str>) -> String {
    let (own, [a, b]) = own_address();
    let host = host.map_or_else(|| own.to_string(), str::to_owned);
    let text = std::fs::read_to_string(bench.cell()).expect("the cell");
    let text = text
        .replace(
            "node na;  node nb;  node nm;",
            &format!("node na at \"{host}\" port {a}; node nb at \"{own}\" port {b};"),
        )
        .replace("link na -- nm delay 1 msec;  link nb -- nm delay 1 msec;", "link na -- nb delay 1 msec;");
    let file = bench.0.path().join("placed.cell");
    std::fs::write(&file, text).expect("the cell is written");
    file.to_str().expect("UTF-8").into()
}

#[test]
fn nodes_started_one_by_one_meet_at_their_declared_addresses_and_again_in_their_next_incarnations() {
    // A restarted node is held back for as long as messages to its earlier incarnation may still be in flight.
    let bench = Bench::that_waits(8);
    let cell = placed(&bench, None);
    let start = |node: &str| {
        let args = ["run", &cell, "--node", node, "--for", "10m", "--format", "json"];
        Program::start(imrs(bench.0.path(), &args))
    };
    for incarnation in 0..2 {
        let (b, a) = (start("nb"), start("na"));
        let a = a.finish();
        // The task of the other node now waits for a partner that has ended, so the test interrupts that node.
        b.interrupt();
        let b = b.finish();
        let summary = a.last_json();
        assert_eq!(a.code, Some(0), "incarnation {incarnation}: {a:?} {b:?}");
        assert_eq!(summary["tasks"][0]["end"], "finished", "{summary}");
        assert_eq!(number(&port(&summary, "ask")["sent"]), 5, "{summary}");
        // In the summary of one node, the arrivals at the other node are unknown.
        let meet = &summary["rendezvous"][0];
        assert_eq!((&meet["false_releases"], &meet["start_skew_us"]), (&Value::Null, &Value::Null), "{meet}");
        assert_eq!(summary["nodes"].as_array().map(Vec::len), Some(1), "{summary}");
        let remembered = std::fs::read_to_string(bench.0.path().join("state/imrs/relayed/na.life"))
            .expect("its incarnation");
        assert_eq!(remembered.trim(), incarnation.to_string());
    }
}

/// The text of a summary as JSON, and the exit code.
fn summed_up(bench: &Bench, args: &[&str]) -> (Option<i32>, Value, String) {
    let said = run_in(bench.0.path(), &[&["summary"], args, &["--format", "json"]].concat());
    (said.code, serde_json::from_str(&said.out).unwrap_or_default(), said.err)
}

#[test]
fn the_reports_of_nodes_that_ran_apart_give_one_summary() {
    let bench = Bench::that_waits(8);
    let cell = placed(&bench, None);
    let [a, b] = ["na", "nb"].map(|node| bench.0.path().join(format!("{node}.json")));
    let [a, b] = [&a, &b].map(|path| path.to_str().expect("UTF-8"));
    let start = |node: &str, report: &str| {
        let args = ["run", &cell, "--node", node, "--for", "10m", "--report", report];
        Program::start(imrs(bench.0.path(), &args))
    };
    let (other, own) = (start("nb", b), start("na", a));
    let own = own.finish();
    other.interrupt();
    let other = other.finish();
    assert_eq!((own.code, other.code), (Some(0), Some(0)), "{own:?} {other:?}");

    let (code, both, err) = summed_up(&bench, &[&cell, a, b]);
    let names: Vec<_> = both["nodes"].as_array().expect("nodes").iter().map(|node| &node["name"]).collect();
    assert_eq!(names, ["na", "nb"], "{both}");
    let ask = port(&both, "ask");
    assert_eq!(
        (number(&ask["sent"]), number(&ask["delivered"])),
        (5, 5),
        "each end counts its own part: {ask}"
    );
    let meet = &both["rendezvous"][0];
    assert_eq!((&meet["false_releases"], &meet["start_skew_us"]), (&0.into(), &Value::Null), "{meet}");
    assert!(number(&meet["released"]) > 0 && number(&meet["unknown"]) == 0, "{meet}");
    let judged = both["incomplete"].as_array().is_some_and(Vec::is_empty);
    assert_eq!(code, Some(if judged { 0 } else { 5 }), "{both} {err}");
    let text = run_in(bench.0.path(), &["summary", &cell, a, b]);
    assert!(text.out.contains("false releases: 0") && text.out.contains("  node nb "), "{text:?}");

    let (code, one, err) = summed_up(&bench, &[&cell, a]);
    assert_eq!((code, &one["rendezvous"][0]["false_releases"]), (Some(5), &Value::Null), "{one}");
    assert!(err.contains("incomplete: node nb has no report"), "{err}");

    // Files and options that cannot be used are refused by name, and no file is replaced.
    let text = std::fs::read_to_string(&cell).expect("the cell");
    let changed = format!("{cell}.changed");
    std::fs::write(&changed, text.replace("delay 1 msec", "delay 2 msec")).expect("a cell");
    for (args, words) in [
        ([&*changed, a], "na.json: is a report of another cell: its declarations differ"),
        ([&*cell, &*cell], "placed.cell: is no report of a run"),
        ([&*cell, "gone.json"], "gone.json: "),
    ] {
        let (code, _, err) = summed_up(&bench, &args);
        assert!(code == Some(2) && err.contains(words), "{args:?}: {err}");
    }
    let again = start("na", a).finish();
    assert!(
        again.code == Some(2) && again.err.contains("na.json") && again.err.contains("--force"),
        "{again:?}"
    );
}

#[test]
fn a_node_without_a_place_to_run_is_told_what_is_missing() {
    let bench = Bench::new();
    let (bare, far) = (bench.cell(), placed(&bench, Some("192.0.2.7")));
    let unkeyed = format!("{far}.unkeyed");
    std::fs::copy(&far, &unkeyed).expect("a cell");
    let bare = bare.to_str().expect("UTF-8");
    for (cell, args, words) in [
        (
            bare,
            &["--node", "na"][..],
            "node `na` has no address: write `node na at \"10.0.0.11\" port 7000;`",
        ),
        (bare, &["--node", "nx"], "the cell has no node `nx`"),
        (&unkeyed, &["--node", "na"], "node `na` has no keys"),
        (&unkeyed, &["--node", "nb"], "imrs keygen "),
        (&unkeyed, &["--node", "nb"], "--insecure on all nodes"),
        (&unkeyed, &["--node", "nb", "--keys", "/no/folder"], "the keys /no/folder/nb.keys: "),
        (&far, &["--node", "na"], "cannot bind UDP address 192.0.2.7"),
        (&far, &["--node", "na", "--insecure"], "cannot bind UDP address 192.0.2.7"),
        (&far, &["--node", "nb", "--kill", "na@1s"], "`na` is not run here"),
        (
            &far,
            &["--node", "nb", "--action", "grip=true"],
            "--action grip: node `nb` runs no task with this action, but task `a` on node `na` does",
        ),
        (bare, &["--observe", "0.0.0.0:0"], "--observe 0.0.0.0:0: all who reach this address"),
        (bare, &["--observe", "127.0.0.1:0"], "on a loopback address each user of this machine"),
        (bare, &["--observe", "0.0.0.0:0"], "--observe-token FILE"),
        (bare, &["--observe", "0.0.0.0:0", "--observe-token", "/no/token"], "the token /no/token: "),
        (bare, &["--restart", "na@1s"], "`na@1s` is not killed before it is started again"),
    ] {
        let said = run_in(bench.0.path(), &[&["run", cell, "--for", "2s"], args].concat());
        assert_eq!(said.code, Some(2), "{args:?}: {said:?}");
        assert!(said.err.contains(words), "{args:?} does not say `{words}`: {}", said.err);
    }
}

/// If failed starts were counted, 130 of them would make the number of the real start look older than the last one,
/// and the node's neighbours would ignore it silently.
#[test]
fn failed_starts_count_nothing_and_the_real_one_is_heard() {
    // A restarted node is held back for as long as messages to its earlier incarnation may still be in flight.
    let bench = Bench::that_waits(8);
    let cell = placed(&bench, None);
    let incarnation = bench.0.path().join("state/imrs/relayed/na.life");
    let args = |node: &'static str| {
        [
            "run".to_owned(),
            cell.clone(),
            "--node".into(),
            node.into(),
            "--for".into(),
            "10m".into(),
            "--format".into(),
            "json".into(),
        ]
    };
    let start = |node| Program::start(imrs(bench.0.path(), &args(node).each_ref().map(String::as_str)));
    let meet = || {
        let (b, a) = (start("nb"), start("na"));
        let a = a.finish();
        b.interrupt();
        (a, b.finish())
    };
    let (a, b) = meet();
    assert_eq!(a.code, Some(0), "{a:?} {b:?}");
    let (own, port) = {
        let text = std::fs::read_to_string(&cell).expect("the cell");
        let rest = text.split("node na at \"").nth(1).expect("its address").to_owned();
        let (host, rest) = rest.split_once("\" port ").expect("its port");
        (host.to_owned(), rest.split(';').next().expect("a number").parse::<u16>().expect("a number"))
    };
    let taken = std::net::UdpSocket::bind((own.as_str(), port)).expect("the address of na");
    for _ in 0..130 {
        let said = run_in(bench.0.path(), &args("na").each_ref().map(String::as_str));
        assert_eq!(said.code, Some(2), "{said:?}");
        assert!(said.err.contains("cannot bind UDP address"), "{said:?}");
    }
    drop(taken);
    assert_eq!(std::fs::read_to_string(&incarnation).expect("its incarnation").trim(), "0");
    // Both nodes restart from their own stored incarnations.
    let (a, b) = meet();
    assert_eq!(a.code, Some(0), "{a:?} {b:?}");
    assert_eq!(std::fs::read_to_string(&incarnation).expect("its incarnation").trim(), "1");
}

#[test]
fn a_node_that_has_lost_its_state_takes_a_later_incarnation_than_its_neighbour_remembers() {
    let bench = Bench::new();
    let cell = placed(&bench, None);
    let start = |node: &str| {
        let args = ["run", &cell, "--node", node, "--for", "10m", "--format", "json"];
        Program::start(imrs(bench.0.path(), &args))
    };
    let incarnation = bench.0.path().join("state/imrs/relayed/na.life");
    let (b, a) = (start("nb"), start("na"));
    let a = a.finish();
    assert_eq!(a.code, Some(0), "{a:?}");
    assert_eq!(std::fs::read_to_string(&incarnation).expect("its state").trim(), "0");
    std::fs::remove_file(&incarnation).expect("its state is lost");
    // nb still waits for na, and remembers na's incarnation.
    let mut again = start("na");
    let _started = again.json();
    assert_eq!(std::fs::read_to_string(&incarnation).expect("its state").trim(), "1");
    again.interrupt();
    let again = again.finish();
    assert!(again.err.contains("a neighbour remembers a later incarnation"), "{again:?}");
    b.interrupt();
    b.finish();
}

#[test]
fn a_node_that_runs_already_is_not_started_again() {
    let bench = Bench::new();
    let cell = placed(&bench, None);
    let args = ["run", &cell, "--node", "nb", "--for", "10m", "--format", "json"];
    let mut first = Program::start(imrs(bench.0.path(), &args));
    let _started = first.json();
    let pid = std::fs::read_to_string(bench.0.path().join("state/imrs/relayed/nb.lock")).expect("a lock");
    let said = run_in(bench.0.path(), &args);
    assert_eq!(said.code, Some(2), "{said:?}");
    assert!(
        said.err.contains(&format!("runs already on this machine, as process {}", pid.trim())),
        "{said:?}"
    );
    first.interrupt();
    first.finish();
}

#[test]
fn nodes_of_two_cell_files_say_so_on_both_sides() {
    let bench = Bench::new();
    let cell = placed(&bench, None);
    let text = std::fs::read_to_string(&cell).expect("the cell");
    for (from, to, what) in [
        ("q.n + 1);", "q.n + 2);", "their statements differ"),
        ("delay 1 msec", "delay 2 msec", "their declarations differ"),
    ] {
        assert!(text.contains(from));
        let other = bench.0.path().join("other.cell");
        std::fs::write(&other, text.replace(from, to)).expect("a file");
        let keys = bench.0.path().join("placed.keys");
        let args = |cell: &str, node: &str| {
            let keys = keys.to_str().expect("UTF-8");
            ["run", cell, "--node", node, "--keys", keys, "--for", "4s", "--format", "json"]
                .map(str::to_owned)
        };
        let start = |cell: &str, node: &str| {
            Program::start(imrs(bench.0.path(), &args(cell, node).each_ref().map(String::as_str)))
        };
        let (b, a) = (start(other.to_str().expect("UTF-8"), "nb"), start(&cell, "na"));
        for said in [a.finish(), b.finish()] {
            assert_eq!(said.code, Some(1), "{said:?}");
            assert!(said.err.contains(what), "{said:?}");
            let summary = said.last_json();
            assert_eq!(summary["nodes"][0]["refusals"].as_array().map(Vec::len), Some(1), "{summary}");
        }
    }
}

/// Two nodes with `--insecure` meet, and report that they have no keys. The headers of all recordings say so, too.
#[test]
fn nodes_without_keys_run_only_if_asked_to_and_say_so_everywhere() {
    let bench = Bench::that_waits(8);
    let cell = without_keys(&bench, None);
    let file = bench.0.path().join("run.imrs");
    let start = |node: &str| {
        let record = file.to_str().expect("UTF-8");
        let args = ["run", &cell, "--node", node, "--for", "10m", "--insecure", "--record", record];
        Program::start(imrs(bench.0.path(), &args))
    };
    let (b, a) = (start("nb"), start("na"));
    let a = a.finish();
    let seen = bench.0.path().join("seen.imrs");
    let monitor = ["monitor", "--record", seen.to_str().expect("UTF-8"), "--for", "100ms", "--force"];
    look_until(bench.0.path(), &monitor, "a monitor records", |said| said.code == Some(0));
    assert!(Tape::read(&seen).header.insecure);
    b.interrupt();
    let b = b.finish();
    assert_eq!(a.code, Some(0), "{a:?} {b:?}");
    for said in [&a, &b] {
        assert!(said.out.contains("INSECURE"), "{said:?}");
    }
    let na = bench.0.path().join("run.na.imrs");
    let replayed = run_in(bench.0.path(), &["replay", na.to_str().expect("UTF-8"), "--cell", &cell]);
    assert!(replayed.out.contains("INSECURE"), "{replayed:?}");
}

/// The key of a node is in its memory, which the kernel writes to no core file.
#[test]
fn a_node_with_keys_leaves_no_core_file() {
    let bench = Bench::new();
    let cell = placed(&bench, None);
    let dumps = |node: &str, how: &str| {
        let imrs = imrs(bench.0.path(), &["run", &cell, "--node", node, "--for", "10m"]);
        let mut shell = Command::new("sh");
        shell.args(["-c", "ulimit -c unlimited; exec \"$@\"", "sh"]).arg(imrs.get_program());
        shell.args(imrs.get_args()).args(how.split_whitespace()).current_dir(bench.0.path());
        shell.envs(imrs.get_envs().filter_map(|(name, value)| Some((name, value?))));
        let mut node = shell.stdout(Stdio::piped()).spawn().expect("it starts");
        // The node prints its first line once it runs.
        let mut line = String::new();
        let mut out = BufReader::new(node.stdout.take().expect("a pipe"));
        out.read_line(&mut line).expect("a line");
        signal(node.id(), Signal::ILL);
        let status = node.wait().expect("its end");
        assert_eq!(status.signal(), Some(Signal::ILL.as_raw()), "{line}");
        status.core_dumped()
    };
    assert!(!dumps("na", ""), "a core file with keys");
    if !dumps("nb", "--insecure") {
        eprintln!("this system writes no core files: a node with keys would not have left one in any case");
    }
}
