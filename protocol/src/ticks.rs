//! Time in machine ticks: lengths, and instants on one clock.

use core::fmt;
use core::ops::{Add, AddAssign, Sub};
use serde::{Deserialize, Serialize};

/// A length of time.
///
/// The machine does not know how long a tick is. The runtime gives microseconds, the model checker gives the cell's
/// `tick` (D42).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Ticks(pub u64);

impl Ticks {
    /// No time at all.
    pub const ZERO: Self = Self(0);
    /// Longer than every other length.
    pub const FAR: Self = Self(u64::MAX);

    /// `self - other`, or zero where `other` is longer. [`Ticks::FAR`] stays what it is: never is always never.
    #[must_use]
    pub const fn saturating_sub(self, other: Self) -> Self {
        if self.0 == u64::MAX { self } else { Self(self.0.saturating_sub(other.0)) }
    }

    /// Whether this is the zero length: a remaining time of zero means expired (D23).
    #[must_use]
    pub const fn is_zero(self) -> bool {
        self.0 == 0
    }
}

/// Saturating: a length past the end is [`Ticks::FAR`].
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

/// A moment on the clock of one machine (a communication task, a transit buffer, a Timer, a node), which begins with
/// [`Instant::START`].
///
/// Instants are compared, moved by a length, and told apart by one: `later - earlier` is how long there is between them. Those
/// of two clocks are never compared: there is no global clock (§5.1), and what goes from one machine to another is a length.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Instant(pub u64);

impl Instant {
    /// The beginning of the clock.
    pub const START: Self = Self(0);
    /// Later than every moment that a clock comes to.
    pub const NEVER: Self = Self(u64::MAX);
}

/// Saturating: a moment past the end of the clock is [`Instant::NEVER`].
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

/// The moment so much earlier, or the beginning. [`Instant::NEVER`] stays what it is.
impl Sub<Ticks> for Instant {
    type Output = Self;
    fn sub(self, length: Ticks) -> Self {
        Self(Ticks(self.0).saturating_sub(length).0)
    }
}

/// How long from an earlier moment to this one: no time at all from a later one, and [`Ticks::FAR`] to [`Instant::NEVER`].
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
