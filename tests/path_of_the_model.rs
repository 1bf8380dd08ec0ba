//! What `imrs run` does is a path of the model that `imrs verify` explores. Nodes and links may be as late as the machine
//! makes them: that is told, and changes no verdict here.

mod support;

use imrs_protocol::{Input, Kind, Packet, Seq24, Ticks};
use imrs_wire::recording::{Record, RecordingReader, RecordingWriter, ScriptStep};
use serde_json::Value;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use support::{Said, run_in, runtime_dir};

const BEAM: &str = "beam_lift.cell";
const WELD: &str = "weld_cell.cell";

/// A recorded run.
struct Recorded {
    folder: tempfile::TempDir,
    cell: String,
    nodes: &'static [&'static str],
}

impl Recorded {
    fn of(example: &str, args: &[&str]) -> Self {
        let cell = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples").join(example);
        let nodes = if example == BEAM { &["nl", "nr", "nh"] } else { &["n1", "n2", "nt"] };
        Self::with(runtime_dir(), &cell, nodes, args)
    }

    fn with(folder: tempfile::TempDir, cell: &Path, nodes: &'static [&'static str], args: &[&str]) -> Self {
        let cell: String = cell.to_str().expect("UTF-8").into();
        let file = folder.path().join("run.imrs");
        let file = file.to_str().expect("UTF-8");
        let run = ["run", &cell, "--record", file, "--format", "json"];
        let said = run_in(folder.path(), &[&run[..], args].concat());
        // Where a fault was asked for, a task may have aborted: that is a finding of the run.
        assert!(matches!(said.code, Some(0 | 1)), "{said:?}");
        Self { folder, cell, nodes }
    }

    fn file(&self, node: &str) -> PathBuf {
        self.folder.path().join(format!("run.{node}.imrs"))
    }

    fn files(&self) -> Vec<PathBuf> {
        self.nodes.iter().map(|node| self.file(node)).collect()
    }

    fn follow(&self, files: &[PathBuf]) -> Said {
        let files: Vec<&str> = files.iter().map(|file| file.to_str().expect("UTF-8")).collect();
        let how = ["--cell", &self.cell, "--model", "--within", "60s", "--format", "json"];
        run_in(self.folder.path(), &[&["replay"], &files[..], &how[..]].concat())
    }

    /// Writes the recording of a node again, changed.
    fn change(&self, node: &str, change: impl FnOnce(&mut Vec<Record>)) -> Vec<PathBuf> {
        let file = File::open(self.file(node)).expect("a recording");
        let mut reader = RecordingReader::new(BufReader::new(file)).expect("a recording");
        let header = reader.header().clone();
        let mut records: Vec<Record> = reader.by_ref().map(|record| record.expect("a record")).collect();
        change(&mut records);
        let changed = self.folder.path().join(format!("changed.{node}.imrs"));
        let sink = File::create(&changed).expect("a file");
        let mut writer = RecordingWriter::new(sink, &header).expect("a recording");
        records.iter().for_each(|record| writer.append(record).expect("written"));
        writer.flush().expect("written");
        let of = |other: &&str| if *other == node { changed.clone() } else { self.file(other) };
        self.nodes.iter().map(of).collect()
    }
}

fn is_path(said: &Said) -> Value {
    let told = said.last_json();
    // On a machine that is late a check may not hold.
    let broken = told["checks"].as_array().expect("checks").iter().any(|check| check["outcome"] == "broken");
    assert_eq!(said.code, Some(i32::from(broken)), "{said:?}");
    assert_eq!(told["path"], true, "{told}");
    assert_eq!(told["unexplained"], Value::Null, "{told}");
    told
}

/// The first thing that no path explains: node, task, why.
fn no_path(said: &Said) -> [String; 3] {
    assert_eq!(said.code, Some(1), "{said:?}");
    let told = said.last_json();
    assert_eq!(told["path"], false, "{told}");
    let at = &told["unexplained"];
    ["node", "task", "why"].map(|key| at[key].as_str().expect("text").to_owned())
}

fn number(told: &Value, name: &str) -> u64 {
    told[name].as_u64().unwrap_or_else(|| panic!("no `{name}` in {told}"))
}

#[test]
fn a_beam_lift_is_a_path_of_the_model() {
    for how in [&["--for", "3s", "--seed", "5"][..], &["--for", "3s", "--seed", "6", "--in-process"]] {
        let run = Recorded::of(BEAM, how);
        let told = is_path(&run.follow(&run.files()));
        // They grip, meet, and lift: beats, looks at the height, answers.
        assert!(number(&told, "inputs") > 50 && number(&told, "turns") > 50, "{told}");
        assert!(number(&told, "moves") >= number(&told, "inputs") / 2, "{told}");
        assert!(number(&told, "kinds") > 10, "{told}");
    }
}

#[test]
fn a_weld_is_a_path_of_the_model() {
    for how in [&["--for", "3s", "--seed", "5"][..], &["--for", "3s", "--seed", "6", "--in-process"]] {
        let run = Recorded::of(WELD, how);
        let told = is_path(&run.follow(&run.files()));
        assert!(number(&told, "inputs") > 50 && number(&told, "turns") > 10, "{told}");
    }
}

#[test]
fn lifts_with_faults_are_paths_of_the_model() {
    for fault in [["--loss", "5%"], ["--cut", "nl--nr@1s+40ms"], ["--kill", "hoist@1500ms"]] {
        for how in [&["--for", "3s", "--seed", "7"][..], &["--for", "3s", "--seed", "8", "--in-process"]] {
            let run = Recorded::of(BEAM, &[how, &fault].concat());
            is_path(&run.follow(&run.files()));
        }
    }
}

