//! The 32-byte packet (Figure 5, D47).
//!
//! ```text
//!  0      version 2 | kind 3 | class 1 | more fragments 1 | re-sent 1      (high bits first)
//!  1      length 4 | hops left 3 | zero 1
//!  2..4   destination task        4..6  source task        6..8  port          (little endian)
//!  8      incarnation             9..12 sequence
//! 12..15  remaining: mantissa     15    fragment index 4 | exponent 4
//! 16..28  contents
//! 28..32  CRC-32/AUTOSAR, end to end
//! ```
//!
//! Remaining time is `mantissa x 10 us << exponent`, rounded down: encoding may shorten it, but never lengthens it.
//! The CRC also covers the cell digest and the port hash, which are not sent, so a packet of another cell fails the check.
//! It omits the fields that relays change (hops left, remaining); the envelope covers those on each hop (D48).

use crate::ids::{Incarnation, MessageId, PortId, Round, Seq24, TaskId};
use crate::ticks::Ticks;
use core::fmt;
use core::num::NonZeroU32;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

mod blank;
mod padded;
#[cfg(feature = "checker")]
mod walk;

/// The size of every packet, in bytes.
pub const PACKET_BYTES: usize = 32;
/// How many bytes of contents one packet carries: three one-word parameters.
pub const CONTENTS_BYTES: usize = 12;
/// How many relays a packet may pass.
pub const MAX_HOPS: u8 = 7;
/// The packet format of this library.
pub const PACKET_VERSION: u8 = 1;
/// The finest step of remaining time on the wire, in microseconds.
pub const WIRE_STEP_US: u64 = 10;

/// What a packet is for. The port's usage tells the destination which verb the sending program used (R44).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum Kind {
    /// A message for a `receive`.
    Send = 0,
    /// A message that may interrupt its target (§4.2).
    Query = 1,
    /// The answer to a received message.
    Reply = 2,
    /// The answer to a query.
    Response = 3,
    /// "I have reached the rendezvous" (§4.3).
    Arrive = 4,
    /// "All have reached the rendezvous" (§4.3).
    Confirm = 5,
    /// "I have left the rendezvous without a release" (D2).
    Abort = 6,
    /// An answer of the communication task itself; see [`Control`].
    Control = 7,
}

impl Kind {
    /// All kinds, in the order of their discriminants.
    pub const ALL: [Self; 8] = [
        Self::Send,
        Self::Query,
        Self::Reply,
        Self::Response,
        Self::Arrive,
        Self::Confirm,
        Self::Abort,
        Self::Control,
    ];
}

/// The paper's two classes of messages (§III; D7).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Class {
    /// Class 2: has meaning until its time_out; the sender waits for the answer. Sorts before status.
    Command,
    /// Class 1: worth nothing once it is late. The sender does not wait, and there is no reply.
    Status,
}

/// What a [`Kind::Control`] packet says about the request whose id it carries. Code 3 is reserved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Control {
    /// The destination found no space for the message; the task never sees the message (D21).
    Refused,
    /// A transit buffer on the route found no space for this copy; another copy may still arrive (D19).
    RefusedOnTheWay,
    /// The destination restarted and cannot know whether the request ran before (D49).
    Restarted,
}

/// Up to [`CONTENTS_BYTES`] bytes of message contents; the bytes past the length are zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "WrittenContents")]
pub struct Contents {
    len: u8,
    bytes: [u8; CONTENTS_BYTES],
}

/// Contents as a file has them, before validation.
#[derive(Deserialize)]
#[serde(rename = "Contents")]
struct WrittenContents {
    len: u8,
    bytes: [u8; CONTENTS_BYTES],
}

impl TryFrom<WrittenContents> for Contents {
    type Error = PacketError;

    fn try_from(WrittenContents { len, bytes }: WrittenContents) -> Result<Self, Self::Error> {
        let padding = bytes.get(usize::from(len)..).ok_or(PacketError::Malformed)?;
        if padding.iter().any(|&byte| byte != 0) {
            return Err(PacketError::Malformed);
        }
        Ok(Self { len, bytes })
    }
}

