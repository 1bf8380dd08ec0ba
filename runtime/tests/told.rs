//! A script takes the signal of a fused step before any other input of its task. This holds even if a turn (hold of
//! the lock) ends, or another thread brings input, before the script goes on. Otherwise a recording could not be
//! replayed (D207).

use crate::common::kept::Kept;
use crate::common::{LONG, LONG_TICKS, one_node, table};
use imrs_protocol::script::{Binary, End, Op, Outcomes, Program, ProgramBuilder, Type};
use imrs_protocol::{Cell, Incarnation, NodeId, NodeTable, PortDecl, PortId, Target, TaskId, Ticks, Usage};
use imrs_runtime::TaskEnd;
use imrs_runtime::record::{About, FileRecorder, RecordingReader, Verdict, replay_scripts, statements};
use std::collections::BTreeMap;
use std::sync::Arc;

/// How many scripts receive: more than can take their signals in one turn.
const RECEIVERS: u16 = 60;
const ROUNDS: i64 = 100;
const MESSAGES: u16 = 20_000;
const NEWS: PortId = PortId(0);
const SENDER: TaskId = TaskId(RECEIVERS);
const THREAD: TaskId = TaskId(RECEIVERS + 1);

/// A script that sends all receivers a message each, one by one, and then waits a little.
fn sender() -> Arc<Program> {
    let mut b = ProgramBuilder::new("sender");
    let n = b.variable("n", Type::Int32);
    let format = b.format(&[]);
    let (top, over) = (b.label(), b.label());
    b.put(top);
    for to in (0..RECEIVERS).map(|to| Target::One(TaskId(to))) {
        b.statement().op(Op::Send { port: NEWS, to, format, time_out: None });
    }
    b.delay(Ticks(100));
    b.statement().load(n).push(1).int(Binary::Add).store(n);
    b.statement().load(n).push(ROUNDS).int(Binary::Less).unless(over).jump(top);
    b.put(over);
    b.end();
    Arc::new(b.finish().expect("a sound program"))
}

/// A script that receives messages until none has come for some time.
fn receiver(name: &str) -> Arc<Program> {
    let mut b = ProgramBuilder::new(name);
    let (top, over) = (b.label(), b.label());
    b.put(top);
    b.statement().op(Op::Get { port: None, source: None, time_out: Some(Ticks(300_000)) });
    b.on(Outcomes::TIME_OUT, over).jump(top);
    b.put(over);
    b.end();
    Arc::new(b.finish().expect("a sound program"))
}

#[test]
fn a_script_takes_its_signal_before_what_another_thread_brings() {
    let mut cell = Cell::new("told", Ticks(1_000));
    let here = cell.node("n0");
    let names: Vec<String> = (0..RECEIVERS).map(|number| format!("r{number}")).collect();
    let receivers: Vec<TaskId> = names.iter().map(|name| cell.task(name, here)).collect();
    assert_eq!([cell.task("sender", here), cell.task("thread", here)], [SENDER, THREAD]);
    for (name, owner) in [("news", SENDER), ("more", THREAD)] {
        cell.port(PortDecl::new(name, owner, Usage::Send, &receivers, LONG_TICKS).bounded_buffer(4));
    }
    let table = table(cell);
    let of_node = NodeTable::new(Arc::clone(&table), NodeId(0));
    let mut programs: BTreeMap<TaskId, Arc<Program>> =
        receivers.iter().zip(&names).map(|(&task, name)| (task, receiver(name))).collect();
    programs.insert(SENDER, sender());
    let statements = statements(programs.iter().map(|(&task, program)| (task, &**program)));
    let about = About { incarnation: (Incarnation(0), false), insecure: true, build: "a test", statements };
    let kept = Kept::default();
    let failed = |error: &_| panic!("memory takes everything: {error}");
    let recorder = FileRecorder::start(kept.clone(), &of_node, &about, failed).expect("a recording");
    let node = programs
        .iter()
        .fold(one_node(&table).recorder(Arc::clone(&recorder) as _), |node, (task, program)| {
            node.script(&table.cell().tasks[task.index()].name, Arc::clone(program))
        });
    let node = node.task("thread", |ctx| {
        let more = ctx.port("more")?;
        for number in 0..MESSAGES {
            let to = Target::One(TaskId(number % RECEIVERS));
            let _copies = ctx.send_with(more, to, &number.to_le_bytes(), None)?;
        }
        Ok(())
    });
    let node = node.start().expect("a node that starts");
    assert!(node.wait(LONG), "a program did not end");
    let ends = node.stop(LONG);
    let well = |end: &TaskEnd| matches!(end, TaskEnd::Returned | TaskEnd::Script(End::Finished));
    assert!(ends.iter().all(|(_, end)| well(end)), "{ends:?}");
    let status = recorder.stop(LONG).expect("it was not stopped before");
    assert!(status.ended, "{status:?}");
    let bytes = kept.0.lock().unwrap().clone();
    let mut reader = RecordingReader::new(&bytes[..]).expect("a recording");
    let replays =
        replay_scripts(&mut reader, &of_node, |task| programs.get(&task), None).expect("a sound one");
    for replay in &replays {
        // If the lane of a task was full, its recording has a gap, and is judged only as far as it goes.
        let verdict = replay.verdict();
        assert!(
            verdict == Verdict::Same || (replay.lost() > 0 && verdict == Verdict::Unknown),
            "{verdict:?}"
        );
    }
    assert!(replays.iter().any(|replay| replay.judged() > 300), "too few steps");
}
