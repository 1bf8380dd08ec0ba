//! Tests of datagrams that leave in one call of the kernel, and of datagrams that arrive in one call (D129).

use super::network::{in_a_network, ip, skip};
use super::rig::{
    A, B, BOUND, C, Memory, PATIENCE, QUEUED, cell, digests, encoded, envelope, envelope_of, introduced,
    link, packet, pair, plain, raw_socket, sealed,
};
use imrs_protocol::{Incarnation, NodeId, Packet, PortId, TaskId, Ticks};
use imrs_runtime::link::udp::{UdpCount, UdpLink};
use imrs_runtime::link::{Came, Link, LinkDiscard, PollEnd};
use imrs_runtime::protocol::Target;
use imrs_runtime::{Runtime, TaskEnd};
use imrs_wire::envelope::{self, Envelope, MAX_DATAGRAM_BYTES, MAX_PACKETS};
use nix::sys::socket::{setsockopt, sockopt};
use std::net::UdpSocket;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Enough packets for three datagrams and a part of the fourth.
const SEVERAL: u32 = 3 * MAX_PACKETS as u32 + 20;

/// Whether the kernel cuts and merges datagrams. This asks the kernel itself, not the link. If the kernel does not, the
/// test is skipped with a message; with `IMRS_REQUIRE_ALL=1` it fails.
fn cuts(link: &UdpLink) -> bool {
    let socket = raw_socket();
    let cuts = setsockopt(&socket, sockopt::UdpGsoSegment, &0).is_ok()
        && setsockopt(&socket, sockopt::UdpGroSegment, &true).is_ok();
    assert!(!cuts || link.at_once() >= SEVERAL as usize, "the kernel can, and the link does not");
    if !cuts {
        skip("the kernel knows no UDP_SEGMENT and UDP_GRO");
    }
    cuts
}

fn several() -> Vec<Packet> {
    (0..SEVERAL).map(packet).collect()
}

fn packets_of(got: &[(NodeId, Packet, Ticks)]) -> Vec<Packet> {
    got.iter().map(|got| got.1).collect()
}

/// A socket that cuts the data of a send into datagrams of this many bytes.
fn cutting(bytes: usize) -> UdpSocket {
    let socket = raw_socket();
    setsockopt(&socket, sockopt::UdpGsoSegment, &i32::try_from(bytes).unwrap()).expect("Linux 4.18");
    socket
}

#[test]
fn what_fills_several_datagrams_leaves_in_one_call_and_comes_in_one() {
    let (a, b) = pair();
    if !cuts(&a) {
        return;
    }
    let memory = Memory::default();
    assert_eq!(a.send(B, &several()), Ok(SEVERAL as usize));
    assert_eq!((a.count(UdpCount::DatagramsSent), a.count(UdpCount::PacketsSent)), (4, SEVERAL.into()));
    assert_eq!(a.count(UdpCount::SendsSaved), 3);
    let got = memory.take_packets(&b, SEVERAL as usize);
    assert_eq!(packets_of(&got), several(), "in order");
    assert!(got.iter().all(|of| (of.0, of.2) == (A, got[0].2)), "one charge for all");
    assert_eq!((b.count(UdpCount::DatagramsReceived), b.count(UdpCount::ReceivesSaved)), (4, 3));
    assert_eq!(b.count(UdpCount::NoStamp), 0, "all have the stamp of the first");
    assert!(memory.discards.lock().unwrap().is_empty());
    // A lone packet leaves in a datagram of its own, as always. Its counter follows the others, so no datagram counts
    // as a repetition.
    assert_eq!(a.send(B, &[packet(1)]), Ok(1));
    assert_eq!(memory.take_packets(&b, 1)[0].1, packet(1));
    assert_eq!(a.count(UdpCount::SendsSaved), 3);
}

