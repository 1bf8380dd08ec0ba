//! Input that is left for the next thread that runs a communication task. The input is stored without the task's lock,
//! and taken in the order in which it was stored.

use crate::sync::{AtomicUsize, Mutex, Ordering, lock};
/// This is the standard library's atomic, which no explorer explores, because that flag is only a hint.
use std::sync::atomic::AtomicBool;

/// How many inputs fit into an inbox. Once the inbox is full, a thread that brings more input waits for the lock.
const ROOM: usize = 64;

/// How many inputs at most wait for a running thread, because that thread must handle all of them in its next call,
/// whatever the call is for (D130).
const FOR_A_RUNNER: usize = 32;

/// An inbox has cache lines of its own, because the thread that takes input and the threads that leave it all write to it.
#[repr(align(64))]
pub(crate) struct Inbox<I> {
    inputs: Mutex<Vec<I>>,
    /// How many inputs the inbox holds, readable without the lock.
    count: AtomicUsize,
    /// Whether the task's own thread has taken input from the inbox since `leave_to_runner` last failed for lack of room.
    comes_in: AtomicBool,
    /// The capacity of the inbox, and whether a thread has found it full.
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

    /// As [`leave`](Self::leave), for a task whose thread runs and often calls: leaves at most `FOR_A_RUNNER` inputs.
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

    /// Whether the inbox is empty. The load is relaxed: a caller that must see the last input that `leave` stored needs
    /// a fence before this call.
    pub fn is_empty(&self) -> bool {
        self.count.load(Ordering::Relaxed) == 0
    }

    /// Whether the inbox is at least half full.
    pub fn is_half_full(&self) -> bool {
        self.count.load(Ordering::Relaxed) >= ROOM / 2
    }

    /// Takes all inputs, by swapping them with the vector `empty`.
    pub fn take(&self, empty: &mut Vec<I>) {
        let mut inputs = lock(&self.inputs);
        std::mem::swap(&mut *inputs, empty);
        self.count.store(0, Ordering::Relaxed);
    }

    /// Notes that the task's own thread takes all inputs of the inbox.
    pub fn come_in(&self) {
        // The flag is written only if it changes, because other threads read its cache line.
        if !self.comes_in.load(Ordering::Relaxed) {
            self.comes_in.store(true, Ordering::Relaxed);
        }
    }
}
