//! Tests of the envelope: golden bytes, round trips, and datagrams that must be rejected.

use imrs_protocol::{Incarnation, NodeId, PACKET_BYTES};
use imrs_wire::envelope::{
    COUNTER_END, Datagram, Digests, Echo, Envelope, EnvelopeError, Greeting, MAGIC, MAX_DATAGRAM_BYTES,
    MAX_PACKETS, MIN_DATAGRAM_BYTES, MODE_KEYS, OVERHEAD_BYTES, Purpose, Refused, Session, VERSION, open,
    read, without_packets,
};
use proptest::prelude::*;

const DIGESTS: Digests = Digests { cell: 0xdead_beef, statements: 0x0bad_cafe };
const HERE: NodeId = NodeId(0x0304);

fn sample() -> Envelope {
    Envelope {
        sender: NodeId(0x0102),
        receiver: HERE,
        incarnation: Incarnation(7),
        restarted: true,
        session: Session(0x2122_2324_2526_2728),
        counter: 0x0011_2233_4455_6677 % COUNTER_END,
        tx_mono: 0x0102_0304_0506_0708,
        echo: Some(Echo { session: Session(0x3132_3334_3536_3738), mono: 0x1112_1314_1516_1718 }),
        purpose: Purpose::Packets,
    }
}

fn sealed(envelope: &Envelope, packets: usize) -> Vec<u8> {
    let mut datagram = Datagram::default();
    for i in 0..packets {
        assert!(datagram.push(&[u8::try_from(i).unwrap(); PACKET_BYTES]));
    }
    datagram.seal(envelope, DIGESTS).to_vec()
}

fn reason(bytes: &[u8]) -> Option<EnvelopeError> {
    open(bytes, HERE, DIGESTS, |_| true).err()
}

#[test]
fn the_layout_is_the_documented_one() {
    let bytes = sealed(&sample(), 2);
    #[rustfmt::skip]
    let header = [
        0x9d, 0x4d, 2, 0,
        0xef, 0xbe, 0xad, 0xde,
        0xfe, 0xca, 0xad, 0x0b,
        0x02, 0x01, 0x04, 0x03,
        7, 0b0000_1100, 2, 0,
        0x28, 0x27, 0x26, 0x25, 0x24, 0x23, 0x22, 0x21,
        0x38, 0x37, 0x36, 0x35, 0x34, 0x33, 0x32, 0x31,
        0x77, 0x66, 0x55, 0x44, 0x33, 0x22, 0x11, 0,
        0x08, 0x07, 0x06, 0x05, 0x04, 0x03, 0x02, 0x01,
        0x18, 0x17, 0x16, 0x15, 0x14, 0x13, 0x12, 0x11,
    ];
    assert_eq!(bytes[..60], header);
    assert_eq!(bytes[60..92], [0; 32]);
    assert_eq!(bytes[92..124], [1; 32]);
    assert_eq!(bytes[124..], GOLDEN_CHECKSUM);
}

/// The checksum of the datagram above. It fixes version 2 of the format.
const GOLDEN_CHECKSUM: [u8; 4] = [0x3e, 0xa2, 0x20, 0xa7];

#[test]
fn greetings_and_refusals_have_the_documented_flags() {
    let greeting = Greeting { wants_answer: true, uncounted: true, remembers: Some(Incarnation(5)) };
    let said = |purpose| without_packets(&Envelope { purpose, ..sample() }, DIGESTS);
    let bytes = said(Purpose::Greeting(greeting));
    assert_eq!((bytes.len(), &bytes[16..20]), (64, &[7, 0b0111_1101, 0, 5][..]));
    assert_eq!(bytes[60..], [0x8e, 0x6f, 0xc3, 0xc8], "version 2 is fixed by it");
    for (number, why) in
        [Refused::OtherCell, Refused::OtherStatements, Refused::Misdelivered].into_iter().enumerate()
    {
        let bytes = said(Purpose::Refusal(why));
        assert_eq!(bytes[16..20], [7, 0b0000_1110, 0, u8::try_from(number).unwrap()]);
        assert_eq!(open(&bytes, HERE, DIGESTS, |_| true).unwrap().0.purpose, Purpose::Refusal(why));
    }
}

