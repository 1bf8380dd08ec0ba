//! Measures messaging systems that send over a network, and that people might use in place of imrs: libzmq, nng and zenoh.
//! libzmq and nng are C libraries, built from source.

use crate::cases::network::HELD_BACK;
use crate::cores::{self, Core};
use crate::sample::{Sample, nanos_of};
use crate::suite::{Effort, Goal, Row, Stat, Suite};
use std::net::TcpListener;
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};
use zenoh::Wait;

/// How many round trips are made before anything is timed.
const WARM: u32 = 50;
/// The contents of questions and answers.
const BYTES: [u8; 32] = [7; 32];
/// How long the connecting side waits before it checks again whether the other side is there.
const LOOK: Duration = Duration::from_millis(5);

// All three systems are compared without a delay for collecting messages. zenoh has a setting for this delay. libzmq
// and the runtime have none and never delay a message: libzmq switches the kernel's delay off (TCP_NODELAY), and the
// runtime sends at the end of `together`.
const _: () = assert!(HELD_BACK.is_zero(), "libzmq and the runtime have no setting for another delay");

/// Adds these libraries to a suite.
pub fn join(suite: &mut Suite) {
    if suite.name != "network" {
        return;
    }
    for (name, other) in [("one core", Core::First), ("two cores", Core::Second)] {
        let one = other == Core::First;
        let mut peer = |name: String, about, least, run: fn(u32, Core) -> Sample| {
            suite.case(name.clone(), about, move |effort| run(effort.of(1_000), other));
            let own = if one { "runtime/UDP one core" } else { "runtime/UDP two cores" };
            suite.row(Row::new("P11", own, &name, Stat::P50, Goal::AtLeast(least)));
        };
        peer(
            format!("libzmq/REQ-REP {name}"),
            "32 bytes there and back, REQ and REP over TCP on the loopback, a thread and a context at each end",
            if one { 3.5 } else { 1.3 },
            libzmq,
        );
        peer(
            format!("nng/REQ-REP {name}"),
            "32 bytes there and back, req0 and rep0 over TCP on the loopback, a thread at each end",
            if one { 5.0 } else { 1.6 },
            nng,
        );
        peer(
            format!("zenoh/get {name}"),
            "32 bytes there and back, get and queryable of two peers over TCP on the loopback, which share zenoh's threads",
            if one { 8.0 } else { 2.5 },
            zenoh_get,
        );
    }
    suite.case(
        "libzmq/PUSH-PULL",
        "32 bytes one way over TCP on the loopback, those together that wait, none held back; nanoseconds per message",
        libzmq_push,
    );
    suite.case(
        "zenoh/put",
        "32 bytes one way, put and subscriber of two peers over TCP on the loopback, no congestion drops, those together that wait, none held back; nanoseconds per message",
        zenoh_put,
    );
    for (peer, least) in [("libzmq/PUSH-PULL", 1.5), ("zenoh/put", 4.0)] {
        let row = Row::new("P12", "runtime/UDP one way", peer, Stat::Mean, Goal::AtLeast(least));
        suite.row(row.with("no message held back"));
    }
}

/// A free address on the loopback interface.
fn address() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    format!("tcp/{}", listener.local_addr().expect("bound"))
}

/// Times `times` round trips, after some to warm up.
fn round_trips(times: u32, mut trip: impl FnMut()) -> Sample {
    let mut nanos = Vec::new();
    for round in 0..times + WARM {
        let begins = Instant::now();
        trip();
        if round >= WARM {
            nanos.push(nanos_of(begins.elapsed()));
        }
    }
    Sample::of(nanos, 1)
}

/// Runs `serve` on a thread of the core `other`, and `ask` here on the first core.
fn on_threads(other: Core, serve: impl FnOnce() + Send, ask: impl FnOnce() -> Sample) -> Sample {
    let sample = std::thread::scope(|s| {
        s.spawn(move || {
            cores::pin(other);
            serve();
        });
        cores::pin(Core::First);
        ask()
    });
    cores::unpin();
    sample
}

fn libzmq(times: u32, other: Core) -> Sample {
    let at = address().replace("tcp/", "tcp://");
    let serve = || {
        let context = zmq::Context::new();
        let socket = context.socket(zmq::REP).expect("a socket");
        socket.bind(&at).expect("an address");
        for _ in 0..times + WARM {
            let asked = socket.recv_bytes(0).expect("a message");
            socket.send(asked, 0).expect("sent");
        }
    };
    let ask = || {
        let context = zmq::Context::new();
        let socket = context.socket(zmq::REQ).expect("a socket");
        socket.connect(&at).expect("an address");
        round_trips(times, || {
            socket.send(&BYTES[..], 0).expect("sent");
            assert_eq!(socket.recv_bytes(0).expect("an answer").len(), BYTES.len());
        })
    };
    on_threads(other, serve, ask)
}

