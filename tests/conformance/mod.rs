//! Compares running nodes with the verified machine (M16). A node's recording is replayed while the node runs, and the
//! monitor must show every deviation of the runtime. Each test puts a fault into a genuine recording, as a runtime with
//! that fault would have recorded it. A stub node then announces the recording to the monitor.

mod mutants;

use crate::support::program::{Program, times};
use crate::support::stub::{Stub, Tells};
use crate::support::tape::Tape;
use crate::support::{bound, imrs, is_alive, run_until, runtime_dir, side_by_side};
use imrs_protocol::Incarnation;
use imrs_wire::obs::{NodeIdentity, RecordingFacts, Table};
use imrs_wire::recording::Record;
use mutants::{MUTANTS, Mutant};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// How long the judging thread may take without any progress: it has the lowest priority of all (nice 19).
const LONG: Duration = Duration::from_secs(600);
/// The goal for the speed of the judge, in inputs per second.
const GOAL: f64 = 200_000.0;

/// A cell with requests and answers, delays, time_outs, a rendezvous, rejections with their penalty, and actions.
const CELL: &str = "\
cell judged;
tick 1 msec;
node na;  node nb;
link na -- nb delay 20 msec;
task inspector on na
  port weld(n: int16)  usage = send  user_list = {arm}  time_out = 3 sec  class = 1;
  port stop()  usage = send  user_list = {arm}  time_out = 3 sec  class = 1;
  port look(n: int16) -> int16  usage = query  user_list = {arm}  time_out = 3 sec  penalty = 50 msec;
  port meet()  usage = waitfor  user_list = {arm}  time_out = 3 sec  class = 2  retry = 3  resend = 100 msec;
  var n: int16;
begin
  loop
    send weld(n);
    delay 20 msec;
    query look(n) -> n on time_out do n := 0; end on refused do n := 0; end;
    n := n + 1;
    send stop();
    waitfor meet() on time_out do skip; end;
  end;
end inspector;
task arm on nb
  use_port weld(n: int16)  usage = receive;
  use_port stop()  usage = receive;
  use_port look(n: int16) -> int16  usage = response;
  use_port meet()  usage = waitfor  time_out = 3 sec;
begin
  order weld > stop > self > look;
  on receive weld(n) do run weld_it n takes 150 msec; end;
  on receive stop() do skip; end;
  on query look(n) do response(n); end;
  loop
    waitfor meet() on time_out do skip; end;
    delay 5 msec;
  end;
end arm;
";

/// A cell in which one task sends 40 queries in each of `ROUNDS` rounds to another task of its node. Then both tasks end.
const CHAT: &str = "\
cell judged;
tick 1 msec;
node na;
task a on na
  port ask(n: int16) -> int16  usage = query  user_list = {b}  time_out = 2 sec  class = 2;
  var n, i, round: int16;
begin
  while round < ROUNDS do
    i := 0;
    while i < 40 do
      query ask(round) -> n on time_out do n := 0; end on refused do n := 0; end;
      i := i + 1;
    end;
    round := round + 1;
    delay 1 msec;
  end;
  query ask(round) -> n on time_out do n := 0; end on refused do n := 0; end;
end a;
task b on na
  use_port ask(n: int16) -> int16  usage = response;
  var last: int16;
begin
  order ask > self;
  on query ask(n) do last := n; response(n); end;
  while last < ROUNDS do delay 50 msec; end;
end b;
";

/// A run of the cell, with the recordings of its two nodes.
struct Bench {
    dir: TempDir,
    cell: PathBuf,
}

impl Bench {
    /// Runs the cell for this many rounds.
    fn run(rounds: usize) -> Self {
        let dir = runtime_dir();
        let (cell, record) = (dir.path().join("judged.cell"), dir.path().join("run.imrs"));
        fs::write(&cell, CELL).expect("the cell is written");
        let (cell_text, record) = (cell.to_str().expect("UTF-8"), record.to_str().expect("UTF-8"));
        let args = ["run", cell_text, "--in-process", "--seed", "3", "--record", record];
        // Each of the two tasks prints this line.
        let said = run_until(dir.path(), &args, times(2 * rounds, "all arrived at `meet`"));
        assert_eq!(said.code, Some(0), "{said:?}");
        Self { dir, cell }
    }

