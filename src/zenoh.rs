//! `imrs zenoh`: carries the datagrams of one node over zenoh (D211).
//!
//! The gateway binds the addresses of the node's neighbours on this machine's loopback. It publishes each datagram of
//! the node unchanged, under a zenoh key for the two nodes, and passes each datagram of a neighbour to the node. The
//! gateway has no encryption keys and stores no datagram. Zenoh may drop, delay or repeat datagrams, because the
//! receiving node checks their clocks and tags itself.

use crate::args::ZenohArgs;
use crate::exit::Exit;
use crate::failure::Failure;
use crate::names::did_you_mean;
use crate::output::{Output, complain};
use imrs_client::place;
use imrs_launch::LaunchError;
use imrs_launch::cells::{self, Loaded};
use imrs_protocol::NodeId;
use imrs_wire::envelope::keyed;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::fmt::Display;
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::thread;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority, Reliability};
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Config, Session, Wait};

/// The size of the receive buffer, in bytes: no datagram of a node is so long.
const ROOM: usize = 2_048;

/// What the gateway's threads report to the thread that prints.
enum Event {
    /// A neighbour's gateway has appeared, or has gone. This is only a hint: the nodes find out themselves whether
    /// they can communicate.
    Neighbour(String, bool),
    /// A signal asks the gateway to end.
    End,
}

/// How many datagrams the gateway has handled.
#[derive(Default)]
struct Counts {
    /// Datagrams of the node that were passed to zenoh, which may still drop them.
    out: AtomicU64,
    /// Datagrams of neighbours that were passed to the node's socket.
    into: AtomicU64,
    /// Datagrams of the node that were not carried because they are not encrypted.
    refused: AtomicU64,
    /// Datagrams that zenoh or the node's socket refused.
    failed: AtomicU64,
}

/// Carries datagrams until a signal ends it.
///
/// # Errors
/// [`Failure::Usage`]: the cell has no such node, an address is not on the loopback or is in use, or zenoh cannot be
/// opened with this configuration.
pub fn run(args: &ZenohArgs, out: &mut Output) -> Result<Exit, Failure> {
    let (_, loaded) = cells::open(&args.cell, false)?;
    let nodes = &loaded.table.cell().nodes;
    let node = nodes.iter().position(|node| node.name == args.node).map(NodeId::from_index);
    let node = node.ok_or_else(|| {
        let hint = did_you_mean(&args.node, nodes.iter().map(|node| node.name.as_str()));
        Failure::Usage(format!("the cell has no node `{}`{hint}", args.node))
    })?;
    let config = match &args.config {
        Some(file) => Config::from_file(file).map_err(|why| usage(file.display(), why))?,
        None => Config::default(),
    };
    let sockets = sockets(&loaded, node)?;
    let session = zenoh::open(config).wait().map_err(|why| usage("zenoh", why))?;
    let (tell, events) = channel();
    let counts = Arc::<Counts>::default();
    let own = &args.node;
    let area = format!("imrs/{:08x}", loaded.table.digest());
    for (neighbour, socket) in sockets {
        let keys = [format!("{area}/{own}/{neighbour}"), format!("{area}/{neighbour}/{own}")];
        carry(&session, keys, Arc::new(socket), args.insecure, &counts).map_err(|why| usage("zenoh", why))?;
        watch(&session, format!("{area}/{neighbour}"), neighbour, tell.clone())
            .map_err(|why| usage("zenoh", why))?;
    }
    let liveliness = session.liveliness();
    let _here =
        liveliness.declare_token(format!("{area}/{own}")).wait().map_err(|why| usage("zenoh", why))?;
    end_by_signal(tell)?;
    out.line(format_args!("node {own}: its datagrams go over zenoh, on {area}"))?;
    for event in events {
        match event {
            Event::Neighbour(name, true) => out.line(format_args!("node {name}: its gateway is there"))?,
            Event::Neighbour(name, false) => out.line(format_args!("node {name}: its gateway is gone"))?,
            Event::End => break,
        }
    }
    let count = |of: &AtomicU64| of.load(Ordering::Relaxed);
    let Counts { out: went, into, refused, failed } = &*counts;
    out.line(format_args!(
        "node {own}: {} datagrams went out, {} came in, {} had no keys, {} were not taken",
        count(went),
        count(into),
        count(refused),
        count(failed)
    ))?;
    Ok(Exit::Well)
}

