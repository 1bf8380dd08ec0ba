//! The envelope as bytes: golden form, round trips, and what must never be taken.

use imrs_protocol::{Incarnation, NodeId, PACKET_BYTES};
use imrs_wire::envelope::{
    COUNTER_END, Datagram, Echo, Envelope, EnvelopeError, MAGIC, MAX_DATAGRAM_BYTES, MAX_PACKETS,
    MIN_DATAGRAM_BYTES, OVERHEAD_BYTES, VERSION, open,
};
use proptest::prelude::*;

const DIGEST: u32 = 0xdead_beef;

fn sample() -> Envelope {
    Envelope {
        sender: NodeId(0x0102),
        incarnation: Incarnation(7),
        restarted: true,
        counter: 0x0011_2233_4455_6677 % COUNTER_END,
        tx_mono: 0x0102_0304_0506_0708,
        echo: Some(Echo { incarnation: Incarnation(9), mono: 0x1112_1314_1516_1718 }),
    }
}

fn sealed(envelope: &Envelope, packets: usize) -> Vec<u8> {
    let mut datagram = Datagram::default();
    for i in 0..packets {
        assert!(datagram.push(&[u8::try_from(i).unwrap(); PACKET_BYTES]));
    }
    datagram.seal(envelope, DIGEST).to_vec()
}

fn reason(bytes: &[u8]) -> Option<EnvelopeError> {
    open(bytes, DIGEST, |_| true).err()
}

#[test]
fn the_layout_is_the_documented_one() {
    let bytes = sealed(&sample(), 2);
    #[rustfmt::skip]
    let header = [
        0x9d, 0x4d, 1, 0,
        0xef, 0xbe, 0xad, 0xde,
        0x02, 0x01, 7, 9, 0b0000_1011,
        0x77, 0x66, 0x55, 0x44, 0x33, 0x22, 0x11,
        0x08, 0x07, 0x06, 0x05, 0x04, 0x03, 0x02, 0x01,
        0x18, 0x17, 0x16, 0x15, 0x14, 0x13, 0x12, 0x11,
    ];
    assert_eq!(bytes[..36], header);
    assert_eq!(bytes[36..68], [0; 32]);
    assert_eq!(bytes[68..100], [1; 32]);
    assert_eq!(bytes[100..], GOLDEN_CHECKSUM);
}

/// Of the datagram above: version 1 of the format is fixed by it.
const GOLDEN_CHECKSUM: [u8; 4] = [0x87, 0x12, 0xf1, 0xe0];

#[test]
fn sizes_fit_an_ethernet_frame() {
    assert_eq!((OVERHEAD_BYTES, MIN_DATAGRAM_BYTES, MAX_DATAGRAM_BYTES), (40, 72, 1448));
    assert_eq!(sealed(&sample(), 1).len(), MIN_DATAGRAM_BYTES);
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
    assert_eq!(reason(&trailing(1)), Some(EnvelopeError::Length(105)));
    // Zeros behind the end leave the checksum as it is.
    assert_eq!(reason(&trailing(PACKET_BYTES)), Some(EnvelopeError::Length(136)));
    let long = [sealed(&sample(), MAX_PACKETS), vec![0; PACKET_BYTES]].concat();
    assert_eq!(reason(&long), Some(EnvelopeError::Length(MAX_DATAGRAM_BYTES + PACKET_BYTES)));
    assert_eq!(open(&good, 1, |_| true).unwrap_err(), EnvelopeError::OtherCell(DIGEST));
    assert_eq!(open(&good, DIGEST, |_| false).unwrap_err(), EnvelopeError::UnknownNode(NodeId(0x0102)));
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
            assert_eq!(reason(&bytes[..72]), Some(expected));
        }
    }
}

fn envelope() -> impl Strategy<Value = Envelope> {
    let echo = proptest::option::of((any::<u8>(), any::<u64>()));
    (any::<u16>(), any::<u8>(), any::<bool>(), 0..COUNTER_END, any::<u64>(), echo).prop_map(
        |(sender, incarnation, restarted, counter, tx_mono, echo)| Envelope {
            sender: NodeId(sender),
            incarnation: Incarnation(incarnation),
            restarted,
            counter,
            tx_mono,
            echo: echo.map(|(life, mono)| Echo { incarnation: Incarnation(life), mono }),
        },
    )
}

proptest! {
    #[test]
    fn opening_undoes_sealing(
        e in envelope(), digest: u32,
        packets in proptest::collection::vec(any::<[u8; PACKET_BYTES]>(), 1..=MAX_PACKETS),
    ) {
        let mut datagram = Datagram::default();
        for packet in &packets {
            prop_assert!(datagram.push(packet));
        }
        let bytes = datagram.seal(&e, digest);
        prop_assert_eq!(open(bytes, digest, |n| n == e.sender), Ok((e, packets.as_slice())));
    }

    #[test]
    fn random_bytes_are_refused(bytes in proptest::collection::vec(any::<u8>(), 0..1600), digest: u32) {
        prop_assert!(open(&bytes, digest, |_| true).is_err());
    }

    #[test]
    fn random_bytes_behind_a_right_prologue_are_refused(
        mut bytes in proptest::collection::vec(any::<u8>(), 4..1600),
    ) {
        bytes[..4].copy_from_slice(&[MAGIC[0], MAGIC[1], VERSION, 0]);
        prop_assert!(open(&bytes, DIGEST, |_| true).is_err());
    }

    #[test]
    fn up_to_five_flipped_bits_are_noticed(
        e in envelope(), packets in 1..=MAX_PACKETS, flips in proptest::collection::hash_set(any::<usize>(), 1..=5),
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