impl Contents {
    /// Contents without any bytes.
    pub const EMPTY: Self = Self { len: 0, bytes: [0; CONTENTS_BYTES] };

    /// Contents of these bytes, or `None` if they are longer than one packet carries.
    #[must_use]
    pub fn new(bytes: &[u8]) -> Option<Self> {
        let mut contents = Self::EMPTY;
        contents.bytes.get_mut(..bytes.len())?.copy_from_slice(bytes);
        contents.len = u8::try_from(bytes.len()).ok()?;
        Some(contents)
    }

    /// The bytes.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        &self.bytes[..usize::from(self.len)]
    }
}

/// The contents of ARRIVE, CONFIRM and ABORT (D47, D54).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Meeting {
    /// The round to which the packet belongs.
    pub round: Round,
    /// The round from which its sender was last released.
    pub released: Round,
    /// The arguments of the `waitfor`. In an ABORT the first two bytes are the round with which to continue.
    pub arguments: [u8; 8],
}

impl Meeting {
    /// The packet contents of this meeting.
    #[must_use]
    pub fn to_contents(self) -> Contents {
        let mut bytes = [0; CONTENTS_BYTES];
        bytes[..2].copy_from_slice(&self.round.0.to_le_bytes());
        bytes[2..4].copy_from_slice(&self.released.0.to_le_bytes());
        bytes[4..].copy_from_slice(&self.arguments);
        Contents { len: 12, bytes }
    }

    /// The meeting that packet contents describe. Missing bytes of short contents read as zero.
    #[must_use]
    pub fn from_contents(contents: &Contents) -> Self {
        let b = &contents.bytes;
        let mut arguments = [0; 8];
        arguments.copy_from_slice(&b[4..]);
        Self {
            round: Round(u16::from_le_bytes([b[0], b[1]])),
            released: Round(u16::from_le_bytes([b[2], b[3]])),
            arguments,
        }
    }

    /// The round with which an ABORT asks its receivers to continue.
    #[must_use]
    pub fn next_round(self) -> Round {
        Round(u16::from_le_bytes([self.arguments[0], self.arguments[1]]))
    }

    /// The arguments of an ABORT that asks its receivers to continue with the round `next`.
    #[must_use]
    pub fn abort_arguments(next: Round) -> [u8; 8] {
        let [low, high] = next.0.to_le_bytes();
        [low, high, 0, 0, 0, 0, 0, 0]
    }
}

/// A packet in memory. Packets between tasks of one node stay in this form and are never serialised (D44).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Packet {
    /// What the packet is for.
    pub kind: Kind,
    /// The class of the message.
    pub class: Class,
    /// Whether more fragments of the same message follow (D28).
    pub more: bool,
    /// Whether this is a retransmission (D5, D55).
    pub resent: bool,
    /// How many more relays the packet may pass.
    #[serde(deserialize_with = "at_most::<_, MAX_HOPS>")]
    pub hops: u8,
    /// The position of the packet among the fragments of one message.
    #[serde(deserialize_with = "at_most::<_, LAST_FRAGMENT>")]
    pub fragment: u8,
    /// The task for which the packet is.
    pub destination: TaskId,
    /// The task from which the packet comes.
    pub source: TaskId,
    /// The port of the message.
    pub port: PortId,
    /// In a request, its own id; in an answer, the id of the request.
    pub id: MessageId,
    /// The remaining time: the rest of the time_out, never an instant (§III, D37).
    pub remaining: Ticks,
    /// The contents of the message.
    pub contents: Contents,
    /// The checksum with which the packet arrived over a link.
    #[serde(skip)]
    pub seal: Seal,
}

/// The end-to-end checksum with which a packet arrived over a link; empty for a packet that this node made.
///
/// A relay forwards the checksum unchanged. A recomputed checksum would also cover bits that flipped in the relay's memory,
/// and the destination would accept the damage (D154).
///
/// Comparisons of packets ignore the seal: packets that differ only in their seals are equal, hash alike and pack into the
/// same bytes of a state. The checker makes all packets itself, so its states hold no seals.
#[derive(Clone, Copy, Debug, Default)]
pub struct Seal(
    /// The checksum. A checksum of zero counts as absent and is recomputed, which happens about once in 2^32 packets.
    Option<NonZeroU32>,
);

