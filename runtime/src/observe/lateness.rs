//! Counts how late the Timer thread begins to serve expiries. Only one thread writes the counters; its stores are
//! relaxed, and it does not read the clock for this.

use crate::clock::Micros;
use imrs_wire::obs::Lateness;
use std::sync::atomic::{AtomicU64, Ordering};

/// The number of counters: one for each number of binary digits that a lateness in microseconds may have.
const SIZES: usize = 32;

/// Counters of the Timer thread's lateness, with one writer.
#[derive(Debug)]
pub(crate) struct LatenessCounts {
    /// The counters, by number of binary digits: counter `n` counts the values that are below `2^n` and at least half
    /// of `2^n`.
    sizes: [AtomicU64; SIZES],
    late: AtomicU64,
    /// The lateness above which an expiry counts as late: the tick that the cell declares.
    tick: Micros,
}

/// The values of the counters when they were last read.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Seen([u64; SIZES]);

impl LatenessCounts {
    pub fn new(tick: Micros) -> Self {
        Self { sizes: std::array::from_fn(|_| AtomicU64::new(0)), late: AtomicU64::new(0), tick }
    }

    /// Records that the Timer thread served an expiry this much after its instant. Only the Timer thread calls this.
    pub fn note(&self, by: Micros) {
        // Only one thread writes, so no increment is lost between the load and the store.
        let add = |count: &AtomicU64| count.store(count.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
        add(&self.sizes[size(by)]);
        if by > self.tick {
            add(&self.late);
        }
    }

    /// The counts since the start, and how the latenesses since `seen` are distributed.
    pub fn since(&self, seen: &mut Seen) -> Lateness {
        let now: [u64; SIZES] = std::array::from_fn(|n| self.sizes[n].load(Ordering::Relaxed));
        let new: [u64; SIZES] = std::array::from_fn(|n| now[n] - seen.0[n]);
        seen.0 = now;
        let all: u64 = new.iter().sum();
        // The upper end of the counter's range in which this percentile lies.
        let within = |share: u64| {
            let wanted = (all * share).div_ceil(100).max(1);
            let mut sum = 0;
            let place = new.iter().position(|count| {
                sum += count;
                sum >= wanted
            });
            place.map_or(0, |n| (1 << n) - 1)
        };
        Lateness {
            count: now.iter().sum(),
            late: self.late.load(Ordering::Relaxed),
            p50_us: within(50),
            p99_us: within(99),
            max_us: within(100),
        }
    }
}

fn size(by: Micros) -> usize {
    let digits = u64::BITS - by.leading_zeros();
    (digits as usize).min(SIZES - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lateness_is_counted_and_its_ranges_end_no_earlier_than_the_truth() {
        let (counts, mut seen) = (LatenessCounts::new(1_000), Seen::default());
        assert_eq!(counts.since(&mut seen), Lateness::default());
        (0..99).for_each(|_| counts.note(60));
        counts.note(3_000);
        let first = counts.since(&mut seen);
        assert_eq!(first, Lateness { count: 100, late: 1, p50_us: 63, p99_us: 63, max_us: 4_095 });
        counts.note(0);
        let second = counts.since(&mut seen);
        assert_eq!(second, Lateness { count: 101, late: 1, p50_us: 0, p99_us: 0, max_us: 0 });
        counts.note(u64::MAX);
        assert_eq!(counts.since(&mut seen).late, 2, "the last range has no end");
    }
}
