//! Tests that a replay notices at least 999 of 1,000 changed recordings, if the change alters something observable. The
//! change may be in the records or in the bytes of the file (D109). `IMRS_CORRUPTIONS` sets how many changes of each kind
//! are made.

mod change;
mod runs;

use change::{Change, change_bytes, change_records};
use imrs_protocol::{CommTask, Input, NodeTable, Outbox, Packet, Signal, TaskId, Ticks, TimeId};
use imrs_runtime::record::{RecordingReader, Verdict, replay_recording, replay_scripts};
use imrs_runtime::script::{Note, Stands, Watch};
use imrs_wire::recording::{Ending, Header, Record, RecordingWriter, Stream};
use runs::Recorded;
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{Arc, Mutex};

/// How many changes of each kind the test makes.
fn wanted() -> usize {
    std::env::var("IMRS_CORRUPTIONS").ok().map_or(300, |number| number.parse().expect("a number"))
}

fn records(bytes: &[u8]) -> (Header, Vec<Record>) {
    let reader = RecordingReader::new(bytes).expect("a recording");
    (reader.header().clone(), reader.map(|record| record.expect("whole")).collect())
}

fn written(header: &Header, records: &[Record]) -> Vec<u8> {
    let mut writer = RecordingWriter::new(Vec::new(), header).expect("memory takes everything");
    // The end of the recording is written as a record like all others, because a changed recording may have no end.
    records.iter().for_each(|record| writer.append(record).expect("memory takes everything"));
    let length = usize::try_from(writer.written()).expect("it is in memory");
    let mut bytes = writer.finish().expect("memory takes everything");
    bytes.truncate(length);
    bytes
}

/// Whether a replay reports that something is wrong with the recording.
fn is_noticed(bytes: &[u8], run: &Recorded) -> bool {
    let Ok(mut reader) = RecordingReader::new(bytes) else { return true };
    let replays = replay_scripts(&mut reader, &run.table, |task| run.programs.get(&task), None);
    let same = replays.is_ok_and(|replays| replays.iter().all(|replay| replay.verdict() == Verdict::Same));
    !same || reader.ending() != Ending::Ended
}

/// The observable parts of a recording for each task, whatever digests it has: all outputs of the communication task,
/// and all requests of its script with their answers, in order. The outputs are hashed, so two may be confused with a
/// chance of 1 in 2^64.
#[derive(Debug, Default, PartialEq, Eq)]
struct Observable(BTreeMap<TaskId, (u64, Vec<String>)>);

impl Observable {
    fn of(header: &Header, records: &[Record], run: &Recorded) -> Self {
        let mut tasks: BTreeMap<TaskId, (CommTask, Outputs)> = BTreeMap::new();
        for task in run.table.tasks_on(run.table.node) {
            let machine = CommTask::new(&run.table, task, header.incarnation, header.restarted);
            tasks.insert(task, (machine, Outputs::default()));
        }
        for record in records {
            let Record::Input { task, elapsed, input, .. } = record else { continue };
            let Some((machine, out)) = tasks.get_mut(task) else { continue };
            again(machine, &run.table, *elapsed, *input, out);
        }
        let notes = Arc::new(Notes::default());
        let watch: Arc<dyn Watch> = Arc::clone(&notes) as _;
        let bytes = written(header, records);
        let mut reader = RecordingReader::new(&bytes[..]).expect("its header is whole");
        let _verdicts = replay_scripts(&mut reader, &run.table, |task| run.programs.get(&task), Some(&watch));
        let mut notes = std::mem::take(&mut *notes.0.lock().unwrap());
        let of = |(task, (_, out)): (TaskId, (CommTask, Outputs))| {
            (task, (out.0.finish(), notes.remove(&task).unwrap_or_default()))
        };
        Self(tasks.into_iter().map(of).collect())
    }
}

fn again(machine: &mut CommTask, table: &NodeTable, elapsed: Ticks, input: Input, out: &mut Outputs) {
    machine.handle(table, machine.now() + elapsed, &input, out);
}

#[derive(Default)]
struct Outputs(DefaultHasher);

impl Outbox for Outputs {
    fn transmit(&mut self, packet: Packet) {
        (0_u8, packet).hash(&mut self.0);
    }

    fn signal(&mut self, signal: Signal) {
        (1_u8, signal).hash(&mut self.0);
    }

    fn arm(&mut self, id: TimeId, _: u8, length: Ticks) {
        (2_u8, id, length).hash(&mut self.0);
    }

    fn disarm(&mut self, id: TimeId) {
        (3_u8, id).hash(&mut self.0);
    }
}

#[derive(Default)]
struct Notes(Mutex<BTreeMap<TaskId, Vec<String>>>);

impl Watch for Notes {
    fn note(&self, task: TaskId, _: u64, note: &Note) {
        self.0.lock().unwrap().entry(task).or_default().push(format!("{note:?}"));
    }

    fn stands(&self, task: TaskId, _: u64, stands: &Stands<'_>) {
        let at = format!("{:?}", stands.script.position());
        let mut notes = self.0.lock().unwrap();
        let notes = notes.entry(task).or_default();
        if notes.last() != Some(&at) {
            notes.push(at);
        }
    }
}

fn runs() -> Vec<Recorded> {
    let mut runs = runs::tasks();
    runs.extend(runs::scripts());
    for run in &runs {
        assert!(!is_noticed(&run.bytes, run), "node {:?} as it was recorded", run.table.node);
    }
    runs
}

