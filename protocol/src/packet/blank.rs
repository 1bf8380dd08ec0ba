//! The blank packet, from which others are built, and contents that are packed and read in place.

use super::{CONTENTS_BYTES, Class, Contents, Kind, MAX_HOPS, Packet, Seal};
use crate::ids::{MessageId, PortId, TaskId};
use crate::ticks::Ticks;

impl Packet {
    /// A packet whose fields all have their default values.
    pub const BLANK: Self = Self {
        kind: Kind::Send,
        class: Class::Command,
        more: false,
        resent: false,
        hops: MAX_HOPS,
        fragment: 0,
        destination: TaskId(0),
        source: TaskId(0),
        port: PortId(0),
        id: MessageId::BLANK,
        remaining: Ticks::ZERO,
        contents: Contents::EMPTY,
        seal: Seal::NONE,
    };
}

impl Contents {
    /// Contents of the first `len` of `bytes`. All other bytes must be zero.
    #[inline]
    pub(crate) const fn padded_with(bytes: [u8; CONTENTS_BYTES], len: u8) -> Self {
        Self { len, bytes }
    }

    #[inline]
    pub(crate) const fn len(&self) -> u8 {
        self.len
    }
}
