//! Tests that a run of `imrs run` is a path of the model that `imrs verify` explores. Nodes and links may be as late as the
//! machine makes them: lateness is reported, but no true run is called impossible.

mod recorded;
mod stopped;
mod unsent;

use crate::support::program::{all_of, one_after_the_other, times};
use crate::support::{Said, excused, run_in, runtime_dir, side_by_side, tape, tried_again};
use imrs_protocol::{Input, Kind, Packet, Seq24, Ticks};
use imrs_wire::recording::{Record, ScriptStep};
use recorded::{Recorded, is_path, no_path, number, path_of};
use serde_json::Value;
use std::path::PathBuf;

const BEAM: &str = "beam_lift.cell";
const WELD: &str = "weld_cell.cell";

const IN_PROCESSES: &[&str] = &["--seed", "5"];
const IN_ONE: &[&str] = &["--seed", "6", "--in-process"];

/// Returns a function that returns true once both arms have stopped after this many lifts.
fn lifts(number: usize) -> impl FnMut(&str) -> bool {
    times(2 * number, " ends stop_now")
}

/// Whether the arms gave up the lift. They do so if a node is suspended for longer than their time_out.
fn is_given_up(run: &Recorded) -> bool {
    let is_so = run.said.contains("partner missing") || run.said.contains("arms missing");
    if is_so {
        excused("a partner stood still for longer than the time_out of the lift");
    }
    is_so
}

#[test]
fn a_beam_lift_is_a_path_of_the_model() {
    side_by_side([IN_PROCESSES, IN_ONE], |how| {
        let run = Recorded::of(BEAM, how, lifts(3));
        let Some(told) = path_of(&run) else { return };
        if is_given_up(&run) {
            return;
        }
        // The arms grip, meet and lift, with heartbeats, height readings and answers.
        assert!(number(&told, "inputs") > 50 && number(&told, "turns") > 50, "{told}");
        assert!(number(&told, "moves") >= number(&told, "inputs") / 2, "{told}");
        assert!(number(&told, "kinds") > 10, "{told}");
    });
}

#[test]
fn a_weld_is_a_path_of_the_model() {
    side_by_side([IN_PROCESSES, IN_ONE], |how| {
        // On a late machine r1 may lose its lease at once, or begin to weld when few heartbeats have come through.
        tried_again("r1 began to weld without enough heartbeats", || {
            let run = Recorded::of(WELD, how, times(1, " begins weld"));
            path_of(&run).is_none_or(|told| number(&told, "inputs") > 50 && number(&told, "turns") > 10)
        });
    });
}

#[test]
fn lifts_with_faults_are_paths_of_the_model() {
    let cases: [(&[&str], &[&str]); 3] = [
        (&["--loss", "5%"], &["ends stop_now"; 6]),
        (&["--cut", "nl--nr@1s+40ms"], &["reach each other again", "ends stop_now", "ends stop_now"]),
        (&["--kill", "hoist@1500ms"], &[" s fault: node", "waits at `lift`", "waits at `lift`"]),
    ];
    side_by_side(in_both_ways(cases), |((fault, until), how)| {
        let run = Recorded::of(BEAM, &[how, fault].concat(), one_after_the_other(until));
        path_of(&run);
    });
}

#[test]
fn welds_with_faults_are_paths_of_the_model() {
    let cases: [(&[&str], &[&str]); 3] = [
        (&["--loss", "5%"], &["begins weld"]),
        (&["--cut", "n1--nt@1s+300ms"], &["reach each other again", "TAKES OVER"]),
        (&["--kill", "r1@1500ms"], &[" s fault: node", "TAKES OVER"]),
    ];
    side_by_side(in_both_ways(cases), |((fault, until), how)| {
        // On a late machine r1 may lose its lease before the fault comes, or get none in time, and then there are no heartbeats
        // that the fault could take.
        tried_again(&format!("{fault:?} took no heartbeat"), || {
            let run = Recorded::of(WELD, &[how, fault].concat(), all_of(until));
            path_of(&run).is_none_or(|told| !told["lost"].as_array().expect("links").is_empty())
        });
    });
}

