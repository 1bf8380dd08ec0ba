//! Tests of injected faults.

use super::network::in_a_network;
use super::rig::{A, B, C, Memory, PATIENCE, link, packet, pair, table};
use imrs_protocol::Incarnation;
use imrs_runtime::link::faulty::{FaultyLink, Injected};
use imrs_runtime::link::udp::{UdpCount, UdpLink, UdpOptions};
use imrs_runtime::link::{Link, LinkBusy, PollEnd};
use imrs_wire::envelope::MAX_PACKETS;
use std::net::Ipv4Addr;
use std::time::{Duration, Instant};

#[test]
fn the_same_seed_loses_the_same_sends() {
    let lost = |seed| {
        let (a, _b) = pair();
        let faulty = FaultyLink::new(a, seed);
        faulty.set_loss(0.2);
        let mut lost = Vec::new();
        for n in 0..500 {
            let before = faulty.injected().lost_packets;
            assert_eq!(faulty.send(B, &[packet(n), packet(n)]), Ok(2));
            if faulty.injected().lost_packets != before {
                lost.push(n);
            }
        }
        assert_eq!(faulty.injected().lost_packets, 2 * lost.len() as u64, "a datagram is lost whole");
        assert_eq!(faulty.inner().count(UdpCount::DatagramsSent), 500 - lost.len() as u64);
        lost
    };
    let first = lost(1);
    assert!((60..140).contains(&first.len()), "{} of 500", first.len());
    assert_eq!(lost(1), first);
    assert_ne!(lost(2), first);
}

/// Datagrams that leave in one call can be lost one by one, as if each had left in a call of its own.
#[test]
fn each_datagram_of_a_call_is_lost_by_itself() {
    const CALLS: u64 = 50;
    let (a, _b) = pair();
    let faulty = FaultyLink::new(a, 3);
    faulty.set_loss(0.5);
    let packets: Vec<_> = (0..4 * MAX_PACKETS as u32).map(packet).collect();
    let (mut taken, mut in_part) = (0, 0);
    for _ in 0..CALLS {
        let before = faulty.injected().lost_packets;
        let now = faulty.send(B, &packets).unwrap() as u64;
        let lost = faulty.injected().lost_packets - before;
        assert!(lost.is_multiple_of(MAX_PACKETS as u64), "{lost}: a datagram is lost whole");
        taken += now;
        in_part += u64::from(lost > 0 && lost < now);
    }
    assert_eq!(faulty.inner().count(UdpCount::PacketsSent) + faulty.injected().lost_packets, taken);
    assert!(
        faulty.at_once() == MAX_PACKETS || in_part > CALLS / 4,
        "{in_part} of {CALLS} calls were lost in part"
    );
}

#[test]
fn a_cut_takes_everything_for_one_neighbour_until_it_ends() {
    let ((a, b), c) = (pair(), link(C));
    a.set_address(C, Some(c.local_address())).unwrap();
    let a = FaultyLink::new(a, 0);
    let first = |at| Memory::default().take_packets(at, 1)[0].1;
    a.set_cut(B, true);
    assert_eq!(a.send(B, &[packet(1)]), Ok(1));
    assert_eq!(a.injected(), Injected { lost_packets: 0, cut_packets: 1 });
    assert_eq!(a.send(C, &[packet(2)]), Ok(1));
    a.set_cut(B, false);
    assert_eq!(a.send(B, &[packet(3)]), Ok(1));
    assert_eq!((first(&b), first(&c)), (packet(3), packet(2)));
}

#[test]
fn a_cut_can_be_planned() {
    let (a, b) = pair();
    a.set_address(C, Some(b.local_address())).unwrap();
    let (a, memory) = (FaultyLink::new(a, 0), Memory::default());
    let (now, hour) = (Instant::now(), Duration::from_secs(3_600));
    a.cut_during(B, now + hour..now + 2 * hour);
    a.cut_during(B, now - Duration::from_millis(1)..now);
    a.cut_during(C, now..now + hour);
    for n in 0..5 {
        assert_eq!(a.send(B, &[packet(n)]), Ok(1), "not yet, and no longer");
        assert_eq!(a.send(C, &[packet(n)]), Ok(1));
    }
    assert_eq!(a.injected(), Injected { lost_packets: 0, cut_packets: 5 });
    assert_eq!(memory.take_packets(&b, 5).len(), 5);
    // A cut that was set for a short span ends by itself.
    let start = Instant::now();
    a.cut_during(B, start..start + Duration::from_millis(20));
    let sent = a.inner().count(UdpCount::PacketsSent);
    while a.inner().count(UdpCount::PacketsSent) == sent {
        a.send(B, &[packet(9)]).unwrap();
    }
    assert!(start.elapsed() >= Duration::from_millis(20));
}

#[test]
fn what_the_link_would_not_take_is_not_lost() {
    let a = FaultyLink::new(link(A), 0);
    a.set_loss(1.0);
    assert!(!a.ready(B));
    assert_eq!(a.send(B, &[packet(1)]), Err(LinkBusy));
    assert_eq!(a.injected(), Injected::default());
}

/// The commands for a network that has only `lo`, and an Ethernet without any other host.
const EMPTY_ETHERNET: [&str; 5] = [
    "link set lo up",
    "link add here type veth peer name there",
    "addr add 10.99.0.1/24 dev here",
    "link set here up",
    "link set there up",
];

/// While the kernel looks for a host that does not answer, it keeps the datagrams for that host, and counts them
/// against the sending socket.
#[test]
fn a_host_that_is_gone_holds_up_nobody_else() {
    in_a_network(&EMPTY_ETHERNET, || {
        let options = UdpOptions::new(Incarnation(1), false);
        let a = UdpLink::bind(table(A), (Ipv4Addr::UNSPECIFIED, 0).into(), options).unwrap();
        let b = link(B);
        a.set_address(B, Some(b.local_address())).unwrap();
        a.set_address(C, Some((Ipv4Addr::new(10, 99, 0, 9), 4_000).into())).unwrap();
        let full: Vec<_> = (0..40).map(packet).collect();
        let held = (0..10_000).take_while(|_| a.send(C, &full).is_ok()).count();
        assert!(held < 10_000, "the kernel takes everything");
        assert!(!a.ready(C) && a.ready(B), "one neighbour is not all");
        let memory = Memory::default();
        for n in 0..100 {
            assert_eq!(a.send(B, &[packet(n)]), Ok(1));
            assert_eq!(memory.take_packets(&b, 1)[0].1, packet(n));
        }
        // In the end the kernel gives up on the host.
        let end = Instant::now() + PATIENCE;
        while !a.ready(C) {
            assert_eq!(a.poll(&memory, Some(end)), PollEnd::Ready, "it never does");
        }
    });
}