impl Seal {
    /// The seal of a packet made by this node: [`Packet::encode`] computes the checksum.
    pub const NONE: Self = Self(None);
}

impl PartialEq for Seal {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Eq for Seal {}

impl core::hash::Hash for Seal {
    fn hash<H: core::hash::Hasher>(&self, _: &mut H) {}
}

/// The highest position of a fragment: the field has four bits.
const LAST_FRAGMENT: u8 = 15;

/// Deserialises a number, and rejects one above `MOST`, because a number in a file may not fit the packet's field.
fn at_most<'de, D: Deserializer<'de>, const MOST: u8>(from: D) -> Result<u8, D::Error> {
    let number = u8::deserialize(from)?;
    if number <= MOST { Ok(number) } else { Err(D::Error::custom(PacketError::Malformed)) }
}

/// Why 32 bytes are not a packet for this node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum PacketError {
    /// Another version of the packet format made the bytes.
    Version(u8),
    /// The packet names a port that the cell does not have.
    UnknownPort(PortId),
    /// The end-to-end checksum is wrong: the packet is damaged, or was made for another cell or declaration of the port.
    Checksum,
    /// The length field exceeds the contents, or a bit that must be zero is set.
    Malformed,
}

impl fmt::Display for PacketError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Version(v) => write!(f, "packet format {v}, this node speaks {PACKET_VERSION}"),
            Self::UnknownPort(p) => write!(f, "port {p} is not in this cell"),
            Self::Checksum => write!(f, "checksum is wrong (damaged, or made for another cell)"),
            Self::Malformed => write!(f, "malformed packet"),
        }
    }
}

impl core::error::Error for PacketError {}

/// The checksum of packets. The lookup table handles sixteen bytes per step.
static CRC: crc::Crc<u32, crc::Table<16>> = crc::Crc::<u32, crc::Table<16>>::new(&crc::CRC_32_AUTOSAR);

/// The bits of byte 1 that relays change.
const HOP_BITS: u8 = 0b0000_1110;

fn checksum(bytes: &[u8; PACKET_BYTES], digest: u32, port_hash: u32) -> u32 {
    let mut covered = [0; 36];
    covered[..4].copy_from_slice(&digest.to_le_bytes());
    covered[4..8].copy_from_slice(&port_hash.to_le_bytes());
    covered[8..].copy_from_slice(&bytes[..28]);
    let packet = &mut covered[8..];
    packet[1] &= !HOP_BITS;
    packet[12..15].fill(0);
    packet[15] &= 0xf0;
    CRC.checksum(&covered)
}

/// Remaining time as the wire carries it: the largest `(mantissa, exponent)` that is not more than `remaining`
/// microseconds. Times past the end of the scale become the largest one, about 63 days.
fn to_wire(remaining: Ticks) -> (u32, u8) {
    const MANTISSA_MAX: u64 = (1 << 24) - 1;
    let steps = remaining.0 / WIRE_STEP_US;
    let bits = 64 - steps.leading_zeros();
    let exponent = bits.saturating_sub(24).min(15);
    let mantissa = (steps >> exponent).min(MANTISSA_MAX);
    (u32::try_from(mantissa).unwrap_or(u32::MAX), u8::try_from(exponent).unwrap_or(15))
}

fn from_wire(mantissa: u32, exponent: u8) -> Ticks {
    Ticks((u64::from(mantissa) << exponent) * WIRE_STEP_US)
}