fn in_both_ways<A: Copy>(cases: [A; 3]) -> impl Iterator<Item = (A, &'static [&'static str])> {
    cases.into_iter().flat_map(|case| [(case, IN_PROCESSES), (case, IN_ONE)])
}

#[test]
fn nodes_of_two_runs_are_no_run() {
    let [one, other] = ["11", "12"].map(|seed| {
        let run = Recorded::of(BEAM, &["--seed", seed, "--in-process"], lifts(1));
        // The pause puts a clear gap between the end of one run and the beginning of the other.
        std::thread::sleep(std::time::Duration::from_millis(300));
        run
    });
    let mut files = one.files();
    files[0] = other.file("nl");
    // Each recording by itself replays with bit-equal outputs.
    for file in &files {
        let file = file.to_str().expect("UTF-8");
        let said = run_in(one.folder.path(), &["replay", file, "--cell", &one.cell]);
        // The exit code may be 5, if the disk was so slow that the recording has no end.
        assert!(matches!(said.code, Some(0 | 5)), "{said:?}");
    }
    let mixed = one.follow(&files);
    assert_eq!(mixed.code, Some(2), "{mixed:?}");
    assert!(mixed.err.contains("these are of two runs: "), "{mixed:?}");
    files = one.files();
    files.push(one.file("nl"));
    let twice = one.follow(&files);
    assert_eq!(twice.code, Some(2), "{twice:?}");
    assert!(twice.err.contains("node nl is given twice: "), "{twice:?}");
}

/// A restarted node has several recordings of one run. The model does not follow such a node, so the result is unknown.
#[test]
fn of_a_run_with_a_restart_nothing_is_known() {
    for how in [IN_PROCESSES, IN_ONE] {
        let run = Recorded::restarted_weld(how);
        let (first, second) = (run.file("nt"), run.file("nt-2"));
        let others = [run.file("n1"), run.file("n2")];
        let with = |files: &[&PathBuf]| -> Vec<PathBuf> {
            others.iter().chain(files.iter().copied()).cloned().collect()
        };
        // On a late machine the second incarnation may have recorded nothing.
        let nothing = run.folder.path().join("nothing.nt-2.imrs");
        tape::change(&second, &nothing, |records| {
            records.retain(|record| matches!(record, Record::Header(_) | Record::End));
        });
        let mut given = vec![with(&[&first, &second]), with(&[&second, &first]), with(&[&first, &nothing])];
        // An answer of the first incarnation shows that the recording of that incarnation is missing.
        let before = run.said.split(" is killed").next().unwrap_or_default();
        if before.contains("begins dress") {
            given.extend([with(&[&second]), with(&[&nothing])]);
        } else {
            excused("the tool had not answered before its node was killed");
        }
        for files in given {
            let said = run.follow(&files);
            assert_eq!(said.code, Some(5), "{files:?}: {said:?}");
            let told = said.last_json();
            assert_eq!(
                (&told["path"], &told["complete"]),
                (&Value::from(false), &Value::from(false)),
                "{told}"
            );
            let why = told["unknown"].as_str().expect("a reason");
            assert!(why.starts_with("node nt was restarted in it, and the model follows"), "{why}");
        }
        let twice = run.follow(&with(&[&second, &second]));
        assert_eq!(twice.code, Some(2), "{twice:?}");
        assert!(twice.err.contains("node nt is given twice: "), "{twice:?}");

        // A recording of another run is refused, whether that run was before or after this one.
        std::thread::sleep(std::time::Duration::from_millis(300));
        let other = Recorded::restarted_weld(how);
        let mixed = run.follow(&with(&[&first, &other.file("nt-2")]));
        assert_eq!(mixed.code, Some(2), "{mixed:?}");
        assert!(mixed.err.contains("these are of two runs: "), "{mixed:?}");
        let mixed = other.follow(&[other.file("n1"), other.file("n2"), other.file("nt"), second]);
        assert_eq!(mixed.code, Some(2), "{mixed:?}");
        assert!(mixed.err.contains("these are of two runs: "), "{mixed:?}");
    }
}

