//! The envelope (D48, D144): what every datagram between two nodes looks like.
//!
//! ```text
//!  0..2   magic 9d 4d
//!  2      version of the envelope: 2
//!  3      mode: how it is closed (0 checksum, 1 reserved for keys); the layout from here on is the mode's
//!
//!         mode 0, checksum (the `--insecure` mode), little endian:
//!  4..8   digest of the cell's declarations
//!  8..12  digest of its statements
//! 12..14  sender node
//! 14..16  receiver node
//! 16      incarnation of the sender
//! 17      bits 0-1 purpose: 0 packets, 1 greeting, 2 refusal
//!         bit 2 an echo is given
//!         bit 3 an earlier incarnation of the sender may have taken requests
//!         of a greeting: bit 4 it wants an answer, bit 5 the sender has no incarnation yet, bit 6 byte 19 is given
//! 18      packets, 0 to 44
//! 19      of a greeting: the incarnation of the receiver that the sender remembers; of a refusal: its reason
//! 20..28  session of the sender
//! 28..36  session of the receiver that the echo belongs to
//! 36..43  counter of the sender's datagrams to this receiver
//! 43      zero
//! 44..52  tx_mono: the sender's monotonic clock, in microseconds from an origin of its own
//! 52..60  echo: the receiver's monotonic clock, as the sender knows it (see [`Echo`])
//! 60..    0 to 44 packets of 32 bytes
//! last 4  CRC-32/MEF over everything before it
//! ```
//!
//! A greeting or a refusal takes 64 bytes, one packet makes 96. The most (44) make 1472, which fit an Ethernet frame under
//! IPv4; 36 fit 1232 bytes, which every IPv6 network carries. Every mode keeps to the same [`OVERHEAD_BYTES`]: one with
//! keys has 48 bytes of header and a tag of 16.
//!
//! The checksum uses another polynomial than the packets' own, because a checksum that is itself covered by one of the
//! same polynomial adds nothing: what passes the inner one would pass the outer one as well. It notices up to five
//! flipped bits in the longest datagram (a test computes this), the fields that relays change included. A checksum says
//! nothing about zeros behind the end, so the number of packets is written down and covered.
//!
//! A datagram that is not taken says why ([`EnvelopeError`]). [`read`] judges version and mode before the checksum, since
//! another version may close its datagrams differently. [`Opened::check`] judges digests, receiver and sender after it, so
//! that damage is never mistaken for another cell. The digests come before the node ids: ids of another cell mean nothing.

mod datagram;
mod error;
mod header;
mod window;

pub use datagram::Datagram;
pub use error::EnvelopeError;
pub use window::{ReplayWindow, WINDOW};

use crate::checksum::CRC;
use imrs_protocol::{Incarnation, NodeId, PACKET_BYTES};
use std::fmt;

/// The first two bytes of every datagram.
pub const MAGIC: [u8; 2] = [0x9d, 0x4d];
/// The envelope format of this library.
pub const VERSION: u8 = 2;
/// The most packets in one datagram.
pub const MAX_PACKETS: usize = 44;
/// What an envelope adds to its packets, in every mode.
pub const OVERHEAD_BYTES: usize = HEADER_BYTES + CHECKSUM_BYTES;
/// The shortest datagram: no packet.
pub const MIN_DATAGRAM_BYTES: usize = OVERHEAD_BYTES;
/// The longest datagram.
pub const MAX_DATAGRAM_BYTES: usize = OVERHEAD_BYTES + MAX_PACKETS * PACKET_BYTES;
/// Counters are below this: 56 bits, which no node ever uses up.
pub const COUNTER_END: u64 = 1 << 56;

const HEADER_BYTES: usize = 60;
const CHECKSUM_BYTES: usize = 4;
const MODE_CHECKSUM: u8 = 0;
/// The mode with keys. Reserved: no node speaks it yet.
pub const MODE_KEYS: u8 = 1;

/// What two nodes must have in common to talk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Digests {
    /// Of the cell's declarations: its canonical table.
    pub cell: u32,
    /// Of the cell's statements: the compiled scripts of all its tasks. Zero where no task has a script: of a task in
    /// another language nothing is known but that the cell declares it so.
    pub statements: u32,
}

impl fmt::Display for Digests {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "declarations {:08x}, statements {:08x}", self.cell, self.statements)
    }
}

/// Names one start of one node: 64 random bits, drawn anew whenever a node gets a socket. Sessions are compared for
/// equality only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Session(pub u64);

