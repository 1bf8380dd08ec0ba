//! Tests that a recording returns exactly the steps that a task's log took. Without room or disk it reports its losses (D62).

use crate::common::{A, B, LONG, LONG_TICKS, ask, cell, finish, one_node, table};
use imrs_protocol::{
    Class, Contents, Incarnation, Input, Kind, MessageId, NodeId, NodeTable, Packet, PortId, Ranked, ReplyTo,
    Request, Seal, Seq24, ServiceOrder, Target, TaskId, Ticks, TimeId,
};
use imrs_runtime::record::{About, FileRecorder, Log, OutputDigest, Recorder, Step};
use imrs_wire::recording::{Record, RecordingReader, ScriptStep, Stream, WriteError};
use proptest::prelude::*;
use std::io::{self, ErrorKind, Write};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Instant;

/// A disk that accepts nothing while it is held, and only `size` bytes in all.
#[derive(Clone)]
struct Disk(Arc<(Mutex<Platter>, Condvar)>);

struct Platter {
    held: bool,
    /// Whether a write waits for the disk, or has waited.
    stuck: bool,
    size: usize,
    bytes: Vec<u8>,
}

impl Disk {
    fn of(size: usize) -> Self {
        let platter = Platter { held: false, stuck: false, size, bytes: Vec::new() };
        Self(Arc::new((Mutex::new(platter), Condvar::new())))
    }

    fn hold(&self, held: bool) {
        self.0.0.lock().unwrap().held = held;
        self.0.1.notify_all();
    }

    fn is_stuck(&self) -> bool {
        self.0.0.lock().unwrap().stuck
    }

