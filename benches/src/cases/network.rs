//! Measures messages between two nodes over UDP on the loopback (goals P11, P12).

use super::cells::{self, LONG_TICKS};
use super::floors;
use super::keys;
use super::recording::{Onlooker, Watched};
use super::urgent::WINDOW;
use crate::cores::{self, Core};
use crate::sample::Sample;
use crate::suite::{Effort, Goal, Row, Stat, Suite};
use imrs_protocol::{CellTable, Incarnation, NodeId, NodeTable, PortDecl, PortId, Usage};
use imrs_runtime::link::udp::{UdpLink, UdpOptions};
use imrs_runtime::{Builder, Context, MANY, Runtime, SPIN};
use nix::sys::socket::{setsockopt, sockopt};
use std::net::{Ipv4Addr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

/// How many packets of 32 bytes the baseline of goal P12 puts into one datagram.
pub const COALESCED: usize = 43;
/// How long a one-way message may be delayed so that later messages share its datagram: not at all. Messages share a
/// datagram only if a task sent them in one `together`, or if they wait anyway.
pub const HELD_BACK: Duration = Duration::ZERO;
/// How many datagrams one system call sends, if the kernel divides the data into datagrams (GSO).
const SEGMENTS: usize = 4;

/// How many packets such a call sends.
const BURST: u64 = (COALESCED * SEGMENTS) as u64;

/// The suite of round trips and streams over UDP.
#[must_use]
pub fn network() -> Suite {
    let mut suite = Suite::new("network");
    for (name, other) in [("one core", Core::First), ("two cores", Core::Second)] {
        suite.case(
            format!("floor/UDP {name}"),
            "32 bytes there and back between two threads asleep in their sockets, with a time_out; plain",
            move |effort| floors::udp(effort, 1_500, other, false),
        );
        suite.case(
            format!("floor/TCP {name}"),
            "32 bytes there and back over one connection between two threads asleep in their sockets, with a time_out and TCP_NODELAY; plain",
            move |effort| floors::tcp(effort, 1_500, other),
        );
        suite.case(
            format!("runtime/UDP {name}"),
            "send, receive, reply between Rust tasks of two nodes of one process, each asleep in its socket before every message (spin budget 0), deadline in the packet, checksum mode",
            move |effort| ask(effort, other, ASLEEP),
        );
        suite.case(
            format!("runtime/UDP as they are {name}"),
            "the same in checksum mode, with the spin budget that a node has unless told otherwise",
            move |effort| ask(effort, other, Asking { spin: SPIN, ..ASLEEP }),
        );
        suite.case(
            format!("runtime/UDP together {name}"),
            "as runtime/UDP, and both tasks send everything `together`: each lone message leaves as soon as its task waits",
            move |effort| ask(effort, other, Asking { together: true, ..ASLEEP }),
        );
    }
    suite.case("floor/UDP spinning", "32 bytes there and back, two hot threads, two cores", |effort| {
        floors::udp(effort, 3_000, Core::Second, true)
    });
    suite.case(
        "floor/UDP one way, 43 a datagram",
        "packets of 32 bytes, 43 to a datagram, between two threads on two cores; nanoseconds per packet",
        |effort| coalesced(effort, 1),
    );
    if cuts_segments() {
        suite.case(
            "floor/UDP one way, 43 a datagram, segmented",
            "the same, four datagrams to a call: the kernel cuts them (UDP_SEGMENT), and puts them together for the receiver (UDP_GRO)",
            |effort| coalesced(effort, SEGMENTS),
        );
    }
    messages_one_way(&mut suite);
    let (one, two) = ("runtime/UDP one core", "runtime/UDP two cores");
    suite.row(Row::new("P11", one, "floor/UDP one core", Stat::P50, Goal::AtMost(1.5)).was("<= 1.2"));
    suite.row(Row::new("P11", two, "floor/UDP two cores", Stat::P50, Goal::AtMost(1.3)).was("<= 1.15"));
    suite.row(Row::new("P11", one, "floor/TCP one core", Stat::P50, Goal::AtMost(1.2)));
    suite.row(Row::new("P11", two, "floor/TCP two cores", Stat::P50, Goal::AtMost(1.15)));
    suite.row(Row::new("P11", "runtime/UDP as they are one core", one, Stat::P50, Goal::AtMost(1.05)));
    let awake = "runtime/UDP as they are two cores";
    suite.row(Row::new("P11", awake, "floor/UDP spinning", Stat::P50, Goal::AtMost(1.3)));
    keys::join(suite)
}

/// Adds the runtime's cases and the rows about messages that go one way, and about what sending together costs a lone
/// message (goal P12).
fn messages_one_way(suite: &mut Suite) {
    suite.case(
        "runtime/UDP one way",
        "class-1 messages from a task to one of another node, sent 43 together, taken as many at once as are there, at most 256 under way; nanoseconds per message",
        |effort| one_way(effort, COALESCED as u64, WINDOW, Closing::Checksum),
    );
    suite.case(
        "runtime/UDP one way, 172 together",
        "the same, sent 172 together, which leave in one call where the kernel cuts it into datagrams, at most 428 under way (as much as the floor that does so may have)",
        |effort| one_way(effort, BURST, WINDOW + BURST, Closing::Checksum),
    );
    suite.case(
        "runtime/UDP one way, each alone",
        "the same, each message sent by itself: a datagram each",
        |effort| one_way(effort, 1, WINDOW, Closing::Checksum),
    );
    let (stream, floor) = ("runtime/UDP one way", "floor/UDP one way, 43 a datagram");
    suite.row(Row::new("P12", stream, floor, Stat::Mean, Goal::AtLeast(0.8)));
    let together = "runtime/UDP one way, 172 together";
    suite.row(Row::new("P12", together, floor, Stat::Mean, Goal::AtLeast(1.1)).was(">= 1.5"));
    // This row shows how much sending several datagrams in one call saves at most (D129).
    let segmented = "floor/UDP one way, 43 a datagram, segmented";
    suite.row(Row::new("P12", segmented, floor, Stat::Mean, Goal::AtLeast(1.0)));
    for name in ["one core", "two cores"] {
        let (together, alone) = (format!("runtime/UDP together {name}"), format!("runtime/UDP {name}"));
        suite.row(Row::new("P12", together, &alone, Stat::P50, Goal::AtMost(1.03)));
    }
}

/// How the datagrams between two nodes are protected.
#[derive(Clone, Copy)]
pub enum Closing {
    /// A checksum protects each datagram.
    Checksum,
    /// Keys of both nodes protect each datagram.
    Keys,
}

/// The links of two nodes that know each other's addresses.
pub fn two_links(table: &Arc<CellTable>, closing: Closing) -> [UdpLink; 2] {
    let bind = |node| {
        let options = UdpOptions::new(Incarnation(1), false);
        let table = NodeTable::new(Arc::clone(table), node);
        UdpLink::bind(table, (Ipv4Addr::LOCALHOST, 0).into(), options).expect("a socket")
    };
    let nodes = [NodeId(0), NodeId(1)];
    let links = nodes.map(bind);
    let links = match closing {
        Closing::Checksum => links,
        Closing::Keys => keys::with_keys(links),
    };
    for (link, other) in [(0, 1), (1, 0)] {
        let address = Some(links[other].local_address());
        links[link].set_address(nodes[other], address).expect("a neighbour");
    }
    links
}

/// The builders of the two nodes.
pub fn two_nodes(table: &Arc<CellTable>, closing: Closing) -> [Builder; 2] {
    let mut nodes = [NodeId(0), NodeId(1)].into_iter();
    two_links(table, closing).map(|link| {
        let node = nodes.next().expect("as many as links");
        Runtime::builder(Arc::clone(table), node).incarnation(Incarnation(1), false).link(Arc::new(link))
    })
}

/// The settings of a measurement of round trips between two nodes.
#[derive(Clone, Copy)]
pub struct Asking {
    /// Whether the nodes are recorded or observed.
    pub how: Watched,
    /// How long the tasks spin before they sleep.
    pub spin: Duration,
    /// How the datagrams are protected.
    pub closing: Closing,
    /// Whether the tasks send everything `together`.
    pub together: bool,
}

/// The tasks sleep before every message. The nodes are neither recorded nor observed, and have no keys.
pub const ASLEEP: Asking =
    Asking { how: Watched::Not, spin: Duration::ZERO, closing: Closing::Checksum, together: false };

/// Starts the asking node on the first core, and the answering one on `other`. A node's own threads run on the core of
/// the thread that starts the node.
pub fn started([asking, answering]: [Builder; 2], other: Core) -> [Runtime; 2] {
    cores::pin(other);
    let answering = answering.start().expect("a node that starts");
    cores::pin(Core::First);
    [asking.start().expect("a node that starts"), answering]
}

/// Measures round trips between two nodes over UDP. The tasks run on the first core and on `other`.
pub fn ask(effort: Effort, other: Core, asking: Asking) -> Sample {
    let Asking { how, spin, closing, together } = asking;
    let table = cells::asking(2, Usage::Send);
    let [a, b] = two_nodes(&table, closing).map(|node| node.spin(spin));
    let mut onlookers = [NodeId(0), NodeId(1)].map(|node| Onlooker::of(how, &table, node));
    let (a, b) = (onlookers[0].told_by(a), onlookers[1].told_by(b));
    let (tell, told) = channel();
    let times = effort.of(1_500);
    let answer =
        move |ctx: &mut Context| if together { ctx.together(cells::answer) } else { cells::answer(ctx) };
    let measure = move |ctx: &mut Context| {
        let ask = |ctx: &mut Context| cells::ask(ctx, &cells::FULL, times, 1);
        let sample = if together { ctx.together(ask) } else { ask(ctx) };
        tell.send(sample?).expect("the harness listens");
        Ok(())
    };
    let [a, b] = started([a.task("t0", measure), b.task("t1", answer)], other);
    onlookers.iter_mut().zip([&a, &b]).for_each(|(onlooker, node)| onlooker.look(how, node));
    let sample = cells::hear(a, &told);
    cells::stop(b);
    onlookers.into_iter().for_each(Onlooker::leave);
    cores::unpin();
    sample
}

/// Measures class-1 messages from one node to another. `together` messages are sent at once, and at most `window` are
/// in flight.
pub fn one_way(effort: Effort, together: u64, window: u64, closing: Closing) -> Sample {
    let mut cell = cells::cell(2, 2);
    let decl = PortDecl::new("news", cells::A, Usage::Send, &[cells::B], LONG_TICKS);
    cell.port(decl.bounded_buffer(u16::try_from(window).expect("few")));
    let [a, b] = two_nodes(&cells::table(cell), closing);
    let times = u64::from(effort.of(30_000));
    let taken = Arc::new(AtomicU64::new(0));
    let other = Arc::clone(&taken);
    let (tell, told) = channel();
    cores::pin(Core::First);
    let b = b.task("t1", move |ctx| {
        let (mut begins, mut count, mut messages) = (None, 0, Vec::with_capacity(MANY));
        // A datagram that the kernel drops must not block the measurement, so the sender counts the messages that arrived.
        while ctx.receive_many(None, &mut messages, MANY, None)? > 0 {
            let begins = *begins.get_or_insert_with(Instant::now);
            let before = count;
            count += messages.len() as u64;
            messages.clear();
            other.store(count, Ordering::Release);
            if before < times && count >= times {
                tell.send(Sample::of_all(begins.elapsed(), count)).expect("the harness listens");
            }
        }
        Ok(())
    });
    let b = b.start().expect("a node that starts");
    cores::pin(Core::Second);
    let a = a.task("t0", move |ctx| {
        let mut sent = 0;
        let mut last = Instant::now();
        let mut written_off = 0;
        while taken.load(Ordering::Acquire) < times {
            let under_way = (sent - written_off) - taken.load(Ordering::Acquire).min(sent - written_off);
            if under_way + together <= window {
                ctx.together(|ctx| {
                    (0..together).try_for_each(|_| ctx.send(PortId(0), &cells::FULL).map(|_copies| ()))
                })?;
                (sent, last) = (sent + together, Instant::now());
            } else if last.elapsed() > Duration::from_millis(20) {
                written_off += under_way;
            } else {
                std::thread::yield_now();
            }
        }
        Ok(())
    });
    let a = a.start().expect("a node that starts");
    let sample = cells::hear(b, &told);
    cells::stop(a);
    cores::unpin();
    sample
}

/// Whether the kernel cuts sent data into datagrams, and merges datagrams that arrive (GSO and GRO).
fn cuts_segments() -> bool {
    let takes = || {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).ok()?;
        setsockopt(&socket, sockopt::UdpGsoSegment, &32).ok()?;
        setsockopt(&socket, sockopt::UdpGroSegment, &true).ok()
    };
    takes().is_some()
}

