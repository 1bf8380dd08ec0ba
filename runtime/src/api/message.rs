//! Typed messages, laid out as the cell language lays out its records: field after field, little endian, without padding.

use imrs_protocol::{CONTENTS_BYTES, Contents};
use std::fmt;
use std::ops::Deref;

/// The length of the longest message in bytes: 16 packets.
pub const LONGEST: usize = 16 * CONTENTS_BYTES;

/// A message of a port: a record of the cell language. Derive it with `imrs_macros::Message` for a struct with the same
/// fields in the same order. Each of them is a [`Field`].
///
/// ```
/// use imrs_runtime::message::{LONGEST, Message};
///
/// let mut room = [0; LONGEST];
/// assert_eq!((120_i16, true).encode(&mut room), Some(3));
/// assert_eq!(room[..3], [120, 0, 1]);
/// assert_eq!(<(i16, bool)>::decode(&[120, 0, 1]), Some((120, true)));
/// assert_eq!(<(i16, bool)>::decode(&[120, 0, 7]), None, "7 is no bool");
/// assert_eq!(<(i16, bool)>::decode(&[120, 0]), None, "too short");
/// ```
pub trait Message: Sized {
    /// The length in bytes of each message of this type; for [`Bytes`] the greatest length.
    const SIZE: usize;

    /// Writes the message to the front of `out`. Returns its length in bytes, or `None` if a field holds a value that no message
    /// can hold.
    fn encode(&self, out: &mut [u8; LONGEST]) -> Option<usize>;

    /// Reads a message from exactly these bytes; `None` if they are no message of this type.
    fn decode(bytes: &[u8]) -> Option<Self>;
}

/// A type that a field of a message can have. Each is a type of the cell language: `bool`, `i8` (int8), `i16`
/// (int16), `i32` (int32), `u32` (word), `f32` (real).
pub trait Field: Copy {
    /// How many bytes the field takes.
    const BYTES: usize;

    /// Writes the value to `out`, which is [`BYTES`](Self::BYTES) long. Returns `None` for a value that no message
    /// can hold.
    fn put(self, out: &mut [u8]) -> Option<()>;

    /// Reads a value from `bytes`; `None` if these bytes are no value of this type.
    fn take(bytes: &[u8]) -> Option<Self>;
}

macro_rules! integers {
    ($($of:ty),*) => {$(
        impl Field for $of {
            const BYTES: usize = size_of::<$of>();

            fn put(self, out: &mut [u8]) -> Option<()> {
                out.copy_from_slice(self.to_le_bytes().get(..out.len())?);
                Some(())
            }

            fn take(bytes: &[u8]) -> Option<Self> {
                Some(Self::from_le_bytes(bytes.try_into().ok()?))
            }
        }
    )*};
}

integers!(i8, i16, i32, u32);

impl Field for bool {
    const BYTES: usize = 1;

    fn put(self, out: &mut [u8]) -> Option<()> {
        i8::from(self).put(out)
    }

    fn take(bytes: &[u8]) -> Option<Self> {
        match bytes {
            [0] => Some(false),
            [1] => Some(true),
            _ => None,
        }
    }
}

impl Field for f32 {
    const BYTES: usize = 4;

    fn put(self, out: &mut [u8]) -> Option<()> {
        // The cell language has only one zero, and neither infinities nor NaN.
        let value = if self == 0.0 { 0.0 } else { self };
        value.is_finite().then_some(value.to_bits())?.put(out)
    }

    fn take(bytes: &[u8]) -> Option<Self> {
        let value = Self::from_bits(u32::take(bytes)?);
        (value.is_finite() && (value != 0.0 || value.is_sign_positive())).then_some(value)
    }
}

impl<F: Field> Message for F {
    const SIZE: usize = F::BYTES;

    fn encode(&self, out: &mut [u8; LONGEST]) -> Option<usize> {
        self.put(out.get_mut(..F::BYTES)?)?;
        Some(F::BYTES)
    }

    fn decode(bytes: &[u8]) -> Option<Self> {
        if bytes.len() == F::BYTES { F::take(bytes) } else { None }
    }
}

/// A message without fields.
impl Message for () {
    const SIZE: usize = 0;

    fn encode(&self, _out: &mut [u8; LONGEST]) -> Option<usize> {
        Some(0)
    }

    fn decode(bytes: &[u8]) -> Option<Self> {
        bytes.is_empty().then_some(())
    }
}

