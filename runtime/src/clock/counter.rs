//! Reads `CLOCK_BOOTTIME` through the processor's counter, where the kernel itself keeps time by that counter.
//!
//! A thread takes a reading of both clocks, an [`Anchor`]. For the next [`AGE`] it derives the time from the counter
//! alone. The result is a pair of bounds. The earlier bound decides whether a deadline has passed, and a request is
//! stamped with the later one. So neither an error of the rate nor the order of two readings ends anything early. If
//! a new anchor lies outside of the bounds of the anchor before it, this process stops using the counter. A suspend
//! has the same effect, because only the kernel's clocks know how long it was (D197).

use std::cell::Cell;
use std::sync::atomic::{AtomicU64, Ordering};

/// For how long (ns) a thread uses an anchor.
const AGE: u64 = 250_000;
/// The rate is known once the process has two readings that are this far (ns) apart.
const BASE: u64 = 20_000_000;
/// A reading of both clocks counts only if it took at most this long (ns).
const BRIEF: u64 = 2_000;
/// The bounds diverge by this share of the time since the anchor, to either side: 1/1024, or 977 in a million. The
/// kernel adjusts its clocks by at most 500 in a million. The rate is wrong by at most [`BRIEF`] / [`BASE`] to either
/// side, which is 200 in a million.
const SHARE: u64 = 1_024;
/// The two bounds of a time lie this much further apart (ns). A processor may read its counter before it has executed
/// the instructions in front of the reading.
const SLACK: u64 = 100;
/// The number of bits behind the binary point of a rate.
const POINT: u32 = 32;
/// The rate of a counter that this process does not use, or has stopped using.
const NEVER: u64 = u64::MAX;

/// The kernel's clock and the processor's counter.
pub(super) trait Clocks {
    /// `CLOCK_BOOTTIME`, in nanoseconds.
    fn kernel(&self) -> u64;
    /// The processor's counter.
    fn count(&self) -> u64;
}

/// One reading of the kernel's clock, between two of the counter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Anchor {
    kernel: u64,
    before: u64,
    after: u64,
    /// How many counts of the counter the thread may use this anchor for; 0 means not at all.
    lasts: u64,
}

/// The earliest and the latest possible value of the current time, in nanoseconds of the kernel's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Between {
    pub earliest: u64,
    pub latest: u64,
}

/// Converts a number of counts to nanoseconds.
fn nanos(counts: u64, rate: u64) -> u64 {
    u64::try_from((u128::from(counts) * u128::from(rate)) >> POINT).unwrap_or(u64::MAX)
}

impl Anchor {
    /// An anchor without a reading.
    pub const NONE: Self = Self { kernel: 0, before: 0, after: 0, lasts: 0 };

    /// An anchor that has not expired.
    #[cfg(test)]
    pub const fn in_use() -> Self {
        Self { lasts: 1, ..Self::NONE }
    }

    /// The anchor of a thread that did not notice a suspend: the counter stopped for `nanos` meanwhile.
    #[cfg(test)]
    pub fn as_before(nanos: u64, clocks: &impl Clocks) -> Self {
        let count = clocks.count();
        Self { kernel: clocks.kernel() - nanos, before: count, after: count, lasts: u64::MAX / 2 }
    }

    fn take(clocks: &impl Clocks) -> Self {
        let before = clocks.count();
        let kernel = clocks.kernel();
        Self { kernel, before, after: clocks.count(), lasts: 0 }
    }

    /// The bounds of the time when the counter reads `count`.
    fn at(&self, count: u64, rate: u64) -> Between {
        let least = nanos(count.saturating_sub(self.after), rate);
        let most = nanos(count.saturating_sub(self.before), rate);
        Between {
            earliest: self.kernel.saturating_add((least - least / SHARE).saturating_sub(SLACK)),
            latest: self.kernel.saturating_add(most).saturating_add(most / SHARE + SLACK),
        }
    }

    fn took(&self, rate: u64) -> u64 {
        nanos(self.after.saturating_sub(self.before), rate)
    }
}

/// A process's measurements of its counter.
pub(super) struct Counter {
    /// Nanoseconds for each count, with [`POINT`] bits behind the binary point; 0 while the rate is not known.
    rate: AtomicU64,
    first: Anchor,
}

