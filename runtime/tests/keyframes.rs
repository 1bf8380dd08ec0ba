//! A recording with losses goes on from a keyframe (D62): later steps are judged again, and lost steps never count as good.

use crate::common::{A, B, LONG, LONG_TICKS, ask, cell, finish, network, on, one_node, report, table};
use imrs_protocol::{
    CellTable, CommTask, Incarnation, Input, NodeId, NodeTable, Outbox, Packet, PortDecl, Seal, Signal,
    TaskId, Ticks, TimeId, Usage,
};
use imrs_runtime::link::in_process::Faults;
use imrs_runtime::record::{
    About, FileRecorder, KeyframeError, Log, Miscount, OutputDigest, Recorded, Recorder, Replay, ReplayError,
    Step, Verdict, replay_recording,
};
use imrs_runtime::{Context, TaskError};
use imrs_wire::recording::{Header, Record, RecordingReader, RecordingWriter, Stream, WriteError};
use std::collections::BTreeMap;
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

const INCARNATION: Incarnation = Incarnation(1);

/// A recorder that keeps every step, with the machine's state before the step.
#[derive(Default)]
struct Tape {
    closed: Mutex<BTreeMap<TaskId, Vec<Entry>>>,
}

#[derive(Clone, Default)]
struct Entry {
    state: Vec<u8>,
    before: u64,
    recorded: Option<Recorded>,
}

impl Recorder for Tape {
    fn log(self: Arc<Self>, task: TaskId) -> Option<Box<dyn Log>> {
        Some(Box::new(TapeOf { tape: self, task, open: None }))
    }
}

struct TapeOf {
    tape: Arc<Tape>,
    task: TaskId,
    open: Option<Entry>,
}

impl Log for TapeOf {
    fn wants_keyframe(&self) -> bool {
        true
    }

    fn keyframe(&mut self, machine: &CommTask, digest: OutputDigest) {
        let state = postcard::to_allocvec(machine).expect("a machine can be written down");
        let entry = Entry { state, before: digest.0, recorded: None };
        assert!(self.open.replace(entry).is_none(), "a step within a step");
    }

    fn step(&mut self, &step: &Step, digest: OutputDigest) -> bool {
        let mut entry = self.open.take().expect("a keyframe before it");
        entry.recorded = Some(Recorded { step, digest });
        self.tape.closed.lock().unwrap().entry(self.task).or_default().push(entry);
        true
    }
}

/// A program that meets other tasks, sends a status, asks and answers.
fn program(ctx: &mut Context) -> Result<(), TaskError> {
    let (lift, news) = (ctx.port("lift")?, ctx.port("news")?);
    for round in 0..15_u8 {
        let _either = ctx.waitfor_with(lift, [round; 8], None)?;
        if ctx.id() == A {
            let _copies = ctx.send(news, &[round])?;
            let ask = ctx.port("ask")?;
            let _outcome = ctx.send(ask, &[round])?;
        } else {
            while let Some(message) = ctx.receive(None, Some(Duration::from_millis(5)))? {
                // A late reply is refused, and a reply to a status is a fault. The recording must contain both results.
                let _fault = ctx.reply(&message.from, b"yes");
            }
        }
        ctx.delay(Duration::from_millis(1))?;
    }
    Ok(())
}

fn run_recorded() -> (Arc<CellTable>, BTreeMap<TaskId, Vec<Entry>>) {
    let mut cell = cell(&[0, 1], Ticks(2_000));
    cell.port(PortDecl::new("lift", A, Usage::Waitfor, &[B], Ticks(200_000)).resend(Ticks(10_000), 1));
    cell.port(PortDecl::new("news", A, Usage::Send, &[B], LONG_TICKS).bounded_buffer(4));
    cell.port(ask(Ticks(40_000)).retry(1, Ticks(15_000)));
    let table = table(cell);
    let most_delay = Duration::from_millis(1);
    let faults = Faults { seed: 5, loss: 0.05, duplicates: 0.1, most_delay, ..Faults::default() };
    let network = network(&table, faults);
    let tape = Arc::new(Tape::default());
    let builder = |(node, task)| {
        let recorder: Arc<dyn Recorder> = Arc::clone(&tape) as _;
        on(&network, &table, node).recorder(recorder).task(task, program)
    };
    let builders: Vec<_> = (0..2).zip(["a", "b"]).map(builder).collect();
    let nodes: Vec<_> = builders.into_iter().map(|node| node.start().unwrap()).collect();
    assert!(nodes.iter().all(|node| node.wait(LONG)));
    nodes.into_iter().for_each(finish);
    let steps = std::mem::take(&mut *tape.closed.lock().unwrap());
    (table, steps)
}

