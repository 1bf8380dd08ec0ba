//! What follows from one state: its moves, each walked on while there is only one.

use super::course::{CellMove, Course};
use super::judge::{Reached, Shown, deadlock, judge, nothing_reached};
use super::seen::{Mark, Seen};
use super::verdict::{Kind, Phase};
use crate::state::Violation;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

/// How many moves without an alternative are walked through before a state is kept.
pub(super) const WALK: usize = 64;

/// How a kept state was first reached: from which, by which of its moves, and in how many choices.
#[derive(Clone, Copy)]
pub(super) struct Origin {
    pub parent: u32,
    pub choice: u16,
    pub depth: u16,
}

/// A finding on the move number `steps` after `origin`.
pub(super) struct Hit {
    pub shown: Shown,
    pub origin: Origin,
    pub steps: usize,
}

/// Where a walk ended.
pub(super) struct Stop {
    pub origin: Origin,
    pub mark: Mark,
    pub state: Box<[u8]>,
}

/// What some walks came to, in their order.
#[derive(Default)]
pub(super) struct Walks {
    pub stops: Vec<Stop>,
    pub hits: Vec<Hit>,
    pub moves: u64,
    /// Whether some state had no packed form: what follows it was not looked at.
    pub outgrown: bool,
}

/// Walks from states that others give it.
pub(super) struct Walker {
    phase: Phase,
    course: Course,
    pub reached: Reached,
    walks: Walks,
    all: Vec<CellMove>,
}

impl Walker {
    pub fn new(phase: Phase, course: Course) -> Self {
        let reached = nothing_reached(&course);
        Self { phase, course, reached, walks: Walks::default(), all: Vec::new() }
    }

    /// For each check, whether what makes it matter was ever seen.
    pub fn mattered(&self) -> &[bool] {
        &self.course.mattered
    }

    /// What the walks came to since the last call.
    pub fn take(&mut self) -> Walks {
        std::mem::take(&mut self.walks)
    }

    /// Walks from the start of the cell.
    pub fn start(&mut self, seen: &Seen) {
        self.walk(Origin { parent: u32::MAX, choice: 0, depth: 0 }, None, seen);
    }

    /// Walks from a kept state, by each of its moves.
    pub fn expand(&mut self, at: u32, depth: u16, state: &[u8], seen: &Seen) {
        self.course.load(state);
        let mut all = std::mem::take(&mut self.all);
        all.clear();
        self.course.moves(&mut all);
        let mut moves: Vec<(u16, CellMove)> = (0_u16..).zip(all.iter().copied()).collect();
        self.all = all;
        let mut fresh = !self.leave_out(state, &mut moves);
        for (choice, step) in moves {
            if !std::mem::take(&mut fresh) {
                self.course.load(state);
            }
            self.walk(Origin { parent: at, choice, depth }, Some(step), seen);
        }
    }

    /// Leaves out what takes a packet away that changes nothing where it arrives: the same happens when it arrives, with
    /// more of the budget left, and a cut may as well begin with the next packet, or end before it. Says whether the
    /// course was used.
    fn leave_out(&mut self, state: &[u8], moves: &mut Vec<(u16, CellMove)>) -> bool {
        if self.course.plan.everything {
            return false;
        }
        let mut taken: Vec<u8> = moves.iter().filter_map(|&(_, step)| takes_away(step)).collect();
        taken.dedup();
        for &i in &taken {
            let comes = |&&(_, step): &&(u16, CellMove)| matches!(step, CellMove::Deliver(at) | CellMove::Mend(at, _) if at == i);
            let Some(&(_, arrives)) = moves.iter().find(comes) else { continue };
            let course = &mut self.course;
            let with = catch_unwind(AssertUnwindSafe(|| course.after(state, arrives)));
            let without = course.without(state, i);
            if !matches!(with, Ok(Some(with)) if with == without) {
                continue;
            }
            let cut = moves.iter().any(|&(_, step)| step == CellMove::Vanish(i));
            moves.retain(|&(_, step)| match step {
                CellMove::Lose(at) | CellMove::Cut(at, _) => at != i,
                CellMove::Mend(at, _) => at != i || !cut,
                _ => true,
            });
        }
        !taken.is_empty()
    }

