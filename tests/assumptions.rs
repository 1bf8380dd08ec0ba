//! `imrs replay --model` names the assumptions of the checks that a run broke: packets lost or doubled, failed actions,
//! killed nodes, clocks that drifted apart, each compared with what the cell declares. The recordings come from real
//! runs with injected faults, or are altered in one respect. The verdicts are the same if this machine is late.

use crate::support::program::{one_after_the_other, times};
use crate::support::{Said, run_in, run_until, runtime_dir, tape};
use imrs_protocol::{Input, Kind, Packet};
use imrs_wire::recording::{Record, Stream};
use serde_json::Value;
use std::sync::LazyLock;

/// A cell of two nodes that exchange statuses all the time, and no commands.
const NEWS: &str = "\
cell news;
tick 10 msec;
node n1; node n2;
link n1 -- n2 delay 10 msec;
type Count is record n: int16; end;
task a on n1
  port there(c: Count) usage = send message_format = Count user_list = {b_hears} time_out = 20 sec class = 1 bounded_buffer[4];
  var c: Count;
begin
  loop run work takes 5..1000 msec on failed do c.n := 0; end; c.n := c.n mod 1000 + 1; send there(c); end;
end a;
task a_hears on n1
  use_port back(c: Count) usage = receive;
  var d: Count; var same: bool;
begin
  loop receive back(d); same := d.n = 0; end;
end a_hears;
task b on n2
  port back(c: Count) usage = send message_format = Count user_list = {a_hears} time_out = 20 sec class = 1 bounded_buffer[4];
  var c: Count;
begin
  loop run work takes 5..1000 msec on failed do c.n := 0; end; c.n := c.n mod 1000 + 1; send back(c); end;
end b;
task b_hears on n2
  use_port there(c: Count) usage = receive;
  var d: Count; var same: bool;
begin
  loop receive there(d); same := d.n = 0; end;
end b_hears;
";

/// The commands of two actions: one takes 50 ms, and the other one fails after 50 ms.
const WORKS: &str = "work=sleep 0.05";
const FAILS: &str = "work=timeout 0.05 sleep 9";
const NODES: [&str; 2] = ["n1", "n2"];

/// A recorded run of the cell. The declarations of `faults` do not change the run, so the same recording can be judged
/// under several of them.
struct Run(tempfile::TempDir);

impl Run {
    /// Runs the cell until `is_enough` accepts a line.
    fn of(args: &[&str], is_enough: impl FnMut(&str) -> bool) -> Self {
        let run = Self(runtime_dir());
        let (cell, file) = (run.cell(""), run.path("run.imrs"));
        let all = [&["run", &cell, "--record", &file, "--seed", "3"], args].concat();
        let said = run_until(run.0.path(), &all, is_enough);
        assert!(matches!(said.code, Some(0 | 1 | 5)), "{said:?}");
        run
    }

    /// A run without faults. All calls share one run, each with a copy of its recordings.
    fn well() -> Self {
        static FILES: LazyLock<[Vec<u8>; 2]> = LazyLock::new(|| {
            let run = Run::of(&["--action", WORKS, "--in-process"], dozens());
            NODES.map(|node| std::fs::read(run.file(node)).expect("a recording"))
        });
        let run = Self(runtime_dir());
        for (node, bytes) in NODES.into_iter().zip(&*FILES) {
            std::fs::write(run.file(node), bytes).expect("written");
        }
        run
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().expect("UTF-8").into()
    }

    /// The recording of a node.
    fn file(&self, node: &str) -> String {
        self.path(&format!("run.{node}.imrs"))
    }

    /// The file of the cell, in which these `faults` are declared.
    fn cell(&self, faults: &str) -> String {
        let cell = self.path("news.cell");
        std::fs::write(&cell, format!("{NEWS}{faults}\n")).expect("the cell is written");
        cell
    }

    fn follow(&self, faults: &str, format: &str) -> Said {
        let (cell, files) = (self.cell(faults), NODES.map(|node| self.file(node)));
        let how = ["replay", &files[0], &files[1], "--cell", &cell, "--model", "--format", format];
        run_in(self.0.path(), &how)
    }

    /// The broken assumptions of the run if these `faults` are declared: kind, text and count of each.
    fn breaches(&self, faults: &str) -> Vec<(String, String, u64)> {
        let said = self.follow(faults, "json");
        let told = said.last_json();
        assert_eq!((said.code, &told["path"]), (Some(0), &Value::Bool(true)), "{said:?}");
        let all = told["breaches"].as_array().expect("breaches").iter();
        let text = |breach: &Value, key: &str| breach[key].as_str().expect("text").to_owned();
        let all: Vec<_> =
            all.map(|b| (text(b, "kind"), text(b, "what"), b["times"].as_u64().expect("a number"))).collect();
        assert_eq!(told["within_assumptions"], all.is_empty(), "{told}");
        all
    }

    /// The assumption of this kind that the run broke if these `faults` are declared, and how often; `None` if the run
    /// broke none.
    fn breach(&self, faults: &str, kind: &str) -> Option<(String, u64)> {
        let all = self.breaches(faults);
        all.into_iter().find(|breach| breach.0 == kind).map(|(_, what, times)| (what, times))
    }

    /// Alters the recording of a node.
    fn change(&self, node: &str, change: impl FnOnce(&mut Vec<Record>)) {
        let file = self.file(node);
        tape::change(file.as_ref(), file.as_ref(), change);
    }
}

/// Accepts when the run has printed enough lines for some dozens of statuses.
fn dozens() -> impl FnMut(&str) -> bool {
    times(40, " begins work")
}

