//! Builds a datagram from encoded packets.

use super::keyed::{self, CLEAR_BYTES, INNER_BYTES, MAX_KEYED_BYTES, TAG_BYTES};
use super::{
    CHECKSUM_BYTES, Digests, Envelope, HEADER_BYTES, MAX_DATAGRAM_BYTES, MAX_PACKETS, OVERHEAD_BYTES,
};
use crate::checksum::CRC;
use imrs_protocol::PACKET_BYTES;

/// A buffer that collects packets and seals them into a datagram. It is reused for the next datagram without allocating.
#[derive(Clone, Debug)]
pub struct Datagram {
    bytes: [u8; MAX_DATAGRAM_BYTES],
    /// The number of packets, at most [`MAX_PACKETS`].
    packets: u8,
    /// The encrypted datagram, if keys are used.
    closed: Option<Box<Closed>>,
}

#[derive(Clone, Debug)]
struct Closed {
    bytes: [u8; MAX_KEYED_BYTES],
    /// The length of the encrypted datagram; zero if the datagram was sealed without keys.
    length: usize,
}

impl Default for Datagram {
    fn default() -> Self {
        Self { bytes: [0; MAX_DATAGRAM_BYTES], packets: 0, closed: None }
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
        if let Some(closed) = &mut self.closed {
            closed.length = 0;
        }
        let checksum = CRC.checksum(&self.bytes[..end]).to_le_bytes();
        self.bytes[end..end + CHECKSUM_BYTES].copy_from_slice(&checksum);
        self.sealed()
    }

    /// Writes the header of mode 1, and encrypts the remaining bytes by `close`: this function encrypts its first
    /// argument into the second, appends a tag, and returns how many bytes it wrote. Returns the bytes to send. `index`
    /// is the receiver's number of the session.
    ///
    /// # Errors
    /// The errors of `close`.
    pub fn seal_keyed<E>(
        &mut self,
        envelope: &Envelope,
        index: u32,
        close: impl FnOnce(&[u8], &mut [u8]) -> Result<usize, E>,
    ) -> Result<&[u8], E> {
        const INNER_AT: usize = HEADER_BYTES - INNER_BYTES;
        let end = self.end();
        self.bytes[INNER_AT..HEADER_BYTES].copy_from_slice(&keyed::inner(envelope, self.packets));
        let closed =
            self.closed.get_or_insert_with(|| Box::new(Closed { bytes: [0; MAX_KEYED_BYTES], length: 0 }));
        closed.bytes[..CLEAR_BYTES].copy_from_slice(&keyed::clear(index, envelope.counter));
        let room = CLEAR_BYTES..CLEAR_BYTES + end - INNER_AT + TAG_BYTES;
        let length = close(&self.bytes[INNER_AT..end], &mut closed.bytes[room])?;
        closed.length = CLEAR_BYTES + length;
        Ok(self.sealed())
    }

    /// The bytes that were sealed last. Valid until a packet is added or the packets are cleared.
    #[must_use]
    pub fn sealed(&self) -> &[u8] {
        match &self.closed {
            Some(closed) if closed.length > 0 => &closed.bytes[..closed.length],
            _ => &self.bytes[..self.end() + CHECKSUM_BYTES],
        }
    }

    /// The offset at which the checksum begins.
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
