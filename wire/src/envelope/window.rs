//! A replay window: which datagrams of one incarnation of a sender have already arrived.

/// How far a datagram's counter may be behind the newest counter and still be checked for repetition.
pub const WINDOW: u64 = 1024;

const WORD: u64 = u64::BITS as u64;
const WORDS: usize = (WINDOW / WORD) as usize;

/// A replay window over the last [`WINDOW`] counters of one sender; use one per peer and session. It accepts each
/// counter at most once, and rejects a counter that is too far behind to be checked.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ReplayWindow {
    /// The newest accepted counter plus one; zero if none was accepted.
    next: u64,
    /// Bit `c % WINDOW` stands for counter `c`, for the `WINDOW` counters before `next`.
    seen: [u64; WORDS],
}

impl ReplayWindow {
    /// An empty window.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns whether `counter` is new, and marks it as seen.
    pub fn accept(&mut self, counter: u64) -> bool {
        if !self.is_new(counter) {
            return false;
        }
        if counter >= self.next {
            self.advance(counter);
        }
        self.set(counter, true);
        true
    }

    /// The counter after the newest accepted one.
    #[must_use]
    pub const fn next(&self) -> u64 {
        self.next
    }

    /// Whether [`accept`](Self::accept) would accept `counter`.
    #[must_use]
    pub const fn is_new(&self, counter: u64) -> bool {
        counter >= self.next || !self.is_behind(counter) && !self.bit(counter)
    }

    /// Whether `counter` has left the window, so that a repetition cannot be detected.
    #[must_use]
    pub const fn is_behind(&self, counter: u64) -> bool {
        counter < self.next && self.next - counter > WINDOW
    }

    /// Whether `counter` is newer than every accepted one.
    #[must_use]
    pub const fn is_newest(&self, counter: u64) -> bool {
        counter >= self.next
    }

    /// Accepts `counter` and continues from it, although the window accepted newer counters, because those were wrong.
    /// Every earlier counter counts as seen.
    pub const fn resume(&mut self, counter: u64) {
        self.next = counter.saturating_add(1);
        self.seen = [u64::MAX; WORDS];
    }

    /// Makes `counter` the newest counter, and forgets the counters that leave the window.
    fn advance(&mut self, counter: u64) {
        if counter - self.next >= WINDOW {
            self.seen = [0; WORDS];
        } else {
            for skipped in self.next..counter {
                self.set(skipped, false);
            }
        }
        self.next = counter.saturating_add(1);
    }

    const fn bit(&self, counter: u64) -> bool {
        let (word, mask) = Self::place(counter);
        self.seen[word] & mask != 0
    }

    fn set(&mut self, counter: u64, value: bool) {
        let (word, mask) = Self::place(counter);
        if value {
            self.seen[word] |= mask;
        } else {
            self.seen[word] &= !mask;
        }
    }

    const fn place(counter: u64) -> (usize, u64) {
        let bit = counter % WINDOW;
        // The index is below WORDS, so it fits into any usize.
        ((bit / WORD) as usize, 1 << (bit % WORD))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::HashSet;

    #[test]
    fn takes_each_counter_once_in_any_order() {
        let mut w = ReplayWindow::new();
        assert!(w.accept(5) && w.accept(3) && w.accept(4) && w.accept(0));
        assert!(!w.accept(5) && !w.accept(3) && !w.accept(0));
        assert!(w.accept(1) && w.accept(2) && w.accept(6));
    }

    #[test]
    fn ends_exactly_where_it_says() {
        let mut w = ReplayWindow::new();
        assert!(w.accept(10_000));
        assert!(w.accept(10_000 - (WINDOW - 1)), "the oldest counter that can be told");
        assert!(!w.accept(10_000 - WINDOW), "one further back cannot");
        assert!(w.accept(10_000 + WINDOW - 1));
        assert!(!w.accept(10_000), "still remembered at the far end");
        assert!(w.accept(10_001));
        assert!(w.accept(10_000 + WINDOW));
        assert!(!w.accept(10_000), "out of the window");
    }

    #[test]
    fn going_on_from_an_earlier_counter_takes_no_counter_twice() {
        let mut w = ReplayWindow::new();
        assert!(w.accept(7) && w.accept(1_000_000));
        assert!(w.is_behind(8) && !w.is_new(8) && !w.is_behind(1_000_000));
        w.resume(8);
        assert!((0..=8).all(|counter| !w.is_new(counter)), "all before count as seen");
        assert!(w.accept(9) && !w.accept(9) && w.accept(1_500));
        w.resume(0);
        assert!(!w.accept(0) && w.accept(1));
    }

    #[test]
    fn the_ends_of_the_range_do_not_panic() {
        let mut w = ReplayWindow::new();
        assert!(w.accept(0) && w.accept(u64::MAX - 1));
        assert!(!w.accept(0) && !w.accept(u64::MAX - 1));
        w.accept(u64::MAX);
        w.accept(u64::MAX);
    }

    proptest! {
        /// The window behaves as the plain rule: a counter is accepted if it is unseen and not too far behind the
        /// newest counter.
        #[test]
        fn behaves_as_an_unbounded_memory_would(
            steps in proptest::collection::vec((0..3000_u64, any::<bool>()), 1..400), start in 0..1_u64 << 55,
        ) {
            let (mut w, mut seen, mut newest) = (ReplayWindow::new(), HashSet::new(), None);
            for (distance, back) in steps {
                let at = newest.unwrap_or(start);
                let counter = if back { u64::saturating_sub(at, distance) } else { at + distance % 700 };
                let fresh = newest.is_none_or(|n| n < counter + WINDOW) && seen.insert(counter);
                prop_assert_eq!(w.accept(counter), fresh);
                newest = newest.max(Some(counter));
            }
        }
    }
}
