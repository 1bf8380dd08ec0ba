//! Reads a recording up to its last whole record.

use super::writer::checksum;
use super::{Header, MAGIC, MAX_RECORD_BYTES, PROLOGUE_BYTES, RECORD_HEAD_BYTES, Record, VERSION};
use std::io::{self, ErrorKind, Read};
use thiserror::Error;

/// How many bytes are read at once, and how many are allocated before they have arrived. So a damaged length costs a
/// reader little memory.
const STEP: usize = 64 * 1024;

/// An error with the byte offset at which it was found.
#[derive(Debug, Error)]
#[error("at byte {offset}: {cause}")]
pub struct ReadError {
    /// Offset of the record that cannot be read, or zero for the file's first bytes.
    pub offset: u64,
    /// The cause of the error.
    pub cause: Cause,
}

/// What is wrong with a recording.
#[derive(Debug, Error)]
pub enum Cause {
    /// The first bytes are not those of a recording.
    #[error("not a recording")]
    NotARecording,
    /// The recording has another version.
    #[error("a recording of version {0}, this program reads {VERSION}")]
    Version(u16),
    /// The first record is not a header, or is cut off.
    #[error("the recording has no header")]
    NoHeader,
    /// A record's length exceeds the limit.
    #[error("a record of {0} bytes, the limit is {MAX_RECORD_BYTES}")]
    TooLong(u32),
    /// A checksum does not match.
    #[error("the record is damaged (its checksum is wrong)")]
    Checksum,
    /// A record's contents cannot be decoded.
    #[error("the record cannot be understood ({0})")]
    Malformed(postcard::Error),
    /// A record has more bytes than its contents need.
    #[error("the record has {0} bytes too many")]
    Trailing(usize),
    /// There is a second header, or there are bytes after the end record.
    #[error("a record that does not belong here")]
    OutOfPlace,
    /// The medium failed.
    #[error("{0}")]
    Io(#[from] io::Error),
}

/// How the part of a recording that was read ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The recording has an end record.
    Ended,
    /// The recording stops after a whole record: its writer still runs, or was killed.
    Open,
    /// The recording stops within a record: its writer still runs or was killed, or the medium was full.
    Torn {
        /// The offset at which the last whole record ends.
        offset: u64,
    },
}

/// Reads a recording record by record.
///
/// The reader reads ahead. If the records stop without an error, a later call continues with records that were appended
/// since. So a reader can follow the recording of a running node.
#[derive(Debug)]
pub struct RecordingReader<R> {
    source: R,
    header: Header,
    /// The offset at which the next record begins.
    offset: u64,
    /// Bytes read ahead; the next record begins at index `at`.
    bytes: Vec<u8>,
    at: usize,
    ended: bool,
    failed: bool,
}

impl<R: Read> RecordingReader<R> {
    /// Opens a recording and reads its header.
    ///
    /// # Errors
    /// If the source is not a recording of this version with a whole header.
    pub fn new(source: R) -> Result<Self, ReadError> {
        let (ended, failed) = (false, false);
        let mut reader =
            Self { source, header: Header::default(), offset: 0, bytes: Vec::new(), at: 0, ended, failed };
        if !reader.fill(PROLOGUE_BYTES)? || reader.pending()[..8] != MAGIC {
            return Err(reader.error(Cause::NotARecording));
        }
        let version = u16::from_le_bytes([reader.pending()[8], reader.pending()[9]]);
        if version != VERSION {
            return Err(reader.error(Cause::Version(version)));
        }
        reader.advance(PROLOGUE_BYTES);
        match reader.record()? {
            Some(Record::Header(header)) => reader.header = header,
            Some(_) | None => {
                reader.offset = PROLOGUE_BYTES as u64;
                return Err(reader.error(Cause::NoHeader));
            }
        }
        Ok(reader)
    }

    /// The header of the recording.
    pub const fn header(&self) -> &Header {
        &self.header
    }

    /// Offset at which the next record begins, in bytes.
    pub const fn offset(&self) -> u64 {
        self.offset
    }

