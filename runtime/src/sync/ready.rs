//! Which futures of a thread are ready to be polled: each future has a bit (D178). A waker sets the bit of its future,
//! the mark, and calls the thread; the thread takes all marks of a word at once.

use crate::sync::park::Park;
use crate::sync::plant::{Plants, Sound};
use crate::sync::{AtomicU64, Ordering};

const BITS: usize = u64::BITS as usize;

pub(crate) struct ReadyFutures<P = Sound> {
    words: Box<[Marks]>,
    /// Where the thread waits while no future is ready.
    pub park: Park,
    plant: P,
}

/// The marks of up to 64 futures.
struct Marks {
    all: AtomicU64,
    /// The marks that the thread of the futures itself made. No other thread accesses them, so they need no locked
    /// instruction.
    own: AtomicU64,
}

/// The bugs that the explorers of schedules (loom and shuttle) must find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plant {
    /// A waker calls the thread before it marks the future.
    CallsFirst,
    /// A waker that finds the mark set only reads it.
    OnlyReads,
    /// The thread reads a word and then clears it, in two steps.
    TakesInTwoSteps,
    /// The thread declares itself running only after it has taken the marks, instead of before.
    BeginsLate,
}

impl ReadyFutures {
    /// Makes `count` futures, all ready, so that each is polled once at the start.
    pub fn new(count: usize, park: Park) -> Self {
        Self::planted(count, park, Sound)
    }
}

impl<P: Plants<Plant>> ReadyFutures<P> {
    /// As [`new`](ReadyFutures::new), with a bug planted for a test.
    pub fn planted(count: usize, park: Park, plant: P) -> Self {
        let marks = |first: usize| Marks {
            all: AtomicU64::new(u64::MAX >> BITS.saturating_sub(count - first)),
            own: AtomicU64::new(0),
        };
        Self { words: (0..count).step_by(BITS).map(marks).collect(), park, plant }
    }

    /// Marks the future at `place` as ready. If the future is marked already, the waker that marked it has called the
    /// thread, or is about to.
    pub fn wake(&self, place: usize) {
        if self.plant.has(Plant::CallsFirst) {
            self.park.call();
        }
        let (word, bit) = (&self.words[place / BITS].all, 1 << (place % BITS));
        if self.plant.has(Plant::OnlyReads) && word.load(Ordering::Acquire) & bit != 0 {
            return;
        }
        // The bit is written even if it is set already, so that the thread that takes it sees all earlier writes of
        // this waker.
        let before = word.fetch_or(bit, Ordering::AcqRel);
        if before & bit == 0 && !self.plant.has(Plant::CallsFirst) {
            self.park.call();
        }
    }

    /// As [`wake`](Self::wake), but called on the thread of the futures itself. That thread runs, so it needs no
    /// wake-up.
    pub fn mark_own(&self, place: usize) {
        let word = &self.words[place / BITS].own;
        word.store(word.load(Ordering::Relaxed) | (1 << (place % BITS)), Ordering::Relaxed);
    }

    /// Polls each ready future once, by calling `poll`.
    pub fn poll_ready(&self, mut poll: impl FnMut(usize)) {
        // The thread declares itself running before it takes any marks, so that a call after it has taken a word's
        // marks keeps it from waiting.
        if !self.plant.has(Plant::BeginsLate) {
            self.park.begins();
        }
        let mut first = 0;
        for Marks { all, own } in &self.words {
            let mut ready = self.take(all) | own.load(Ordering::Relaxed);
            own.store(0, Ordering::Relaxed);
            while ready != 0 {
                poll(first + ready.trailing_zeros() as usize);
                ready &= ready - 1;
            }
            first += BITS;
        }
        if self.plant.has(Plant::BeginsLate) {
            self.park.begins();
        }
    }

    /// Whether a future is ready already, so that the thread need not try to wait.
    pub fn any(&self) -> bool {
        self.words
            .iter()
            .any(|marks| marks.own.load(Ordering::Relaxed) != 0 || marks.all.load(Ordering::Relaxed) != 0)
    }

    fn take(&self, word: &AtomicU64) -> u64 {
        if self.plant.has(Plant::TakesInTwoSteps) {
            let ready = word.load(Ordering::Acquire);
            word.store(0, Ordering::Release);
            return ready;
        }
        // The word is swapped only if it has marks. If this load misses a mark, the waker of that mark has called the
        // thread, or is about to call it, and so keeps the thread awake.
        if word.load(Ordering::Relaxed) == 0 { 0 } else { word.swap(0, Ordering::AcqRel) }
    }
}
