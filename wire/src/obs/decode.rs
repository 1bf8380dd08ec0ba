//! Bytes to values, totally: any bytes give a value or a [`DecodeError`].

use super::version::Version;
use serde::de::DeserializeOwned;
use thiserror::Error;

/// Why bytes are no frame of this protocol.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DecodeError {
    /// The first frame does not begin with the magic: the other side speaks something else.
    #[error("the other side does not speak imrs-obs")]
    NotObs,
    /// The other side speaks another major version. Nothing after the version was looked at.
    #[error("the other side speaks imrs-obs {theirs}, this program {ours}")]
    OtherMajor {
        /// What the other side speaks.
        theirs: Version,
        /// What this program speaks.
        ours: Version,
    },
    /// A frame of a kind that this version does not know. The stream is still in step: a reader may go on.
    #[error("a frame of unknown kind {0}")]
    UnknownKind(u32),
    /// The frame's contents are not what its kind has.
    #[error("a malformed frame ({0})")]
    Malformed(postcard::Error),
    /// The frame is longer than what its kind has, by so many bytes.
    #[error("a frame with {0} bytes too many")]
    TrailingBytes(usize),
}

/// The value that `bytes` are, where its type is an enum of `kinds` variants.
pub(crate) fn whole<T: DeserializeOwned>(bytes: &[u8], kinds: u32) -> Result<T, DecodeError> {
    let (kind, _) = postcard::take_from_bytes::<u32>(bytes).map_err(DecodeError::Malformed)?;
    if kind >= kinds {
        return Err(DecodeError::UnknownKind(kind));
    }
    let (value, rest) = postcard::take_from_bytes(bytes).map_err(DecodeError::Malformed)?;
    if rest.is_empty() { Ok(value) } else { Err(DecodeError::TrailingBytes(rest.len())) }
}
