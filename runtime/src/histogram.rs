//! A histogram of times in fixed memory, with one writer: it takes a time in a few instructions and allocates nothing.
//!
//! Times are counted in ranges whose width grows with the time: each range is at most a sixteenth of the times in it. So a
//! percentile is at most a sixteenth more than the truth, and never less.

use std::sync::atomic::{AtomicU64, Ordering};

/// The number of ranges for each doubling of the time, as a power of two.
const FINENESS: u32 = 4;
/// The number of ranges. Everything above 33 s counts in the last one.
const RANGES: usize = 23 << FINENESS;

/// A histogram of times in microseconds.
#[derive(Debug)]
pub(crate) struct Histogram {
    counts: [AtomicU64; RANGES],
    greatest: AtomicU64,
}

/// The counts of a histogram at some moment, or those that were added between two moments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Counts {
    counts: [u64; RANGES],
    /// The greatest time that was counted.
    greatest: u64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { counts: std::array::from_fn(|_| AtomicU64::new(0)), greatest: AtomicU64::new(0) }
    }
}

impl Histogram {
    /// Counts a time. Only one thread at a time may call this.
    pub fn note(&self, micros: u64) {
        // Only one thread writes, so no increment is lost between the load and the store.
        let count = &self.counts[place(micros)];
        count.store(count.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
        if micros > self.greatest.load(Ordering::Relaxed) {
            self.greatest.store(micros, Ordering::Relaxed);
        }
    }

    /// All counts so far.
    pub fn counts(&self) -> Counts {
        Counts {
            counts: std::array::from_fn(|at| self.counts[at].load(Ordering::Relaxed)),
            greatest: self.greatest.load(Ordering::Relaxed),
        }
    }
}

impl Default for Counts {
    fn default() -> Self {
        Self { counts: [0; RANGES], greatest: 0 }
    }
}

impl Counts {
    /// The counts that were added since `earlier`.
    pub fn since(&self, earlier: &Self) -> Self {
        let counts = std::array::from_fn(|at| self.counts[at].saturating_sub(earlier.counts[at]));
        Self { counts, greatest: self.greatest }
    }

    /// How many times were counted.
    pub fn total(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// The least time that at least `percent` percent of the times do not exceed, in microseconds; zero if none was
    /// counted.
    pub fn percentile(&self, percent: u64) -> u64 {
        let wanted = (self.total() * percent).div_ceil(100).max(1);
        let mut sum = 0;
        let range = self.counts.iter().position(|count| {
            sum += count;
            sum >= wanted
        });
        range.map_or(0, |range| end(range).min(self.greatest))
    }
}

/// The range of a time.
fn place(micros: u64) -> usize {
    let shift = (micros | 1 << FINENESS).ilog2() - FINENESS;
    let place = (u64::from(shift) << FINENESS) + (micros >> shift);
    usize::try_from(place).unwrap_or(RANGES).min(RANGES - 1)
}

/// The greatest time in a range; of the last range, which has no end, the greatest of all.
fn end(range: usize) -> u64 {
    if range == RANGES - 1 {
        return u64::MAX;
    }
    let shift = (range >> FINENESS).saturating_sub(1);
    let within = (range - (shift << FINENESS)) as u64;
    ((within + 1) << shift) - 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn ranges_follow_each_other_without_a_gap() {
        let mut next = 0;
        for range in 0..RANGES - 1 {
            assert_eq!((place(next), place(end(range))), (range, range));
            next = end(range) + 1;
        }
        assert_eq!((place(next), place(u64::MAX)), (RANGES - 1, RANGES - 1));
        assert!(next > 33_000_000, "{next}");
    }

    #[test]
    fn counts_of_a_part_of_the_time_leave_out_what_came_before() {
        let histogram = Histogram::default();
        assert_eq!(histogram.counts().percentile(99), 0);
        (0..99).for_each(|_| histogram.note(40_000));
        let before = histogram.counts();
        (0..98).for_each(|_| histogram.note(60));
        [3_000, 3_001].into_iter().for_each(|time| histogram.note(time));
        let all = histogram.counts();
        let lately = all.since(&before);
        assert_eq!((all.total(), lately.total()), (199, 100));
        assert_eq!(lately.percentile(50), 61);
        assert!((3_000..3_200).contains(&lately.percentile(99)));
        assert!((40_000..42_500).contains(&all.percentile(99)));
    }

    proptest! {
        /// Compares each percentile with that of the sorted list.
        #[test]
        fn a_percentile_is_never_less_than_the_truth_and_at_most_a_sixteenth_more(
            mut times in proptest::collection::vec(0..30_000_000_u64, 1..200), percent in 1..=100_u64,
        ) {
            let histogram = Histogram::default();
            times.iter().for_each(|&time| histogram.note(time));
            times.sort_unstable();
            let place = (times.len() * usize::try_from(percent).unwrap()).div_ceil(100) - 1;
            let (truth, told) = (times[place], histogram.counts().percentile(percent));
            prop_assert!(told >= truth && told <= truth + truth / 16, "{told} for {truth}");
            prop_assert_eq!(histogram.counts().percentile(100), *times.last().unwrap());
        }
    }
}
