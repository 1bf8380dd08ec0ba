//! What the hand-offs are made of. The unit-test build takes loom's, so that every interleaving is explored; tests
//! with real threads live in `tests/` and get the real ones.

#[cfg(test)]
pub(crate) use explored::{Mutex, MutexGuard, lock, try_lock};
#[cfg(test)]
pub(crate) use loom::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering, fence};
#[cfg(not(test))]
pub(crate) use real::{lock, try_lock};
#[cfg(not(test))]
pub(crate) use std::sync::{
    Mutex, MutexGuard,
    atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering, fence},
};

#[cfg(not(test))]
mod real {
    use std::sync::{Mutex, MutexGuard, PoisonError, TryLockError};

    /// Locks. A panic under one of these locks has ended the process (D43), so none is ever poisoned.
    pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
        mutex.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Locks if nobody holds the lock.
    pub(crate) fn try_lock<T>(mutex: &Mutex<T>) -> Option<MutexGuard<'_, T>> {
        match mutex.try_lock() {
            Ok(guard) => Some(guard),
            Err(TryLockError::Poisoned(poisoned)) => Some(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        }
    }
}

/// loom explores no `try_lock` against the release of its own mutex (a release is no point where it branches). This
/// mutex says in an atomic that it is held, which loom explores, old values included: the weakest lock that is one.
#[cfg(test)]
mod explored {
    use loom::sync::atomic::{AtomicBool, Ordering};
    use std::ops::{Deref, DerefMut};

    #[derive(Debug)]
    pub(crate) struct Mutex<T> {
        held: AtomicBool,
        value: loom::sync::Mutex<T>,
    }

    pub(crate) struct MutexGuard<'a, T> {
        mutex: &'a Mutex<T>,
        guard: loom::sync::MutexGuard<'a, T>,
    }

    impl<T> Mutex<T> {
        pub fn new(value: T) -> Self {
            Self { held: AtomicBool::new(false), value: loom::sync::Mutex::new(value) }
        }
    }

    pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
        let guard = mutex.value.lock().unwrap();
        mutex.held.store(true, Ordering::Relaxed);
        MutexGuard { mutex, guard }
    }

    pub(crate) fn try_lock<T>(mutex: &Mutex<T>) -> Option<MutexGuard<'_, T>> {
        (!mutex.held.load(Ordering::Relaxed)).then(|| lock(mutex))
    }

    impl<T> Drop for MutexGuard<'_, T> {
        fn drop(&mut self) {
            self.mutex.held.store(false, Ordering::Release);
        }
    }

    impl<T> Deref for MutexGuard<'_, T> {
        type Target = T;
        fn deref(&self) -> &T {
            &self.guard
        }
    }

    impl<T> DerefMut for MutexGuard<'_, T> {
        fn deref_mut(&mut self) -> &mut T {
            &mut self.guard
        }
    }
}

/// A number that one thread can sleep on.
#[derive(Debug)]
pub(crate) struct Word {
    value: AtomicU32,
    #[cfg(test)]
    sleeper: (loom::sync::Mutex<()>, loom::sync::Condvar),
}

impl Word {
    pub fn new(value: u32) -> Self {
        Self {
            value: AtomicU32::new(value),
            #[cfg(test)]
            sleeper: (loom::sync::Mutex::new(()), loom::sync::Condvar::new()),
        }
    }

    pub fn load(&self) -> u32 {
        self.value.load(Ordering::Acquire)
    }

    pub fn store(&self, value: u32) {
        self.value.store(value, Ordering::Release);
    }

    pub fn swap(&self, value: u32) -> u32 {
        self.value.swap(value, Ordering::AcqRel)
    }

    /// Adds one, around the wrap.
    pub fn increment(&self) {
        self.value.fetch_add(1, Ordering::AcqRel);
    }

    /// Puts `new` in the place of `current`; whether it was there.
    pub fn replace(&self, current: u32, new: u32) -> bool {
        self.value.compare_exchange(current, new, Ordering::AcqRel, Ordering::Acquire).is_ok()
    }
}

#[cfg(not(test))]
impl Word {
    /// Sleeps while the word is `value`, at most until `deadline` in nanoseconds of the monotonic clock. May also
    /// return for no reason.
    pub fn wait(&self, value: u32, deadline: Option<u64>) {
        use rustix::thread::futex;
        let timespec = deadline.map(crate::clock::timespec);
        // Interrupted, timed out, changed meanwhile: the caller looks for itself in every case.
        let any = std::num::NonZeroU32::MAX;
        let _ = futex::wait_bitset(&self.value, futex::Flags::PRIVATE, value, timespec.as_ref(), any);
    }

    /// Wakes who sleeps.
    pub fn wake(&self) {
        use rustix::thread::futex;
        let _ = futex::wake(&self.value, futex::Flags::PRIVATE, 1);
    }
}

#[cfg(test)]
impl Word {
    /// loom has no time: a deadline never passes by itself, see [`time_out`](Self::time_out).
    pub fn wait(&self, value: u32, _deadline: Option<u64>) {
        let guard = self.sleeper.0.lock().unwrap();
        if self.load() == value {
            drop(self.sleeper.1.wait(guard));
        }
    }

    pub fn wake(&self) {
        let _guard = self.sleeper.0.lock().unwrap();
        self.sleeper.1.notify_one();
    }

    /// Plays the kernel's timer: the sleeper returns though nobody changed the word.
    pub fn time_out(&self) {
        self.wake();
    }
}
