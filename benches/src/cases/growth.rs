//! How costs grow with the size of a cell, how much memory is allocated, and how often an idle node wakes up.

use super::cells::{self, A, ASK, B, LONG_TICKS};
use super::floors::GROUP;
use super::handoff::{machine_round_trip, machine_waits};
use crate::sample::{Sample, each};
use crate::suite::{Effort, Goal, Row, Stat, Suite};
use crate::{cores, memory};
use imrs_protocol::{
    Cell, CellTable, CommTask, Contents, Event, Incarnation, Node, NodeId, NodeInput, NodeOutbox, NodeTable,
    Observation, Packet, PortDecl, PortId, Reason, Request, Signal, Target, TaskId, Ticks, Usage,
};
use imrs_runtime::Runtime;
use std::cell::OnceCell;
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::Duration;

/// The suite that measures how costs grow with ports, tasks and waiting messages.
#[must_use]
pub fn growth() -> Suite {
    let mut suite = Suite::new("growth");
    for (tasks, name) in [(2, "2 tasks"), (10_000, "10,000 tasks")] {
        let table = Once::new(move || crowd(tasks));
        suite.case(
            format!("machine/ask of {name}"),
            "send, receive, reply between two tasks of a node with so many tasks, a port each",
            move |effort| ask_on(effort, table.get(), ASK),
        );
    }
    suite.row(Row::new(
        "growth",
        "machine/ask of 10,000 tasks",
        "machine/ask of 2 tasks",
        Stat::P50,
        Goal::AtMost(1.1),
    ));
    for (ports, name) in [(2, "2 ports"), (10_000, "10,000 ports")] {
        let table = Once::new(move || questions(ports));
        suite.case(
            format!("machine/ask of {name}"),
            "send, receive, reply on the last of so many ports between the two tasks of a node",
            move |effort| ask_on(effort, table.get(), PortId::from_index(ports - 1)),
        );
    }
    suite.row(Row::new(
        "growth",
        "machine/ask of 10,000 ports",
        "machine/ask of 2 ports",
        Stat::P50,
        Goal::AtMost(1.1),
    ));
    for ports in [4, 1_024, 10_000] {
        let table = Once::new(move || fan(ports, 1));
        suite.case(
            format!("machine/get over {ports} ports"),
            "take the most urgent message of any port and send another, one waiting in every port",
            move |effort| get_over_ports(effort, table.get(), ports),
        );
    }
    let few = "machine/get over 4 ports";
    suite.row(Row::new("growth", "machine/get over 1024 ports", few, Stat::P50, Goal::AtMost(1.5)));
    for waiting in [16, 10_000] {
        let table = Once::new(move || fan(1, waiting));
        suite.case(
            format!("machine/tick over {waiting} messages"),
            "time passes, and nothing is due of so many messages that wait",
            move |effort| tick(effort, table.get(), waiting),
        );
    }
    let few = "machine/tick over 16 messages";
    suite.row(Row::new("growth", "machine/tick over 10000 messages", few, Stat::P50, Goal::AtMost(1.1)));
    expiries(&mut suite);
    suite
}

/// Adds the cases and the row about messages whose time ends.
fn expiries(suite: &mut Suite) {
    for waiting in [16, 10_000] {
        let table = Once::new(move || fan(1, waiting));
        suite.case(
            format!("machine/expiry among {waiting} messages"),
            "the time of one message ends, of so many that wait, and another is sent",
            move |effort| expiry(effort, table.get(), waiting),
        );
    }
    let few = "machine/expiry among 16 messages";
    // The bound is that of the queue itself: the logarithm of 10,000 is 3.3 times that of 16.
    suite.row(Row::new("growth", "machine/expiry among 10000 messages", few, Stat::P50, Goal::AtMost(4.0)));
}

/// The suite that measures memory, and the wake-ups of an idle node.
#[must_use]
pub fn footprint() -> Suite {
    let mut suite = Suite::new("footprint");
    suite.case(
        "memory/queued packet",
        "bytes that a port's buffer takes for each packet it has room for",
        |_| {
            let count = |capacity| bytes_of(&fan(1, capacity));
            per(count(4_001), count(1), 4_000)
        },
    );
    suite.case(
        "memory/idle port",
        "bytes that a port takes at its receiving task, with room for one packet",
        |_| {
            let count = |ports| bytes_of(&fan(ports, 1));
            per(count(4_004), count(4), 4_000)
        },
    );
    suite.case(
        "memory/allocations",
        "of the whole process per round trip of two threads, in steady state",
        |_| allocations(),
    );
    suite.case("runtime/idle", "sleeps per second of all threads of a node with nothing pending", |_| idle());
    for (what, subject, bound) in [
        ("bytes per queued packet", "memory/queued packet", 64.0),
        ("bytes per idle port", "memory/idle port", 256.0),
        ("allocations per message", "memory/allocations", 0.0),
        ("wake-ups per second of an idle node", "runtime/idle", 0.0),
    ] {
        suite.row(Row::bounded("memory", what, subject, Stat::Count, Goal::AtMost(bound)));
    }
    suite
}

