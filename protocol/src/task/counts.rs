//! The counters of a port as its task keeps them.

use crate::observe::PortCounters;
use core::ops::AddAssign;
use serde::{Deserialize, Serialize};

/// A saturating counter of 48 bits: at a million counts per second the counter is full after 8.9 years.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "u64", into = "u64")]
pub(crate) struct Count([u16; 3]);

impl Count {
    const MOST: u64 = (1 << 48) - 1;
}

impl From<Count> for u64 {
    fn from(Count([low, middle, high]): Count) -> Self {
        Self::from(low) | (Self::from(middle) << 16) | (Self::from(high) << 32)
    }
}

impl From<u64> for Count {
    #[expect(clippy::cast_possible_truncation, reason = "in parts")]
    fn from(count: u64) -> Self {
        let count = count.min(Self::MOST);
        Self([count as u16, (count >> 16) as u16, (count >> 32) as u16])
    }
}

impl AddAssign<u64> for Count {
    #[inline]
    fn add_assign(&mut self, more: u64) {
        let low = &mut self.0[0];
        // Nearly always `more` is 1, and the sum fits into the low part.
        match u16::try_from(more).ok().and_then(|more| low.checked_add(more)) {
            Some(sum) => *low = sum,
            None => self.carry(more),
        }
    }
}

impl Count {
    #[cold]
    fn carry(&mut self, more: u64) {
        *self = u64::from(*self).saturating_add(more).into();
    }
}

/// [`PortCounters`] in 66 bytes, because every port of every task has them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Counts {
    pub sent: Count,
    pub resent: Count,
    pub enqueued: Count,
    pub delivered: Count,
    pub expired: Count,
    pub refused: Count,
    pub rejected: Count,
    pub evicted: Count,
    pub duplicates: Count,
    pub timed_out: Count,
    pub dropped: Count,
}

impl From<&Counts> for PortCounters {
    fn from(counts: &Counts) -> Self {
        Self {
            sent: counts.sent.into(),
            resent: counts.resent.into(),
            enqueued: counts.enqueued.into(),
            delivered: counts.delivered.into(),
            expired: counts.expired.into(),
            refused: counts.refused.into(),
            rejected: counts.rejected.into(),
            evicted: counts.evicted.into(),
            duplicates: counts.duplicates.into(),
            timed_out: counts.timed_out.into(),
            dropped: counts.dropped.into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_counter_stays_full() {
        let mut count = Count::default();
        for (more, sum) in [(1, 1), (0xffff, 0x1_0000), (0xffff_ffff, 0x1_0000_ffff)] {
            count += more;
            assert_eq!(u64::from(count), sum);
        }
        for more in [Count::MOST - 0x1_0001_0000, 1, 1, u64::MAX] {
            count += more;
        }
        assert_eq!(u64::from(count), (1 << 48) - 1);
    }
}