/// What a datagram says about itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Envelope {
    /// The node that sent it: the last hop, not the packets' source.
    pub sender: NodeId,
    /// The node that it is for: the next hop, not the packets' destination.
    pub receiver: NodeId,
    /// The incarnation of the sender (D49).
    pub incarnation: Incarnation,
    /// Whether the sender says that an earlier incarnation of it may have taken requests.
    pub restarted: bool,
    /// The session of the sender.
    pub session: Session,
    /// The position among the datagrams with packets that this session of the sender sent to this receiver; below
    /// [`COUNTER_END`].
    pub counter: u64,
    /// The sender's monotonic clock, in microseconds: not later than the instant for which the remaining times of the
    /// packets hold.
    pub tx_mono: u64,
    /// What the sender last heard of the receiver's clock.
    pub echo: Option<Echo>,
    /// What it is for.
    pub purpose: Purpose,
}

/// The receiver's own `tx_mono`, come back: the one of its last datagram that reached the sender, plus the time that
/// the sender has held it since. So at the sender's `tx_mono` the receiver's clock showed `mono` or more, and the round
/// trip took the receiver's clock on arrival minus `mono`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Echo {
    /// The session of the receiver whose clock it is: another session has a clock of another origin.
    pub session: Session,
    /// That clock, in microseconds.
    pub mono: u64,
}

/// What a datagram is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// It carries packets, at least one.
    Packets,
    /// It tells the receiver about the sender, and carries no packet.
    Greeting(Greeting),
    /// It tells the receiver that the sender takes none of its datagrams, and carries no packet.
    Refusal(Refused),
}

/// What a node says of itself and of the receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Greeting {
    /// Whether the receiver is asked for a greeting of its own. An answer wants none.
    pub wants_answer: bool,
    /// Whether the sender has no incarnation yet: it asks which ones are remembered, and its own field means nothing.
    pub uncounted: bool,
    /// The newest incarnation of the receiver that the sender remembers.
    pub remembers: Option<Incarnation>,
}

/// Why a node takes no datagram of another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Refused {
    /// The cell's declarations differ.
    OtherCell,
    /// The declarations are the same, and the statements differ.
    OtherStatements,
    /// The datagram names another receiver.
    Misdelivered,
}

impl Refused {
    const ALL: [Self; 3] = [Self::OtherCell, Self::OtherStatements, Self::Misdelivered];

    /// A short name for tables and counters.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::OtherCell => "other_cell",
            Self::OtherStatements => "other_statements",
            Self::Misdelivered => "misdelivered",
        }
    }
}

/// A datagram that is whole. Whether it is for this node, [`check`](Self::check) says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Opened<'a> {
    /// The sender's digests.
    pub digests: Digests,
    /// What it says about itself.
    pub envelope: Envelope,
    /// Its packets, still encoded.
    pub packets: &'a [[u8; PACKET_BYTES]],
}

/// Takes a datagram of any cell apart.
///
/// # Errors
/// Says why the bytes are no whole datagram. Total: never panics, whatever the bytes are.
pub fn read(bytes: &[u8]) -> Result<Opened<'_>, EnvelopeError> {
    let too_short = EnvelopeError::TooShort(bytes.len());
    let (prologue, _) = bytes.split_first_chunk::<4>().ok_or(too_short)?;
    if prologue[..2] != MAGIC {
        return Err(EnvelopeError::NotImrs);
    }
    if prologue[2] != VERSION {
        return Err(EnvelopeError::Version(prologue[2]));
    }
    if prologue[3] != MODE_CHECKSUM {
        return Err(EnvelopeError::Mode(prologue[3]));
    }
    if bytes.len() < MIN_DATAGRAM_BYTES {
        return Err(too_short);
    }
    let (covered, checksum) = bytes.split_last_chunk::<CHECKSUM_BYTES>().ok_or(too_short)?;
    let (header, body) = covered.split_first_chunk::<HEADER_BYTES>().ok_or(too_short)?;
    let (packets, ragged) = body.as_chunks::<PACKET_BYTES>();
    if !ragged.is_empty() || packets.len() > MAX_PACKETS {
        return Err(EnvelopeError::Length(bytes.len()));
    }
    if CRC.checksum(covered) != u32::from_le_bytes(*checksum) {
        return Err(EnvelopeError::Checksum);
    }
    if usize::from(header[header::COUNT_AT]) != packets.len() {
        return Err(EnvelopeError::Length(bytes.len()));
    }
    let envelope = Envelope::parse(header)?;
    if packets.is_empty() == matches!(envelope.purpose, Purpose::Packets) {
        return Err(EnvelopeError::Length(bytes.len()));
    }
    let digests = Digests { cell: header::four(header, 4), statements: header::four(header, 8) };
    Ok(Opened { digests, envelope, packets })
}

