//! Tests of the layout, of the checksum, and of the fields that a relay may change.

use super::*;
use proptest::prelude::*;

fn packet() -> impl Strategy<Value = Packet> {
    let flags = (0..8_usize, any::<bool>(), any::<bool>(), any::<bool>(), 0..8_u8, 0..16_u8);
    let ids = (any::<u16>(), any::<u16>(), any::<u16>(), any::<u8>(), 0..Seq24::MODULUS);
    (flags, ids, 0..10_000_000_000_000_u64, proptest::collection::vec(any::<u8>(), 0..=12)).prop_map(
        |((kind, command, more, resent, hops, fragment), (d, s, p, i, q), remaining, bytes)| Packet {
            kind: Kind::ALL[kind],
            class: if command { Class::Command } else { Class::Status },
            more,
            resent,
            hops,
            fragment,
            destination: TaskId(d),
            source: TaskId(s),
            port: PortId(p),
            id: MessageId { incarnation: Incarnation(i), sequence: Seq24::new(q) },
            remaining: Ticks(remaining),
            contents: Contents::new(&bytes).unwrap(),
            seal: Seal::NONE,
        },
    )
}

proptest! {
    #[test]
    fn decoding_undoes_encoding_and_never_adds_remaining_time(p in packet(), digest: u32, hash: u32) {
        let back = Packet::decode(&p.encode(digest, hash), digest, |_| Some(hash)).unwrap();
        prop_assert!(back.remaining <= p.remaining);
        let lost = p.remaining - back.remaining;
        prop_assert!(p.remaining.0 > 5_000_000_000_000 || lost.0 <= WIRE_STEP_US.max(p.remaining.0 >> 23));
        prop_assert_eq!(Packet { remaining: p.remaining, ..back }, p);
    }

    #[test]
    fn relaying_keeps_the_checksum(p in packet(), hops in 0..8_u8, less: u64) {
        let mut bytes = p.encode(1, 2);
        let came = Packet::decode(&bytes, 1, |_| Some(2)).unwrap();
        let relayed = Packet { hops, remaining: Ticks(came.remaining.0.min(less)), ..came }.encode(1, 2);
        let made = Packet { seal: Seal::NONE, hops, remaining: Ticks(came.remaining.0.min(less)), ..came };
        prop_assert_eq!(made.encode(1, 2), relayed, "what it came with is what would be computed");
        bytes[1] = relayed[1];
        bytes[12..15].copy_from_slice(&relayed[12..15]);
        bytes[15] = relayed[15];
        prop_assert_eq!(bytes, relayed);
    }

    #[test]
    fn any_bytes_behind_a_right_checksum_are_a_packet_or_an_error(mut bytes: [u8; 32], digest: u32, hash: u32) {
        // Most random bytes have another version or nonzero padding. So the test sets the version, a length of at least 12
        // and the zero bit.
        bytes[0] = (bytes[0] & 0x3f) | (PACKET_VERSION << 6);
        bytes[1] = (bytes[1] | 0xc0) & !1;
        let crc = checksum(&bytes, digest, hash);
        bytes[28..].copy_from_slice(&crc.to_le_bytes());
        if let Ok(p) = Packet::decode(&bytes, digest, |_| Some(hash)) {
            let again = p.encode(digest, hash);
            prop_assert_eq!(Packet::decode(&again, digest, |_| Some(hash)), Ok(p));
        }
    }
}

fn sample() -> Packet {
    Packet {
        kind: Kind::Arrive,
        class: Class::Command,
        more: false,
        resent: true,
        hops: 7,
        fragment: 0,
        destination: TaskId(0x0102),
        source: TaskId(0x0304),
        port: PortId(5),
        id: MessageId { incarnation: Incarnation(9), sequence: Seq24::new(0x0a_0b0c) },
        remaining: Ticks(2_000_000),
        contents: Meeting { round: Round(7), released: Round(6), arguments: *b"abcdefgh" }.to_contents(),
        seal: Seal::NONE,
    }
}

#[test]
#[expect(clippy::unusual_byte_groupings, reason = "a group of digits for each field")]
fn the_layout_is_the_documented_one() {
    let bytes = sample().encode(0xdead_beef, 0x1234_5678);
    let mut expected = [
        0b01_100_1_0_1,
        0b1100_111_0,
        2,
        1,
        4,
        3,
        5,
        0,
        9,
        0x0c,
        0x0b,
        0x0a,
        0x40,
        0x0d,
        0x03,
        0,
        7,
        0,
        6,
        0,
        b'a',
        b'b',
        b'c',
        b'd',
        b'e',
        b'f',
        b'g',
        b'h',
        0,
        0,
        0,
        0,
    ];
    expected[28..].copy_from_slice(&bytes[28..]);
    assert_eq!(bytes, expected);
}

#[test]
fn a_packet_of_another_cell_version_or_port_is_told_apart() {
    let bytes = sample().encode(1, 2);
    assert_eq!(Packet::decode(&bytes, 3, |_| Some(2)), Err(PacketError::Checksum));
    assert_eq!(Packet::decode(&bytes, 1, |_| Some(4)), Err(PacketError::Checksum));
    assert_eq!(Packet::decode(&bytes, 1, |_| None), Err(PacketError::UnknownPort(PortId(5))));
    let mut other = bytes;
    other[0] = (other[0] & 0x3f) | 0x80;
    assert_eq!(Packet::decode(&other, 1, |_| Some(2)), Err(PacketError::Version(2)));
}