    fn tape(&self, node: &str) -> Tape {
        Tape::read(&self.dir.path().join(format!("run.{node}.imrs")))
    }

    /// A monitor of a stub node, which announces a recording at `path`.
    fn watch(&self, tape: &Tape, node: &str, path: &Path) -> Watched {
        let dir = runtime_dir();
        let id = tape.header.node.expect("a node");
        let identity = NodeIdentity {
            cell: tape.header.cell.clone(),
            digest: tape.header.digest,
            node: node.to_owned(),
            id: id.0,
            incarnation: Incarnation(tape.header.incarnation.0),
            tick_us: 1,
        };
        let facts = RecordingFacts { path: path.display().to_string(), ..RecordingFacts::default() };
        let mut tells = Tells::default();
        tells.vitals.recording = Some(facts);
        let table = Table { cell: tape.header.cell.clone(), ..Table::default() };
        let stub = Stub::start(dir.path(), identity, table, tells);
        let folder = dir.path().to_owned();
        Watched::over(&folder, &self.cell, Some((stub, dir)))
    }
}

/// A monitor, and the stub that it watches.
struct Watched {
    monitor: Program,
    /// The stub and its folder, which are dropped after the monitor.
    _seen: Option<(Stub, TempDir)>,
}

impl Watched {
    /// Monitors the nodes in this folder.
    fn over(folder: &Path, cell: &Path, seen: Option<(Stub, TempDir)>) -> Self {
        let judge = cell.to_str().expect("UTF-8");
        let args = ["monitor", "--watch", "50ms", "--format", "json", "--judge", judge];
        Self { monitor: Program::start(imrs(folder, &args)), _seen: seen }
    }

    /// The next sample of the node: the verdict, the number of judged steps, and the text of `model-violation`.
    fn said(&mut self) -> (String, u64, Option<String>) {
        let report = self.monitor.json();
        let node = &report["nodes"][0];
        let verdict = node["conformance"].as_str().unwrap_or("unknown").to_owned();
        let mut findings = report["findings"].as_array().expect("findings").iter();
        let found = findings.rfind(|found| found["code"] == "model-violation");
        let words = found.map(|found| found["text"].as_str().expect("words").to_owned());
        (verdict, node["conforming_steps"].as_u64().unwrap_or(0), words)
    }

    /// Waits until the verdict is `verdict` after at least this many steps, as long as the judge makes progress.
    fn until(&mut self, verdict: &str, steps: u64) -> (u64, Option<String>) {
        let (mut most, mut end) = (0, Instant::now() + LONG);
        loop {
            let (said, judged, words) = self.said();
            if said == verdict && judged >= steps {
                return (judged, words);
            }
            if judged > most {
                (most, end) = (judged, Instant::now() + LONG);
            }
            assert!(
                Instant::now() < end,
                "not {verdict} after {steps} steps, but {said} after {judged}: {words:?}"
            );
        }
    }
}

fn inputs(records: &[Record]) -> u64 {
    records.iter().filter(|record| matches!(record, Record::Input { .. })).count() as u64
}

#[test]
fn every_fault_of_a_runtime_is_seen_and_a_true_recording_conforms() {
    let bench = Bench::run(12);
    let folder = bench.dir.path();
    side_by_side(["na", "nb"], |node| {
        let tape = bench.tape(node);
        let path = folder.join(format!("true.{node}.imrs"));
        tape.write(&path);
        let (steps, words) = bench.watch(&tape, node, &path).until("conforms", inputs(&tape.records));
        println!("| as it was ({node}) | conforms, {steps} steps |");
        assert_eq!(words, None);
    });
    side_by_side(MUTANTS, |Mutant { name, node, make }| {
        let mut tape = bench.tape(node);
        let at =
            make(&mut tape.records).unwrap_or_else(|| panic!("{name}: nothing in the recording of {node}"));
        let path = folder.join(format!("{}.imrs", name.replace(' ', "_")));
        tape.write(&path);
        let (_, words) = bench.watch(&tape, node, &path).until("violates", 0);
        let words = words.unwrap_or_else(|| panic!("{name}: no finding"));
        println!("| {name} ({node}, record {at} of {}) | {words} |", tape.records.len());
    });
    println!("{} of {} mutants flagged", MUTANTS.len(), MUTANTS.len());
}