#[test]
fn a_run_without_faults_loses_doubles_and_fails_nothing() {
    let kinds: Vec<String> = Run::well().breaches("").into_iter().map(|(kind, ..)| kind).collect();
    // A delay may be found in any run, because it depends on this machine.
    assert!(kinds.iter().all(|kind| ["delay", "late"].contains(&kind.as_str())), "{kinds:?}");
}

#[test]
fn more_lost_packets_than_declared_are_named_and_as_many_are_not() {
    let some = Run::of(&["--action", WORKS, "--loss", "40%"], dozens());
    let (what, lost) = some.breach("faults loss 1;", "loss").expect("of some dozens a few are lost");
    assert_eq!(what, format!("{lost} packets never arrived, the cell declares `loss 1`"));
    let said = some.follow("faults loss 1;", "text");
    let line = format!("outside the assumptions: {what} (first at ");
    assert!(said.out.contains(&line), "{said:?}");
    let (what, lost) = some.breach("", "loss").expect("of some dozens a few are lost");
    assert_eq!(what, format!("{lost} packets never arrived, the cell declares no `loss`"));
    assert_eq!(some.breach("faults loss 250;", "loss"), None);
    let told_meanwhile =
        &[" s fault: nothing passes", "sends `", "sends `", "reach each other again", "sends `"];
    // The cut is long enough that two actions, each of which is a process, begin and end within it.
    let cut = ["--action", WORKS, "--cut", "n1--n2@500ms+6s"];
    let cut = Run::of(&cut, one_after_the_other(told_meanwhile));
    assert_eq!(cut.breach("faults loss 250;", "loss"), None);
    assert!(cut.breach("", "loss").is_some());
}

#[test]
fn faults_that_are_declared_apart_do_not_come_together() {
    let run = Run::of(&["--loss", "40%", "--action", FAILS], dozens());
    let faults = "faults loss 250;\nfaults fail 250;";
    let (what, _) = run.breach(faults, "together").expect("packets were lost and actions failed");
    assert!(what.ends_with("; no `faults` of the cell declares them together"), "{what}");
    assert_eq!((run.breach(faults, "loss"), run.breach(faults, "fail")), (None, None));
}

#[test]
fn a_killed_node_is_named_where_no_crash_of_it_is_declared() {
    let after_it = &[" s fault: node n2", " begins work", " begins work"];
    let run = Run::of(&["--action", WORKS, "--kill", "n2@1s"], one_after_the_other(after_it));
    let (what, _) = run.breach("faults crash n1;", "crash").expect("n2 was killed");
    assert!(what.starts_with("node n2 was killed") && what.ends_with("no `crash` of it"), "{what}");
    assert_eq!(run.breach("faults crash n1;\nfaults crash n2;", "crash"), None);
}

fn is_news(record: &Record) -> bool {
    matches!(record, Record::Input { input: Input::Packet(Packet { kind: Kind::Send, .. }), .. })
}

#[test]
fn a_packet_that_a_link_doubled_is_a_path_and_named() {
    let double = |run: &Run| {
        run.change("n2", |records| {
            let news: Vec<usize> = (0..records.len()).filter(|&at| is_news(&records[at])).collect();
            let [first, next, ..] = news[..] else { panic!("news") };
            // The copy arrives when the task waits again. The task's state machine drops it, so the machine's outputs
            // stay the same.
            let mut copy = records[first].clone();
            let Record::Input { task: doubled, elapsed, outputs, .. } = &mut copy else { panic!("an input") };
            let doubled = *doubled;
            elapsed.0 = 0;
            let before = records[..next].iter().rev().find_map(|record| match record {
                Record::Input { task, outputs, .. } if *task == doubled => Some(*outputs),
                _ => None,
            });
            *outputs = before.expect("the news itself");
            records.insert(next, copy);
            for record in records {
                if let Record::Close { task, inputs, .. } = record
                    && *task == doubled
                {
                    *inputs += 1;
                }
            }
        });
    };
    let run = Run::well();
    double(&run);
    let (what, _) = run.breach("faults loss 3;", "dup").expect("a copy");
    assert_eq!(what, "1 packet arrived twice, the cell declares no `dup`");
    assert_eq!(run.breach("faults dup 1;", "dup"), None);
}

/// The recording of a node with a fast clock differs from another recording only in its times.
#[test]
fn clocks_that_run_apart_are_named() {
    let slow_down = |run: &Run| {
        run.change("n2", |records| {
            // During such waits for an action or a status, no timer of the state machines runs.
            for record in records {
                if let Record::Input { elapsed, .. } = record
                    && elapsed.0 > 1_000
                {
                    elapsed.0 += elapsed.0 / 5;
                }
            }
        });
    };
    let run = Run::well();
    assert_eq!(run.breach("", "drift"), None);
    slow_down(&run);
    let (what, _) = run.breach("", "drift").expect("a fifth of a second and a half, less what packets take");
    assert!(what.starts_with("the clocks of n1 and n2 ran apart by at least "), "{what}");
    assert!(what.ends_with("the cell declares no `drift`"), "{what}");
    assert_eq!(run.breach("faults drift 250;", "drift"), None);
}

#[test]
fn of_a_run_with_a_gap_nothing_is_said() {
    let run = Run::well();
    run.change("n1", |records| {
        let at = records.iter().position(is_news).expect("news");
        let Record::Input { task, .. } = records[at] else { panic!("an input") };
        records[at] = Record::Gap { stream: Stream::Task(task), lost: 1 };
    });
    let said = run.follow("", "text");
    assert_eq!(said.code, Some(5), "{said:?}");
    let words = "INCOMPLETE: it is unknown whether this run is a path of the model: inputs of `a_hears` are missing in ";
    assert!(said.out.contains(words), "{said:?}");
    assert_eq!(run.follow("", "json").last_json()["path"], false);
}
