//! Measures rendezvous of tasks on threads (goal P9), and of scripts (goal P10).

use super::cells::{self, LONG_TICKS};
use super::floors::GROUP;
use crate::sample::{Sample, each, laps, nanos_of};
use crate::suite::{Effort, Goal, Row, Stat, Suite};
use imrs_protocol::{
    CellTable, Incarnation, Node, NodeId, NodeInput, NodeOutbox, NodeTable, Packet, PortDecl, PortId,
    Request, Signal, TaskId, Usage,
};
use imrs_runtime::Runtime;
use rustix::thread::futex;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::channel;
use std::sync::{Arc, Barrier};
use std::time::Instant;

const LIFT: PortId = PortId(0);
const WARM_UP: u32 = 5;

/// The suite that compares a `waitfor` of n tasks with barriers.
#[must_use]
pub fn meetings() -> Suite {
    let mut suite = Suite::new("meetings");
    suite.case(
        "machine/meet of 3",
        "three members reach it one after the other through the state machine of a node alone",
        |effort| machine(effort, 3),
    );
    for n in [2, 4, 8, 16_usize] {
        let name = |of: &str| format!("{of} of {n}");
        suite.case(
            name("runtime/waitfor"),
            "tasks of a node on threads meet again and again, deadline armed; a round as its first task sees it",
            move |effort| waitfor(effort, n),
        );
        suite.case(
            name("floor/std Barrier"),
            "the same with std::sync::Barrier: no deadline",
            move |effort| {
                let barrier = Barrier::new(n);
                threads(effort, n, || {
                    barrier.wait();
                })
            },
        );
        suite.case(
            name("floor/futex barrier"),
            "one word that all sleep on, one call that wakes them all: no deadline",
            move |effort| {
                let barrier = FutexBarrier { all: n as u32, ..FutexBarrier::default() };
                threads(effort, n, || barrier.wait())
            },
        );
        suite.case(
            name("runtime/scripts meet"),
            "scripts of a node meet again and again, run by the thread that began them; a value is a node's mean",
            move |effort| scripts_meet(effort, n),
        );
        suite.case(
            name("machine/meet"),
            "the members reach it one after the other through the state machine of a node alone: no lock, no clock, no thread",
            move |effort| machine(effort, n),
        );
        let own = name("runtime/waitfor");
        let times = if n == 16 { 2.0 } else { 1.0 };
        suite.row(Row::new("P9", own.clone(), &name("floor/std Barrier"), Stat::P50, Goal::AtLeast(times)));
        suite.row(Row::new("P9", own, &name("floor/futex barrier"), Stat::P50, Goal::AtMost(2.0)));
    }
    // Each of n members receives the arrivals of the n - 1 others.
    let (many, few) = ("runtime/scripts meet of 16", "runtime/scripts meet of 4");
    let flat = Row::new("P10", many, few, Stat::P50, Goal::AtMost(1.1));
    suite.row(flat.for_each("arrival", [16 * 15, 4 * 3]));
    suite
}

#[derive(Default)]
struct FutexBarrier {
    all: u32,
    here: AtomicU32,
    round: AtomicU32,
}

impl FutexBarrier {
    fn wait(&self) {
        let round = self.round.load(Ordering::Acquire);
        if self.here.fetch_add(1, Ordering::AcqRel) + 1 == self.all {
            self.here.store(0, Ordering::Relaxed);
            self.round.store(round.wrapping_add(1), Ordering::Release);
            let _ = futex::wake(&self.round, futex::Flags::PRIVATE, u32::MAX >> 1);
            return;
        }
        while self.round.load(Ordering::Acquire) == round {
            let _ = futex::wait(&self.round, futex::Flags::PRIVATE, round, None);
        }
    }
}

fn threads(effort: Effort, n: usize, wait: impl Fn() + Sync) -> Sample {
    let times = effort.of(300);
    let nanos = std::thread::scope(|s| {
        for _ in 1..n {
            s.spawn(|| (0..times + WARM_UP).for_each(|_| wait()));
        }
        laps(WARM_UP, 1, &mut || wait());
        laps(times, 1, &mut || wait())
    });
    Sample::of(nanos, 1)
}

fn table(n: usize) -> Arc<CellTable> {
    let mut cell = cells::cell(n, 1);
    let others: Vec<TaskId> = (1..n).map(TaskId::from_index).collect();
    cell.port(PortDecl::new("lift", TaskId(0), Usage::Waitfor, &others, LONG_TICKS));
    cells::table(cell)
}

fn waitfor(effort: Effort, n: usize) -> Sample {
    let times = effort.of(300);
    let (tell, told) = channel();
    let mut builder = Runtime::builder(table(n), NodeId(0));
    for task in 0..n {
        let tell = (task == 0).then(|| tell.clone());
        builder = builder.task(&format!("t{task}"), move |ctx| {
            let mut failed = None;
            let mut round = || failed = failed.take().or(cells::meet(ctx, LIFT).err());
            laps(WARM_UP, 1, &mut round);
            let nanos = laps(times, 1, &mut round);
            if let Some(tell) = tell {
                tell.send(Sample::of(nanos, 1)).expect("the harness listens");
            }
            failed.map_or(Ok(()), Err)
        });
    }
    cells::hear(builder.start().expect("a node that starts"), &told)
}

fn scripts_meet(effort: Effort, n: usize) -> Sample {
    let all = effort.of(4_000);
    // Scripts take at most 10,000 steps for one input.
    let times = all.min(8_000 / n as u32);
    let table = table(n);
    let mut nanos = Vec::new();
    for _ in 0..all / times {
        let mut builder = Runtime::builder(Arc::clone(&table), NodeId(0)).hold_scripts();
        for task in 0..n {
            builder = builder.script(&format!("t{task}"), cells::meeter(LIFT, times));
        }
        let node = builder.start().expect("a node that starts");
        let begins = Instant::now();
        node.begin();
        nanos.push(nanos_of(begins.elapsed()));
        cells::stop(node);
    }
    Sample::of(nanos, times)
}

/// An outbox that counts how many members were released.
#[derive(Default)]
struct Released(usize);

impl NodeOutbox for Released {
    fn link(&mut self, _: NodeId, _: Packet) {}
    fn signal(&mut self, _: TaskId, signal: Signal) {
        self.0 += usize::from(matches!(signal, Signal::Released { .. }));
    }
}

fn machine(effort: Effort, n: usize) -> Sample {
    let mut node = Node::new(NodeTable::new(table(n), NodeId(0)), Incarnation(0), false, 4);
    let reach = Request::Arrive { port: LIFT, arguments: [0; 8], time_out: None };
    each(effort.of(20_000), GROUP, || {
        let mut released = Released::default();
        for task in (0..n).map(TaskId::from_index) {
            node.step(node.now(), NodeInput::Request(task, reach), &mut released);
        }
        assert_eq!(released.0, n, "not all were released");
    })
}