    /// How the recording ends. This is meaningful once [`next_record`](Self::next_record) has returned `None`.
    pub const fn ending(&self) -> Ending {
        match (self.ended, self.at == self.bytes.len()) {
            (true, _) => Ending::Ended,
            (false, true) => Ending::Open,
            (false, false) => Ending::Torn { offset: self.offset },
        }
    }

    /// The next record, or `None` if no further whole record has arrived.
    ///
    /// # Errors
    /// Names the offset and the cause. No later record can be read.
    pub fn next_record(&mut self) -> Result<Option<Record>, ReadError> {
        let at = self.offset;
        let misplaced = ReadError { offset: at, cause: Cause::OutOfPlace };
        if self.ended {
            return if self.fill(1)? { Err(misplaced) } else { Ok(None) };
        }
        let record = self.record()?;
        match record {
            Some(Record::Header(_)) => return Err(misplaced),
            Some(Record::End) => self.ended = true,
            _ => {}
        }
        Ok(record)
    }

    fn record(&mut self) -> Result<Option<Record>, ReadError> {
        if !self.fill(RECORD_HEAD_BYTES)? {
            return Ok(None);
        }
        let head: [u8; RECORD_HEAD_BYTES] = std::array::from_fn(|i| self.pending()[i]);
        // After a crash a file system may leave zeros in place of a record.
        if head == [0; RECORD_HEAD_BYTES] && self.only_zeros_follow()? {
            return Ok(None);
        }
        let word = |at: usize| [head[at], head[at + 1], head[at + 2], head[at + 3]];
        // The length is checked first, because a damaged length would look like a file that was cut off.
        if checksum(&word(0)) != u32::from_le_bytes(word(4)) {
            return Err(self.error(Cause::Checksum));
        }
        let length = u32::from_le_bytes(word(0));
        let end = RECORD_HEAD_BYTES.saturating_add(usize::try_from(length).unwrap_or(usize::MAX));
        if end > RECORD_HEAD_BYTES + MAX_RECORD_BYTES {
            return Err(self.error(Cause::TooLong(length)));
        }
        if !self.fill(end)? {
            return Ok(None);
        }
        let contents = &self.pending()[RECORD_HEAD_BYTES..end];
        if checksum(contents) != u32::from_le_bytes(word(8)) {
            return Err(self.error(Cause::Checksum));
        }
        let (record, rest) =
            postcard::take_from_bytes(contents).map_err(|e| self.error(Cause::Malformed(e)))?;
        if !rest.is_empty() {
            return Err(self.error(Cause::Trailing(rest.len())));
        }
        self.advance(end);
        Ok(Some(record))
    }

    /// The bytes that have arrived of the next record and of the following ones.
    fn pending(&self) -> &[u8] {
        &self.bytes[self.at..]
    }

    fn advance(&mut self, bytes: usize) {
        self.at += bytes;
        self.offset += bytes as u64;
    }

    /// Reads until at least `want` bytes of the next record have been read. Returns false if the source has no more
    /// bytes for now.
    fn fill(&mut self, want: usize) -> Result<bool, ReadError> {
        while self.bytes.len() - self.at < want {
            if self.at > 0 {
                self.bytes.drain(..self.at);
                self.at = 0;
            }
            let have = self.bytes.len();
            self.bytes.resize(have + STEP, 0);
            let read = self.source.read(&mut self.bytes[have..]);
            self.bytes.truncate(have + *read.as_ref().unwrap_or(&0));
            match read {
                Ok(0) => return Ok(false),
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(self.error(Cause::Io(error))),
            }
        }
        Ok(true)
    }

    fn only_zeros_follow(&mut self) -> Result<bool, ReadError> {
        loop {
            let more = self.fill(self.pending().len() + STEP)?;
            if self.pending().iter().any(|&byte| byte != 0) {
                return Ok(false);
            }
            self.bytes.truncate(self.at + RECORD_HEAD_BYTES);
            if !more {
                return Ok(true);
            }
        }
    }

    fn error(&self, cause: Cause) -> ReadError {
        ReadError { offset: self.offset, cause }
    }
}

/// Yields the records up to the first error. The iterator stops when no further whole record has arrived, and may
/// continue later.
impl<R: Read> Iterator for RecordingReader<R> {
    type Item = Result<Record, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let next = self.next_record();
        self.failed = next.is_err();
        next.transpose()
    }
}
