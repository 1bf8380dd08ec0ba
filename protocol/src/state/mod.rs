//! One traversal of all state, for packing, reading and changing it (D165). Each struct of a state lists its fields once, in
//! `walk(&mut self, .., w: &mut impl Walk)`. That function destructures the struct without `..`, so a new field does not
//! compile until it is listed. A pass decides what is done with the fields.
//!
//! | pass | what it does with a field |
//! |---|---|
//! | [`Encode`] | writes it in canonical form: instants as remaining times, numbers relative to the [`Frame`] (D51) |
//! | [`Decode`] | reads it back, relative to zero |
//! | [`Pass::Look`] | reads relative values, for example to find the least round in use |
//! | [`Pass::Change`] | shifts relative values: rebases a clock, adds a constant to ids |
//!
//! A field is *walked*, *rebuilt* by a pass that reads, from other fields, or *ignored*. Behaviour does not depend on an
//! ignored field, and a comment says why.

mod bytes;

pub use bytes::{Decode, Encode, Frame, Overflow};

use crate::ids::{Incarnation, MessageId, PortId, Round, Seq24, TaskId};
use crate::packet::{CONTENTS_BYTES, Contents};
use crate::ticks::{Instant, Ticks};
use alloc::vec::Vec;

/// What a pass does with the fields of a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pass {
    /// The pass writes bytes.
    Encode,
    /// The pass reads bytes and overwrites the earlier values.
    Decode,
    /// The pass looks at values and changes none.
    Look,
    /// The pass changes relative values and keeps the order of instants.
    Change,
}

/// A pass over a state. A method that a pass does not override does nothing.
pub trait Walk {
    /// What the pass does with the fields.
    const PASS: Pass;
    /// Whether the pass reads bytes: if so, containers are filled, and derived fields are rebuilt.
    const READS: bool = matches!(Self::PASS, Pass::Decode);
    /// Whether the pass writes or reads bytes.
    const PACKS: bool = matches!(Self::PASS, Pass::Encode | Pass::Decode);

    /// Visits the clock to which the instants that follow belong.
    fn clock(&mut self, now: &mut Instant) {
        let _ = now;
    }

    /// Visits an instant on the clock that was visited last.
    fn instant(&mut self, instant: &mut Instant) {
        let _ = instant;
    }

    /// Visits an instant that follows from others on the same clock. As a number it is not packed: a pass that reads calls
    /// `derive` instead. As a symbol it is packed, because `derive` may need many comparisons of symbols, which are
    /// slow.
    fn derived(&mut self, instant: &mut Instant, derive: impl FnOnce() -> Instant) {
        if Self::READS {
            *instant = derive();
        } else if !Self::PACKS {
            self.instant(instant);
        }
    }

    /// Visits a round of a port.
    fn round(&mut self, port: PortId, round: &mut Round) {
        let _ = (port, round);
    }

    /// Visits a sequence number of a source.
    fn sequence(&mut self, source: TaskId, sequence: &mut Seq24) {
        let _ = (source, sequence);
    }

    /// Visits the next sequence number of a source, to which its other sequence numbers are relative.
    fn next_sequence(&mut self, source: TaskId, next: &mut Seq24) {
        self.sequence(source, next);
    }

    /// Visits an epoch of the couple at this position in the cell. The primary's epochs are odd, so only an even shift
    /// preserves behaviour.
    fn epoch(&mut self, couple: u8, epoch: &mut u8) {
        let _ = (couple, epoch);
    }

    /// Visits a byte, whose value no pass changes.
    fn byte(&mut self, byte: &mut u8) {
        let _ = byte;
    }

    /// Whether nodes restart. If not, every incarnation is the first one and takes no bytes.
    fn incarnations(&self) -> bool {
        true
    }

    /// Reports that the state does not fit its packed form.
    fn overflows(&mut self) {}

    /// Writes a byte, or returns the byte that is read in its place.
    fn put(&mut self, mut byte: u8) -> u8 {
        self.byte(&mut byte);
        byte
    }

    /// Visits a number that fits into one byte in all states that are checked.
    fn count(&mut self, count: usize) -> usize {
        let byte = u8::try_from(count).unwrap_or_else(|_| {
            self.overflows();
            0
        });
        if Self::PACKS { usize::from(self.put(byte)) } else { count }
    }

    /// Visits a `u16` that fits into one byte in all states that are checked.
    fn small(&mut self, number: &mut u16) {
        let read = self.count(usize::from(*number));
        if Self::READS {
            *number = u16::try_from(read).unwrap_or(0);
        }
    }

