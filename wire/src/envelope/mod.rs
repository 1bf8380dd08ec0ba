//! The envelope: header, packets and checksum of every datagram between two nodes.
//!
//! ```text
//!  0..2   magic 9d 4d
//!  2      version of the envelope: 2
//!  3      mode: how it is closed (0 checksum, 1 keys: see [`keyed`]); the layout from here on is the mode's
//!
//!         mode 0, checksum (the `--insecure` mode), little endian:
//!  4..8   digest of the cell's declarations
//!  8..12  digest of its statements
//! 12..14  sender node
//! 14..16  receiver node
//! 16      incarnation of the sender
//! 17      bits 0-1 purpose: 0 packets, 1 greeting, 2 refusal, 3 goodbye
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
//! A greeting, a refusal or a goodbye takes 64 bytes; each packet adds 32. The maximum of 44 packets makes 1472 bytes, which fit
//! an Ethernet frame under IPv4. 36 packets make 1216 bytes; every IPv6 network carries 1232. With keys a datagram is 12 bytes
//! shorter.
//!
//! The packets' own checksum uses another polynomial, because two nested checksums of one polynomial detect no more
//! errors than one. The envelope's checksum detects up to five flipped bits in the longest datagram (a test computes
//! this), including bits of the fields that relays change. A checksum does not detect appended zeros, so the header
//! contains the number of packets.
//!
//! [`EnvelopeError`] names the reason for which a datagram is dropped. [`read`] checks version and mode before the checksum,
//! because another version may use another checksum. [`Opened::check`] runs after [`read`], so damage is never mistaken for
//! another cell. It compares the digests before the node ids, because the ids of another cell mean nothing.

mod datagram;
mod error;
mod header;
pub mod keyed;
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
/// The greatest number of packets in one datagram.
pub const MAX_PACKETS: usize = 44;
/// The number of bytes that an envelope adds to its packets, in mode 0.
pub const OVERHEAD_BYTES: usize = HEADER_BYTES + CHECKSUM_BYTES;
/// The length of the shortest datagram, which has no packet, in bytes.
pub const MIN_DATAGRAM_BYTES: usize = OVERHEAD_BYTES;
/// The length of the longest datagram, in bytes.
pub const MAX_DATAGRAM_BYTES: usize = OVERHEAD_BYTES + MAX_PACKETS * PACKET_BYTES;
/// Datagram counters are below this bound: 56 bits, which no node ever uses up.
pub const COUNTER_END: u64 = 1 << 56;

const HEADER_BYTES: usize = 60;
const CHECKSUM_BYTES: usize = 4;
const MODE_CHECKSUM: u8 = 0;
/// The number of the mode with keys.
pub const MODE_KEYS: u8 = 1;

/// The digests that must be equal on two nodes before they communicate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Digests {
    /// The digest of the cell's declarations, computed over its canonical table.
    pub cell: u32,
    /// The digest of the cell's statements: the compiled scripts of all tasks. Zero if no task has a script. Of an
    /// extern task it covers only the declaration.
    pub statements: u32,
}

impl fmt::Display for Digests {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "declarations {:08x}, statements {:08x}", self.cell, self.statements)
    }
}

/// Identifies one start of one node: 64 random bits, drawn each time a node opens its socket. Sessions have no order;
/// they can only be compared for equality.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Session(pub u64);

/// The decoded header of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Envelope {
    /// The node that sent this datagram: the previous hop, not the packets' source.
    pub sender: NodeId,
    /// The node for which this datagram is: the next hop, not the packets' destination.
    pub receiver: NodeId,
    /// The incarnation of the sender.
    pub incarnation: Incarnation,
    /// Whether an earlier incarnation of the sender may have taken requests.
    pub restarted: bool,
    /// The session of the sender.
    pub session: Session,
    /// The sequence number among the datagrams with packets, and goodbyes, from this session to this receiver; below [`COUNTER_END`].
    pub counter: u64,
    /// The sender's monotonic clock, in microseconds. It is not later than the instant at which the packets' remaining
    /// times hold.
    pub tx_mono: u64,
    /// The receiver's clock, as the sender last received it.
    pub echo: Option<Echo>,
    /// The purpose of the datagram.
    pub purpose: Purpose,
}

/// A reading of the receiver's own clock, which the sender returns to it. It is the `tx_mono` of the receiver's last datagram
/// that reached the sender, plus the time for which the sender has held it. So when the sender's clock showed `tx_mono`, the
/// receiver's clock showed `mono` or more. The round trip took the receiver's clock on arrival minus `mono`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Echo {
    /// The session of the receiver to which this clock belongs: each session's clock has its own origin.
    pub session: Session,
    /// The receiver's clock, in microseconds.
    pub mono: u64,
}