#[test]
fn lengths_and_padding_are_checked_behind_a_right_checksum() {
    let forge = |change: fn(&mut [u8; 32])| {
        let mut b = Packet { contents: Contents::new(b"abc").unwrap(), ..sample() }.encode(1, 2);
        change(&mut b);
        let crc = checksum(&b, 1, 2);
        b[28..].copy_from_slice(&crc.to_le_bytes());
        Packet::decode(&b, 1, |_| Some(2))
    };
    assert!(forge(|_| ()).is_ok());
    assert_eq!(forge(|b| b[1] = (b[1] & 0x0f) | 0xd0), Err(PacketError::Malformed));
    assert_eq!(forge(|b| b[20] = 1), Err(PacketError::Malformed));
    assert_eq!(forge(|b| b[1] |= 1), Err(PacketError::Malformed), "the bit after the hops");
}

/// Flips each bit of a packet in a relay's memory, except hops and remaining time, which relays change themselves. The
/// destination detects every flip.
#[test]
fn a_bit_that_falls_over_in_a_relay_is_found_at_the_destination() {
    let (mut flipped, mut found) = (0, 0);
    for kind in Kind::ALL {
        let sent = Packet { kind, ..sample() }.encode(1, 2);
        let came = Packet::decode(&sent, 1, |_| Some(2)).unwrap();
        let mut damaged = alloc::vec::Vec::new();
        let mut flip = |bits: u32, flip: &dyn Fn(&mut Packet, u32)| {
            for bit in 0..bits {
                let mut packet = came;
                flip(&mut packet, bit);
                damaged.push(packet);
            }
        };
        flip(3, &|p, bit| p.kind = Kind::ALL[(p.kind as usize) ^ (1 << bit)]);
        flip(1, &|p, _| p.class = Class::Status);
        flip(1, &|p, _| p.more = !p.more);
        flip(1, &|p, _| p.resent = !p.resent);
        flip(4, &|p, bit| p.fragment ^= 1 << bit);
        flip(16, &|p, bit| p.destination.0 ^= 1 << bit);
        flip(16, &|p, bit| p.source.0 ^= 1 << bit);
        flip(16, &|p, bit| p.port.0 ^= 1 << bit);
        flip(8, &|p, bit| p.id.incarnation.0 ^= 1 << bit);
        flip(24, &|p, bit| p.id.sequence = Seq24::new(p.id.sequence.get() ^ 1 << bit));
        flip(4, &|p, bit| p.contents.len ^= 1 << bit);
        flip(96, &|p, bit| p.contents.bytes[bit as usize / 8] ^= 1 << (bit % 8));
        flip(32, &|p, bit| p.seal.0 = NonZeroU32::new(p.seal.0.map_or(0, NonZeroU32::get) ^ 1 << bit));
        for packet in damaged {
            let bytes = packet.encode(1, 2);
            flipped += 1;
            found += u32::from(Packet::decode(&bytes, 1, |_| Some(2)) == Err(PacketError::Checksum));
            // A recomputed checksum would hide the flip.
            let anew = Packet { seal: Seal::NONE, ..packet }.encode(1, 2);
            assert_ne!(Packet::decode(&anew, 1, |_| Some(2)), Err(PacketError::Checksum));
        }
    }
    assert_eq!((flipped, found), (8 * 222, 8 * 222));
}

#[test]
fn a_seal_is_no_part_of_what_a_packet_says() {
    let came = Packet::decode(&sample().encode(1, 2), 1, |_| Some(2)).unwrap();
    assert_eq!(came, sample());
    assert!(came.seal.0.is_some() && sample().seal.0.is_none());
    assert!(size_of::<Packet>() <= 48, "packets are copied often");
}

#[test]
fn control_contents_are_total() {
    for control in [Control::Refused, Control::Restarted, Control::RefusedOnTheWay] {
        let p = Packet { contents: control.to_contents(), ..sample() };
        assert_eq!(p.control(), Some(control));
    }
    assert_eq!(sample().control(), None);
}

/// The polynomial (0xF4ACFB13) was chosen for this: any one to six flipped bits of the 256 on the wire (224 covered, 32
/// of the checksum) are detected. A pattern of up to six bits is the sum of two disjoint patterns of up to three, so it
/// suffices that no two patterns of up to three bits share a syndrome.
#[test]
fn up_to_six_flipped_bits_are_always_noticed() {
    const PREFIX: usize = 8;
    let zero = CRC.checksum(&[0; PREFIX + 28]);
    let mut single = alloc::vec::Vec::new();
    for bit in 0..28 * 8 {
        let mut bytes = [0_u8; PREFIX + 28];
        bytes[PREFIX + bit / 8] = 1 << (bit % 8);
        single.push(CRC.checksum(&bytes) ^ zero);
    }
    single.extend((0..32).map(|bit| 1_u32 << bit));
    let mut seen = alloc::vec![0];
    for (i, &a) in single.iter().enumerate() {
        seen.push(a);
        for (j, &b) in single.iter().enumerate().skip(i + 1) {
            seen.push(a ^ b);
            seen.extend(single.iter().skip(j + 1).map(|&c| a ^ b ^ c));
        }
    }
    seen.sort_unstable();
    let patterns = seen.len();
    seen.dedup();
    assert_eq!(seen.len(), patterns, "two patterns of up to three bits share a syndrome");
}
