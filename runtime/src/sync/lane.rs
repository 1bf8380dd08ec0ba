//! A ring of fixed size for one producer and one consumer, without locks and without waiting. If there is no room for
//! a record, the ring does not take it.
//!
//! A record consists of one or more slots in a row. The producer fills the slots one by one and publishes them together
//! ([`Fill::publish`]), so the consumer finds only whole records.

use crate::sync::plant::{Plants, Sound};
use crate::sync::{AtomicU64, AtomicUsize, Ordering};
use std::sync::Arc;

/// A slot in a cache line of its own.
#[repr(align(64))]
struct Slot<const WORDS: usize>([AtomicU64; WORDS]);

/// The state that producer and consumer share, in slots of `WORDS` words.
struct Lane<const WORDS: usize, P> {
    slots: Box<[Slot<WORDS>]>,
    /// How many slots the producer has ever published.
    filled: AtomicUsize,
    /// How many slots the consumer has given back.
    emptied: AtomicUsize,
    plant: P,
}

/// The bugs that the explorers of schedules (loom and shuttle) must find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plant {
    /// The producer publishes slots before it fills them.
    ShownFirst,
    /// The consumer gives slots back before it reads them.
    GivenBackFirst,
    /// The store to `filled` has no release ordering after the words in the slots.
    NoRelease,
}

/// The producer's end of a lane.
pub(crate) struct Fill<const WORDS: usize, P = Sound> {
    lane: Arc<Lane<WORDS, P>>,
    /// How many slots the producer has filled.
    at: usize,
    /// Slots up to this number are known to be free, without loading `emptied` again.
    free: usize,
}

/// The consumer's end of a lane.
pub(crate) struct Drain<const WORDS: usize, P = Sound> {
    lane: Arc<Lane<WORDS, P>>,
    /// How many slots the consumer has emptied.
    at: usize,
}

/// A lane with room for at least `slots` slots, rounded up to a power of two.
pub(crate) fn lane<const WORDS: usize>(slots: usize) -> (Fill<WORDS>, Drain<WORDS>) {
    used_lane(slots, 0, Sound)
}

/// A lane whose counters begin at `at`, as if so many slots had been used before. `plant` is a planted bug, or none. The
/// counters wrap around.
pub(crate) fn used_lane<const WORDS: usize, P>(
    slots: usize,
    at: usize,
    plant: P,
) -> (Fill<WORDS, P>, Drain<WORDS, P>) {
    let slot = |_| Slot(std::array::from_fn(|_| AtomicU64::new(0)));
    let lane = Arc::new(Lane {
        slots: (0..slots.next_power_of_two()).map(slot).collect(),
        filled: AtomicUsize::new(at),
        emptied: AtomicUsize::new(at),
        plant,
    });
    (Fill { lane: Arc::clone(&lane), at, free: at }, Drain { lane, at })
}

impl<const WORDS: usize, P> Lane<WORDS, P> {
    fn slot(&self, at: usize) -> &[AtomicU64; WORDS] {
        &self.slots[at & (self.slots.len() - 1)].0
    }
}

impl<const WORDS: usize, P: Plants<Plant>> Fill<WORDS, P> {
    /// Whether there is room for this many slots. At times calls `crowded`, if at least a quarter of the lane is
    /// used.
    #[inline]
    pub fn has_room(&mut self, slots: usize, crowded: impl FnOnce()) -> bool {
        self.free.wrapping_sub(self.at) >= slots || self.look(slots, crowded)
    }

    #[cold]
    fn look(&mut self, slots: usize, crowded: impl FnOnce()) -> bool {
        let (used, quarter) = (self.used(), self.lane.slots.len() / 4);
        if used >= quarter.max(1) {
            crowded();
        }
        let room = self.lane.slots.len() - used;
        // `free` counts only a part of the free slots, so that `emptied` is loaded again soon enough to report
        // crowding.
        self.free = self.at.wrapping_add(room.min(quarter.max(slots)));
        room >= slots
    }

    /// Whether half of the lane is free.
    pub fn is_half_free(&self) -> bool {
        self.used() <= self.lane.slots.len() / 2
    }

    fn used(&self) -> usize {
        self.at.wrapping_sub(self.lane.emptied.load(Ordering::Acquire))
    }

    /// Fills the next slot. The caller has made sure that there is room.
    #[inline]
    pub fn put(&mut self, words: [u64; WORDS]) {
        if self.lane.plant.has(Plant::ShownFirst) {
            self.lane.filled.store(self.at.wrapping_add(1), Ordering::Release);
        }
        for (word, value) in self.lane.slot(self.at).iter().zip(words) {
            word.store(value, Ordering::Relaxed);
        }
        self.at = self.at.wrapping_add(1);
    }

    /// Publishes the filled slots. The release pairs with the acquire in [`Drain::filled`].
    #[inline]
    pub fn publish(&mut self) {
        if self.lane.plant.has(Plant::NoRelease) {
            return self.lane.filled.store(self.at, Ordering::Relaxed);
        }
        self.lane.filled.store(self.at, Ordering::Release);
    }
}

impl<const WORDS: usize, P: Plants<Plant>> Drain<WORDS, P> {
    /// How many slots are published now. The acquire pairs with the release in [`Fill::publish`].
    pub fn filled(&self) -> usize {
        self.lane.filled.load(Ordering::Acquire)
    }

    /// Reads the next slot; `None` if it is the slot `until`.
    pub fn next(&mut self, until: usize) -> Option<[u64; WORDS]> {
        if self.at == until {
            return None;
        }
        if self.lane.plant.has(Plant::GivenBackFirst) {
            self.lane.emptied.store(self.at.wrapping_add(1), Ordering::Release);
        }
        let slot = self.lane.slot(self.at);
        let words = std::array::from_fn(|word| slot[word].load(Ordering::Relaxed));
        self.at = self.at.wrapping_add(1);
        Some(words)
    }

    /// Gives back the slots that the consumer has read. The release pairs with the acquire in `Fill::used`.
    pub fn give_back(&self) {
        self.lane.emptied.store(self.at, Ordering::Release);
    }
}