/// An outbox that records all outputs of a machine.
#[derive(Default, Debug, PartialEq)]
struct All(Vec<String>);

impl Outbox for All {
    fn transmit(&mut self, packet: Packet) {
        self.0.push(format!("{packet:?}"));
    }

    fn signal(&mut self, signal: Signal) {
        self.0.push(format!("{signal:?}"));
    }

    fn arm(&mut self, id: TimeId, _: u8, length: Ticks) {
        self.0.push(format!("{id:?} {length:?}"));
    }

    fn disarm(&mut self, id: TimeId) {
        self.0.push(format!("{id:?}"));
    }

    fn observe(&mut self, observation: imrs_protocol::Observation) {
        self.0.push(format!("{observation:?}"));
    }
}

#[test]
fn a_machine_read_back_from_its_keyframe_behaves_bit_equal() {
    let (table, logs) = run_recorded();
    assert_eq!(logs.len(), 2);
    for (&task, log) in &logs {
        let node = NodeTable::new(Arc::clone(&table), NodeId(task.0));
        assert!(log.len() > 60, "{task} took only {} inputs", log.len());
        let mut original = CommTask::new(&node, task, INCARNATION, false);
        let mut copy = original.clone();
        for entry in log {
            let step = entry.recorded.expect("a whole step").step;
            let mut out = [All::default(), All::default()];
            for (machine, out) in [&mut original, &mut copy].into_iter().zip(&mut out) {
                machine.handle(&node, machine.now() + step.elapsed, &step.input, out);
            }
            assert_eq!(out[0], out[1]);
            // The state is read back exactly after every step, so the original and the copy go on alike.
            let bytes = postcard::to_allocvec(&original).unwrap();
            copy = postcard::from_bytes(&bytes).unwrap();
            assert_eq!(postcard::to_allocvec(&copy).unwrap(), bytes);
            assert_eq!(
                (copy.next_deadline(), copy.view(&node, 8)),
                (original.next_deadline(), original.view(&node, 8))
            );
        }
    }
}

#[test]
fn a_replay_goes_on_from_any_keyframe_and_says_unknown() {
    let (table, logs) = run_recorded();
    for (&task, log) in &logs {
        let node = NodeTable::new(Arc::clone(&table), NodeId(task.0));
        let steps = |from: usize| log[from..].iter().map(|entry| entry.recorded.expect("a whole step"));
        let mut whole = Replay::new(&node, task, INCARNATION, false);
        steps(0).for_each(|step| whole.step(step));
        assert_eq!((whole.verdict(), whole.judged(), whole.unjudged()), (Verdict::Same, log.len(), 0));
        for cut in (1..log.len()).step_by(7) {
            let entry = &log[cut];
            let mut replay = Replay::new(&node, task, INCARNATION, false);
            steps(0).take(cut / 2).for_each(|step| replay.step(step));
            replay.gap(3);
            // This step was recorded after the gap and before the keyframe, so it cannot be judged.
            steps(cut - 1).take(1).for_each(|step| replay.step(step));
            replay.keyframe(&entry.state, OutputDigest(entry.before)).unwrap();
            steps(cut).for_each(|step| replay.step(step));
            assert_eq!((replay.verdict(), replay.lost(), replay.unjudged()), (Verdict::Unknown, 3, 1));
            assert_eq!(replay.judged(), cut / 2 + log.len() - cut);

            // A change after the keyframe must be noticed.
            let mut replay = Replay::new(&node, task, INCARNATION, false);
            replay.gap(1);
            replay.keyframe(&entry.state, OutputDigest(entry.before)).unwrap();
            let mut wrong = entry.recorded.expect("a whole step");
            wrong.digest.0 ^= 1;
            replay.step(wrong);
            assert!(
                matches!(replay.verdict(), Verdict::Differs(found) if found.index == 0 && found.task == task)
            );
        }
    }
}

#[test]
fn keyframes_that_are_none_are_told() {
    let (table, logs) = run_recorded();
    let [a, b] = [A, B].map(|task| logs[&task][20].clone());
    let node = NodeTable::new(table, NodeId(0));
    let mut replay = Replay::new(&node, A, INCARNATION, false);
    replay.gap(1);
    let mut try_state = |state: &[u8]| replay.keyframe(state, OutputDigest(a.before));
    assert!(matches!(try_state(&a.state[..a.state.len() - 1]), Err(KeyframeError::Malformed(A, _))));
    assert_eq!(try_state(&[&a.state[..], &[0, 0]].concat()), Err(KeyframeError::Trailing(A, 2)));
    assert_eq!(try_state(&b.state), Err(KeyframeError::Foreign(A, B, INCARNATION)));
    assert_eq!(try_state(&a.state), Ok(()));
    let contradiction = replay.keyframe(&a.state, OutputDigest(a.before ^ 1));
    assert_eq!(contradiction, Err(KeyframeError::Contradicts(A)));
    assert_eq!(replay.verdict(), Verdict::Unknown);
}

