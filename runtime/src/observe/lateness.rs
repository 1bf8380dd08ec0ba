//! Counts how late the Timer thread begins to serve expiries. Only one thread writes the counters; its stores are
//! relaxed, and it does not read the clock for this.

use crate::clock::Micros;
use crate::histogram::{Counts, Histogram};
use imrs_wire::obs::Lateness;
use std::sync::atomic::{AtomicU64, Ordering};

/// Counters of the Timer thread's lateness, with one writer.
#[derive(Debug)]
pub(crate) struct LatenessCounts {
    latenesses: Histogram,
    late: AtomicU64,
    /// The lateness above which an expiry counts as late: the tick that the cell declares.
    tick: Micros,
}

/// The values of the counters when they were last read.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Seen(Counts);

impl LatenessCounts {
    pub fn new(tick: Micros) -> Self {
        Self { latenesses: Histogram::default(), late: AtomicU64::new(0), tick }
    }

    /// Records that the Timer thread served an expiry this much after its instant. Only the Timer thread calls this.
    pub fn note(&self, by: Micros) {
        self.latenesses.note(by);
        if by > self.tick {
            // Only one thread writes, so no increment is lost between the load and the store.
            self.late.store(self.late.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
        }
    }

    /// The counts since the start, and how the latenesses since `seen` are distributed.
    pub fn since(&self, seen: &mut Seen) -> Lateness {
        let now = self.latenesses.counts();
        let new = now.since(&seen.0);
        seen.0 = now;
        Lateness {
            count: now.total(),
            late: self.late.load(Ordering::Relaxed),
            p50_us: new.percentile(50),
            p99_us: new.percentile(99),
            max_us: new.percentile(100),
        }
    }
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
        assert_eq!(first, Lateness { count: 100, late: 1, p50_us: 61, p99_us: 61, max_us: 3_000 });
        counts.note(0);
        let second = counts.since(&mut seen);
        assert_eq!(second, Lateness { count: 101, late: 1, p50_us: 0, p99_us: 0, max_us: 0 });
        counts.note(u64::MAX);
        assert_eq!(counts.since(&mut seen).late, 2, "the last range has no end");
    }
}
