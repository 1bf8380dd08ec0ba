//! Reads and writes length-prefixed frames over any byte stream. Both resume after a timeout or `WouldBlock`.

use serde::Serialize;
use std::io::{self, ErrorKind, Read, Write};
use thiserror::Error;

/// The longest frame, in bytes, without its length field.
pub const MAX_FRAME: usize = 1 << 20;
/// The longest frame that a node accepts from a monitor, in bytes: requests are short.
pub const MAX_REQUEST: usize = 4096;

const LENGTH: usize = 4;
/// How much memory is allocated before the bytes for it have arrived, so that a length field alone costs a reader little.
const STEP: usize = 64 * 1024;

/// Why a frame could not be read or written.
#[derive(Debug, Error)]
pub enum FrameError {
    /// The other side closed the stream between two frames.
    #[error("the connection was closed")]
    Closed,
    /// The other side closed the stream within a frame.
    #[error("the connection was closed after {got} of a frame's {of} bytes")]
    Truncated {
        /// How many of the frame's bytes arrived, its length field included.
        got: usize,
        /// How many bytes the whole frame has, its length field included; for an incomplete length field, four.
        of: usize,
    },
    /// The length field exceeds the limit. The stream cannot be read any further.
    #[error("a frame of {length} bytes was announced, the limit is {limit}")]
    TooLong {
        /// The announced length.
        length: usize,
        /// The greatest allowed length of a frame on this stream, in bytes.
        limit: usize,
    },
    /// The stream would block. Call again later: the bytes read or written so far are kept.
    #[error("the other side is not ready")]
    NotReady,
    /// The value cannot be encoded.
    #[error("a value that cannot be encoded ({0})")]
    Encode(postcard::Error),
    /// The stream failed.
    #[error("the connection failed: {0}")]
    Io(#[from] io::Error),
}

/// Reads frames from a byte stream.
#[derive(Debug)]
pub struct FrameReader<R> {
    source: R,
    limit: usize,
    /// The bytes of the current frame that have arrived, its length field included.
    bytes: Vec<u8>,
    have: usize,
}

impl<R: Read> FrameReader<R> {
    /// A reader of frames that are at most `limit` bytes long ([`MAX_FRAME`], or [`MAX_REQUEST`] at a node).
    pub const fn new(source: R, limit: usize) -> Self {
        Self { source, limit, bytes: Vec::new(), have: 0 }
    }

    /// The byte stream.
    pub const fn get_ref(&self) -> &R {
        &self.source
    }

    /// The contents of the next frame. They are valid until the next call.
    ///
    /// # Errors
    /// After [`FrameError::NotReady`] call again; every other error ends the stream.
    pub fn read_frame(&mut self) -> Result<&[u8], FrameError> {
        if self.whole()?.is_some_and(|whole| self.have == whole) {
            self.have = 0;
        }
        loop {
            let whole = self.whole()?;
            if whole == Some(self.have) {
                return Ok(&self.bytes[LENGTH..self.have]);
            }
            self.read_some(whole.unwrap_or(LENGTH))?;
        }
    }

    /// The length of the frame, length field included, once that field has arrived.
    fn whole(&self) -> Result<Option<usize>, FrameError> {
        let (true, Some(field)) = (self.have >= LENGTH, self.bytes.first_chunk::<LENGTH>()) else {
            return Ok(None);
        };
        let length = usize::try_from(u32::from_le_bytes(*field)).unwrap_or(usize::MAX);
        if length > self.limit {
            return Err(FrameError::TooLong { length, limit: self.limit });
        }
        Ok(Some(LENGTH + length))
    }

    fn read_some(&mut self, of: usize) -> Result<(), FrameError> {
        let end = of.min(self.have + STEP);
        if self.bytes.len() < end {
            self.bytes.resize(end, 0);
        }
        let read = match self.source.read(&mut self.bytes[self.have..end]) {
            // If a peer dies without reading all data, the kernel resets the connection. This counts as closed.
            Err(e) if e.kind() == ErrorKind::ConnectionReset => Ok(0),
            read => read,
        };
        match read {
            Ok(0) if self.have == 0 => Err(FrameError::Closed),
            Ok(0) => Err(FrameError::Truncated { got: self.have, of }),
            Ok(count) => {
                self.have += count;
                Ok(())
            }
            Err(e) if e.kind() == ErrorKind::Interrupted => Ok(()),
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                Err(FrameError::NotReady)
            }
            Err(e) => Err(FrameError::Io(e)),
        }
    }
}

/// Writes frames. It keeps the bytes that a slow reader has not taken yet. Push the next frame only when
/// [`is_drained`](Self::is_drained) returns true, so that never more than one frame is pending.
#[derive(Debug)]
pub struct FrameWriter<W> {
    sink: W,
    pending: Vec<u8>,
    gone: usize,
    /// Scratch buffer for encoding, kept to avoid allocations.
    scratch: Vec<u8>,
}

impl<W: Write> FrameWriter<W> {
    /// A writer without pending bytes.
    pub const fn new(sink: W) -> Self {
        Self { sink, pending: Vec::new(), gone: 0, scratch: Vec::new() }
    }

    /// The byte stream.
    pub const fn get_ref(&self) -> &W {
        &self.sink
    }

    /// Whether every pushed frame has been written.
    #[must_use]
    pub const fn is_drained(&self) -> bool {
        self.gone == self.pending.len()
    }

    /// Appends `value` as a frame to the pending bytes. Writes nothing.
    ///
    /// # Errors
    /// [`FrameError::TooLong`] and [`FrameError::Encode`]; nothing is appended then.
    pub fn push<T: Serialize>(&mut self, value: &T) -> Result<(), FrameError> {
        let mut scratch = std::mem::take(&mut self.scratch);
        scratch.clear();
        let scratch = postcard::to_extend(value, scratch).map_err(FrameError::Encode)?;
        let pushed = self.push_bytes(&scratch);
        self.scratch = scratch;
        pushed
    }

    /// Appends a frame with these contents to the pending bytes: a [`Handshake`](super::Handshake), or a frame that is
    /// encoded once for several readers.
    ///
    /// # Errors
    /// [`FrameError::TooLong`]; nothing is appended then.
    pub fn push_bytes(&mut self, contents: &[u8]) -> Result<(), FrameError> {
        let length = contents.len();
        let field = u32::try_from(length).ok().filter(|_| length <= MAX_FRAME);
        let field = field.ok_or(FrameError::TooLong { length, limit: MAX_FRAME })?;
        self.pending.extend(field.to_le_bytes());
        self.pending.extend_from_slice(contents);
        Ok(())
    }

    /// Writes the pending bytes.
    ///
    /// # Errors
    /// After [`FrameError::NotReady`] call again; every other error ends the stream.
    pub fn flush(&mut self) -> Result<(), FrameError> {
        while self.gone < self.pending.len() {
            match self.sink.write(&self.pending[self.gone..]) {
                Ok(0) => return Err(FrameError::Closed),
                Ok(count) => self.gone += count,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    return Err(FrameError::NotReady);
                }
                Err(e) if matches!(e.kind(), ErrorKind::BrokenPipe | ErrorKind::ConnectionReset) => {
                    return Err(FrameError::Closed);
                }
                Err(e) => return Err(FrameError::Io(e)),
            }
        }
        self.pending.clear();
        self.gone = 0;
        Ok(self.sink.flush()?)
    }
}
