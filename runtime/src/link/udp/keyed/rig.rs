//! Three nodes with keys and a link between any two, for the tests of whole links.

use crate::link::udp::keys::{NodeKeys, draw_cell_key, draw_node_keys};
use crate::link::udp::{UdpLink, UdpOptions};
use crate::link::{LinkDiscard, Sink};
use crate::lock::lock;
use imrs_protocol::{
    Cell, CellTable, Class, Contents, Incarnation, Kind, MAX_HOPS, MessageId, NodeId, NodeTable, Packet,
    PortDecl, PortId, Seal, Seq24, TaskId, Ticks, Usage,
};
use std::collections::BTreeMap;
use std::net::Ipv4Addr;
use std::sync::{Arc, LazyLock, Mutex};
use std::time::{Duration, Instant};

pub const NODES: [NodeId; 3] = [NodeId(0), NodeId(1), NodeId(2)];
/// A time far above what these tests need on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// A task on each node, and a port from each task to both others.
static TABLE: LazyLock<Arc<CellTable>> = LazyLock::new(|| {
    let mut cell = Cell::new("with keys", Ticks(100));
    let nodes = ["a", "b", "c"].map(|node| cell.node(node));
    let tasks = [0, 1, 2].map(|at| cell.task(["x", "y", "z"][at], nodes[at]));
    for (from, to) in [(0, 1), (0, 2), (1, 2)] {
        cell.link(nodes[from], nodes[to], Ticks(2_000));
    }
    for (at, name) in ["of_x", "of_y", "of_z"].into_iter().enumerate() {
        let others: Vec<_> = tasks.into_iter().filter(|&task| task != tasks[at]).collect();
        cell.port(PortDecl::new(name, tasks[at], Usage::Send, &others, Ticks(60_000_000)));
    }
    Arc::new(CellTable::new(cell).expect("a sound cell"))
});

/// The keys of the three nodes of a cell.
pub fn keys() -> [NodeKeys; 3] {
    let cell = draw_cell_key().expect("a key");
    let pairs = NODES.map(|_| draw_node_keys().expect("keys"));
    let publics: BTreeMap<_, _> = NODES.into_iter().zip(pairs.iter().map(|pair| pair.1)).collect();
    pairs.map(|(private, _)| NodeKeys::new(cell.clone(), private, publics.clone()))
}

/// The link of a node with its keys, at an address of its own.
pub fn bound(node: usize, keys: &[NodeKeys; 3]) -> UdpLink {
    let options = UdpOptions::new(Incarnation(1), false);
    let table = NodeTable::new(Arc::clone(&TABLE), NODES[node]);
    let link = UdpLink::bind(table, (Ipv4Addr::LOCALHOST, 0).into(), options).expect("a link");
    link.with_keys(&keys[node]).expect("keys of all nodes")
}

/// The packet with this number that a node sends to another one.
pub fn packet(from: usize, to: usize, number: u32) -> Packet {
    let [source, destination] = [from, to].map(|at| TaskId(at as u16));
    Packet {
        kind: Kind::Send,
        class: Class::Status,
        more: false,
        resent: false,
        hops: MAX_HOPS,
        fragment: 0,
        destination,
        source,
        port: PortId(from as u16),
        id: MessageId { incarnation: Incarnation(1), sequence: Seq24::new(number) },
        remaining: Ticks(60_000_000),
        contents: Contents::EMPTY,
        seal: Seal::NONE,
    }
}

/// A sink that keeps the numbers of the packets with their senders, and counts the reasons of discards.
#[derive(Default)]
pub struct Heard {
    pub numbers: Mutex<Vec<(NodeId, u32)>>,
    pub peers: Mutex<Vec<(NodeId, Incarnation, bool)>>,
    pub stopped: Mutex<Vec<NodeId>>,
    pub discards: Mutex<BTreeMap<&'static str, u64>>,
}

impl Heard {
    /// The numbers of the packets of this node, in the order in which they came.
    pub fn of(&self, node: usize) -> Vec<u32> {
        let numbers = lock(&self.numbers);
        numbers.iter().filter(|(from, _)| *from == NODES[node]).map(|(_, number)| *number).collect()
    }
}

impl Sink for Heard {
    fn packets(&self, from: NodeId, packets: &[Packet], _charge: Ticks, _at: Instant) {
        lock(&self.numbers).extend(packets.iter().map(|packet| (from, packet.id.sequence.get())));
    }

    fn peer(&self, node: NodeId, incarnation: Incarnation, restarted: bool) {
        lock(&self.peers).push((node, incarnation, restarted));
    }

    fn stopped(&self, node: NodeId) {
        lock(&self.stopped).push(node);
    }

    fn discarded(&self, reason: LinkDiscard) {
        *lock(&self.discards).entry(reason.name()).or_default() += 1;
    }
}
