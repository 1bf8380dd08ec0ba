//! Tests of sessions: after a restart of a node, its neighbours accept its datagrams again. A dead session never
//! replaces the current one (D144).

use super::rig::{
    A, B, C, Memory, PATIENCE, any_port, cell, digests, encoded, envelope, introduced, link, packet, pair,
    raw_socket, sealed, sealed_for, started, table,
};
use imrs_protocol::{Incarnation, NodeTable, Packet};
use imrs_runtime::link::udp::{UdpCount, UdpLink, UdpOptions};
use imrs_runtime::link::{Link, LinkDiscard};
use imrs_wire::envelope::{Digests, Envelope, Refused, read};
use std::net::UdpSocket;
use std::time::{Duration, Instant};

/// Lets all links receive until `done` returns true.
pub fn drive(links: &[(&UdpLink, &Memory)], mut done: impl FnMut() -> bool) {
    let end = Instant::now() + PATIENCE;
    while !done() {
        assert!(Instant::now() < end, "nothing more came");
        for (link, memory) in links {
            link.poll(*memory, Some(Instant::now() + Duration::from_micros(200)));
        }
    }
}

/// Lets all links receive until no more datagrams arrive: a datagram on the loopback arrives at once.
fn settle(links: &[(&UdpLink, &Memory)]) {
    let came = || links.iter().map(|(link, _)| received(link)).sum::<u64>();
    let mut before = u64::MAX;
    drive(links, || std::mem::replace(&mut before, came()) == came());
}

fn received(link: &UdpLink) -> u64 {
    [UdpCount::DatagramsReceived, UdpCount::GreetingsReceived].map(|count| link.count(count)).iter().sum()
}

/// Intercepts the datagram that A would send to B next.
pub fn taken_on_its_way(a: &UdpLink, b: &UdpLink, packet: Packet) -> Vec<u8> {
    let between = raw_socket();
    between.set_read_timeout(Some(PATIENCE)).unwrap();
    a.set_address(B, Some(between.local_addr().unwrap())).unwrap();
    a.send(B, &[packet]).unwrap();
    let mut bytes = vec![0; 2_000];
    let length = between.recv(&mut bytes).unwrap();
    bytes.truncate(length);
    a.set_address(B, Some(b.local_address())).unwrap();
    bytes
}

fn throw(bytes: &[u8], at: &UdpLink) {
    raw_socket().send_to(bytes, at.local_address()).unwrap();
}

/// Lets both nodes receive a datagram from each other.
fn acquainted(a: &UdpLink, b: &UdpLink) {
    let (at_a, at_b) = (Memory::default(), Memory::default());
    b.send(A, &[packet(1)]).unwrap();
    at_a.take_packets(a, 1);
    a.send(B, &[packet(1)]).unwrap();
    at_b.take_packets(b, 1);
}

/// Lets A send packets to B, one by one, until B gets one. Returns how many of A's packets were lost.
fn lost_until_heard(a: &UdpLink, b: &UdpLink, at_b: &Memory, first: u32) -> u32 {
    let at_a = Memory::default();
    for number in first..first + 100 {
        a.send(B, &[packet(number)]).unwrap();
        settle(&[(b, at_b), (a, &at_a), (b, at_b)]);
        if at_b.packets.lock().unwrap().iter().any(|got| got.1 == packet(number)) {
            return number - first;
        }
    }
    panic!("it stays deaf");
}

/// A regression test: a datagram for B that reached C instead once made C drop all 74 later datagrams.
#[test]
fn a_datagram_for_another_node_changes_nothing_and_is_named() {
    let ((a, b), c) = (pair(), link(C));
    for number in 0..1_500 {
        a.send(B, &[packet(number)]).unwrap();
    }
    let astray = taken_on_its_way(&a, &b, packet(1_500));
    throw(&astray, &c);
    let memory = Memory::default();
    assert_eq!(memory.take_discards(&c, 1), [LinkDiscard::Misdelivered]);
    a.set_address(C, Some(c.local_address())).unwrap();
    for number in 0..74 {
        a.send(C, &[packet(number)]).unwrap();
    }
    assert_eq!(memory.take_packets(&c, 74).len(), 74);
    assert_eq!(*memory.discards.lock().unwrap(), []);
}

