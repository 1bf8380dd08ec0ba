//! Tests that the messages of a running node allocate no memory.

use crate::allocator::ByThread;
use crate::alone;
use crate::common::{A, B, C, LONG, LONG_TICKS, ask, cell, finish, network, on, one_node, report, table};
use imrs_protocol::{
    CellTable, Delivery, Incarnation, NodeId, Packet, PortDecl, PortId, Target, Ticks, Usage,
};
use imrs_runtime::link::in_process::{Faults, InProcess};
use imrs_runtime::link::{Link, LinkBusy, PollEnd, Sink};
use imrs_runtime::{AsyncContext, Builder, Context, MANY, Rendezvous, Runtime, TaskError};
use std::sync::mpsc::{Receiver, Sender};
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

/// The threads through which messages pass.
const THREADS: [&str; 5] = ["a", "b", "c", "imrs receive", "imrs timer"];

const WARM_UP: u32 = 200;
const COUNTED_ROUNDS: u32 = 2_000;

/// The threads that allocated, and how often each did.
type Allocated = Vec<(String, u64)>;

/// The channels by which task `a` reports and waits, besides messages.
struct Counter {
    timers: Receiver<()>,
    nodes: usize,
    allocated: Sender<Allocated>,
}

impl Counter {
    /// Waits until every Timer thread has served one expiry, because memory that a thread allocates at its start belongs to
    /// no message. These delays are the only waits that the Timer ends: the other tasks wait without a time_out.
    fn wait_for_timers(&self) {
        (0..self.nodes).for_each(|_| self.timers.recv_timeout(LONG).expect("a delay ends"));
    }

    fn count(&self, work: impl FnOnce() -> Result<(), TaskError>) -> Result<(), TaskError> {
        let counted = ByThread::begin();
        work()?;
        self.allocated.send(counted.end(&THREADS)).expect("the test listens");
        Ok(())
    }
}

/// Adds a task whose delay the Timer thread ends.
fn needs_the_timer(node: Builder, name: &str, tell: &Sender<()>) -> Builder {
    let tell = tell.clone();
    node.async_task(name, |mut ctx: AsyncContext| async move {
        ctx.delay(Duration::from_millis(1)).await?;
        tell.send(()).expect("`a` waits for it");
        Ok(())
    })
}

/// The counter of task `a` for this many nodes, the sender for the reports of the Timers, and the receiver of the count.
fn counter(nodes: usize) -> (Counter, Sender<()>, Receiver<Allocated>) {
    let ((tell, timers), (allocated, counted)) = (report(), report());
    (Counter { timers, nodes, allocated }, tell, counted)
}

/// Waits for the programs of all nodes to end. Returns their allocations.
fn allocations(nodes: Vec<Runtime>, counted: &Receiver<Allocated>) -> Allocated {
    assert!(nodes.iter().all(|node| node.wait(LONG)));
    nodes.into_iter().for_each(finish);
    counted.try_recv().expect("it was counted")
}