impl Counter {
    /// A counter whose rate is measured from now on, if it is `usable`.
    pub fn new(clocks: &impl Clocks, usable: bool) -> Self {
        Self {
            rate: AtomicU64::new(if usable { 0 } else { NEVER }),
            first: (0..8)
                .map(|_| Anchor::take(clocks))
                .min_by_key(|anchor| anchor.after.wrapping_sub(anchor.before))
                .unwrap_or_default(),
        }
    }

    /// Whether time is derived from the counter, or will be as soon as its rate is known.
    pub fn is_trusted(&self) -> bool {
        self.rate.load(Ordering::Relaxed) != NEVER
    }

    /// Whether the rate is known and the anchor has not expired.
    #[cfg(test)]
    pub fn is_in_use(&self, anchor: &Cell<Anchor>) -> bool {
        self.rate.load(Ordering::Relaxed) != 0 && anchor.get().lasts != 0
    }

    /// The bounds of the current time, derived from the calling thread's anchor or from a new one.
    #[inline]
    pub fn read(&self, clocks: &impl Clocks, anchor: &Cell<Anchor>) -> Between {
        let (rate, known) = (self.rate.load(Ordering::Relaxed), anchor.get());
        if rate != NEVER {
            let count = clocks.count();
            // If the counter has gone back since the anchor, the difference wraps around and is greater than `lasts`.
            if count.wrapping_sub(known.after) < known.lasts {
                return known.at(count, rate);
            }
        }
        self.anew(clocks, anchor)
    }

    /// Reads the time from the kernel, and makes an anchor for the next readings.
    #[cold]
    fn anew(&self, clocks: &impl Clocks, anchor: &Cell<Anchor>) -> Between {
        let rate = self.rate.load(Ordering::Relaxed);
        if rate == NEVER {
            let now = clocks.kernel();
            return Between { earliest: now, latest: now };
        }
        let (known, mut new) = (anchor.get(), Anchor::take(clocks));
        let now = Between { earliest: new.kernel, latest: new.kernel };
        if rate == 0 {
            self.measure(&new);
            return now;
        }
        let parted = known.kernel != 0
            && (new.kernel < known.at(new.before, rate).earliest
                || new.kernel > known.at(new.after, rate).latest
                || new.before < known.after);
        if parted {
            self.rate.store(NEVER, Ordering::Relaxed);
            return now;
        }
        if new.took(rate) <= BRIEF {
            new.lasts = u64::try_from((u128::from(AGE) << POINT) / u128::from(rate)).unwrap_or_default();
        }
        anchor.set(new);
        now
    }

    /// Computes the rate from the process's first reading and this one, if both were brief and are far enough apart
    /// in time.
    fn measure(&self, new: &Anchor) {
        let (length, counts) =
            (new.kernel.saturating_sub(self.first.kernel), new.after.saturating_sub(self.first.after));
        if length < BASE || counts == 0 {
            return;
        }
        let rate = u64::try_from((u128::from(length) << POINT) / u128::from(counts)).unwrap_or(NEVER);
        if rate == 0 || self.first.took(rate) > BRIEF {
            // Either the process was stopped during its first reading, or the counter does not count.
            self.rate.store(NEVER, Ordering::Relaxed);
        } else if new.took(rate) <= BRIEF {
            // Another thread may have stored its rate first. Its rate stays, because all anchors of a process must
            // use one rate.
            let _ = self.rate.compare_exchange(0, rate, Ordering::Relaxed, Ordering::Relaxed);
        }
    }
}

