//! A simulated robot: every action takes some time of its interval and succeeds.

use super::actions::{Act, Actions, Ending, Stop};
use crate::clock;
use std::collections::BTreeMap;
use std::io;
use std::ops::RangeInclusive;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Instant;

/// What the actions of one name give, in all tasks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Results {
    /// The name of the action.
    pub name: String,
    /// Any of these.
    pub range: RangeInclusive<i32>,
}

/// A simulated robot. How long an action takes and what it gives follow from the seed, the name of the task and how
/// many actions the task began before.
pub struct Simulated {
    seed: u64,
    results: BTreeMap<String, RangeInclusive<i32>>,
    shared: Arc<Shared>,
}

struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    /// The next to end comes first.
    under_way: BTreeMap<(Instant, u64), (i32, Ending)>,
    numbers: u64,
    closed: bool,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A number made of a name: what is seeded with it differs between names.
pub(crate) fn salt(name: &str) -> u64 {
    name.bytes()
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

impl Simulated {
    /// A robot whose actions give these results; an action without any gives 0.
    ///
    /// # Errors
    /// The operating system refused the thread that ends the actions.
    pub fn start(seed: u64, results: Vec<Results>) -> io::Result<Arc<dyn Actions>> {
        let shared = Arc::new(Shared { state: Mutex::default(), changed: Condvar::new() });
        let ends = Arc::clone(&shared);
        thread::Builder::new().name("imrs actions".into()).spawn(move || run(&ends))?;
        let results = results.into_iter().map(|one| (one.name, one.range)).collect();
        Ok(Arc::new(Self { seed, results, shared }))
    }
}

impl Actions for Simulated {
    fn begin(&self, act: &Act<'_>, ending: Ending) -> Option<Stop> {
        let mut draws = fastrand::Rng::with_seed(self.seed ^ salt(act.task).rotate_left(17) ^ act.number);
        let spread = act.most.saturating_sub(act.least);
        let length = act.least + spread.mul_f64(draws.f64());
        let range = self.results.get(act.name).cloned().unwrap_or(0..=0);
        let value = draws.i32(range);
        let mut state = self.shared.lock();
        let key = (Instant::now() + length, state.numbers);
        state.numbers += 1;
        let first = state.under_way.keys().next().is_none_or(|earliest| key < *earliest);
        state.under_way.insert(key, (value, ending));
        drop(state);
        if first {
            self.shared.changed.notify_one();
        }
        let shared = Arc::clone(&self.shared);
        Some(Box::new(move || {
            let gone = shared.lock().under_way.remove(&key);
            // Outside of the lock: it has something to say.
            drop(gone);
        }))
    }
}

impl Drop for Simulated {
    fn drop(&mut self) {
        self.shared.lock().closed = true;
        self.shared.changed.notify_one();
    }
}

fn run(shared: &Shared) {
    clock::sleep_exactly();
    let mut state = shared.lock();
    while !state.closed {
        let now = Instant::now();
        let due = state.under_way.keys().next().map(|(at, _)| *at);
        match due {
            Some(at) if at <= now => {
                let Some((_, (value, ending))) = state.under_way.pop_first() else { continue };
                drop(state);
                ending.done(value);
                state = shared.lock();
            }
            Some(at) => {
                let waited = shared.changed.wait_timeout(state, at - now);
                state = waited.unwrap_or_else(PoisonError::into_inner).0;
            }
            None => {
                state = shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
            }
        }
    }
    // What is under way ends with nobody to tell.
    let left = std::mem::take(&mut state.under_way);
    drop(state);
    drop(left);
}
