//! Input for the next thread that runs a communication task: a ring of slots, first in, first out (D201).
//!
//! Threads that leave input number it under a lock that only they take. The thread that holds the lock of the
//! communication task takes input without that lock: the number in a slot says which input the slot holds. So an
//! input crosses from one core to another in one cache line, and a thread that spins on the next slot sees the input
//! with that line.

use crate::sync::plant::{Plants, Sound};
use crate::sync::{AtomicU64, Line, Mutex, Ordering, lock};
/// This flag is the standard library's atomic, which loom and shuttle do not explore, because the flag is only a hint.
use std::sync::atomic::AtomicBool;

/// How many inputs fit into an inbox. Once it is full, a thread that brings another input waits for the task's lock.
#[cfg(not(test))]
pub(super) const ROOM: u64 = 64;
/// In explorations few inputs must be enough to fill the ring. loom and shuttle also make each slot anew for every
/// schedule.
#[cfg(test)]
pub(super) const ROOM: u64 = 2;

/// The most inputs that may wait for a running thread. The bound exists because that thread handles all of them in
/// its next call (D130).
const FOR_A_RUNNER: u64 = ROOM / 2;

/// An input that fits into a slot.
pub(crate) trait Slotted: Sized {
    /// The words that an input consists of.
    type Words: AsRef<[u64]> + AsMut<[u64]> + Default;
    /// As many atomics as `Words` has words.
    type Atomics: AsRef<[AtomicU64]>;

    /// The atomics of an empty slot.
    fn atomics() -> Self::Atomics;

    /// The input as words. `None` for an input that no thread ever leaves in an inbox.
    fn to_words(&self) -> Option<Self::Words>;

    /// The input that these words represent.
    fn of_words(words: &Self::Words) -> Self;
}

/// A slot of the inbox: an input in a cache line of its own.
#[repr(align(64))]
struct Slot<I: Slotted> {
    /// How many inputs had been left up to this one, itself included; zero before the first.
    number: AtomicU64,
    words: I::Atomics,
}

/// The state that the threads that leave input share.
struct Leaving {
    /// How many inputs have been left so far.
    left: u64,
    /// How many inputs had been taken when a leaving thread last loaded `Inbox::taken`.
    taken: u64,
}

/// The bugs that the explorers of schedules (loom and shuttle) must find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plant {
    /// The number of an input is written to the slot before its words.
    NumberFirst,
    /// The slot is freed before its words are read.
    TakenFirst,
    /// Input is left although there is no room.
    Overfull,
    /// An input is put into its slot only after the lock that gave it its number was released.
    OutOfTurn,
}

pub(crate) struct Inbox<I: Slotted, P = Sound> {
    slots: Box<[Slot<I>; ROOM as usize]>,
    leaving: Line<Mutex<Leaving>>,
    /// How many inputs were taken. Only a thread that holds the lock of the communication task writes it.
    taken: Line<AtomicU64>,
    /// Whether the task's thread has made a call since too many inputs last waited for it.
    comes_in: Line<AtomicBool>,
    /// For tests: how many inputs fit, and whether a thread found the inbox full.
    #[cfg(test)]
    pub room: (u64, AtomicBool),
    plant: P,
}

/// Takes input from an inbox. There is one such value, behind the lock of the communication task.
pub(crate) struct Taker {
    taken: u64,
}

impl<I: Slotted> Inbox<I> {
    /// An empty inbox, and the value that takes input from it.
    pub fn new() -> (Self, Taker) {
        Self::planted(Sound)
    }
}

impl<I: Slotted, P: Plants<Plant>> Inbox<I, P> {
    /// As [`new`](Inbox::new), with a bug planted for a test.
    pub fn planted(plant: P) -> (Self, Taker) {
        // A larger slot would take two cache lines, and each line would move to the other core by itself. In
        // explorations the atomics are larger, so this is checked only without them.
        #[cfg(not(test))]
        const {
            assert!(size_of::<Slot<I>>() == 64, "a slot is one cache line");
        };
        let slot = |_| Slot { number: AtomicU64::new(0), words: I::atomics() };
        let inbox = Self {
            slots: Box::new(std::array::from_fn(slot)),
            leaving: Line(Mutex::new(Leaving { left: 0, taken: 0 })),
            taken: Line(AtomicU64::new(0)),
            comes_in: Line(AtomicBool::new(false)),
            #[cfg(test)]
            room: (ROOM, AtomicBool::new(false)),
            plant,
        };
        (inbox, Taker { taken: 0 })
    }