/// Every datagram is complete in itself, so a receiver without merging can read it, and every network can carry it.
#[test]
fn a_socket_that_puts_nothing_together_gets_whole_datagrams() {
    let (a, b) = (link(A), raw_socket());
    if !cuts(&a) {
        return;
    }
    b.set_read_timeout(Some(PATIENCE)).unwrap();
    a.set_address(B, Some(b.local_addr().unwrap())).unwrap();
    assert_eq!(a.send(B, &several()), Ok(SEVERAL as usize));
    assert_eq!(a.send(B, &[packet(SEVERAL)]), Ok(1));
    let mut bytes = [0; 2 * MAX_DATAGRAM_BYTES];
    let mut next = 0;
    for (counter, count) in [MAX_PACKETS, MAX_PACKETS, MAX_PACKETS, 20, 1].into_iter().enumerate() {
        let length = b.recv(&mut bytes).unwrap();
        let (envelope, packets) = envelope::open(&bytes[..length], B, digests(), |node| node == A).unwrap();
        assert_eq!((envelope.counter, packets.len()), (counter as u64, count));
        for packet in packets {
            assert_eq!(*packet, encoded(next));
            next += 1;
        }
    }
    assert_eq!(a.count(UdpCount::SendsSaved), 3);
}

#[test]
fn a_link_that_may_not_segment_is_heard_by_one_that_puts_together_and_the_other_way_round() {
    for (a, b) in [introduced(plain(A), link(B)), introduced(link(A), plain(B))] {
        let (memory, packets) = (Memory::default(), several());
        let mut left = packets.as_slice();
        while !left.is_empty() {
            left = &left[a.send(B, left).unwrap()..];
        }
        assert_eq!(packets_of(&memory.take_packets(&b, packets.len())), packets);
        assert_eq!((a.count(UdpCount::DatagramsSent), b.count(UdpCount::DatagramsReceived)), (4, 4));
        assert_eq!(a.count(UdpCount::SendsSaved), if a.at_once() == MAX_PACKETS { 0 } else { 3 });
        assert_eq!(b.count(UdpCount::ReceivesSaved), 0);
    }
}

/// Packets that a thread sends together reach the link in one call, and each datagram begins with its most urgent
/// packet. The packets of the first datagram leave first nevertheless. Otherwise more than 63 packets could overtake a
/// message, and the receiver would drop it as an old copy (D75).
#[test]
fn what_is_said_together_leaves_in_one_call_the_most_urgent_of_each_datagram_first() {
    let (a, b) = (Arc::new(link(A)), link(B));
    if !cuts(&a) {
        return;
    }
    a.set_address(B, Some(b.local_address())).unwrap();
    // This poll takes the event that the neighbour's address is known. Otherwise the receiving thread could take the
    // event at any later time, and send waiting packets just then.
    assert_eq!(a.poll(&Memory::default(), None), PollEnd::Ready);
    let node = Runtime::builder(cell("udp"), A).incarnation(Incarnation(1), false).link(a.clone());
    let node = node.task("x", |ctx| {
        ctx.together(|ctx| {
            (0..SEVERAL).try_for_each(|number| {
                // The time_out must not be longer than the port's.
                let time_out = Some(Duration::from_millis(u64::from(60_000 + number * 59 % SEVERAL * 16)));
                ctx.send_with(PortId(0), Target::One(TaskId(1)), b"here", time_out).map(|_copies| ())
            })
        })
    });
    let node = node.start().expect("a node that starts");
    let got = Memory::default().take_packets(&b, SEVERAL as usize);
    assert_eq!(node.stop(PATIENCE), [("x".to_owned(), TaskEnd::Returned)]);
    for (datagram, got) in got.chunks(MAX_PACKETS).enumerate() {
        let remaining: Vec<_> = got.iter().map(|got| got.1.remaining).collect();
        assert!(remaining.is_sorted(), "{datagram}: {remaining:?}");
        let mut said: Vec<_> = got.iter().map(|got| got.1.id.sequence.get()).collect();
        assert!(!said.is_sorted(), "{datagram}: they were said in another order");
        said.sort_unstable();
        assert!(
            said.windows(2).all(|two| two[1] == two[0] + 1),
            "{datagram}: {said:?} were said one after another"
        );
    }
    assert_eq!((a.count(UdpCount::DatagramsSent), a.count(UdpCount::SendsSaved)), (4, 3));
}

/// The kernel gives a leader one event for several datagrams, and the leader must receive all of them.
#[test]
fn the_leader_takes_in_all_that_came_in_one() {
    let (a, b) = pair();
    if !cuts(&a) {
        return;
    }
    let (memory, leading) = (Memory::default(), b.leading().expect("a link to wait in"));
    a.send(B, &several()).unwrap();
    let end = Instant::now() + PATIENCE;
    while leading.wait(Some(PATIENCE)) != Came::Something {
        assert!(Instant::now() < end, "nothing came");
    }
    assert!(leading.take_in(&memory));
    assert_eq!(packets_of(&memory.packets.lock().unwrap()), several());
}