/// The monitor follows a recording as it grows. It notices a fault in a file that replaces the recording, and reads a
/// file that takes its name from the beginning.
#[test]
fn a_recording_is_followed_as_it_grows_and_begins_anew_when_it_is_replaced() {
    let bench = Bench::run(6);
    let tape = bench.tape("na");
    let half = tape.records.len() / 2;
    let (first, whole) =
        (Tape { records: tape.records[..half].to_vec(), ..tape.clone() }, inputs(&tape.records));
    let path = bench.dir.path().join("grows.imrs");
    first.write(&path);
    let mut watched = bench.watch(&tape, "na", &path);
    // The first half of the recording is judged.
    let (steps, _) = watched.until("conforms", inputs(&first.records));
    assert_eq!(steps, inputs(&first.records));

    // The second half is appended to the recording, byte for byte as a node would do it.
    let all = bench.dir.path().join("all.imrs");
    tape.write(&all);
    let (bytes, before) = (fs::read(&all).expect("a file"), fs::read(&path).expect("a file"));
    assert!(bytes.starts_with(&before));
    let mut file = File::options().append(true).open(&path).expect("the recording");
    std::io::Write::write_all(&mut file, &bytes[before.len()..]).expect("appended");
    let (steps, _) = watched.until("conforms", whole);
    assert_eq!(steps, whole);

    // The file is replaced, first by a recording with a fault, then by the genuine one.
    let mut wrong = tape;
    (MUTANTS[0].make)(&mut wrong.records).expect("a fault");
    let other = bench.dir.path().join("other.imrs");
    wrong.write(&other);
    fs::rename(&other, &path).expect("renamed");
    watched.until("violates", 0);
    fs::rename(&all, &path).expect("renamed");
    let (steps, _) = watched.until("conforms", whole);
    assert_eq!(steps, whole);
}

/// A monitor follows a node that works as fast as it can. The test measures how far behind the monitor is when the node
/// stops, and how many inputs a second a later monitor replays.
#[test]
fn it_keeps_up_with_a_busy_node() {
    let dir = runtime_dir();
    let (cell, record) = (dir.path().join("judged.cell"), dir.path().join("run.imrs"));
    let rounds = bound("IMRS_ROUNDS", 250);
    fs::write(&cell, CHAT.replace("ROUNDS", &rounds.to_string())).expect("the cell is written");
    let (text, file) = (cell.to_str().expect("UTF-8"), record.to_str().expect("UTF-8"));
    let args = ["run", text, "--in-process", "--format", "json", "--record", file];
    let mut node = Program::start(imrs(dir.path(), &args));
    node.line();
    let begins = Instant::now();
    let mut live = Watched::over(dir.path(), &cell, None);
    while is_alive(node.pid()) {
        let (verdict, steps, words) = live.said();
        assert_ne!(verdict, "violates", "after {steps} steps: {words:?}");
    }
    let (stopped, ran) = (Instant::now(), begins.elapsed());
    let said = node.finish();
    assert!(matches!(said.code, Some(0 | 1 | 5)), "{said:?}");
    let bench = Bench { dir, cell };
    let tape = bench.tape("na");
    let all = inputs(&tape.records);
    // If the disk was too slow, the recording has gaps, and the judge only judges it up to the first gap.
    let whole = !tape.records.iter().any(|record| matches!(record, Record::Gap { .. }));
    if !whole {
        println!("its disk could not keep up with the node: nothing is measured");
        return;
    }
    live.until("conforms", all);
    println!("{all} inputs in {ran:?}: all were run again {:?} after the node stopped", stopped.elapsed());
    let mut later = bench.watch(&tape, "na", &bench.dir.path().join("run.na.imrs"));
    let first = later.until("conforms", 1).0;
    let since = Instant::now();
    later.until("conforms", all);
    // If the judge read the whole recording in one call, the call took no longer than this time.
    let (seconds, more) = match all - first {
        0 => (0.25, all),
        more => (since.elapsed().as_secs_f64().max(1e-3), more),
    };
    println!("{:.0} inputs a second run again; goal {GOAL:.0}", more as f64 / seconds);
}
