//! Durations and local instants in machine ticks.

use core::fmt;
use core::ops::{Add, AddAssign, Sub};
use serde::{Deserialize, Serialize};

/// A length of time, or an instant on one communication task's own elapsed-ticks counter.
///
/// The machine does not know how long a tick is. The runtime gives microseconds, the model checker gives the cell's
/// `tick` (D42). Instants of two tasks are never compared: there is no global clock (§5.1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Ticks(pub u64);

impl Ticks {
    /// No time at all.
    pub const ZERO: Self = Self(0);
    /// Later than every instant that a machine reaches.
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

/// Saturating: an instant past the counter's end stays [`Ticks::FAR`]. `rebase` keeps real counters far below it.
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

impl fmt::Display for Ticks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}