    fn records(&self) -> Vec<Record> {
        let bytes = self.0.0.lock().unwrap().bytes.clone();
        RecordingReader::new(&bytes[..]).unwrap().map(|record| record.expect("a sound record")).collect()
    }
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let waits = |platter: &mut Platter| {
            platter.stuck |= platter.held;
            platter.held
        };
        let mut platter = self.0.1.wait_while(self.0.0.lock().unwrap(), waits).unwrap();
        let taken = bytes.len().min(platter.size - platter.bytes.len());
        platter.bytes.extend_from_slice(&bytes[..taken]);
        if taken == 0 { Err(ErrorKind::StorageFull.into()) } else { Ok(taken) }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The recorder of a node with two tasks, and the table of that node.
fn recorder(
    disk: &Disk,
    failed: impl FnOnce(&WriteError) + Send + 'static,
) -> (Arc<FileRecorder>, NodeTable) {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    let here = NodeTable::new(table(cell), NodeId(0));
    let about =
        About { incarnation: (Incarnation(1), false), insecure: true, build: "a test", statements: 0 };
    (FileRecorder::start(disk.clone(), &here, &about, failed).expect("a recording"), here)
}

fn log(recorder: &Arc<FileRecorder>, task: TaskId) -> Box<dyn Log> {
    Arc::clone(recorder).log(task).expect("nobody has taken it")
}

fn no_failure(error: &WriteError) {
    panic!("{error}");
}

fn wait_for(what: &str, mut done: impl FnMut() -> bool) {
    let start = Instant::now();
    while !done() {
        assert!(start.elapsed() < LONG, "{what}");
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
}

/// Only the node owns the recorder, so the recording ends when the node ends, and not before.
#[test]
fn a_recording_lasts_as_long_as_its_node() {
    const TIMES: usize = 50;
    let disk = Disk::of(usize::MAX);
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    let table = table(cell);
    let here = NodeTable::new(Arc::clone(&table), NodeId(0));
    let about =
        About { incarnation: (Incarnation(0), false), insecure: true, build: "a test", statements: 0 };
    let recorder = FileRecorder::start(disk.clone(), &here, &about, no_failure).expect("a recording");
    let node = one_node(&table).recorder(recorder).task("a", |ctx| {
        let port = ctx.port("ask")?;
        for _ in 0..TIMES {
            assert!(ctx.send(port, b"?")?.reply().is_some());
        }
        Ok(())
    });
    let node = node.task("b", |ctx| {
        for _ in 0..TIMES {
            let message = ctx.receive(None, None)?.expect("it waits without end");
            ctx.reply(&message.from, b"!")?;
        }
        Ok(())
    });
    finish(node.start().expect("a node that starts"));
    let is_ended = || matches!(disk.records().last(), Some(Record::End));
    wait_for("the recording does not end with its node", is_ended);
    let inputs =
        |of| disk.records().iter().filter(|r| matches!(r, Record::Input { task, .. } if *task == of)).count();
    // For task `a` these inputs are the request and its answer; for task `b` they are the receive, the message and the reply.
    assert!(inputs(A) >= 2 * TIMES && inputs(B) >= 3 * TIMES, "{} and {}", inputs(A), inputs(B));
}

fn contents() -> impl Strategy<Value = Contents> {
    prop::collection::vec(any::<u8>(), 0..=12).prop_map(|bytes| Contents::new(&bytes).expect("they fit"))
}

fn ticks() -> impl Strategy<Value = Ticks> {
    prop_oneof![Just(0), 0..1_000_u64, any::<u64>()].prop_map(Ticks)
}

fn id() -> impl Strategy<Value = MessageId> {
    let of = |(incarnation, number)| MessageId {
        incarnation: Incarnation(incarnation),
        sequence: Seq24::new(number),
    };
    any::<(u8, u32)>().prop_map(of)
}

fn reply_to() -> impl Strategy<Value = ReplyTo> {
    let of = |(port, source, id)| ReplyTo { port: PortId(port), source: TaskId(source), id };
    (any::<u16>(), any::<u16>(), id()).prop_map(of)
}

fn packet() -> impl Strategy<Value = Packet> {
    let how = (0..8_usize, any::<[bool; 3]>(), (0..8_u8, 0..16_u8), any::<[u16; 3]>());
    (how, id(), ticks(), contents()).prop_map(
        |((kind, [status, more, resent], (hops, fragment), [to, from, port]), id, remaining, contents)| {
            Packet {
                kind: Kind::ALL[kind],
                class: if status { Class::Status } else { Class::Command },
                more,
                resent,
                hops,
                fragment,
                destination: TaskId(to),
                source: TaskId(from),
                port: PortId(port),
                id,
                remaining,
                contents,
                seal: Seal::NONE,
            }
        },
    )
}

fn request() -> impl Strategy<Value = Request> {
    let target = prop_oneof![
        Just(Target::All),
        any::<u16>().prop_map(|task| Target::One(TaskId(task))),
        any::<u64>().prop_map(Target::Some)
    ];
    let port = || any::<u16>().prop_map(PortId);
    let time = || prop::option::of(ticks());
    let id = || any::<u8>().prop_map(TimeId);
    let send = (port(), target, contents(), time());
    let get = (prop::option::of(port()), prop::option::of(any::<u16>().prop_map(TaskId)), time());
    prop_oneof![
        send.prop_map(|(port, to, contents, time_out)| Request::Send { port, to, contents, time_out }),
        get.prop_map(|(port, source, time_out)| Request::Get { port, source, time_out }),
        (reply_to(), contents()).prop_map(|(to, contents)| Request::Reply { to, contents }),
        (port(), any::<u8>(), contents()).prop_map(|(port, index, contents)| Request::Part {
            port,
            index,
            contents
        }),
        (port(), any::<[u8; 8]>(), time()).prop_map(|(port, arguments, time_out)| Request::Arrive {
            port,
            arguments,
            time_out
        }),
        // This is the longest request, encoded with postcard.
        any::<u16>().prop_map(|port| {
            Request::Order(
                ServiceOrder::new(&[Ranked::Port(PortId(port)); ServiceOrder::LEVELS]).expect("they fit"),
            )
        }),
        (port(), any::<bool>()).prop_map(|(port, handled)| Request::Handle { port, handled }),
        (id(), ticks()).prop_map(|(id, length)| Request::Delay { id, length }),
        (id(), ticks()).prop_map(|(id, length)| Request::Start { id, length }),
        id().prop_map(|id| Request::Stop { id }),
        contents().prop_map(Request::Publish),
        any::<bool>().prop_map(Request::Atomic),
        prop::sample::select(vec![
            Request::Boundary,
            Request::Work,
            Request::Done,
            Request::Return,
            Request::Lease,
            Request::End,
            Request::Cancel,
            Request::Abandon,
        ]),
    ]
}

fn input() -> impl Strategy<Value = Input> {
    prop_oneof![
        Just(Input::Time),
        request().prop_map(Input::Request),
        packet().prop_map(Input::Packet),
        any::<(u8, u8)>().prop_map(|(id, turn)| Input::TimeOut { id: TimeId(id), turn }),
        id().prop_map(Input::Unsent),
        any::<u16>().prop_map(|node| Input::PeerRestarted(NodeId(node))),
        any::<u16>().prop_map(|node| Input::PeerStopped(NodeId(node))),
    ]
}

fn script_step() -> impl Strategy<Value = ScriptStep> {
    prop_oneof![
        any::<u64>().prop_map(|at| ScriptStep::Begin { at }),
        any::<(u8, bool, i32)>().prop_map(|(level, ok, value)| ScriptStep::Acted { level, ok, value }),
        any::<u16>().prop_map(ScriptStep::Chosen),
        Just(ScriptStep::Stopped),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(64) })]

