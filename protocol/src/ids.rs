//! Identifiers of tasks, nodes, ports, messages and rounds. The protocol only compares message ids and rounds (for equality,
//! and in wrap-safe order) and increments them. So adding a constant to all ids of one source changes no behaviour (D51).

use core::fmt;
use serde::{Deserialize, Serialize};

/// A computational task `T_i` of the cell (§I): an index into the cell's task list.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct TaskId(pub u16);

/// A node `N_i` of the distributed computer system (§5.1): an index into the cell's node list.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct NodeId(pub u16);

/// The globally unique port identifier, the paper's PID (§III): an index into the cell's port list.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct PortId(pub u16);

impl PortId {
    /// The number that stands for no port. A cell has fewer ports than that.
    pub const NONE: Self = Self(u16::MAX);
}

macro_rules! index {
    ($($name:ident $letter:literal),*) => {$(
        impl $name {
            /// The position of the port in the cell's list.
            #[must_use]
            pub const fn index(self) -> usize {
                self.0 as usize
            }

            /// The identifier of the port at position `index`. The cell's limits keep it within 16 bits.
            #[must_use]
            #[expect(clippy::cast_possible_truncation, reason = "a cell has at most 65,536 of each")]
            pub const fn from_index(index: usize) -> Self {
                Self(index as u16)
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!($letter, "{}"), self.0)
            }
        }
    )*};
}
index!(TaskId "T", NodeId "N", PortId "P");

/// The incarnation of a node: one start, until the node ends. Each restart begins a new incarnation (D49).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Incarnation(pub u8);

impl Incarnation {
    /// Whether this incarnation is earlier than `other`, in wrap-safe order.
    pub(crate) const fn is_older_than(self, other: Self) -> bool {
        let steps = other.0.wrapping_sub(self.0);
        steps != 0 && steps < 0x80
    }
}

/// A 24-bit sequence number that wraps. Ordered by distance: `a` is newer than `b` if it is less than half the range
/// ahead. [`CellTable::new`](crate::CellTable::new) rejects a rate that could reach half the range within one TTL (D53).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "u32", into = "u32")]
pub struct Seq24(u32);

impl From<Seq24> for u32 {
    fn from(Seq24(number): Seq24) -> Self {
        number
    }
}

/// Validates a sequence number from a file, because the arithmetic relies on values below 2^24.
impl TryFrom<u32> for Seq24 {
    type Error = &'static str;

    fn try_from(number: u32) -> Result<Self, Self::Error> {
        if number < Self::MODULUS { Ok(Self(number)) } else { Err("a sequence number of more than 24 bits") }
    }
}

impl Seq24 {
    /// The number of different sequence numbers.
    pub const MODULUS: u32 = 1 << 24;

    /// The sequence number `value` modulo 2^24.
    #[must_use]
    pub const fn new(value: u32) -> Self {
        Self(value % Self::MODULUS)
    }

    /// The raw value, below 2^24.
    #[must_use]
    pub const fn get(self) -> u32 {
        self.0
    }

    /// The number after this one, around the wrap.
    #[must_use]
    pub const fn next(self) -> Self {
        Self::new(self.0 + 1)
    }

    /// This number moved `by` steps forward, around the wrap.
    #[must_use]
    pub const fn plus(self, by: u32) -> Self {
        Self::new(self.0.wrapping_add(by % Self::MODULUS))
    }

    /// How many steps forward lead from `older` to `self`, around the wrap.
    #[must_use]
    pub const fn steps_from(self, older: Self) -> u32 {
        (self.0 + Self::MODULUS - older.0) % Self::MODULUS
    }

    /// Whether `self` comes after `other` in wrap-safe order. Never true of equal numbers.
    #[must_use]
    pub const fn is_newer_than(self, other: Self) -> bool {
        let steps = self.steps_from(other);
        steps != 0 && steps < Self::MODULUS / 2
    }
}

/// A message identifier: unique per source for as long as duplicates may arrive (§5.2, D6).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct MessageId {
    /// The incarnation of the source node that made the message.
    pub incarnation: Incarnation,
    /// The position of the message among those of its source task.
    pub sequence: Seq24,
}

impl MessageId {
    /// A placeholder id, which is overwritten when an id is read.
    pub const BLANK: Self = Self { incarnation: Incarnation(0), sequence: Seq24::new(0) };
}

impl fmt::Display for MessageId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.incarnation.0, self.sequence.get())
    }
}

/// The number of a meeting at a rendezvous, a `waitfor` port (D3). Wraps; ordered by distance like [`Seq24`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Round(pub u16);

impl Round {
    /// The round after this one, around the wrap.
    #[must_use]
    pub const fn next(self) -> Self {
        Self(self.0.wrapping_add(1))
    }

    /// This round moved `by` steps forward, around the wrap.
    #[must_use]
    pub const fn plus(self, by: u16) -> Self {
        Self(self.0.wrapping_add(by))
    }

    /// How many steps forward lead from `older` to `self`, around the wrap.
    #[must_use]
    pub const fn steps_from(self, older: Self) -> u16 {
        self.0.wrapping_sub(older.0)
    }

    /// Whether `self` comes after `other` in wrap-safe order. Never true of equal rounds.
    #[must_use]
    pub const fn is_newer_than(self, other: Self) -> bool {
        let steps = self.steps_from(other);
        steps != 0 && steps < 0x8000
    }

    /// The fresher of two rounds in wrap-safe order.
    #[must_use]
    pub const fn fresher(self, other: Self) -> Self {
        if other.is_newer_than(self) { other } else { self }
    }
}

impl fmt::Display for Round {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "r{}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sequence_order_survives_every_wrap() {
        for base in [0, 1, 0x7f_ffff, 0x80_0000, 0xff_fffe, 0xff_ffff] {
            let a = Seq24::new(base);
            assert!(a.next().is_newer_than(a) && !a.is_newer_than(a.next()) && !a.is_newer_than(a));
            assert!(a.plus(0x7f_ffff).is_newer_than(a));
            assert!(!a.plus(0x80_0000).is_newer_than(a) && !a.is_newer_than(a.plus(0x80_0000)));
            assert_eq!(a.plus(7).steps_from(a), 7);
        }
    }

    #[test]
    fn round_order_survives_every_wrap() {
        for base in [0, 0x7fff, 0x8000, 0xffff] {
            let r = Round(base);
            assert!(r.next().is_newer_than(r) && !r.is_newer_than(r.next()) && !r.is_newer_than(r));
            assert!(r.plus(0x7fff).is_newer_than(r) && !r.plus(0x8000).is_newer_than(r));
            assert_eq!(r.fresher(r.next()), r.next());
            assert_eq!(r.next().fresher(r), r.next());
        }
    }
}