/// The purpose of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// The datagram carries packets, at least one.
    Packets,
    /// The datagram introduces the sender, and carries no packet.
    Greeting(Greeting),
    /// The sender drops all of the receiver's datagrams. Such a datagram carries no packet.
    Refusal(Refused),
    /// The sender has stopped in order: none of its tasks runs any more, and its session ends. Such a datagram carries
    /// no packet, but has a counter, as datagrams with packets have. Programs from before decision D205 drop it.
    Goodbye,
}

/// The statements of a greeting about its sender and its receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Greeting {
    /// Whether the receiver must answer with a greeting. An answer itself sets this to false.
    pub wants_answer: bool,
    /// Whether the sender does not know its incarnation yet. It then asks for the incarnation that the receiver
    /// remembers, and [`Envelope::incarnation`] means nothing.
    pub uncounted: bool,
    /// The newest incarnation of the receiver that the sender remembers.
    pub remembers: Option<Incarnation>,
}

/// Why a node drops all datagrams of another node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Refused {
    /// The cell's declarations differ.
    OtherCell,
    /// The declarations are equal, but the statements differ.
    OtherStatements,
    /// The datagram names another node as its receiver.
    Misdelivered,
    /// The two nodes have different keys: of the cell, or of one of the nodes.
    OtherKeys,
    /// One of the two nodes has keys, and the other node has none.
    OtherMode,
    /// The envelopes of the two nodes have different versions.
    OtherVersion,
}

impl Refused {
    const ALL: [Self; 6] = [
        Self::OtherCell,
        Self::OtherStatements,
        Self::Misdelivered,
        Self::OtherKeys,
        Self::OtherMode,
        Self::OtherVersion,
    ];

    /// The reason with this number on the wire.
    #[must_use]
    pub fn of(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }

    /// A short name for tables and counters.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::OtherCell => "other_cell",
            Self::OtherStatements => "other_statements",
            Self::Misdelivered => "misdelivered",
            Self::OtherKeys => "other_keys",
            Self::OtherMode => "other_mode",
            Self::OtherVersion => "other_version",
        }
    }
}

/// An intact datagram of any cell. [`check`](Self::check) decides whether it is for this node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Opened<'a> {
    /// The sender's digests.
    pub digests: Digests,
    /// The datagram's decoded header.
    pub envelope: Envelope,
    /// The datagram's packets, still encoded.
    pub packets: &'a [[u8; PACKET_BYTES]],
}

/// Decodes a datagram of any cell.
///
/// # Errors
/// Says why the bytes are not an intact datagram. Never panics, whatever the bytes are.
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

/// Decodes a datagram and checks that it is for `node` of a cell with these digests. Returns its header and its
/// packets, still encoded. `known` decides whether a sender is acceptable.
///
/// # Errors
/// Says why the bytes are not a datagram for this node. Never panics, whatever the bytes are.
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
    /// Checks that the datagram is for `node` of a cell with these digests. `known` decides whether a sender is acceptable.
    ///
    /// # Errors
    /// The first check that fails.
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

/// Whether incarnation `new` comes after `old`, with wrap-around. A launcher increments the incarnation at each start,
/// so the later one is less than 128 steps ahead.
#[must_use]
pub const fn supersedes(new: Incarnation, old: Incarnation) -> bool {
    let steps = new.0.wrapping_sub(old.0);
    steps != 0 && steps < 0x80
}

/// The bytes of a datagram without packets: a greeting, a refusal, or a goodbye.
#[must_use]
pub fn without_packets(envelope: &Envelope, digests: Digests) -> [u8; OVERHEAD_BYTES] {
    datagram::bare(envelope, digests)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    /// The polynomial was chosen for this property: it detects any two to five flipped bits in the longest datagram. An
    /// odd number of flipped bits is detected because the polynomial is a multiple of x + 1. Two or four flipped bits,
    /// shifted so that the lowest is bit 0, go unnoticed only if `1 + x^a = x^b + x^c` (or `1 = x^a`) for powers below
    /// the datagram's length.
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
        // A bitmap over the low bits filters out almost all of the 67 million look-ups in the table.
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
    fn later_incarnations_supersede_earlier_ones_around_the_wrap() {
        let newer = |new, old| supersedes(Incarnation(new), Incarnation(old));
        assert!(newer(1, 0) && newer(0, 255) && newer(127, 0));
        assert!(!newer(0, 0) && !newer(0, 1) && !newer(255, 0) && !newer(128, 0));
    }
}
