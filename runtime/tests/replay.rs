//! Tests that a replay of a node's recorded inputs gives bit-equal outputs (D62).

use crate::common::kept::Kept;
use crate::common::{LONG, LONG_TICKS, Tape, ask, busy, cell, finish, meets_and_asks, on, one_node, table};
use imrs_protocol::{CellTable, Incarnation, Input, NodeId, NodeTable, Request, TaskId, Ticks};
use imrs_runtime::record::{About, FileRecorder, OutputDigest, Recorded, Recorder, Step, replay};
use imrs_wire::recording::{Record, RecordingReader};
use std::collections::BTreeMap;
use std::sync::Arc;

fn run_recorded() -> (Arc<CellTable>, BTreeMap<TaskId, Vec<Recorded>>) {
    let (table, network) = busy();
    let tape = Arc::new(Tape::default());
    let builder = |(node, task)| {
        let recorder: Arc<dyn Recorder> = Arc::clone(&tape) as _;
        on(&network, &table, node).recorder(recorder).task(task, |ctx| meets_and_asks(ctx, 20))
    };
    let builders: Vec<_> = (0..3).zip(["a", "b", "c"]).map(builder).collect();
    let nodes: Vec<_> = builders.into_iter().map(|node| node.start().unwrap()).collect();
    assert!(nodes.iter().all(|node| node.wait(LONG)));
    nodes.into_iter().for_each(finish);
    let steps = std::mem::take(&mut *tape.closed.lock().unwrap());
    (table, steps)
}

#[test]
fn a_recorded_run_of_three_nodes_replays_bit_equal_and_a_change_is_noticed() {
    let (table, logs) = run_recorded();
    assert_eq!(logs.len(), 3);
    for (&task, log) in &logs {
        let node = NodeTable::new(Arc::clone(&table), NodeId(task.0));
        let again = |log: Vec<Recorded>| replay(&node, task, Incarnation(1), false, log);
        assert!(log.len() > 100, "{task} took only {} inputs", log.len());
        assert_eq!(again(log.clone()), Ok(log.len()));

        // A changed argument in one arrival changes the packets that follow.
        let arrives = |entry: &Recorded| matches!(entry.step.input, Input::Request(Request::Arrive { .. }));
        let position = log.iter().position(arrives).expect("every task meets");
        let mut changed = log.clone();
        if let Input::Request(Request::Arrive { arguments, .. }) = &mut changed[position].step.input {
            arguments[7] ^= 1;
        }
        assert_eq!(again(changed).unwrap_err().index, position);

        let mut shorter = log.clone();
        shorter.remove(position);
        assert!(again(shorter).is_err(), "an input that is missing");

        // The test adds a hundred seconds to one step. A task that waited at that step would have given up by then.
        let waits = (0..log.len() - 1).filter(|&at| arrives(&log[at]));
        let mut noticed = waits.filter(|&at| {
            let mut later = log.clone();
            later[at + 1].step.elapsed += Ticks(100_000_000);
            again(later).is_err()
        });
        assert!(noticed.next().is_some(), "other times");
        assert!(
            replay(&node, task, Incarnation(2), false, log.clone()).is_err(),
            "another life sends other ids"
        );
    }
}

#[test]
fn a_recording_in_a_file_replays_bit_equal() {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    let table = table(cell);
    let here = NodeTable::new(Arc::clone(&table), NodeId(0));
    let kept = Kept::default();
    let incarnation = (Incarnation(4), false);
    let failed = |error: &imrs_wire::recording::WriteError| panic!("{error}");
    let recorder = FileRecorder::start(
        kept.clone(),
        &here,
        &About { incarnation, insecure: false, build: "a test", statements: 0 },
        failed,
    )
    .unwrap();
    let node = one_node(&table)
        .incarnation(incarnation.0, incarnation.1)
        .recorder(Arc::clone(&recorder) as _)
        .task("a", |ctx| {
            let ask = ctx.port("ask")?;
            for number in 0..200_u8 {
                assert!(ctx.send(ask, &[number])?.reply().is_some());
            }
            Ok(())
        })
        .task("b", |ctx| {
            for _ in 0..200 {
                let question = ctx.receive(None, None)?.expect("only a message ends it");
                ctx.reply(&question.from, question.contents.as_bytes())?;
            }
            Ok(())
        })
        .start()
        .unwrap();
    finish(node);
    let status = recorder.stop(LONG).expect("it was not stopped before");
    assert!(status.ended && status.lost == 0, "{status:?}");
    assert_eq!((recorder.status(), recorder.stop(LONG)), (None, None));

    let bytes = kept.0.lock().unwrap().clone();
    let mut reader = RecordingReader::new(&bytes[..]).unwrap();
    let mut logs: BTreeMap<TaskId, Vec<Recorded>> = BTreeMap::new();
    while let Some(record) = reader.next_record().unwrap() {
        match record {
            Record::Input { task, elapsed, input, outputs } => {
                let step = Step { elapsed, input };
                logs.entry(task).or_default().push(Recorded { step, digest: OutputDigest(outputs) });
            }
            Record::Header(header) => {
                assert_eq!((header.digest, header.incarnation), (table.digest(), incarnation.0));
            }
            Record::Script { .. } | Record::Close { .. } | Record::End => {}
            other @ (Record::Keyframe { .. } | Record::Gap { .. } | Record::Frame { .. }) => {
                panic!("{other:?}")
            }
        }
    }
    assert_eq!(logs.len(), 2);
    for (task, log) in logs {
        assert!(log.len() >= 400);
        assert_eq!(replay(&here, task, incarnation.0, incarnation.1, log.clone()), Ok(log.len()));
    }
}
