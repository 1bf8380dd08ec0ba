//! Measures what keys between nodes cost (D191): traffic with keys beside the same traffic without, and the refusal
//! of each kind of forged datagram.

use super::cells;
use super::network::{ASLEEP, Asking, COALESCED, Closing, ask, one_way, started, two_links, two_nodes};
use super::urgent::WINDOW;
use crate::cores::{self, Core};
use crate::harness::Spread;
use crate::sample::Sample;
use crate::suite::{Effort, Goal, Row, Stat, Suite};
use imrs_protocol::{
    Class, Contents, Incarnation, Kind, MAX_HOPS, MessageId, NodeId, Packet, PortId, Seal, Seq24, Ticks,
    Usage,
};
use imrs_runtime::link::udp::UdpLink;
use imrs_runtime::link::udp::keys::{NodeKeys, draw_cell_key, draw_node_keys};
use imrs_runtime::link::{Link, LinkDiscard, Sink};
use imrs_runtime::{Context, Runtime};
use imrs_wire::envelope::MAX_PACKETS;
use std::collections::BTreeMap;
use std::net::{Ipv4Addr, UdpSocket};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

const NODES: [NodeId; 2] = [NodeId(0), NodeId(1)];
/// How many forged datagrams the socket contains when the link begins to refuse them. More would count as a flood,
/// after which the link pauses.
const WAITING: usize = 15;
/// How long the link waits for further datagrams.
const SHORT: Duration = Duration::from_millis(20);

/// The kinds of forged datagrams, by the work that it takes to refuse them.
#[derive(Clone, Copy)]
enum Forged {
    /// The index belongs to a session, but the tag is wrong.
    Tag,
    /// The index belongs to no session.
    Index,
    /// The datagram is the first one of a handshake, encrypted with another cell's key.
    Hello,
    /// The datagram has no keys, and its checksum is wrong.
    Checksum,
}

/// Adds the cases and rows about keys to the suite.
pub fn join(mut suite: Suite) -> Suite {
    suite.case(
        "keys/UDP one core",
        "as runtime/UDP, with keys: each datagram is encrypted, with one tag",
        |effort| ask(effort, Core::First, Asking { closing: Closing::Keys, ..ASLEEP }),
    );
    suite.case(
        IN_TURNS,
        "the round trips of keys/UDP and of runtime/UDP in turns of 50, so that other programs and the state of the cores meet both alike; counts how many times the median of a turn without keys the median of the turn with keys after it is, and takes the median of these ratios",
        in_turns,
    );
    suite.case("keys/UDP one way", "as runtime/UDP one way, with keys", |effort| {
        one_way(effort, COALESCED as u64, WINDOW, Closing::Keys)
    });
    let about = "a node takes forged datagrams from its socket, 15 at a time, and drops them; nanoseconds per datagram, most of them for the kernel";
    for (name, forged, packets) in [
        ("refuse/checksum, 1 packet", Forged::Checksum, 1),
        ("refuse/tag, 1 packet", Forged::Tag, 1),
        ("refuse/checksum, 44 packets", Forged::Checksum, MAX_PACKETS),
        ("refuse/tag, 44 packets", Forged::Tag, MAX_PACKETS),
        ("refuse/index", Forged::Index, 1),
        ("refuse/hello", Forged::Hello, 1),
    ] {
        suite.case(name, about, move |effort| refused(effort, forged, packets));
    }
    let p15 = |subject, against, stat, goal| Row::new("P15", subject, against, stat, goal);
    let (one, what) = ("keys/UDP one core", "keys/UDP : runtime/UDP, in turns of 50, two cores");
    suite.row(Row::bounded("P15", what, IN_TURNS, Stat::Count, Goal::AtMost(1.05)));
    suite.row(p15(one, "runtime/UDP one core", Stat::P50, Goal::AtMost(1.2)));
    suite.row(p15("keys/UDP one way", "runtime/UDP one way", Stat::Mean, Goal::AtMost(1.5)));
    let (tag, checksum) = ("refuse/tag, 1 packet", "refuse/checksum, 1 packet");
    suite.row(p15(tag, checksum, Stat::Mean, Goal::AtMost(1.5)));
    suite.row(p15("refuse/index", checksum, Stat::Mean, Goal::AtMost(1.1)));
    suite
}

/// The case that decides what keys cost a round trip on two cores. Two runs one after the other differ by a quarter in either
/// direction on a shared machine (D191), so their ratio cannot show a difference of one part in twenty.
const IN_TURNS: &str = "keys/UDP in turns, two cores";
/// How many round trips a turn has: about two milliseconds, and far more than the tasks need to get warm again.
const TURN: u32 = 50;

/// Two nodes between which one task makes a turn of round trips each time that it is told to.
struct Pair {
    nodes: [Runtime; 2],
    begin: Sender<()>,
    took: Receiver<Sample>,
}