#[test]
fn of_a_cell_of_one_node_a_restart_leaves_a_gap() {
    let folder = runtime_dir();
    let cell = folder.path().join("own.cell");
    std::fs::write(&cell, GRIPS).expect("the cell is written");
    let cell = cell.to_str().expect("UTF-8").into();
    let run = Recorded::restarted(folder, cell, &["n"], "n", &[]);
    let said = run.follow(&[run.file("n"), run.file("n-2")]);
    assert_eq!(said.code, Some(5), "{said:?}");
}

#[test]
fn what_nobody_sent_is_no_path() {
    // `start_lift` of armL ends only after an answer of the other arm.
    let (mut lifted, mut answered) = (lifts(3), false);
    let run = Recorded::of(BEAM, IN_ONE, |line| {
        answered |= line.contains("armL") && line.contains("ends start_lift");
        lifted(line) && answered
    });
    if is_given_up(&run) || path_of(&run).is_none() {
        return;
    }
    // The inserted packet is an answer without a query, which armL's own state machine ignores.
    let files = run.change("nl", |records| {
        let answer = |record: &Record| {
            matches!(record, Record::Input { input: Input::Packet(Packet { kind: Kind::Response, .. }), .. })
        };
        let at = records.iter().position(answer).expect("an answer to a beat");
        let outputs = records[..at].iter().rev().find_map(|record| match record {
            Record::Input { outputs, .. } => Some(*outputs),
            _ => None,
        });
        let mut forged = records[at].clone();
        if let Record::Input { input: Input::Packet(packet), elapsed, outputs: digest, .. } = &mut forged {
            packet.id.sequence = Seq24::default().plus(70_000);
            (*elapsed, *digest) = (Ticks::ZERO, outputs.expect("an input before it"));
        }
        records.insert(at, forged);
        // The count of inputs in the last record is changed, too, because it alone would reveal the alteration.
        for record in records {
            if let Record::Close { inputs, .. } = record {
                *inputs += 1;
            }
        }
    });
    let [node, task, why] = no_path(&run.follow(&files));
    assert_eq!((node.as_str(), task.as_str()), ("nl", "armL"));
    assert!(why.contains("that the model has not sent"), "{why}");
}

#[test]
fn another_outcome_is_not_what_the_task_did() {
    let run = Recorded::of(BEAM, IN_ONE, lifts(1));
    if path_of(&run).is_none() {
        return;
    }
    let acted =
        |record: &&mut Record| matches!(record, Record::Script { step: ScriptStep::Acted { .. }, .. });
    let files = run.change("nl", |records| {
        let record = records.iter_mut().find(acted).expect("an action that ended");
        if let Record::Script { step: ScriptStep::Acted { ok, .. }, .. } = record {
            *ok = !*ok;
        }
    });
    let [node, task, _] = no_path(&run.follow(&files));
    assert_eq!((node.as_str(), task.as_str()), ("nl", "armL"));
}

#[test]
fn a_member_that_never_heard_of_the_others_is_not_released() {
    let run = Recorded::of(BEAM, IN_ONE, lifts(1));
    if path_of(&run).is_none() {
        return;
    }
    let meets = |record: &Record| {
        matches!(
            record,
            Record::Input { input: Input::Packet(Packet { kind: Kind::Arrive | Kind::Confirm, .. }), .. }
        )
    };
    let files = run.change("nh", |records| {
        let before = records.len();
        records.retain(|record| !meets(record));
        assert!(records.len() < before);
    });
    let [node, task, _] = no_path(&run.follow(&files));
    assert_eq!((node.as_str(), task.as_str()), ("nh", "hoist"));
}

