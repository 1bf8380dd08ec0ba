//! Measures other libraries over a network: tokio's UDP and TCP, and zeromq (the implementation in Rust, over TCP).

use crate::cases::floors;
use crate::cores::{self, Core};
use crate::sample::{Sample, nanos_of};
use crate::suite::{Effort, Goal, Row, Stat, Suite};
use std::time::Instant;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpStream, UdpSocket};
use zeromq::{Socket, SocketRecv, SocketSend, ZmqMessage};

/// Adds these libraries to a suite.
pub fn join(suite: &mut Suite) {
    if suite.name != "network" {
        return;
    }
    for (name, other) in [("one core", Core::First), ("two cores", Core::Second)] {
        suite.case(
            format!("tokio/UDP {name}"),
            "32 bytes there and back between two single-threaded runtimes on two threads",
            move |effort| tokio_udp(effort.of(1_500), other),
        );
        suite.case(
            format!("tokio/TCP {name}"),
            "the same over one connection, with TCP_NODELAY",
            move |effort| tokio_tcp(effort.of(1_500), other),
        );
        suite.case(
            format!("zeromq/REQ-REP {name}"),
            "32 bytes there and back, REQ and REP over TCP on the loopback, two single-threaded runtimes",
            move |effort| req_rep(effort.of(1_000), other),
        );
        // These bounds follow from the bounds of the runtime, which may take 1.2 times the baseline's time on one
        // core and 1.15 times on two. On one core tokio took 1.4 times the baseline's time.
        let (zeromq, tokio) = if other == Core::First { (3.5, 1.15) } else { (1.3, 0.87) };
        for (peer, times) in [("zeromq/REQ-REP", zeromq), ("tokio/UDP", tokio), ("tokio/TCP", tokio)] {
            let (own, peer) = (format!("runtime/UDP {name}"), format!("{peer} {name}"));
            suite.row(Row::new("P11", own, &peer, Stat::P50, Goal::AtLeast(times)));
        }
    }
    suite.case(
        "zeromq/PUSH-PULL",
        "32 bytes one way over TCP on the loopback; nanoseconds per message",
        push_pull,
    );
    suite.row(Row::new("P12", "runtime/UDP one way", "zeromq/PUSH-PULL", Stat::Mean, Goal::AtLeast(1.5)));
}

fn block_on<T>(work: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    runtime.expect("a runtime").block_on(work)
}

/// Runs `serve` on a thread of its own, and `work` on this thread.
fn both<T>(other: Core, serve: impl Future<Output = ()> + Send, work: impl Future<Output = T>) -> T {
    let done = std::thread::scope(|s| {
        s.spawn(move || {
            cores::pin(other);
            block_on(serve);
        });
        cores::pin(Core::First);
        block_on(work)
    });
    cores::unpin();
    done
}

fn tokio_udp(times: u32, other: Core) -> Sample {
    let bound = || {
        let socket = std::net::UdpSocket::bind("127.0.0.1:0").expect("a socket");
        socket.set_nonblocking(true).expect("an option");
        socket
    };
    let (a, b) = (bound(), bound());
    a.connect(b.local_addr().expect("bound")).expect("an address");
    b.connect(a.local_addr().expect("bound")).expect("an address");
    let serve = async move {
        let socket = UdpSocket::from_std(b).expect("a socket");
        let mut buffer = [0; 64];
        // A datagram of one byte ends the loop.
        while socket.recv(&mut buffer).await.expect("a datagram") > 1 {
            socket.send(&buffer[..32]).await.expect("sent");
        }
    };
    let work = async move {
        let socket = UdpSocket::from_std(a).expect("a socket");
        let (mut buffer, mut nanos) = ([0; 64], Vec::new());
        for round in 0..times + 50 {
            let begins = Instant::now();
            socket.send(&[7; 32]).await.expect("sent");
            socket.recv(&mut buffer).await.expect("an answer");
            if round >= 50 {
                nanos.push(nanos_of(begins.elapsed()));
            }
        }
        socket.send(&[0]).await.expect("sent");
        Sample::of(nanos, 1)
    };
    both(other, serve, work)
}

fn tokio_tcp(times: u32, other: Core) -> Sample {
    let [a, b] = floors::connected();
    let stream = |stream: std::net::TcpStream| {
        stream.set_nonblocking(true).expect("an option");
        TcpStream::from_std(stream).expect("a socket")
    };
    let serve = async move {
        let (mut stream, mut buffer) = (stream(b), [0; 32]);
        // The loop ends when the other end closes the connection.
        while stream.read_exact(&mut buffer).await.is_ok() {
            stream.write_all(&buffer).await.expect("sent");
        }
    };
    let work = async move {
        let (mut stream, mut buffer, mut nanos) = (stream(a), [0; 32], Vec::new());
        for round in 0..times + 50 {
            let begins = Instant::now();
            stream.write_all(&[7; 32]).await.expect("sent");
            stream.read_exact(&mut buffer).await.expect("an answer");
            if round >= 50 {
                nanos.push(nanos_of(begins.elapsed()));
            }
        }
        Sample::of(nanos, 1)
    };
    both(other, serve, work)
}

fn message() -> ZmqMessage {
    ZmqMessage::from(vec![7; 32])
}

fn req_rep(times: u32, other: Core) -> Sample {
    let (tell, told) = tokio::sync::oneshot::channel();
    let all = times + 50;
    let serve = async move {
        let mut socket = zeromq::RepSocket::new();
        let at = socket.bind("tcp://127.0.0.1:0").await.expect("a socket");
        tell.send(at).expect("it listens");
        for _ in 0..all {
            let message = socket.recv().await.expect("a message");
            socket.send(message).await.expect("sent");
        }
    };
    let work = async move {
        let mut socket = zeromq::ReqSocket::new();
        let at = told.await.expect("an address").to_string();
        socket.connect(&at).await.expect("connected");
        let mut nanos = Vec::new();
        for round in 0..all {
            let begins = Instant::now();
            socket.send(message()).await.expect("sent");
            socket.recv().await.expect("an answer");
            if round >= 50 {
                nanos.push(nanos_of(begins.elapsed()));
            }
        }
        Sample::of(nanos, 1)
    };
    both(other, serve, work)
}

fn push_pull(effort: Effort) -> Sample {
    let times = effort.of(20_000);
    let (tell, told) = tokio::sync::oneshot::channel();
    let (end, ended) = tokio::sync::oneshot::channel::<()>();
    let serve = async move {
        let mut socket = zeromq::PushSocket::new();
        let at: zeromq::Endpoint = told.await.expect("an address");
        socket.connect(&at.to_string()).await.expect("connected");
        for _ in 0..times {
            socket.send(message()).await.expect("sent");
        }
        // All messages must leave before the socket is closed.
        let _ = ended.await;
    };
    let work = async move {
        let mut socket = zeromq::PullSocket::new();
        tell.send(socket.bind("tcp://127.0.0.1:0").await.expect("a socket")).expect("it listens");
        socket.recv().await.expect("a message");
        let begins = Instant::now();
        for _ in 1..times {
            socket.recv().await.expect("a message");
        }
        let elapsed = begins.elapsed();
        drop(end);
        Sample::of_all(elapsed, u64::from(times - 1))
    };
    both(Core::Second, serve, work)
}
