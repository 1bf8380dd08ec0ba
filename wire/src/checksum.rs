//! The checksum of envelopes and recordings.

/// CRC-32/MEF (polynomial 0x741B8CD7), computed sixteen bytes at a time. The packets use another polynomial, because a
/// checksum over data that already carries one of the same polynomial detects nothing more.
pub(crate) const CRC: crc::Crc<u32, crc::Table<16>> = crc::Crc::<u32, crc::Table<16>>::new(&crc::CRC_32_MEF);