/// Takes a datagram for `node` of a cell with these digests apart: what it says about itself, and its packets, still
/// encoded. `known` tells whether a sender is acceptable.
///
/// # Errors
/// Says why the bytes are not a datagram for this node. Total: never panics, whatever the bytes are.
pub fn open(
    bytes: &[u8],
    node: NodeId,
    digests: Digests,
    known: impl FnOnce(NodeId) -> bool,
) -> Result<(Envelope, &[[u8; PACKET_BYTES]]), EnvelopeError> {
    let opened = read(bytes)?;
    opened.check(node, digests, known)?;
    Ok((opened.envelope, opened.packets))
}

impl Opened<'_> {
    /// Whether the datagram is for `node` of a cell with these digests. `known` tells whether a sender is acceptable.
    ///
    /// # Errors
    /// Says why not.
    pub fn check(
        &self,
        node: NodeId,
        digests: Digests,
        known: impl FnOnce(NodeId) -> bool,
    ) -> Result<(), EnvelopeError> {
        if self.digests.cell != digests.cell {
            return Err(EnvelopeError::OtherCell(self.digests.cell));
        }
        if self.digests.statements != digests.statements {
            return Err(EnvelopeError::OtherStatements(self.digests.statements));
        }
        if self.envelope.receiver != node {
            return Err(EnvelopeError::Misdelivered(self.envelope.receiver));
        }
        if !known(self.envelope.sender) {
            return Err(EnvelopeError::UnknownNode(self.envelope.sender));
        }
        Ok(())
    }
}

/// Whether incarnation `new` comes after `old`, around the wrap. A launcher counts a node's lives up by one (D49), so
/// the one less than half the circle ahead is the later.
#[must_use]
pub const fn supersedes(new: Incarnation, old: Incarnation) -> bool {
    let steps = new.0.wrapping_sub(old.0);
    steps != 0 && steps < 0x80
}

/// The bytes of a datagram without packets: a greeting, or a refusal.
#[must_use]
pub fn without_packets(envelope: &Envelope, digests: Digests) -> [u8; OVERHEAD_BYTES] {
    datagram::bare(envelope, digests)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    /// The choice of polynomial rests on this: no two to five flipped bits of the longest datagram go unnoticed. An odd
    /// number is noticed because the polynomial is a multiple of x + 1. Two or four bits, moved so that the lowest is
    /// bit 0, go unnoticed only where `1 + x^a = x^b + x^c` (or `1 = x^a`) for powers below the datagram's length.
    #[test]
    fn up_to_five_flipped_bits_of_the_longest_datagram_are_noticed() {
        const POLY: u32 = 0x741b_8cd7;
        assert_eq!(crc::CRC_32_MEF.poly, POLY);
        assert_eq!((POLY.count_ones() + 1) % 2, 0, "a multiple of x + 1 has an even number of terms");
        let bits = MAX_DATAGRAM_BYTES * 8;
        let mut power = 1_u32;
        let mut powers = Vec::with_capacity(bits);
        for _ in 0..bits {
            powers.push(power);
            power = (power << 1) ^ if power >> 31 == 1 { POLY } else { 0 };
        }
        let pairs: HashSet<u32> = powers[1..].iter().map(|&a| 1 ^ a).collect();
        assert!(pairs.len() == bits - 1 && !pairs.contains(&0), "two bits");
        // A bitmap over the low bits turns almost all of the 67 million look-ups away.
        const FILTER_BITS: u32 = 22;
        let slot = |value: u32| (value & ((1 << FILTER_BITS) - 1)) as usize;
        let mut filter = vec![false; 1 << FILTER_BITS];
        for &pair in &pairs {
            filter[slot(pair)] = true;
        }
        for (b, &low) in powers.iter().enumerate().skip(1) {
            for &high in &powers[b + 1..] {
                let value = low ^ high;
                assert!(!(filter[slot(value)] && pairs.contains(&value)), "four bits");
            }
        }
    }

    #[test]
    fn later_lives_supersede_earlier_ones_around_the_wrap() {
        let lives = |new, old| supersedes(Incarnation(new), Incarnation(old));
        assert!(lives(1, 0) && lives(0, 255) && lives(127, 0));
        assert!(!lives(0, 0) && !lives(0, 1) && !lives(255, 0) && !lives(128, 0));
    }
}
