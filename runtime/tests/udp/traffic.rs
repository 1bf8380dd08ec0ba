//! Tests of sending, coalescing, waiting, restarts and network errors.

use super::rig::{A, B, C, Memory, PATIENCE, any_port, link, packet, pair, raw_socket, started, table};
use imrs_protocol::{Contents, Incarnation, NodeId, Packet, PacketError, Ticks};
use imrs_runtime::link::udp::{NotANeighbour, UdpCount, UdpError, UdpLink, UdpOptions};
use imrs_runtime::link::{Link, LinkBusy, LinkDiscard, PollEnd};
use std::net::{Ipv4Addr, UdpSocket};
use std::thread;
use std::time::{Duration, Instant};

#[test]
fn packets_arrive_as_they_were_sent() {
    let (a, b) = pair();
    let memory = Memory::default();
    assert_eq!(a.send(B, &[packet(1)]), Ok(1));
    let got = memory.take_packets(&b, 1);
    assert_eq!((got[0].0, got[0].1), (A, packet(1)));
    assert_eq!(*memory.peers.lock().unwrap(), [(A, Incarnation(1), false)]);
    assert!(memory.discards.lock().unwrap().is_empty());
}

/// Node A sends a packet to B, which forwards its copy of the packet to C. A bit of the copy flips in B's memory.
#[test]
fn what_falls_over_in_a_relay_is_turned_away_where_the_packet_ends() {
    let ((a, b), c) = (pair(), link(C));
    b.set_address(C, Some(c.local_address())).unwrap();
    let (relay, memory) = (Memory::default(), Memory::default());
    assert_eq!(a.send(B, &[packet(1)]), Ok(1));
    let came = relay.take_packets(&b, 1)[0].1;
    let relayed = Packet { hops: came.hops - 1, remaining: came.remaining - Ticks(100), ..came };
    assert_eq!(b.send(C, &[relayed]), Ok(1));
    assert_eq!(memory.take_packets(&c, 1)[0].1.contents, packet(1).contents);
    let damaged = Packet { contents: Contents::new(b"hare").unwrap(), ..relayed };
    assert_eq!(b.send(C, &[damaged]), Ok(1));
    assert_eq!(memory.take_discards(&c, 1), [LinkDiscard::Packet(PacketError::Checksum)]);
}

#[test]
fn what_is_queued_leaves_in_one_datagram() {
    let (a, b) = pair();
    let memory = Memory::default();
    let packets: Vec<_> = (0..100).map(packet).collect();
    let mut left = packets.as_slice();
    while !left.is_empty() {
        let taken = a.send(B, left).unwrap();
        left = &left[taken..];
    }
    assert_eq!((a.count(UdpCount::DatagramsSent), a.count(UdpCount::PacketsSent)), (3, 100));
    let got = memory.take_packets(&b, 100);
    assert!(got.iter().map(|p| p.1).eq(packets), "in order");
    assert_eq!((b.count(UdpCount::DatagramsReceived), b.count(UdpCount::PacketsReceived)), (3, 100));
    assert_eq!(a.send(B, &[packet(1)]), Ok(1), "a lone packet leaves at once");
    assert_eq!(memory.take_packets(&b, 1).len(), 1);
}

#[test]
fn a_neighbour_without_an_address_is_not_ready() {
    let (a, b) = (link(A), link(B));
    assert!(!a.ready(B) && !a.ready(NodeId(9)) && !a.ready(A));
    assert_eq!(a.send(B, &[packet(1)]), Err(LinkBusy));
    assert_eq!(a.set_address(NodeId(3), None), Err(NotANeighbour(NodeId(3))), "no link is declared");
    a.set_address(B, Some(b.local_address())).unwrap();
    assert!(a.ready(B) && !a.ready(C));
    assert_eq!(a.poll(&Memory::default(), None), PollEnd::Ready, "a poll ends when packets can leave");
    assert_eq!(a.send(B, &[packet(1)]), Ok(1));
}

/// Only the neighbour's socket that is connected to this node gets the datagram (D155).
#[test]
fn datagrams_leave_from_the_address_that_receives() {
    for any in ["127.0.0.1:0", "0.0.0.0:0"] {
        let options = UdpOptions::new(Incarnation(1), false);
        let a = UdpLink::bind(table(A), any.parse().unwrap(), options).unwrap();
        let other = raw_socket();
        other.set_read_timeout(Some(PATIENCE)).unwrap();
        a.set_address(B, Some(other.local_addr().unwrap())).unwrap();
        assert_eq!(a.send(B, &[packet(1)]), Ok(1));
        let (_, from) = other.recv_from(&mut [0; 2_000]).unwrap();
        assert_eq!(from.port(), a.local_address().port(), "{any}");
    }
}

