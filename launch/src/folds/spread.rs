//! Percentiles of any number of values, in bounded memory.

use serde::Serialize;

/// How many values are kept exactly at most.
const KEPT: usize = 4_096;
/// If there are more values, they are counted in buckets with a relative width of at most 1 / `PARTS`. `PARTS` is a
/// power of two.
const PARTS: u64 = 128;

/// The median, the 99th percentile and the maximum of some values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Spread {
    /// The median: half of the values are no larger.
    pub p50: u64,
    /// The 99th percentile: 99 of 100 values are no larger.
    pub p99: u64,
    /// The largest value.
    pub max: u64,
}

/// Collects values. Up to 4,096 values the result is exact. With more values, `p50` and `p99` are at most one part in
/// 128 too large, and `max` is exact.
#[derive(Clone, Debug, Default)]
pub struct Spreading {
    /// The values, as long as there are at most `KEPT`.
    kept: Vec<u64>,
    /// The number of values in each bucket; empty while there are at most `KEPT` values.
    counts: Vec<u64>,
    max: u64,
}

impl Spreading {
    /// Adds a value.
    pub fn add(&mut self, value: u64) {
        self.max = self.max.max(value);
        if self.counts.is_empty() && self.kept.len() < KEPT {
            self.kept.push(value);
            return;
        }
        for value in std::mem::take(&mut self.kept) {
            self.count(value);
        }
        self.count(value);
    }

    fn count(&mut self, value: u64) {
        let at = bucket(value);
        if self.counts.len() <= at {
            self.counts.resize(at + 1, 0);
        }
        self.counts[at] += 1;
    }

    /// The percentiles; `None` without values.
    pub fn spread(&self) -> Option<Spread> {
        let mut kept = self.kept.clone();
        kept.sort_unstable();
        let all = kept.len() as u64 + self.counts.iter().sum::<u64>();
        // The nearest rank: the least value such that at least `percent` of all values are not greater.
        let rank = |percent: u64| {
            let rank = (all * percent).div_ceil(100).max(1);
            let mut below = 0;
            let at = self.counts.iter().position(|&count| {
                below += count;
                below >= rank
            });
            let of_bucket = at.map(|at| largest(at).min(self.max));
            of_bucket.or_else(|| kept.get(usize::try_from(rank - 1).ok()?).copied()).unwrap_or(self.max)
        };
        (all > 0).then(|| Spread { p50: rank(50), p99: rank(99), max: self.max })
    }

    /// How many numbers are held in memory.
    #[cfg(test)]
    pub fn size(&self) -> usize {
        self.kept.len() + self.counts.len()
    }
}

/// The bucket of a value: one for each value below `2 * PARTS`, then `PARTS` for each power of two.
fn bucket(value: u64) -> usize {
    let shift = u64::from((2 * PARTS).leading_zeros().saturating_sub(value.leading_zeros()) + 1);
    let shift = if value < 2 * PARTS { 0 } else { shift };
    usize::try_from(shift * PARTS + (value >> shift)).unwrap_or(usize::MAX)
}

/// The largest value of a bucket.
fn largest(bucket: usize) -> u64 {
    let bucket = bucket as u64;
    let shift = (bucket / PARTS).saturating_sub(1);
    let head = bucket - shift * PARTS;
    (head << shift) + ((1 << shift) - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_of_few_values_are_values_that_occurred() {
        let spread = |values: &mut dyn Iterator<Item = u64>| {
            let mut all = Spreading::default();
            values.for_each(|value| all.add(value));
            all.spread()
        };
        assert_eq!(spread(&mut [].into_iter()), None);
        assert_eq!(spread(&mut [3].into_iter()), Some(Spread { p50: 3, p99: 3, max: 3 }));
        assert_eq!(spread(&mut (1..=100).rev()), Some(Spread { p50: 50, p99: 99, max: 100 }));
    }

    #[test]
    fn every_value_is_in_a_bucket_that_is_no_wider_than_stated() {
        let mut last = 0;
        for value in
            (0..100_000).chain((17..64).flat_map(|power| [(1 << power) - 1, 1 << power])).chain([u64::MAX])
        {
            let (at, most) = (bucket(value), largest(bucket(value)));
            assert!(at >= last && most >= value && most - value <= value / PARTS, "{value}: {at}, {most}");
            last = at;
        }
        assert!(last < 8_000, "{last}");
    }

    #[test]
    fn of_a_million_values_the_size_is_bounded_and_the_error_is_too() {
        let (mut all, mut plain) = (Spreading::default(), Vec::new());
        let mut value = 1_u64;
        for _ in 0..1_000_000 {
            value = value.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            // Most of these values are small, and a few are large.
            let us = (value >> 44) >> (value >> 20 & 15);
            all.add(us);
            plain.push(us);
        }
        plain.sort_unstable();
        let found = all.spread().expect("values");
        for (found, exact) in [(found.p50, plain[499_999]), (found.p99, plain[989_999])] {
            assert!(found >= exact && found - exact <= exact / PARTS, "{found} for {exact}");
        }
        assert_eq!(found.max, plain[999_999]);
        assert!(all.size() < 8_000, "{}", all.size());
    }
}
