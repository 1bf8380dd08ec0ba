//! Once a node runs, its messages allocate nothing.

mod common;

use common::{A, B, C, LONG, LONG_TICKS, ask, cell, finish, network, on, one_node, table};
use imrs_protocol::{
    CellTable, Delivery, Incarnation, NodeId, Packet, PortDecl, PortId, Target, Ticks, Usage,
};
use imrs_runtime::link::in_process::Faults;
use imrs_runtime::link::{Link, LinkBusy, PollEnd, Sink};
use imrs_runtime::{Context, MANY, Rendezvous, Runtime, TaskError};
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

struct Counting;

static COUNTED: AtomicU64 = AtomicU64::new(0);
static COUNTING: AtomicBool = AtomicBool::new(false);

fn count() {
    if COUNTING.load(Ordering::Relaxed) {
        COUNTED.fetch_add(1, Ordering::Relaxed);
    }
}

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise is passed on.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: the caller's promise is passed on.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const WARM_UP: u32 = 200;
const COUNTED_ROUNDS: u32 = 2_000;

/// `a` asks `b`, all three meet, `a` tells the others; then `a` looks at the count.
fn round(ctx: &mut Context, number: u32, messages: &mut Vec<Delivery>) -> Result<(), TaskError> {
    let (ask, lift, news) = (imrs_protocol::PortId(0), imrs_protocol::PortId(1), imrs_protocol::PortId(2));
    if ctx.id() == A {
        assert!(ctx.send(ask, &number.to_le_bytes())?.reply().is_some());
        let _copies = ctx.send(news, b"done")?;
    } else if ctx.id() == B {
        let question = ctx.receive(Some(ask), None)?.expect("only a message ends it");
        ctx.reply(&question.from, b"yes")?;
    }
    if ctx.id() != A {
        assert_eq!(ctx.receive_many(Some(news), messages, MANY, None)?, 1);
        messages.clear();
    }
    match ctx.waitfor(lift)? {
        Rendezvous::Released { .. } => Ok(()),
        Rendezvous::GaveUp { .. } => panic!("nobody was missing"),
    }
}

fn program(ctx: &mut Context) -> Result<(), TaskError> {
    let mut messages = Vec::with_capacity(MANY);
    for number in 0..WARM_UP {
        round(ctx, number, &mut messages)?;
    }
    // All have met: none is warming up any more.
    if ctx.id() == A {
        COUNTED.store(0, Ordering::SeqCst);
        COUNTING.store(true, Ordering::SeqCst);
    }
    for number in 0..COUNTED_ROUNDS {
        round(ctx, number, &mut messages)?;
    }
    if ctx.id() == A {
        COUNTING.store(false, Ordering::SeqCst);
    }
    // Nobody leaves while it is counted.
    round(ctx, 0, &mut messages)
}

/// A link that takes several datagrams in one call.
struct Wide<L>(L);

impl<L: Link> Link for Wide<L> {
    fn ready(&self, next: NodeId) -> bool {
        self.0.ready(next)
    }

    fn at_once(&self) -> usize {
        2 * usize::from(BURST)
    }

    fn send_at(&self, next: NodeId, packets: &[Packet], at: Instant) -> Result<usize, LinkBusy> {
        let mut taken = 0;
        while taken < packets.len() {
            match self.0.send_at(next, &packets[taken..], at) {
                Ok(some) => taken += some,
                Err(LinkBusy) if taken > 0 => break,
                Err(LinkBusy) => return Err(LinkBusy),
            }
        }
        Ok(taken)
    }

    fn poll(&self, sink: &dyn Sink, until: Option<Instant>) -> PollEnd {
        self.0.poll(sink, until)
    }

    fn wake(&self) {
        self.0.wake();
    }
}

/// How many messages are said together, in nearly the order of urgency.
const BURST: u16 = 120;

