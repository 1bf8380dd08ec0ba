//! Once two links know each other, their datagrams need no allocation.

use crate::allocator::of_this_thread;
use crate::alone;
use imrs_protocol::{
    Cell, CellTable, Class, Contents, Incarnation, Kind, MAX_HOPS, MessageId, NodeId, NodeTable, Packet,
    PortDecl, PortId, Seal, Seq24, TaskId, Ticks, Usage,
};
use imrs_runtime::link::udp::{UdpLink, UdpOptions};
use imrs_runtime::link::{Link, LinkDiscard, PollEnd, Sink};
use std::net::Ipv4Addr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

#[derive(Default)]
struct Counter(AtomicU64);

impl Sink for Counter {
    fn packets(&self, _from: NodeId, packets: &[Packet], _charge: Ticks, _at: Instant) {
        self.0.fetch_add(packets.len() as u64, Ordering::Relaxed);
    }

    fn peer(&self, _node: NodeId, _incarnation: Incarnation, _restarted: bool) {}

    fn discarded(&self, reason: LinkDiscard) {
        panic!("{reason}");
    }
}

fn links() -> [UdpLink; 2] {
    let mut cell = Cell::new("two", Ticks(100));
    let nodes = ["a", "b"].map(|name| cell.node(name));
    let tasks = [cell.task("x", nodes[0]), cell.task("y", nodes[1])];
    cell.link(nodes[0], nodes[1], Ticks(1_000));
    cell.port(PortDecl::new("p", tasks[0], Usage::Send, &tasks[1..], Ticks(1_000_000)));
    let table = Arc::new(CellTable::new(cell).unwrap());
    let link = |node| {
        let address = (Ipv4Addr::LOCALHOST, 0).into();
        let options = UdpOptions::new(Incarnation(1), false);
        UdpLink::bind(NodeTable::new(Arc::clone(&table), node), address, options).unwrap()
    };
    let [a, b] = nodes.map(link);
    a.set_address(nodes[1], Some(b.local_address())).unwrap();
    b.set_address(nodes[0], Some(a.local_address())).unwrap();
    [a, b]
}

#[test]
fn sending_and_receiving_allocate_nothing() {
    let _alone = alone();
    let [a, b] = links();
    let packet = Packet {
        kind: Kind::Send,
        class: Class::Status,
        more: false,
        resent: false,
        hops: MAX_HOPS,
        fragment: 0,
        destination: TaskId(1),
        source: TaskId(0),
        port: PortId(0),
        id: MessageId { incarnation: Incarnation(1), sequence: Seq24::new(1) },
        remaining: Ticks(1_000_000),
        contents: Contents::EMPTY,
        seal: Seal::NONE,
    };
    let (packets, got) = ([packet; 50], Counter::default());
    let round = |sender: &UdpLink, receiver: &UdpLink, to: NodeId, count: usize| {
        let before = got.0.load(Ordering::Relaxed);
        let taken = sender.send(to, &packets[..count]).unwrap();
        while got.0.load(Ordering::Relaxed) < before + taken as u64 {
            let end = receiver.poll(&got, Some(Instant::now() + Duration::from_secs(120)));
            assert_ne!(end, PollEnd::TimedOut);
        }
    };
    let rounds = || {
        for count in [1, 2, 50] {
            round(&a, &b, NodeId(1), count);
            round(&b, &a, NodeId(0), count);
        }
    };
    rounds();
    let before = of_this_thread();
    for _ in 0..500 {
        rounds();
    }
    assert_eq!(of_this_thread() - before, 0, "in 3,000 datagrams");
}
