//! One at a time, and nobody waits: who wants work done says so and takes its turn; who finds another one at it leaves
//! the work to that one, who looks again before it leaves.

use crate::sync::{AtomicBool, Mutex, Ordering, fence, lock, try_lock};

pub(crate) struct Turn<T> {
    wanted: AtomicBool,
    inside: Mutex<T>,
    #[cfg(test)]
    pub plant: Plant,
}

/// The bugs that the explorers must find.
#[cfg(test)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plant {
    None,
    /// The one at work does not look again.
    LeavesBlindly,
    /// Nothing orders the wish and the lock.
    NoFence,
}

impl<T> Turn<T> {
    pub fn new(inside: T) -> Self {
        Self {
            wanted: AtomicBool::new(false),
            inside: Mutex::new(inside),
            #[cfg(test)]
            plant: Plant::None,
        }
    }

    /// Says that there is work. What it is was written before.
    pub fn want(&self) {
        // A swap, not a store: it comes after the last one of the other in the order of this flag.
        self.wanted.swap(true, Ordering::AcqRel);
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
            #[cfg(test)]
            if self.plant == Plant::LeavesBlindly {
                return;
            }
        }
    }

    /// Works once, unless another thread is at it in [`must`](Self::must): that one works once more before it leaves.
    /// What there was to say was said before. `None` where it was left to the other.
    pub fn once<R>(&self, work: impl FnOnce(&mut T) -> R) -> Option<R> {
        self.want();
        self.fence();
        let mut inside = try_lock(&self.inside)?;
        self.wanted.swap(false, Ordering::AcqRel);
        Some(work(&mut inside))
    }

    /// Works, after the one that is at it, and then for those who left work to this one.
    pub fn must(&self, mut work: impl FnMut(&mut T)) {
        loop {
            let mut inside = lock(&self.inside);
            self.wanted.swap(false, Ordering::AcqRel);
            work(&mut inside);
            drop(inside);
            #[cfg(test)]
            if self.plant == Plant::LeavesBlindly {
                return;
            }
            // As in `take`.
            self.fence();
            if !self.wanted.load(Ordering::Relaxed) {
                return;
            }
        }
    }

    fn fence(&self) {
        #[cfg(test)]
        if self.plant == Plant::NoFence {
            return;
        }
        fence(Ordering::SeqCst);
    }
}
