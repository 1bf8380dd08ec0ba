//! Decodes frames. Whatever the bytes are, decoding gives a frame or a [`DecodeError`].

use super::version::Version;
use serde::de::DeserializeOwned;
use thiserror::Error;

/// Why bytes are not a frame of this protocol.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DecodeError {
    /// The first frame does not begin with the magic bytes: the other side uses another protocol.
    #[error("the other side does not speak imrs-obs")]
    NotObs,
    /// The other side uses another major version. The decoder read nothing after the version.
    #[error("the other side speaks imrs-obs {theirs}, this program {ours}")]
    OtherMajor {
        /// The version of the other side.
        theirs: Version,
        /// The version of this program.
        ours: Version,
    },
    /// This version does not know the frame's kind. The stream is still intact, so the reader may read the next frame.
    #[error("a frame of unknown kind {0}")]
    UnknownKind(u32),
    /// The frame's contents do not match its kind.
    #[error("a malformed frame ({0})")]
    Malformed(postcard::Error),
    /// The frame has this many bytes more than its kind needs.
    #[error("a frame with {0} bytes too many")]
    TrailingBytes(usize),
}

/// Decodes all of `bytes` as one value of an enum with `kinds` variants.
pub(crate) fn whole<T: DeserializeOwned>(bytes: &[u8], kinds: u32) -> Result<T, DecodeError> {
    let (kind, _) = postcard::take_from_bytes::<u32>(bytes).map_err(DecodeError::Malformed)?;
    if kind >= kinds {
        return Err(DecodeError::UnknownKind(kind));
    }
    let (value, rest) = postcard::take_from_bytes(bytes).map_err(DecodeError::Malformed)?;
    if rest.is_empty() { Ok(value) } else { Err(DecodeError::TrailingBytes(rest.len())) }
}