fn libzmq_push(effort: Effort) -> Sample {
    let (at, times) = (address().replace("tcp/", "tcp://"), effort.of(100_000));
    let serve = || {
        let context = zmq::Context::new();
        let socket = context.socket(zmq::PUSH).expect("a socket");
        socket.connect(&at).expect("an address");
        for _ in 0..=times {
            socket.send(&BYTES[..], 0).expect("sent");
        }
    };
    let take = || {
        let context = zmq::Context::new();
        let socket = context.socket(zmq::PULL).expect("a socket");
        socket.bind(&at).expect("an address");
        let take = || assert_eq!(socket.recv_bytes(0).expect("a message").len(), BYTES.len());
        // Timing starts with the first message, because the two sides connect before it.
        take();
        let begins = Instant::now();
        (0..times).for_each(|_| take());
        Sample::of(vec![nanos_of(begins.elapsed())], times)
    };
    on_threads(Core::Second, serve, take)
}

fn nng(times: u32, other: Core) -> Sample {
    let at = address().replace("tcp/", "tcp://");
    let (tell, told) = channel();
    let serve = || {
        let socket = nng::Socket::new(nng::Protocol::Rep0).expect("a socket");
        socket.listen(&at).expect("an address");
        tell.send(()).expect("it listens");
        for _ in 0..times + WARM {
            let asked = socket.recv().expect("a message");
            socket.send(asked).expect("sent");
        }
        // The last answer must leave before the socket is closed.
        std::thread::sleep(LOOK);
    };
    let ask = || {
        told.recv().expect("it listens");
        let socket = nng::Socket::new(nng::Protocol::Req0).expect("a socket");
        socket.dial(&at).expect("an address");
        round_trips(times, || {
            socket.send(&BYTES[..]).expect("sent");
            assert_eq!(socket.recv().expect("an answer").len(), BYTES.len());
        })
    };
    on_threads(other, serve, ask)
}

/// Two zenoh peers that know each other's address and do not search for others.
fn sessions() -> (zenoh::Session, zenoh::Session) {
    let at = address();
    let held_back = HELD_BACK.as_millis().to_string();
    let open = |listen: &str, connect: &str| {
        let mut config = zenoh::Config::default();
        for (key, value) in [
            ("mode", "\"peer\""),
            ("scouting/multicast/enabled", "false"),
            ("listen/endpoints", listen),
            ("connect/endpoints", connect),
            ("transport/link/tx/queue/batching/enabled", "true"),
            ("transport/link/tx/queue/batching/time_limit", &held_back),
        ] {
            config.insert_json5(key, value).expect("a setting");
        }
        zenoh::open(config).wait().expect("a session")
    };
    let there = format!("[\"{at}\"]");
    let first = open(&there, "[]");
    (first, open("[]", &there))
}

fn zenoh_get(times: u32, other: Core) -> Sample {
    let (here, there) = sessions();
    if other == Core::First {
        cores::pin_all(Core::First);
    }
    let answer = |query: zenoh::query::Query| query.reply("ask", &BYTES[..]).wait().expect("sent");
    let answering = there.declare_queryable("ask").callback(answer).wait().expect("a queryable");
    let ask = || {
        here.get("ask").payload(&BYTES[..]).wait().expect("asked").recv().is_ok_and(|a| a.result().is_ok())
    };
    // The loop ends when this peer knows that the other one answers.
    while !ask() {
        std::thread::sleep(LOOK);
    }
    let sample = round_trips(times, || assert!(ask(), "an answer"));
    answering.undeclare().wait().expect("undeclared");
    cores::unpin_all();
    sample
}

fn zenoh_put(effort: Effort) -> Sample {
    let ((here, there), times) = (sessions(), effort.of(100_000));
    let (tell, told) = channel();
    let hear = move |sample: zenoh::sample::Sample| tell.send(sample.payload().len()).expect("it listens");
    let hearing = there.declare_subscriber("news").callback(hear).wait().expect("a subscriber");
    let publisher = here.declare_publisher("news").congestion_control(zenoh::qos::CongestionControl::Block);
    let publisher = publisher.wait().expect("a publisher");
    let put = || publisher.put(&BYTES[..]).wait().expect("sent");
    // The loop ends when this peer knows that the other one listens. Messages sent before are not counted.
    while told.try_recv().is_err() {
        put();
        std::thread::sleep(LOOK);
    }
    std::thread::sleep(10 * LOOK);
    while told.try_recv().is_ok() {}
    let begins = Instant::now();
    std::thread::scope(|s| {
        s.spawn(|| (0..times).for_each(|_| put()));
        (0..times).for_each(|_| assert_eq!(told.recv().expect("heard"), BYTES.len()));
    });
    let sample = Sample::of(vec![nanos_of(begins.elapsed())], times);
    hearing.undeclare().wait().expect("undeclared");
    sample
}

#[cfg(test)]
mod tests {
    use crate::cases::network;

    #[test]
    fn the_rows_of_one_way_name_the_delay_that_is_set_in_all_three() {
        let mut suite = network::network();
        super::join(&mut suite);
        for peer in ["libzmq/PUSH-PULL", "zenoh/put"] {
            let row = suite.rows.iter().find(|row| row.other() == Some(peer)).expect("a row");
            assert_eq!(row.what, format!("runtime/UDP one way : {peer}, no message held back"));
        }
    }
}
