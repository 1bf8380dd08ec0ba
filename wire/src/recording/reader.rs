//! Reading records, as far as they are whole.

use super::writer::checksum;
use super::{Header, MAGIC, MAX_RECORD_BYTES, PROLOGUE_BYTES, RECORD_HEAD_BYTES, Record, VERSION};
use std::io::{self, ErrorKind, Read};
use thiserror::Error;

/// How much is read at once, and room is made before the bytes for it have come: a damaged length costs a reader no
/// more than this.
const STEP: usize = 64 * 1024;

/// What cannot be read, and where.
#[derive(Debug, Error)]
#[error("at byte {offset}: {cause}")]
pub struct ReadError {
    /// Where the record (or the file's beginning) starts that cannot be read.
    pub offset: u64,
    /// What is wrong with it.
    pub cause: Cause,
}

/// What is wrong with a recording.
#[derive(Debug, Error)]
pub enum Cause {
    /// The first bytes are not those of a recording.
    #[error("not a recording")]
    NotARecording,
    /// A recording of another version.
    #[error("a recording of version {0}, this program reads {VERSION}")]
    Version(u16),
    /// The first record is not a header, or is cut off.
    #[error("the recording has no header")]
    NoHeader,
    /// A record that cannot be this long.
    #[error("a record of {0} bytes, the limit is {MAX_RECORD_BYTES}")]
    TooLong(u32),
    /// A damaged record.
    #[error("the record is damaged (its checksum is wrong)")]
    Checksum,
    /// A record that this version does not know.
    #[error("the record cannot be understood ({0})")]
    Malformed(postcard::Error),
    /// More bytes than the record needs.
    #[error("the record has {0} bytes too many")]
    Trailing(usize),
    /// A header where none belongs, or anything after the end.
    #[error("a record that does not belong here")]
    OutOfPlace,
    /// The medium failed.
    #[error("{0}")]
    Io(#[from] io::Error),
}

/// How a recording ends, as far as it was read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// It was ended.
    Ended,
    /// It stops after a whole record: its writer still runs, or was killed.
    Open,
    /// It stops within the record that begins at this byte: as before, or the medium was full.
    Torn {
        /// Where the last whole record ends.
        offset: u64,
    },
}

/// Reads a recording record by record.
///
/// It reads ahead. Where the records stop without an error, reading again later goes on with what was appended meanwhile:
/// so the recording of a running node can be followed.
#[derive(Debug)]
pub struct RecordingReader<R> {
    source: R,
    header: Header,
    /// Where the next record begins.
    offset: u64,
    /// What was read, of it and of what follows, from `at` on.
    bytes: Vec<u8>,
    at: usize,
    ended: bool,
    failed: bool,
}

impl<R: Read> RecordingReader<R> {
    /// Opens a recording.
    ///
    /// # Errors
    /// Where the source is not a recording of this version with a whole header.
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

    /// What the recording is about.
    pub const fn header(&self) -> &Header {
        &self.header
    }

    /// Where the next record begins.
    pub const fn offset(&self) -> u64 {
        self.offset
    }

    /// How the recording ends. Means something once the records have stopped.
    pub const fn ending(&self) -> Ending {
        match (self.ended, self.at == self.bytes.len()) {
            (true, _) => Ending::Ended,
            (false, true) => Ending::Open,
            (false, false) => Ending::Torn { offset: self.offset },
        }
    }

    /// The next record, or `None` where no further whole record has come.
    ///
    /// # Errors
    /// Names the byte and the cause. Nothing after it can be read.
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
        // A file system that was not told to write may leave zeros where a record should be.
        if head == [0; RECORD_HEAD_BYTES] && self.only_zeros_follow()? {
            return Ok(None);
        }
        let word = |at: usize| [head[at], head[at + 1], head[at + 2], head[at + 3]];
        // Before the length is believed: a damaged one would look like a file that was cut off.
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

    /// What has come of the next record, and what follows it.
    fn pending(&self) -> &[u8] {
        &self.bytes[self.at..]
    }

    fn advance(&mut self, bytes: usize) {
        self.at += bytes;
        self.offset += bytes as u64;
    }

    /// Reads until `want` bytes of the record are there. False where the source has no more for now.
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

/// The records up to the first error. Stops where no further whole record has come, and may go on later.
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
