//! Sessions that are renewed while nodes on real sockets send to each other. Each datagram that the network delivers
//! must be accepted, and only once.

use super::rig::{Heard, NODES, PATIENCE, bound, keys, packet};
use crate::link::Link;
use crate::link::udp::peer::Peer;
use crate::link::udp::{UdpCount, UdpLink};
use crate::lock::lock;
use imrs_wire::envelope::keyed::{self, Keyed};
use std::collections::{BTreeMap, BTreeSet};
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, RwLock};
use std::thread;
use std::time::{Duration, Instant};

/// The most datagrams of a node that are in flight, so that no socket queue of the kernel overflows.
const UNDER_WAY: usize = 60;
/// The pairs of nodes that talk with each other.
const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

/// The datagrams of one node that reached another node: by the index of the session, their counters.
type Delivered = BTreeMap<u32, BTreeSet<u64>>;

/// A network between the three nodes that loses, repeats and delays datagrams.
struct Network {
    /// `sockets[to][from]` is where the datagrams of `from` for `to` arrive.
    sockets: [[UdpSocket; 3]; 3],
    nodes: [SocketAddr; 3],
    delivered: [[Mutex<Delivered>; 3]; 3],
    /// How many datagrams are no longer in flight: they were lost, or were delivered with all their copies.
    done: AtomicU64,
}

impl Network {
    fn new(links: &[UdpLink; 3]) -> Self {
        let socket = |_| {
            let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
            socket.set_read_timeout(Some(Duration::from_millis(1))).expect("a time");
            socket
        };
        let sockets = [0, 1, 2].map(|_| [0, 1, 2].map(socket));
        for (to, of) in sockets.iter().enumerate() {
            for (from, socket) in of.iter().enumerate().filter(|(from, _)| *from != to) {
                links[from].set_address(NODES[to], socket.local_addr().ok()).expect("a neighbour");
            }
        }
        Self {
            sockets,
            nodes: links.each_ref().map(UdpLink::local_address),
            delivered: Default::default(),
            done: AtomicU64::new(0),
        }
    }

    /// Forwards what `from` sends to `to`, as the network does.
    fn pass_on(&self, (from, to): (usize, usize), is_over: &AtomicBool) {
        let mut random = fastrand::Rng::with_seed((3 * from + to) as u64);
        let (mut room, mut later) = ([0; 2_000], Vec::<(Instant, Vec<u8>)>::new());
        while !is_over.load(Ordering::Acquire) || !later.is_empty() {
            if let Ok(length) = self.sockets[to][from].recv(&mut room) {
                let bytes = room[..length].to_vec();
                match random.u8(..10) {
                    0 => drop(self.done.fetch_add(1, Ordering::AcqRel)),
                    1 => {
                        self.deliver((from, to), &bytes);
                        later.push((Instant::now() + Duration::from_millis(random.u64(..4)), bytes));
                    }
                    2 => later.push((Instant::now() + Duration::from_millis(random.u64(..4)), bytes)),
                    _ => self.deliver_last((from, to), &bytes),
                }
            }
            let now = Instant::now();
            let (due, not_yet) = later.into_iter().partition(|(at, _)| *at <= now);
            later = not_yet;
            due.iter().for_each(|(_, bytes): &(Instant, Vec<u8>)| self.deliver_last((from, to), bytes));
        }
    }

    fn deliver_last(&self, way: (usize, usize), bytes: &[u8]) {
        self.deliver(way, bytes);
        self.done.fetch_add(1, Ordering::AcqRel);
    }

    fn deliver(&self, (from, to): (usize, usize), bytes: &[u8]) {
        if let Ok(Keyed::Transport { index, counter, .. }) = keyed::read(bytes) {
            lock(&self.delivered[from][to]).entry(index).or_default().insert(counter);
        }
        // The datagram leaves from the socket whose address `to` knows as the address of `from`.
        self.sockets[from][to].send_to(bytes, self.nodes[to]).expect("it leaves");
    }

    /// How many datagrams were delivered. Copies of one datagram count once.
    fn count(&self, from: usize, to: usize) -> usize {
        lock(&self.delivered[from][to]).values().map(BTreeSet::len).sum()
    }

    fn sessions(&self, from: usize, to: usize) -> usize {
        lock(&self.delivered[from][to]).len()
    }
}

fn peer(link: &UdpLink, node: usize) -> &Peer {
    link.peer(NODES[node]).expect("a neighbour").1
}

fn taken(link: &UdpLink, from: usize) -> usize {
    usize::try_from(peer(link, from).progress().accepted).expect("few")
}

/// All ordered pairs of sender and receiver.
fn both() -> impl Iterator<Item = (usize, usize)> {
    PAIRS.iter().flat_map(|&(a, b)| [(a, b), (b, a)])
}

/// Whether no datagram is in flight, and the nodes have accepted every datagram that was delivered.
fn are_taken(links: &[UdpLink; 3], network: &Network) -> bool {
    let kinds = [UdpCount::DatagramsSent, UdpCount::GreetingsSent, UdpCount::HandshakesSent];
    let sent: u64 = links.iter().flat_map(|link| kinds.map(|kind| link.count(kind))).sum();
    let is_done = network.done.load(Ordering::Acquire) == sent;
    is_done && both().all(|(from, to)| taken(&links[to], from) == network.count(from, to))
}