/// Measures the baseline of goal P12, with `segments` datagrams in each call.
fn coalesced(effort: Effort, segments: usize) -> Sample {
    let socket = || {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a socket");
        socket.set_read_timeout(Some(Duration::from_millis(20))).expect("an option");
        socket
    };
    let (a, b) = (socket(), socket());
    a.connect(b.local_addr().expect("bound")).expect("an address");
    if segments > 1 {
        let size = i32::try_from(32 * COALESCED).expect("a datagram");
        setsockopt(&a, sockopt::UdpGsoSegment, &size).expect("an option of the kernel's since 4.18");
        setsockopt(&b, sockopt::UdpGroSegment, &true).expect("an option of the kernel's since 5.0");
    }
    let packets = (COALESCED * segments) as u64;
    let calls = u64::from(effort.of(120_000)) / packets;
    let bytes = 32 * COALESCED * segments;
    let taken = AtomicU64::new(0);
    let elapsed = std::thread::scope(|s| {
        let taken = &taken;
        s.spawn(move || {
            cores::pin(Core::Second);
            let contents = vec![7; bytes];
            for sent in 0..calls {
                // At most as many packets are in flight as the window of messages allows.
                while (sent * packets).saturating_sub(taken.load(Ordering::Acquire)) > WINDOW {
                    std::thread::yield_now();
                }
                a.send(&contents).expect("sent");
            }
        });
        cores::pin(Core::First);
        let begins = Instant::now();
        let mut buffer = vec![0; bytes + 1];
        while taken.load(Ordering::Acquire) < calls * packets {
            // The loopback loses no datagram as long as fewer bytes are in flight than the socket's buffer
            // holds.
            if let Ok(length) = b.recv(&mut buffer) {
                taken.fetch_add(length as u64 / 32, Ordering::Release);
            }
        }
        begins.elapsed()
    });
    cores::unpin();
    Sample::of_all(elapsed, calls * packets)
}
