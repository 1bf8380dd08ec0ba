//! The search of a state space: stateright's breadth-first search, and what stateright 0.31 leaves to its user.
//!
//! There is one property and one thread, so the first counterexample is a shortest one. (With several properties stateright
//! would replace it by a later, longer counterexample.) A stateright search cannot be cancelled: when its budget ends, the
//! model offers no more transitions. A panic of the state machine would lose the path, so it becomes an absorbing state.

use crate::scenario::{Scenario, Watch};
use crate::state::{Packed, Violation};
use crate::world::{Action, Form, World};
use stateright::{Checker, Model, Property};
use std::fmt::Debug;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Limits of an exploration.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// The greatest number of states that are expanded.
    pub states: u64,
    /// The greatest resident memory of the whole process, in bytes.
    pub memory: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { states: u64::MAX, memory: 4 << 30 }
    }
}

/// What an exploration found.
#[derive(Clone, Debug)]
pub struct Exploration<A = Action> {
    /// A shortest path to a violation, if there is one.
    pub path: Option<Vec<A>>,
    /// The states on that path, including the first one.
    pub states_on_path: Option<Vec<Packed>>,
    /// The violation at the end of the path.
    pub violation: Option<Violation>,
    /// The number of distinct states.
    pub states: u64,
    /// The number of transitions that were taken.
    pub transitions: u64,
    /// The depth of the state space: the length of the longest shortest path from the initial state.
    pub depth: u64,
    /// Whether everything within the bounds was explored, or a violation found.
    pub complete: bool,
    /// The number of bytes of the longest packed state.
    pub longest_state: u64,
    /// The duration in seconds of wall-clock time.
    pub seconds: f64,
}

/// A state space to explore, with working memory. `actions` and `step` first load the packed state that they are given
/// into this memory.
pub(crate) trait Ground: Send {
    /// The type of a transition.
    type Action: Copy + Debug + PartialEq + Send + Sync + 'static;

    /// The initial state.
    fn first(&mut self) -> Packed;
    /// Lists the enabled transitions of a state that is not final.
    fn actions(&mut self, state: &Packed, actions: &mut Vec<Self::Action>);
    /// The state after a transition. May panic if the state machine does.
    fn step(&mut self, state: &Packed, action: Self::Action) -> Packed;
    /// Repairs the working memory after a panic, so that it can be used again.
    fn renew(&mut self);
}

/// Receives the progress of a search: the number of states that were expanded.
pub(crate) type Hear = Arc<dyn Fn(u64) + Send + Sync>;

/// A state space as a stateright model.
pub(crate) struct Grounded<G> {
    pub scratch: Mutex<G>,
    limits: Limits,
    expanded: AtomicU64,
    longest: AtomicU64,
    over: AtomicBool,
    replaying: AtomicBool,
    progress: Option<Hear>,
}

/// How many states are expanded between two measurements of the memory, and between two reports of progress.
const LOOK: u64 = 8192;

impl<G: Ground> Grounded<G> {
    /// The stateright model of a state space.
    pub fn new(pad: G, limits: Limits, progress: Option<Hear>) -> Self {
        Self {
            scratch: Mutex::new(pad),
            limits,
            expanded: AtomicU64::new(0),
            longest: AtomicU64::new(0),
            over: AtomicBool::new(false),
            replaying: AtomicBool::new(false),
            progress,
        }
    }

