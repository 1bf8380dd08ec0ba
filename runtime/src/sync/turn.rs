//! One at a time, and nobody waits: who wants work done says so and takes its turn; who finds another one at it leaves
//! the work to that one, who looks again before it leaves.

use crate::sync::plant::{Plants, Sound};
use crate::sync::{AtomicBool, Mutex, MutexGuard, Ordering, fence, lock, try_lock};

pub(crate) struct Turn<T, P = Sound> {
    wanted: AtomicBool,
    inside: Mutex<T>,
    plant: P,
}

/// The bugs that the explorers must find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plant {
    /// The one at work does not look again.
    LeavesBlindly,
    /// Nothing orders the wish and the lock.
    NoFence,
}

impl<T> Turn<T> {
    pub fn new(inside: T) -> Self {
        Self::planted(inside, Sound)
    }
}

impl<T, P: Plants<Plant>> Turn<T, P> {
    /// As [`new`](Turn::new), with a bug.
    pub fn planted(inside: T, plant: P) -> Self {
        Self { wanted: AtomicBool::new(false), inside: Mutex::new(inside), plant }
    }

    /// Says that there is work. What it is was written before.
    pub fn want(&self) {
        // A swap, not a store: it comes after the last one of the other in the order of this flag.
        self.wanted.swap(true, Ordering::AcqRel);
    }

    /// The turn itself, unless another thread has it. Who lets go of it [takes](Self::take) one after that: what was wanted
    /// meanwhile was left to it.
    pub fn enter(&self) -> Option<MutexGuard<'_, T>> {
        try_lock(&self.inside)
    }

    /// Works until no work is wanted, unless another thread is at it.
    pub fn take(&self, mut work: impl FnMut(&mut T)) {
        loop {
            // Between the wish and the lock here, between the lock and the wish after letting go: one of two threads
            // sees the other.
            self.fence();
            if !self.wanted.load(Ordering::Relaxed) {
                return;
            }
            let Some(mut inside) = try_lock(&self.inside) else { return };
            while self.wanted.swap(false, Ordering::AcqRel) {
                work(&mut inside);
            }
            drop(inside);
            if self.plant.has(Plant::LeavesBlindly) {
                return;
            }
        }
    }

    /// As [`take`](Self::take), but first waits until no other thread has the turn. Who does so holds nothing that the other one
    /// may want.
    pub fn take_after(&self, work: impl FnMut(&mut T)) {
        drop(lock(&self.inside));
        self.take(work);
    }

    fn fence(&self) {
        if !self.plant.has(Plant::NoFence) {
            fence(Ordering::SeqCst);
        }
    }
}
