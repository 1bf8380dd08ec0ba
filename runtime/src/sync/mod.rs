//! The primitives of the hand-offs between threads: locks, atomics and a futex word. Unit tests use the primitives of
//! `crate::explorer`, which explores schedules. Tests with real threads live in `tests/` and use the real primitives.

pub(crate) mod alarm;
pub(crate) mod awake;
pub(crate) mod combining_lock;
pub(crate) mod handoff;
pub(crate) mod inbox;
pub(crate) mod lane;
pub(crate) mod lead;
pub(crate) mod park;
pub(crate) mod plant;
pub(crate) mod protected;
pub(crate) mod ready;
pub(crate) mod task_waker;
pub(crate) mod waiting;

#[cfg(test)]
pub(crate) use crate::explorer::{
    AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Mutex, MutexGuard, Ordering, fence, lock, try_lock,
};
#[cfg(test)]
use crate::explorer::{Condvar, PlainMutex};
/// A panic of a thread that holds one of these locks ends the process (D43), so none of these locks is ever poisoned.
#[cfg(not(test))]
pub(crate) use crate::lock::lock;
#[cfg(not(test))]
pub(crate) use real::try_lock;
#[cfg(not(test))]
pub(crate) use std::sync::{
    Mutex, MutexGuard,
    atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering, fence},
};

#[cfg(not(test))]
mod real {
    use std::sync::{Mutex, MutexGuard, TryLockError};

    /// Takes the lock if no thread holds it.
    pub(crate) fn try_lock<T>(mutex: &Mutex<T>) -> Option<MutexGuard<'_, T>> {
        match mutex.try_lock() {
            Ok(guard) => Some(guard),
            Err(TryLockError::Poisoned(poisoned)) => Some(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        }
    }
}

/// A value that is alone in its cache lines, because several cores write it, or would write other values in the same
/// line.
#[derive(Debug)]
#[repr(align(64))]
pub(crate) struct Line<T>(pub T);

/// A futex word: a number that one thread can sleep on.
#[derive(Debug)]
pub(crate) struct Word {
    value: AtomicU32,
    #[cfg(test)]
    sleeper: (PlainMutex<()>, Condvar),
}

impl Word {
    pub fn new(value: u32) -> Self {
        Self {
            value: AtomicU32::new(value),
            #[cfg(test)]
            sleeper: (PlainMutex::new(()), Condvar::new()),
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

    /// Adds one to the word; the word wraps around.
    pub fn increment(&self) {
        self.value.fetch_add(1, Ordering::AcqRel);
    }

    /// Replaces `current` by `new`. Returns whether the word was `current`.
    pub fn replace(&self, current: u32, new: u32) -> bool {
        self.value.compare_exchange(current, new, Ordering::AcqRel, Ordering::Acquire).is_ok()
    }
}

impl Word {
    /// Sleeps while the word is `value`, at most until `deadline` in nanoseconds of the monotonic clock. Wake-ups may be
    /// spurious.
    pub fn wait(&self, value: u32, deadline: Option<u64>) {
        crate::clock::sleeps();
        self.sleep(value, deadline);
    }
}

#[cfg(not(test))]
impl Word {
    fn sleep(&self, value: u32, deadline: Option<u64>) {
        use rustix::thread::futex;
        let timespec = deadline.map(crate::clock::timespec);
        // The call was interrupted, timed out, or found another value: the caller checks the word in every case.
        let any = std::num::NonZeroU32::MAX;
        let _ = futex::wait_bitset(&self.value, futex::Flags::PRIVATE, value, timespec.as_ref(), any);
    }

    /// Wakes the sleeping thread, if there is one.
    pub fn wake(&self) {
        use rustix::thread::futex;
        let _ = futex::wake(&self.value, futex::Flags::PRIVATE, 1);
    }
}

#[cfg(test)]
impl Word {
    /// An explorer has no time, so a deadline never passes by itself: see [`time_out`](Self::time_out).
    fn sleep(&self, value: u32, _deadline: Option<u64>) {
        let guard = self.sleeper.0.lock().unwrap();
        if self.load() == value {
            drop(self.sleeper.1.wait(guard));
        }
    }

    pub fn wake(&self) {
        let _guard = self.sleeper.0.lock().unwrap();
        self.sleeper.1.notify_one();
    }

    /// Acts as the kernel's timer: the sleeper returns although no thread has changed the word.
    pub fn time_out(&self) {
        self.wake();
    }
}
