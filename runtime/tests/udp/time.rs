//! Old packets come out old (D20, D50).

use crate::rig::{A, B, BOUND, Memory, link, packet, pair};
use imrs_runtime::link::Link;
use imrs_runtime::link::udp::UdpCount;
use std::thread;
use std::time::{Duration, Instant};

const LONG: Duration = Duration::from_millis(300);

fn micros(duration: Duration) -> u64 {
    u64::try_from(duration.as_micros()).unwrap()
}

#[test]
fn a_datagram_left_in_the_socket_is_charged_its_wait() {
    let (a, b) = pair();
    let memory = Memory::default();
    a.send(B, &[packet(1)]).unwrap();
    let sent = Instant::now();
    thread::sleep(LONG);
    let (_, _, charge) = memory.take_packets(&b, 1)[0];
    let most = sent.elapsed();
    assert!(charge.0 >= micros(LONG) + BOUND.0, "{charge} us for a wait of {LONG:?}");
    assert!(charge.0 <= micros(most) + BOUND.0 + 100_000, "{charge} us for a wait of at most {most:?}");
    assert_eq!(b.count(UdpCount::NoStamp), 0, "the kernel gives stamps");
}

/// With the first datagram nothing is known of the sender's clock: only the kernel's stamp can tell.
#[test]
fn the_stamp_alone_tells_how_long_each_datagram_waited() {
    let (a, b) = (link(A), link(B));
    a.set_address(B, Some(b.local_address())).unwrap();
    a.send(B, &[packet(1)]).unwrap();
    thread::sleep(LONG);
    a.send(B, &[packet(2)]).unwrap();
    let charges: Vec<_> = Memory::default().take_packets(&b, 2).iter().map(|p| p.2.0).collect();
    assert!(charges[0] >= micros(LONG) + BOUND.0, "{charges:?}");
    assert!(charges[1] >= BOUND.0 && charges[0] - charges[1] >= micros(LONG) / 2, "{charges:?}");
}

#[test]
fn a_sender_stopped_between_its_clock_and_the_socket_is_charged() {
    let (a, b) = pair();
    let (at_a, at_b) = (Memory::default(), Memory::default());
    // A round trip lets B know A's clock.
    b.send(A, &[packet(1)]).unwrap();
    at_a.take_packets(&a, 1);
    a.send(B, &[packet(2)]).unwrap();
    at_b.take_packets(&b, 1);
    let read = Instant::now();
    thread::sleep(LONG);
    assert_eq!(a.send_at(B, &[packet(3)], read), Ok(1));
    let (_, _, charge) = at_b.take_packets(&b, 1)[0];
    assert!(charge.0 >= micros(LONG), "{charge} us");
}

/// The same before any echo: B never sends.
#[test]
fn a_stopped_sender_is_charged_without_a_round_trip_too() {
    let (a, b) = (link(A), link(B));
    a.set_address(B, Some(b.local_address())).unwrap();
    let memory = Memory::default();
    a.send(B, &[packet(1)]).unwrap();
    memory.take_packets(&b, 1);
    let read = Instant::now();
    thread::sleep(LONG);
    a.send_at(B, &[packet(2)], read).unwrap();
    let (_, _, charge) = memory.take_packets(&b, 1)[0];
    assert!(charge.0 >= micros(LONG), "{charge} us");
}

/// What a packet costs when nothing is wrong: the declared bound, and what a busy machine adds to a loopback round trip.
#[test]
fn a_quick_round_trip_costs_little_more_than_the_declared_bound() {
    let (a, b) = pair();
    let (at_a, at_b) = (Memory::default(), Memory::default());
    let mut charges = Vec::new();
    for n in 0..200 {
        a.send(B, &[packet(n)]).unwrap();
        charges.push(at_b.take_packets(&b, 1)[0].2);
        b.send(A, &[packet(n)]).unwrap();
        charges.push(at_a.take_packets(&a, 1)[0].2);
    }
    charges.sort_unstable();
    assert!(charges[0] >= BOUND, "never less than declared");
    let median = charges[charges.len() / 2];
    assert!(median.0 <= BOUND.0 + 50_000, "median {median} us");
}
