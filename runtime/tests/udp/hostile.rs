//! Datagrams that are not for this node: each is counted under its reason, nothing is delivered, nothing panics.

use super::rig::{
    A, B, C, Memory, cell, digests, encoded, envelope, envelope_of, link, packet, raw_socket, sealed,
    sealed_for,
};
use imrs_protocol::{Incarnation, NodeId, PacketError, PortId};
use imrs_runtime::link::LinkDiscard;
use imrs_runtime::link::udp::UdpLink;
use imrs_wire::envelope::{Digests, Envelope, MAGIC, VERSION};
use std::net::UdpSocket;

struct Victim {
    link: UdpLink,
    memory: Memory,
    from: UdpSocket,
}

impl Victim {
    fn new() -> Self {
        Self { link: link(B), memory: Memory::default(), from: raw_socket() }
    }

    fn throw(&self, bytes: &[u8]) {
        self.from.send_to(bytes, self.link.local_address()).unwrap();
    }

    /// Sends datagrams one by one, each of which must be dropped. Returns the reason of each drop.
    fn reasons<'a>(&self, datagrams: impl IntoIterator<Item = &'a [u8]>) -> Vec<LinkDiscard> {
        let mut reasons = Vec::new();
        for bytes in datagrams {
            self.throw(bytes);
            let dropped = self.memory.take_discards(&self.link, 1);
            assert_eq!(dropped.len(), 1, "{bytes:02x?}");
            reasons.extend(dropped);
        }
        assert_eq!(self.memory.delivered(), 0);
        reasons
    }

    fn reason(&self, bytes: &[u8]) -> LinkDiscard {
        self.reasons([bytes])[0]
    }

    /// Asserts that the node still accepts a valid datagram.
    fn still_listens(&self, counter: u64) {
        self.throw(&sealed(&envelope(counter), &[encoded(1)]));
        let got = self.memory.take_packets(&self.link, 1);
        assert_eq!((got.len(), got[0].0, got[0].1), (1, A, packet(1)));
    }
}

#[test]
fn garbage_of_every_first_byte() {
    let victim = Victim::new();
    let mut random = fastrand::Rng::with_seed(7);
    for first in 0..=u8::MAX {
        let mut bytes: Vec<u8> = (0..random.usize(4..1_600)).map(|_| random.u8(..)).collect();
        bytes[0] = first;
        let expected = if bytes[..2] == MAGIC { LinkDiscard::Version } else { LinkDiscard::NotImrs };
        assert_eq!(victim.reason(&bytes), expected);
    }
    for length in 0..4 {
        assert_eq!(victim.reason(&vec![0; length]), LinkDiscard::TooShort);
    }
    victim.still_listens(0);
}

#[test]
fn garbage_behind_a_right_beginning() {
    let victim = Victim::new();
    let mut random = fastrand::Rng::with_seed(8);
    for _ in 0..1_000 {
        let mut bytes: Vec<u8> = (0..random.usize(4..1_600)).map(|_| random.u8(..)).collect();
        bytes[..4].copy_from_slice(&[MAGIC[0], MAGIC[1], VERSION, 0]);
        let expected = match bytes.len() {
            0..64 => LinkDiscard::TooShort,
            n if n <= 1472 && (n - 64).is_multiple_of(32) => LinkDiscard::Checksum,
            _ => LinkDiscard::Length,
        };
        assert_eq!(victim.reason(&bytes), expected);
    }
    victim.still_listens(0);
}

#[test]
fn a_flipped_bit_anywhere() {
    let victim = Victim::new();
    let good = sealed(&envelope(0), &[encoded(1)]);
    for bit in 0..good.len() * 8 {
        let mut bytes = good.clone();
        bytes[bit / 8] ^= 1 << (bit % 8);
        let expected = match bit / 8 {
            0 | 1 => LinkDiscard::NotImrs,
            2 => LinkDiscard::Version,
            3 => LinkDiscard::Mode,
            _ => LinkDiscard::Checksum,
        };
        assert_eq!(victim.reason(&bytes), expected, "bit {bit}");
    }
    victim.still_listens(0);
}

