//! Time in machine ticks: durations, and instants on one clock.

use core::fmt;
use core::ops::{Add, AddAssign, Sub};
use serde::{Deserialize, Serialize};

/// A duration.
///
/// The machine does not know how long a tick is: it is a microsecond in the runtime, and the cell's `tick` in the
/// model checker (D42).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Ticks(pub u64);

impl Ticks {
    /// No time at all.
    pub const ZERO: Self = Self(0);
    /// Longer than every other duration: without an end.
    pub const FAR: Self = Self(u64::MAX);

    /// `self - other`, or zero if `other` is longer. [`Ticks::FAR`] stays [`Ticks::FAR`].
    #[must_use]
    pub const fn saturating_sub(self, other: Self) -> Self {
        if self.0 == u64::MAX { self } else { Self(self.0.saturating_sub(other.0)) }
    }

    /// Whether the duration is zero: a message with a remaining time of zero has expired (D23).
    #[must_use]
    pub const fn is_zero(self) -> bool {
        self.0 == 0
    }
}

/// Saturating at [`Ticks::FAR`].
impl Add for Ticks {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}

impl AddAssign for Ticks {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

/// Saturating at zero, as [`Ticks::saturating_sub`].
impl Sub for Ticks {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self.saturating_sub(other)
    }
}

/// An instant on the clock of one machine: a communication task, a transit buffer, a Timer or a node. The clock
/// begins at [`Instant::START`].
///
/// Instants are compared and moved by a duration, and `later - earlier` is a duration. Instants of two clocks are
/// never compared, because there is no global clock (§5.1): machines exchange durations only.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Instant(pub u64);

impl Instant {
    /// The first instant of the clock.
    pub const START: Self = Self(0);
    /// Later than every instant that a clock reaches.
    pub const NEVER: Self = Self(u64::MAX);
}

/// Saturating at [`Instant::NEVER`].
impl Add<Ticks> for Instant {
    type Output = Self;
    fn add(self, length: Ticks) -> Self {
        Self(self.0.saturating_add(length.0))
    }
}

impl AddAssign<Ticks> for Instant {
    fn add_assign(&mut self, length: Ticks) {
        *self = *self + length;
    }
}

/// Saturating at [`Instant::START`]. [`Instant::NEVER`] stays [`Instant::NEVER`].
impl Sub<Ticks> for Instant {
    type Output = Self;
    fn sub(self, length: Ticks) -> Self {
        Self(Ticks(self.0).saturating_sub(length).0)
    }
}

/// The duration from an earlier instant to this one: zero if that is not earlier, and [`Ticks::FAR`] up to [`Instant::NEVER`].
impl Sub for Instant {
    type Output = Ticks;
    fn sub(self, earlier: Self) -> Ticks {
        Ticks(self.0).saturating_sub(Ticks(earlier.0))
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
