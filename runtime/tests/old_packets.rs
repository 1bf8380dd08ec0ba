//! The time for which a node is stopped counts as waiting time: commands and statuses that expired meanwhile reach no
//! task (D20, D50).

use crate::common::{A, B, C, LONG, LONG_TICKS, ask, cell, finish, network, report, table};
use imrs_protocol::{
    CellTable, Incarnation, NodeId, NodeTable, Outcome, Packet, PortDecl, PortId, Reason, Seal, Ticks, Usage,
};
use imrs_runtime::link::faulty::FaultyLink;
use imrs_runtime::link::in_process::Faults;
use imrs_runtime::link::udp::{UdpLink, UdpOptions};
use imrs_runtime::link::{Came, Leading, Link, LinkBusy, LinkDiscard, PollEnd, Sink};
use imrs_runtime::{Context, Runtime, Sent, TaskError};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::thread;
use std::time::{Duration, Instant};

/// How long the node stays stopped.
const STOP: Duration = Duration::from_millis(300);
const STOP_US: u64 = 300_000;
/// The time_out of messages that must expire during the stop.
const SHORT: Ticks = Ticks(200_000);
/// How many messages of each kind are sent.
const COPIES: u8 = 5;

/// The point of its work at which the node is stopped.
#[derive(Clone, Copy, PartialEq)]
enum Where {
    /// The node is stopped before it checks the link, as long as the gate is closed.
    BeforeThePoll,
    /// The node is stopped for [`STOP`] after the link has computed the charge of the hop.
    BeforeTheSink,
}

/// A link that stops its node at the chosen point.
struct Stopping<L> {
    inner: L,
    stop: Where,
    open: Mutex<bool>,
    opened: Condvar,
    charges: Mutex<Vec<Ticks>>,
}

impl<L> Stopping<L> {
    fn new(inner: L, stop: Where) -> Self {
        let open = Mutex::new(stop != Where::BeforeThePoll);
        Self { inner, stop, open, opened: Condvar::new(), charges: Mutex::default() }
    }

    fn pass(&self) {
        drop(self.opened.wait_while(self.open.lock().unwrap(), |open| !*open).unwrap());
    }

    fn watching<'a>(&'a self, sink: &'a dyn Sink) -> Watching<'a> {
        let stop = if self.stop == Where::BeforeTheSink { STOP } else { Duration::ZERO };
        Watching { sink, stop, charges: &self.charges }
    }

    fn open(&self) {
        *self.open.lock().unwrap() = true;
        self.opened.notify_all();
    }
}

impl<L: Link> Link for Stopping<L> {
    fn ready(&self, next: NodeId) -> bool {
        self.inner.ready(next)
    }

    fn send_at(&self, next: NodeId, packets: &[Packet], at: Instant) -> Result<usize, LinkBusy> {
        self.inner.send_at(next, packets, at)
    }

    fn poll(&self, sink: &dyn Sink, until: Option<Instant>) -> PollEnd {
        self.pass();
        self.inner.poll(&self.watching(sink), until)
    }

    fn wake(&self) {
        self.open();
        self.inner.wake();
    }

    fn leading(&self) -> Option<&dyn Leading> {
        self.inner.leading().map(|_| self as &dyn Leading)
    }
}

/// If a task's thread waits in the link, the stop happens in that thread, not in the receiving thread.
impl<L: Link> Leading for Stopping<L> {
    fn wait(&self, left: Option<Duration>) -> Came {
        self.pass();
        self.inner.leading().unwrap().wait(left)
    }

    fn take_in(&self, sink: &dyn Sink) -> bool {
        self.inner.leading().unwrap().take_in(&self.watching(sink))
    }

    fn call(&self) {
        self.inner.leading().unwrap().call();
    }
}

/// A sink that records the charges, and stops the node before it passes packets on.
struct Watching<'a> {
    sink: &'a dyn Sink,
    stop: Duration,
    charges: &'a Mutex<Vec<Ticks>>,
}