/// A disk that accepts nothing while it is held.
#[derive(Clone, Default)]
struct Disk(Arc<(Mutex<Platter>, Condvar)>);

#[derive(Default)]
struct Platter {
    held: bool,
    bytes: Vec<u8>,
}

impl Disk {
    fn hold(&self, held: bool) {
        self.0.0.lock().unwrap().held = held;
        self.0.1.notify_all();
    }
}

impl std::io::Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let mut platter = self.0.1.wait_while(self.0.0.lock().unwrap(), |platter| platter.held).unwrap();
        platter.bytes.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_node_whose_disk_was_stuck_is_recorded_on_and_its_replay_is_unknown() {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    let table = table(cell);
    let here = NodeTable::new(Arc::clone(&table), NodeId(0));
    let disk = Disk::default();
    let failed = |error: &WriteError| panic!("{error}");
    let recorder = FileRecorder::start(
        disk.clone(),
        &here,
        &About { incarnation: (INCARNATION, false), insecure: false, build: "a test", statements: 0 },
        failed,
    )
    .unwrap();
    let (status, in_program) = (Arc::clone(&recorder), disk.clone());
    let (tell, told) = report();
    let node = one_node(&table)
        .incarnation(INCARNATION, false)
        .recorder(Arc::clone(&recorder) as _)
        .task("a", move |ctx| {
            let ask = ctx.port("ask")?;
            let lost = || status.status().expect("it runs").lost;
            let mut answered = |times: u32| {
                for number in 0..times {
                    assert!(ctx.send(ask, &number.to_le_bytes())?.reply().is_some());
                }
                Ok::<(), TaskError>(())
            };
            answered(50)?;
            in_program.hold(true);
            while lost() == 0 {
                answered(100)?;
            }
            in_program.hold(false);
            // This loop repeats until both tasks are recorded again.
            let start = Instant::now();
            loop {
                let before = lost();
                answered(100)?;
                if lost() == before {
                    break;
                }
                assert!(start.elapsed() < LONG, "the recording never went on");
                std::thread::sleep(Duration::from_millis(1));
            }
            tell.send(()).expect("the test listens");
            Ok(())
        })
        .task("b", |ctx| {
            while let Some(question) = ctx.receive(None, None)? {
                ctx.reply(&question.from, question.contents.as_bytes())?;
            }
            Ok(())
        })
        .start()
        .unwrap();
    told.recv_timeout(10 * LONG).expect("the disk takes everything again"); // This takes over 10,000 round trips.
    assert!(node.stop(LONG).iter().all(|(_, end)| *end == imrs_runtime::TaskEnd::Returned));
    let status = recorder.stop(LONG).expect("it was not stopped before");
    assert!(status.ended && status.lost > 0, "{status:?}");

    let bytes = disk.0.0.lock().unwrap().bytes.clone();
    let replays = replay_recording(&mut RecordingReader::new(&bytes[..]).unwrap(), &here).unwrap();
    assert_eq!(replays.iter().map(Replay::lost).sum::<u64>(), status.lost);
    for replay in &replays {
        let expected = if replay.lost() == 0 { Verdict::Same } else { Verdict::Unknown };
        assert_eq!((replay.verdict(), replay.unjudged()), (expected, 0), "{}", replay.task());
        assert!(replay.judged() > 300, "{} of {}", replay.judged(), replay.task());
    }
    let count = |is_one: fn(&Record) -> bool| {
        RecordingReader::new(&bytes[..]).unwrap().filter(|record| record.as_ref().is_ok_and(is_one)).count()
    };
    let gaps = count(|record| matches!(record, Record::Gap { .. }));
    let keyframes = count(|record| matches!(record, Record::Keyframe { .. }));
    // There is at most one keyframe for each gap, and none where nothing was lost.
    assert!((1..=gaps).contains(&keyframes), "{keyframes} keyframes, {gaps} gaps");
}

