//! A flood of datagrams at a node's port costs its neighbours nothing, because each neighbour has a socket of its own (D155).

use super::keys::{carried, keys, pair as pair_with_keys};
use super::rig::{
    A, B, C, Memory, PATIENCE, cell, digests, encoded, envelope_of, link, packet, pair, raw_socket, sealed,
    sealed_for,
};
use imrs_protocol::{Incarnation, NodeId, Packet, Ticks};
use imrs_runtime::link::udp::{UdpCount, UdpLink};
use imrs_runtime::link::{Link, LinkDiscard, PollEnd, Sink};
use imrs_wire::envelope::{Digests, Envelope};
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// More datagrams than any socket of this test holds.
const FILLS_A_SOCKET: usize = 5_000;
/// How many datagrams the flood sends while the neighbour's datagrams must still be received.
const FLOOD: usize = 200_000;
/// How many of the neighbour's datagrams fit into its socket while no thread receives.
const UNDER_WAY: usize = 100;

/// The datagrams of a flood: garbage of several lengths, and datagrams that look like this cell's.
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
        // This datagram has the name of the neighbour, but a session that is not the neighbour's.
        sealed(&envelope_of(3, 11), &[encoded(4)]),
    ]
}

/// Sends `count` of these datagrams as fast as possible.
fn flood(to: SocketAddr, count: usize, thrown: &[Vec<u8>]) {
    let socket = raw_socket();
    for number in 0..count {
        // The kernel may refuse a send for lack of room. Then the flood cannot be faster.
        let _ = socket.send_to(&thrown[number % thrown.len()], to);
    }
}

/// A sink that records the numbers of the neighbour's packets, in order of arrival, and when a datagram was last discarded.
#[derive(Default)]
struct Heard {
    numbers: Mutex<Vec<u32>>,
    count: AtomicUsize,
    discarded: Mutex<Option<Instant>>,
}

impl Sink for Heard {
    fn packets(&self, from: NodeId, packets: &[Packet], _charge: Ticks, _at: Instant) {
        assert_eq!(from, A);
        self.numbers.lock().unwrap().extend(packets.iter().map(|packet| packet.id.sequence.get()));
        self.count.fetch_add(packets.len(), Ordering::Release);
    }

    fn peer(&self, _node: NodeId, _incarnation: Incarnation, _restarted: bool) {}

    fn discarded(&self, _reason: LinkDiscard) {
        *self.discarded.lock().unwrap() = Some(Instant::now());
    }
}

/// The remote address of a socket that is not connected, as the kernel lists it.
const UNCONNECTED: &str = "00000000:0000";

/// How many datagrams the kernel dropped on each of the `count` sockets at a local address, by their remote addresses.
///
/// The kernel lists its sockets in pieces. While other threads open and close sockets, it may omit or repeat a line, so the list
/// is read again until it is complete.
fn drops(local: SocketAddr, count: usize) -> BTreeMap<String, u64> {
    let SocketAddr::V4(local) = local else { panic!("{local} is listed elsewhere") };
    let local = format!("{:08X}:{:04X}", u32::from_ne_bytes(local.ip().octets()), local.port());
    let end = Instant::now() + PATIENCE;
    loop {
        let table =
            std::fs::read_to_string("/proc/thread-self/net/udp").expect("the sockets of this network");
        let lines = table.lines().skip(1).map(|line| line.split_whitespace().collect::<Vec<_>>());
        let dropped = |fields: &[&str]| fields.last().and_then(|last| last.parse().ok()).expect("a count");
        let own = lines.filter(|fields| fields[1] == local);
        let found: BTreeMap<_, _> = own.map(|fields| (fields[2].to_owned(), dropped(&fields))).collect();
        if found.len() == count {
            return found;
        }
        assert!(Instant::now() < end, "{count} sockets are at {local}: {table}");
        thread::sleep(Duration::from_millis(1));
    }
}

/// Two links of nodes that have heard from each other.
fn acquainted() -> (UdpLink, UdpLink) {
    let (a, b) = pair();
    for (from, to, node) in [(&a, &b, B), (&b, &a, A), (&a, &b, B)] {
        from.send(node, &[packet(0)]).unwrap();
        Memory::default().take_packets(to, 1);
    }
    (a, b)
}

/// Sends packets as long as `floods` returns true, never more at once than fit into the socket. Returns how many
/// packets were sent.
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
    // No thread receives yet: the flood fills the socket at which it arrives, and then the neighbour sends.
    flood(to, FILLS_A_SOCKET, &thrown());
    let first = UNDER_WAY as u32 / 2;
    (1..=first).for_each(|number| assert_eq!(a.send(B, &[packet(number)]), Ok(1)));
    let stop = AtomicBool::new(false);
    let last = thread::scope(|scope| {
        let flooding = scope.spawn(|| flood(to, FLOOD, &thrown()));
        let polling = scope.spawn(|| {
            while !stop.load(Ordering::Acquire) {
                b.poll(&heard, Some(Instant::now() + PATIENCE));
            }
        });
        let sent = speaks(&a, &heard, || !flooding.is_finished());
        // The last packet is sent once, like the others: if it were repeated without a pause, it would itself fill the
        // socket. If it is lost, the comparison below shows that.
        let last = sent + 1;
        assert_eq!(a.send(B, &[packet(last)]), Ok(1));
        let end = Instant::now() + PATIENCE;
        while heard.numbers.lock().unwrap().last() != Some(&last) && Instant::now() < end {
            thread::sleep(Duration::from_millis(1));
        }
        stop.store(true, Ordering::Release);
        b.wake();
        polling.join().unwrap();
        last
    });
    let numbers = heard.numbers.into_inner().unwrap();
    let expected = (1..=first).chain(1..=last);
    assert!(numbers.iter().copied().eq(expected), "{} heard of {}", numbers.len(), first + last);
    let mut connected = drops(to, 3);
    let others = connected.remove(UNCONNECTED);
    assert!(others.is_some_and(|dropped| dropped > 0), "the flood filled no socket: {others:?}");
    assert!(connected.values().eq(&[0, 0]), "two neighbours: {connected:?}");
}