/// A datagram whose counter is far ahead, and that brings no packet of this cell.
#[test]
fn a_datagram_without_a_packet_of_this_cell_changes_nothing() {
    let (b, memory) = (link(B), Memory::default());
    let mut damaged = encoded(2);
    damaged[20] ^= 1;
    throw(&sealed(&envelope(1 << 50), &[damaged]), &b);
    assert_eq!(memory.take_discards(&b, 1)[0].name(), "packet_checksum");
    assert_eq!(*memory.peers.lock().unwrap(), [], "it is not even heard of");
    throw(&sealed(&envelope(0), &[encoded(1)]), &b);
    assert_eq!(memory.take_packets(&b, 1).len(), 1);
}

#[test]
fn a_node_that_lost_its_state_is_heard_after_one_exchange() {
    for (before, after) in [(200, 0), (5, 5), (130, 2), (7, 8)] {
        // Each iteration has a new link, because datagrams of earlier iterations would count, and because one link asks
        // only once in a while.
        let (b, at_b) = (link(B), Memory::default());
        let a = started(A, before, true);
        let (a, b) = (a, &b);
        a.set_address(B, Some(b.local_address())).unwrap();
        b.set_address(A, Some(a.local_address())).unwrap();
        lost_until_heard(&a, b, &at_b, 100);
        drop(a);
        let again = started(A, after, false);
        again.set_address(B, Some(b.local_address())).unwrap();
        b.set_address(A, Some(again.local_address())).unwrap();
        let lost = lost_until_heard(&again, b, &at_b, 200);
        assert_eq!(lost, 1, "{after} after {before}: the first one asks, the next one is heard");
        assert_eq!(at_b.peers.lock().unwrap().last(), Some(&(A, Incarnation(after), true)));
        assert!(b.count(UdpCount::EchoesAsked) >= 1);
    }
}

#[test]
fn a_node_that_greets_is_heard_with_its_first_packet() {
    let (a, b) = pair();
    let (at_a, at_b) = (Memory::default(), Memory::default());
    acquainted(&a, &b);
    let again = started(A, 0, false);
    let (again, b) = introduced(again, b);
    assert!(again.greet());
    settle(&[(&b, &at_b), (&again, &at_a), (&b, &at_b), (&again, &at_a)]);
    assert!(!again.greet(), "they have met");
    assert_eq!(lost_until_heard(&again, &b, &at_b, 5), 0);
    assert_eq!(*at_b.peers.lock().unwrap(), [(A, Incarnation(0), true)]);
}

#[test]
fn a_datagram_of_a_dead_session_takes_nothing_over() {
    let (a, b) = introduced(started(A, 200, true), link(B));
    let at_b = Memory::default();
    acquainted(&a, &b);
    let dead = taken_on_its_way(&a, &b, packet(7));
    assert!(read(&dead).unwrap().envelope.echo.is_some(), "it had heard B");
    drop(a);
    // Incarnation 100 comes before 200, and 250 after it.
    for (incarnation, reason) in [(100, LinkDiscard::UnprovenSession), (250, LinkDiscard::StaleIncarnation)] {
        let (again, b) = (started(A, incarnation, false), &b);
        again.set_address(B, Some(b.local_address())).unwrap();
        b.set_address(A, Some(again.local_address())).unwrap();
        lost_until_heard(&again, b, &at_b, 10);
        let before = b.count(UdpCount::NewIncarnations);
        at_b.packets.lock().unwrap().clear();
        at_b.discards.lock().unwrap().clear();
        for number in 0..20 {
            throw(&dead, b);
            assert_eq!(at_b.take_discards(b, 1), [reason]);
            assert_eq!(lost_until_heard(&again, b, &at_b, 1_000 + number), 0);
        }
        assert_eq!(at_b.take_packets(b, 20).len(), 20);
        assert_eq!(b.count(UdpCount::NewIncarnations), before);
    }
}

