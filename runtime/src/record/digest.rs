//! The digest of all outputs of a communication task or a script.

use imrs_protocol::script::Address;
use imrs_protocol::{CONTENTS_BYTES, Contents, Delivery, MessageId, Outcome, Packet, Signal, Ticks, TimeId};
use postcard::ser_flavors::Flavor;
use serde::Serialize;

/// Identifies all outputs so far of a communication task or a script, in order. Two runs have equal digests only if
/// all their packets, signals and requests to the Timer were equal (except for collisions of 64 bits). The digest is
/// computed from 64-bit numbers that describe an output, so it is the same in every build and on every machine. This
/// module defines these numbers for outputs that occur with every message; other outputs are encoded with postcard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputDigest(pub u64);

/// An output that postcard encodes for the digest. The order of the variants, and of the variants inside of them, is part of
/// the recordings' format.
#[derive(Serialize)]
enum Output {
    Signal(Signal),
    Arm(TimeId, Ticks),
    Disarm(TimeId),
}

/// The top byte of the first number of an output whose numbers this module defines. In outputs that postcard encodes,
/// the top byte is never above 7.
#[derive(Clone, Copy)]
enum Mark {
    Packet = 0x80,
    Message = 0x81,
    Reply = 0x82,
    Accepted = 0x83,
    Statement = 0x84,
}

impl Mark {
    const fn over(self, rest: u64) -> u64 {
        ((self as u64) << 56) | rest
    }
}

impl OutputDigest {
    /// The digest before any output.
    pub const START: Self = Self(0xcbf2_9ce4_8422_2325);

    pub(crate) fn transmitted(&mut self, packet: &Packet) {
        let Packet { kind, class, more, resent, hops, fragment, .. } = *packet;
        let Packet { destination, source, port, id, remaining, ref contents, .. } = *packet;
        let flags = u64::from(more) | u64::from(resent) << 1 | (class as u64) << 2;
        let how = (kind as u64) << 24 | flags << 16 | u64::from(hops) << 8 | u64::from(fragment);
        self.mix(Mark::Packet.over(how));
        self.mix(u64::from(destination.0) << 32 | u64::from(source.0) << 16 | u64::from(port.0));
        self.mix(number(id));
        self.mix(remaining.0);
        self.contents(contents);
    }

    pub(crate) fn signalled(&mut self, signal: Signal) {
        match signal {
            Signal::Message(Delivery { from, class, budget, ref contents, fragments }) => {
                self.mix(Mark::Message.over((class as u64) << 8 | u64::from(fragments)));
                self.mix(u64::from(from.port.0) << 16 | u64::from(from.source.0));
                self.mix(number(from.id));
                self.mix(budget.0);
                self.contents(contents);
            }
            Signal::Outcome(Outcome::Reply(ref contents)) => {
                self.mix(Mark::Reply.over(0));
                self.contents(contents);
            }
            Signal::Accepted(copies) => self.mix(Mark::Accepted.over(u64::from(copies))),
            Signal::Outcome(_)
            | Signal::Fault(_)
            | Signal::Answers { .. }
            | Signal::Interrupt(_)
            | Signal::Granted(_)
            | Signal::Nothing
            | Signal::Released { .. }
            | Signal::GaveUp { .. }
            | Signal::TimeOut(_)
            | Signal::Cancelled => self.add(&Output::Signal(signal)),
        }
    }

    pub(crate) fn armed(&mut self, id: TimeId, length: Ticks) {
        self.add(&Output::Arm(id, length));
    }

    pub(crate) fn disarmed(&mut self, id: TimeId) {
        self.add(&Output::Disarm(id));
    }

    pub(crate) fn passed(&mut self, at: Address) {
        self.mix(Mark::Statement.over(u64::from(at)));
    }

    pub(crate) fn add(&mut self, output: &impl Serialize) {
        // Every output can be serialised. If one could not, the digest would stay the same in the run and in the replay.
        let lanes = Lanes { digest: *self, lane: 0, filled: 0 };
        if let Ok(digest) = postcard::serialize_with_flavor(output, lanes) {
            *self = digest;
        }
    }

    /// Mixes eight bytes into the hash, by xor, a multiplication and a shift, none of which loses information.
    const fn mix(&mut self, lane: u64) {
        let hash = (self.0 ^ lane).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = hash ^ (hash >> 32);
    }

    /// Mixes the bytes of the contents into the digest, and their number in the top byte of the last word.
    fn contents(&mut self, contents: &Contents) {
        const { assert!(CONTENTS_BYTES == 12) };
        let [a, b, c, d, e, f, g, h, i, j, k, l] = *contents.padded();
        self.mix(u64::from_le_bytes([a, b, c, d, e, f, g, h]));
        let length = (contents.as_bytes().len() as u64) << 56;
        self.mix(length | u64::from(u32::from_le_bytes([i, j, k, l])));
    }
}

const fn number(id: MessageId) -> u64 {
    (id.incarnation.0 as u64) << 32 | id.sequence.get() as u64
}

/// Mixes bytes into the digest, eight at a time (a lane). The last lane is never full, and has the number of its
/// bytes in its top byte.
struct Lanes {
    digest: OutputDigest,
    lane: u64,
    /// How many bits of the lane are filled.
    filled: u32,
}

impl Flavor for Lanes {
    type Output = OutputDigest;

