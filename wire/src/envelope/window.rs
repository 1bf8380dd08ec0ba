//! Which datagrams of one life of one sender came in already.

/// How far behind the newest counter a datagram may come and still be told from a repetition.
pub const WINDOW: u64 = 1024;

const WORD: u64 = u64::BITS as u64;
const WORDS: usize = (WINDOW / WORD) as usize;

/// The last [`WINDOW`] counters of one sender (one window per peer and incarnation). Takes every counter at most once;
/// one that is too far behind to tell is not taken.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ReplayWindow {
    /// One more than the newest counter taken; zero where none was.
    next: u64,
    /// Bit `c % WINDOW` stands for counter `c`, for the `WINDOW` counters before `next`.
    seen: [u64; WORDS],
}

impl ReplayWindow {
    /// A window that has seen nothing.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Whether `counter` is new; from now on it is not.
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

    /// Whether [`accept`](Self::accept) would take `counter`.
    #[must_use]
    pub const fn is_new(&self, counter: u64) -> bool {
        counter >= self.next || !self.is_behind(counter) && !self.bit(counter)
    }

    /// Whether `counter` is so far behind the newest one that nothing is known of it any more.
    #[must_use]
    pub const fn is_behind(&self, counter: u64) -> bool {
        counter < self.next && self.next - counter > WINDOW
    }

    /// Whether `counter` is newer than all that were taken.
    #[must_use]
    pub const fn is_newest(&self, counter: u64) -> bool {
        counter >= self.next
    }

    /// Goes on from `counter`, though newer ones were taken: they were mistakes. Takes `counter`; every earlier one counts
    /// as seen.
    pub const fn resume(&mut self, counter: u64) {
        self.next = counter.saturating_add(1);
        self.seen = [u64::MAX; WORDS];
    }

    /// Makes `counter` the newest: forgets the counters that fall out of the window.
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
        // Below WORDS, so it fits any usize.
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
        /// Against the plain rule: never seen before, and not too far behind the newest.
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
