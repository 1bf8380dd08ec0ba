//! A flood of datagrams at a node's port costs its neighbours nothing: each has a socket of its own (D155).

use super::rig::{
    A, B, C, Memory, PATIENCE, cell, digests, encoded, envelope_of, link, packet, pair, raw_socket, sealed,
    sealed_for,
};
use imrs_protocol::{Incarnation, NodeId, Packet, Ticks};
use imrs_runtime::link::udp::{UdpCount, UdpLink};
use imrs_runtime::link::{Link, LinkDiscard, PollEnd, Sink};
use imrs_wire::envelope::{Digests, Envelope};
use std::net::SocketAddr;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// More than any socket here holds.
const FILLS_A_SOCKET: usize = 5_000;
/// How many datagrams the flooder sends while the neighbour is heard.
const FLOOD: usize = 200_000;
/// So many of the neighbour's datagrams fit its socket while nobody receives.
const UNDER_WAY: usize = 100;

/// Garbage of several lengths, and what looks like a datagram of this cell.
fn thrown() -> Vec<Vec<u8>> {
    let other = Digests { cell: cell("another cell").digest(), ..digests() };
    let stranger = Envelope { sender: NodeId(9), ..envelope_of(1, 0) };
    let mut damaged = sealed(&envelope_of(1, 7), &[encoded(1)]);
    damaged[70] ^= 1;
    vec![
        vec![0xa5; 3],
        vec![0x5a; 700],
        damaged,
        sealed(&stranger, &[encoded(2)]),
        sealed_for(other, &envelope_of(1, 9), &[encoded(3)]),
        // In the name of the neighbour, of a session that is not its own.
        sealed(&envelope_of(3, 11), &[encoded(4)]),
    ]
}

/// Sends so many datagrams as fast as they leave.
fn flood(to: SocketAddr, count: usize) {
    let (socket, thrown) = (raw_socket(), thrown());
    for number in 0..count {
        // The kernel may say that it has no room: then the flood is as fast as can be.
        let _ = socket.send_to(&thrown[number % thrown.len()], to);
    }
}

/// Remembers the numbers of the neighbour's packets, in the order in which they came.
#[derive(Default)]
struct Heard {
    numbers: Mutex<Vec<u32>>,
    count: AtomicUsize,
}

impl Sink for Heard {
    fn packets(&self, from: NodeId, packets: &[Packet], _charge: Ticks, _at: Instant) {
        assert_eq!(from, A);
        self.numbers.lock().unwrap().extend(packets.iter().map(|packet| packet.id.sequence.get()));
        self.count.fetch_add(packets.len(), Ordering::Release);
    }

    fn peer(&self, _node: NodeId, _incarnation: Incarnation, _restarted: bool) {}

    fn discarded(&self, _reason: LinkDiscard) {}
}

/// What the kernel dropped on each socket of a port: those that are connected, and those that are not.
fn drops(port: u16) -> (Vec<u64>, Vec<u64>) {
    let table = std::fs::read_to_string("/proc/thread-self/net/udp").expect("the sockets of this network");
    let (mut connected, mut others) = (Vec::new(), Vec::new());
    for line in table.lines().skip(1) {
        let fields: Vec<_> = line.split_whitespace().collect();
        if fields[1].ends_with(&format!(":{port:04X}")) {
            let of = if fields[2].ends_with(":0000") { &mut others } else { &mut connected };
            of.push(fields.last().expect("a line has fields").parse().expect("a count"));
        }
    }
    (connected, others)
}

/// Each has heard the other.
fn acquainted() -> (UdpLink, UdpLink) {
    let (a, b) = pair();
    for (from, to, node) in [(&a, &b, B), (&b, &a, A), (&a, &b, B)] {
        from.send(node, &[packet(0)]).unwrap();
        Memory::default().take_packets(to, 1);
    }
    (a, b)
}

/// Sends while the flood lasts, and never more than fit the socket. Returns how many.
fn speaks(a: &UdpLink, heard: &Heard, floods: impl Fn() -> bool) -> u32 {
    let mut sent = 0;
    while floods() {
        if (sent as usize).saturating_sub(heard.count.load(Ordering::Acquire)) < UNDER_WAY {
            sent += 1;
            assert_eq!(a.send(B, &[packet(sent)]), Ok(1));
        } else {
            thread::yield_now();
        }
    }
    sent
}

#[test]
fn a_flood_from_elsewhere_loses_nothing_of_a_neighbour() {
    let (a, b) = acquainted();
    let (to, heard) = (b.local_address(), Heard::default());
    let silent = raw_socket();
    b.set_address(C, Some(silent.local_addr().unwrap())).unwrap();
    // Nobody receives: what is thrown fills whatever socket it comes to, and then the neighbour speaks.
    flood(to, FILLS_A_SOCKET);
    let first = UNDER_WAY as u32 / 2;
    (1..=first).for_each(|number| assert_eq!(a.send(B, &[packet(number)]), Ok(1)));
    let stop = AtomicBool::new(false);
    let last = thread::scope(|scope| {
        let flooding = scope.spawn(|| flood(to, FLOOD));
        let polling = scope.spawn(|| {
            while !stop.load(Ordering::Acquire) {
                b.poll(&heard, Some(Instant::now() + PATIENCE));
            }
        });
        let sent = speaks(&a, &heard, || !flooding.is_finished());
        // The last is said until it is heard: what is not there by then is lost.
        let last = sent + 1;
        let end = Instant::now() + PATIENCE;
        while heard.numbers.lock().unwrap().last() != Some(&last) {
            assert_eq!(a.send(B, &[packet(last)]), Ok(1));
            assert!(Instant::now() < end, "it stays deaf");
            thread::yield_now();
        }
        stop.store(true, Ordering::Release);
        b.wake();
        polling.join().unwrap();
        last
    });
    let mut numbers = heard.numbers.into_inner().unwrap();
    numbers.dedup();
    let (connected, others) = drops(to.port());
    let expected = (1..=first).chain(1..=last);
    assert!(numbers.iter().copied().eq(expected), "{} heard of {}", numbers.len(), first + last);
    assert_eq!(connected, [0, 0], "two neighbours");
    assert!(others.len() == 1 && others[0] > 0, "the flood filled no socket: {others:?}");
}

/// A thread that did nothing but turn a flood away would take its core from the tasks.
#[test]
fn a_flood_is_looked_at_in_turns_of_a_millisecond() {
    /// Of so many datagrams that mean nothing a visit takes, and then the next one waits.
    const VISIT: u64 = 16;
    const VISITS: u64 = 12;
    let (b, memory) = (link(B), Memory::default());
    flood(b.local_address(), FILLS_A_SOCKET);
    let start = Instant::now();
    let came = || b.count(UdpCount::DatagramsReceived) + b.count(UdpCount::GreetingsReceived);
    while came() < VISIT * VISITS {
        assert_eq!(b.poll(&memory, Some(start + PATIENCE)), PollEnd::Received);
    }
    let least = Duration::from_millis(VISITS - 1);
    assert!(start.elapsed() >= least, "{} datagrams within {:?}", came(), start.elapsed());
    // A poll that ends before the rest does is on time.
    assert_eq!(b.poll(&memory, Some(Instant::now())), PollEnd::TimedOut);
}
