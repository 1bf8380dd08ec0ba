//! Cells and small helpers shared by the tests with real threads.

pub mod kept;
pub mod monitor;
pub mod udp;

use imrs_protocol::{Cell, CellTable, Class, NodeId, PortDecl, TaskId, Ticks, Usage};
use imrs_runtime::link::in_process::{Faults, Network};
use imrs_runtime::record::{Log, OutputDigest, Recorded, Recorder, Step};
use imrs_runtime::{Builder, Context, Runtime, TaskEnd, TaskError};
use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// A time that is long enough, even on a busy machine, for every message that is not lost.
pub const LONG: Duration = Duration::from_secs(60);

/// The time of [`LONG`] in ticks.
pub const LONG_TICKS: Ticks = Ticks(60_000_000);

/// A time_out that expires in a test. It is long enough for all threads to run meanwhile, even on a busy machine.
pub const AMPLE: Duration = Duration::from_secs(4);

/// The time of [`AMPLE`] in ticks.
pub const AMPLE_TICKS: Ticks = Ticks(4_000_000);

pub const A: TaskId = TaskId(0);
pub const B: TaskId = TaskId(1);
pub const C: TaskId = TaskId(2);

/// A cell with tasks `a`, `b`, ... on the given nodes; links of `delay` join every two nodes.
pub fn cell(nodes: &[usize], delay: Ticks) -> Cell {
    let mut cell = Cell::new("test", Ticks(1_000));
    let count = nodes.iter().max().map_or(0, |&last| last + 1);
    for node in 0..count {
        cell.node(&format!("n{node}"));
        for other in 0..node {
            cell.link(NodeId::from_index(other), NodeId::from_index(node), delay);
        }
    }
    for (task, &node) in nodes.iter().enumerate() {
        let letter = u8::try_from(task).map(|t| char::from(b'a' + t)).expect("few tasks");
        cell.task(&letter.to_string(), NodeId::from_index(node));
    }
    cell
}

/// A class-2 port from `a` to `b`.
pub fn ask(time_out: Ticks) -> PortDecl {
    PortDecl::new("ask", A, Usage::Send, &[B], time_out).command()
}

pub fn table(cell: Cell) -> Arc<CellTable> {
    Arc::new(CellTable::new(cell).expect("a sound cell"))
}

pub fn one_node(table: &Arc<CellTable>) -> Builder {
    Runtime::builder(Arc::clone(table), NodeId(0))
}

/// The builder of a node of an in-process network, in its first incarnation. Until all nodes have joined, packets to
/// the missing nodes are lost. So make all builders before you start a node.
pub fn on(network: &Arc<Network>, table: &Arc<CellTable>, node: u16) -> Builder {
    let link = network.join(NodeId(node), imrs_protocol::Incarnation(1), false);
    Runtime::builder(Arc::clone(table), NodeId(node))
        .incarnation(imrs_protocol::Incarnation(1), false)
        .link(Arc::new(link))
}

pub fn network(table: &Arc<CellTable>, faults: Faults) -> Arc<Network> {
    Network::new(Arc::clone(table), faults)
}

/// A cell of three nodes with a task each, for [`meets_and_asks`], and a network that loses and repeats packets.
pub fn busy() -> (Arc<CellTable>, Arc<Network>) {
    let mut cell = cell(&[0, 1, 2], Ticks(2_000));
    cell.port(PortDecl::new("lift", A, Usage::Waitfor, &[B, C], Ticks(200_000)).resend(Ticks(10_000), 1));
    cell.port(PortDecl::new("news", A, Usage::Send, &[B, C], LONG_TICKS).bounded_buffer(4));
    cell.port(PortDecl::new("ask", A, Usage::Send, &[B], Ticks(40_000)).command().retry(1, Ticks(15_000)));
    let table = table(cell);
    let most_delay = Duration::from_millis(1);
    let network =
        network(&table, Faults { seed: 3, loss: 0.05, duplicates: 0.1, most_delay, ..Faults::default() });
    (table, network)
}

/// The program of a task of [`busy`]: it meets the other tasks `rounds` times. Between two meetings `a` sends a status
/// and asks, and the other tasks answer.
pub fn meets_and_asks(ctx: &mut Context, rounds: u8) -> Result<(), TaskError> {
    let (lift, news) = (ctx.port("lift")?, ctx.port("news")?);
    for round in 0..rounds {
        let _either = ctx.waitfor_with(lift, [round; 8], None)?;
        if ctx.id() == A {
            let _copies = ctx.send(news, &[round])?;
            let ask = ctx.port("ask")?;
            let _outcome = ctx.send(ask, &[round])?;
        } else {
            while let Some(message) = ctx.receive(None, Some(Duration::from_millis(5)))? {
                if message.class == Class::Command {
                    // A late reply is refused, and a recording must contain that, too.
                    let _late = ctx.reply(&message.from, b"yes");
                }
            }
        }
        ctx.delay(Duration::from_millis(1))?;
    }
    Ok(())
}

/// Waits for all programs, stops the node and expects that every program returned.
pub fn finish(runtime: Runtime) {
    assert!(runtime.wait(LONG), "a program did not end");
    let ends = runtime.stop(LONG);
    assert!(ends.iter().all(|(_, end)| *end == TaskEnd::Returned), "{ends:?}");
}

/// Calls `done` repeatedly until it returns true.
pub fn until(mut done: impl FnMut() -> bool) {
    let start = Instant::now();
    while !done() {
        assert!(start.elapsed() < LONG, "it never came");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// A channel for the reports of the programs.
pub fn report<T>() -> (Sender<T>, Receiver<T>) {
    channel()
}

/// A recorder that keeps everything in memory.
#[derive(Default)]
pub struct Tape {
    pub closed: Mutex<BTreeMap<TaskId, Vec<Recorded>>>,
}

struct TapeOf(Arc<Tape>, TaskId);

impl Recorder for Tape {
    fn log(self: Arc<Self>, task: TaskId) -> Option<Box<dyn Log>> {
        Some(Box::new(TapeOf(self, task)))
    }
}

impl Log for TapeOf {
    fn step(&mut self, &step: &Step, digest: OutputDigest) -> bool {
        self.0.closed.lock().unwrap().entry(self.1).or_default().push(Recorded { step, digest });
        false
    }
}

/// A recorder that wants the state of a task before each of its steps, so that the tasks take small steps.
pub struct SmallSteps;

impl Recorder for SmallSteps {
    fn log(self: Arc<Self>, _: TaskId) -> Option<Box<dyn Log>> {
        Some(Box::new(Self))
    }
}

impl Log for SmallSteps {
    fn step(&mut self, _: &Step, _: OutputDigest) -> bool {
        true
    }

    fn part(&mut self, step: &Step, _: OutputDigest) -> bool {
        panic!("a part of a fused step: {step:?}");
    }

    fn wants_keyframe(&self) -> bool {
        true
    }
}