#[test]
fn welds_with_faults_are_paths_of_the_model() {
    for fault in [["--loss", "5%"], ["--cut", "n1--nt@1s+300ms"], ["--kill", "r1@1500ms"]] {
        for how in [&["--for", "3s", "--seed", "9"][..], &["--for", "3s", "--seed", "4", "--in-process"]] {
            let run = Recorded::of(WELD, &[how, &fault].concat());
            let told = is_path(&run.follow(&run.files()));
            let lost = told["lost"].as_array().expect("links");
            assert!(!lost.is_empty(), "{fault:?}: {told}");
        }
    }
}

#[test]
fn nodes_of_two_runs_are_no_run() {
    let [one, other] = ["11", "12"].map(|seed| {
        let run = Recorded::of(BEAM, &["--for", "2s", "--seed", seed, "--in-process"]);
        // So that one is over clearly before the other begins.
        std::thread::sleep(std::time::Duration::from_millis(300));
        run
    });
    let mut files = one.files();
    files[0] = other.file("nl");
    // Each of them replays bit-equal by itself.
    for file in &files {
        let file = file.to_str().expect("UTF-8");
        let said = run_in(one.folder.path(), &["replay", file, "--cell", &one.cell]);
        assert_eq!(said.code, Some(0), "{said:?}");
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

#[test]
fn what_nobody_sent_is_no_path() {
    let run = Recorded::of(BEAM, &["--for", "2s", "--seed", "3", "--in-process"]);
    is_path(&run.follow(&run.files()));
    // An answer that nobody asked for: armL's own machine takes no notice of it.
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
        // Its count alone would give it away.
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
    let run = Recorded::of(WELD, &["--for", "3s", "--seed", "3", "--in-process"]);
    let acted =
        |record: &&mut Record| matches!(record, Record::Script { step: ScriptStep::Acted { .. }, .. });
    let files = run.change("n1", |records| {
        let record = records.iter_mut().find(acted).expect("an action that ended");
        if let Record::Script { step: ScriptStep::Acted { ok, .. }, .. } = record {
            *ok = !*ok;
        }
    });
    let [node, task, _] = no_path(&run.follow(&files));
    assert_eq!((node.as_str(), task.as_str()), ("n1", "r1"));
}

#[test]
fn a_member_that_never_heard_of_the_others_is_not_released() {
    let run = Recorded::of(BEAM, &["--for", "3s", "--seed", "2", "--in-process"]);
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

#[test]
fn an_action_does_not_end_before_its_least_time() {
    const GRIPS: &str =
        "cell grips; tick 1 msec; node n; task a on n begin loop run grip takes 100..200 msec; end; end a;";
    let folder = runtime_dir();
    let cell = folder.path().join("grips.cell");
    std::fs::write(&cell, GRIPS).expect("the cell is written");
    let run = Recorded::with(folder, &cell, &["n"], &["--for", "1s"]);
    is_path(&run.follow(&run.files()));
    let files = run.change("n", |records| {
        let acted = |record: &Record| matches!(record, Record::Script { step: ScriptStep::Acted { .. }, .. });
        let at = records.iter().position(acted).expect("an action that ended");
        let Some(Record::Input { elapsed, .. }) = records[..at].last_mut() else {
            panic!("no time before it")
        };
        // Nothing but time tells it from a run where the robot was so fast.
        elapsed.0 /= 10;
    });
    let [_, task, why] = no_path(&run.follow(&files));
    assert_eq!(task, "a");
    assert!(why.contains("before its least time"), "{why}");
}

/// Timers of a task that end in one tick of the model end in either order on a real node: one that was started first ends
/// before a `delay` that is over in that tick or after it, long after anything that could be rounded otherwise.
#[test]
fn timers_that_end_in_one_tick_end_in_either_order() {
    const TIES: &str = "\
cell ties; tick 1 msec; node n;
task a on n
  var ends: int16; var one, two, three, four: timer;
begin
  order one > two > three > four > self;
  on expiry one do ends := ends + 1; start one 500 msec; end;
  on expiry two do ends := ends + 1; start two 510 msec; end;
  on expiry three do ends := ends + 1; start three 520 msec; end;
  on expiry four do ends := ends + 1; start four 530 msec; end;
  start one 500 msec; start two 510 msec; start three 520 msec; start four 530 msec;
  loop delay 1 msec; end;
end a;";
    let folder = runtime_dir();
    let cell = folder.path().join("ties.cell");
    std::fs::write(&cell, TIES).expect("the cell is written");
    let run = Recorded::with(folder, &cell, &["n"], &["--for", "6s"]);
    // Of some forty ends about half come after that of a delay which was to end in the same tick.
    is_path(&run.follow(&run.files()));
}

#[test]
fn all_nodes_are_asked_for() {
    let run = Recorded::of(WELD, &["--for", "1s", "--in-process"]);
    let said = run.follow(&run.files()[..2]);
    assert_eq!(said.code, Some(2), "{said:?}");
    assert!(said.err.contains("the recording of node `nt` is missing"), "{said:?}");
    let [files, ..] = &run.files()[..] else { panic!("files") };
    let file = files.to_str().expect("UTF-8");
    let said = run_in(run.folder.path(), &["replay", file, "--model"]);
    assert_eq!(said.code, Some(2), "{said:?}");
}
