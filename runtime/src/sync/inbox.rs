//! What is left for whoever runs a communication task next: put down without its lock, and worked off in the same order.

use crate::sync::{AtomicUsize, Mutex, Ordering, lock};
/// Not what the explorers explore: it is a hint.
use std::sync::atomic::AtomicBool;

/// How many inputs wait in an inbox before who brings more waits for the lock.
const ROOM: usize = 64;

/// How many inputs at most wait for a thread that runs: what it works off, whatever it comes for (D130).
const FOR_A_RUNNER: usize = 32;

/// Both ends write to it: it stands in a line of the cache of its own.
#[repr(align(64))]
pub(crate) struct Inbox<I> {
    inputs: Mutex<Vec<I>>,
    /// How many there are, to be read without the lock.
    count: AtomicUsize,
    /// Whether the task's thread has come in since somebody found too much here.
    comes_in: AtomicBool,
    /// Room, and whether anybody found none.
    #[cfg(test)]
    pub room: (usize, AtomicBool),
}

impl<I> Inbox<I> {
    pub fn new() -> Self {
        Self {
            inputs: Mutex::new(Vec::with_capacity(ROOM)),
            count: AtomicUsize::new(0),
            comes_in: AtomicBool::new(false),
            #[cfg(test)]
            room: (ROOM, AtomicBool::new(false)),
        }
    }

    /// An empty one to [take](Self::take) into.
    pub fn spare() -> Vec<I> {
        Vec::with_capacity(ROOM)
    }

    /// Puts input down, or hands it back where there is no room.
    pub fn leave(&self, input: I) -> Result<(), I> {
        self.leave_up_to(ROOM, input)
    }

    /// As [`leave`](Self::leave), for a thread that runs and comes in; not more than it may have to work off.
    pub fn leave_to_runner(&self, input: I) -> Result<(), I> {
        if !self.comes_in.load(Ordering::Relaxed) {
            return Err(input);
        }
        let left = self.leave_up_to(FOR_A_RUNNER, input);
        if left.is_err() {
            self.comes_in.store(false, Ordering::Relaxed);
        }
        left
    }

    fn leave_up_to(&self, most: usize, input: I) -> Result<(), I> {
        let mut inputs = lock(&self.inputs);
        #[cfg(test)]
        if inputs.len() >= self.room.0 {
            self.room.1.store(true, Ordering::Relaxed);
            return Err(input);
        }
        if inputs.len() >= most {
            return Err(input);
        }
        inputs.push(input);
        self.count.store(inputs.len(), Ordering::Relaxed);
        Ok(())
    }

    /// Whether there is nothing, as far as the caller can see: see the fences of whoever asks.
    pub fn is_empty(&self) -> bool {
        self.count.load(Ordering::Relaxed) == 0
    }

    /// Whether it is on its way to being full.
    pub fn is_half_full(&self) -> bool {
        self.count.load(Ordering::Relaxed) >= ROOM / 2
    }

    /// Puts `empty` in the place of what there is.
    pub fn take(&self, empty: &mut Vec<I>) {
        let mut inputs = lock(&self.inputs);
        std::mem::swap(&mut *inputs, empty);
        self.count.store(0, Ordering::Relaxed);
    }

    /// The task's thread is here, and works off what there is.
    pub fn come_in(&self) {
        // Others read the line.
        if !self.comes_in.load(Ordering::Relaxed) {
            self.comes_in.store(true, Ordering::Relaxed);
        }
    }
}
