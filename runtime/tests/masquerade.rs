//! Tests that a node believes a neighbour only about tasks whose routes lead through that neighbour.

use crate::common::udp::{Nobody, links_with_keys};
use crate::common::{A, B, C, LONG, LONG_TICKS, cell, finish, report, table};
use imrs_protocol::{
    Cell, CellTable, Class, Contents, Incarnation, Kind, MAX_HOPS, MessageId, NodeId, Packet, PortDecl,
    PortId, Reason, Seal, Seq24, TaskId, Ticks, Usage,
};
use imrs_runtime::Runtime;
use imrs_runtime::link::udp::UdpLink;
use imrs_runtime::link::{Link, LinkBusy, PollEnd, Sink};
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

/// A link that hands over packets that the test makes, in the name of any neighbour.
#[derive(Default)]
struct Forger {
    state: Mutex<(Vec<(NodeId, Packet)>, bool)>,
    changed: Condvar,
}

impl Link for Forger {
    fn ready(&self, _next: NodeId) -> bool {
        true
    }

    fn send_at(&self, _next: NodeId, packets: &[Packet], _at: Instant) -> Result<usize, LinkBusy> {
        Ok(packets.len())
    }

    fn poll(&self, sink: &dyn Sink, _until: Option<Instant>) -> PollEnd {
        let idle = |state: &mut (Vec<_>, bool)| state.0.is_empty() && !state.1;
        let mut state = self.changed.wait_while(self.state.lock().unwrap(), idle).unwrap();
        let (packets, woken) = std::mem::take(&mut *state);
        drop(state);
        for (from, packet) in packets {
            sink.packets(from, &[packet], Ticks::ZERO, Instant::now());
        }
        if woken { PollEnd::Woken } else { PollEnd::Received }
    }

    fn wake(&self) {
        self.state.lock().unwrap().1 = true;
        self.changed.notify_all();
    }
}

fn news(source: TaskId, number: u8) -> Packet {
    Packet {
        kind: Kind::Send,
        class: Class::Status,
        more: false,
        resent: false,
        hops: MAX_HOPS,
        fragment: 0,
        destination: C,
        source,
        port: PortId(source.0),
        id: MessageId { incarnation: Incarnation(1), sequence: Seq24::new(u32::from(number)) },
        remaining: LONG_TICKS,
        contents: Contents::new(&[number]).expect("one byte"),
        seal: Seal::NONE,
    }
}

/// A cell with `a`, `b` and `c` on nodes of their own. Links join the nodes of `a` and `b` with that of `c`, but not
/// with each other.
fn star() -> Arc<CellTable> {
    let mut cell: Cell = cell(&[0, 1, 2], Ticks(1_000));
    cell.links.retain(|link| link.b == NodeId(2) || link.a == NodeId(2));
    for (name, owner) in [("of a", A), ("of b", B)] {
        cell.port(PortDecl::new(name, owner, Usage::Send, &[C], LONG_TICKS).bounded_buffer(8));
    }
    table(cell)
}

#[test]
fn a_packet_from_the_wrong_neighbour_is_dropped_counted_and_shown() {
    let link = Arc::new(Forger::default());
    let (tell, told) = report();
    let node = Runtime::builder(star(), NodeId(2))
        .link(Arc::clone(&link) as Arc<dyn Link>)
        .task("c", move |ctx| {
            for _ in 0..2 {
                let news = ctx.receive(None, None)?.expect("only a message ends it");
                tell.send((news.from.source, news.contents.as_bytes()[0])).expect("the test listens");
            }
            assert_eq!(ctx.poll(None)?, None, "somebody was believed who spoke in another's name");
            Ok(())
        })
        .start()
        .unwrap();
    let mut seen = node.node().observe();
    let (first, second) = (NodeId(0), NodeId(1));
    let own = Packet { source: C, destination: A, ..news(A, 5) };
    let packets = vec![
        (second, news(A, 1)),
        (first, news(B, 2)),
        (first, own),
        (first, news(A, 3)),
        (second, news(B, 4)),
    ];
    link.state.lock().unwrap().0 = packets;
    link.changed.notify_all();
    assert!(node.wait(LONG));
    let mut events = Vec::new();
    assert_eq!(seen.drain(64, &mut events), 0);
    let not_allowed = imrs_protocol::Event::Discarded(Reason::NotAllowed);
    let dropped: Vec<_> =
        events.iter().filter(|event| event.what.event == not_allowed).map(|event| event.what.peer).collect();
    assert_eq!(dropped, [A, B, C]);
    let counts = node.node().snapshot(0).discards;
    let count = counts.iter().find(|count| count.name == Reason::NotAllowed.name()).expect("every reason");
    assert_eq!(count.count, 3);
    drop(seen);
    finish(node);
    assert_eq!(told.iter().collect::<Vec<_>>(), [(A, 3), (B, 4)]);
}

/// Sends packets to `c`'s node, once this link has a session with that node.
fn sends(link: &UdpLink, packets: &[Packet]) {
    let (end, mut left) = (Instant::now() + LONG, packets);
    while !left.is_empty() {
        assert!(Instant::now() < end, "there is no session");
        if link.ready(NodeId(2)) {
            let sent = link.send(NodeId(2), left).unwrap_or_default();
            left = &left[sent..];
        } else {
            link.poll(&Nobody, Some(Instant::now() + Duration::from_millis(20)));
        }
    }
}

/// The node of `a` has keys of the cell, and sends packets in the name of `b`, which is the only user of a port.
#[test]
fn a_node_with_keys_is_not_believed_about_the_user_of_a_port_on_another_node() {
    let mut cell = star().cell().clone();
    cell.port(PortDecl::new("jobs", C, Usage::Receive, &[B], LONG_TICKS).bounded_buffer(8));
    let table = table(cell);
    let mut links = links_with_keys(&table);
    let of_c = links.pop().expect("three links");
    let (tell, told) = report();
    let node = Runtime::builder(Arc::clone(&table), NodeId(2)).incarnation(Incarnation(1), false);
    let node = node.link(Arc::new(of_c)).task("c", move |ctx| {
        for _ in 0..2 {
            let news = ctx.receive(None, None)?.expect("only a message ends it");
            tell.send((news.from.source, news.contents.as_bytes()[0])).expect("the test listens");
        }
        Ok(())
    });
    let node = node.start().unwrap();
    let job = |source, number| Packet { port: PortId(2), ..news(source, number) };
    // All packets leave in one datagram. So when the last packet arrives, the forgeries before it have been judged.
    sends(&links[0], &[job(B, 1), job(A, 2), news(A, 3)]);
    assert_eq!(told.recv_timeout(LONG), Ok((A, 3)));
    sends(&links[1], &[job(B, 4)]);
    assert_eq!(told.recv_timeout(LONG), Ok((B, 4)), "the user of the port, over its own link");
    let counts = node.node().snapshot(0).discards;
    let count = counts.iter().find(|count| count.name == Reason::NotAllowed.name()).expect("every reason");
    assert_eq!(count.count, 2);
    finish(node);
}