    /// Runs `work` on the state space, under its lock.
    pub fn with<R>(&self, work: impl FnOnce(&mut G) -> R) -> R {
        work(&mut self.scratch.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn look(&self) {
        if self.replaying.load(Ordering::Relaxed) {
            return;
        }
        let expanded = self.expanded.fetch_add(1, Ordering::Relaxed) + 1;
        if expanded >= self.limits.states {
            self.over.store(true, Ordering::Relaxed);
        }
        if expanded.is_multiple_of(LOOK) {
            if resident_bytes().is_some_and(|bytes| bytes > self.limits.memory) {
                self.over.store(true, Ordering::Relaxed);
            }
            if let Some(progress) = &self.progress {
                progress(expanded);
            }
        }
    }
}

impl<G: Ground> Model for Grounded<G> {
    type State = Packed;
    type Action = G::Action;

    fn init_states(&self) -> Vec<Packed> {
        vec![self.with(Ground::first)]
    }

    fn actions(&self, state: &Packed, actions: &mut Vec<G::Action>) {
        self.look();
        self.longest.fetch_max(state.len() as u64, Ordering::Relaxed);
        if self.over.load(Ordering::Relaxed) || state.is_final() {
            return;
        }
        self.with(|pad| pad.actions(state, actions));
    }

    fn next_state(&self, state: &Packed, action: G::Action) -> Option<Packed> {
        Some(self.with(|pad| {
            let result = catch_unwind(AssertUnwindSafe(|| pad.step(state, action)));
            result.unwrap_or_else(|_| {
                pad.renew();
                Packed(Box::new([Violation::Panic.code(), 0, 0, 0, 0]))
            })
        }))
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![Property::always("claim", |_, state: &Packed| state.violation().is_none())]
    }
}

/// Implements stateright's model for a public type that wraps a [`Grounded`] state space, without showing the type of that
/// state space.
macro_rules! shows_its_ground {
    ($model:ty, $action:ty) => {
        impl stateright::Model for $model {
            type State = Packed;
            type Action = $action;

            fn init_states(&self) -> Vec<Packed> {
                self.0.init_states()
            }

            fn actions(&self, state: &Packed, actions: &mut Vec<$action>) {
                self.0.actions(state, actions);
            }

            fn next_state(&self, state: &Packed, action: $action) -> Option<Packed> {
                self.0.next_state(state, action)
            }

            fn properties(&self) -> Vec<stateright::Property<Self>> {
                vec![stateright::Property::always("claim", |_, state: &Packed| state.violation().is_none())]
            }
        }
    };
}
pub(crate) use shows_its_ground;

/// Explores a state space until it is covered, a violation is found or a limit is reached.
pub(crate) fn search<G: Ground + 'static>(
    pad: G,
    limits: Limits,
    progress: Option<Hear>,
) -> Exploration<G::Action> {
    let start = Instant::now();
    let checker = Grounded::new(pad, limits, progress).checker().threads(1).spawn_bfs().join();
    let cut = checker.model().over.swap(false, Ordering::Relaxed);
    // stateright rebuilds a path by asking the model again, so from now on the model must offer the same transitions as in
    // the search.
    checker.model().replaying.store(true, Ordering::Relaxed);
    let path = checker.discoveries().remove("claim");
    let violation = path.as_ref().and_then(|path| path.last_state().violation());
    let states_on_path = path.clone().map(stateright::Path::into_states);
    Exploration {
        complete: !cut || path.is_some(),
        violation,
        states_on_path,
        states: checker.unique_state_count() as u64,
        transitions: checker.state_count() as u64,
        depth: checker.max_depth() as u64,
        longest_state: checker.model().longest.load(Ordering::Relaxed),
        seconds: start.elapsed().as_secs_f64(),
        path: path.map(stateright::Path::into_actions),
    }
}

impl Ground for World {
    type Action = Action;

    fn first(&mut self) -> Packed {
        World::new(&self.scenario).store()
    }

    fn actions(&mut self, state: &Packed, actions: &mut Vec<Action>) {
        self.load(state, None);
        World::actions(self, actions);
    }

    fn step(&mut self, state: &Packed, action: Action) -> Packed {
        if let Action::Act(i) = action
            && let Err(violation) = self.compare_in(state, usize::from(i))
        {
            self.violation = Some(violation);
            return self.store();
        }
        let touch = match touched(&self.scenario, action) {
            Touch::All => None,
            Touch::One(i) => Some(i),
            Touch::Destination => match action {
                Action::Deliver(i) => World::destination(&self.scenario, state, i),
                _ => None,
            },
        };
        self.load(state, touch);
        self.apply(action);
        self.store()
    }

