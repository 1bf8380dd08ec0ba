//! Words on their way from one thread to another: a ring of fixed room that one fills and one empties, without a lock and
//! without waiting. What finds no room is not taken.
//!
//! A record is some slots in a row. They are filled one by one and shown together ([`Fill::publish`]), so whoever empties
//! finds whole records only.

use crate::sync::plant::{Plants, Sound};
use crate::sync::{AtomicU64, AtomicUsize, Ordering};
use std::sync::Arc;

/// Lies in a line of the cache of its own.
#[repr(align(64))]
struct Slot<const WORDS: usize>([AtomicU64; WORDS]);

/// What both ends see, in slots of so many words.
struct Lane<const WORDS: usize, P> {
    slots: Box<[Slot<WORDS>]>,
    /// How many slots were ever shown.
    filled: AtomicUsize,
    /// How many were emptied of those.
    emptied: AtomicUsize,
    plant: P,
}

/// The bugs that the explorers must find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plant {
    /// Slots are shown before they are filled.
    ShownFirst,
    /// Slots are given back before they were read.
    GivenBackFirst,
    /// Nothing orders what is shown after what is in it.
    NoRelease,
}

/// The end that fills.
pub(crate) struct Fill<const WORDS: usize, P = Sound> {
    lane: Arc<Lane<WORDS, P>>,
    /// How many slots were filled.
    at: usize,
    /// Up to which number of slots there is room without another look.
    free: usize,
}

/// The end that empties.
pub(crate) struct Drain<const WORDS: usize, P = Sound> {
    lane: Arc<Lane<WORDS, P>>,
    /// How many slots were emptied.
    at: usize,
}

/// A lane with room for so many slots, rounded up to a power of two.
pub(crate) fn lane<const WORDS: usize>(slots: usize) -> (Fill<WORDS>, Drain<WORDS>) {
    used_lane(slots, 0, Sound)
}

/// A lane through which so many slots have gone before, with a bug. The counts go around the wrap.
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
    /// Whether there is room for so many slots. `crowded` is called now and then while a good part is full.
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
        // Not all of it, so that the next look is not too late to say that it gets crowded.
        self.free = self.at.wrapping_add(room.min(quarter.max(slots)));
        room >= slots
    }

    /// Whether half of it is free.
    pub fn is_half_free(&self) -> bool {
        self.used() <= self.lane.slots.len() / 2
    }

    fn used(&self) -> usize {
        self.at.wrapping_sub(self.lane.emptied.load(Ordering::Acquire))
    }

    /// Fills the next slot, for which there is room.
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

    /// Shows what was filled.
    #[inline]
    pub fn publish(&mut self) {
        if self.lane.plant.has(Plant::NoRelease) {
            return self.lane.filled.store(self.at, Ordering::Relaxed);
        }
        self.lane.filled.store(self.at, Ordering::Release);
    }
}

impl<const WORDS: usize, P: Plants<Plant>> Drain<WORDS, P> {
    /// How far it is filled now.
    pub fn filled(&self) -> usize {
        self.lane.filled.load(Ordering::Acquire)
    }

    /// The next slot, unless it is one beyond `until`.
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

    /// Gives the slots back that were read.
    pub fn give_back(&self) {
        self.lane.emptied.store(self.at, Ordering::Release);
    }
}