impl Packet {
    /// The bytes of this packet. `digest` is the digest of the cell, `port_hash` the hash of the packet's port. A packet
    /// that arrived over a link keeps its checksum.
    #[must_use]
    pub fn encode(&self, digest: u32, port_hash: u32) -> [u8; PACKET_BYTES] {
        let mut b = [0; PACKET_BYTES];
        b[0] = (PACKET_VERSION << 6)
            | ((self.kind as u8) << 3)
            | (u8::from(self.class == Class::Command) << 2)
            | (u8::from(self.more) << 1)
            | u8::from(self.resent);
        b[1] = (self.contents.len << 4) | ((self.hops & 7) << 1);
        b[2..4].copy_from_slice(&self.destination.0.to_le_bytes());
        b[4..6].copy_from_slice(&self.source.0.to_le_bytes());
        b[6..8].copy_from_slice(&self.port.0.to_le_bytes());
        b[8] = self.id.incarnation.0;
        b[9..12].copy_from_slice(&self.id.sequence.get().to_le_bytes()[..3]);
        let (mantissa, exponent) = to_wire(self.remaining);
        b[12..15].copy_from_slice(&mantissa.to_le_bytes()[..3]);
        b[15] = (self.fragment << 4) | exponent;
        b[16..28].copy_from_slice(&self.contents.bytes);
        let crc = self.seal.0.map_or_else(|| checksum(&b, digest, port_hash), NonZeroU32::get);
        b[28..].copy_from_slice(&crc.to_le_bytes());
        b
    }

    /// The packet in the bytes `b`. `port_hash` looks up the hash of a port of this cell.
    ///
    /// # Errors
    /// Says why the bytes are not a packet of this cell. Never panics, whatever the bytes are.
    pub fn decode(
        b: &[u8; PACKET_BYTES],
        digest: u32,
        port_hash: impl FnOnce(PortId) -> Option<u32>,
    ) -> Result<Self, PacketError> {
        let version = b[0] >> 6;
        if version != PACKET_VERSION {
            return Err(PacketError::Version(version));
        }
        let port = PortId(u16::from_le_bytes([b[6], b[7]]));
        let hash = port_hash(port).ok_or(PacketError::UnknownPort(port))?;
        let crc = u32::from_le_bytes([b[28], b[29], b[30], b[31]]);
        if checksum(b, digest, hash) != crc {
            return Err(PacketError::Checksum);
        }
        let len = b[1] >> 4;
        let mut bytes = [0; CONTENTS_BYTES];
        bytes.copy_from_slice(&b[16..28]);
        let padding = bytes.get(usize::from(len)..).ok_or(PacketError::Malformed)?;
        if b[1] & 1 != 0 || padding.iter().any(|&byte| byte != 0) {
            return Err(PacketError::Malformed);
        }
        Ok(Self {
            kind: Kind::ALL[usize::from((b[0] >> 3) & 7)],
            class: if b[0] & 4 != 0 { Class::Command } else { Class::Status },
            more: b[0] & 2 != 0,
            resent: b[0] & 1 != 0,
            hops: (b[1] & HOP_BITS) >> 1,
            fragment: b[15] >> 4,
            destination: TaskId(u16::from_le_bytes([b[2], b[3]])),
            source: TaskId(u16::from_le_bytes([b[4], b[5]])),
            port,
            id: MessageId {
                incarnation: Incarnation(b[8]),
                sequence: Seq24::new(u32::from_le_bytes([b[9], b[10], b[11], 0])),
            },
            remaining: from_wire(u32::from_le_bytes([b[12], b[13], b[14], 0]), b[15] & 0x0f),
            contents: Contents { len, bytes },
            seal: Seal(NonZeroU32::new(crc)),
        })
    }

    /// The contents of a packet of a meeting.
    #[must_use]
    pub fn meeting(&self) -> Meeting {
        Meeting::from_contents(&self.contents)
    }

    /// What a CONTROL packet says, or `None` if this version does not know its code.
    #[must_use]
    pub fn control(&self) -> Option<Control> {
        match self.contents.as_bytes() {
            [1] => Some(Control::Refused),
            [2] => Some(Control::Restarted),
            [4] => Some(Control::RefusedOnTheWay),
            _ => None,
        }
    }
}

impl Control {
    /// The packet contents for this control code.
    #[must_use]
    pub fn to_contents(self) -> Contents {
        let mut contents = Contents { len: 1, ..Contents::EMPTY };
        contents.bytes[0] = match self {
            Self::Refused => 1,
            Self::Restarted => 2,
            Self::RefusedOnTheWay => 4,
        };
        contents
    }
}

#[cfg(test)]
mod tests;