/// A table that is made when it is first needed and then kept, because only messages are measured.
struct Once<F>(OnceCell<Arc<CellTable>>, F);

impl<F: Fn() -> Arc<CellTable>> Once<F> {
    fn new(make: F) -> Self {
        Self(OnceCell::new(), make)
    }

    fn get(&self) -> &Arc<CellTable> {
        self.0.get_or_init(&self.1)
    }
}

fn crowd(tasks: usize) -> Arc<CellTable> {
    let mut cell = cells::cell(tasks, 1);
    for owner in (0..tasks).step_by(2) {
        let [owner, user] = [owner, owner + 1].map(TaskId::from_index);
        cell.port(PortDecl::new(&format!("p{}", owner.0), owner, Usage::Send, &[user], LONG_TICKS).command());
    }
    cells::table(cell)
}

/// A cell in which A asks B on `ports` ports.
fn questions(ports: usize) -> Arc<CellTable> {
    let mut cell = cells::cell(2, 1);
    for port in 0..ports {
        cell.port(PortDecl::new(&format!("p{port}"), A, Usage::Send, &[B], LONG_TICKS).command());
    }
    cells::table(cell)
}

fn ask_on(effort: Effort, table: &Arc<CellTable>, port: PortId) -> Sample {
    let table = NodeTable::new(Arc::clone(table), NodeId(0));
    let mut node = Node::new(table, Incarnation(0), false, 4);
    let contents = Contents::new(&cells::FULL).expect("12 bytes fit");
    machine_waits(&mut node, port);
    each(effort.of(50_000), GROUP, || machine_round_trip(&mut node, port, contents))
}

/// A cell in which A sends to B on `ports` ports, each with room for `room` messages.
fn fan(ports: usize, room: u16) -> Arc<CellTable> {
    let mut cell: Cell = cells::cell(2, 1);
    for port in 0..ports {
        let decl = PortDecl::new(&format!("p{port}"), A, Usage::Send, &[B], LONG_TICKS);
        cell.port(decl.bounded_buffer(room));
    }
    cells::table(cell)
}

/// An outbox that keeps the port of the last received message.
struct Taken(Option<PortId>);

impl NodeOutbox for Taken {
    fn ready(&mut self, _: NodeId) -> bool {
        false
    }
    fn link(&mut self, _: NodeId, _: Packet) {}
    fn signal(&mut self, _: TaskId, signal: Signal) {
        if let Signal::Message(message) = signal {
            self.0 = Some(message.from.port);
        }
    }
}

fn send(node: &mut Node, port: PortId, ttl: u64) {
    let contents = Contents::new(&cells::FULL).expect("12 bytes fit");
    let request = Request::Send { port, to: Target::All, contents, time_out: Some(Ticks(ttl)) };
    node.step(node.now(), NodeInput::Request(A, request), &mut Taken(None));
}

fn filled(table: &Arc<CellTable>, ports: usize, each: u16) -> Node {
    let table = NodeTable::new(Arc::clone(table), NodeId(0));
    let mut node = Node::new(table, Incarnation(0), false, 4);
    for message in 0..each {
        for port in 0..ports {
            let ttl = 40_000_000 + (port as u64 * 7_919 + u64::from(message) * 104_729) % 10_000_000;
            send(&mut node, PortId::from_index(port), ttl);
        }
    }
    node
}

fn get_over_ports(effort: Effort, table: &Arc<CellTable>, ports: usize) -> Sample {
    let mut node = filled(table, ports, 1);
    let get = Request::Get { port: None, source: None, time_out: Some(Ticks::ZERO) };
    let mut number = 0_u64;
    each(effort.of(20_000), GROUP, || {
        let mut taken = Taken(None);
        node.step(node.now(), NodeInput::Request(B, get), &mut taken);
        number += 1;
        let ttl = 40_000_000 + number * 7_919 % 10_000_000;
        send(&mut node, taken.0.expect("a message waits in every port"), ttl);
    })
}

