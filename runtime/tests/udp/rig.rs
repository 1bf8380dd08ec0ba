//! Helpers of the tests of the UDP link: three nodes with a link between any two, a task on each node, and a sink that
//! records packets.

use imrs_protocol::{
    Cell, CellTable, Class, Contents, Incarnation, Kind, MAX_HOPS, MessageId, NodeId, NodeTable, Packet,
    PortDecl, PortId, Seal, Seq24, TaskId, Ticks, Usage,
};
use imrs_runtime::link::udp::{UdpCount, UdpLink, UdpOptions};
use imrs_runtime::link::{Link, LinkDiscard, PollEnd, Sink};
use imrs_wire::envelope::{Datagram, Digests, Envelope, Purpose, Session};
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::{Arc, LazyLock, Mutex};
use std::time::{Duration, Instant};

pub const A: NodeId = NodeId(0);
pub const B: NodeId = NodeId(1);
pub const C: NodeId = NodeId(2);
/// The declared bound of every link of these tests.
pub const BOUND: Ticks = Ticks(2_000);
/// How many messages can wait at the port of a task: more than a datagram holds.
pub const QUEUED: u16 = 64;
/// A time far above what any of these tests needs on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(120);

pub fn cell(name: &str) -> Arc<CellTable> {
    let mut cell = Cell::new(name, Ticks(100));
    let nodes = ["a", "b", "c"].map(|n| cell.node(n));
    let tasks: Vec<_> = ["x", "y", "z"].iter().zip(nodes).map(|(t, n)| cell.task(t, n)).collect();
    for (from, to) in [(0, 1), (0, 2), (1, 2)] {
        cell.link(nodes[from], nodes[to], BOUND);
    }
    cell.node("stranger");
    cell.port(
        PortDecl::new("status", tasks[0], Usage::Send, &tasks[1..], Ticks(120_000_000))
            .bounded_buffer(QUEUED),
    );
    Arc::new(CellTable::new(cell).unwrap())
}

pub fn table(node: NodeId) -> NodeTable {
    NodeTable::new(cell("udp"), node)
}

pub fn any_port() -> SocketAddr {
    (Ipv4Addr::LOCALHOST, 0).into()
}

pub fn link(node: NodeId) -> UdpLink {
    started(node, 1, false)
}

pub fn started(node: NodeId, incarnation: u8, restarted: bool) -> UdpLink {
    LazyLock::force(&STAMPED);
    bound(node, UdpOptions::new(Incarnation(incarnation), restarted))
}

fn bound(node: NodeId, options: UdpOptions) -> UdpLink {
    UdpLink::bind(table(node), any_port(), options).unwrap()
}

/// A link with kernel stamps, which is kept until the end of the process. The kernel begins to stamp some time after
/// the first socket asks for stamps, on a busy machine long after. It stops when the last such socket is closed.
static STAMPED: LazyLock<UdpLink> = LazyLock::new(|| {
    let end = Instant::now() + PATIENCE;
    loop {
        let (a, b) = introduced(bound(A, first_incarnation()), bound(B, first_incarnation()));
        a.send(B, &[packet(1)]).unwrap();
        Memory::default().take_packets(&b, 1);
        if b.count(UdpCount::NoStamp) == 0 {
            return b;
        }
        assert!(Instant::now() < end, "the kernel gives no stamps");
    }
});

fn first_incarnation() -> UdpOptions {
    UdpOptions::new(Incarnation(1), false)
}

/// A link for which the kernel neither cuts nor merges datagrams.
pub fn plain(node: NodeId) -> UdpLink {
    bound(node, UdpOptions { segments: false, ..first_incarnation() })
}

/// Links of A and B that know each other's addresses.
pub fn pair() -> (UdpLink, UdpLink) {
    introduced(link(A), link(B))
}

pub fn introduced(a: UdpLink, b: UdpLink) -> (UdpLink, UdpLink) {
    a.set_address(B, Some(b.local_address())).unwrap();
    b.set_address(A, Some(a.local_address())).unwrap();
    (a, b)
}

