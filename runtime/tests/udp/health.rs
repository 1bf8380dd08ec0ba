//! Tests of what a link measures: how long datagrams took (D205), and whether damage makes the link faulty.

use super::rig::{A, B, C, Memory, encoded, envelope, link, packet, pair, raw_socket, sealed};
use imrs_protocol::NodeId;
use imrs_runtime::link::udp::{FAILURES, UdpLink};
use imrs_runtime::link::{Link, LinkDiscard};
use imrs_wire::obs::LinkReport;
use std::net::UdpSocket;
use std::thread;
use std::time::{Duration, Instant};

fn report(link: &UdpLink, of: NodeId) -> LinkReport {
    link.health().into_iter().find(|report| report.peer == of).unwrap()
}

#[test]
fn a_delay_is_bounded_by_the_round_trip_and_never_less_than_the_truth() {
    let (a, b) = pair();
    let (at_a, at_b) = (Memory::default(), Memory::default());
    let begun = Instant::now();
    for number in 1..=40 {
        a.send(B, &[packet(number)]).unwrap();
        at_b.take_packets(&b, 1);
        b.send(A, &[packet(number)]).unwrap();
        at_a.take_packets(&a, 1);
    }
    let told = report(&a, B);
    // If an exchange took so long that the clocks may have drifted apart, it is not measured. That happens on a busy
    // machine.
    assert_eq!(told.delay.count + told.unmeasured, 40);
    assert!(told.delay.count > 0 && told.delay.p50_us <= told.delay.p99_us, "{told:?}");
    assert!(told.delay.max_us <= u64::try_from(begun.elapsed().as_micros()).unwrap(), "{told:?}");
    assert_eq!(told.recent, told.delay, "all of it is recent");
    assert_eq!(report(&b, C).delay.count, 0, "nothing came from there");
}

#[test]
fn a_datagram_that_was_held_back_is_late() {
    let (a, b) = pair();
    let (at_a, at_b) = (Memory::default(), Memory::default());
    let exchange = |number, read_at: Option<Instant>| {
        b.send(A, &[packet(number)]).unwrap();
        at_a.take_packets(&a, 1);
        let read_at = read_at.unwrap_or_else(Instant::now);
        a.send_at(B, &[packet(number)], read_at).unwrap();
        at_b.take_packets(&b, 1);
    };
    (1..=5).for_each(|number| exchange(number, None));
    let before = report(&b, A).delay;
    // The sender is stopped between the reading of its clock and the send call, after an exchange that bounds the
    // offset of the clocks closely.
    let held = Duration::from_millis(100);
    let read_at = Instant::now();
    thread::sleep(held);
    exchange(6, Some(read_at));
    let after = report(&b, A).delay;
    assert_eq!((after.count, after.late), (before.count + 1, before.late + 1), "{after:?}");
    assert!(after.max_us >= u64::try_from(held.as_micros()).unwrap(), "{after:?}");
}

#[test]
fn without_an_exchange_nothing_is_measured() {
    let (a, b) = (link(A), link(B));
    a.set_address(B, Some(b.local_address())).unwrap();
    let at_b = Memory::default();
    for number in 1..=3 {
        a.send(B, &[packet(number)]).unwrap();
        at_b.take_packets(&b, 1);
    }
    let told = report(&b, A);
    assert_eq!((told.delay.count, told.unmeasured), (0, 3), "no datagram has an echo");
}

/// The link of node B, and a socket whose address is that of A in B's address book.
fn beside() -> (UdpLink, UdpSocket) {
    let (b, at_a) = (link(B), raw_socket());
    b.set_address(A, Some(at_a.local_addr().unwrap())).unwrap();
    (b, at_a)
}

fn datagram(number: u64) -> Vec<u8> {
    sealed(&envelope(number), &[encoded(u32::try_from(number).unwrap() + 1)])
}

fn damaged(number: u64) -> Vec<u8> {
    let mut bytes = datagram(number);
    *bytes.last_mut().unwrap() ^= 1;
    bytes
}

#[test]
fn a_link_that_damages_datagrams_is_faulty_and_still_used() {
    let (b, at_a) = beside();
    let memory = Memory::default();
    let send = |bytes: &[u8]| assert_eq!(at_a.send_to(bytes, b.local_address()).unwrap(), bytes.len());
    send(&datagram(0));
    memory.take_packets(&b, 1);
    for number in 1..=FAILURES + 1 {
        send(&damaged(number));
        assert_eq!(memory.take_discards(&b, 1), [LinkDiscard::Checksum]);
    }
    assert!(!report(&b, A).integrity.is_faulty, "nothing is known to be missing");
    send(&datagram(FAILURES + 2));
    assert_eq!(memory.take_packets(&b, 1).len(), 1, "what is whole is taken");
    let told = report(&b, A).integrity;
    assert_eq!((told.failures, told.is_faulty, told.faults), (FAILURES + 1, true, 1));
    send(&datagram(FAILURES + 3));
    assert_eq!(memory.take_packets(&b, 1).len(), 1, "and so is what comes later");
}

#[test]
fn garbage_under_the_address_of_a_neighbour_makes_its_link_not_faulty() {
    let (b, at_a) = beside();
    let memory = Memory::default();
    for number in 0..3 * FAILURES {
        at_a.send_to(&datagram(number), b.local_address()).unwrap();
        memory.take_packets(&b, 1);
        at_a.send_to(&[7; 120], b.local_address()).unwrap();
        memory.take_discards(&b, 1);
    }
    let told = report(&b, A).integrity;
    assert_eq!((told.failures, told.is_faulty, told.faults), (3 * FAILURES, false, 0));
}

#[test]
fn garbage_of_strangers_counts_for_no_link() {
    let (b, _at_a) = beside();
    let (memory, stranger) = (Memory::default(), raw_socket());
    for _ in 0..3 * FAILURES {
        stranger.send_to(&[7; 120], b.local_address()).unwrap();
        memory.take_discards(&b, 1);
    }
    assert_eq!(report(&b, A).integrity.failures, 0);
}