    /// Puts input into the inbox, or returns the input if there is no room. Returns whether more inputs wait now than a
    /// running thread should have to handle.
    pub fn leave(&self, input: I) -> Result<bool, I> {
        #[cfg(test)]
        let room = self.room.0;
        #[cfg(not(test))]
        let room = ROOM;
        let Some(words) = input.to_words() else { return Err(input) };
        let mut leaving = lock(&self.leaving.0);
        if leaving.left - leaving.taken >= FOR_A_RUNNER {
            // The acquire pairs with the release in `take`, which has finished reading the slot's former content.
            leaving.taken = self.taken.0.load(Ordering::Acquire);
        }
        let waits = leaving.left - leaving.taken;
        if waits >= room && !self.plant.has(Plant::Overfull) {
            #[cfg(test)]
            self.room.1.store(true, Ordering::Relaxed);
            return Err(input);
        }
        let slot = self.slot(leaving.left);
        leaving.left += 1;
        let number = leaving.left;
        if self.plant.has(Plant::NumberFirst) {
            slot.number.store(number, Ordering::Release);
        }
        // Slots are filled in the order of their numbers, so that no input has to wait in the ring for an earlier one.
        let leaving = (!self.plant.has(Plant::OutOfTurn)).then_some(leaving);
        for (atomic, &word) in slot.words.as_ref().iter().zip(words.as_ref()) {
            atomic.store(word, Ordering::Relaxed);
        }
        slot.number.store(number, Ordering::Release);
        drop(leaving);
        Ok(waits >= FOR_A_RUNNER)
    }

    /// Takes the next input, if there is one.
    pub fn take(&self, taker: &mut Taker) -> Option<I> {
        let slot = self.slot(taker.taken);
        if slot.number.load(Ordering::Acquire) <= taker.taken {
            return None;
        }
        if self.plant.has(Plant::TakenFirst) {
            self.taken.0.store(taker.taken + 1, Ordering::Release);
        }
        let mut words = I::Words::default();
        for (word, atomic) in words.as_mut().iter_mut().zip(slot.words.as_ref()) {
            *word = atomic.load(Ordering::Relaxed);
        }
        taker.taken += 1;
        self.taken.0.store(taker.taken, Ordering::Release);
        Some(I::of_words(&words))
    }

    /// Whether the inbox is empty. The loads are relaxed, so a caller that must not miss a concurrent `leave` makes a
    /// fence first. A caller without the lock of the communication task may see input that another thread has taken
    /// meanwhile.
    pub fn is_empty(&self) -> bool {
        !self.holds(1)
    }

    /// Whether the inbox is at least half full.
    pub fn is_half_full(&self) -> bool {
        self.holds(ROOM / 2)
    }

    /// Whether there are at least `count` inputs.
    fn holds(&self, count: u64) -> bool {
        let last = self.taken.0.load(Ordering::Relaxed) + count;
        self.slot(last - 1).number.load(Ordering::Relaxed) >= last
    }

    fn slot(&self, before: u64) -> &Slot<I> {
        // The index is less than the length of the slice.
        &self.slots[(before % ROOM) as usize]
    }

    /// Notes that the task's own thread has made a call and takes all inputs of the inbox.
    pub fn come_in(&self) {
        self.set_entered(true);
    }

    /// Notes that too many inputs wait for the running thread of the task.
    pub fn is_too_much(&self) {
        self.set_entered(false);
    }

    /// Whether the task's thread makes calls so often that input may be left to it. This is only a hint.
    pub fn is_entered(&self) -> bool {
        self.comes_in.0.load(Ordering::Relaxed)
    }

    fn set_entered(&self, entered: bool) {
        // The flag is written only if it changes, because other threads read its cache line.
        if self.is_entered() != entered {
            self.comes_in.0.store(entered, Ordering::Relaxed);
        }
    }
}