    #[test]
    fn whatever_is_taken_is_written_down_as_it_was(
        steps in prop::collection::vec(
            (any::<u64>(), prop_oneof![
                3 => (ticks(), input()).prop_map(|(elapsed, input)| Ok(Step { elapsed, input })),
                1 => script_step().prop_map(Err),
            ]),
            1..100,
        ),
    ) {
        let disk = Disk::of(usize::MAX);
        let (recorder, _) = recorder(&disk, no_failure);
        let mut log = log(&recorder, B);
        let (mut expected, task) = (Vec::new(), B);
        let (mut inputs, mut outputs) = (0, OutputDigest::START.0);
        for (digest, step) in steps {
            expected.push(match step {
                Ok(step) => {
                    prop_assert!(!log.step(&step, OutputDigest(digest)), "nothing is lost");
                    (inputs, outputs) = (inputs + 1, digest);
                    Record::Input { task, elapsed: step.elapsed, input: step.input, outputs }
                }
                Err(step) => {
                    log.script(step, OutputDigest(digest));
                    Record::Script { task, step, done: digest }
                }
            });
        }
        let status = recorder.stop(LONG).expect("stopped once");
        prop_assert!(status.ended && status.lost == 0, "{:?}", status);
        expected.insert(0, Record::Close { task: A, inputs: 0, outputs: OutputDigest::START.0 });
        // Either of the two tasks may end first.
        let records = disk.records();
        let (mut closes, rest): (Vec<_>, Vec<_>) =
            records.into_iter().partition(|record| matches!(record, Record::Close { task: A, .. }));
        closes.extend(rest);
        expected.push(Record::Close { task, inputs, outputs });
        expected.push(Record::End);
        prop_assert_eq!(closes, expected);
    }
}

#[test]
fn a_task_has_one_log_and_that_of_another_node_none() {
    let disk = Disk::of(usize::MAX);
    let (recorder, _) = recorder(&disk, no_failure);
    let _log = log(&recorder, A);
    assert!(Arc::clone(&recorder).log(A).is_none() && Arc::clone(&recorder).log(TaskId(7)).is_none());
}

const TICK: Step = Step { elapsed: Ticks(1), input: Input::Time };

/// Records one step again and again until a step is lost. Returns how many were recorded.
fn fill(recorder: &FileRecorder, log: &mut dyn Log) -> u64 {
    let before = recorder.status().expect("it runs").lost;
    (0..)
        .take_while(|&number| {
            log.step(&TICK, OutputDigest(number));
            recorder.status().expect("it runs").lost == before
        })
        .count() as u64
}

