//! Tests that old packets are charged for their age (D20, D50).

use super::rig::{
    A, B, BOUND, Memory, PATIENCE, QUEUED, cell, encoded, envelope, link, packet, pair, raw_socket, sealed,
};
use imrs_protocol::Incarnation;
use imrs_runtime::link::Link;
use imrs_runtime::link::udp::UdpCount;
use imrs_runtime::{Runtime, TaskEnd};
use imrs_wire::envelope::MAX_PACKETS;
use std::sync::Arc;
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
    let begin = Instant::now();
    a.send(B, &[packet(1)]).unwrap();
    thread::sleep(LONG);
    let (_, _, charge) = memory.take_packets(&b, 1)[0];
    let most = begin.elapsed();
    assert!(charge.0 >= micros(LONG) + BOUND.0, "{charge} us for a wait of {LONG:?}");
    // The time by the kernel's stamp lies between the two bounds, however long the machine took for the other work.
    assert!(charge.0 <= micros(most) + BOUND.0 + 100_000, "{charge} us for a wait of at most {most:?}");
    assert_eq!(b.count(UdpCount::NoStamp), 0, "the kernel gives stamps");
}

/// At the first datagram the receiver does not know the sender's clock, so only the kernel's stamp shows how long the
/// datagram waited.
#[test]
fn the_stamp_alone_tells_how_long_each_datagram_waited() {
    let (a, b) = (link(A), link(B));
    a.set_address(B, Some(b.local_address())).unwrap();
    a.send(B, &[packet(1)]).unwrap();
    thread::sleep(LONG);
    let second = Instant::now();
    a.send(B, &[packet(2)]).unwrap();
    let charges: Vec<_> = Memory::default().take_packets(&b, 2).iter().map(|p| p.2.0).collect();
    let most = second.elapsed();
    assert!(charges[0] >= micros(LONG) + BOUND.0, "{charges:?}");
    assert!(charges[1] >= BOUND.0, "{charges:?}");
    // The second datagram is not charged for the time for which the first one waited, however long the machine took to
    // receive both.
    assert!(charges[1] <= micros(most) + BOUND.0 + 100_000, "{charges:?}, the second within {most:?}");
}

#[test]
fn a_sender_stopped_between_its_clock_and_the_socket_is_charged() {
    let (a, b) = pair();
    let (at_a, at_b) = (Memory::default(), Memory::default());
    // B learns the clock of A by a round trip.
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

/// A stopped sender without any echo: B never sends, so it does not learn A's clock.
#[test]
fn a_stopped_sender_is_charged_without_a_round_trip_too() {
    let (a, b) = (link(A), link(B));
    a.set_address(B, Some(b.local_address())).unwrap();
    let memory = Memory::default();
    let begin = Instant::now();
    a.send(B, &[packet(1)]).unwrap();
    memory.take_packets(&b, 1);
    // Without an echo, the fastest datagram is assumed to have kept the declared bound. So far there is one datagram,
    // which took at most this long.
    let first = begin.elapsed();
    let read = Instant::now();
    thread::sleep(LONG);
    a.send_at(B, &[packet(2)], read).unwrap();
    let (_, _, charge) = memory.take_packets(&b, 1)[0];
    assert!(charge.0 + micros(first) >= micros(LONG), "{charge} us, where the first took {first:?}");
}

/// Without any fault, the charge is the declared bound and the time that this machine needs for a loopback round trip.
#[test]
fn a_quick_round_trip_costs_little_more_than_the_declared_bound() {
    let (a, b) = pair();
    let (at_a, at_b) = (Memory::default(), Memory::default());
    let (mut charges, mut trips) = (Vec::new(), Vec::new());
    for n in 0..200 {
        let begin = Instant::now();
        a.send(B, &[packet(n)]).unwrap();
        charges.push(at_b.take_packets(&b, 1)[0].2);
        b.send(A, &[packet(n)]).unwrap();
        charges.push(at_a.take_packets(&a, 1)[0].2);
        trips.push(begin.elapsed());
    }
    charges.sort_unstable();
    trips.sort_unstable();
    assert!(charges[0] >= BOUND, "never less than declared");
    let (median, trip) = (charges[charges.len() / 2], trips[trips.len() / 2]);
    assert!(median.0 <= BOUND.0 + micros(trip) + 50_000, "median {median} us, of a round trip {trip:?}");
}

/// All packets of one datagram have one instant and one charge. Otherwise a later message would count as older, and go
/// first, if the clock advanced between two packets.
#[test]
fn what_came_together_is_taken_in_the_order_in_which_it_was_sent() {
    const DATAGRAMS: u32 = 50;
    let b = Arc::new(link(B));
    let (to, socket) = (b.local_address(), raw_socket());
    let (together, most) = (MAX_PACKETS as u32, u32::from(QUEUED));
    assert!(together <= most, "all of a datagram have room");
    let node = Runtime::builder(cell("udp"), B).incarnation(Incarnation(1), false).link(b);
    let node = node.task("y", move |ctx| {
        for datagram in 0..DATAGRAMS {
            let packets: Vec<_> = (0..together).map(|n| encoded(datagram * together + n)).collect();
            socket.send_to(&sealed(&envelope(u64::from(datagram)), &packets), to).expect("sent");
            // This delay makes the messages wait for the task, and not the task for the messages.
            ctx.delay(Duration::from_millis(2))?;
            for n in 0..together {
                let message = ctx.receive(None, Some(PATIENCE))?.expect("nothing is lost");
                assert_eq!(message.from.id.sequence.get(), datagram * together + n);
            }
        }
        Ok(())
    });
    let node = node.start().expect("a node that starts");
    assert!(node.wait(PATIENCE));
    assert_eq!(node.stop(PATIENCE), [("y".to_owned(), TaskEnd::Returned)]);
}