impl Pair {
    fn start(closing: Closing) -> Self {
        let table = cells::asking(2, Usage::Send);
        let [a, b] = two_nodes(&table, closing).map(|node| node.spin(Duration::ZERO));
        let ((begin, begins), (tell, took)) = (channel(), channel());
        let turns = move |ctx: &mut Context| {
            while begins.recv().is_ok() {
                tell.send(cells::ask(ctx, &cells::FULL, TURN, 1)?).expect("the harness listens");
            }
            Ok(())
        };
        let nodes = started([a.task("t0", turns), b.task("t1", cells::answer)], Core::Second);
        Self { nodes, begin, took }
    }

    /// The median time of a round trip in the next turn.
    fn turn(&self) -> f64 {
        self.begin.send(()).expect("the task waits");
        self.took.recv().expect("the task told what it measured").p50
    }

    fn stop(self) {
        drop(self.begin);
        self.nodes.into_iter().for_each(cells::stop);
    }
}

fn in_turns(effort: Effort) -> Sample {
    let pairs = [Closing::Checksum, Closing::Keys].map(Pair::start);
    let ratios = (0..effort.of(60)).map(|_| {
        let [plain, keyed] = pairs.each_ref().map(Pair::turn);
        keyed / plain
    });
    let ratio = Spread::of(ratios.collect()).expect("a turn");
    pairs.into_iter().for_each(Pair::stop);
    cores::unpin();
    Sample::counted(ratio.median)
}

/// The two links with keys of one cell.
pub fn with_keys(links: [UdpLink; 2]) -> [UdpLink; 2] {
    let cell = draw_cell_key().expect("random numbers");
    let pairs = NODES.map(|node| (node, draw_node_keys().expect("random numbers")));
    let publics: BTreeMap<_, _> = pairs.iter().map(|(node, (_, public))| (*node, *public)).collect();
    let mut own = pairs.into_iter().map(|(_, (private, _))| private);
    links.map(|link| {
        let private = own.next().expect("as many as links");
        link.with_keys(&NodeKeys::new(cell.clone(), private, publics.clone())).expect("all keys")
    })
}

/// A sink that counts what its link drops.
#[derive(Default)]
struct Dropped(AtomicUsize);

impl Sink for Dropped {
    fn packets(&self, _from: NodeId, _packets: &[Packet], _charge: Ticks, _at: Instant) {}
    fn peer(&self, _node: NodeId, _incarnation: Incarnation, _restarted: bool) {}
    fn discarded(&self, _reason: LinkDiscard) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

const PACKET: Packet = Packet {
    kind: Kind::Send,
    class: Class::Status,
    more: false,
    resent: false,
    hops: MAX_HOPS,
    fragment: 0,
    destination: cells::B,
    source: cells::A,
    port: PortId(0),
    id: MessageId { incarnation: Incarnation(1), sequence: Seq24::new(1) },
    remaining: Ticks(60_000_000),
    contents: Contents::EMPTY,
    seal: Seal::NONE,
};

/// Intercepts a genuine datagram from the first node to the second: a datagram of a session, or the first one of a handshake.
fn taken(links: &[UdpLink; 2], packets: usize, is_hello: bool) -> Vec<u8> {
    let [a, b] = links;
    let (sink, mut bytes) = (Dropped::default(), vec![0; 2_048]);
    while !is_hello && !a.ready(NODES[1]) {
        for link in [a, b] {
            link.poll(&sink, Some(Instant::now() + Duration::from_millis(1)));
        }
    }
    let between = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a socket");
    a.set_address(NODES[1], between.local_addr().ok()).expect("a neighbour");
    if is_hello {
        a.ready(NODES[1]);
    } else {
        a.send(NODES[1], &vec![PACKET; packets]).expect("it is ready");
    }
    let length = between.recv(&mut bytes).expect("a datagram");
    bytes.truncate(length);
    bytes
}

fn refused(effort: Effort, forged: Forged, packets: usize) -> Sample {
    let closing = if matches!(forged, Forged::Checksum) { Closing::Checksum } else { Closing::Keys };
    let links = two_links(&cells::asking(2, Usage::Send), closing);
    let mut bytes = taken(&links, packets, matches!(forged, Forged::Hello));
    match forged {
        // The upper half of a session index is the number of a neighbour. Only the lower half is changed.
        Forged::Index => bytes[6] ^= 1,
        Forged::Tag | Forged::Hello | Forged::Checksum => *bytes.last_mut().expect("a tag") ^= 1,
    }
    let [_, b] = links;
    let (sink, from) = (Dropped::default(), UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a socket"));
    let (times, mut done, mut elapsed) = (effort.of(10_000) as usize, 0, Duration::ZERO);
    cores::pin(Core::First);
    while done < times {
        for _ in 0..WAITING {
            from.send_to(&bytes, b.local_address()).expect("sent");
        }
        let begin = Instant::now();
        while sink.0.load(Ordering::Relaxed) < done + WAITING && begin.elapsed() < SHORT {
            b.poll(&sink, Some(begin + SHORT));
        }
        elapsed += begin.elapsed();
        done = sink.0.load(Ordering::Relaxed);
    }
    cores::unpin();
    Sample::of_all(elapsed, done as u64)
}
