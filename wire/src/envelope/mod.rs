//! The envelope (D48): what every datagram between two nodes looks like.
//!
//! ```text
//!  0..2   magic 9d 4d
//!  2      version of the envelope
//!  3      mode: how it is closed; the layout from here on is the mode's
//!
//!         mode 0, checksum (the `--insecure` mode), little endian:
//!  4..8   digest of the cell's table
//!  8..10  sender node
//! 10      incarnation of the sender
//! 11      incarnation of the receiver that the echo belongs to
//! 12      packets, 6 bits | an earlier life of the sender may have taken requests | an echo is given
//! 13..20  counter of the sender's datagrams to this receiver
//! 20..28  tx_mono: the sender's monotonic clock, in microseconds from an origin of its own
//! 28..36  echo: the receiver's monotonic clock, as the sender knows it (see [`Echo`])
//! 36..    1 to 44 packets of 32 bytes
//! last 4  CRC-32/MEF over everything before it
//! ```
//!
//! One packet makes 72 bytes, the most (44) make 1448 and fit an Ethernet frame. Every mode keeps to the same
//! [`OVERHEAD_BYTES`]: one with keys has 24 bytes of header and a tag of 16.
//!
//! The checksum uses another polynomial than the packets' own, because a checksum that is itself covered by one of the
//! same polynomial adds nothing: what passes the inner one would pass the outer one as well. It notices up to five
//! flipped bits in the longest datagram (a test computes this), the fields that relays change included. A checksum says
//! nothing about zeros behind the end, so the number of packets is written down and covered.
//!
//! A datagram that is not taken says why ([`EnvelopeError`]). Version and mode are judged before the checksum, since
//! another version may close its datagrams differently; digest and sender after it, so that damage is never mistaken
//! for another cell.

mod window;

pub use window::{ReplayWindow, WINDOW};

use crate::checksum::CRC;
use imrs_protocol::{Incarnation, NodeId, PACKET_BYTES};
use thiserror::Error;

/// The first two bytes of every datagram.
pub const MAGIC: [u8; 2] = [0x9d, 0x4d];
/// The envelope format of this library.
pub const VERSION: u8 = 1;
/// The most packets in one datagram.
pub const MAX_PACKETS: usize = 44;
/// What an envelope adds to its packets, in every mode.
pub const OVERHEAD_BYTES: usize = HEADER_BYTES + CHECKSUM_BYTES;
/// The shortest datagram: one packet.
pub const MIN_DATAGRAM_BYTES: usize = OVERHEAD_BYTES + PACKET_BYTES;
/// The longest datagram.
pub const MAX_DATAGRAM_BYTES: usize = OVERHEAD_BYTES + MAX_PACKETS * PACKET_BYTES;
/// Counters are below this: 56 bits, which no node ever uses up.
pub const COUNTER_END: u64 = 1 << 56;

const HEADER_BYTES: usize = 36;
const CHECKSUM_BYTES: usize = 4;
const MODE_CHECKSUM: u8 = 0;
const FLAG_ECHO: u8 = 1;
const FLAG_RESTARTED: u8 = 2;
const COUNT_SHIFT: u32 = 2;

/// What a datagram says about itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Envelope {
    /// The node that sent it: the last hop, not the packets' source.
    pub sender: NodeId,
    /// The life of the sender (D49).
    pub incarnation: Incarnation,
    /// Whether the sender says that an earlier life of it may have taken requests.
    pub restarted: bool,
    /// The position among the datagrams that this life of the sender sent to this receiver; below [`COUNTER_END`].
    pub counter: u64,
    /// The sender's monotonic clock, in microseconds: not later than the instant for which the remaining times of the
    /// packets hold.
    pub tx_mono: u64,
    /// What the sender last heard of the receiver's clock.
    pub echo: Option<Echo>,
}

/// The receiver's own `tx_mono`, come back: the one of its last datagram that reached the sender, plus the time that
/// the sender has held it since. So at the sender's `tx_mono` the receiver's clock showed `mono` or more, and the round
/// trip took the receiver's clock on arrival minus `mono`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Echo {
    /// The life of the receiver whose clock it is: a later life may have a clock of another origin.
    pub incarnation: Incarnation,
    /// That clock, in microseconds.
    pub mono: u64,
}

/// Why a datagram is not one for this node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum EnvelopeError {
    /// Shorter than an envelope with one packet.
    #[error("{0} bytes are too short for an envelope")]
    TooShort(usize),
    /// The first bytes are not [`MAGIC`].
    #[error("not an envelope: the first bytes are others")]
    NotImrs,
    /// Made by another version of the format.
    #[error("envelope version {0}, this node speaks {VERSION}")]
    Version(u8),
    /// Closed in another way than this node is told to accept.
    #[error("envelope mode {0}, this node speaks mode {MODE_CHECKSUM}")]
    Mode(u8),
    /// Cut off, or with trailing bytes: not a whole number of packets, or more than [`MAX_PACKETS`].
    #[error("{0} bytes are not an envelope of 1 to {MAX_PACKETS} whole packets")]
    Length(usize),
    /// Damaged.
    #[error("the envelope's checksum is wrong")]
    Checksum,
    /// Of a cell with another table.
    #[error("from a cell with digest {0:08x}")]
    OtherCell(u32),
    /// From a node that the receiver does not know.
    #[error("from node {0}, which is not a neighbour")]
    UnknownNode(NodeId),
}