fn usage(what: impl Display, why: impl Display) -> Failure {
    Failure::Usage(format!("{what}: {why}"))
}

/// For each neighbour of the node, a socket at the neighbour's address. It exchanges datagrams with the node only.
fn sockets(loaded: &Loaded, node: NodeId) -> Result<Vec<(String, UdpSocket)>, Failure> {
    let own = place::address(loaded, node).map_err(LaunchError::from)?;
    let neighbours = place::neighbours(loaded, node).map_err(LaunchError::from)?;
    let name = &loaded.table.cell().nodes[node.index()].name;
    let on_loopback = |name: &str, address: SocketAddr| {
        if address.ip().is_loopback() {
            return Ok(());
        }
        Err(Failure::Usage(format!(
            "node `{name}` is declared at {address}: over zenoh, declare each node at a port of 127.0.0.1, where on each machine the node itself or the gateway is; the addresses of the machines are in zenoh's configuration"
        )))
    };
    on_loopback(name, own)?;
    let bound = |(name, address): (String, SocketAddr)| {
        on_loopback(&name, address)?;
        let socket = UdpSocket::bind(address).and_then(|socket| socket.connect(own).map(|()| socket));
        let socket =
            socket.map_err(|why| usage(format_args!("the address {address} of node {name}"), why))?;
        Ok((name, socket))
    };
    neighbours.into_iter().map(bound).collect()
}

/// Carries the datagrams between the node and one neighbour, with one zenoh key for each direction.
fn carry(
    session: &Session,
    [out, into]: [String; 2],
    socket: Arc<UdpSocket>,
    insecure: bool,
    counts: &Arc<Counts>,
) -> zenoh::Result<()> {
    let publisher = session
        .declare_publisher(out)
        // A message's time to live runs on while its datagram waits. So zenoh drops datagrams that it cannot send at
        // once, and batches none.
        .congestion_control(CongestionControl::Drop)
        .reliability(Reliability::BestEffort)
        .priority(Priority::RealTime)
        .express(true)
        .wait()?;
    let (node, arrived) = (Arc::clone(&socket), Arc::clone(counts));
    let hand_over = move |sample: Sample| {
        let handed = node.send(&sample.payload().to_bytes());
        (if handed.is_ok() { &arrived.into } else { &arrived.failed }).fetch_add(1, Ordering::Relaxed);
    };
    session.declare_subscriber(into).callback(hand_over).background().wait()?;
    let counts = Arc::clone(counts);
    thread::Builder::new()
        .name("imrs carries".into())
        .spawn(move || put_all(&publisher, &socket, insecure, &counts))?;
    Ok(())
}

/// Publishes each datagram that the node sends.
fn put_all(publisher: &Publisher<'_>, socket: &UdpSocket, insecure: bool, counts: &Counts) {
    static TOLD: AtomicBool = AtomicBool::new(false);
    let mut room = [0; ROOM];
    loop {
        // The node is not running, or a signal interrupted the call.
        let Ok(length) = socket.recv(&mut room) else { continue };
        let datagram = &room[..length];
        let count = if !insecure && keyed::read(datagram).is_err() {
            if !TOLD.swap(true, Ordering::Relaxed) {
                complain(
                    "the node sends datagrams without keys, which are not carried: start it with keys (`imrs keygen`), or accept forgeries with --insecure",
                );
            }
            &counts.refused
        } else if publisher.put(datagram).wait().is_ok() {
            &counts.out
        } else {
            &counts.failed
        };
        count.fetch_add(1, Ordering::Relaxed);
    }
}

/// Reports when a neighbour's gateway appears or goes.
fn watch(session: &Session, token: String, name: String, tell: Sender<Event>) -> zenoh::Result<()> {
    let changed = move |sample: Sample| {
        // If the receiver is gone, this process ends.
        let _ = tell.send(Event::Neighbour(name.clone(), sample.kind() == SampleKind::Put));
    };
    session.liveliness().declare_subscriber(token).history(true).callback(changed).background().wait()
}

fn end_by_signal(tell: Sender<Event>) -> Result<(), Failure> {
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP]).map_err(LaunchError::Start)?;
    let wait = move || {
        signals.forever().next();
        let _ = tell.send(Event::End);
    };
    thread::Builder::new().name("imrs signals".into()).spawn(wait).map_err(LaunchError::Start)?;
    Ok(())
}
