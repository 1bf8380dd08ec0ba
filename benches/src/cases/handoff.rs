//! Measures send, receive and reply within a node, with a deadline for every message (goals P1 to P5).

use super::cells::{self, A, ASK, B, LONG_TICKS};
use super::floors::{self, GROUP};
use super::recording::{Onlooker, Watched};
use crate::cores::{self, Core};
use crate::sample::{Sample, each, passed};
use crate::suite::{Effort, Goal, Row, Stat, Suite};
use imrs_protocol::{
    Contents, Incarnation, Node, NodeId, NodeInput, NodeOutbox, NodeTable, Packet, PortDecl, PortId, Request,
    Signal, Target, TaskId, Ticks, Usage,
};
use imrs_runtime::{Runtime, SPIN};
use std::sync::mpsc::channel;
use std::time::Duration;

const ONE: [Core; 2] = [Core::First; 2];
const TWO: [Core; 2] = [Core::First, Core::Second];

/// The suite of hand-overs without sleeping: both tasks in one thread (P1, P5), or one task on a thread of its own (P4).
#[must_use]
pub fn awake() -> Suite {
    let mut suite = Suite::new("awake");
    suite.case(
        "floor/coroutines",
        "two boxed futures and a queue of who runs next, one thread, hot",
        floors::coroutines,
    );
    suite.case(
        "machine/ask",
        "send, receive, reply through the state machine of a node alone: no lock, no clock, no thread",
        |effort| machine(effort, Usage::Send),
    );
    suite.case("machine/query", "the same on a query port", |effort| machine(effort, Usage::Query));
    suite.case(
        "machine/stream",
        "a message of class 1 through the state machine of a node alone: 32 wait in a port, then their receiver takes them",
        stream_through_machine,
    );
    suite.case(
        "runtime/scripts ask",
        "two scripts of a running node, run by the thread that began them; a value is the mean of a node's round trips",
        |effort| scripts(effort, Usage::Send, Watched::Not, passed),
    );
    suite.case("runtime/scripts query", "the same on a query port", |effort| {
        scripts(effort, Usage::Query, Watched::Not, passed)
    });
    suite.case(
        "runtime/futures ask",
        "two Rust tasks of a running node, each a future, on the one thread of the node's futures",
        futures,
    );
    suite.case(
        "runtime/thread asks script",
        "a Rust task's thread asks a script of its node, and runs it: nobody sleeps",
        thread_asks_script,
    );
    suite.case("floor/clock_gettime", "one reading of CLOCK_BOOTTIME", |effort| {
        each(effort.of(400_000), GROUP, || {
            std::hint::black_box(rustix::time::clock_gettime(rustix::time::ClockId::Boottime));
        })
    });
    suite.case("runtime/clock", "one reading of a node's clock", |effort| {
        each(effort.of(400_000), GROUP, || {
            std::hint::black_box(imrs_runtime::read_clock());
        })
    });
    let coroutines = "floor/coroutines";
    suite.row(Row::new("P1", "runtime/scripts ask", coroutines, Stat::Mean, Goal::AtMost(11.0)).was("<= 7"));
    suite.row(Row::new("P1", "runtime/futures ask", coroutines, Stat::Mean, Goal::AtMost(14.0)).was("<= 7"));
    suite.row(Row::new("P1", "machine/ask", coroutines, Stat::Mean, Goal::AtMost(4.0)).was("<= 7"));
    for (query, ask) in [("runtime/scripts query", "runtime/scripts ask"), ("machine/query", "machine/ask")] {
        suite.row(Row::new("P5", query, ask, Stat::P50, Goal::AtMost(1.05)).was("<= 0.8"));
    }
    suite
}

