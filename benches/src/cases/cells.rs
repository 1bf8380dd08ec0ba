//! Small cells for the benchmark cases, and the tasks that run in them.

use crate::sample::{Sample, laps, nanos_of};
use imrs_protocol::script::{Binary, End, Program, ProgramBuilder, Type};
use imrs_protocol::{Cell, CellTable, NodeId, PortDecl, PortId, Target, TaskId, Ticks, Usage};
use imrs_runtime::{AsyncContext, Context, Rendezvous, Runtime, TaskEnd, TaskError};
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

/// The task that asks.
pub const A: TaskId = TaskId(0);
/// The task that answers.
pub const B: TaskId = TaskId(1);
/// The port on which A asks.
pub const ASK: PortId = PortId(0);
/// The TTL of every message. It is longer than any case takes, so a message that expires makes its case fail.
pub const LONG: Duration = Duration::from_secs(60);
/// [`LONG`] in ticks of one microsecond.
pub const LONG_TICKS: Ticks = Ticks(60_000_000);
/// How many round trips are made before anything is timed.
pub const WARM_UP: u32 = 100;

/// A cell of `tasks` tasks, spread over `nodes` nodes that are all linked with each other.
pub fn cell(tasks: usize, nodes: usize) -> Cell {
    let mut cell = Cell::new("bench", Ticks(1));
    for node in 0..nodes {
        cell.node(&format!("n{node}"));
        for other in 0..node {
            cell.link(NodeId::from_index(other), NodeId::from_index(node), Ticks(2_000));
        }
    }
    for task in 0..tasks {
        cell.task(&format!("t{task}"), NodeId::from_index(task % nodes));
    }
    cell
}

/// Checks a cell and makes its table.
pub fn table(cell: Cell) -> Arc<CellTable> {
    Arc::new(CellTable::new(cell).expect("a sound cell"))
}

/// The longest contents that fit in one packet.
pub const FULL: [u8; 12] = [7; 12];
/// Contents that hold one number, in the layout that the scripts of these cases use.
pub const NUMBER: [u8; 4] = [7; 4];

/// A cell in which A asks B, by `send` (class 2) or by `query`.
pub fn asking(nodes: usize, usage: Usage) -> Arc<CellTable> {
    let mut cell = cell(2, nodes);
    cell.port(PortDecl::new("ask", A, usage, &[B], LONG_TICKS).command());
    table(cell)
}

/// Asks `times` times, after some round trips to warm up. Returns the measured times, and the number of sleeps of all
/// threads per round trip.
pub fn ask(ctx: &mut Context, contents: &[u8], times: u32, group: u32) -> Result<Sample, TaskError> {
    let mut failed = None;
    let mut round_trip = || match ctx.send(ASK, contents) {
        Ok(sent) => assert!(sent.reply().is_some(), "no answer but {sent:?}"),
        Err(error) => failed = Some(error),
    };
    laps(WARM_UP, 1, &mut round_trip);
    let before = crate::cores::Sleeps::now();
    let nanos = laps(times, group, &mut round_trip);
    let slept = before.since() as f64 / f64::from(times);
    match failed {
        Some(error) => Err(error),
        None => Ok(Sample::of(nanos, group).with(slept)),
    }
}

/// Answers until the node stops.
pub fn answer(ctx: &mut Context) -> Result<(), TaskError> {
    let mut next = ctx.receive(Some(ASK), None)?;
    while let Some(message) = next {
        next = ctx.reply_and_receive(&message.from, message.contents.as_bytes(), Some(ASK), None)?;
    }
    Ok(())
}

/// As [`ask`], in a task that is a future. Returns the measured times, each of `group` round trips.
pub async fn ask_as_future(ctx: &mut AsyncContext, times: u32, group: u32) -> Result<Sample, TaskError> {
    let mut nanos = Vec::with_capacity(usize::try_from(times / group).unwrap_or_default());
    for round in 0..=times / group {
        let begins = Instant::now();
        for _ in 0..group {
            let sent = ctx.send(ASK, &FULL).await?;
            assert!(sent.reply().is_some(), "no answer but {sent:?}");
        }
        // The first group of round trips warms up, and is not counted.
        if round > 0 {
            nanos.push(nanos_of(begins.elapsed()));
        }
    }
    Ok(Sample::of(nanos, group))
}

/// Does what [`answer`] does, in a task that is a future.
pub async fn answer_as_future(mut ctx: AsyncContext) -> Result<(), TaskError> {
    let mut next = ctx.receive(Some(ASK), None).await?;
    while let Some(message) = next {
        next = ctx.reply_and_receive(&message.from, message.contents.as_bytes(), Some(ASK), None).await?;
    }
    Ok(())
}

/// Waits at the rendezvous until all members have arrived, and fails if the task gave up.
pub fn meet(ctx: &mut Context, port: PortId) -> Result<(), TaskError> {
    match ctx.waitfor(port)? {
        Rendezvous::Released { .. } => Ok(()),
        Rendezvous::GaveUp { missing, .. } => panic!("{missing:#b} were missing"),
    }
}

/// Waits for the result that a task of the node sends through `told`, and then stops the node.
pub fn hear<T>(node: Runtime, told: &Receiver<T>) -> T {
    let heard = told.recv_timeout(LONG);
    stop(node);
    heard.expect("the task that measures told what it measured")
}

/// Stops a node, and checks that no task of it has failed.
pub fn stop(node: Runtime) {
    let ends = node.stop(LONG);
    let well = |end: &TaskEnd| matches!(end, TaskEnd::Returned | TaskEnd::Script(End::Finished));
    assert!(ends.iter().all(|(_, end)| well(end)), "{ends:?}");
}

/// A script that asks `times` questions and ends.
pub fn asker(times: u32) -> Arc<Program> {
    let mut b = ProgramBuilder::new("asker");
    let (n, answer) = (b.variable("n", Type::Int32), b.variable("answer", Type::Int32));
    let (top, over) = (b.label(), b.label());
    b.put(top);
    b.send(ASK, Target::All, &[(Type::Int32, n)]).unpack(&[(Type::Int32, answer)]);
    b.statement().load(n).push(1).int(Binary::Add).store(n);
    b.statement().load(n).push(i64::from(times)).int(Binary::Less).unless(over).jump(top);
    b.put(over);
    b.end();
    Arc::new(b.finish().expect("a sound program"))
}

/// A script that answers every question, in an endless loop.
pub fn answerer() -> Arc<Program> {
    let mut b = ProgramBuilder::new("answerer");
    let n = b.variable("n", Type::Int32);
    b.forever(|b| {
        b.receive(ASK, None, &[(Type::Int32, n)]);
        b.reply(&[(Type::Int32, n)]);
    });
    b.end();
    Arc::new(b.finish().expect("a sound program"))
}

/// A script that meets the other tasks `times` times and ends.
pub fn meeter(port: PortId, times: u32) -> Arc<Program> {
    let mut b = ProgramBuilder::new("meeter");
    let n = b.variable("n", Type::Int32);
    let (top, over) = (b.label(), b.label());
    b.put(top);
    b.waitfor(port);
    b.statement().load(n).push(1).int(Binary::Add).store(n);
    b.statement().load(n).push(i64::from(times)).int(Binary::Less).unless(over).jump(top);
    b.put(over);
    b.end();
    Arc::new(b.finish().expect("a sound program"))
}
