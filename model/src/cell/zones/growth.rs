//! Accelerates a zone that grows and grows.
//!
//! While an action of some seconds runs, the heartbeats of a couple come back to the same control every some milliseconds,
//! each time with a zone that is larger by the same times. Without acceleration, each of these zones would be expanded. If a
//! zone has grown several times in the same way, the search assumes that it grows on like this for as long as the order of
//! its times stays the same, and goes on with the zone that this would lead to (D221). The assumption can only add times, so
//! the search still covers everything.

use crate::zone::dbm::Dbm;

/// The longest sequence of different growths that is noticed when it repeats. A control is reached several times in one
/// round of heartbeats, and grows by something else each time.
const PERIODS: usize = 4;

/// How often a growth must repeat before the zone is accelerated.
const REPEATS: usize = 2;

/// The zones that a zone was before it grew, the latest one last.
#[derive(Default)]
pub(super) struct Growth(Vec<Dbm>);

impl Growth {
    /// The greatest number of zones that are of use.
    const MOST: usize = PERIODS * (REPEATS + 1);

    /// Notes that a zone grows, which was `zone`.
    pub fn note(&mut self, zone: Dbm) {
        if self.0.len() == Self::MOST {
            self.0.remove(0);
        }
        self.0.push(zone);
    }

    /// Joins the growths of two zones that became one. The longer one is kept.
    pub fn join(&mut self, other: Self) {
        if other.0.len() > self.0.len() {
            *self = other;
        }
    }

    /// Whether the zone has grown often enough for a growth to have repeated.
    pub const fn may_repeat(&self) -> bool {
        self.0.len() >= REPEATS
    }

    /// The zone to which `now` will grow, which was `before`; `None` if it did not grow in the same way several times.
    pub fn ahead(&self, before: &Dbm, now: &Dbm) -> Option<Dbm> {
        let back = |steps: usize| match steps {
            0 => Some(now),
            1 => Some(before),
            _ => self.0.len().checked_sub(steps - 1).map(|at| &self.0[at]),
        };
        let repeats = |period: &usize| {
            (0..REPEATS).all(|at| {
                let zones = [at, at + 1, at + 2].map(|periods| back(periods * period));
                matches!(zones, [Some(third), Some(second), Some(first)] if third.grows_on(second, first))
            })
        };
        let period = (1..=PERIODS).find(repeats)?;
        now.ahead(back(period)?)
    }
}