impl Sink for Watching<'_> {
    fn packets(&self, from: NodeId, packets: &[Packet], charge: Ticks, at: Instant) {
        self.charges.lock().unwrap().extend(packets.iter().map(|_| charge));
        thread::sleep(self.stop);
        self.sink.packets(from, packets, charge, at);
    }

    fn peer(&self, node: NodeId, incarnation: Incarnation, restarted: bool) {
        self.sink.peer(node, incarnation, restarted);
    }

    fn discarded(&self, reason: LinkDiscard) {
        self.sink.discarded(reason);
    }
}

fn two_nodes() -> Arc<CellTable> {
    let mut cell = cell(&[0, 1], Ticks(1_000));
    cell.port(PortDecl::new("short", A, Usage::Send, &[B], SHORT).bounded_buffer(16));
    cell.port(PortDecl::new("long", A, Usage::Send, &[B], LONG_TICKS).bounded_buffer(16));
    cell.port(ask(SHORT));
    table(cell)
}

/// Sends messages that expire during the stop, and messages that do not.
fn sender(ctx: &mut Context) -> Result<(), TaskError> {
    let (short, long, ask) = (ctx.port("short")?, ctx.port("long")?, ctx.port("ask")?);
    for number in 0..COPIES {
        assert_eq!(ctx.send(short, &[number])?, Sent::Copies(1));
        assert_eq!(ctx.send(long, &[number])?, Sent::Copies(1));
    }
    assert_eq!(ctx.send(ask, b"now")?, Sent::Outcome(Outcome::TimedOutUnknown));
    Ok(())
}

/// Checks that the receiver's task gets no expired message, and that all of them are counted.
fn only_what_lives_arrives<L: Link + 'static>(table: &Arc<CellTable>, links: [L; 2], stop: Where) {
    let [first, second] = links;
    let second = Arc::new(Stopping::new(second, stop));
    let (tell, told) = report();
    let builder = |node| Runtime::builder(Arc::clone(table), NodeId(node)).incarnation(Incarnation(1), false);
    let receiver = builder(1).link(Arc::clone(&second) as Arc<dyn Link>).task("b", move |ctx| {
        let long = ctx.port("long")?;
        let mut numbers = Vec::new();
        for _ in 0..COPIES {
            let news = ctx.receive(None, None)?.expect("only a message ends it");
            assert_eq!(news.from.port, long, "a message from the past: {news:?}");
            numbers.extend_from_slice(news.contents.as_bytes());
            tell.send(news.budget).expect("the test listens");
        }
        // The order may differ, because a packet that a stopped thread was handling counts as older than others.
        numbers.sort_unstable();
        assert!(numbers.iter().copied().eq(0..COPIES), "{numbers:?}");
        // No further message arrives.
        assert_eq!(ctx.receive(None, Some(Duration::from_millis(50)))?, None);
        Ok(())
    });
    let sender = builder(0).link(Arc::new(first)).task("a", sender);
    let (receiver, sender) = (receiver.start().unwrap(), sender.start().unwrap());
    assert!(sender.wait(LONG));
    thread::sleep(STOP);
    second.open();
    let expired = Reason::ExpiredOnTheWay.name();
    let count = || {
        let counts = receiver.node().snapshot(0).discards;
        counts.iter().find(|count| count.name == expired).map_or(0, |count| count.count)
    };
    let begun = Instant::now();
    while count() < u64::from(COPIES) + 1 {
        assert!(begun.elapsed() < LONG, "{} expired on the way", count());
        thread::sleep(Duration::from_millis(1));
    }
    assert!(receiver.wait(LONG));
    let charges = second.charges.lock().unwrap().clone();
    finish(receiver);
    finish(sender);
    assert_eq!(charges.len(), 2 * usize::from(COPIES) + 1);
    if stop == Where::BeforeThePoll {
        assert!(charges.iter().all(|charge| charge.0 >= STOP_US), "{charges:?}");
    }
    let left: Vec<Ticks> = told.iter().collect();
    assert!(left.iter().all(|left| left.0 <= LONG_TICKS.0 - STOP_US), "younger than the stop: {left:?}");
}

