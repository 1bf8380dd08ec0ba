//! The contestants: how each of them carries a command, written as its own guide shows.

use crate::ends::{COMMANDER, EXECUTOR, command, execute, listens};
use imrs_bench::duel::TTL;
use imrs_protocol::{Cell, CellTable, Incarnation, NodeId, NodeTable, PortDecl, PortId, Ticks, Usage};
use imrs_runtime::link::udp::{UdpLink, UdpOptions};
use imrs_runtime::{Builder, Runtime};
use std::sync::Arc;
use std::time::Duration;
use zenoh::Wait;
use zenoh::handlers::RingChannel;

/// One way to send commands.
pub struct Contestant {
    pub name: &'static str,
    /// Sends a stream of this length.
    pub command: fn(Duration),
    /// Executes commands until the process is killed.
    pub execute: fn(),
}

/// All contestants. Those whose commander waits for the answer come first.
pub const ALL: [Contestant; 8] = [
    Contestant { name: "imrs, class 2", command: |length| imrs(length, true), execute: || serve(true) },
    Contestant { name: "zenoh, get", command: zenoh_get, execute: zenoh_queryable },
    Contestant { name: "libzmq, REQ-REP", command: zmq_req, execute: zmq_rep },
    Contestant { name: "imrs, class 1", command: |length| imrs(length, false), execute: || serve(false) },
    Contestant { name: "zenoh, put", command: zenoh_put, execute: zenoh_subscriber },
    Contestant { name: "zenoh, put, newest only", command: zenoh_put, execute: zenoh_ring },
    Contestant { name: "libzmq, PUSH-PULL", command: |l| zmq_push(l, false), execute: || zmq_pull(false) },
    Contestant {
        name: "libzmq, PUSH-PULL, newest only",
        command: |length| zmq_push(length, true),
        execute: || zmq_pull(true),
    },
];

const PORT: PortId = PortId(0);
/// Longer than any stream.
const FOREVER: Duration = Duration::from_secs(86_400);
const KEY: &str = "robot/command";

/// The cell of two nodes: a task commands a task of the other node, whose port keeps commands for at most [`TTL`].
fn node(own: NodeId, is_class_2: bool) -> Builder {
    let mut cell = Cell::new("duel", Ticks(1));
    let (near, far) = (cell.node("near"), cell.node("far"));
    let (commander, executor) = (cell.task("commander", near), cell.task("executor", far));
    cell.link(near, far, Ticks(1_000));
    let ttl = Ticks(u64::try_from(TTL.as_micros()).expect("a short time"));
    let port = PortDecl::new("command", commander, Usage::Send, &[executor], ttl).bounded_buffer(16);
    // The guide's `retry = 2`: the copies are spread over the time_out, and the command is executed once.
    cell.port(if is_class_2 { port.command().retry(2, Ticks(ttl.0 / 3)) } else { port });
    let table = Arc::new(CellTable::new(cell).expect("a sound cell"));
    let (here, other, there) =
        if own == near { (COMMANDER, far, EXECUTOR) } else { (EXECUTOR, near, COMMANDER) };
    let options = UdpOptions::new(Incarnation(1), false);
    let link =
        UdpLink::bind(NodeTable::new(Arc::clone(&table), own), here.into(), options).expect("a socket");
    link.set_address(other, Some(there.into())).expect("a neighbour");
    Runtime::builder(table, own).incarnation(Incarnation(1), false).insecure(true).link(Arc::new(link))
}

fn imrs(length: Duration, is_class_2: bool) {
    let near = node(NodeId(0), is_class_2).task("commander", move |ctx| {
        command(length, |bytes| {
            // Whether a command without an answer was executed is unknown; the next command follows anyway.
            let _outcome = ctx.send(PORT, bytes).expect("a port of this task");
        })
    });
    let near = near.start().expect("a node that starts");
    let _ended = near.wait(FOREVER);
}

fn serve(is_class_2: bool) {
    let far = node(NodeId(1), is_class_2).task("executor", move |ctx| {
        while let Some(message) = ctx.receive(Some(PORT), None)? {
            execute(message.contents.as_bytes());
            if is_class_2 {
                // The answer may be too late for the commander, which is no error here.
                let _late = ctx.reply(&message.from, b"done");
            }
        }
        Ok(())
    });
    let far = far.start().expect("a node that starts");
    listens();
    let _ended = far.wait(FOREVER);
}