    /// Visits up to eight booleans; the first one is the lowest bit.
    fn flags<const N: usize>(&mut self, flags: [bool; N]) -> [bool; N] {
        if !Self::PACKS {
            return flags;
        }
        let bits = flags.iter().rev().fold(0, |bits, &flag| bits << 1 | u8::from(flag));
        let bits = self.put(bits);
        if Self::READS { core::array::from_fn(|i| bits & (1 << i) != 0) } else { flags }
    }

    /// Visits a boolean that takes a byte.
    fn flag(&mut self, flag: &mut bool) {
        *flag = self.flags([*flag])[0];
    }

    /// Visits bytes, whose values no pass changes.
    fn raw(&mut self, bytes: &mut [u8]) {
        if Self::PACKS {
            bytes.iter_mut().for_each(|byte| self.byte(byte));
        }
    }

    /// Visits a number of two bytes.
    fn word(&mut self, word: &mut u16) {
        let mut bytes = word.to_le_bytes();
        self.raw(&mut bytes);
        *word = u16::from_le_bytes(bytes);
    }

    /// Visits a number of eight bytes.
    fn long(&mut self, long: &mut u64) {
        let mut bytes = long.to_le_bytes();
        self.raw(&mut bytes);
        *long = u64::from_le_bytes(bytes);
    }

    /// Visits a number that takes one byte, or 255 followed by four bytes.
    fn number(&mut self, number: &mut u32) {
        match self.put(u8::try_from(*number).unwrap_or(u8::MAX)) {
            u8::MAX => {
                let mut bytes = number.to_le_bytes();
                self.raw(&mut bytes);
                *number = u32::from_le_bytes(bytes);
            }
            short if Self::READS => *number = u32::from(short),
            _ => {}
        }
    }

    /// Visits a length of time in the form of [`number`](Self::number): the greatest number stands for [`Ticks::FAR`].
    fn span(&mut self, span: &mut Ticks) {
        if !Self::PACKS {
            return;
        }
        let is_far = !Self::READS && *span == Ticks::FAR;
        let mut number = if is_far { u32::MAX } else { u32::try_from(span.0).unwrap_or(u32::MAX - 1) };
        self.number(&mut number);
        *span = if number == u32::MAX { Ticks::FAR } else { Ticks(number.into()) };
    }

    /// Visits the remaining time of something outside the machines; zero if that time is over. With `forgets`, behaviour
    /// does not depend on how long ago the time ended.
    fn left(&mut self, left: &mut Ticks, forgets: bool) {
        let _ = forgets;
        self.span(left);
    }

    /// Visits the time since a packet was sent over its link. The remaining time of the packet that is walked next counts
    /// from that instant.
    fn age(&mut self, age: &mut Ticks) {
        self.span(age);
    }

    /// Visits a length of time that takes one byte: 255 stands for [`Ticks::FAR`], and 254 is followed by four bytes for a
    /// longer one.
    fn length(&mut self, length: &mut Ticks) {
        self.number_of_ticks(length);
    }

    /// Visits the bytes of [`length`](Self::length).
    fn number_of_ticks(&mut self, length: &mut Ticks) {
        const LONG: u8 = u8::MAX - 1;
        if !Self::PACKS {
            return;
        }
        let short = u8::try_from(length.0).ok().filter(|&short| short < LONG);
        match self.put(short.unwrap_or(if *length == Ticks::FAR { u8::MAX } else { LONG })) {
            LONG => {
                let long = u32::try_from(length.0).unwrap_or_else(|_| {
                    if !Self::READS {
                        self.overflows();
                    }
                    0
                });
                let mut bytes = long.to_le_bytes();
                self.raw(&mut bytes);
                *length = Ticks(u64::from(u32::from_le_bytes(bytes)));
            }
            u8::MAX => *length = Ticks::FAR,
            short => *length = Ticks(u64::from(short)),
        }
    }

    /// Visits a byte that is packed only if `is` holds; otherwise the byte is zero.
    fn byte_if(&mut self, is: bool, byte: &mut u8) {
        if is {
            self.byte(byte);
        } else if Self::READS {
            *byte = 0;
        }
    }

    /// Visits a list: its length, then each element.
    fn list<T: Clone>(&mut self, list: &mut Vec<T>, blank: T, mut walk: impl FnMut(&mut T, &mut Self))
    where
        Self: Sized,
    {
        let count = self.count(list.len());
        if Self::READS {
            list.clear();
            list.resize(count, blank);
        }
        list.iter_mut().for_each(|one| walk(one, self));
    }

