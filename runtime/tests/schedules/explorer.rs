//! shuttle as the explorer: schedules drawn by PCT (probabilistic concurrency testing), which finds a bug that needs `DEPTH`
//! ordered steps with a known probability per schedule. Every atomic operation counts as sequentially consistent.

use shuttle::scheduler::PctScheduler;
pub(crate) use shuttle::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering, fence};
pub(crate) use shuttle::sync::{Arc, Condvar, Mutex, Mutex as PlainMutex, MutexGuard};
pub(crate) use shuttle::thread;
use shuttle::{Config, FailurePersistence, Runner};
use std::collections::BTreeMap;

/// Whether a load may return an overwritten value. With shuttle a load always returns the last value.
pub(crate) const SEES_OLD_VALUES: bool = false;

/// How many schedules of each scene are drawn, unless `IMRS_SCHEDULES` sets the number; `.ci/long` takes 100,000.
const SCHEDULES: usize = 2_000;
/// The depth of PCT: the greatest number of steps on whose order a bug may depend.
const DEPTH: usize = 3;
/// The seed of the random draws, which is the same in every run.
const SEED: u64 = 1987;

/// How often each outcome was seen.
pub(crate) type Histogram<O> = BTreeMap<O, u64>;

fn schedules() -> usize {
    std::env::var("IMRS_SCHEDULES").map_or(SCHEDULES, |n| n.parse().expect("IMRS_SCHEDULES is a number"))
}

/// Runs `body` under as many schedules as [`schedules`] says.
pub(crate) fn explore<O: Ord + Send + 'static>(body: impl Fn() -> O + Send + Sync + 'static) -> Histogram<O> {
    let seen = std::sync::Arc::new(std::sync::Mutex::new(Histogram::new()));
    let shared = std::sync::Arc::clone(&seen);
    let mut config = Config::new();
    config.failure_persistence = FailurePersistence::None;
    config.silence_warnings = true;
    let scheduler = PctScheduler::new_from_seed(SEED, DEPTH, schedules());
    let ran = Runner::new(scheduler, config).run(move || {
        let outcome = body();
        *shared.lock().unwrap().entry(outcome).or_insert(0) += 1;
    });
    assert_eq!(ran, schedules(), "not every schedule was run");
    let seen = std::mem::take(&mut *seen.lock().unwrap());
    assert_eq!(seen.values().sum::<u64>(), ran as u64, "a schedule did not come to its end");
    seen
}

/// This explorer draws as many schedules for a large scene as for others, so both functions are the same.
pub(crate) use explore as explore_large;

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap()
}

pub(crate) fn try_lock<T>(mutex: &Mutex<T>) -> Option<MutexGuard<'_, T>> {
    mutex.try_lock().ok()
}