fn in_process(table: &Arc<CellTable>) -> [imrs_runtime::link::in_process::InProcess; 2] {
    let network = network(table, Faults::default());
    [0, 1].map(|node| network.join(NodeId(node), Incarnation(1), false))
}

/// Tests both kinds of link at once, because the test spends most of its time waiting.
fn over_both_links(stop: Where) {
    let table = two_nodes();
    thread::scope(|s| {
        s.spawn(|| only_what_lives_arrives(&table, in_process(&table), stop));
        only_what_lives_arrives(&table, udp(&table), stop);
    });
}

fn udp(table: &Arc<CellTable>) -> [UdpLink; 2] {
    let links = [0, 1].map(|node| {
        let here = NodeTable::new(Arc::clone(table), NodeId(node));
        let address = "127.0.0.1:0".parse().expect("an address");
        UdpLink::bind(here, address, UdpOptions::new(Incarnation(1), false)).expect("a free port")
    });
    links[0].set_address(NodeId(1), Some(links[1].local_address())).expect("a neighbour");
    links[1].set_address(NodeId(0), Some(links[0].local_address())).expect("a neighbour");
    links
}

#[test]
fn a_node_stopped_before_it_polls() {
    over_both_links(Where::BeforeThePoll);
}

#[test]
fn a_node_stopped_between_the_link_and_its_tasks() {
    over_both_links(Where::BeforeTheSink);
}

/// A link whose node is stopped while its packets leave: the node's clock is read before the stop, and the link's clock
/// after it.
struct LateSender<L>(L);

impl<L: Link> Link for LateSender<L> {
    fn ready(&self, next: NodeId) -> bool {
        self.0.ready(next)
    }

    fn send_at(&self, next: NodeId, packets: &[Packet], at: Instant) -> Result<usize, LinkBusy> {
        thread::sleep(STOP);
        self.0.send_at(next, packets, at)
    }

    fn poll(&self, sink: &dyn Sink, until: Option<Instant>) -> PollEnd {
        self.0.poll(sink, until)
    }

    fn wake(&self) {
        self.0.wake();
    }
}

