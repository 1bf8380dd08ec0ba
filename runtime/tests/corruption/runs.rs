//! Recordings of runs in which a little of everything happens.

use crate::common::kept::Kept;
use crate::common::{A, B, LONG, busy, cell, finish, meets_and_asks, network, on, table};
use imrs_protocol::script::{Binary, Op, Outcomes, Program, ProgramBuilder, StatementOutcome, Type};
use imrs_protocol::{Incarnation, NodeId, NodeTable, PortDecl, PortId, Target, TaskId, Ticks, Usage};
use imrs_runtime::Runtime;
use imrs_runtime::link::in_process::Faults;
use imrs_runtime::record::{About, FileRecorder, statements};
use imrs_runtime::script::{Actions, Call, Functions, Simulated};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicI32, Ordering};

const INCARNATION: (Incarnation, bool) = (Incarnation(1), false);

/// The recording of a node, with the table and the scripts that its replay needs.
pub struct Recorded {
    pub table: NodeTable,
    pub programs: BTreeMap<TaskId, Arc<Program>>,
    pub bytes: Vec<u8>,
}

struct Recording(Arc<FileRecorder>, Kept);

impl Recording {
    fn of(table: &NodeTable, programs: &BTreeMap<TaskId, Arc<Program>>) -> Self {
        let kept = Kept::default();
        let statements = statements(programs.iter().map(|(&task, program)| (task, &**program)));
        let about = About { incarnation: INCARNATION, insecure: false, build: "a test", statements };
        let failed = |error: &imrs_wire::recording::WriteError| panic!("{error}");
        Self(FileRecorder::start(kept.clone(), table, &about, failed).unwrap(), kept)
    }

    fn end(self, table: NodeTable, programs: BTreeMap<TaskId, Arc<Program>>) -> Recorded {
        let status = self.0.stop(LONG).expect("it was not stopped before");
        assert!(status.ended && status.lost == 0, "{status:?}");
        let bytes = std::mem::take(&mut *self.1.0.lock().unwrap());
        Recorded { table, programs, bytes }
    }
}

/// The recordings of three nodes with a Rust task each.
pub fn tasks() -> Vec<Recorded> {
    let (table, network) = busy();
    let start = |(node, task)| {
        let here = NodeTable::new(Arc::clone(&table), NodeId(node));
        let recording = Recording::of(&here, &BTreeMap::new());
        let builder = on(&network, &table, node)
            .recorder(Arc::clone(&recording.0) as _)
            .task(task, |ctx| meets_and_asks(ctx, 15));
        (here, recording, builder)
    };
    let nodes: Vec<_> = (0..3).zip(["a", "b", "c"]).map(start).collect();
    let nodes: Vec<_> = nodes.into_iter().map(|(here, r, node)| (here, r, node.start().unwrap())).collect();
    assert!(nodes.iter().all(|(.., node)| node.wait(LONG)));
    let end = |(here, recording, node): (_, Recording, _)| {
        finish(node);
        recording.end(here, BTreeMap::new())
    };
    nodes.into_iter().map(end).collect()
}

const ASK: PortId = PortId(0);

/// A script that measures, and asks a question with the measured value. Every third measurement fails, and then the
/// script asks nothing.
fn measurer(times: i64) -> Arc<Program> {
    let mut b = ProgramBuilder::new("a");
    let [i, n, answer] = ["i", "n", "answer"].map(|name| b.variable(name, Type::Int32));
    let (top, next, over) = (b.label(), b.label(), b.label());
    b.put(top);
    b.run("measure", Ticks(0), Ticks(1_000_000));
    b.when(Outcomes::of(&[StatementOutcome::Failed]), |b| {
        b.jump(next);
    });
    b.op(Op::Value).store(n);
    b.send(ASK, Target::All, &[(Type::Int32, n)]).unpack(&[(Type::Int32, answer)]);
    b.when(Outcomes::TIME_OUT, |b| {
        b.jump(next);
    });
    b.put(next);
    b.statement().load(i).push(1).int(Binary::Add).store(i);
    b.statement().load(i).push(times).int(Binary::Less).unless(over).jump(top);
    b.put(over);
    b.end();
    Arc::new(b.finish().expect("a sound program"))
}

/// A script that answers each question with the received number plus one, in an endless loop.
fn answerer() -> Arc<Program> {
    let mut b = ProgramBuilder::new("b");
    let n = b.variable("n", Type::Int32);
    b.forever(|b| {
        b.receive(ASK, None, &[(Type::Int32, n)]);
        b.statement().load(n).push(1).int(Binary::Add).store(n);
        b.reply(&[(Type::Int32, n)]);
    });
    b.end();
    Arc::new(b.finish().expect("a sound program"))
}

/// The recordings of two nodes with a script each.
pub fn scripts() -> Vec<Recorded> {
    let mut cell = cell(&[0, 1], Ticks(2_000));
    cell.port(PortDecl::new("ask", A, Usage::Send, &[B], Ticks(40_000)).command().retry(1, Ticks(15_000)));
    let table = table(cell);
    let faults = Faults { seed: 7, loss: 0.1, ..Faults::default() };
    let network = network(&table, faults);
    let count = AtomicI32::new(0);
    // Calls 1, 2, 4, 5, 7 and so on of the action succeed: every third call fails.
    let measure = move |_: &Call| match count.fetch_add(1, Ordering::Relaxed) {
        n if n % 3 == 2 => Err("nothing to see".into()),
        n => Ok(n + 1),
    };
    let simulated: Arc<dyn Actions> = Simulated::start(1, Vec::new(), Vec::new()).expect("a thread");
    let functions: Arc<dyn Actions> = Arc::new(Functions::new(simulated).action("measure", measure));
    let start = |(node, task, program): (u16, TaskId, Arc<Program>)| {
        let here = NodeTable::new(Arc::clone(&table), NodeId(node));
        let programs = BTreeMap::from([(task, Arc::clone(&program))]);
        let recording = Recording::of(&here, &programs);
        let name = &table.cell().tasks[task.index()].name;
        let builder = on(&network, &table, node).actions(Arc::clone(&functions));
        let builder = builder.recorder(Arc::clone(&recording.0) as _).script(name, program);
        (here, recording, programs, builder)
    };
    // The answering node starts before the other node asks it.
    let nodes = [(1, B, answerer()), (0, A, measurer(40))].map(start);
    let nodes =
        nodes.map(|(here, recording, programs, node)| (here, recording, programs, node.start().unwrap()));
    assert!(nodes[1].3.wait(LONG));
    let end = |(here, recording, programs, node): (_, Recording, _, Runtime)| {
        let _ends = node.stop(LONG);
        recording.end(here, programs)
    };
    nodes.map(end).into()
}