fn tick(effort: Effort, table: &Arc<CellTable>, waiting: u16) -> Sample {
    let mut node = filled(table, 1, waiting);
    each(effort.of(200_000), GROUP, || node.step(node.now() + Ticks(1), NodeInput::Time, &mut Taken(None)))
}

/// An outbox that counts the messages whose time ended.
#[derive(Default)]
struct Expired(u32);

impl NodeOutbox for Expired {
    fn link(&mut self, _: NodeId, _: Packet) {}
    fn signal(&mut self, _: TaskId, _: Signal) {}
    fn observe(&mut self, _: Option<TaskId>, observation: Observation) {
        self.0 += u32::from(observation.event == Event::Discarded(Reason::Expired));
    }
}

/// Measures the expiry of one message while `waiting` messages wait. They expire one by one, but not in the order in
/// which they were sent.
fn expiry(effort: Effort, table: &Arc<CellTable>, waiting: u16) -> Sample {
    const STEP: u64 = 1_000;
    let mut node = Node::new(NodeTable::new(Arc::clone(table), NodeId(0)), Incarnation(0), false, 4);
    let all = u64::from(waiting);
    for message in 0..all {
        // 7,919 has no common divisor with 16 or 10,000, so each expiry time is used exactly once.
        send(&mut node, PortId(0), (1 + message * 7_919 % all) * STEP);
    }
    each(effort.of(50_000), GROUP, || {
        let mut expired = Expired::default();
        node.step(node.now() + Ticks(STEP), NodeInput::Time, &mut expired);
        assert_eq!(expired.0, 1, "messages whose time ended");
        send(&mut node, PortId(0), all * STEP);
    })
}

fn bytes_of(table: &Arc<CellTable>) -> Option<i64> {
    let table = NodeTable::new(Arc::clone(table), NodeId(0));
    let (task, allocated) = memory::counted(|| CommTask::new(&table, B, Incarnation(0), false));
    assert!(task.is_idle(), "a fresh task");
    allocated.map(|allocated| allocated.bytes)
}

fn per(many: Option<i64>, few: Option<i64>, more: u32) -> Sample {
    let count = many.zip(few).map(|(many, few)| (many - few) as f64 / f64::from(more));
    Sample { count, ..Sample::default() }
}

fn allocations() -> Sample {
    const TIMES: u32 = 500;
    let (tell, told) = channel();
    let node = Runtime::builder(cells::asking(1, Usage::Send), NodeId(0))
        .task("t0", move |ctx| {
            cells::ask(ctx, &cells::FULL, 1, 1)?;
            let mut series = || {
                memory::counted(|| {
                    (0..TIMES).try_for_each(|_| {
                        let sent = ctx.send(ASK, &cells::FULL)?;
                        assert!(sent.reply().is_some(), "an answer in time");
                        Ok::<(), imrs_runtime::TaskError>(())
                    })
                })
            };
            // Several series are counted, and the least result is kept: during the first series, other threads may
            // not sleep yet.
            let mut least = None;
            for _ in 0..5 {
                let (done, allocated) = series();
                done?;
                let calls = allocated.map(|allocated| allocated.calls);
                least = least.min(calls).or(calls);
            }
            tell.send(least).expect("the harness listens");
            Ok(())
        })
        .task("t1", cells::answer)
        .start()
        .expect("a node that starts");
    let count = cells::hear(node, &told).map(|calls| calls as f64 / f64::from(TIMES));
    Sample { count, ..Sample::default() }
}

fn idle() -> Sample {
    let (tell, told) = channel();
    let node = Runtime::builder(cells::asking(1, Usage::Send), NodeId(0))
        .task("t0", move |ctx| {
            cells::ask(ctx, &cells::FULL, 1, 1)?;
            tell.send(()).expect("the harness listens");
            ctx.receive(None, None).map(|_| ())
        })
        .task("t1", cells::answer)
        .start()
        .expect("a node that starts");
    told.recv().expect("the task gets that far");
    std::thread::sleep(Duration::from_millis(100));
    let before = cores::Sleeps::now();
    std::thread::sleep(Duration::from_millis(500));
    // The sleep of this thread itself is subtracted.
    let slept = before.since().saturating_sub(1);
    cells::stop(node);
    Sample::counted(slept as f64 * 2.0)
}
