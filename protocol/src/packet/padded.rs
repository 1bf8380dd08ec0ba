//! Contents as bytes of a fixed length, for code that copies them word by word.

use super::{CONTENTS_BYTES, Contents};

impl Contents {
    /// Contents of the first `len` of these bytes, at most all: the reverse of [`padded`](Self::padded), for code that copies words.
    #[must_use]
    pub fn of_padded(padded: [u8; CONTENTS_BYTES], len: u8) -> Self {
        let len = len.min(CONTENTS_BYTES as u8);
        let mut word = [0; 16];
        word[..CONTENTS_BYTES].copy_from_slice(&padded);
        let kept = u128::from_le_bytes(word) & ((1 << (8 * len)) - 1);
        let mut bytes = [0; CONTENTS_BYTES];
        bytes.copy_from_slice(&kept.to_le_bytes()[..CONTENTS_BYTES]);
        Self { len, bytes }
    }

    /// The bytes of the contents, padded with zeros to a fixed length, for code that copies them word by word.
    #[must_use]
    pub const fn padded(&self) -> &[u8; CONTENTS_BYTES] {
        &self.bytes
    }
}