    /// Makes a move, and goes on while there is only one.
    fn walk(&mut self, origin: Origin, first: Option<CellMove>, seen: &Seen) {
        let mut step = first;
        let mut moves = Vec::new();
        for steps in 1..=WALK {
            if let Some(step) = step {
                self.apply(step);
            }
            if self.look(origin, steps) {
                return;
            }
            moves.clear();
            self.course.moves(&mut moves);
            if !moves.iter().any(|step| !matches!(step, CellMove::Crash(_) | CellMove::Restart(_))) {
                if let Some(shown) = deadlock(&self.course) {
                    self.note(shown, origin, steps);
                }
                if moves.is_empty() {
                    return;
                }
            }
            match moves[..] {
                [only] if steps < WALK => step = Some(only),
                _ => break,
            }
            if self.is_covered(&moves, seen) {
                return;
            }
        }
        match self.course.store() {
            Ok(state) => {
                let mark = Mark::of(self.course.split(&state));
                if !seen.covers(mark) {
                    self.walks.stops.push(Stop { origin, mark, state });
                }
            }
            // As when members of a meeting give up by themselves for ever: their rounds differ more and more.
            Err(Violation::Overflow) => self.walks.outgrown = true,
            Err(violation) => {
                self.note(Shown::whole(Kind::Machine, violation.text()), origin, WALK);
            }
        }
    }

    fn apply(&mut self, step: CellMove) {
        self.walks.moves += 1;
        let course = &mut self.course;
        if catch_unwind(AssertUnwindSafe(|| course.apply(step))).is_err() {
            let mattered = std::mem::take(&mut self.course.mattered);
            self.course = Course::new(&Arc::clone(&self.course.plan), &self.course.faults.clone());
            self.course.mattered = mattered;
            self.course.floor.violation = Some(Violation::Panic);
        }
    }

    /// Whether a state with more left to go wrong was kept here: where packets arrive there was a choice then.
    fn is_covered(&mut self, moves: &[CellMove], seen: &Seen) -> bool {
        if self.phase != Phase::Faults || !matches!(moves, [CellMove::Deliver(_) | CellMove::Vanish(_)]) {
            return false;
        }
        let Ok(state) = self.course.store() else { return false };
        seen.covers(Mark::of(self.course.split(&state)))
    }

    /// Notes what the last move showed; whether nothing that follows is looked at.
    fn look(&mut self, origin: Origin, steps: usize) -> bool {
        let shown = judge(&mut self.course, self.phase, &mut self.reached);
        let last = shown.iter().any(|shown| shown.last);
        shown.into_iter().for_each(|shown| self.note(shown, origin, steps));
        last
    }

    fn note(&mut self, shown: Shown, origin: Origin, steps: usize) {
        if !self.walks.hits.iter().any(|known| known.shown.is_same(&shown)) {
            self.walks.hits.push(Hit { shown, origin, steps });
        }
    }
}

/// The packet that a move takes off its link without an arrival.
const fn takes_away(step: CellMove) -> Option<u8> {
    match step {
        CellMove::Lose(i) | CellMove::Cut(i, _) | CellMove::Vanish(i) => Some(i),
        CellMove::Pass
        | CellMove::Drift(..)
        | CellMove::Deliver(_)
        | CellMove::Duplicate(_)
        | CellMove::Mend(..)
        | CellMove::Acted(..)
        | CellMove::GoOn(..)
        | CellMove::Stay(_)
        | CellMove::Choose(..)
        | CellMove::Crash(_)
        | CellMove::Restart(_) => None,
    }
}
