//! Expands kept states: makes each of their moves, and goes on as long as only one move is possible. Such a path from a
//! kept state to the next choice is called a *walk* here.

use super::judge::{Reached, Shown, judge, nothing_reached};
use super::run_state::{CellMove, RunState};
use super::seen::{Mark, Seen};
use super::standstill::{StateGraph, is_outside};
use super::verdict::{Kind, Phase};
use super::waiting::for_ever;
use crate::state::Violation;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

/// After this many moves without an alternative, the search keeps (stores) the state in any case.
const WALK: u16 = 512;

/// How a kept state was first reached: its parent, which of the parent's moves, and the number of choices on the path.
#[derive(Clone, Copy)]
pub(super) struct Origin {
    pub parent: u32,
    pub choice: u16,
    pub depth: u16,
    /// The number of moves from the parent to this state, including the chosen move.
    pub steps: u16,
}

/// A finding that the last move of a walk shows. `origin` describes the walk.
pub(super) struct Hit {
    pub shown: Shown,
    pub origin: Origin,
}

/// The state at the end of a walk, which the search may keep.
pub(super) struct Stop {
    pub origin: Origin,
    pub mark: Mark,
    pub state: Box<[u8]>,
}

/// The part of a walk that has been made so far.
#[derive(Clone, Copy)]
struct WalkPath {
    from: u32,
    takes_fault: bool,
    /// Whether some move of the walk was progress.
    further: bool,
}

/// What the kept states tell about a state that has only one move.
enum Known {
    /// Nothing is known, so the walk goes on.
    No,
    /// A kept state covers this state: the kept state allows all moves that this state allows.
    Covered(Mark),
    /// The search keeps this state, though it lies on a chain: a row of states of which each has one successor only. The
    /// second value is its packed form.
    Post(Mark, Box<[u8]>),
}

/// The results of some walks, in their order.
#[derive(Default)]
pub(super) struct Walks {
    pub stops: Vec<Stop>,
    pub hits: Vec<Hit>,
    pub moves: u64,
    pub graph: StateGraph,
    /// Whether some number of a state did not fit its field, so that the state has no packed form. The search does not
    /// continue from such a state.
    pub outgrown: bool,
}

/// Makes walks from kept states to the next choice.
pub(super) struct Walker {
    phase: Phase,
    run_state: RunState,
    pub reached: Reached,
    walks: Walks,
    all: Vec<CellMove>,
}

impl Walker {
    pub fn new(phase: Phase, run_state: RunState) -> Self {
        let reached = nothing_reached(&run_state);
        Self { phase, run_state, reached, walks: Walks::default(), all: Vec::new() }
    }

    /// For each check, whether its left side was ever true.
    pub fn mattered(&self) -> &[bool] {
        &self.run_state.mattered
    }

    /// The results of the walks since the last call.
    pub fn take(&mut self) -> Walks {
        std::mem::take(&mut self.walks)
    }

    /// Makes the walk from the start of the cell.
    pub fn start(&mut self, seen: &Seen) {
        self.walk(Origin { parent: u32::MAX, choice: 0, depth: 0, steps: 0 }, None, seen);
    }

    /// Expands a kept state: makes a walk for each of its moves. `before` is the number of choices on the path to the
    /// state; `is_sampled` says whether the state is in the sample.
    pub fn expand(&mut self, at: u32, (before, is_sampled): (u16, bool), state: &[u8], seen: &Seen) {
        self.run_state.cell.is_sampled = is_sampled || self.run_state.plan.everything;
        self.run_state.load(state);
        let mut all = std::mem::take(&mut self.all);
        all.clear();
        self.run_state.moves(&mut all);
        let mut moves: Vec<(u16, CellMove)> = (0_u16..).zip(all.iter().copied()).collect();
        self.all = all;
        let depth = before.saturating_add(u16::from(moves.len() > 1));
        let mut fresh = !self.leave_out(state, &mut moves);
        for (choice, step) in moves {
            if !std::mem::take(&mut fresh) {
                self.run_state.load(state);
            }
            self.walk(Origin { parent: at, choice, depth, steps: 0 }, Some(step), seen);
        }
    }

    /// Drops the moves that lose a packet whose arrival would change nothing. The arrival leads to the same state, with
    /// more faults left. A cut that begins or ends at this packet may as well begin at the next packet, or have ended
    /// before. The move that ends a cut stays in two cases: if events are postponed, because an arrival ends
    /// postponements; and if nodes may crash, because a node may crash right after an arrival. Returns whether the run
    /// state was changed.
    fn leave_out(&mut self, state: &[u8], moves: &mut Vec<(u16, CellMove)>) -> bool {
        if self.run_state.plan.everything {
            return false;
        }
        let beside = &self.run_state.beside;
        let waits = !beside.stays.is_empty() || beside.slow != 0 || !beside.crashed.is_empty();
        let mut taken: Vec<u8> = moves.iter().filter_map(|&(_, step)| takes_away(step)).collect();
        taken.dedup();
        let mut fresh = true;
        for &i in &taken {
            let comes = |&&(_, step): &&(u16, CellMove)| matches!(step, CellMove::Deliver(at) | CellMove::Mend(at, _) if at == i);
            let Some(&(_, arrives)) = moves.iter().find(comes) else { continue };
            let run_state = &mut self.run_state;
            if !std::mem::take(&mut fresh) {
                run_state.load(state);
            }
            let without = run_state.without(i);
            let with = catch_unwind(AssertUnwindSafe(|| run_state.after(state, arrives)));
            if !matches!(with, Ok(Some(with)) if with == without) {
                continue;
            }
            let cut = moves.iter().any(|&(_, step)| step == CellMove::Vanish(i));
            moves.retain(|&(_, step)| match step {
                CellMove::Lose(at) | CellMove::Cut(at, _) => at != i,
                CellMove::Mend(at, _) => at != i || !cut || waits,
                _ => true,
            });
        }
        !fresh
    }

