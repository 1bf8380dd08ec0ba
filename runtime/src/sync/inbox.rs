//! Input left for the next thread that runs a communication task: stored without that task's lock, taken in the same order.

use crate::sync::{AtomicUsize, Mutex, Ordering, lock};
/// This is the standard atomic, which no explorer explores, because the flag is only a hint.
use std::sync::atomic::AtomicBool;

/// How many inputs fit into an inbox. Once it is full, a thread that brings more waits for the lock.
const ROOM: usize = 64;

/// How many inputs at most wait for a running thread: it works them off whatever it enters for (D130).
const FOR_A_RUNNER: usize = 32;

/// An inbox has cache lines of its own, because both ends write to it.
#[repr(align(64))]
pub(crate) struct Inbox<I> {
    inputs: Mutex<Vec<I>>,
    /// How many inputs there are, readable without the lock.
    count: AtomicUsize,
    /// Whether the task's thread has entered since a thread last found no room for a runner.
    comes_in: AtomicBool,
    /// The room, and whether a thread found none.
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

    /// An empty vector for the inputs that [`take`](Self::take) takes.
    pub fn spare() -> Vec<I> {
        Vec::with_capacity(ROOM)
    }

    /// Puts input into the inbox, or returns it if there is no room.
    pub fn leave(&self, input: I) -> Result<(), I> {
        self.leave_up_to(ROOM, input)
    }

    /// As [`leave`](Self::leave), for a running thread that keeps entering: at most as much as it may have to work off.
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

    /// Whether the inbox is empty. The load is relaxed: a caller that must not miss what `leave` stored fences before.
    pub fn is_empty(&self) -> bool {
        self.count.load(Ordering::Relaxed) == 0
    }

    /// Whether the inbox is at least half full.
    pub fn is_half_full(&self) -> bool {
        self.count.load(Ordering::Relaxed) >= ROOM / 2
    }

    /// Swaps the inputs with the vector `empty`.
    pub fn take(&self, empty: &mut Vec<I>) {
        let mut inputs = lock(&self.inputs);
        std::mem::swap(&mut *inputs, empty);
        self.count.store(0, Ordering::Relaxed);
    }

    /// Notes that the task's thread has entered, and so takes all inputs that are there.
    pub fn come_in(&self) {
        // The flag is written only if it changes, because other threads read its cache line.
        if !self.comes_in.load(Ordering::Relaxed) {
            self.comes_in.store(true, Ordering::Relaxed);
        }
    }
}
