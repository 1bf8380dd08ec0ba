//! An independent breadth-first search, level by level, with whole states, not fingerprints, in the set of visited states.

use imrs_model::{Action, Limits, Packed, Scenario, WorldModel};
use stateright::Model;
use std::collections::HashSet;
use std::sync::Arc;

pub struct Walk {
    /// Every state, in the order in which the search found it.
    pub states: Vec<Packed>,
    /// The number of transitions, plus one for the start, because stateright counts generated states in this way.
    pub generated: u64,
    /// The length of a shortest path to a violation, if there is one.
    pub violated_at: Option<usize>,
}

/// Explores all states of a scenario up to the level of the first violation.
pub fn walk(scenario: &Arc<Scenario>) -> Walk {
    let model = WorldModel::new(scenario, Limits::default());
    let mut level = model.init_states();
    let mut seen: HashSet<Packed> = level.iter().cloned().collect();
    let mut walk = Walk { states: level.clone(), generated: 1, violated_at: None };
    for depth in 0.. {
        if level.iter().any(|state| state.violation().is_some()) {
            walk.violated_at = Some(depth);
        }
        if level.is_empty() || walk.violated_at.is_some() {
            return walk;
        }
        let mut next = Vec::new();
        for state in &level {
            for (_, after) in successors(&model, state) {
                walk.generated += 1;
                if seen.insert(after.clone()) {
                    next.push(after);
                }
            }
        }
        walk.states.extend(next.iter().cloned());
        level = next;
    }
    unreachable!("levels are finite")
}

/// The enabled actions of a state, each with the state to which it leads.
pub fn successors(model: &WorldModel, state: &Packed) -> Vec<(Action, Packed)> {
    let mut actions = Vec::new();
    model.actions(state, &mut actions);
    let next = |action| (action, model.next_state(state, action).expect("only enabled actions are listed"));
    actions.into_iter().map(next).collect()
}

/// A small seeded generator of random numbers, so that a failure is reproducible.
pub struct Dice(pub u64);

impl Dice {
    pub fn below(&mut self, limit: usize) -> usize {
        // The algorithm is xorshift64*.
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        let high = self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 33;
        usize::try_from(high).expect("31 bits") % limit
    }

    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for i in (1..items.len()).rev() {
            items.swap(i, self.below(i + 1));
        }
    }
}