const GRIPS: &str =
    "cell grips; tick 1 msec; node n; task a on n begin loop run grip takes 100..200 msec; end; end a;";

/// Replays a run of [`GRIPS`]. Its first grips took this many microseconds each, and all others 150 ms.
fn grips_that_took(microseconds: &[u64]) -> Said {
    let run = Recorded::of_text(GRIPS, times(3, " ends grip"));
    let files = run.change("n", |records| {
        let acted = |record: &Record| matches!(record, Record::Script { step: ScriptStep::Acted { .. }, .. });
        let ends: Vec<usize> = (0..records.len()).filter(|&at| acted(&records[at])).collect();
        let mut before = records.iter().position(|record| matches!(record, Record::Script { .. }));
        let took = microseconds.iter().copied().chain(std::iter::repeat(150_000));
        for (end, took) in ends.into_iter().zip(took) {
            // The recording differs only in its times from a run in which the robot was that fast.
            let mut took = Ticks(took);
            for record in records[before.replace(end).expect("a beginning")..end].iter_mut().rev() {
                if let Record::Input { elapsed, .. } = record {
                    *elapsed = std::mem::replace(&mut took, Ticks::ZERO);
                }
            }
        }
    });
    run.follow(&files)
}

#[test]
fn an_action_does_not_end_before_its_least_time() {
    let [_, task, why] = no_path(&grips_that_took(&[15_000]));
    assert_eq!(task, "a");
    assert!(why.contains("before its least time"), "{why}");
}

#[test]
fn of_a_machine_that_is_late_it_is_unknown_what_times_say_by_few_ticks() {
    let said = grips_that_took(&[]);
    assert_eq!(is_path(&said)["late_at_most"], 0);
    let [_, _, why] = no_path(&grips_that_took(&[150_000, 97_000]));
    assert!(why.contains("before its least time"), "{why}");

    let said = grips_that_took(&[600_000, 97_000]);
    assert_eq!(said.code, Some(5), "{said:?}");
    let told = said.last_json();
    assert_eq!((&told["path"], &told["complete"]), (&Value::from(false), &Value::from(false)), "{told}");
    assert!(told["unknown"].as_str().is_some_and(|why| why.starts_with("nodes acted late")), "{told}");
    // Lateness of this machine cannot explain a grip that was this fast.
    no_path(&grips_that_took(&[600_000, 15_000]));
}

/// Timers of a task that expire in one tick of the model expire in either order on a real node. A timer that was
/// started before a `delay` may expire before or after the end of that delay in the same tick, although neither time
/// can be rounded in another way.
#[test]
fn timers_that_end_in_one_tick_end_in_either_order() {
    const TIES: &str = "\
cell ties; tick 1 msec; node n;
task a on n
  var ends: int16; var one, two, three, four: timer;
begin
  order one > two > three > four > self;
  on expiry one do ends := ends + 1; start one 100 msec; end;
  on expiry two do ends := ends + 1; start two 102 msec; end;
  on expiry three do ends := ends + 1; start three 104 msec; end;
  on expiry four do ends := ends + 1; start four 106 msec; end;
  start one 100 msec; start two 102 msec; start three 104 msec; start four 106 msec;
  while ends < 44 do delay 1 msec; end;
end a;";
    let run = Recorded::of_text(TIES, |_| false);
    // About half of some forty expirations of the timer come after the end of a delay in the same tick.
    path_of(&run);
}

#[test]
fn all_nodes_are_asked_for() {
    let run = Recorded::of(WELD, IN_ONE, times(1, " begins dress"));
    let said = run.follow(&run.files()[..2]);
    assert_eq!(said.code, Some(2), "{said:?}");
    assert!(said.err.contains("the recording of node `nt` is missing"), "{said:?}");
    let [files, ..] = &run.files()[..] else { panic!("files") };
    let file = files.to_str().expect("UTF-8");
    let said = run_in(run.folder.path(), &["replay", file, "--model"]);
    assert_eq!(said.code, Some(2), "{said:?}");
}
