//! Tests of the goodbye of a node that stops in order (D205).

use super::keys::{carried, keys, pair};
use super::rig::{
    A, B, Memory, PATIENCE, any_port, digests, encoded, envelope, envelope_of, link, raw_socket, sealed,
};
use imrs_protocol::{Cell, CellTable, Incarnation, NodeId, NodeTable, Outcome, PortDecl, Ticks, Usage};
use imrs_runtime::link::udp::{UdpCount, UdpLink, UdpOptions};
use imrs_runtime::link::{Link, LinkDiscard};
use imrs_runtime::{Runtime, Sent};
use imrs_wire::envelope::{Envelope, Purpose, without_packets};
use std::sync::{Arc, mpsc};
use std::time::Duration;

fn goodbye(envelope: Envelope) -> Vec<u8> {
    without_packets(&Envelope { purpose: Purpose::Goodbye, ..envelope }, digests()).to_vec()
}

fn has_stopped(link: &UdpLink) -> bool {
    link.health().iter().any(|report| report.peer == A && report.has_stopped)
}

#[test]
fn a_goodbye_counts_once_if_it_is_the_newest_of_the_known_session() {
    // Without the address of A, the order of incarnations decides which session is newer.
    let (b, a, memory) = (link(B), raw_socket(), Memory::default());
    let throw = |bytes: &[u8]| assert_eq!(a.send_to(bytes, b.local_address()).unwrap(), bytes.len());
    let dropped = |bytes: &[u8]| {
        throw(bytes);
        memory.take_discards(&b, 1)[0]
    };
    assert_eq!(dropped(&goodbye(envelope(0))), LinkDiscard::UnprovenSession, "of an unknown session");
    throw(&sealed(&envelope(5), &[encoded(1)]));
    memory.take_packets(&b, 1);
    for old in [3, 5] {
        assert_eq!(dropped(&goodbye(envelope(old))), LinkDiscard::Replayed);
    }
    assert_eq!(dropped(&goodbye(envelope_of(2, 9))), LinkDiscard::UnprovenSession, "of another session");
    assert!(memory.stopped.lock().unwrap().is_empty() && !has_stopped(&b));
    for counter in 6..9 {
        throw(&goodbye(envelope(counter)));
        memory.poll_until(&b, |m| !m.stopped.lock().unwrap().is_empty());
    }
    assert_eq!(dropped(&goodbye(envelope(7))), LinkDiscard::Replayed);
    assert_eq!(*memory.stopped.lock().unwrap(), [A], "once, though it is repeated");
    assert!(has_stopped(&b));
    // The next start of A begins a session.
    throw(&sealed(&envelope_of(2, 0), &[encoded(2)]));
    memory.take_packets(&b, 1);
    assert!(!has_stopped(&b));
    assert_eq!(dropped(&goodbye(envelope(9))), LinkDiscard::StaleIncarnation, "of the session before");
    assert!(!has_stopped(&b));
}

#[test]
fn with_keys_only_the_neighbour_itself_says_goodbye() {
    let (a, b) = pair(&keys());
    carried(&a, &b, 1..5);
    let (forger, at_b) = (raw_socket(), Memory::default());
    forger.send_to(&goodbye(envelope(1 << 40)), b.local_address()).unwrap();
    assert_eq!(at_b.take_discards(&b, 1), [LinkDiscard::Mode]);
    assert!(at_b.stopped.lock().unwrap().is_empty());
    a.goodbye();
    at_b.poll_until(&b, |m| !m.stopped.lock().unwrap().is_empty());
    assert_eq!((*at_b.stopped.lock().unwrap()).clone(), [A]);
    assert!(has_stopped(&b) && a.count(UdpCount::GoodbyesSent) >= 3);
    assert_eq!(b.count(UdpCount::GoodbyesReceived), 1);
}

/// Node `a` has a task that asks a task of node `b`. The time_out of the question is longer than any test waits.
#[test]
fn a_request_to_a_node_that_leaves_ends_at_once() {
    let mut cell = Cell::new("leave", Ticks(1_000));
    let nodes = ["a", "b"].map(|name| cell.node(name));
    let (asks, asked) = (cell.task("asks", nodes[0]), cell.task("asked", nodes[1]));
    cell.link(nodes[0], nodes[1], Ticks(50_000));
    cell.port(PortDecl::new("ask", asks, Usage::Send, &[asked], Ticks(3_600_000_000)).command());
    let table = Arc::new(CellTable::new(cell).unwrap());
    let bound = |node: NodeId| {
        let options = UdpOptions::new(Incarnation(1), false);
        Arc::new(UdpLink::bind(NodeTable::new(Arc::clone(&table), node), any_port(), options).unwrap())
    };
    let (of_a, of_b) = (bound(nodes[0]), bound(nodes[1]));
    of_a.set_address(nodes[1], Some(of_b.local_address())).unwrap();
    of_b.set_address(nodes[0], Some(of_a.local_address())).unwrap();
    let node = |at: usize, link| Runtime::builder(Arc::clone(&table), nodes[at]).insecure(true).link(link);
    let (taken, is_taken) = mpsc::channel();
    let b = node(1, of_b).task("asked", move |ctx| {
        let _question = ctx.receive(None, None)?;
        taken.send(()).expect("the test waits");
        ctx.delay(Duration::from_secs(3_600))?;
        Ok(())
    });
    let (ended, end) = mpsc::channel();
    let a = node(0, of_a).task("asks", move |ctx| {
        let ask = ctx.port("ask")?;
        let is_over = matches!(ctx.send(ask, b"?")?, Sent::Outcome(Outcome::PeerRestarted));
        ended.send(is_over).expect("the test waits");
        Ok(())
    });
    let (b, a) = (b.start().unwrap(), a.start().unwrap());
    is_taken.recv_timeout(PATIENCE).expect("the question arrives");
    assert!(end.try_recv().is_err(), "the question has no answer");
    let _ends = b.leave(PATIENCE);
    assert_eq!(end.recv_timeout(PATIENCE), Ok(true), "it may have run, and no answer will come");
    let _ends = a.stop(PATIENCE);
}
