//! Sends foreign and damaged datagrams to a node of a running beam lift.

use super::{check, ends_well, interrupted, node};
use crate::support::live::{Live, Seen, named, released};
use crate::support::{look_until, number, runtime_dir, wait_until};
use imrs_protocol::{Incarnation, NodeId, PACKET_BYTES};
use imrs_wire::envelope::{Datagram, Digests, Envelope, Purpose, Session};
use imrs_wire::recording::RecordingReader;
use std::fs::File;
use std::net::UdpSocket;

/// How many datagrams fit into the kernel's receive queue.
const AT_ONCE: u64 = 64;

/// A sender that is no neighbour of the node, and that sends no faster than the node discards datagrams.
struct Stranger {
    socket: UdpSocket,
    seen: Seen,
    sent: u64,
}

impl Stranger {
    fn of(demo: &Live) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.connect(demo.address("nl")).unwrap();
        Self { socket, seen: Seen::by_monitor(demo.dir()), sent: 0 }
    }

    fn send(&mut self, bytes: &[u8]) {
        self.socket.send(bytes).unwrap();
        self.sent += 1;
        if self.sent.is_multiple_of(AT_ONCE) {
            self.wait();
        }
    }

    /// Waits until the node has discarded all datagrams of this sender, except for those that it loses on purpose.
    fn wait(&mut self) {
        let sent = self.sent;
        self.seen.until("garbage is counted", |seen| {
            let discards =
                named(&seen["nodes"], "nl")["link_discards"].as_array().cloned().unwrap_or_default();
            let counted: u64 = discards.iter().filter_map(|of| of["count"].as_u64()).sum();
            counted + AT_ONCE / 2 + sent / 20 > sent
        });
    }
}

#[test]
fn garbage_is_counted_by_reason_and_does_no_harm() {
    let dir = runtime_dir();
    let file = dir.path().join("run.imrs");
    let demo = Live::steady_with(&["--insecure", "--loss", "1%", "--record", file.to_str().unwrap()]);
    let recorded = dir.path().join("run.nl.imrs");
    wait_until("the recording has its header", || {
        File::open(&recorded).is_ok_and(|file| RecordingReader::new(file).is_ok())
    });
    let digest = RecordingReader::new(File::open(&recorded).unwrap()).unwrap().header().digest;

    let mut stranger = Stranger::of(&demo);
    for first in 0..=255_u8 {
        let mut bytes = [first; 72];
        bytes[1] = !first;
        stranger.send(&bytes);
    }
    let envelope = Envelope {
        sender: NodeId(1),
        receiver: NodeId(0),
        incarnation: Incarnation(0),
        restarted: false,
        session: Session(1),
        counter: 1,
        tx_mono: 0,
        echo: None,
        purpose: Purpose::Packets,
    };
    let digests = |cell| Digests { cell, statements: 0 };
    let mut datagram = Datagram::default();
    datagram.push(&[0; PACKET_BYTES]);
    stranger.send(datagram.seal(&envelope, digests(digest ^ 1)));
    // No node has the statements with this digest.
    stranger.send(datagram.seal(&envelope, digests(digest)));
    let whole = datagram.seal(&envelope, digests(digest)).to_vec();
    (0..whole.len()).for_each(|length| stranger.send(&whole[..length]));
    for bit in 0..whole.len() * 8 {
        let mut flipped = whole.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        stranger.send(&flipped);
    }
    stranger.wait();

    let once = ["monitor", "--once", "--format", "json"];
    look_until(demo.dir(), &once, "garbage is seen", |seen| seen.out.contains("link_discards"));
    let (summary, code, errors) = interrupted(demo, "a lift", |seen| released(seen, "armL") >= 1);
    let is_excused = code == Some(1) && ends_well(&summary, code, &errors);
    assert!(code == Some(6) || is_excused, "{code:?}: {errors}");
    let security = &node(&summary, "nl")["security"];
    assert!(number(&security["alarms"]) >= 1, "{security}");
    let lift = check(&summary);
    assert!(number(&lift["released"]) > 0, "{summary}");
    assert_eq!(node(&summary, "nl")["exit"], "clean");
    let counted = &node(&summary, "nl")["link_discards"];
    for (reason, least) in [
        ("not_imrs", 200),
        ("version", 4),
        ("mode", 4),
        ("other_cell", 1),
        ("other_statements", 1),
        ("too_short", 30),
        ("checksum", 400),
    ] {
        assert!(counted.get(reason).is_some_and(|n| number(n) >= least), "{reason} in {counted}");
    }
}
