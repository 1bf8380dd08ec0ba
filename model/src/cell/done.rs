//! The result of one phase of a check (one search of the cell: without faults, or with one fault hypothesis), before
//! the verdict is made of it.

use super::judge::Reached;
use super::plan::Part;
use super::verdict::{Coverage, Finding, Unfinished};

/// The result of a phase, or of the search of one independent part in it.
pub(super) struct Done {
    pub coverage: Coverage,
    pub findings: Vec<Finding>,
    pub warnings: Vec<Finding>,
    pub reached: Reached,
    /// For each check, whether its left side was ever true.
    pub mattered: Vec<bool>,
}

impl Done {
    /// Adds what an earlier search of the same phase, at other event times, found and reached, and its time.
    pub fn with(mut self, earlier: Option<Self>) -> Self {
        if let Some(earlier) = earlier {
            self.findings.extend(earlier.findings);
            self.warnings.extend(earlier.warnings);
            self.coverage.seconds += earlier.coverage.seconds;
            if earlier.coverage.times > self.coverage.times {
                self.coverage.finer = Some(Box::new(earlier.coverage));
            }
            self.reached = self.reached.join(earlier.reached);
            self.mattered.iter_mut().zip(earlier.mattered).for_each(|(all, one)| *all |= one);
        }
        self
    }

    /// Joins the results of two parts; `part` is the part that `other` searched.
    pub fn beside(mut self, other: Self, part: &Part) -> Self {
        self.coverage.join(other.coverage);
        self.findings.extend(other.findings);
        self.warnings.extend(other.warnings);
        let reached = other.reached.statements.into_iter().flatten();
        self.reached.statements.iter_mut().flatten().zip(reached).for_each(|(all, one)| *all |= one);
        take_checks(&mut self.reached.still, other.reached.still, part);
        take_checks(&mut self.mattered, other.mattered, part);
        self
    }
}

impl Coverage {
    /// Joins what the searches of two parts have covered.
    fn join(&mut self, one: Self) {
        let all = self;
        let whole = match (all.complete, one.complete) {
            (true, true) => all.whole_depth.max(one.whole_depth),
            (true, false) => one.whole_depth,
            (false, true) => all.whole_depth,
            (false, false) => all.whole_depth.min(one.whole_depth),
        };
        all.whole_depth = whole;
        all.times = all.times.min(one.times);
        all.states += one.states;
        all.inexact += one.inexact;
        all.moves += one.moves;
        all.depth = all.depth.max(one.depth);
        all.ticks = all.ticks.max(one.ticks);
        all.complete &= one.complete;
        all.pruned |= one.pruned;
        all.ended_by = all.ended_by.take().or(one.ended_by);
        all.unfinished = match (all.unfinished.take(), one.unfinished) {
            (Some(mine), Some(other)) => Some(Unfinished { open: mine.open + other.open, ..mine }),
            (mine, other) => mine.or(other),
        };
        all.finer = match (all.finer.take(), one.finer) {
            (Some(mut mine), Some(other)) => {
                mine.join(*other);
                Some(mine)
            }
            (mine, other) => mine.or(other),
        };
        all.longest_state = all.longest_state.max(one.longest_state);
        all.seconds += one.seconds;
    }
}

/// Copies the entries of those checks that belong to a part.
pub(super) fn take_checks<T>(all: &mut [T], other: Vec<T>, part: &Part) {
    for (check, (mine, other)) in all.iter_mut().zip(other).enumerate() {
        if part.has_check(check) {
            *mine = other;
        }
    }
}