/// A node that has just begun cannot distinguish an old datagram from a first one. The next exchange corrects that.
#[test]
fn a_dead_session_that_is_heard_first_is_replaced() {
    let (a, b) = pair();
    acquainted(&a, &b);
    let dead_of_a = taken_on_its_way(&a, &b, packet(7));
    let between = raw_socket();
    between.set_read_timeout(Some(PATIENCE)).unwrap();
    b.set_address(A, Some(between.local_addr().unwrap())).unwrap();
    b.send(A, &[packet(8)]).unwrap();
    let mut dead_of_b = vec![0; 2_000];
    let length = between.recv(&mut dead_of_b).unwrap();
    drop((a, b));
    // Each node first receives a datagram of the dead session of the other node.
    let (a, b) = introduced(started(A, 3, true), started(B, 3, true));
    let (at_a, at_b) = (Memory::default(), Memory::default());
    throw(&dead_of_a, &b);
    throw(&dead_of_b[..length], &a);
    at_b.take_packets(&b, 1);
    at_a.take_packets(&a, 1);
    assert_eq!(lost_until_heard(&a, &b, &at_b, 50), 1);
    b.send(A, &[packet(60)]).unwrap();
    assert_eq!(at_a.take_packets(&a, 1)[0].1, packet(60));
}

#[test]
fn a_counter_that_jumped_ahead_comes_back() {
    let (a, b) = pair();
    let at_b = Memory::default();
    acquainted(&a, &b);
    let bytes = taken_on_its_way(&a, &b, packet(7));
    let opened = read(&bytes).unwrap();
    let far = Envelope { counter: 1 << 50, ..opened.envelope };
    throw(&sealed(&far, opened.packets), &b);
    assert_eq!(at_b.take_packets(&b, 1)[0].1, packet(7));
    assert!(lost_until_heard(&a, &b, &at_b, 100) <= 1);
    assert_eq!(b.count(UdpCount::CountersMended), 1);
    // The datagram's counter is not new, so the datagram counts as seen.
    throw(&bytes, &b);
    at_b.discards.lock().unwrap().clear();
    assert_eq!(at_b.take_discards(&b, 1), [LinkDiscard::Replayed]);
    assert_eq!(lost_until_heard(&a, &b, &at_b, 300), 0);
}

fn with(name: &str, node: imrs_protocol::NodeId, statements: u32) -> UdpLink {
    let options = UdpOptions { statements, ..UdpOptions::new(Incarnation(1), false) };
    UdpLink::bind(NodeTable::new(cell(name), node), any_port(), options).unwrap()
}

#[test]
fn nodes_of_two_cells_both_say_that_they_do_not_talk() {
    for (other, statements, why, name) in [
        ("another cell", 7, Refused::OtherCell, "other_cell"),
        ("udp", 8, Refused::OtherStatements, "other_statements"),
    ] {
        let (a, b) = introduced(with("udp", A, 7), with(other, B, statements));
        let (at_a, at_b) = (Memory::default(), Memory::default());
        a.send(B, &[packet(1)]).unwrap();
        drive(&[(&b, &at_b), (&a, &at_a)], || !at_a.discards.lock().unwrap().is_empty());
        assert_eq!(at_b.discards.lock().unwrap()[0].name(), name);
        assert_eq!(*at_a.discards.lock().unwrap(), [LinkDiscard::RefusedByPeer]);
        assert_eq!(at_b.delivered(), 0);
        let [of_a] = a.refusals()[..] else { panic!("{:?}", a.refusals()) };
        let [of_b] = b.refusals()[..] else { panic!("{:?}", b.refusals()) };
        assert_eq!((of_a.node, of_a.why, of_a.here, of_a.there), (B, why, false, true));
        assert_eq!((of_b.node, of_b.why, of_b.here, of_b.there), (A, why, true, false));
        assert_eq!((of_a.theirs, of_b.theirs), (b.digests(), a.digests()), "both know both");
        // A node sends few refusals, and answers none.
        for number in 0..100 {
            a.send(B, &[packet(number)]).unwrap();
        }
        settle(&[(&b, &at_b), (&a, &at_a), (&b, &at_b)]);
        assert!(b.count(UdpCount::RefusalsSent) <= 100 && a.count(UdpCount::RefusalsSent) == 0);
    }
}