/// A datagram of version 1 with one packet. The decoder reads only its version.
#[test]
fn version_1_is_refused_by_name() {
    let mut bytes = [0; 72];
    bytes[..4].copy_from_slice(&[MAGIC[0], MAGIC[1], 1, 0]);
    let error = reason(&bytes).unwrap();
    assert_eq!(error, EnvelopeError::Version(1));
    assert_eq!(error.to_string(), "envelope version 1, this node speaks 2");
    bytes[2..4].copy_from_slice(&[VERSION, MODE_KEYS]);
    assert_eq!(reason(&bytes).unwrap().to_string(), "envelope mode 1, this node speaks mode 0");
}

#[test]
fn sizes_fit_an_ethernet_frame() {
    assert_eq!((OVERHEAD_BYTES, MIN_DATAGRAM_BYTES, MAX_DATAGRAM_BYTES), (64, 64, 1472));
    assert_eq!(sealed(&sample(), 1).len(), 96);
    assert!(sealed(&sample(), 36).len() <= 1232 && sealed(&sample(), 37).len() > 1232);
    assert_eq!(sealed(&sample(), MAX_PACKETS).len(), MAX_DATAGRAM_BYTES);
    let mut full = Datagram::default();
    while full.push(&[0; PACKET_BYTES]) {}
    assert_eq!(full.len(), MAX_PACKETS);
    full.clear();
    assert!(full.is_empty() && full.push(&[1; PACKET_BYTES]));
}

#[test]
fn every_flipped_bit_is_noticed() {
    for packets in [1, 3, MAX_PACKETS] {
        let good = sealed(&sample(), packets);
        assert_eq!(reason(&good), None);
        for bit in 0..good.len() * 8 {
            let mut bytes = good.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            let expected = match bit / 8 {
                0 | 1 => EnvelopeError::NotImrs,
                2 => EnvelopeError::Version(bytes[2]),
                3 => EnvelopeError::Mode(bytes[3]),
                _ => EnvelopeError::Checksum,
            };
            assert_eq!(reason(&bytes), Some(expected), "bit {bit} of {packets} packets");
        }
    }
}

#[test]
fn each_fault_has_its_own_reason() {
    let good = sealed(&sample(), 2);
    for length in 0..good.len() {
        let expected = match length {
            0..MIN_DATAGRAM_BYTES => EnvelopeError::TooShort(length),
            _ if (length - OVERHEAD_BYTES).is_multiple_of(PACKET_BYTES) => EnvelopeError::Checksum,
            _ => EnvelopeError::Length(length),
        };
        assert_eq!(reason(&good[..length]), Some(expected), "cut off at {length}");
    }
    let trailing = |more: usize| [good.as_slice(), vec![0; more].as_slice()].concat();
    assert_eq!(reason(&trailing(1)), Some(EnvelopeError::Length(129)));
    // Appended zeros do not change the checksum.
    assert_eq!(reason(&trailing(PACKET_BYTES)), Some(EnvelopeError::Length(160)));
    let long = [sealed(&sample(), MAX_PACKETS), vec![0; PACKET_BYTES]].concat();
    assert_eq!(reason(&long), Some(EnvelopeError::Length(MAX_DATAGRAM_BYTES + PACKET_BYTES)));
    let refused = |node, digests, known| open(&good, node, digests, |_| known).unwrap_err();
    let (cell, statements) = (Digests { cell: 1, ..DIGESTS }, Digests { statements: 1, ..DIGESTS });
    assert_eq!(refused(NodeId(1), cell, false), EnvelopeError::OtherCell(DIGESTS.cell));
    assert_eq!(refused(NodeId(1), statements, false), EnvelopeError::OtherStatements(DIGESTS.statements));
    assert_eq!(refused(NodeId(1), DIGESTS, false), EnvelopeError::Misdelivered(HERE));
    assert_eq!(refused(HERE, DIGESTS, false), EnvelopeError::UnknownNode(NodeId(0x0102)));
    // The number of packets must be possible for the purpose.
    let greeting = Purpose::Greeting(Greeting::default());
    let with_packets = sealed(&Envelope { purpose: greeting, ..sample() }, 1);
    assert_eq!(reason(&with_packets), Some(EnvelopeError::Length(96)));
    let empty = without_packets(&sample(), DIGESTS);
    assert_eq!(reason(&empty), Some(EnvelopeError::Length(64)));
}