#[test]
fn what_waits_in_a_neighbours_socket_outlasts_its_address() {
    let (a, b) = pair();
    let memory = Memory::default();
    for (number, address) in [(1, None), (2, Some(a.local_address())), (3, Some(a.local_address()))] {
        assert_eq!(a.send(B, &[packet(number)]), Ok(1));
        b.set_address(A, address).unwrap();
        assert_eq!(memory.take_packets(&b, 1)[0].1, packet(number));
    }
}

/// The address book has an outdated address of the neighbour, or none at all.
#[test]
fn a_neighbour_at_another_address_is_heard_and_answered_at_the_known_one() {
    let (a, b) = pair();
    let (at_a, at_b) = (Memory::default(), Memory::default());
    let elsewhere = raw_socket();
    b.set_address(A, Some(elsewhere.local_addr().unwrap())).unwrap();
    assert_eq!(a.send(B, &[packet(1)]), Ok(1));
    assert_eq!(at_b.take_packets(&b, 1)[0].1, packet(1));
    b.set_address(A, Some(a.local_address())).unwrap();
    assert_eq!(a.send(B, &[packet(2)]), Ok(1));
    assert_eq!(at_b.take_packets(&b, 1)[0].1, packet(2));
    assert_eq!(b.send(A, &[packet(3)]), Ok(1));
    assert_eq!(at_a.take_packets(&a, 1)[0].1, packet(3));
}

#[test]
fn a_wake_ends_the_present_or_the_next_poll() {
    let b = link(B);
    let memory = Memory::default();
    b.wake();
    assert_eq!(b.poll(&memory, None), PollEnd::Woken);
    thread::scope(|s| {
        let polls: Vec<_> = (0..3).map(|_| s.spawn(|| b.poll(&memory, None))).collect();
        // A wake-up ends all polls that have begun. If none has, the wake-up ends the next poll.
        let end = Instant::now() + PATIENCE;
        while !polls.iter().all(thread::ScopedJoinHandle::is_finished) {
            assert!(Instant::now() < end);
            b.wake();
            thread::sleep(Duration::from_millis(1));
        }
        for poll in polls {
            assert_eq!(poll.join().unwrap(), PollEnd::Woken);
        }
    });
}

#[test]
fn an_address_and_a_wake_end_a_poll_each() {
    let (a, b) = (link(A), link(B));
    a.set_address(B, Some(b.local_address())).unwrap();
    a.wake();
    let memory = Memory::default();
    let until = Some(Instant::now() + PATIENCE);
    let ends = [a.poll(&memory, until), a.poll(&memory, until)];
    assert!(ends.contains(&PollEnd::Ready) && ends.contains(&PollEnd::Woken), "{ends:?}");
}

#[test]
fn polls_time_out_never_early() {
    let b = link(B);
    let memory = Memory::default();
    for micros in [0, 1, 900, 1_100, 20_000] {
        let until = Instant::now() + Duration::from_micros(micros);
        assert_eq!(b.poll(&memory, Some(until)), PollEnd::TimedOut);
        assert!(Instant::now() >= until, "{micros} us");
    }
    // Polls that wait for their turn keep their own deadlines.
    thread::scope(|s| {
        let polls: Vec<_> = [15, 30, 45]
            .into_iter()
            .map(|millis| {
                let until = Instant::now() + Duration::from_millis(millis);
                let (b, memory) = (&b, &memory);
                s.spawn(move || (b.poll(memory, Some(until)), Instant::now() >= until))
            })
            .collect();
        for poll in polls {
            assert_eq!(poll.join().unwrap(), (PollEnd::TimedOut, true));
        }
    });
}

#[test]
fn whoever_waits_takes_over_the_socket() {
    let (a, b) = pair();
    let memory = Memory::default();
    thread::scope(|s| {
        let poll = || loop {
            let end = b.poll(&memory, Some(Instant::now() + PATIENCE));
            // `Ready` only reports that a neighbour got an address, so this polls again.
            if end != PollEnd::Ready {
                return end;
            }
        };
        let polls: Vec<_> = (0..3).map(|_| s.spawn(poll)).collect();
        for n in 0..3 {
            a.send(B, &[packet(n)]).unwrap();
            let end = Instant::now() + PATIENCE;
            while memory.delivered() <= n as usize && polls.iter().any(|p| !p.is_finished()) {
                assert!(Instant::now() < end);
                thread::yield_now();
            }
        }
        // A later wake-up ends a poll that has not begun yet.
        let end = Instant::now() + PATIENCE;
        while !polls.iter().all(thread::ScopedJoinHandle::is_finished) {
            assert!(Instant::now() < end);
            b.wake();
            thread::sleep(Duration::from_millis(1));
        }
        for poll in polls {
            assert!(matches!(poll.join().unwrap(), PollEnd::Received | PollEnd::Woken));
        }
    });
    assert_eq!(memory.delivered(), 3);
}