/// The counts for one kind of change.
#[derive(Debug, Default)]
struct Count {
    made: usize,
    observable: usize,
    noticed: usize,
    /// How many changes altered nothing observable and were noticed all the same.
    besides: usize,
}

#[test]
fn changed_inputs_behind_right_checksums_are_noticed() {
    let runs = runs();
    let all: Vec<_> = runs.iter().map(|run| (run, records(&run.bytes))).collect();
    let plain: Vec<_> = all.iter().map(|(run, (header, all))| Observable::of(header, all, run)).collect();
    let mut random = fastrand::Rng::with_seed(17);
    let mut counts: BTreeMap<Change, Count> = BTreeMap::new();
    let mut observable = 0;
    while observable < wanted() {
        let at = random.usize(..all.len());
        let (run, (header, whole)) = &all[at];
        let Some((change, changed)) = change_records(whole, &mut random) else { continue };
        let count = counts.entry(change).or_default();
        count.made += 1;
        // A recorded digest says what the outputs were, so changing the digest counts as a change of something observable.
        let differs = change == Change::Outputs || Observable::of(header, &changed, run) != plain[at];
        let noticed = is_noticed(&written(header, &changed), run);
        observable += usize::from(differs);
        count.observable += usize::from(differs);
        count.noticed += usize::from(differs && noticed);
        count.besides += usize::from(!differs && noticed);
    }
    tell("changed inputs", &counts);
    let noticed: usize = counts.values().map(|count| count.noticed).sum();
    assert!(noticed * 1_000 >= observable * 999, "{noticed} of {observable}: {counts:#?}");
    assert_eq!(counts.len(), Change::ALL.len(), "every kind was made: {counts:#?}");
    assert!(counts.values().all(|count| count.observable > 0), "every kind can be observed: {counts:#?}");
}

#[test]
fn changed_bytes_of_the_file_are_noticed() {
    let runs = runs();
    let all: Vec<_> = runs.iter().map(|run| (run, records(&run.bytes))).collect();
    let mut random = fastrand::Rng::with_seed(18);
    let mut counts: BTreeMap<&'static str, Count> = BTreeMap::new();
    let mut observable = 0;
    while observable < wanted() {
        let (run, whole) = &all[random.usize(..all.len())];
        let (change, changed) = change_bytes(&run.bytes, &mut random);
        let reads_the_same = RecordingReader::new(&changed[..]).is_ok_and(|mut reader| {
            let header = reader.header().clone();
            let read: Result<Vec<Record>, _> = reader.by_ref().collect();
            read.is_ok_and(|read| (header, read) == *whole) && reader.ending() == Ending::Ended
        });
        let noticed = is_noticed(&changed, run);
        let count = counts.entry(change).or_default();
        count.made += 1;
        observable += usize::from(!reads_the_same);
        count.observable += usize::from(!reads_the_same);
        count.noticed += usize::from(!reads_the_same && noticed);
        count.besides += usize::from(reads_the_same && noticed);
    }
    tell("changed bytes", &counts);
    let noticed: usize = counts.values().map(|count| count.noticed).sum();
    assert!(noticed * 1_000 >= observable * 999, "{noticed} of {observable}: {counts:#?}");
}

/// After a gap only the keyframe has the state. A changed keyframe may have any state, so the replay must refuse it
/// or run from it.
#[test]
fn changed_keyframes_are_refused_or_replayed() {
    let runs = runs();
    let mut random = fastrand::Rng::with_seed(19);
    let mut refused = 0;
    for _ in 0..wanted() {
        let run = &runs[random.usize(..runs.len())];
        let (header, whole) = records(&run.bytes);
        let at = random.usize(1..whole.len() / 2);
        let (before, after) = whole.split_at(at);
        let Some(task) = run.table.tasks_on(run.table.node).next() else { continue };
        let mut machine = CommTask::new(&run.table, task, header.incarnation, header.restarted);
        let mut digest = 0;
        for record in before {
            if let Record::Input { elapsed, input, outputs, .. } = record {
                again(&mut machine, &run.table, *elapsed, *input, &mut Outputs::default());
                digest = *outputs;
            }
        }
        let mut state = postcard::to_allocvec(&machine).expect("memory takes everything");
        for _ in 0..random.usize(1..4) {
            let at = random.usize(..state.len());
            state[at] = if random.bool() { state[at] ^ (1 << random.u8(..8)) } else { random.u8(..) };
        }
        let gap = Record::Gap { stream: Stream::Task(task), lost: at as u64 };
        let changed = [&[gap, Record::Keyframe { task, state, outputs: digest }], after].concat();
        let bytes = written(&header, &changed);
        assert!(is_noticed(&bytes, run), "a gap is never called good");
        let mut reader = RecordingReader::new(&bytes[..]).expect("its header is whole");
        refused += usize::from(replay_recording(&mut reader, &run.table).is_err());
    }
    assert!(refused > 0, "no changed keyframe was refused");
}

/// Prints the counts, which `--nocapture` shows and the log of `.ci/long` keeps.
fn tell<K: std::fmt::Debug>(what: &str, counts: &BTreeMap<K, Count>) {
    for (kind, Count { made, observable, noticed, besides }) in counts {
        println!(
            "{what}: {kind:?}: {made} made, {observable} observable, {noticed} of them noticed, {besides} besides"
        );
    }
}
