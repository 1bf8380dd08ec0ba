//! Builds a datagram from encoded packets.

use super::{
    CHECKSUM_BYTES, Digests, Envelope, HEADER_BYTES, MAX_DATAGRAM_BYTES, MAX_PACKETS, OVERHEAD_BYTES,
};
use crate::checksum::CRC;
use imrs_protocol::PACKET_BYTES;

/// A buffer that collects packets and seals them into a datagram. It is reused for the next datagram without allocating.
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
    /// Whether the datagram contains no packet.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.packets == 0
    }

    /// How many packets the datagram contains.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.packets as usize
    }

    /// Adds an encoded packet. Returns false if the datagram already has [`MAX_PACKETS`].
    pub fn push(&mut self, packet: &[u8; PACKET_BYTES]) -> bool {
        let room = self.len() < MAX_PACKETS;
        if room {
            let start = HEADER_BYTES + self.len() * PACKET_BYTES;
            self.bytes[start..start + PACKET_BYTES].copy_from_slice(packet);
            self.packets += 1;
        }
        room
    }

    /// Writes header and checksum, and returns the bytes to send. The datagram can be sealed again with another envelope.
    pub fn seal(&mut self, envelope: &Envelope, digests: Digests) -> &[u8] {
        let end = self.end();
        if let Some(header) = self.bytes.first_chunk_mut() {
            envelope.emit(digests, self.packets, header);
        }
        let checksum = CRC.checksum(&self.bytes[..end]).to_le_bytes();
        self.bytes[end..end + CHECKSUM_BYTES].copy_from_slice(&checksum);
        self.sealed()
    }

    /// The bytes that [`seal`](Self::seal) returned. Valid until a packet is added or the packets are cleared.
    #[must_use]
    pub fn sealed(&self) -> &[u8] {
        &self.bytes[..self.end() + CHECKSUM_BYTES]
    }

    /// Where the checksum begins.
    const fn end(&self) -> usize {
        HEADER_BYTES + self.len() * PACKET_BYTES
    }

    /// Removes all packets.
    pub fn clear(&mut self) {
        self.packets = 0;
    }
}

/// Encodes a datagram without packets: a greeting or a refusal.
pub(super) fn bare(envelope: &Envelope, digests: Digests) -> [u8; OVERHEAD_BYTES] {
    let mut bytes = [0; OVERHEAD_BYTES];
    if let Some(header) = bytes.first_chunk_mut() {
        envelope.emit(digests, 0, header);
    }
    let checksum = CRC.checksum(&bytes[..HEADER_BYTES]).to_le_bytes();
    bytes[HEADER_BYTES..].copy_from_slice(&checksum);
    bytes
}