#[test]
fn the_first_bytes_decide_before_anything_else() {
    for first in 0..=u8::MAX {
        for second in 0..=u8::MAX {
            let mut bytes = [0_u8; 200];
            bytes[..4].copy_from_slice(&[first, second, VERSION, 0]);
            let expected = match [first, second] {
                MAGIC => EnvelopeError::Checksum,
                _ => EnvelopeError::NotImrs,
            };
            assert_eq!(reason(&bytes[..96]), Some(expected));
        }
    }
}

fn envelope() -> impl Strategy<Value = Envelope> {
    let echo = proptest::option::of((any::<u64>(), any::<u64>()));
    let nodes = (any::<u16>(), any::<u16>());
    (nodes, any::<u8>(), any::<bool>(), any::<u64>(), 0..COUNTER_END, any::<u64>(), echo).prop_map(
        |((sender, receiver), incarnation, restarted, session, counter, tx_mono, echo)| Envelope {
            sender: NodeId(sender),
            receiver: NodeId(receiver),
            incarnation: Incarnation(incarnation),
            restarted,
            session: Session(session),
            counter,
            tx_mono,
            echo: echo.map(|(session, mono)| Echo { session: Session(session), mono }),
            purpose: Purpose::Packets,
        },
    )
}

proptest! {
    #[test]
    fn opening_undoes_sealing(
        e in envelope(), cell: u32, statements: u32,
        packets in proptest::collection::vec(any::<[u8; PACKET_BYTES]>(), 1..=MAX_PACKETS),
    ) {
        let mut datagram = Datagram::default();
        for packet in &packets {
            prop_assert!(datagram.push(packet));
        }
        let digests = Digests { cell, statements };
        let bytes = datagram.seal(&e, digests);
        prop_assert_eq!(open(bytes, e.receiver, digests, |n| n == e.sender), Ok((e, packets.as_slice())));
        for purpose in [
            Purpose::Greeting(Greeting { wants_answer: e.restarted, uncounted: false, remembers: Some(e.incarnation) }),
            Purpose::Greeting(Greeting { wants_answer: false, uncounted: e.restarted, remembers: None }),
            Purpose::Refusal(Refused::OtherStatements),
            Purpose::Goodbye,
        ] {
            let e = Envelope { purpose, ..e };
            let bytes = without_packets(&e, digests);
            let opened = read(&bytes).unwrap();
            prop_assert_eq!((opened.envelope, opened.digests, opened.packets.len()), (e, digests, 0));
        }
    }

    #[test]
    fn random_bytes_are_refused(bytes in proptest::collection::vec(any::<u8>(), 0..1600), cell: u32) {
        let digests = Digests { cell, ..DIGESTS };
        prop_assert!(open(&bytes, HERE, digests, |_| true).is_err());
    }

    #[test]
    fn random_bytes_behind_a_right_prologue_are_refused(
        mut bytes in proptest::collection::vec(any::<u8>(), 4..1600),
    ) {
        bytes[..4].copy_from_slice(&[MAGIC[0], MAGIC[1], VERSION, 0]);
        prop_assert!(open(&bytes, HERE, DIGESTS, |_| true).is_err());
    }

    #[test]
    fn up_to_five_flipped_bits_are_noticed(
        e in envelope().prop_map(|e| Envelope { receiver: HERE, ..e }), packets in 1..=MAX_PACKETS, flips in proptest::collection::hash_set(any::<usize>(), 1..=5),
    ) {
        let mut bytes = sealed(&e, packets);
        let good = bytes.clone();
        for flip in flips {
            let bit = flip % (bytes.len() * 8);
            bytes[bit / 8] ^= 1 << (bit % 8);
        }
        prop_assert!(bytes == good || reason(&bytes).is_some());
    }
}
