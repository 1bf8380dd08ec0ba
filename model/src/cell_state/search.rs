//! Explores cell states with stateright's breadth-first search.

use super::plan::CellScenario;
use super::{CellState, Move};
use crate::explore::{Exploration, Ground, Grounded, Limits, search, shows_its_ground};
use crate::state::Packed;
use std::sync::Arc;

impl Ground for CellState {
    type Action = Move;

    fn first(&mut self) -> Packed {
        Self::new(&Arc::clone(&self.plan)).store()
    }

    fn actions(&mut self, state: &Packed, actions: &mut Vec<Move>) {
        self.load(state);
        self.moves(actions);
    }

    fn step(&mut self, state: &Packed, action: Move) -> Packed {
        self.load(state);
        self.apply(action);
        self.store()
    }

    fn renew(&mut self) {
        *self = Self::new(&Arc::clone(&self.plan));
    }
}

/// A cell as a stateright model.
pub struct CellModel(Grounded<CellState>);

impl CellModel {
    /// The stateright model of a scenario.
    #[must_use]
    pub fn new(plan: &Arc<CellScenario>, limits: Limits) -> Self {
        Self(Grounded::new(CellState::new(plan), limits, None))
    }

    /// Whether all effects within nodes are carried out, and no step of an eager task is left.
    #[doc(hidden)]
    #[must_use]
    pub fn is_quiescent(&self, state: &Packed) -> bool {
        self.0.with(|cell_state| {
            cell_state.load(state);
            cell_state.is_quiescent()
        })
    }

    /// The packed form of a [quiescent](Self::is_quiescent) state in the same cell with fused steps.
    #[doc(hidden)]
    #[must_use]
    pub fn as_fused(&self, state: &Packed) -> Packed {
        self.0.with(|cell_state| {
            cell_state.load(state);
            let mut fused = cell_state.clone();
            fused.fuse();
            fused.store()
        })
    }

    /// The packed state, after it was unpacked and packed again.
    #[doc(hidden)]
    #[must_use]
    pub fn rewritten(&self, state: &Packed) -> Packed {
        self.0.with(|cell_state| {
            cell_state.load(state);
            cell_state.store()
        })
    }
}

shows_its_ground!(CellModel, Move);

/// Explores a cell until its state space is covered, a violation is found or a limit is reached.
#[must_use]
pub fn explore_cell_state(plan: &Arc<CellScenario>, limits: Limits) -> Exploration<Move> {
    search(CellState::new(plan), limits, None)
}

/// A cell state that is never packed: every transition works on a copy of the whole state. For tests that compare it with
/// packed states.
#[doc(hidden)]
#[derive(Clone, Debug)]
pub struct LiveCellState(CellState);

impl LiveCellState {
    /// The initial state.
    #[must_use]
    pub fn new(plan: &Arc<CellScenario>) -> Self {
        Self(CellState::new(plan))
    }

    /// All successor states.
    #[must_use]
    pub fn next(&self) -> Vec<Self> {
        let mut moves = Vec::new();
        self.0.moves(&mut moves);
        let follow = |step| {
            let mut next = self.clone();
            next.0.apply(step);
            next
        };
        moves.into_iter().map(follow).collect()
    }

    /// The packed form of the state.
    #[must_use]
    pub fn packed(&self) -> Packed {
        self.0.clone().store()
    }
}
