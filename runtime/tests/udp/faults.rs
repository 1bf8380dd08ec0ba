//! Injected faults.

use crate::rig::{A, B, C, Memory, link, packet, pair};
use imrs_runtime::link::faulty::{FaultyLink, Injected};
use imrs_runtime::link::udp::UdpCount;
use imrs_runtime::link::{Link, LinkBusy};
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
    // A short one ends by itself.
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