/// Sends packets to both neighbours until `is_over`, but pauses while the test holds the write lock of `may`. Returns
/// how many packets were sent to each node.
fn speak(
    me: usize,
    links: &[UdpLink; 3],
    network: &Network,
    (is_over, may): (&AtomicBool, &RwLock<()>),
) -> [u32; 3] {
    let mut sent = [0; 3];
    while !is_over.load(Ordering::Acquire) {
        let may = may.read().expect("no panic");
        for to in (0..3).filter(|to| *to != me) {
            let is_free = network.count(me, to) < taken(&links[to], me) + UNDER_WAY;
            let (next, link) = (sent[to] + 1, &links[me]);
            if is_free && link.ready(NODES[to]) && link.send(NODES[to], &[packet(me, to, next)]).is_ok() {
                sent[to] = next;
            }
        }
        drop(may);
        thread::sleep(Duration::from_micros(300));
    }
    sent
}

/// Lets three nodes send to each other until `is_enough`, and checks what arrived. `before` changes the nodes after
/// each has heard the others.
fn talk(replace_after: u64, before: impl Fn(&[UdpLink; 3]), is_enough: impl Fn(&Network) -> bool) {
    let keys = keys();
    let links = [0, 1, 2].map(|node| bound(node, &keys));
    for (at, to) in both() {
        lock(&peer(&links[at], to).channel).as_mut().expect("keys").replace_after = replace_after;
    }
    let (network, heard) = (Network::new(&links), [(); 3].map(|()| Heard::default()));
    let (is_silent, is_over, may) = (AtomicBool::new(false), AtomicBool::new(false), RwLock::new(()));
    let wait = |what: &str, is_so: &dyn Fn() -> bool| {
        let end = Instant::now() + PATIENCE;
        while !is_so() {
            if Instant::now() > end {
                is_silent.store(true, Ordering::Release);
                is_over.store(true, Ordering::Release);
                panic!("{what}: {:?}", heard.each_ref().map(|heard| lock(&heard.discards).clone()));
            }
            thread::sleep(Duration::from_millis(5));
        }
    };
    thread::scope(|scope| {
        for node in 0..3 {
            let (link, heard, is_over) = (&links[node], &heard[node], &is_over);
            scope.spawn(move || {
                while !is_over.load(Ordering::Acquire) {
                    link.poll(heard, Some(Instant::now() + Duration::from_millis(20)));
                }
            });
        }
        for way in both() {
            let (network, is_over) = (&network, &is_over);
            scope.spawn(move || network.pass_on(way, is_over));
        }
        let speaking = [0, 1, 2].map(|node| {
            let (links, network, until) = (&links, &network, (&is_silent, &may));
            scope.spawn(move || speak(node, links, network, until))
        });
        wait("they meet", &|| both().all(|(from, to)| taken(&links[to], from) > 20));
        // `before` may set a counter far ahead. Datagrams still in flight would then lie below the receiver's window
        // and be dropped.
        let may_not = may.write().expect("no panic");
        wait("all that was delivered is taken in", &|| are_taken(&links, &network));
        before(&links);
        drop(may_not);
        wait("sessions are renewed", &|| is_enough(&network));
        is_silent.store(true, Ordering::Release);
        let sent = speaking.map(|speaking| speaking.join().expect("no panic"));
        wait("all that was delivered is taken in", &|| are_taken(&links, &network));
        is_over.store(true, Ordering::Release);
        for (to, heard) in heard.iter().enumerate() {
            let mut numbers = 0;
            for from in (0..3).filter(|from| *from != to) {
                let came = heard.of(from);
                numbers += came.len();
                let once: BTreeSet<_> = came.iter().collect();
                assert_eq!(once.len(), came.len(), "a packet came twice");
                assert!(once.last() <= Some(&&sent[from][to]));
            }
            let greetings = links[to].count(UdpCount::GreetingsReceived);
            let all: usize = (0..3).filter(|from| *from != to).map(|from| taken(&links[to], from)).sum();
            assert_eq!(numbers + usize::try_from(greetings).expect("few"), all, "no packet was lost");
            assert!(lock(&heard.stopped).is_empty() && lock(&heard.peers).len() == 2, "nobody started again");
            let discards = lock(&heard.discards);
            assert!(discards.keys().all(|why| ["replayed", "stale_session"].contains(why)), "{discards:?}");
        }
    });
}

#[test]
fn sessions_that_are_renewed_ten_times_a_second_lose_nothing() {
    let is_enough = |network: &Network| {
        PAIRS.iter().all(|&(a, b)| network.sessions(a, b) > 12 && network.sessions(b, a) > 12)
    };
    talk(100_000, |_| (), is_enough);
}

/// The test runs twice: first the lower node of each pair reaches the greatest number of datagrams of a session, then
/// the other node.
#[test]
fn a_session_is_renewed_after_so_many_datagrams_and_loses_nothing() {
    const MOST: u64 = 1 << 32;
    for late in [0, 1] {
        let near_the_end = |links: &[UdpLink; 3]| {
            for (a, b) in PAIRS {
                let (of, to) = if late == 0 { (a, b) } else { (b, a) };
                lock(&peer(&links[of], to).outgoing).counter = MOST - 50;
            }
        };
        let is_enough = |network: &Network| {
            PAIRS.iter().all(|&(a, b)| {
                let (from, to) = if late == 0 { (a, b) } else { (b, a) };
                let delivered = lock(&network.delivered[from][to]);
                let after = |counters: &BTreeSet<u64>| counters.range(MOST..).count();
                // The earlier session still carries some datagrams until the new session is ready.
                let is_renewed = delivered.values().any(|counters| counters.first() > Some(&(MOST - 50)));
                is_renewed && delivered.values().map(after).sum::<usize>() > 100
            })
        };
        talk(3_600_000_000, near_the_end, is_enough);
    }
}