    #[inline]
    fn try_push(&mut self, byte: u8) -> postcard::Result<()> {
        self.lane |= u64::from(byte) << self.filled;
        self.filled += 8;
        if self.filled == u64::BITS {
            self.digest.mix(self.lane);
            (self.lane, self.filled) = (0, 0);
        }
        Ok(())
    }

    fn finalize(mut self) -> postcard::Result<OutputDigest> {
        self.digest.mix(self.lane | u64::from(self.filled / 8) << 56);
        Ok(self.digest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use imrs_protocol::{Class, Control, Incarnation, Kind, PortId, ReplyTo, Seal, Seq24, TaskId};

    fn by_hand(lanes: &[u64]) -> OutputDigest {
        let step = |hash: u64, lane: &u64| {
            let hash = (hash ^ lane).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            hash ^ (hash >> 32)
        };
        OutputDigest(lanes.iter().fold(OutputDigest::START.0, step))
    }

    fn packet() -> Packet {
        Packet {
            kind: Kind::Control,
            class: Class::Command,
            more: true,
            resent: true,
            hops: 5,
            fragment: 3,
            destination: TaskId(0x102),
            source: TaskId(0x304),
            port: PortId(0x506),
            id: MessageId { incarnation: Incarnation(7), sequence: Seq24::new(0x08_090a) },
            remaining: Ticks(1 << 40),
            contents: Control::Refused.to_contents(),
            seal: Seal::NONE,
        }
    }

    /// Compares the digests with the numbers in recordings of other builds: if these numbers change, recordings need a
    /// new version.
    #[test]
    fn what_comes_with_every_message_is_laid_out_so() {
        let mut digest = OutputDigest::START;
        let yes = Contents::new(b"yes and more").unwrap();
        digest.transmitted(&Packet { contents: yes, ..packet() });
        let class = Class::Command as u64;
        let how = (Kind::Control as u64) << 24 | (3 | class << 2) << 16 | 5 << 8 | 3;
        let contents = [u64::from_le_bytes(*b"yes and "), u64::from_le_bytes(*b"more\0\0\0\x0c")];
        let mut lanes = vec![0x80 << 56 | how, 0x0102_0304_0506, 7 << 32 | 0x08_090a, 1 << 40];
        lanes.extend(contents);
        assert_eq!(digest, by_hand(&lanes));
        let from = ReplyTo { port: PortId(0x506), source: TaskId(0x304), id: packet().id };
        let message = Delivery { from, class: Class::Command, budget: Ticks(9), contents: yes, fragments: 2 };
        digest.signalled(Signal::Message(message));
        lanes.extend([0x81 << 56 | class << 8 | 2, 0x0506_0304, 7 << 32 | 0x08_090a, 9]);
        lanes.extend(contents);
        digest.signalled(Signal::Outcome(Outcome::Reply(yes)));
        lanes.push(0x82 << 56);
        lanes.extend(contents);
        digest.signalled(Signal::Accepted(2));
        digest.passed(77);
        lanes.extend([0x83 << 56 | 2, 0x84 << 56 | 77]);
        assert_eq!(digest, by_hand(&lanes));
        assert_eq!(digest, OutputDigest(0xc713_19c4_dc3b_783b));
    }

    #[test]
    fn the_rest_is_laid_out_as_postcard_has_it() {
        let mut digest = OutputDigest::START;
        digest.armed(TimeId(1), Ticks(300));
        digest.disarmed(TimeId(1));
        digest.signalled(Signal::TimeOut(TimeId(1)));
        // If a lane of eight bytes is full, an empty lane follows it.
        digest.armed(TimeId(1), Ticks(1 << 36));
        let short = |bytes: &[u8]| {
            let mut lane = [0; 8];
            lane[..bytes.len()].copy_from_slice(bytes);
            lane[7] = u8::try_from(bytes.len()).unwrap();
            u64::from_le_bytes(lane)
        };
        let full = u64::from_le_bytes([1, 1, 0x80, 0x80, 0x80, 0x80, 0x80, 0x02]);
        let lanes = [short(&[1, 1, 0xac, 0x02]), short(&[2, 1]), short(&[0, 10, 1]), full, 0];
        assert_eq!(digest, by_hand(&lanes));
    }

    /// Changes each field of a packet, and compares contents that could be mistaken for each other.
    #[test]
    fn packets_that_differ_have_other_digests() {
        let p = packet();
        let bytes = |bytes: &[u8]| Packet { contents: Contents::new(bytes).unwrap(), ..p };
        let others = [
            p,
            Packet { kind: Kind::Send, ..p },
            Packet { class: Class::Status, ..p },
            Packet { more: false, ..p },
            Packet { resent: false, ..p },
            Packet { hops: 4, ..p },
            Packet { fragment: 2, ..p },
            Packet { destination: TaskId(1), ..p },
            Packet { source: TaskId(1), ..p },
            Packet { port: PortId(1), ..p },
            Packet { id: MessageId { incarnation: Incarnation(8), ..p.id }, ..p },
            Packet { id: MessageId { sequence: Seq24::new(1), ..p.id }, ..p },
            Packet { remaining: Ticks(1), ..p },
            bytes(b""),
            bytes(b"\0"),
            bytes(b"\0\0\0\0\0\0\0\0\0\0\0\0"),
        ];
        let digests: std::collections::BTreeSet<u64> = others
            .iter()
            .map(|packet| {
                let mut digest = OutputDigest::START;
                digest.transmitted(packet);
                digest.0
            })
            .collect();
        assert_eq!(digests.len(), others.len());
    }
}