/// Makes the thread's next reading take a new anchor, because the thread is about to sleep.
pub(super) fn renew(anchor: &Cell<Anchor>) {
    anchor.set(Anchor { lasts: 0, ..anchor.get() });
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;

    /// Clocks that the test sets: a true time, and a counter of 2.6 GHz that the test may make wrong.
    struct Given {
        now: Cell<u64>,
        counted: Cell<u64>,
        per_mille: Cell<u64>,
        taken: RefCell<u64>,
    }

    impl Given {
        fn new() -> Self {
            let (now, counted) = (Cell::new(1_000_000_000), Cell::new(77_000_000));
            Self { now, counted, per_mille: Cell::new(2_600), taken: RefCell::new(0) }
        }

        fn pass(&self, nanos: u64) {
            self.now.set(self.now.get() + nanos);
            self.counted.set(self.counted.get() + nanos * self.per_mille.get() / 1_000);
        }

        /// A counter whose rate is known.
        fn counter(&self) -> Counter {
            let counter = Counter::new(self, true);
            self.pass(BASE);
            counter.read(self, &Cell::default());
            assert_ne!(counter.rate.load(Ordering::Relaxed), 0, "the rate is known");
            counter
        }
    }

    impl Clocks for Given {
        fn kernel(&self) -> u64 {
            *self.taken.borrow_mut() += 1;
            self.now.get()
        }
        fn count(&self) -> u64 {
            self.counted.get()
        }
    }

    /// Reads the time every 10 us for 10 ms. Returns by how many ns a reading was early at most, and how often the
    /// kernel's clock was read.
    fn readings(given: &Given, counter: &Counter, anchor: &Cell<Anchor>) -> (u64, u64) {
        let (mut early, asked) = (0, *given.taken.borrow());
        for _ in 0..1_000 {
            given.pass(10_000);
            let found = counter.read(given, anchor);
            assert!(found.earliest <= found.latest);
            early = early.max(found.earliest.saturating_sub(given.now.get()));
            early = early.max(given.now.get().saturating_sub(found.latest));
        }
        (early, *given.taken.borrow() - asked)
    }

    #[test]
    fn a_good_counter_saves_the_kernel_and_nothing_is_early() {
        let given = Given::new();
        let (counter, anchor) = (given.counter(), Cell::default());
        let (early, asked) = readings(&given, &counter, &anchor);
        assert_eq!(early, 0);
        assert!(
            counter.is_trusted() && asked <= 1_000 / (AGE / 10_000 - 1),
            "the kernel was asked {asked} times"
        );
    }

    #[test]
    fn what_the_kernel_may_adjust_makes_nothing_early_and_keeps_the_trust() {
        for per_mille in [2_599, 2_601] {
            let given = Given::new();
            let (counter, anchor) = (given.counter(), Cell::default());
            given.per_mille.set(per_mille);
            assert_eq!(readings(&given, &counter, &anchor).0, 0, "{per_mille}");
            assert!(counter.is_trusted(), "{per_mille}");
        }
    }

    #[test]
    fn a_counter_that_parts_from_the_kernel_is_not_used_after_one_anchor() {
        for (per_mille, most) in [(2_700, AGE / 20), (5_200, AGE), (2_500, AGE / 20), (1_300, 2 * AGE)] {
            let given = Given::new();
            let (counter, anchor) = (given.counter(), Cell::default());
            given.per_mille.set(per_mille);
            let (early, _) = readings(&given, &counter, &anchor);
            assert!(early <= most, "{per_mille}: {early} ns");
            assert!(!counter.is_trusted(), "{per_mille}");
            assert_eq!(readings(&given, &counter, &anchor).0, 0, "{per_mille}: by the kernel from now on");
        }
    }

    #[test]
    fn a_jump_ends_the_trust_and_a_long_one_is_not_even_read() {
        for jump in [-5_000_000_i64, 5_000_000] {
            let given = Given::new();
            let (counter, anchor) = (given.counter(), Cell::default());
            counter.read(&given, &anchor);
            given.pass(1_000);
            given.counted.set(given.counted.get().saturating_add_signed(jump));
            assert_eq!(counter.read(&given, &anchor).earliest, given.now.get(), "{jump}: the kernel says it");
            assert!(!counter.is_trusted(), "{jump}");
        }
    }

    #[test]
    fn a_suspend_is_left_to_the_kernel() {
        let given = Given::new();
        let (counter, anchor) = (given.counter(), Cell::default());
        counter.read(&given, &anchor);
        renew(&anchor);
        // An hour passes by the kernel's clock, while the counter does not count.
        given.now.set(given.now.get() + 3_600_000_000_000);
        assert_eq!(counter.read(&given, &anchor).earliest, given.now.get());
        assert!(!counter.is_trusted());
    }

    #[test]
    fn a_thread_that_slept_asks_the_kernel_first() {
        let given = Given::new();
        let (counter, anchor) = (given.counter(), Cell::default());
        counter.read(&given, &anchor);
        given.pass(5_000);
        assert!(
            counter.read(&given, &anchor).earliest < given.now.get(),
            "by the counter: the earlier bound"
        );
        renew(&anchor);
        assert_eq!(counter.read(&given, &anchor).earliest, given.now.get());
        assert!(counter.is_trusted());
    }

    #[test]
    fn a_counter_that_is_not_usable_is_never_read_for_the_time() {
        let given = Given::new();
        let (counter, anchor) = (Counter::new(&given, false), Cell::default());
        given.pass(2 * BASE);
        let (early, asked) = readings(&given, &counter, &anchor);
        assert_eq!((early, asked, counter.is_trusted()), (0, 1_000, false));
    }
}
