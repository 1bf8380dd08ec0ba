//! Two nodes with keys, and an attacker who controls the network between them. The attacker's sockets receive what a
//! node sends. The attacker hands it to the other node, or keeps it.

use super::super::{Received, Together};
use crate::link::residency::Reading;
use crate::link::udp::keyed::rig::{Heard, NODES, PATIENCE, bound, packet};
use crate::link::udp::keys::NodeKeys;
use crate::link::udp::{UdpCount, UdpLink};
use crate::link::{Link, PollEnd};
use crate::lock::lock;
use imrs_protocol::{NodeId, Ticks};
use std::fmt::Write;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

/// The two nodes.
pub const ENDS: [NodeId; 2] = [NODES[0], NODES[1]];
/// A neighbour of both nodes that never answers, so that both wait for a session with it.
pub const SILENT: NodeId = NODES[2];
/// How many datagrams of one start of the two nodes the attacker keeps.
const KEPT: usize = 800;
/// The counters of a link that only genuine datagrams may change.
const COUNTS: [UdpCount; 8] = [
    UdpCount::PacketsReceived,
    UdpCount::NewIncarnations,
    UdpCount::GreetingsReceived,
    UdpCount::GreetingsSent,
    UdpCount::GoodbyesReceived,
    UdpCount::EchoesAsked,
    UdpCount::CountersMended,
    UdpCount::SessionsMade,
];

pub struct Scene {
    pub links: [UdpLink; 2],
    pub heard: [Heard; 2],
    /// The sockets at which the datagrams for each of the two nodes arrive.
    wires: [UdpSocket; 2],
    silent: UdpSocket,
    /// Datagrams with their receiving node: the first ones of this start, and the newest ones.
    pub recorded: Vec<(usize, Vec<u8>)>,
    /// The requests of the two nodes for a session with the silent neighbour.
    pub asked: [Vec<u8>; 2],
    /// The request of the first node for another session, and the indices of that session at both nodes. The attacker
    /// holds back the answer that would complete it.
    pub pending: (Vec<u8>, [u32; 2]),
    /// How many datagrams were recorded.
    all: usize,
    /// The number of the last packet of each node.
    pub sent: [u32; 2],
}

impl Scene {
    /// Starts both nodes, and lets them greet each other and talk.
    pub fn new(keys: &[NodeKeys; 3]) -> Self {
        let links = [0, 1].map(|me| bound(me, keys));
        let [first, second, silent] = [(); 3].map(|()| UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap());
        let wires = [first, second];
        wires.iter().chain([&silent]).for_each(|socket| socket.set_nonblocking(true).unwrap());
        for me in [0, 1] {
            links[me].set_address(ENDS[1 - me], wires[1 - me].local_addr().ok()).unwrap();
            links[me].set_address(SILENT, silent.local_addr().ok()).unwrap();
        }
        let mut scene = Self {
            links,
            heard: Default::default(),
            wires,
            silent,
            recorded: Vec::new(),
            asked: Default::default(),
            pending: Default::default(),
            all: 0,
            sent: [0; 2],
        };
        for me in [0, 1] {
            scene.links[me].greet();
            scene.passes_on();
            let mut hello = [0; 2_000];
            let length = scene.silent.recv(&mut hello).unwrap();
            scene.asked[me] = hello[..length].to_vec();
        }
        assert!(ENDS.iter().all(|&end| scene.links.iter().any(|link| link.has_met(end) == Ok(true))));
        (0..100).for_each(|_| scene.talks(&[]));
        scene
    }

    /// Makes the first node ask for another session; the attacker holds back the answer.
    pub fn asks_again(&mut self) {
        let now = self.links[0].micros(Instant::now());
        let hello = lock(&self.links[0].peers[0].channel).as_mut().and_then(|channel| channel.knock(now));
        let hello = hello.expect("a request").to_vec();
        let mut bytes = hello.clone();
        for to in [1, 0, 1] {
            self.recorded.push((to, bytes.clone()));
            self.arrives(to, Some(self.address_of_other(to)), (&bytes, bytes.len()));
            bytes = self.received(1 - to).expect("an answer");
        }
        let index = |at: usize| u32::from_le_bytes(*bytes[at..].first_chunk().expect("an index"));
        self.pending = (hello, [32, 36].map(index));
    }

    /// The address under which a node finds the other node.
    pub fn address_of_other(&self, me: usize) -> SocketAddr {
        self.wires[1 - me].local_addr().unwrap()
    }

    pub fn silent_address(&self) -> SocketAddr {
        self.silent.local_addr().unwrap()
    }

    fn received(&self, to: usize) -> Option<Vec<u8>> {
        let mut bytes = [0; 2_000];
        let length = self.wires[to].recv(&mut bytes).ok()?;
        Some(bytes[..length].to_vec())
    }

    /// Takes the next datagram that a node has sent to node `to`, and records it.
    pub fn taken(&mut self, to: usize) -> Option<Vec<u8>> {
        let bytes = self.received(to)?;
        let datagram = (to, bytes.clone());
        if self.recorded.len() < KEPT {
            self.recorded.push(datagram);
        } else {
            self.recorded[KEPT / 2 + self.all % (KEPT / 2)] = datagram;
        }
        self.all += 1;
        Some(bytes)
    }