    /// Visits a list that is packed only if `is` holds; otherwise the list is empty.
    fn list_if<T: Clone>(
        &mut self,
        is: bool,
        list: &mut Vec<T>,
        blank: T,
        walk: impl FnMut(&mut T, &mut Self),
    ) where
        Self: Sized,
    {
        if is {
            self.list(list, blank, walk);
        } else if Self::READS {
            list.clear();
        }
    }

    /// Visits the contents of a packet.
    fn contents(&mut self, contents: &mut Contents) {
        if !Self::PACKS {
            return;
        }
        let len = self.count(contents.as_bytes().len()).min(CONTENTS_BYTES);
        let mut bytes = [0; CONTENTS_BYTES];
        if !Self::READS {
            bytes[..len].copy_from_slice(contents.as_bytes());
        }
        self.raw(&mut bytes[..len]);
        if Self::READS {
            *contents = Contents::new(&bytes[..len]).unwrap_or_default();
        }
    }

    /// Visits the arguments of a member's arrival, without trailing zeros.
    fn arguments(&mut self, arguments: &mut [u8; 8]) {
        if !Self::PACKS {
            return;
        }
        let len = arguments.iter().rposition(|&byte| byte != 0).map_or(0, |last| last + 1);
        let len = self.count(len).min(arguments.len());
        if Self::READS {
            *arguments = [0; 8];
        }
        self.raw(&mut arguments[..len]);
    }

    /// Visits the incarnation of a node.
    fn incarnation(&mut self, incarnation: &mut Incarnation) {
        if self.incarnations() {
            self.byte(&mut incarnation.0);
        }
    }

    /// Visits an incarnation that may not be known yet. If no node restarts, it is always the first incarnation.
    fn known_incarnation(&mut self, incarnation: &mut Option<Incarnation>) {
        if !self.incarnations() {
            if Self::READS {
                *incarnation = Some(Incarnation(0));
            }
            return;
        }
        let read = self.put(incarnation.map_or(0, |incarnation| incarnation.0.wrapping_add(1)));
        if Self::READS {
            *incarnation = read.checked_sub(1).map(Incarnation);
        }
    }

    /// Visits the id of a message. If no node restarts, its incarnation is `incarnation`.
    fn id(&mut self, source: TaskId, incarnation: Incarnation, id: &mut MessageId) {
        if Self::READS {
            id.incarnation = incarnation;
        }
        self.incarnation(&mut id.incarnation);
        self.sequence(source, &mut id.sequence);
    }

    /// Visits the variant of a value, packed as its position in `among`. A pass that reads sets the value to the template at
    /// the position read. The caller then walks the fields of the variant.
    fn one_of<T: Copy>(&mut self, among: &[T], value: &mut T, is_like: impl Fn(&T, &T) -> bool) {
        if !Self::PACKS {
            return;
        }
        let place = if Self::READS { Some(0) } else { among.iter().position(|one| is_like(one, value)) };
        if place.is_none() {
            self.overflows();
        }
        let place = self.count(place.unwrap_or(0));
        if Self::READS {
            *value = among[place.min(among.len() - 1)];
        }
    }

    /// The value in an `Option`. For a pass that reads, `is` says whether a value follows.
    fn some<'a, T>(&self, place: &'a mut Option<T>, is: bool, blank: T) -> Option<&'a mut T> {
        if Self::READS {
            *place = is.then_some(blank);
        }
        place.as_mut().filter(|_| is)
    }
}

/// A flag for a packed byte: `bit` if `set`, otherwise zero.
#[must_use]
pub const fn mark(set: bool, bit: u8) -> u8 {
    if set { bit } else { 0 }
}

/// Whether two options are both empty, or hold values of the same variant.
pub(crate) fn same_option<T>(a: &Option<T>, b: &Option<T>) -> bool {
    a.as_ref().map(core::mem::discriminant) == b.as_ref().map(core::mem::discriminant)
}

/// Whether two values are of the same variant.
pub(crate) fn same_variant<T>(a: &T, b: &T) -> bool {
    core::mem::discriminant(a) == core::mem::discriminant(b)
}

/// A pass that moves a clock, and every instant on it.
pub(crate) struct Clock<F>(pub F);

/// A pass that sets a clock back to its start. Instants in the past become the start.
pub(crate) fn restart(now: Instant) -> Clock<impl FnMut(Instant) -> Instant> {
    Clock(move |instant| Instant::START + (instant - now))
}

impl<F: FnMut(Instant) -> Instant> Walk for Clock<F> {
    const PASS: Pass = Pass::Change;

    fn clock(&mut self, now: &mut Instant) {
        *now = self.0(*now);
    }

    fn instant(&mut self, instant: &mut Instant) {
        *instant = self.0(*instant);
    }
}
