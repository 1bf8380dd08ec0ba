//! Measures what the packets of one datagram cost to encode and decode, without a socket.

use super::cells::{self, A, ASK, B, LONG_TICKS};
use super::network::COALESCED;
use crate::sample::each;
use crate::suite::Suite;
use imrs_protocol::{
    CellTable, Class, Contents, Incarnation, Kind, MessageId, NodeId, Packet, Seal, Seq24, Usage,
};
use imrs_wire::envelope::{self, Datagram, Digests, Envelope, Purpose, Session};
use std::hint::black_box;

/// The suite of the wire format.
#[must_use]
pub fn wire() -> Suite {
    let mut suite = Suite::new("wire");
    suite.case(
        "wire/encode+decode of 43",
        "43 packets into a datagram in checksum mode and out of it again, as a link does it, without a socket; a value is one datagram's",
        |effort| each(effort.of(20_000), 1, datagrams()),
    );
    suite
}

/// Encodes the packets of one datagram, seals it, opens it, and decodes the packets.
fn datagrams() -> impl FnMut() {
    let table = cells::asking(2, Usage::Send);
    let digests = Digests { cell: table.digest(), statements: 0 };
    let mut envelope = Envelope {
        sender: NodeId(0),
        receiver: NodeId(1),
        incarnation: Incarnation(1),
        restarted: false,
        session: Session(1),
        counter: 0,
        tx_mono: 1_000_000,
        echo: None,
        purpose: Purpose::Packets,
    };
    let packets: Vec<Packet> = (0..COALESCED as u32).map(packet).collect();
    let mut datagram = Datagram::default();
    let mut decoded = Vec::with_capacity(COALESCED);
    move || {
        datagram.clear();
        decoded.clear();
        envelope.counter += 1;
        for packet in black_box(&packets) {
            let hash = table.port(packet.port).map_or(0, |port| port.hash);
            assert!(datagram.push(&packet.encode(table.digest(), hash)), "room");
        }
        let bytes = black_box(datagram.seal(&envelope, digests));
        let (_, taken) =
            envelope::open(bytes, NodeId(1), digests, |node| node == NodeId(0)).expect("an intact datagram");
        decoded.extend(taken.iter().map(|bytes| decode(bytes, &table)));
        assert_eq!(black_box(&decoded).len(), COALESCED);
    }
}

/// A message as a task sends it: its checksum is not known yet.
fn packet(number: u32) -> Packet {
    Packet {
        kind: Kind::Send,
        class: Class::Status,
        more: false,
        resent: false,
        hops: 0,
        fragment: 0,
        destination: B,
        source: A,
        port: ASK,
        id: MessageId { incarnation: Incarnation(1), sequence: Seq24::new(number) },
        remaining: LONG_TICKS,
        contents: Contents::new(&cells::FULL).expect("12 bytes fit"),
        seal: Seal::NONE,
    }
}

fn decode(bytes: &[u8; imrs_protocol::PACKET_BYTES], table: &CellTable) -> Packet {
    let hash = |port| table.port(port).map(|port| port.hash);
    Packet::decode(bytes, table.digest(), hash).expect("a packet of this cell")
}
