//! The checksum of envelopes and recordings.

/// CRC-32/MEF (polynomial 0x741B8CD7), sixteen bytes at a time. Another polynomial than that of the packets: a checksum
/// that is itself covered by one of the same polynomial adds nothing.
pub(crate) const CRC: crc::Crc<u32, crc::Table<16>> = crc::Crc::<u32, crc::Table<16>>::new(&crc::CRC_32_MEF);