/// The charge of a packet from a node that is stopped while it sends. The receiver knows that node's clock by then.
fn charge_of_a_late_packet(links: [impl Link + 'static; 2]) -> Ticks {
    let [first, second] = links;
    let first: Arc<dyn Link> = Arc::new(FaultyLink::new(LateSender(FaultyLink::new(first, 0)), 0));
    let charges = Mutex::default();
    let sink = Watching { sink: &Nobody, stop: Duration::ZERO, charges: &charges };
    let packet = Packet {
        kind: imrs_protocol::Kind::Send,
        class: imrs_protocol::Class::Status,
        more: false,
        resent: false,
        hops: imrs_protocol::MAX_HOPS,
        fragment: 0,
        destination: B,
        source: A,
        port: imrs_protocol::PortId(0),
        id: imrs_protocol::MessageId { incarnation: Incarnation(1), sequence: imrs_protocol::Seq24::new(1) },
        remaining: SHORT,
        contents: imrs_protocol::Contents::EMPTY,
        seal: Seal::NONE,
    };
    // The nodes send one packet in each direction, so that the second node knows the clock of the first.
    assert_eq!(second.send(NodeId(0), &[packet]), Ok(1));
    let end = Some(Instant::now() + LONG);
    let received = |link: &dyn Link, count| {
        while charges.lock().unwrap().len() < count {
            assert_ne!(link.poll(&sink, end), PollEnd::TimedOut);
        }
    };
    received(first.as_ref(), 1);
    assert_eq!(first.send_at(NodeId(1), &[packet], Instant::now()), Ok(1));
    received(&second, 2);
    charges.into_inner().unwrap()[1]
}

struct Nobody;

impl Sink for Nobody {
    fn packets(&self, _from: NodeId, _packets: &[Packet], _charge: Ticks, _at: Instant) {}
    fn peer(&self, _node: NodeId, _incarnation: Incarnation, _restarted: bool) {}
    fn discarded(&self, reason: LinkDiscard) {
        panic!("{reason}");
    }
}

#[test]
fn a_node_stopped_while_it_sends_through_layers_of_links() {
    let table = two_nodes();
    let charges = [charge_of_a_late_packet(in_process(&table)), charge_of_a_late_packet(udp(&table))];
    assert!(charges.iter().all(|charge| charge.0 >= STOP_US), "{charges:?}");
}

/// A link that takes a long time to refuse a packet. The first refusal takes so long that another packet of the node
/// enters the buffer meanwhile.
struct Refusing<L> {
    inner: L,
    refused: AtomicBool,
    asked: AtomicBool,
    other_came: AtomicBool,
}

fn until(flag: &AtomicBool) {
    while !flag.load(Ordering::Acquire) {
        thread::sleep(Duration::from_millis(1));
    }
}

impl<L: Link> Link for Refusing<L> {
    fn ready(&self, next: NodeId) -> bool {
        self.inner.ready(next)
    }

    fn send_at(&self, next: NodeId, packets: &[Packet], at: Instant) -> Result<usize, LinkBusy> {
        if self.asked.swap(true, Ordering::AcqRel) {
            return self.inner.send_at(next, packets, at);
        }
        until(&self.other_came);
        self.refused.store(true, Ordering::Release);
        self.inner.wake();
        Err(LinkBusy)
    }

    fn poll(&self, sink: &dyn Sink, until: Option<Instant>) -> PollEnd {
        match self.inner.poll(sink, until) {
            PollEnd::Woken if self.refused.swap(false, Ordering::AcqRel) => PollEnd::Ready,
            end => end,
        }
    }

    fn wake(&self) {
        self.inner.wake();
    }
}

#[test]
fn what_a_link_refused_late_is_as_old_as_that() {
    let mut cell = cell(&[0, 1, 0], Ticks(1_000));
    cell.port(PortDecl::new("long", A, Usage::Send, &[B], LONG_TICKS).bounded_buffer(1));
    cell.port(PortDecl::new("other", C, Usage::Send, &[B], LONG_TICKS).bounded_buffer(1));
    let table = table(cell);
    let [first, second] = in_process(&table);
    let [refused, asked, other_came] = [false; 3].map(AtomicBool::new);
    let link = Arc::new(Refusing { inner: first, refused, asked, other_came });
    let builder =
        |node| Runtime::builder(Arc::clone(&table), NodeId(node)).incarnation(Incarnation(1), false);
    let (tell, told) = report();
    let receiver = builder(1).link(Arc::new(second)).task("b", move |ctx| {
        for _ in 0..2 {
            let news = ctx.receive(None, None)?.expect("only a message ends it");
            tell.send((news.from.port, news.budget)).expect("the test listens");
        }
        Ok(())
    });
    let here = Arc::clone(&link);
    let sender = builder(0).link(Arc::clone(&link) as Arc<dyn Link>);
    let sender = sender.task("a", |ctx| ctx.send(ctx.port("long")?, b"old").map(|_copies| ()));
    let sender = sender.task("c", move |ctx| {
        until(&here.asked);
        ctx.delay(STOP)?;
        let _copies = ctx.send(ctx.port("other")?, b"new")?;
        here.other_came.store(true, Ordering::Release);
        Ok(())
    });
    let (receiver, sender) = (receiver.start().unwrap(), sender.start().unwrap());
    assert!(receiver.wait(LONG));
    let budgets: Vec<_> = told.iter().collect();
    let long = PortId(0);
    let (_, left) = budgets.iter().find(|(port, _)| *port == long).expect("it came");
    assert!(left.0 <= LONG_TICKS.0 - STOP_US, "younger than the link's answer: {budgets:?}");
    finish(receiver);
    finish(sender);
}