/// The suite of hand-overs between two threads that spin (P2) or sleep (P3).
#[must_use]
pub fn threads() -> Suite {
    let mut suite = Suite::new("threads");
    floors::line(&mut suite);
    suite.case(
        "floor/spin then futex",
        "the same; who waits too long sleeps, and is woken only if it does",
        floors::spin_then_futex,
    );
    for (name, places) in [("one core", ONE), ("two cores", TWO)] {
        suite.case(
            format!("floor/park {name}"),
            "two threads asleep in turn, std::thread::park",
            move |effort| floors::relay(effort, 1_500, 2, places, false),
        );
        suite.case(
            format!("floor/park_timeout {name}"),
            "two threads asleep in turn, each sleep with a time_out",
            move |effort| floors::relay(effort, 1_500, 2, places, true),
        );
        suite.case(
            format!("floor/relay of 4 {name}"),
            "what a thread per communication task would cost: four threads wake each other in a row and back",
            move |effort| floors::relay(effort, 500, 4, places, true),
        );
        suite.case(
            format!("runtime/threads {name}"),
            "two Rust tasks of a node, each on a thread that sleeps before every message (spin budget 0); counts sleeps per round trip",
            move |effort| asking(effort, 1_500, 1, places, Duration::ZERO),
        );
        suite.case(
            format!("runtime/threads as they are {name}"),
            "the same with the spin budget that a node has unless told otherwise; 32 round trips share a look at the clock",
            move |effort| asking(effort, 100_000, GROUP, places, SPIN),
        );
    }
    suite.case(
        "runtime/threads as they are, each trip",
        "the same on two cores, each round trip timed by itself: for the tail",
        |effort| asking(effort, 20_000, 1, TWO, SPIN),
    );
    let hot = "runtime/threads as they are two cores";
    let bound = if imrs_runtime::is_by_counter() { 2.5 } else { 4.5 };
    suite.row(Row::new("P2", hot, floors::LINE, Stat::P50, Goal::AtMost(bound)).was("<= 2.2"));
    let each = "runtime/threads as they are, each trip";
    suite.row(Row::within("P2", each, Stat::P999, Stat::P50, Goal::AtMost(3.0)).when_quiet());
    let (one, two) = ("runtime/threads one core", "runtime/threads two cores");
    suite.row(Row::new("P3", one, "floor/park_timeout one core", Stat::P50, Goal::AtMost(1.15)));
    suite.row(Row::new("P3", "runtime/threads as they are one core", one, Stat::P50, Goal::AtMost(1.05)));
    suite.row(Row::new("P3", two, "floor/park_timeout two cores", Stat::P50, Goal::AtMost(1.10)));
    for (subject, floor) in [(one, "floor/relay of 4 one core"), (two, "floor/relay of 4 two cores")] {
        suite.row(Row::new("P3", subject, floor, Stat::P50, Goal::AtMost(0.4)));
        let what = format!("{subject}: sleeps per round trip, each ended by a futex wake");
        suite.row(Row::bounded("P3", &what, subject, Stat::Count, Goal::AtMost(2.02)));
    }
    suite
}

/// Measures two Rust tasks on threads of their own, which spin this long before they sleep.
fn asking(effort: Effort, full: u32, group: u32, places: [Core; 2], spin: Duration) -> Sample {
    let (tell, told) = channel();
    let times = effort.of(full);
    cores::pin(places[0]);
    let node = Runtime::builder(cells::asking(1, Usage::Send), NodeId(0))
        .spin(spin)
        .task("t0", move |ctx| {
            cores::pin(places[0]);
            tell.send(cells::ask(ctx, &cells::FULL, times, group)?).expect("the harness listens");
            Ok(())
        })
        .task("t1", move |ctx| {
            cores::pin(places[1]);
            cells::answer(ctx)
        })
        .start()
        .expect("a node that starts");
    let sample = cells::hear(node, &told);
    cores::unpin();
    sample
}

/// Measures two scripts of one node by a clock. The thread that starts the scripts runs both to their end.
pub fn scripts(effort: Effort, usage: Usage, how: Watched, clock: fn() -> u64) -> Sample {
    // A script takes at most 10,000 steps for one input.
    const MOST: u32 = 1_000;
    let all = effort.of(24 * MOST);
    let times = all.min(MOST);
    let table = cells::asking(1, usage);
    let mut nanos = Vec::new();
    for _ in 0..all / times {
        let mut onlooker = Onlooker::of(how, &table, NodeId(0));
        let node = Runtime::builder(table.clone(), NodeId(0))
            .script("t0", cells::asker(times))
            .script("t1", cells::answerer())
            .hold_scripts();
        let node = onlooker.told_by(node).start().expect("a node that starts");
        onlooker.look(how, &node);
        let begins = clock();
        node.begin();
        nanos.push(clock().saturating_sub(begins));
        cells::stop(node);
        onlooker.leave();
    }
    Sample::of(nanos, times)
}

