//! What this node measures of the datagrams of one neighbour: how long they took, and how many were damaged (D205). All of it is
//! in fixed memory.

use super::delay::{DRIFT_PPM, Hop};
use super::integrity::{IntegrityWatch, Progress};
use crate::histogram::{Counts, Histogram};
use crate::lock::lock;
use imrs_protocol::{NodeId, Ticks};
use imrs_wire::obs::{Delays, LinkReport};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// The least length of the *recent* time of a report, in microseconds. If reports are read often, it is at most twice
/// this.
const RECENT: u64 = 5_000_000;
/// A datagram is measured only if the clocks cannot have drifted by more than this part of the link's bound since the
/// last exchange.
const DRIFT_PART: u64 = 8;

/// The measurements of one direction of a link. Times are of this node's clock, in microseconds.
#[derive(Debug)]
pub(super) struct Health {
    delays: Histogram,
    late: AtomicU64,
    unmeasured: AtomicU64,
    /// When this node last sent the neighbour a datagram. The neighbour's next datagram echoes this instant.
    sent_at: AtomicU64,
    /// For how long after `sent_at` the neighbour's datagrams are measured. After that the clocks may have drifted
    /// too far apart.
    fresh_for: u64,
    declared: Ticks,
    marks: Mutex<Marks>,
    integrity: Mutex<IntegrityWatch>,
}

/// The counters at two earlier moments. The recent time began at the older one.
#[derive(Debug, Default)]
struct Marks {
    older: Mark,
    newer: Mark,
}

#[derive(Clone, Copy, Debug, Default)]
struct Mark {
    at: u64,
    counts: Counts,
    late: u64,
}

impl Health {
    /// The state in which nothing was measured yet. `declared` is the bound of the link.
    pub(super) fn new(declared: Ticks) -> Self {
        Self {
            delays: Histogram::default(),
            late: AtomicU64::new(0),
            unmeasured: AtomicU64::new(0),
            sent_at: AtomicU64::new(0),
            fresh_for: (declared.0 / DRIFT_PART).saturating_mul(1_000_000 / DRIFT_PPM),
            declared,
            marks: Mutex::default(),
            integrity: Mutex::default(),
        }
    }

    /// Notes that a datagram leaves for the neighbour.
    pub(super) fn sends(&self, at: u64) {
        self.sent_at.store(at, Ordering::Relaxed);
    }

    /// Adds the measured hop of an accepted datagram. Only one thread at a time calls this.
    pub(super) fn arrived(&self, hop: &Hop, at: u64) {
        let since = at.saturating_sub(self.sent_at.load(Ordering::Relaxed));
        // Only one thread writes, so no increment is lost between the load and the store.
        let add = |count: &AtomicU64| count.store(count.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
        if !hop.is_proven || since > self.fresh_for {
            return add(&self.unmeasured);
        }
        self.delays.note(hop.longest.0);
        if hop.shortest > self.declared {
            add(&self.late);
        }
    }

    /// Notes a damaged datagram from the neighbour's address.
    pub(super) fn failed(&self, at: u64, progress: Progress) {
        lock(&self.integrity).failed(at, progress);
    }

    /// What was measured until `now`.
    pub(super) fn report(&self, peer: NodeId, now: u64, progress: Progress) -> LinkReport {
        let present = Mark { at: now, counts: self.delays.counts(), late: self.late.load(Ordering::Relaxed) };
        let mut marks = lock(&self.marks);
        if now.saturating_sub(marks.newer.at) >= RECENT {
            marks.older = std::mem::replace(&mut marks.newer, present);
        }
        LinkReport {
            peer,
            delay: present.since(&Mark::default()),
            recent: present.since(&marks.older),
            recent_us: now.saturating_sub(marks.older.at),
            unmeasured: self.unmeasured.load(Ordering::Relaxed),
            integrity: lock(&self.integrity).report(now, progress),
            has_stopped: false,
        }
    }
}

impl Mark {
    fn since(&self, earlier: &Self) -> Delays {
        let counts = self.counts.since(&earlier.counts);
        Delays {
            count: counts.total(),
            late: self.late.saturating_sub(earlier.late),
            p50_us: counts.percentile(50),
            p99_us: counts.percentile(99),
            max_us: counts.percentile(100),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUND: Ticks = Ticks(2_000);

    fn hop(longest: u64, shortest: u64) -> Hop {
        Hop { longest: Ticks(longest), shortest: Ticks(shortest), is_proven: true }
    }

    fn report(health: &Health, now: u64) -> LinkReport {
        health.report(NodeId(1), now, Progress::default())
    }

    #[test]
    fn a_datagram_is_measured_if_an_exchange_bounds_it_closely() {
        let health = Health::new(BOUND);
        health.sends(1_000_000);
        health.arrived(&hop(300, 0), 1_000_300);
        health.arrived(&Hop { is_proven: false, ..hop(300, 0) }, 1_000_300);
        // In 625 ms the clocks drift apart by 250 us, an eighth of the bound.
        health.arrived(&hop(500, 0), 1_625_000);
        health.arrived(&hop(500, 0), 1_625_001);
        let report = report(&health, 1_700_000);
        assert_eq!((report.delay.count, report.unmeasured), (2, 2));
        assert_eq!(report.delay.max_us, 500);
    }

    #[test]
    fn late_is_what_was_certainly_late() {
        let health = Health::new(BOUND);
        health.sends(5_000);
        for shortest in [0, 2_000, 2_001] {
            health.arrived(&hop(9_000, shortest), 6_000);
        }
        assert_eq!(
            report(&health, 7_000).delay,
            Delays { count: 3, late: 1, p50_us: 9_000, p99_us: 9_000, max_us: 9_000 }
        );
    }

    #[test]
    fn recent_leaves_out_what_is_long_ago() {
        let health = Health::new(BOUND);
        health.sends(1_000);
        health.arrived(&hop(1_900, 2_001), 1_100);
        assert_eq!(report(&health, 1_200).recent.count, 1, "since the start");
        for second in 1..=11 {
            report(&health, second * 1_000_000);
        }
        health.sends(11_000_000);
        health.arrived(&hop(100, 0), 11_000_100);
        let told = report(&health, 11_000_200);
        assert_eq!((told.delay.count, told.delay.late), (2, 1));
        assert_eq!((told.recent.count, told.recent.late, told.recent.max_us), (1, 0, 103));
        assert!((RECENT..=2 * RECENT).contains(&told.recent_us), "{}", told.recent_us);
    }
}