    /// Empties the attacker's sockets, which may hold, for example, answers to forged datagrams.
    pub fn empty_the_wires(&self) {
        let mut bytes = [0; 2_000];
        for socket in self.wires.iter().chain([&self.silent]) {
            while socket.recv(&mut bytes).is_ok() {}
        }
    }

    /// Hands over what the nodes have sent, until they send no more.
    pub fn passes_on(&mut self) {
        let mut quiet = 0;
        while quiet < 2 {
            for to in [0, 1] {
                quiet += 1;
                while let Some(bytes) = self.taken(to) {
                    let from = self.address_of_other(to);
                    self.arrives(to, Some(from), (&bytes, bytes.len()));
                    quiet = 0;
                }
            }
        }
    }

    /// Lets datagrams of this length arrive at a node in one call, from a neighbour's address or from a stranger's.
    /// Returns how many of them the node accepted.
    pub fn arrives(&self, to: usize, from: Option<SocketAddr>, (bytes, segment): (&[u8], usize)) -> usize {
        let link = &self.links[to];
        link.with_room(|room| {
            let together = Together {
                link,
                from,
                now: Reading::take(),
                waited: Ticks(1),
                decoded: &mut room.decoded,
                plain: &mut room.plain,
                of: None,
                greetings: 0,
                handshakes: 0,
                admitted: 0,
                sink: &self.heard[to],
            };
            together.deliver(&Received::of(bytes, segment)).1
        })
    }

    /// Lets each node send a packet to the other, and asserts that it arrives. If `forged` is not empty, it arrives
    /// in the same call, as if the kernel had merged it with the genuine datagram.
    pub fn talks(&mut self, forged: &[u8]) {
        self.empty_the_wires();
        for from in [0, 1] {
            self.sent[from] += 1;
            let packet = packet(from, 1 - from, self.sent[from]);
            assert_eq!(self.links[from].send(ENDS[1 - from], &[packet]), Ok(1));
            let genuine = self.taken(1 - from).expect("it left");
            let mut merged = genuine.clone();
            if forged.len() == genuine.len() {
                merged = [forged, &genuine, forged].concat();
            }
            let address = self.address_of_other(1 - from);
            self.arrives(1 - from, Some(address), (&merged, genuine.len()));
            assert_eq!(lock(&self.heard[1 - from].numbers).last(), Some(&(ENDS[from], self.sent[from])));
        }
    }

    /// From now on the nodes send to each other's sockets, and know no address of the silent neighbour.
    pub fn meets_on_sockets(&self) {
        for me in [0, 1] {
            let link = &self.links[me];
            link.set_address(ENDS[1 - me], Some(self.links[1 - me].local_address())).unwrap();
            link.set_address(SILENT, None).unwrap();
        }
    }

    /// Lets a node receive until it has taken at least one datagram from its sockets.
    pub fn takes_in(&self, me: usize) {
        let end = Instant::now() + PATIENCE;
        while self.links[me].poll(&self.heard[me], Some(end)) != PollEnd::Received {
            assert!(Instant::now() < end, "nothing came");
        }
    }

    /// Each node sends a packet to the other one, through their sockets.
    pub fn talks_on_sockets(&mut self) {
        for from in [0, 1] {
            self.sent[from] += 1;
            let (to, packet) = (1 - from, packet(from, 1 - from, self.sent[from]));
            assert_eq!(self.links[from].send(ENDS[to], &[packet]), Ok(1));
            while lock(&self.heard[to].numbers).last() != Some(&(ENDS[from], self.sent[from])) {
                self.takes_in(to);
            }
        }
    }

    /// Lets the clocks of both nodes run ahead by this time.
    pub fn later(&mut self, by: Duration) {
        for link in &mut self.links {
            link.origin = link.origin.checked_sub(by).expect("the machine has run for longer");
        }
    }

    /// All that a node knows of its neighbours, except hints for people.
    pub fn state(&self, me: usize) -> String {
        let (link, heard) = (&self.links[me], &self.heard[me]);
        let mut text = String::new();
        for peer in &link.peers {
            let channel = lock(&peer.channel).as_ref().map(|channel| channel.state());
            let outgoing = lock(&peer.outgoing).counter;
            let (known, heard, remembers) = (lock(&peer.known), lock(&peer.heard), lock(&peer.remembers));
            let address = lock(&peer.route).as_ref().map(|route| route.address);
            let (met, remembered) = (&peer.met, peer.remembered());
            let of_links = (outgoing, address, met, &peer.has_stopped, remembered);
            writeln!(text, "{} {channel:?} {known:?} {heard:?} {remembers:?} {of_links:?}", peer.node)
                .unwrap();
        }
        for report in link.health() {
            let faults = (report.integrity.is_faulty, report.integrity.faults);
            writeln!(text, "{:?} {} {faults:?}", report.delay, report.unmeasured).unwrap();
        }
        let told = (lock(&heard.numbers).len(), &heard.peers, &heard.stopped);
        writeln!(text, "{told:?} {:?}", COUNTS.map(|count| link.count(count))).unwrap();
        text
    }
}