/// Measures two futures of one node.
fn futures(effort: Effort) -> Sample {
    let (tell, told) = channel();
    let times = effort.of(24_000);
    let node = Runtime::builder(cells::asking(1, Usage::Send), NodeId(0))
        .async_task("t0", move |mut ctx| async move {
            tell.send(cells::ask_as_future(&mut ctx, times, GROUP).await?).expect("the harness listens");
            Ok(())
        })
        .async_task("t1", cells::answer_as_future)
        .start()
        .expect("a node that starts");
    cells::hear(node, &told)
}

fn thread_asks_script(effort: Effort) -> Sample {
    let (tell, told) = channel();
    let times = effort.of(100_000);
    let node = Runtime::builder(cells::asking(1, Usage::Send), NodeId(0))
        .task("t0", move |ctx| {
            tell.send(cells::ask(ctx, &cells::NUMBER, times, GROUP)?).expect("the harness listens");
            Ok(())
        })
        .script("t1", cells::answerer())
        .start()
        .expect("a node that starts");
    cells::hear(node, &told)
}

/// An outbox that keeps the last signal to each of the two tasks.
#[derive(Default)]
struct Told([Option<Signal>; 2]);

impl NodeOutbox for Told {
    fn ready(&mut self, _: NodeId) -> bool {
        false
    }
    fn link(&mut self, _: NodeId, _: Packet) {}
    fn signal(&mut self, task: TaskId, signal: Signal) {
        if let Some(slot) = self.0.get_mut(task.index()) {
            *slot = Some(signal);
        }
    }
}

/// B waits for a message on this port.
pub fn machine_waits(node: &mut Node, port: PortId) {
    let get = Request::Get { port: Some(port), source: None, time_out: None };
    node.step(node.now(), NodeInput::Request(B, get), &mut Told::default());
}

/// A round trip on this port through the state machine of a node whose first two tasks are A and B. B [waits](machine_waits) before and after.
pub fn machine_round_trip(node: &mut Node, port: PortId, contents: Contents) {
    let mut told = Told::default();
    let send = Request::Send { port, to: Target::All, contents, time_out: None };
    node.step(node.now(), NodeInput::Request(A, send), &mut told);
    let Some(Signal::Message(message)) = told.0[1] else { panic!("B was told {:?}", told.0[1]) };
    let reply = Request::Reply { to: message.from, contents: message.contents };
    let get = Request::Get { port: Some(port), source: None, time_out: None };
    assert!(node.reply_and_get(B, [&reply, &get], &mut told), "a fused step");
    assert!(matches!(told.0[0], Some(Signal::Outcome(_))), "A was told {:?}", told.0[0]);
}

fn machine(effort: Effort, usage: Usage) -> Sample {
    let table = NodeTable::new(cells::asking(1, usage), NodeId(0));
    let mut node = Node::new(table, Incarnation(0), false, 4);
    let contents = Contents::new(&cells::FULL).expect("12 bytes fit");
    machine_waits(&mut node, ASK);
    each(effort.of(200_000), GROUP, || machine_round_trip(&mut node, ASK, contents))
}

fn stream_through_machine(effort: Effort) -> Sample {
    let mut cell = cells::cell(2, 1);
    let capacity = u16::try_from(GROUP).expect("few");
    let port = cell.port(PortDecl::new("work", A, Usage::Send, &[B], LONG_TICKS).bounded_buffer(capacity));
    let table = NodeTable::new(cells::table(cell), NodeId(0));
    let mut node = Node::new(table, Incarnation(0), false, 4);
    let contents = Contents::new(&cells::FULL).expect("12 bytes fit");
    let send = Request::Send { port, to: Target::All, contents, time_out: None };
    let poll = Request::Get { port: None, source: None, time_out: Some(Ticks::ZERO) };
    let mut waiting = 0;
    each(effort.of(200_000), GROUP, || {
        let mut told = Told::default();
        node.step(node.now(), NodeInput::Request(A, send), &mut told);
        waiting += 1;
        if waiting == GROUP {
            for _ in 0..waiting {
                node.step(node.now(), NodeInput::Request(B, poll), &mut told);
                assert!(matches!(told.0[1], Some(Signal::Message(_))), "B was told {:?}", told.0[1]);
            }
            waiting = 0;
        }
    })
}