#[test]
fn cut_off_and_trailing() {
    let victim = Victim::new();
    let good = sealed(&envelope(0), &[encoded(1), encoded(2)]);
    for length in 0..good.len() {
        let expected = match length {
            0..64 => LinkDiscard::TooShort,
            64 | 96 => LinkDiscard::Checksum,
            _ => LinkDiscard::Length,
        };
        assert_eq!(victim.reason(&good[..length]), expected, "cut off at {length}");
    }
    for more in [1, 32, 5_000] {
        let long = [good.as_slice(), vec![0; more].as_slice()].concat();
        assert_eq!(victim.reason(&long), LinkDiscard::Length, "{more} trailing bytes");
    }
    victim.still_listens(0);
}

#[test]
fn strangers() {
    let victim = Victim::new();
    let other = Digests { cell: cell("another cell").digest(), ..digests() };
    assert_eq!(victim.reason(&sealed_for(other, &envelope(0), &[encoded(1)])), LinkDiscard::OtherCell);
    let other = Digests { statements: 1, ..digests() };
    assert_eq!(victim.reason(&sealed_for(other, &envelope(0), &[encoded(1)])), LinkDiscard::OtherStatements);
    for sender in [B, NodeId(3), NodeId(9), NodeId(u16::MAX)] {
        let strange = sealed(&Envelope { sender, ..envelope(0) }, &[encoded(1)]);
        assert_eq!(victim.reason(&strange), LinkDiscard::UnknownNode, "{sender}");
    }
    assert_eq!(*victim.memory.peers.lock().unwrap(), [], "no stranger is announced");
    victim.still_listens(0);
}

#[test]
fn bad_packets_in_a_good_envelope_leave_the_others_alone() {
    let victim = Victim::new();
    let mut damaged = encoded(2);
    damaged[20] ^= 1;
    let mut foreign = encoded(3);
    foreign[6] = 77;
    let mut newer = encoded(4);
    newer[0] ^= 0x80;
    victim.throw(&sealed(&envelope(0), &[encoded(1), damaged, foreign, newer, encoded(5)]));
    let got = victim.memory.take_packets(&victim.link, 2);
    assert_eq!(got.iter().map(|p| p.1).collect::<Vec<_>>(), [packet(1), packet(5)]);
    let reasons = victim.memory.take_discards(&victim.link, 3);
    let [first, second, third] = reasons[..] else { panic!("{reasons:?}") };
    assert_eq!(first, LinkDiscard::Packet(PacketError::Checksum));
    assert_eq!(second, LinkDiscard::Packet(PacketError::UnknownPort(PortId(77))));
    assert!(matches!(third, LinkDiscard::Packet(PacketError::Version(_))));
}

#[test]
fn repetitions_and_earlier_incarnations() {
    let victim = Victim::new();
    let from = |incarnation: u8, counter: u64| sealed(&envelope_of(incarnation, counter), &[encoded(1)]);
    for counter in [0, 1, 1_500, 1_499, 477] {
        victim.throw(&from(1, counter));
        assert_eq!(victim.memory.take_packets(&victim.link, 1).len(), 1, "{counter}");
    }
    let repeated = [1_500, 477, 476, 1].map(|counter| from(1, counter));
    assert_eq!(victim.reasons(repeated.iter().map(Vec::as_slice)), [LinkDiscard::Replayed; 4]);
    victim.throw(&from(2, 0));
    assert_eq!(victim.memory.take_packets(&victim.link, 1).len(), 1);
    assert_eq!(victim.reason(&from(1, 1_501)), LinkDiscard::StaleIncarnation);
    assert_eq!(victim.reason(&from(2, 0)), LinkDiscard::Replayed);
    let peers = victim.memory.peers.lock().unwrap();
    assert_eq!(*peers, [(A, Incarnation(1), false), (A, Incarnation(2), true)]);
}

/// Incarnations and counters are kept for each neighbour.
#[test]
fn neighbours_are_told_apart() {
    let victim = Victim::new();
    for sender in [A, C] {
        victim.throw(&sealed(&Envelope { sender, ..envelope(0) }, &[encoded(1)]));
        assert_eq!(victim.memory.take_packets(&victim.link, 1)[0].0, sender);
    }
}