/// After one datagram from a cell with other statements, the node still accepts the right datagrams, and the refusal ends.
#[test]
fn a_refusal_ends_with_what_is_admitted() {
    let (a, b) = pair();
    let at_b = Memory::default();
    let other = Digests { statements: 9, ..digests() };
    throw(&sealed_for(other, &envelope(0), &[encoded(1)]), &b);
    assert_eq!(at_b.take_discards(&b, 1), [LinkDiscard::OtherStatements]);
    assert_eq!(b.refusals().len(), 1);
    let at_a = Memory::default();
    assert_eq!(at_a.take_discards(&a, 1), [LinkDiscard::RefusedByPeer]);
    assert_eq!(a.refusals().len(), 1);
    acquainted(&a, &b);
    assert!(a.refusals().is_empty() && b.refusals().is_empty());
}

#[test]
fn neighbours_say_which_incarnation_they_remember() {
    let (a, b) = introduced(started(A, 77, true), link(B));
    acquainted(&a, &b);
    drop(a);
    let (again, c) = (started(A, 0, false), link(C));
    again.set_address(C, Some(c.local_address())).unwrap();
    c.set_address(A, Some(again.local_address())).unwrap();
    let (again, b) = introduced(again, b);
    let (at_b, at_c) = (Memory::default(), Memory::default());
    let said = std::thread::scope(|scope| {
        let asking = scope.spawn(|| again.ask_incarnations(PATIENCE));
        drive(&[(&b, &at_b), (&c, &at_c)], || asking.is_finished());
        asking.join().unwrap()
    });
    assert_eq!(said, [(B, Some(Incarnation(77))), (C, None)]);
    assert_eq!(*at_b.peers.lock().unwrap(), [], "a node that asks is not yet there");
    again.set_incarnation(Incarnation(78), true);
    assert_eq!(lost_until_heard(&again, &b, &at_b, 5), 0, "it has heard B already");
    assert_eq!(at_b.peers.lock().unwrap().last(), Some(&(A, Incarnation(78), true)));
}

#[test]
fn a_node_that_nobody_answers_goes_on() {
    let (a, silent): (_, UdpSocket) = (link(A), raw_socket());
    a.set_address(B, Some(silent.local_addr().unwrap())).unwrap();
    let (start, time) = (Instant::now(), Duration::from_millis(50));
    assert_eq!(a.ask_incarnations(time), []);
    assert!(start.elapsed() >= time);
    // Without an address there is no neighbour to ask.
    assert_eq!(link(B).ask_incarnations(PATIENCE), []);
}

/// C has received A's packets only through the relay B, and remembers A's incarnation all the same.
#[test]
fn what_others_pass_on_is_remembered_too() {
    let (b, c) = (link(B), link(C));
    let (at_c, other) = (Memory::default(), packet(3));
    b.set_address(C, Some(c.local_address())).unwrap();
    let id = imrs_protocol::MessageId { incarnation: Incarnation(41), ..other.id };
    b.send(C, &[Packet { id, ..other }]).unwrap();
    at_c.take_packets(&c, 1);
    let a = started(A, 0, false);
    a.set_address(C, Some(c.local_address())).unwrap();
    c.set_address(A, Some(a.local_address())).unwrap();
    let said = std::thread::scope(|scope| {
        let asking = scope.spawn(|| a.ask_incarnations(PATIENCE));
        drive(&[(&c, &at_c)], || asking.is_finished());
        asking.join().unwrap()
    });
    assert_eq!(said, [(C, Some(Incarnation(41)))]);
    assert_eq!(table(A).digest(), c.digests().cell);
}