/// One round of messages: `a` asks `b`, all three tasks meet, and `a` sends a status to the other two.
fn round(ctx: &mut Context, number: u32, messages: &mut Vec<Delivery>) -> Result<(), TaskError> {
    let (ask, lift, news) = (PortId(0), PortId(1), PortId(2));
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

/// Task `a` counts allocations once all tasks have met, because then every task has warmed up.
fn program(ctx: &mut Context, counter: Option<&Counter>) -> Result<(), TaskError> {
    let mut messages = Vec::with_capacity(MANY);
    counter.into_iter().for_each(Counter::wait_for_timers);
    for number in 0..WARM_UP {
        round(ctx, number, &mut messages)?;
    }
    let mut counted = || (0..COUNTED_ROUNDS).try_for_each(|number| round(ctx, number, &mut messages));
    match counter {
        Some(counter) => counter.count(counted)?,
        None => counted()?,
    }
    // This round keeps every task running while `a` counts allocations.
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

/// How many messages are sent together, nearly in the order of their urgency.
const BURST: u16 = 120;
/// How many messages fit into one datagram. The link hands these messages over together.
const TOGETHER: u16 = 40;
/// The number of the question that ends the answers.
const END: u16 = u16::MAX;

fn tell_together(ctx: &mut Context, count: u16) -> Result<(), TaskError> {
    ctx.together(|ctx| {
        (0..count).try_for_each(|number| {
            // A few later messages overtake each of these messages.
            let time_out = Some(LONG - Duration::from_millis(u64::from(BURST - (number ^ 7))));
            ctx.send_with(PortId(1), Target::All, b"more", time_out).map(|_copies| ())
        })
    })
}

/// Asks the other task whether `count` messages have arrived.
fn ask_for(ctx: &mut Context, count: u16) -> Result<(), TaskError> {
    assert!(ctx.send(PortId(0), &count.to_le_bytes())?.reply().is_some());
    Ok(())
}

/// Takes as many messages as each question says, and then answers the question.
fn takes_bursts(ctx: &mut Context) -> Result<(), TaskError> {
    let (ask, burst) = (PortId(0), PortId(1));
    let mut messages = Vec::with_capacity(MANY);
    loop {
        let question = ctx.receive(Some(ask), None)?.expect("only a message ends it");
        let count = u16::from_le_bytes(question.contents.as_bytes().try_into().expect("a count"));
        let mut left = if count == END { 0 } else { usize::from(count) };
        while left > 0 {
            left -= ctx.receive_many(Some(burst), &mut messages, MANY, None)?;
            messages.clear();
        }
        ctx.reply(&question.from, b"yes")?;
        if count == END {
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

/// Two nodes with one task for messages each, and with another task each that needs the Timer.
fn two_nodes() -> (Arc<CellTable>, [InProcess; 2]) {
    let mut cell = cell(&[0, 1, 0, 1], Ticks(1_000));
    cell.port(ask(LONG_TICKS));
    cell.port(PortDecl::new("burst", A, Usage::Send, &[B], LONG_TICKS).bounded_buffer(BURST));
    let table = table(cell);
    let network = network(&table, Faults::default());
    let links = [0, 1].map(|node| network.join(NodeId(node), Incarnation(1), false));
    (table, links)
}

/// The allocations while task `a` sends to task `b`. `links` has one link for each node.
fn told(
    table: &Arc<CellTable>,
    links: [Arc<dyn Link>; 2],
    program: impl FnOnce(&mut Context, &Counter) -> Result<(), TaskError> + Send + 'static,
) -> Allocated {
    let (counter, tell, counted) = counter(2);
    let [first, second] = links;
    let node = |number, link| {
        Runtime::builder(Arc::clone(table), NodeId(number)).incarnation(Incarnation(1), false).link(link)
    };
    let first = needs_the_timer(node(0, first).task("a", move |ctx| program(ctx, &counter)), "c", &tell);
    let second = needs_the_timer(node(1, second).task("b", takes_bursts), "d", &tell);
    let nodes = [first, second].map(|node| node.start().expect("a node that starts"));
    allocations(nodes.into(), &counted)
}

#[test]
fn messages_allocate_nothing_in_steady_state() {
    let _alone = alone();
    let table = declare(&[0, 0, 0, 0], Ticks(0));
    let (counter, tell, counted) = self::counter(1);
    let node = one_node(&table).task("a", move |ctx| program(ctx, Some(&counter)));
    let node = node.task("b", |ctx| program(ctx, None)).task("c", |ctx| program(ctx, None));
    let node = needs_the_timer(node, "d", &tell).start().unwrap();
    assert_eq!(allocations(vec![node], &counted), [], "on one node");

    let table = declare(&[0, 1, 2, 0, 1, 2], Ticks(1_000));
    let network = network(&table, Faults::default());
    let (counter, tell, counted) = self::counter(3);
    let first = on(&network, &table, 0).task("a", move |ctx| program(ctx, Some(&counter)));
    let others =
        [(1, "b"), (2, "c")].map(|(n, task)| on(&network, &table, n).task(task, |ctx| program(ctx, None)));
    let nodes = std::iter::once(first).chain(others).zip(["d", "e", "f"]);
    let nodes: Vec<_> = nodes.map(|(node, task)| needs_the_timer(node, task, &tell)).collect();
    let nodes = nodes.into_iter().map(|node| node.start().unwrap()).collect();
    assert_eq!(allocations(nodes, &counted), [], "between nodes");

    let (table, links) = two_nodes();
    let links = links.map(|link| Arc::new(Wide(link)) as Arc<dyn Link>);
    let allocated = told(&table, links, |ctx, counter| {
        counter.wait_for_timers();
        let mut rounds = |count: u32| {
            (0..count).try_for_each(|_| {
                tell_together(ctx, BURST)?;
                ask_for(ctx, BURST)
            })
        };
        rounds(50)?;
        counter.count(|| rounds(150))?;
        ask_for(ctx, END)
    });
    assert_eq!(allocated, [], "several datagrams together");
}

/// A link that can be closed. While it is closed, its node receives nothing.
struct Gate<L> {
    link: L,
    state: Mutex<Door>,
    changed: Condvar,
}

#[derive(Default)]
struct Door {
    closed: bool,
    /// Whether the node waits for the link to open.
    waits: bool,
}

impl<L: Link> Gate<L> {
    fn new(link: L) -> Self {
        Self { link, state: Mutex::default(), changed: Condvar::new() }
    }

    /// Closes the link: from now on its node receives nothing.
    fn close(&self) {
        self.state.lock().unwrap().closed = true;
        self.link.wake();
        drop(self.changed.wait_while(self.state.lock().unwrap(), |door| !door.waits).unwrap());
    }

    fn open(&self) {
        self.state.lock().unwrap().closed = false;
        self.changed.notify_all();
    }
}

impl<L: Link> Link for Gate<L> {
    fn ready(&self, next: NodeId) -> bool {
        self.link.ready(next)
    }

    fn send_at(&self, next: NodeId, packets: &[Packet], at: Instant) -> Result<usize, LinkBusy> {
        self.link.send_at(next, packets, at)
    }

    fn poll(&self, sink: &dyn Sink, until: Option<Instant>) -> PollEnd {
        let mut door = self.state.lock().unwrap();
        while door.closed {
            door.waits = true;
            self.changed.notify_all();
            door = self.changed.wait(door).unwrap();
        }
        door.waits = false;
        drop(door);
        self.link.poll(sink, until)
    }

    fn wake(&self) {
        self.link.wake();
    }
}

/// A thread that has never received two packets for a task in one datagram receives forty. This can happen after a
/// node was stopped, or if a neighbour sends more at once than ever before.
#[test]
fn packets_that_come_together_for_the_first_time_allocate_nothing() {
    let _alone = alone();
    let (table, [first, second]) = two_nodes();
    let gate = Arc::new(Gate::new(second));
    let here = Arc::clone(&gate);
    let allocated = told(&table, [Arc::new(first), gate], move |ctx, counter| {
        counter.wait_for_timers();
        (0..WARM_UP).try_for_each(|_| {
            tell_together(ctx, 1)?;
            ask_for(ctx, 1)
        })?;
        here.close();
        counter.count(|| {
            tell_together(ctx, TOGETHER)?;
            here.open();
            ask_for(ctx, TOGETHER)
        })?;
        ask_for(ctx, END)
    });
    assert_eq!(allocated, []);
}
