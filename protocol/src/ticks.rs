//! Time in machine ticks: durations, and instants on one clock.
//!
//! The state machine only compares times, adds and subtracts them. So a checker may run the machine on *symbolic* times:
//! differences of variables whose values it does not fix ([`symbolic`]). `number` holds the operations on both forms.

mod number;
#[cfg(feature = "checker")]
pub mod symbolic;

use core::cmp::Ordering;
use core::fmt;
use core::ops::{Add, AddAssign, Sub};
use serde::{Deserialize, Serialize};

/// A duration.
///
/// The machine does not know how long a tick is: it is a microsecond in the runtime, and the cell's `tick` in the
/// model checker (D42).
#[derive(Clone, Copy, Debug, Default, Hash, Serialize, Deserialize)]
#[expect(
    clippy::derived_hash_with_manual_eq,
    reason = "equal numbers hash alike, and symbols are never hashed"
)]
pub struct Ticks(pub u64);

impl Ticks {
    /// No time at all.
    pub const ZERO: Self = Self(0);
    /// A duration without an end, longer than every other one.
    pub const FAR: Self = Self(u64::MAX);

    /// `self - other`, or zero if `other` is longer. [`Ticks::FAR`] stays [`Ticks::FAR`].
    #[must_use]
    pub fn saturating_sub(self, other: Self) -> Self {
        Self(number::difference(self.0, other.0))
    }

    /// How many whole periods fit into the duration. A period of zero counts as a period of one tick.
    #[must_use]
    pub fn whole(self, period: Self) -> u64 {
        number::quotient(self.0, period.0.max(1))
    }

    /// Whether the duration is zero: a message with a remaining time of zero has expired (D23).
    #[must_use]
    pub fn is_zero(self) -> bool {
        self == Self::ZERO
    }
}

/// An instant on the clock of one machine: a communication task, a transit buffer, a Timer or a node. The clock
/// begins at [`Instant::START`].
///
/// Instants are compared and moved by a duration, and `later - earlier` is a duration. Instants of two clocks are
/// never compared, because there is no global clock (§5.1): machines exchange durations only.
#[derive(Clone, Copy, Debug, Default, Hash, Serialize, Deserialize)]
#[expect(
    clippy::derived_hash_with_manual_eq,
    reason = "equal numbers hash alike, and symbols are never hashed"
)]
pub struct Instant(pub u64);

impl Instant {
    /// The first instant of the clock.
    pub const START: Self = Self(0);
    /// An instant later than all instants that a clock reaches.
    pub const NEVER: Self = Self(u64::MAX);
}

/// Implements the order of times with the operations of `number`.
macro_rules! ordered {
    ($($time:ty),*) => {$(
        impl PartialEq for $time {
            fn eq(&self, other: &Self) -> bool {
                number::is_same(self.0, other.0)
            }
        }

        impl Eq for $time {}

        impl PartialOrd for $time {
            fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
                Some(self.cmp(other))
            }
            fn lt(&self, other: &Self) -> bool {
                number::is_less(self.0, other.0)
            }
            fn le(&self, other: &Self) -> bool {
                !number::is_less(other.0, self.0)
            }
            fn gt(&self, other: &Self) -> bool {
                number::is_less(other.0, self.0)
            }
            fn ge(&self, other: &Self) -> bool {
                !number::is_less(self.0, other.0)
            }
        }

        impl Ord for $time {
            fn cmp(&self, other: &Self) -> Ordering {
                number::order(self.0, other.0)
            }
            fn max(self, other: Self) -> Self {
                if other < self { self } else { other }
            }
            fn min(self, other: Self) -> Self {
                if other < self { other } else { self }
            }
        }
    )*};
}

ordered!(Ticks, Instant);

/// The sum saturates at [`Ticks::FAR`].
impl Add for Ticks {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(number::sum(self.0, other.0))
    }
}

impl AddAssign for Ticks {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

/// The difference saturates at zero, as [`Ticks::saturating_sub`].
impl Sub for Ticks {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self.saturating_sub(other)
    }
}

/// The sum saturates at [`Instant::NEVER`].
impl Add<Ticks> for Instant {
    type Output = Self;
    fn add(self, length: Ticks) -> Self {
        Self(number::sum(self.0, length.0))
    }
}

impl AddAssign<Ticks> for Instant {
    fn add_assign(&mut self, length: Ticks) {
        *self = *self + length;
    }
}

/// The difference saturates at [`Instant::START`]. [`Instant::NEVER`] stays [`Instant::NEVER`].
impl Sub<Ticks> for Instant {
    type Output = Self;
    fn sub(self, length: Ticks) -> Self {
        Self(number::difference(self.0, length.0))
    }
}

/// The duration from an earlier instant to this one. The duration is zero if that instant is not earlier, and
/// [`Ticks::FAR`] if this instant is [`Instant::NEVER`].
impl Sub for Instant {
    type Output = Ticks;
    fn sub(self, earlier: Self) -> Ticks {
        Ticks(number::difference(self.0, earlier.0))
    }
}

impl fmt::Display for Ticks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}

impl fmt::Display for Instant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}
