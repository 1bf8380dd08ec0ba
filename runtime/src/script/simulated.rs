//! A simulated robot: every action takes a random time within its interval and succeeds.

use super::actions::{Act, Actions, Ending, Stop};
use crate::clock;
use crate::lock::lock;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// The results of all actions of one name, in all tasks.
#[derive(Clone, Debug, PartialEq)]
pub struct Results {
    /// The name of the action.
    pub name: String,
    /// The range of the action's results.
    pub give: Give,
}

/// A range of results: any value from the least to the greatest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Give {
    /// A range of whole numbers; truth values are 0 and 1.
    Whole(i32, i32),
    /// A range of finite reals.
    Real(f32, f32),
}

impl Give {
    /// A random value of the range; a `real` is given by its bits.
    fn any(self, draws: &mut fastrand::Rng) -> i32 {
        match self {
            Self::Whole(least, most) => draws.i32(least..=most.max(least)),
            Self::Real(..) => self.at(draws.f64()),
        }
    }

    /// The value at `share` of the range, from the least value (0) to the greatest (1); a `real` is given by its bits.
    fn at(self, share: f64) -> i32 {
        match self {
            #[expect(clippy::cast_possible_truncation, reason = "between two numbers of 32 bits")]
            Self::Whole(least, most) => {
                (f64::from(least) + share * (f64::from(most) - f64::from(least))).floor() as i32
            }
            #[expect(clippy::cast_possible_truncation, reason = "the nearest real is meant")]
            Self::Real(least, most) => {
                let value = (f64::from(least) + share * (f64::from(most) - f64::from(least))) as f32;
                // The scripts have no negative zero, and no infinity.
                let value = if value == 0.0 || !value.is_finite() { 0.0 } else { value };
                value.to_bits().cast_signed()
            }
        }
    }
}

/// An action whose results depend on time. When the action `since` ends in the same task, the result is the least
/// value. During `over` the result rises to the greatest value, and stays there.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ramp {
    /// The action that gives the results.
    pub action: String,
    /// The action from whose end the time counts.
    pub since: String,
    /// How long the result takes to rise from the least to the greatest value.
    pub over: Duration,
}

/// A simulated robot. The seed, the name of the task and the number of actions that the task began before determine how
/// long an action takes and its result.
pub struct Simulated {
    seed: u64,
    results: BTreeMap<String, Give>,
    courses: Vec<Ramp>,
    /// The ends of actions from which ramps count: for each task and such action, when it last ended or will end.
    followed: Mutex<BTreeMap<(String, String), Instant>>,
    shared: Arc<Shared>,
}

struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    /// The actions in progress; the next to end comes first.
    under_way: BTreeMap<(Instant, u64), (i32, Ending)>,
    numbers: u64,
    closed: bool,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }
}

/// A hash of a name, to seed draws differently for each name.
pub(crate) fn salt(name: &str) -> u64 {
    name.bytes()
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

/// The random numbers for a task's action with this number. One generator seeds the next: if the seed and the number
/// were only combined by `^`, runs with neighbouring seeds would draw the same numbers in another order.
fn draws(seed: u64, task: &str, number: u64) -> fastrand::Rng {
    let mut of_task = fastrand::Rng::with_seed(seed ^ salt(task));
    fastrand::Rng::with_seed(of_task.u64(..) ^ number)
}

impl Simulated {
    /// A robot whose actions give these results; other actions give 0.
    ///
    /// # Errors
    /// The operating system refused the thread that ends the actions.
    pub fn start(seed: u64, results: Vec<Results>, courses: Vec<Ramp>) -> io::Result<Arc<dyn Actions>> {
        let shared = Arc::new(Shared { state: Mutex::default(), changed: Condvar::new() });
        let ends = Arc::clone(&shared);
        thread::Builder::new().name("imrs actions".into()).spawn(move || run(&ends))?;
        let results = results.into_iter().map(|one| (one.name, one.give)).collect();
        let followed = Mutex::default();
        Ok(Arc::new(Self { seed, results, courses, followed, shared }))
    }

    /// How far the result of an action is on its ramp, from 0 to 1, if the action has a ramp.
    fn on_its_course(&self, act: &Act<'_>, now: Instant) -> Option<f64> {
        let ramp = self.courses.iter().find(|ramp| ramp.action == act.name)?;
        let followed = lock(&self.followed);
        let since = followed.get(&(act.task.to_owned(), ramp.since.clone()));
        let passed = since.map_or(Duration::ZERO, |since| now.saturating_duration_since(*since));
        Some(if passed >= ramp.over { 1.0 } else { passed.div_duration_f64(ramp.over) })
    }
}

impl Actions for Simulated {
    fn begin(&self, act: &Act<'_>, ending: Ending) -> Option<Stop> {
        let mut draws = draws(self.seed, act.task, act.number);
        let spread = act.most.saturating_sub(act.least);
        let length = act.least + spread.mul_f64(draws.f64());
        let now = Instant::now();
        if self.courses.iter().any(|ramp| ramp.since == act.name) {
            let mut followed = lock(&self.followed);
            followed.insert((act.task.into(), act.name.into()), now + length);
        }
        let give = |give: &Give| match self.on_its_course(act, now) {
            Some(share) => give.at(share),
            None => give.any(&mut draws),
        };
        let value = self.results.get(act.name).map_or(0, give);
        let mut state = self.shared.lock();
        let key = (now + length, state.numbers);
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
            // This is dropped without the lock, because dropping the ending reports to the node.
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
    // The actions in progress are dropped without the lock, because that reports to the node.
    let left = std::mem::take(&mut state.under_way);
    drop(state);
    drop(left);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_action_of_each_task_under_each_seed_draws_its_own_numbers() {
        let mut drawn = std::collections::BTreeSet::new();
        for (seed, task, number) in (0..32)
            .flat_map(|seed| ["left", "right"].map(|task| (seed, task)))
            .flat_map(|(seed, task)| (0..32).map(move |number| (seed, task, number)))
        {
            assert!(drawn.insert(draws(seed, task, number).u64(..)), "{seed} {task} {number}");
        }
    }

    #[test]
    fn what_is_given_lies_between_the_least_and_the_most() {
        for (share, whole) in [(0.0, -3), (0.5, 0), (0.99, 2), (1.0, 3)] {
            assert_eq!(Give::Whole(-3, 3).at(share), whole, "{share}");
        }
        assert_eq!(Give::Whole(i32::MIN, i32::MAX).at(1.0), i32::MAX);
        let mut draws = fastrand::Rng::with_seed(7);
        assert!((0..100).all(|_| (-3..=3).contains(&Give::Whole(-3, 3).any(&mut draws))));
        let real = |least, most, share| f32::from_bits(Give::Real(least, most).at(share).cast_unsigned());
        assert_eq!((real(-1.0, 3.0, 0.5), real(2.0, 2.0, 0.3)), (1.0, 2.0));
        // The result is never a negative zero.
        assert_eq!(Give::Real(-0.0, -0.0).at(0.0), 0);
    }
}
