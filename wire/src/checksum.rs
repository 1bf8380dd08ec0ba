//! The checksum of envelopes and recordings.

/// CRC-32/MEF (polynomial 0x741B8CD7), computed sixteen bytes at a time. The packets use another polynomial, because an
/// outer checksum of the same polynomial as an inner one detects no additional errors.
pub(crate) const CRC: crc::Crc<u32, crc::Table<16>> = crc::Crc::<u32, crc::Table<16>>::new(&crc::CRC_32_MEF);
