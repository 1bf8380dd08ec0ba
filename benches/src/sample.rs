//! The result of one measurement of a case: a sample of times.

use rustix::time::{ClockId, clock_gettime};
use std::time::{Duration, Instant};

/// The distribution of the measured times, in nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Sample {
    /// The median of the times.
    pub p50: f64,
    /// The 99th percentile of the times.
    pub p99: f64,
    /// The 99.9th percentile of the times.
    pub p999: f64,
    /// The mean of the times.
    pub mean: f64,
    /// A number that is not a time: bytes, allocations or sleeps. The case says what it counts.
    pub count: Option<f64>,
}

impl Sample {
    /// The distribution of measured times in nanoseconds, given in any order. Each time covers `group` operations.
    #[must_use]
    pub fn of(mut nanos: Vec<u64>, group: u32) -> Self {
        nanos.sort_unstable();
        let Some(last) = nanos.len().checked_sub(1) else { return Self::default() };
        let group = f64::from(group.max(1));
        let at = |share: f64| {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a share of a length"
            )]
            let position = (last as f64 * share).round() as usize;
            nanos[position.min(last)] as f64 / group
        };
        let mean = nanos.iter().sum::<u64>() as f64 / nanos.len() as f64 / group;
        Self { p50: at(0.5), p99: at(0.99), p999: at(0.999), mean, count: None }
    }

    /// The sample for one time that covers `operations` operations.
    #[must_use]
    pub fn of_all(elapsed: Duration, operations: u64) -> Self {
        let each = elapsed.as_nanos() as f64 / operations.max(1) as f64;
        Self { p50: each, p99: each, p999: each, mean: each, count: None }
    }

    /// A sample with a count and no times.
    #[must_use]
    pub fn counted(count: f64) -> Self {
        Self::default().with(count)
    }

    /// The same sample, with this number as its count.
    #[must_use]
    pub const fn with(mut self, count: f64) -> Self {
        self.count = Some(count);
        self
    }
}

/// Runs `operation` `times` times and measures the times. If an operation takes less than reading the clock, `group`
/// operations share one reading.
pub fn each(times: u32, group: u32, mut operation: impl FnMut()) -> Sample {
    Sample::of(laps(times, group, &mut operation), group)
}

/// The times that [`each`] measures, in nanoseconds, for callers that merge several lists.
pub fn laps(times: u32, group: u32, operation: &mut impl FnMut()) -> Vec<u64> {
    let mut nanos = Vec::with_capacity(times as usize);
    let mut before = Instant::now();
    for _ in 0..times / group.max(1) {
        for _ in 0..group {
            operation();
        }
        let after = Instant::now();
        nanos.push(nanos_of(after - before));
        before = after;
    }
    nanos
}

/// The processor time of this thread, in nanoseconds.
#[must_use]
pub fn worked() -> u64 {
    nanos_by(ClockId::ThreadCPUTime)
}

/// The time since some instant in the past, in nanoseconds.
#[must_use]
pub fn passed() -> u64 {
    nanos_by(ClockId::Monotonic)
}

fn nanos_by(clock: ClockId) -> u64 {
    let now = clock_gettime(clock);
    let nanos = i128::from(now.tv_sec) * 1_000_000_000 + i128::from(now.tv_nsec);
    u64::try_from(nanos).unwrap_or(0)
}

/// A duration in nanoseconds.
#[must_use]
pub fn nanos_of(length: Duration) -> u64 {
    u64::try_from(length.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_those_of_the_sorted_list() {
        let sample = Sample::of((1..=1_001).rev().collect(), 1);
        assert_eq!((sample.p50, sample.p99, sample.p999, sample.mean), (501.0, 991.0, 1_000.0, 501.0));
        let grouped = Sample::of(vec![40, 80], 8);
        assert_eq!((grouped.p50, grouped.mean), (10.0, 7.5));
        assert_eq!(Sample::of(Vec::new(), 1), Sample::default());
        assert_eq!(Sample::of_all(Duration::from_micros(3), 3).p99, 1_000.0);
    }

    #[test]
    fn every_operation_is_timed() {
        let mut done = 0;
        let nanos = laps(100, 10, &mut || done += 1);
        assert_eq!((done, nanos.len()), (100, 10));
    }
}
