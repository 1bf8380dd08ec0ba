//! A combining lock, for which no thread waits: a thread sets `wanted` and tries the lock. If the lock is taken, its
//! holder does the work, because the holder rechecks `wanted` after unlocking.

use crate::sync::plant::{Plants, Sound};
use crate::sync::{AtomicBool, Mutex, MutexGuard, Ordering, fence, lock, try_lock};

pub(crate) struct CombiningLock<T, P = Sound> {
    wanted: AtomicBool,
    inside: Mutex<T>,
    plant: P,
}

/// The bugs that the explorers of schedules (loom and shuttle) must find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plant {
    /// The holder does not recheck `wanted` after unlocking.
    LeavesBlindly,
    /// No fence orders the accesses to `wanted` and to the lock.
    NoFence,
}

impl<T> CombiningLock<T> {
    pub fn new(inside: T) -> Self {
        Self::planted(inside, Sound)
    }
}

impl<T, P: Plants<Plant>> CombiningLock<T, P> {
    /// As [`new`](CombiningLock::new), with a bug planted for a test.
    pub fn planted(inside: T, plant: P) -> Self {
        Self { wanted: AtomicBool::new(false), inside: Mutex::new(inside), plant }
    }

    /// Declares that there is work for the lock's holder. The caller must have stored the work itself before.
    pub fn want(&self) {
        // This is a swap, not a store: it continues the release sequence of earlier swaps, so the swap in `take`
        // acquires the work of all of them.
        self.wanted.swap(true, Ordering::AcqRel);
    }

    /// Takes the lock, unless another thread holds it. After the caller has dropped the guard, it must call
    /// [`take`](Self::take), because other threads may have left work for it.
    pub fn enter(&self) -> Option<MutexGuard<'_, T>> {
        try_lock(&self.inside)
    }

    /// Works until no more work is wanted. If another thread holds the lock, leaves the work to that thread.
    pub fn take(&self, mut work: impl FnMut(&mut T)) {
        loop {
            // This fence pairs with the same fence in another thread: before it, `want` writes `wanted` and a holder
            // unlocks. So either this `try_lock` sees the unlock, or the holder's load sees `wanted`.
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

    /// As [`take`](Self::take), but first waits until no other thread holds the lock. The caller must hold no lock that the
    /// holder may need.
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