#[test]
fn a_keyframe_is_wanted_once_the_disk_keeps_up_again_and_nothing_is_recorded_before_it() {
    let disk = Disk::of(usize::MAX);
    let (recorder, here) = recorder(&disk, no_failure);
    let (mut stream, mut other) = (log(&recorder, A), log(&recorder, B));
    disk.hold(true);
    // When the writing thread begins to wait for the disk, it has taken some records from the lane. From then on it
    // makes no room.
    let mut taken = 0;
    wait_for("the disk to be stuck", || {
        assert!(!stream.step(&TICK, OutputDigest(0)), "there is room for all of these");
        taken += 1;
        disk.is_stuck()
    });
    taken += fill(&recorder, stream.as_mut());
    assert!(!stream.step(&TICK, OutputDigest(0)), "there is no room: it would be lost as well");
    // The other task has a lane of its own, with room.
    let lost = recorder.status().expect("it runs").lost;
    assert!(!other.step(&TICK, OutputDigest(1)));
    other.script(ScriptStep::Chosen(1), OutputDigest(2));
    assert_eq!(recorder.status().expect("it runs").lost, lost);
    disk.hold(false);
    wait_for("room for a keyframe", || stream.wants_keyframe());
    for _ in 0..5 {
        assert!(stream.step(&TICK, OutputDigest(0)), "there is room, but it could not be replayed");
    }
    stream.script(ScriptStep::Stopped, OutputDigest(0));
    let lost = recorder.status().expect("it runs").lost;
    let machine = imrs_protocol::CommTask::new(&here, A, Incarnation(1), false);
    stream.keyframe(&machine, OutputDigest(42));
    assert!(!stream.wants_keyframe() && !stream.step(&TICK, OutputDigest(43)));
    let status = recorder.stop(LONG).expect("stopped once");
    assert!(status.ended && status.lost == lost, "{status:?}");
    assert!(!stream.step(&TICK, OutputDigest(44)) && !stream.wants_keyframe(), "nothing is written any more");

    let of_a: Vec<_> = disk
        .records()
        .into_iter()
        .filter(|record| match record {
            Record::Input { task, .. } | Record::Script { task, .. } | Record::Keyframe { task, .. } => {
                *task == A
            }
            Record::Close { task, .. } => *task == A,
            Record::Gap { stream, .. } => *stream == Stream::Task(A),
            _ => false,
        })
        .collect();
    let (before, after) = of_a.split_at(usize::try_from(taken).unwrap());
    assert!(before.iter().all(|record| matches!(record, Record::Input { .. })), "all that was taken");
    let Some((Record::Gap { lost: told, .. }, after)) = after.split_first() else { panic!("{after:?}") };
    assert_eq!(*told, lost);
    let state = postcard::to_allocvec(&machine).unwrap();
    let input = TICK.input;
    // One of the lost records was a script's, and one input came after the keyframe.
    let inputs = taken + (lost - 1) + 1;
    let expected = [
        Record::Keyframe { task: A, state, outputs: 42 },
        Record::Input { task: A, elapsed: Ticks(1), input, outputs: 43 },
        Record::Close { task: A, inputs, outputs: 43 },
    ];
    assert_eq!(after, expected);
}

#[test]
fn after_a_full_disk_everything_is_lost_and_counted() {
    let disk = Disk::of(1_000);
    let (tell, told) = std::sync::mpsc::channel();
    let (recorder, _) = recorder(&disk, move |error| tell.send(error.to_string()).unwrap());
    let mut log = log(&recorder, A);
    wait_for("the disk to be full", || {
        log.step(&TICK, OutputDigest(1));
        recorder.status().expect("it runs").failure.is_some()
    });
    assert!(told.recv_timeout(LONG).unwrap().starts_with("the recording cannot be written"));
    let before = recorder.status().expect("it runs").lost;
    for _ in 0..10 {
        assert!(!log.step(&TICK, OutputDigest(1)), "no keyframe would be written either");
    }
    let status = recorder.stop(LONG).expect("stopped once");
    assert_eq!((status.lost, status.ended), (before + 10, false));
}