#[test]
fn of_what_came_in_one_only_what_is_wrong_is_dropped() {
    let (b, memory) = (link(B), Memory::default());
    if !cuts(&b) {
        return;
    }
    let datagram = |counter: u64| sealed(&envelope(counter), &[encoded(1), encoded(2)]);
    let mut all: Vec<Vec<u8>> = (0..6).map(datagram).collect();
    // The second datagram is damaged, the fourth is a repetition, the fifth is garbage, and the last is shorter.
    all[1][50] ^= 4;
    all[3] = datagram(0);
    all[4].fill(0xa5);
    all[5] = sealed(&envelope(5), &[encoded(3)]);
    cutting(all[0].len()).send_to(&all.concat(), b.local_address()).unwrap();
    let got = memory.take_packets(&b, 5);
    assert_eq!(packets_of(&got), [1, 2, 1, 2, 3].map(packet));
    let reasons = [LinkDiscard::Checksum, LinkDiscard::Replayed, LinkDiscard::NotImrs];
    assert_eq!(memory.take_discards(&b, 3), reasons);
    assert_eq!((b.count(UdpCount::DatagramsReceived), b.count(UdpCount::ReceivesSaved)), (6, 5));
    // The first two of these datagrams are longer than any envelope, and the last is too short.
    let mut long = sealed(&envelope(9), &[encoded(1); MAX_PACKETS]);
    long.push(0);
    let long = [long.as_slice(), &long, &long[..3]].concat();
    cutting(MAX_DATAGRAM_BYTES + 1).send_to(&long, b.local_address()).unwrap();
    let reasons = [LinkDiscard::Length, LinkDiscard::Length, LinkDiscard::TooShort];
    assert_eq!(memory.take_discards(&b, 3), reasons);
    assert_eq!(memory.delivered(), 0);
}

/// The link distinguishes datagrams of different neighbours and incarnations within one receive call.
#[test]
fn what_came_in_one_need_not_be_of_one() {
    let (b, memory) = (link(B), Memory::default());
    if !cuts(&b) {
        return;
    }
    let of = |sender: NodeId, incarnation: u8, counter: u64, number: u32| {
        sealed(&Envelope { sender, ..envelope_of(incarnation, counter) }, &[encoded(number)])
    };
    let all =
        [of(A, 1, 0, 1), of(A, 1, 1, 2), of(C, 1, 0, 3), of(A, 2, 0, 4), of(A, 1, 2, 5), of(C, 1, 1, 6)];
    cutting(all[0].len()).send_to(&all.concat(), b.local_address()).unwrap();
    let got: Vec<_> = memory.take_packets(&b, 5).iter().map(|got| (got.0, got.1)).collect();
    assert_eq!(got, [(A, 1), (A, 2), (C, 3), (A, 4), (C, 6)].map(|(node, number)| (node, packet(number))));
    assert_eq!(memory.take_discards(&b, 1), [LinkDiscard::StaleIncarnation]);
    let lives = [(A, Incarnation(1), false), (C, Incarnation(1), false), (A, Incarnation(2), true)];
    assert_eq!(*memory.peers.lock().unwrap(), lives);
    assert_eq!(b.count(UdpCount::ReceivesSaved), 5);
}