/// A status message of task x (node A) to task y (node B) with a TTL of one minute.
pub fn packet(number: u32) -> Packet {
    Packet {
        kind: Kind::Send,
        class: Class::Status,
        more: false,
        resent: false,
        hops: MAX_HOPS,
        fragment: 0,
        destination: TaskId(1),
        source: TaskId(0),
        port: PortId(0),
        id: MessageId { incarnation: Incarnation(1), sequence: Seq24::new(number) },
        remaining: Ticks(60_000_000),
        contents: Contents::new(b"here").unwrap(),
        seal: Seal::NONE,
    }
}

/// The bytes of [`packet`] in a datagram.
pub fn encoded(number: u32) -> [u8; 32] {
    let table = table(A);
    packet(number).encode(table.digest(), table.port(PortId(0)).unwrap().hash)
}

/// An envelope as the first incarnation of A would write it to B.
pub fn envelope(counter: u64) -> Envelope {
    envelope_of(1, counter)
}

/// An envelope as this incarnation of A would write it to B. The session has the same number as the incarnation.
pub fn envelope_of(incarnation: u8, counter: u64) -> Envelope {
    Envelope {
        sender: A,
        receiver: B,
        incarnation: Incarnation(incarnation),
        restarted: false,
        session: Session(incarnation.into()),
        counter,
        tx_mono: 1_000_000 + counter,
        echo: None,
        purpose: Purpose::Packets,
    }
}

/// The digests that all nodes of these tests share.
pub fn digests() -> Digests {
    Digests { cell: table(A).digest(), statements: 0 }
}

pub fn sealed(envelope: &Envelope, packets: &[[u8; 32]]) -> Vec<u8> {
    sealed_for(digests(), envelope, packets)
}

pub fn sealed_for(digests: Digests, envelope: &Envelope, packets: &[[u8; 32]]) -> Vec<u8> {
    let mut datagram = Datagram::default();
    for packet in packets {
        assert!(datagram.push(packet));
    }
    datagram.seal(envelope, digests).to_vec()
}

/// A socket without a link, from which a test can send anything.
pub fn raw_socket() -> UdpSocket {
    UdpSocket::bind(any_port()).unwrap()
}

/// A sink that records what a link hands over.
#[derive(Default)]
pub struct Memory {
    pub packets: Mutex<Vec<(NodeId, Packet, Ticks)>>,
    pub peers: Mutex<Vec<(NodeId, Incarnation, bool)>>,
    pub discards: Mutex<Vec<LinkDiscard>>,
    pub stopped: Mutex<Vec<NodeId>>,
}

impl Sink for Memory {
    fn packets(&self, from: NodeId, packets: &[Packet], charge: Ticks, _at: Instant) {
        self.packets.lock().unwrap().extend(packets.iter().map(|&packet| (from, packet, charge)));
    }

    fn peer(&self, node: NodeId, incarnation: Incarnation, restarted: bool) {
        self.peers.lock().unwrap().push((node, incarnation, restarted));
    }

    fn stopped(&self, node: NodeId) {
        self.stopped.lock().unwrap().push(node);
    }

    fn discarded(&self, reason: LinkDiscard) {
        self.discards.lock().unwrap().push(reason);
    }
}

impl Memory {
    pub fn delivered(&self) -> usize {
        self.packets.lock().unwrap().len()
    }

    /// Polls until `done`, for no longer than [`PATIENCE`].
    pub fn poll_until(&self, link: &impl Link, done: impl Fn(&Self) -> bool) {
        let end = Instant::now() + PATIENCE;
        while !done(self) {
            let ended = link.poll(self, Some(end));
            assert_ne!(ended, PollEnd::TimedOut, "nothing more came in");
        }
    }

    /// Polls until this many packets have arrived since the last call, and returns them.
    pub fn take_packets(&self, link: &impl Link, count: usize) -> Vec<(NodeId, Packet, Ticks)> {
        self.poll_until(link, |m| m.delivered() >= count);
        std::mem::take(&mut *self.packets.lock().unwrap())
    }

    /// Polls until this many discards have happened since the last call, and returns them.
    pub fn take_discards(&self, link: &impl Link, count: usize) -> Vec<LinkDiscard> {
        self.poll_until(link, |m| m.discards.lock().unwrap().len() >= count);
        std::mem::take(&mut *self.discards.lock().unwrap())
    }
}