#[test]
fn recordings_of_others_are_refused() {
    let mut cell = cell(&[0, 1], Ticks(1_000));
    cell.port(ask(LONG_TICKS));
    let table = table(cell);
    let here = NodeTable::new(Arc::clone(&table), NodeId(0));
    let replayed = |digest: u32, node: Option<NodeId>, records: &[Record]| {
        let header =
            Header { cell: "test".into(), digest, node, incarnation: INCARNATION, ..Header::default() };
        let mut writer = RecordingWriter::new(Vec::new(), &header).unwrap();
        records.iter().for_each(|record| writer.append(record).unwrap());
        let bytes = writer.finish().unwrap();
        let result = replay_recording(&mut RecordingReader::new(&bytes[..]).unwrap(), &here);
        result.map(|replays| replays.iter().map(Replay::verdict).collect::<Vec<_>>())
    };
    let (digest, node) = (table.digest(), Some(NodeId(0)));
    assert_eq!(replayed(digest, node, &[]).unwrap(), [Verdict::Same]);
    let gap = |task| Record::Gap { stream: Stream::Task(task), lost: 9 };
    assert_eq!(replayed(digest, node, &[gap(A)]).unwrap(), [Verdict::Unknown]);
    assert!(matches!(replayed(digest, node, &[gap(B)]), Err(ReplayError::ForeignTask(B))));
    assert!(matches!(replayed(digest ^ 1, node, &[]), Err(ReplayError::OtherCell { .. })));
    assert!(matches!(replayed(digest, Some(NodeId(1)), &[]), Err(ReplayError::OtherNode(NodeId(0)))));
    assert!(matches!(replayed(digest, None, &[]), Err(ReplayError::OtherNode(_))));
    let broken = Record::Keyframe { task: A, state: vec![1, 2, 3], outputs: 0 };
    assert!(matches!(replayed(digest, node, &[broken]), Err(ReplayError::Keyframe(_))));
}

/// The keyframe is of a machine whose port has a larger buffer, so the replayed machine can never have its state.
#[test]
fn a_state_of_a_machine_with_other_buffers_is_refused() {
    let with_room_for = |messages: u16| {
        let mut cell = cell(&[0, 1], Ticks(1_000));
        cell.port(PortDecl::new("news", A, Usage::Send, &[B], LONG_TICKS).bounded_buffer(messages));
        NodeTable::new(table(cell), NodeId(1))
    };
    let (wide, narrow) = (with_room_for(3), with_room_for(1));
    let mut machine = CommTask::new(&wide, B, INCARNATION, false);
    for sequence in 1..=3 {
        let packet = Packet {
            kind: imrs_protocol::Kind::Send,
            class: imrs_protocol::Class::Status,
            more: false,
            resent: false,
            hops: 0,
            fragment: 0,
            destination: B,
            source: A,
            port: imrs_protocol::PortId(0),
            id: imrs_protocol::MessageId {
                incarnation: INCARNATION,
                sequence: imrs_protocol::Seq24::new(sequence),
            },
            remaining: Ticks(1_000_000),
            contents: imrs_protocol::Contents::EMPTY,
            seal: Seal::NONE,
        };
        machine.handle(&wide, machine.now(), &Input::Packet(packet), &mut All::default());
    }
    let state = postcard::to_allocvec(&machine).unwrap();
    let resumed = |table: &NodeTable| {
        let mut replay = Replay::new(table, B, INCARNATION, false);
        replay.gap(1);
        replay.keyframe(&state, OutputDigest(5))
    };
    assert_eq!(resumed(&wide), Ok(()));
    assert_eq!(resumed(&narrow), Err(KeyframeError::OutOfBounds(B)));
}

/// The last record says that the task had more inputs or other outputs than the earlier records show. There is no
/// gap, so records were lost unnoticed.
#[test]
fn a_last_record_that_does_not_fit_is_told() {
    let here = NodeTable::new(table(cell(&[0], Ticks(0))), NodeId(0));
    let start = OutputDigest::START;
    let time = Step { elapsed: Ticks(1), input: Input::Time };
    let closed = |gap: u64, inputs: u64, outputs: OutputDigest| {
        let mut replay = Replay::new(&here, A, INCARNATION, false);
        replay.step(Recorded { step: time, digest: start });
        if gap > 0 {
            replay.gap(gap);
        }
        replay.close(inputs, outputs);
        replay.verdict()
    };
    let other = OutputDigest(3);
    assert_eq!(closed(0, 1, start), Verdict::Same);
    let miscount = |said, said_outputs| {
        Verdict::Miscounts(Miscount { task: A, said, found: 1, said_outputs, outputs: start })
    };
    assert_eq!(closed(0, 2, start), miscount(2, start));
    assert_eq!(closed(0, 1, other), miscount(1, other));
    // A gap explains a difference in the counts, but only for as many records as the gap says.
    assert_eq!(closed(2, 3, other), Verdict::Unknown);
    assert_eq!(closed(2, 4, other), miscount(4, other));
}