/// `a` says much together and asks whether it came; then it looks at the count.
fn bursts(ctx: &mut Context) -> Result<(), TaskError> {
    let (ask, burst) = (PortId(0), PortId(1));
    for round in 0..200 {
        if round == 50 {
            COUNTED.store(0, Ordering::SeqCst);
            COUNTING.store(true, Ordering::SeqCst);
        }
        ctx.together(|ctx| {
            (0..BURST).try_for_each(|number| {
                // Overtaken by a few.
                let time_out = Some(LONG - Duration::from_millis(u64::from(BURST - (number ^ 7))));
                ctx.send_with(burst, Target::All, b"more", time_out).map(|_copies| ())
            })
        })?;
        assert!(ctx.send(ask, b"all?")?.reply().is_some());
    }
    COUNTING.store(false, Ordering::SeqCst);
    assert!(ctx.send(ask, b"end")?.reply().is_some());
    Ok(())
}

fn takes_bursts(ctx: &mut Context) -> Result<(), TaskError> {
    let (ask, burst) = (PortId(0), PortId(1));
    let mut messages = Vec::with_capacity(MANY);
    loop {
        let question = ctx.receive(Some(ask), None)?.expect("only a message ends it");
        let end = question.contents.as_bytes() == b"end";
        let mut left = if end { 0 } else { usize::from(BURST) };
        while left > 0 {
            left -= ctx.receive_many(Some(burst), &mut messages, MANY, None)?;
            messages.clear();
        }
        ctx.reply(&question.from, b"yes")?;
        if end {
            return Ok(());
        }
    }
}

fn declare(nodes: &[usize], delay: Ticks) -> Arc<CellTable> {
    let mut cell = cell(nodes, delay);
    cell.port(ask(LONG_TICKS));
    cell.port(PortDecl::new("lift", A, Usage::Waitfor, &[B, C], LONG_TICKS).resend(Ticks(50_000), 1));
    cell.port(PortDecl::new("news", A, Usage::Send, &[B, C], LONG_TICKS).bounded_buffer(4));
    table(cell)
}

fn allocations(nodes: Vec<Runtime>) -> u64 {
    assert!(nodes.iter().all(|node| node.wait(LONG)));
    let counted = COUNTED.load(Ordering::SeqCst);
    nodes.into_iter().for_each(finish);
    counted
}

/// One test: the count is the process's.
#[test]
fn messages_allocate_nothing_in_steady_state() {
    let table = declare(&[0, 0, 0], Ticks(0));
    let node = one_node(&table).task("a", program).task("b", program).task("c", program).start().unwrap();
    assert_eq!(allocations(vec![node]), 0, "on one node");

    let table = declare(&[0, 1, 2], Ticks(1_000));
    let network = network(&table, Faults::default());
    let builders = (0..3).zip(["a", "b", "c"]);
    let builders: Vec<_> = builders.map(|(n, task)| on(&network, &table, n).task(task, program)).collect();
    let nodes = builders.into_iter().map(|node| node.start().unwrap()).collect();
    assert_eq!(allocations(nodes), 0, "between nodes");

    let mut cell = cell(&[0, 1], Ticks(1_000));
    cell.port(ask(LONG_TICKS));
    cell.port(PortDecl::new("burst", A, Usage::Send, &[B], LONG_TICKS).bounded_buffer(BURST));
    let table = common::table(cell);
    let network = common::network(&table, Faults::default());
    let builders = [0, 1].map(|node| {
        let link = network.join(NodeId(node), Incarnation(1), false);
        let builder = Runtime::builder(Arc::clone(&table), NodeId(node)).incarnation(Incarnation(1), false);
        builder.link(Arc::new(Wide(link)))
    });
    let [first, second] = builders;
    let nodes =
        vec![first.task("a", bursts).start().unwrap(), second.task("b", takes_bursts).start().unwrap()];
    assert_eq!(allocations(nodes), 0, "several datagrams together");
}