    /// Makes the first move of a walk, and goes on as long as only one move is possible.
    fn walk(&mut self, mut origin: Origin, first: Option<CellMove>, seen: &Seen) {
        let mut step = first;
        let mut moves = Vec::new();
        let mut path =
            WalkPath { from: origin.parent, takes_fault: origin.parent == u32::MAX, further: false };
        loop {
            origin.steps += u16::from(step.is_some());
            if let Some(step) = step {
                path.takes_fault |= is_outside(step);
                path.further |= self.apply(step);
            }
            if self.look(origin) {
                self.lead(path, None);
                return;
            }
            moves.clear();
            self.run_state.moves(&mut moves);
            if !moves.iter().any(|step| !matches!(step, CellMove::Crash(_) | CellMove::Restart(_))) {
                if let Some(shown) = for_ever(&self.run_state, false) {
                    self.note(shown, origin);
                }
                self.lead(path, None);
                if moves.is_empty() {
                    return;
                }
            }
            match moves[..] {
                [only] if origin.steps < WALK => step = Some(only),
                _ => break,
            }
            match self.is_known(&moves, seen) {
                Known::Covered(mark) => {
                    self.lead(path, Some(mark));
                    return;
                }
                Known::Post(mark, state) => {
                    self.note_ring(origin);
                    self.lead(path, Some(mark));
                    self.walks.stops.push(Stop { origin, mark, state });
                    return;
                }
                Known::No => {}
            }
        }
        self.note_ring(origin);
        match self.run_state.pack() {
            Ok(()) => {
                let mark = self.mark();
                self.lead(path, Some(mark));
                if !seen.covers(mark) {
                    let state = self.run_state.packed().into();
                    self.walks.stops.push(Stop { origin, mark, state });
                }
            }
            // A number of the state outgrew its field. For example, the rounds of a rendezvous drift apart without
            // bound if its members give up again and again.
            Err(Violation::Overflow) => self.walks.outgrown = true,
            Err(violation) => {
                self.note(Shown::whole(Kind::Machine, violation.text()), origin);
            }
        }
    }

    /// Notes a deadlock of some tasks, or an endless wait, while other tasks go on.
    fn note_ring(&mut self, origin: Origin) {
        if let Some(shown) = for_ever(&self.run_state, true) {
            self.note(shown, origin);
        }
    }

    /// Notes for the livelock analysis to which state a walk leads. A walk that has a fault is not noted.
    fn lead(&mut self, path: WalkPath, to: Option<Mark>) {
        if !path.takes_fault {
            self.walks.graph.note(path.from, to.filter(|_| !path.further).map(Mark::core));
        }
    }

    /// Makes a move. Returns whether the move was progress.
    fn apply(&mut self, step: CellMove) -> bool {
        self.walks.moves += 1;
        self.run_state.progresses(step).unwrap_or_else(|| {
            let mattered = std::mem::take(&mut self.run_state.mattered);
            self.run_state = RunState::new(&Arc::clone(&self.run_state.plan), &self.run_state.faults.clone());
            self.run_state.mattered = mattered;
            self.run_state.cell.violation = Some(Violation::Panic);
            true
        })
    }

    /// Looks up a state whose only move is the arrival of a packet. With more faults left the same state has a choice,
    /// so the search may have kept it. If not, two paths that join here meet again at the next kept state of the chain.
    fn is_known(&mut self, moves: &[CellMove], seen: &Seen) -> Known {
        if !matches!(moves, [CellMove::Deliver(_) | CellMove::Vanish(_)]) {
            return Known::No;
        }
        if self.run_state.pack().is_err() {
            return Known::No;
        }
        let mark = self.mark();
        if seen.covers(mark) {
            Known::Covered(mark)
        } else if mark.is_post() {
            Known::Post(mark, self.run_state.packed().into())
        } else {
            Known::No
        }
    }

    /// The mark of the state that was packed last.
    fn mark(&self) -> Mark {
        Mark::of(self.run_state.split(self.run_state.packed()))
    }

    /// Judges the last move. Returns whether the search stops after it.
    fn look(&mut self, origin: Origin) -> bool {
        let shown = judge(&mut self.run_state, self.phase, &mut self.reached);
        let last = shown.iter().any(|shown| shown.last);
        shown.into_iter().for_each(|shown| self.note(shown, origin));
        last
    }

    fn note(&mut self, shown: Shown, origin: Origin) {
        if !self.walks.hits.iter().any(|known| known.shown.is_same(&shown)) {
            self.walks.hits.push(Hit { shown, origin });
        }
    }
}

/// The packet that a move removes from its link without delivering it.
const fn takes_away(step: CellMove) -> Option<u8> {
    match step {
        CellMove::Lose(_) | CellMove::Cut(..) | CellMove::Vanish(_) => step.packet(),
        _ => None,
    }
}