/// Datagrams that a neighbour sent in one call, and that arrive in one call, share one charge and one instant. Otherwise, if
/// the clock advanced between two of them, the packets of the later datagram would count as older, and could be taken first.
#[test]
fn what_came_in_one_is_taken_in_the_order_in_which_it_was_sent() {
    const TIMES: u32 = 50;
    const SEGMENTS: u32 = 8;
    let b = Arc::new(link(B));
    if !cuts(&b) {
        return;
    }
    let (each, to) = (u32::from(QUEUED) / SEGMENTS, b.local_address());
    let merged = Arc::clone(&b);
    let node = Runtime::builder(cell("udp"), B).incarnation(Incarnation(1), false).link(b);
    let node = node.task("y", move |ctx| {
        for time in 0..TIMES {
            let datagram = |segment: u32| {
                let number = time * SEGMENTS + segment;
                let packets: Vec<_> = (0..each).map(|n| encoded(number * each + n)).collect();
                let tx_mono = 1_000_000 + u64::from(time);
                sealed(&Envelope { tx_mono, ..envelope(number.into()) }, &packets)
            };
            let all: Vec<_> = (0..SEGMENTS).map(datagram).collect();
            cutting(all[0].len()).send_to(&all.concat(), to).expect("sent");
            // This delay makes the messages wait for the task, and not the task for the messages.
            ctx.delay(Duration::from_millis(2))?;
            for n in 0..u32::from(QUEUED) {
                let message = ctx.receive(None, Some(PATIENCE))?.expect("nothing is lost");
                assert_eq!(message.from.id.sequence.get(), time * u32::from(QUEUED) + n);
            }
        }
        Ok(())
    });
    let node = node.start().expect("a node that starts");
    assert!(node.wait(PATIENCE));
    assert_eq!(node.stop(PATIENCE), [("y".to_owned(), TaskEnd::Returned)]);
    assert_eq!(merged.count(UdpCount::ReceivesSaved), u64::from(TIMES * (SEGMENTS - 1)));
}

#[test]
fn what_waited_in_one_is_charged_as_the_first_of_it() {
    let (a, b) = (link(A), link(B));
    if !cuts(&a) {
        return;
    }
    a.set_address(B, Some(b.local_address())).unwrap();
    a.send(B, &several()).unwrap();
    let wait = Duration::from_millis(200);
    std::thread::sleep(wait);
    let got = Memory::default().take_packets(&b, SEVERAL as usize);
    assert!(got.iter().all(|got| u128::from(got.2.0 - BOUND.0) >= wait.as_micros()), "{:?}", got[0].2);
}

/// If a network takes no full datagram in one piece, the kernel refuses to cut a send, and takes each datagram by itself.
#[test]
fn where_the_kernel_refuses_to_cut_each_datagram_leaves_by_itself() {
    in_a_network(&["link set lo mtu 1280", "link set lo up"], || {
        let (a, b) = pair();
        if !cuts(&a) {
            return;
        }
        let memory = Memory::default();
        for _ in 0..3 {
            assert_eq!(a.send(B, &several()), Ok(SEVERAL as usize));
            assert_eq!(packets_of(&memory.take_packets(&b, SEVERAL as usize)), several());
        }
        let counts = [UdpCount::DatagramsSent, UdpCount::SendsSaved, UdpCount::SegmentsRefused];
        assert_eq!(counts.map(|of| a.count(of)), [12, 0, 1]);
        assert!(a.failures().iter().all(|(_, count)| *count == 0), "{:?}", a.failures());
        assert!(a.evidence().contains(&(UdpCount::SegmentsRefused.name(), 1)));
        assert!(memory.discards.lock().unwrap().is_empty(), "none came twice");
    });
}

/// The kernel was asked to cut the sends of this socket, and then the network changes. Some kernels then refuse even a
/// send that fits into one datagram.
#[test]
fn where_the_kernel_no_longer_cuts_a_lone_datagram_still_leaves() {
    in_a_network(&["link set lo up"], || {
        let (a, b) = pair();
        if !cuts(&a) {
            return;
        }
        let memory = Memory::default();
        let send = |count: u32| {
            let packets: Vec<_> = (0..count).map(packet).collect();
            assert_eq!(a.send(B, &packets), Ok(packets.len()));
            assert_eq!(packets_of(&memory.take_packets(&b, packets.len())), packets);
            [UdpCount::SendsSaved, UdpCount::SegmentsRefused].map(|of| a.count(of))
        };
        assert_eq!(send(SEVERAL), [3, 0]);
        assert!(ip("link set lo mtu 1280"));
        assert!([send(1), send(1)].iter().all(|[saved, refused]| *saved == 3 && *refused <= 1));
        assert_eq!(send(SEVERAL), [3, 1]);
        assert!(ip("link set lo mtu 65536"));
        assert_eq!(send(SEVERAL), [3, 1], "until the neighbour's address is said again");
        a.set_address(B, Some(b.local_address())).unwrap();
        assert_eq!(send(SEVERAL), [6, 1]);
        assert!(memory.discards.lock().unwrap().is_empty());
    });
}
