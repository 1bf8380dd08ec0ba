//! loom as the explorer of schedules: the primitives that the hand-offs use in unit tests, and how a scene is explored.

pub(crate) use loom::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering, fence};
pub(crate) use loom::sync::{Condvar, Mutex as PlainMutex};
pub(crate) use loom::thread;
use std::collections::BTreeMap;
use std::ops::{Deref, DerefMut};
/// This is the standard library's `Arc`, not loom's. loom counts each operation of its own `Arc` as a step, and a
/// thread that is abandoned in a deadlock cannot drop it.
pub(crate) use std::sync::Arc;
use std::time::{Duration, Instant};

/// Whether a load may return an overwritten value, where the orderings allow it.
pub(crate) const SEES_OLD_VALUES: bool = true;

/// The most preemptions of one execution.
const PREEMPTIONS: usize = 3;
/// The most preemptions in a large scene: one preemption more would take 15,000 to 225,000 executions instead of at most a
/// tenth of that.
const PREEMPTIONS_IF_LARGE: usize = 2;
/// The time limit of an exploration. An exploration that takes longer proves nothing, so it fails. An exploration needs
/// only seconds; the limit is longer because the machine may be busy.
const CAP: Duration = Duration::from_secs(600);

/// How often each outcome was seen.
pub(crate) type Histogram<O> = BTreeMap<O, u64>;

/// Runs `body` in every interleaving with at most [`PREEMPTIONS`] preemptions.
pub(crate) fn explore<O: Ord + Send + 'static>(body: impl Fn() -> O + Send + Sync + 'static) -> Histogram<O> {
    explore_within(PREEMPTIONS, body)
}

/// As [`explore`], with at most [`PREEMPTIONS_IF_LARGE`] preemptions; if `.ci/long` sets `IMRS_FULL_SCENES=1`, with at most
/// [`PREEMPTIONS`].
pub(crate) fn explore_large<O: Ord + Send + 'static>(
    body: impl Fn() -> O + Send + Sync + 'static,
) -> Histogram<O> {
    let is_full = std::env::var_os("IMRS_FULL_SCENES").is_some_and(|value| value == "1");
    explore_within(if is_full { PREEMPTIONS } else { PREEMPTIONS_IF_LARGE }, body)
}

fn explore_within<O: Ord + Send + 'static>(
    preemptions: usize,
    body: impl Fn() -> O + Send + Sync + 'static,
) -> Histogram<O> {
    let seen = std::sync::Arc::new(std::sync::Mutex::new(Histogram::new()));
    let shared = std::sync::Arc::clone(&seen);
    let mut builder = loom::model::Builder::new();
    builder.preemption_bound = Some(preemptions);
    builder.max_duration = Some(CAP);
    let start = Instant::now();
    builder.check(move || {
        let outcome = body();
        *shared.lock().unwrap().entry(outcome).or_insert(0) += 1;
    });
    assert!(start.elapsed() < CAP, "the exploration did not end");
    let seen = std::mem::take(&mut *seen.lock().unwrap());
    assert!(seen.values().sum::<u64>() > 1, "only one execution was explored");
    seen
}

/// loom explores no `try_lock` against the release of its own mutex, because it does not branch there. This mutex keeps
/// `held` in an atomic of its own, which loom explores, stale values included. No correct lock gives weaker promises
/// than this mutex.
#[derive(Debug)]
pub(crate) struct Mutex<T> {
    held: AtomicBool,
    value: PlainMutex<T>,
}

pub(crate) struct MutexGuard<'a, T> {
    mutex: &'a Mutex<T>,
    guard: loom::sync::MutexGuard<'a, T>,
}

impl<T> Mutex<T> {
    pub fn new(value: T) -> Self {
        Self { held: AtomicBool::new(false), value: PlainMutex::new(value) }
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