    fn renew(&mut self) {
        *self = World::new(&Arc::clone(&self.scenario));
    }
}

enum Touch {
    All,
    One(usize),
    Destination,
}

/// Which nodes must be unpacked for a transition: only one, if neither the property nor a reduction looks at other nodes.
fn touched(scenario: &Scenario, action: Action) -> Touch {
    let local = scenario.is_meeting()
        && !scenario.reductions.ignores
        && !scenario.reductions.turns
        && !scenario.incarnations()
        && !matches!(scenario.watch, Watch::Stranded | Watch::Waits)
        && scenario.timing.late == 0;
    match action {
        Action::Act(i) if local => Touch::One(usize::from(i)),
        Action::Deliver(_) if local => Touch::Destination,
        _ => Touch::All,
    }
}

/// A scenario as a stateright model.
pub struct WorldModel(Grounded<World>);

impl WorldModel {
    /// The stateright model of a scenario.
    #[must_use]
    pub fn new(scenario: &Arc<Scenario>, limits: Limits) -> Self {
        Self(Grounded::new(World::new(scenario), limits, None))
    }

    /// The canonical form of `state` under the reductions of this scenario.
    #[doc(hidden)]
    #[must_use]
    pub fn canonical(&self, state: &Packed) -> Packed {
        self.0.with(|world| {
            world.load(state, None);
            world.store()
        })
    }

    /// The state with its members renamed: member `order[k]` moves to position `k`.
    #[doc(hidden)]
    #[must_use]
    pub fn renamed(&self, state: &Packed, order: &[usize]) -> Packed {
        self.0.with(|world| {
            world.load(state, None);
            world.store_as(Form::Named(order))
        })
    }

    /// The state without the marks that the reduction by turns sets. Just after a tick, searches with and without this
    /// reduction have the same states.
    #[doc(hidden)]
    #[must_use]
    pub fn without_turns(&self, state: &Packed) -> Packed {
        self.0.with(|world| {
            world.load(state, None);
            world.forget_turns();
            world.store_plain()
        })
    }

    /// Whether all tasks have finished their work, and no packet is in flight.
    #[doc(hidden)]
    #[must_use]
    pub fn is_finished(&self, state: &Packed) -> bool {
        self.0.with(|world| {
            world.load(state, None);
            world.is_finished()
        })
    }
}

shows_its_ground!(WorldModel, Action);

/// Explores a scenario until its state space is covered, a violation is found or a limit is reached.
#[must_use]
pub fn explore(
    scenario: &Arc<Scenario>,
    limits: Limits,
    progress: Option<Arc<dyn Fn(u64) + Send + Sync>>,
) -> Exploration {
    search(World::new(scenario), limits, progress)
}

/// The resident memory of this process in bytes, if the system tells it.
pub(crate) fn resident_bytes() -> Option<u64> {
    let statm = std::fs::read_to_string("/proc/self/statm").ok()?;
    let pages: u64 = statm.split_whitespace().nth(1)?.parse().ok()?;
    Some(pages * 4096)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::worlds::Meeting;

    #[test]
    fn a_panic_of_the_machine_is_a_violation_and_the_next_step_is_sound() {
        let scenario = Meeting::new(2, Watch::FalseRelease).scenario().expect("a sound declaration");
        let model = WorldModel::new(&scenario, Limits::default());
        let start = model.init_states().remove(0);
        let expected = model.next_state(&start, Action::Act(0));
        // A world without nodes panics because an index is out of range, as a fault of the state machine would.
        model.0.scratch.lock().expect("nobody panicked with it").nodes.clear();
        let broken = model.next_state(&start, Action::Act(0)).expect("a state in any case");
        assert_eq!(broken.violation(), Some(crate::Violation::Panic));
        assert!(broken.is_final());
        assert_eq!(model.next_state(&start, Action::Act(0)), expected);
    }
}