/// Takes a datagram of the cell `digest` apart: what it says about itself, and its packets, still encoded. `known`
/// tells whether a sender is acceptable.
///
/// # Errors
/// Says why the bytes are not a datagram for this node. Total: never panics, whatever the bytes are.
pub fn open(
    bytes: &[u8],
    digest: u32,
    known: impl FnOnce(NodeId) -> bool,
) -> Result<(Envelope, &[[u8; PACKET_BYTES]]), EnvelopeError> {
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
    let cell = u32::from_le_bytes([header[4], header[5], header[6], header[7]]);
    if cell != digest {
        return Err(EnvelopeError::OtherCell(cell));
    }
    if usize::from(header[12] >> COUNT_SHIFT) != packets.len() {
        return Err(EnvelopeError::Length(bytes.len()));
    }
    let envelope = Envelope::parse(header);
    if !known(envelope.sender) {
        return Err(EnvelopeError::UnknownNode(envelope.sender));
    }
    Ok((envelope, packets))
}

/// Whether incarnation `new` comes after `old`, around the wrap. A launcher counts a node's lives up by one (D49), so
/// the one less than half the circle ahead is the later.
#[must_use]
pub const fn supersedes(new: Incarnation, old: Incarnation) -> bool {
    let steps = new.0.wrapping_sub(old.0);
    steps != 0 && steps < 0x80
}

impl Envelope {
    fn parse(h: &[u8; HEADER_BYTES]) -> Self {
        let echo = Echo {
            incarnation: Incarnation(h[11]),
            mono: u64::from_le_bytes([h[28], h[29], h[30], h[31], h[32], h[33], h[34], h[35]]),
        };
        Self {
            sender: NodeId(u16::from_le_bytes([h[8], h[9]])),
            incarnation: Incarnation(h[10]),
            restarted: h[12] & FLAG_RESTARTED != 0,
            counter: u64::from_le_bytes([h[13], h[14], h[15], h[16], h[17], h[18], h[19], 0]),
            tx_mono: u64::from_le_bytes([h[20], h[21], h[22], h[23], h[24], h[25], h[26], h[27]]),
            echo: (h[12] & FLAG_ECHO != 0).then_some(echo),
        }
    }

    fn emit(&self, digest: u32, count: u8, h: &mut [u8; HEADER_BYTES]) {
        h[..2].copy_from_slice(&MAGIC);
        h[2] = VERSION;
        h[3] = MODE_CHECKSUM;
        h[4..8].copy_from_slice(&digest.to_le_bytes());
        h[8..10].copy_from_slice(&self.sender.0.to_le_bytes());
        h[10] = self.incarnation.0;
        h[11] = self.echo.map_or(0, |e| e.incarnation.0);
        h[12] = (count << COUNT_SHIFT)
            | if self.restarted { FLAG_RESTARTED } else { 0 }
            | if self.echo.is_some() { FLAG_ECHO } else { 0 };
        h[13..20].copy_from_slice(&self.counter.to_le_bytes()[..7]);
        h[20..28].copy_from_slice(&self.tx_mono.to_le_bytes());
        h[28..36].copy_from_slice(&self.echo.map_or(0, |e| e.mono).to_le_bytes());
    }
}

/// A datagram in the making: collects packets, then is sealed. Reused from one to the next without allocating.
#[derive(Clone, Debug)]
pub struct Datagram {
    bytes: [u8; MAX_DATAGRAM_BYTES],
    /// At most [`MAX_PACKETS`].
    packets: u8,
}

impl Default for Datagram {
    fn default() -> Self {
        Self { bytes: [0; MAX_DATAGRAM_BYTES], packets: 0 }
    }
}

impl Datagram {
    /// Whether no packet is in it.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.packets == 0
    }

    /// How many packets are in it.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.packets as usize
    }

    /// Adds an encoded packet, or returns false where [`MAX_PACKETS`] are in it.
    pub fn push(&mut self, packet: &[u8; PACKET_BYTES]) -> bool {
        let room = self.len() < MAX_PACKETS;
        if room {
            let start = HEADER_BYTES + self.len() * PACKET_BYTES;
            self.bytes[start..start + PACKET_BYTES].copy_from_slice(packet);
            self.packets += 1;
        }
        room
    }

    /// Closes the datagram, and returns what is to be sent. It can be sealed again with another envelope.
    pub fn seal(&mut self, envelope: &Envelope, digest: u32) -> &[u8] {
        let end = self.end();
        if let Some(header) = self.bytes.first_chunk_mut() {
            envelope.emit(digest, self.packets, header);
        }
        let checksum = CRC.checksum(&self.bytes[..end]).to_le_bytes();
        self.bytes[end..end + CHECKSUM_BYTES].copy_from_slice(&checksum);
        self.sealed()
    }

    /// What [`seal`](Self::seal) returned, as long as nothing was added or taken out since.
    #[must_use]
    pub fn sealed(&self) -> &[u8] {
        &self.bytes[..self.end() + CHECKSUM_BYTES]
    }

    /// Where the checksum begins.
    const fn end(&self) -> usize {
        HEADER_BYTES + self.len() * PACKET_BYTES
    }

    /// Takes all packets out.
    pub fn clear(&mut self) {
        self.packets = 0;
    }
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
