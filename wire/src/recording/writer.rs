//! Writes a recording record by record.

use super::{Header, MAGIC, MAX_RECORD_BYTES, PROLOGUE_BYTES, RECORD_HEAD_BYTES, Record, VERSION};
use crate::checksum::CRC;
use std::io::{self, Write};
use thiserror::Error;

/// Initial buffer size, above the size of input records with their heads.
const SHORT: usize = 256;

/// Why a record could not be written.
#[derive(Debug, Error)]
pub enum WriteError {
    /// The record cannot be encoded.
    #[error("a record that cannot be encoded ({0})")]
    Encode(postcard::Error),
    /// The record is longer than [`MAX_RECORD_BYTES`].
    #[error("a record of {0} bytes, the limit is {MAX_RECORD_BYTES}")]
    TooLong(usize),
    /// The medium failed, or is full.
    #[error("the recording cannot be written: {0}")]
    Io(#[from] io::Error),
}

/// Writes a recording. Only whole records are passed to `W`, so a recording without an end record is still readable.
#[derive(Debug)]
pub struct RecordingWriter<W> {
    sink: W,
    /// The record being encoded; longer records enlarge it.
    bytes: Vec<u8>,
    records: u64,
    written: u64,
}

impl<W: Write> RecordingWriter<W> {
    /// Begins a recording: writes the prologue and the header.
    ///
    /// # Errors
    /// If the header cannot be written.
    pub fn new(sink: W, header: &Header) -> Result<Self, WriteError> {
        let mut writer = Self { sink, bytes: vec![0; SHORT], records: 0, written: 0 };
        let mut prologue = [0; PROLOGUE_BYTES];
        prologue[..8].copy_from_slice(&MAGIC);
        prologue[8..10].copy_from_slice(&VERSION.to_le_bytes());
        writer.sink.write_all(&prologue)?;
        writer.written = PROLOGUE_BYTES as u64;
        writer.append(&Record::Header(header.clone()))?;
        Ok(writer)
    }

    /// Appends a record.
    ///
    /// # Errors
    /// If the medium fails ([`WriteError::Io`]), a part of the record may have been written. The recording is readable
    /// up to that record, but nothing can be appended.
    pub fn append(&mut self, record: &Record) -> Result<(), WriteError> {
        let length = self.encode(record)?;
        if length > MAX_RECORD_BYTES {
            return Err(WriteError::TooLong(length));
        }
        let (head, contents) = self.bytes[..RECORD_HEAD_BYTES + length].split_at_mut(RECORD_HEAD_BYTES);
        let length = u32::try_from(length).map_err(|_| WriteError::TooLong(length))?.to_le_bytes();
        head[..4].copy_from_slice(&length);
        head[4..8].copy_from_slice(&checksum(&length).to_le_bytes());
        head[8..].copy_from_slice(&checksum(contents).to_le_bytes());
        let whole = RECORD_HEAD_BYTES + contents.len();
        self.sink.write_all(&self.bytes[..whole])?;
        self.written += whole as u64;
        self.records += 1;
        Ok(())
    }

    /// Encodes the contents of a record behind the space for its head. Returns their length.
    fn encode(&mut self, record: &Record) -> Result<usize, WriteError> {
        match postcard::to_slice(record, &mut self.bytes[RECORD_HEAD_BYTES..]) {
            Ok(contents) => Ok(contents.len()),
            // The record is longer than the buffer, so the buffer is enlarged.
            Err(postcard::Error::SerializeBufferFull) => {
                self.bytes =
                    postcard::to_extend(record, vec![0; RECORD_HEAD_BYTES]).map_err(WriteError::Encode)?;
                Ok(self.bytes.len() - RECORD_HEAD_BYTES)
            }
            Err(error) => Err(WriteError::Encode(error)),
        }
    }

    /// How many records were written, the header included.
    #[must_use]
    pub const fn records(&self) -> u64 {
        self.records
    }

    /// How many bytes were written.
    #[must_use]
    pub const fn written(&self) -> u64 {
        self.written
    }

    /// Flushes everything to the medium.
    ///
    /// # Errors
    /// If the medium fails.
    pub fn flush(&mut self) -> Result<(), WriteError> {
        Ok(self.sink.flush()?)
    }

    /// Ends the recording, and returns the sink.
    ///
    /// # Errors
    /// If the last record cannot be written.
    pub fn finish(mut self) -> Result<W, WriteError> {
        self.append(&Record::End)?;
        self.flush()?;
        Ok(self.sink)
    }
}

pub(super) fn checksum(bytes: &[u8]) -> u32 {
    let mut crc = CRC.digest();
    crc.update(bytes);
    crc.finalize()
}