macro_rules! tuples {
    ($(($($field:ident $of:ident),+))*) => {$(
        impl<$($of: Field),+> Message for ($($of,)+) {
            const SIZE: usize = 0 $(+ $of::BYTES)+;

            fn encode(&self, out: &mut [u8; LONGEST]) -> Option<usize> {
                let ($($field,)+) = *self;
                let mut at = 0;
                $(
                    $field.put(out.get_mut(at..at + $of::BYTES)?)?;
                    at += $of::BYTES;
                )+
                Some(at)
            }

            fn decode(bytes: &[u8]) -> Option<Self> {
                if bytes.len() != Self::SIZE {
                    return None;
                }
                let mut rest = bytes;
                $(
                    let (first, after) = rest.split_at_checked($of::BYTES)?;
                    let $field = $of::take(first)?;
                    rest = after;
                )+
                rest.is_empty().then_some(($($field,)+))
            }
        }
    )*};
}

tuples! { (a A) (a A, b B) (a A, b B, c C) (a A, b B, c C, d D) (a A, b B, c C, d D, e E) (a A, b B, c C, d D, e E, f F) }

/// A message of unknown type: up to [`LONGEST`] bytes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Bytes {
    length: usize,
    room: [u8; LONGEST],
}

impl Bytes {
    /// A message of these bytes; `None` if there are more than [`LONGEST`].
    #[must_use]
    pub fn new(bytes: &[u8]) -> Option<Self> {
        let mut all = Self::default();
        all.room.get_mut(..bytes.len())?.copy_from_slice(bytes);
        all.length = bytes.len();
        Some(all)
    }

    pub(crate) fn of(contents: &Contents) -> Self {
        let mut all = Self::default();
        all.append(contents);
        all
    }

    /// Appends a fragment, unless the message would then be longer than [`LONGEST`].
    pub(crate) fn append(&mut self, contents: &Contents) {
        let part = contents.as_bytes();
        if let Some(room) = self.room.get_mut(self.length..self.length + part.len()) {
            room.copy_from_slice(part);
            self.length += part.len();
        }
    }
}

impl Default for Bytes {
    fn default() -> Self {
        Self { length: 0, room: [0; LONGEST] }
    }
}

impl Deref for Bytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.room[..self.length]
    }
}

impl fmt::Debug for Bytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        (**self).fmt(f)
    }
}

impl Message for Bytes {
    const SIZE: usize = LONGEST;

    fn encode(&self, out: &mut [u8; LONGEST]) -> Option<usize> {
        *out = self.room;
        Some(self.length)
    }

    fn decode(bytes: &[u8]) -> Option<Self> {
        Self::new(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn back<M: Message + PartialEq + fmt::Debug>(message: M, bytes: &[u8]) {
        let mut room = [0xff; LONGEST];
        assert_eq!(message.encode(&mut room), Some(bytes.len()), "{message:?}");
        assert_eq!(&room[..bytes.len()], bytes, "{message:?}");
        assert_eq!(M::decode(bytes), Some(message));
    }

    #[test]
    fn fields_stand_one_after_another_little_endian() {
        back((), b"");
        back(-2_i8, &[0xfe]);
        back((true, 0x0102_i16, 0x0304_0506_u32), &[1, 2, 1, 6, 5, 4, 3]);
        back((1.5_f32, -1_i32), &[0, 0, 0xc0, 0x3f, 0xff, 0xff, 0xff, 0xff]);
        back(Bytes::new(b"any").expect("short"), b"any");
    }

    #[test]
    fn what_is_no_value_of_the_language_is_neither_sent_nor_read() {
        let mut room = [0; LONGEST];
        assert_eq!((f32::NAN.encode(&mut room), f32::INFINITY.encode(&mut room)), (None, None));
        assert_eq!(((-0.0_f32).encode(&mut room), &room[..4]), (Some(4), &[0; 4][..]));
        assert_eq!(f32::decode(&[0, 0, 0, 0x80]), None, "zero has no sign");
        assert_eq!(f32::decode(&f32::NAN.to_le_bytes()), None);
        assert_eq!((bool::decode(&[2]), i16::decode(&[1]), u32::decode(&[0; 5])), (None, None, None));
        assert_eq!(<(i8, i8)>::decode(&[1, 2, 3]), None, "too long");
        assert!(Bytes::new(&[0; LONGEST + 1]).is_none());
    }
}