/// The polling thread reads the socket of strangers with pauses. Without them it would only drop the flood, and the
/// tasks would lose its core.
#[test]
fn a_flood_is_looked_at_in_turns_of_a_millisecond() {
    /// The number of datagrams after which a visit to the socket ends, if all are meaningless; the next visit then
    /// waits.
    const VISIT: u64 = 16;
    const VISITS: u64 = 12;
    let (b, heard) = (link(B), Heard::default());
    flood(b.local_address(), FILLS_A_SOCKET, &thrown());
    let start = Instant::now();
    let came = || b.count(UdpCount::DatagramsReceived) + b.count(UdpCount::GreetingsReceived);
    while came() < VISIT * VISITS {
        assert_eq!(b.poll(&heard, Some(start + PATIENCE)), PollEnd::Received);
    }
    // The pause of a millisecond counts from a clock reading a few microseconds before the last discards of its visit.
    let least = Duration::from_millis(VISITS - 1) * 9 / 10;
    assert!(start.elapsed() >= least, "{} datagrams within {:?}", came(), start.elapsed());
    // A poll during the pause reads nothing. The pause began after the last discard. It can be over by now only if
    // this thread did not run for a while.
    let discarded = heard.discarded.lock().unwrap().expect("all of it means nothing");
    let end = b.poll(&heard, Some(Instant::now()));
    let since = discarded.elapsed();
    assert!(end == PollEnd::TimedOut || since >= Duration::from_millis(1), "{end:?} after {since:?}");
}

/// The request for a session that the node of `a` sends to B.
fn request_of(a: &UdpLink) -> Vec<u8> {
    let between = raw_socket();
    between.set_read_timeout(Some(PATIENCE)).unwrap();
    a.set_address(B, Some(between.local_addr().unwrap())).unwrap();
    a.greet();
    let mut bytes = vec![0; 2_000];
    let length = between.recv(&mut bytes).unwrap();
    bytes.truncate(length);
    bytes
}

/// A request that a stranger made up costs a node with keys one hash. A copy of a genuine request costs two more
/// hashes, and perhaps the sending of a cookie.
#[test]
fn a_flood_of_requests_for_sessions_loses_nothing_of_a_neighbour() {
    /// How many packets the neighbour sends, each some time after the one before.
    const PACKETS: u32 = 2_000;
    let (pause, most) = (Duration::from_micros(250), Duration::from_secs(60));
    // A flood to another address shows what a flood costs this machine; a flood of garbage shows what any flood costs
    // the node.
    let elsewhere = raw_socket();
    for what in ["no flood", "elsewhere", "garbage", "requests"] {
        let (a, b) = pair_with_keys(&keys());
        let copy = request_of(&a);
        a.set_address(B, Some(b.local_address())).unwrap();
        carried(&a, &b, 1..2);
        let mut made_up = copy.clone();
        *made_up.last_mut().unwrap() ^= 1;
        let (to, at_a, at_b, stop) =
            (b.local_address(), Memory::default(), Heard::default(), AtomicBool::new(false));
        let is_over = || stop.load(Ordering::Acquire);
        let polls = |link: &UdpLink, sink: &dyn Sink| {
            while !is_over() {
                link.poll(sink, Some(Instant::now() + Duration::from_millis(20)));
            }
        };
        let thrown = thread::scope(|scope| {
            scope.spawn(|| polls(&a, &at_a));
            scope.spawn(|| polls(&b, &at_b));
            let flooding = scope.spawn(|| {
                let mut thrown = 0;
                let to = if what == "elsewhere" { elsewhere.local_addr().unwrap() } else { to };
                let garbage = vec![vec![0x5a; copy.len()]];
                let thrown_ones =
                    if what == "garbage" { garbage } else { vec![copy.clone(), made_up.clone()] };
                while what != "no flood" && !is_over() {
                    flood(to, 1_000, &thrown_ones);
                    thrown += 1_000;
                }
                thrown
            });
            for number in 1..=PACKETS {
                while number as usize > at_b.count.load(Ordering::Acquire) + UNDER_WAY {
                    thread::sleep(pause);
                }
                assert_eq!(a.send(B, &[packet(number)]), Ok(1));
                // B hears A's echo of its clock, so it can measure A's next datagram.
                assert_eq!(b.send(A, &[packet(number)]), Ok(1));
                thread::sleep(pause);
            }
            let end = Instant::now() + most;
            while at_b.count.load(Ordering::Acquire) < PACKETS as usize && Instant::now() < end {
                thread::sleep(Duration::from_millis(1));
            }
            stop.store(true, Ordering::Release);
            flooding.join().unwrap()
        });
        assert!(at_b.numbers.into_inner().unwrap().into_iter().eq(1..=PACKETS), "each came, in order");
        let delay = b.health().iter().find(|report| report.peer == A).expect("a report").delay;
        let (answers, dropped) = (b.count(UdpCount::HandshakesSent), b.count(UdpCount::StrangersDropped));
        println!(
            "{what}: {thrown} thrown, {answers} answers, {dropped} dropped by the kernel; A's datagrams: {delay:?}"
        );
        let mut connected = drops(to, 2);
        connected.remove(UNCONNECTED);
        assert!(connected.values().eq(&[0]), "the neighbour's socket: {connected:?}");
    }
}