#[test]
fn a_restart_is_announced_and_what_is_left_of_the_old_incarnation_dropped() {
    let (a, b) = pair();
    let memory = Memory::default();
    a.send(B, &[packet(1)]).unwrap();
    memory.take_packets(&b, 1);
    let again = started(A, 2, true);
    again.set_address(B, Some(b.local_address())).unwrap();
    // The new incarnation has another address, which the address book gives.
    b.set_address(A, Some(again.local_address())).unwrap();
    again.greet();
    memory.poll_until(&b, |_| b.count(UdpCount::GreetingsReceived) == 1);
    Memory::default().poll_until(&again, |_| again.count(UdpCount::GreetingsReceived) == 1);
    again.send(B, &[packet(2)]).unwrap();
    assert_eq!(memory.take_packets(&b, 1)[0].1, packet(2));
    a.send(B, &[packet(3)]).unwrap();
    assert_eq!(memory.take_discards(&b, 1)[0].name(), "stale_incarnation");
    assert_eq!(*memory.peers.lock().unwrap(), [(A, Incarnation(1), false), (A, Incarnation(2), true)]);
    assert_eq!(b.count(UdpCount::NewIncarnations), 2);
    b.send(A, &[packet(4)]).unwrap();
    assert_eq!(Memory::default().take_packets(&again, 1)[0].1, packet(4));
}

#[test]
fn a_node_says_itself_that_it_restarted() {
    let (again, b) = (started(A, 9, true), link(B));
    again.set_address(B, Some(b.local_address())).unwrap();
    again.send(B, &[packet(1)]).unwrap();
    let memory = Memory::default();
    memory.take_packets(&b, 1);
    assert_eq!(
        *memory.peers.lock().unwrap(),
        [(A, Incarnation(9), true)],
        "though this is the first contact"
    );
}

#[test]
fn errors_of_the_network_are_counted_and_survived() {
    let (a, b) = pair();
    let memory = Memory::default();
    // The address and the port belong to this test alone, so that no other process takes the port meanwhile.
    let [.., high, low] = std::process::id().to_be_bytes();
    let own = UdpSocket::bind((Ipv4Addr::new(127, 77, high, low), 0)).unwrap();
    let gone = own.local_addr().unwrap();
    drop(own);
    a.set_address(C, Some(gone)).unwrap();
    for n in 0..20 {
        assert_eq!(a.send(C, &[packet(n)]), Ok(1), "nobody is there, which only the counters need to know");
    }
    // The kernel reports the error of a datagram when the next datagram is sent.
    assert!(a.count(UdpCount::SendRefused) > 0);
    // Once there is a socket at the address again, no datagram is lost because of an earlier error.
    let back = UdpLink::bind(table(C), gone, UdpOptions::new(Incarnation(1), false)).unwrap();
    assert_eq!(a.send(C, &[packet(20)]), Ok(1));
    assert_eq!(memory.take_packets(&back, 1)[0].1, packet(20));
    // An address of another family cannot be reached from this socket.
    a.set_address(C, Some("[::1]:9".parse().unwrap())).unwrap();
    assert_eq!(a.send(C, &[packet(1)]), Ok(1));
    assert_eq!(a.count(UdpCount::SendFailed), 1);
    b.send(A, &[packet(7)]).unwrap();
    assert_eq!(memory.take_packets(&a, 1)[0].1, packet(7));
}

#[test]
fn what_the_kernel_drops_is_counted() {
    let a = link(A);
    let options = UdpOptions { queue_bytes: 4_096, ..UdpOptions::new(Incarnation(1), false) };
    let b = UdpLink::bind(table(B), any_port(), options).unwrap();
    a.set_address(B, Some(b.local_address())).unwrap();
    for n in 0..200 {
        a.send(B, &[packet(n)]).unwrap();
    }
    let memory = Memory::default();
    // The kernel reports drops with the next datagram that arrives after them.
    while b.count(UdpCount::KernelDropped) == 0 {
        assert_eq!(b.poll(&memory, Some(Instant::now() + PATIENCE)), PollEnd::Received);
        a.send(B, &[packet(200)]).unwrap();
    }
    assert!(b.count(UdpCount::KernelDropped) < 200);
    let names: Vec<_> = b.counts().map(|(name, _)| name).collect();
    assert!(names.contains(&"kernel_dropped") && names.len() == UdpCount::ALL.len());
}

#[test]
fn an_address_that_is_taken_is_named() {
    let taken = raw_socket();
    let address = taken.local_addr().unwrap();
    let error =
        UdpLink::bind(table(A), address, UdpOptions::new(Incarnation(1), false)).map(|_| ()).unwrap_err();
    assert!(matches!(&error, UdpError::Bind { address: at, .. } if *at == address), "{error}");
}