/// A zenoh peer that knows the other one's address and does not search for others.
fn session(listen: &str, connect: &str) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"peer\""),
        ("scouting/multicast/enabled", "false"),
        ("listen/endpoints", listen),
        ("connect/endpoints", connect),
    ] {
        config.insert_json5(key, value).expect("a setting");
    }
    zenoh::open(config).wait().expect("a session")
}

fn zenoh_near() -> zenoh::Session {
    session("[]", &format!("[\"tcp/{EXECUTOR}\"]"))
}

fn zenoh_far() -> zenoh::Session {
    session(&format!("[\"tcp/{EXECUTOR}\"]"), "[]")
}

fn zenoh_get(length: Duration) {
    let session = zenoh_near();
    command(length, |bytes| {
        let replies = session.get(KEY).payload(&bytes[..]).timeout(TTL).wait().expect("asked");
        while replies.recv().is_ok() {}
    });
}

fn zenoh_queryable() {
    let session = zenoh_far();
    let queryable = session.declare_queryable(KEY).wait().expect("a queryable");
    listens();
    while let Ok(query) = queryable.recv() {
        execute(&query.payload().expect("a command").to_bytes());
        query.reply(KEY, "done").wait().expect("answered");
    }
}

fn zenoh_put(length: Duration) {
    let session = zenoh_near();
    let publisher = session.declare_publisher(KEY).wait().expect("a publisher");
    command(length, |bytes| publisher.put(&bytes[..]).wait().expect("sent"));
}

fn zenoh_subscriber() {
    let session = zenoh_far();
    let subscriber = session.declare_subscriber(KEY).wait().expect("a subscriber");
    listens();
    while let Ok(sample) = subscriber.recv() {
        execute(&sample.payload().to_bytes());
    }
}

fn zenoh_ring() {
    let session = zenoh_far();
    let subscriber = session.declare_subscriber(KEY).with(RingChannel::new(1)).wait().expect("a subscriber");
    listens();
    while let Ok(sample) = subscriber.recv() {
        execute(&sample.payload().to_bytes());
    }
}

/// A socket of libzmq that does not wait for its messages to leave when it is closed.
fn socket(context: &zmq::Context, kind: zmq::SocketType, is_newest: bool) -> zmq::Socket {
    let socket = context.socket(kind).expect("a socket");
    socket.set_linger(0).expect("an option");
    if is_newest {
        socket.set_conflate(true).expect("an option");
    }
    socket
}

/// The reliable client of the guide ("Lazy Pirate"): if an answer is late, the client closes its socket and connects
/// a new one. It does not send the old command again, because that command is worthless by then.
fn zmq_req(length: Duration) {
    let context = zmq::Context::new();
    let connected = || {
        let socket = socket(&context, zmq::REQ, false);
        socket.connect(&format!("tcp://{EXECUTOR}")).expect("an address");
        socket
    };
    let mut near = connected();
    let ttl = i64::try_from(TTL.as_millis()).expect("a short time");
    command(length, |bytes| {
        near.send(&bytes[..], 0).expect("sent");
        if near.poll(zmq::POLLIN, ttl).expect("polled") > 0 {
            near.recv_bytes(0).expect("an answer");
        } else {
            near = connected();
        }
    });
}

fn zmq_rep() {
    let context = zmq::Context::new();
    let far = socket(&context, zmq::REP, false);
    far.bind(&format!("tcp://{EXECUTOR}")).expect("an address");
    listens();
    loop {
        execute(&far.recv_bytes(0).expect("a command"));
        far.send("done", 0).expect("answered");
    }
}

fn zmq_push(length: Duration, is_newest: bool) {
    let context = zmq::Context::new();
    let near = socket(&context, zmq::PUSH, is_newest);
    near.connect(&format!("tcp://{EXECUTOR}")).expect("an address");
    command(length, |bytes| near.send(&bytes[..], 0).expect("sent"));
}

fn zmq_pull(is_newest: bool) {
    let context = zmq::Context::new();
    let far = socket(&context, zmq::PULL, is_newest);
    far.bind(&format!("tcp://{EXECUTOR}")).expect("an address");
    listens();
    loop {
        execute(&far.recv_bytes(0).expect("a command"));
    }
}
