//! Finds the checks whose values a move may have changed: only these checks are evaluated.
//!
//! A variable changes only in a step of its task's script, or when its node crashes or restarts. So a check that reads only
//! variables of other tasks keeps its value. A predicate may change with any move.
//!
//! In steps from a sampled state, the checks that kept their values are evaluated, too, and must give the same values.

use super::{CellMove, RunState, bit};
use crate::cell::plan::{CellPlan, Holds};
use crate::cell_state::CellState;
use crate::cell_state::script::ScriptReaction;
use crate::state::Violation;
use imrs_protocol::Ticks;
use imrs_protocol::script::{Reading, Term, eval};

/// All tasks, as a bit set.
const ALL: u64 = u64::MAX;

/// The last values of the checks, and what the last move may have changed.
#[derive(Clone, Debug)]
pub(super) struct Evaluated {
    /// For each check, the tasks whose variables it reads, as a bit set.
    reads: Vec<u64>,
    /// For each check, the last values of its two sides; `None` after a state was loaded. An `always` check has one side,
    /// which counts as the right one.
    values: Vec<Option<[bool; 2]>>,
    /// The tasks whose variables the last move may have changed, as a bit set.
    touched: u64,
    /// Whether the evaluation in a sampled step gave a check another value than the kept value, which is a fault of the
    /// checker.
    is_stale: bool,
}

impl Evaluated {
    pub fn new(plan: &CellPlan) -> Self {
        let reads = |check| plan.terms(check).into_iter().fold(0, |all, term| all | tasks_of(term));
        let count = plan.checks.len();
        Self {
            reads: (0..count).map(reads).collect(),
            values: vec![None; count],
            touched: ALL,
            is_stale: false,
        }
    }

    /// Called after a kept state was loaded. No check is broken in such a state, and its obligations are part of it.
    pub fn forget(&mut self) {
        self.values.fill(None);
    }

    /// Notes what a move may have changed.
    pub fn note(&mut self, plan: &CellPlan, step: CellMove, turns: &[ScriptReaction]) {
        let anew = matches!(step, CellMove::Crash(_) | CellMove::Restart(_));
        self.touched = if anew || plan.everything {
            ALL
        } else {
            turns.iter().fold(0, |touched, turn| touched | bit(turn.task))
        };
    }

    /// Whether the last move may have changed the value of a term.
    pub fn touches(&self, term: Term) -> bool {
        self.touches_any(tasks_of(term))
    }

    /// Whether the last move may have changed a value that depends on these tasks.
    const fn touches_any(&self, tasks: u64) -> bool {
        self.touched == ALL || tasks == ALL || tasks & self.touched != 0
    }

    /// The values of both sides of a check; `None` if they are the same as when the state was kept.
    pub fn values(&mut self, at: usize, holds: &Holds, cell: &CellState) -> Option<[bool; 2]> {
        let may_differ = self.touches_any(self.reads[at]);
        if !may_differ && !cell.is_sampled {
            return self.values[at];
        }
        let is = |terms: &[Term]| eval(terms, |term| cell.look_up(term)).is_ok_and(|value| value != 0);
        let (now, when_kept) = match holds {
            Holds::Always(terms) => ([false, is(terms)], Some([false, true])),
            Holds::Leads { when, then, .. } => ([is(when), is(then)], None),
        };
        if may_differ {
            self.values[at] = Some(now);
        } else {
            self.is_stale |= self.values[at].or(when_kept).is_some_and(|granted| granted != now);
        }
        self.values[at]
    }
}

/// The tasks on which the value of a term depends, as a bit set.
fn tasks_of(term: Term) -> u64 {
    match term.reads() {
        Some(Reading::Variable(task, _)) => bit(task.index()),
        Some(Reading::Predicate(_)) => ALL,
        None => 0,
    }
}

impl RunState {
    /// Evaluates the checks whose values may have changed, and whether both tasks of a couple act.
    pub(super) fn look(&mut self) {
        for at in 0..self.plan.checks.len() {
            if !self.plan.has_check(at) {
                continue;
            }
            let check = &self.plan.checks[at];
            let Some([when, then]) = self.checks.values(at, &check.holds, &self.cell) else { continue };
            match &check.holds {
                Holds::Always(_) => {
                    if !then {
                        self.broken.push(at);
                    }
                }
                Holds::Leads { within, .. } => {
                    let due = &mut self.beside.due[at];
                    self.mattered[at] |= when;
                    if then {
                        *due = None;
                    } else if when && due.is_none() && !self.broken.contains(&at) {
                        *due = Some(Ticks(within.0.min(u64::from(u32::MAX - 1))));
                    }
                }
            }
        }
        if std::mem::take(&mut self.checks.is_stale) {
            self.cell.violation = Some(Violation::StaleCheck);
        }
        self.mix();
        let couples = &self.plan.table.cell().couples;
        self.both_active =
            couples.iter().any(|couple| self.acts(couple.primary) && self.acts(couple.standby));
    }

    /// Whether the last move may have changed the value of a term.
    pub fn touches(&self, term: Term) -> bool {
        self.checks.touches(term)
    }
}
