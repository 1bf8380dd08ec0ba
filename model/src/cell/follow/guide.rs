//! Finds roundings of recorded times with which the model can follow a run.
//!
//! An event between two ticks of the model may count for either tick. First every time is rounded down. If the model cannot
//! follow the run with these ticks, one of the latest times is rounded up instead, the latest first. The other rounding may
//! put two times of one tick in order, or make the time between two events a tick longer or shorter.

use super::run::{Followed, Run, Unexplained};
use super::{Follower, Rounding, Stop};
use crate::cell::outside::with_programs;
use crate::cell::plan::CellPlan;
use imrs_protocol::TaskId;
use std::cmp::Reverse;
use std::sync::Arc;
use std::time::Instant;

/// The number of inputs between two kept states of the follower. The search for roundings returns to a kept state to try
/// another rounding.
const KEEP_EVERY: usize = 32;
/// The greatest number of the last inputs whose roundings a search may change.
const BACK: usize = 400;
/// A rounding is adopted at once if the model then follows this many inputs past the input at which it was stuck.
const BEYOND: usize = 12;

/// `DEEP`: how many roundings one search combines at most. `WIDTH`: to how many of the best trials a search adds a
/// further rounding.
const DEEP: usize = 4;
const WIDTH: usize = 3;

/// How far the model follows the run after the time of one more input was rounded otherwise.
struct Trial {
    follower: Follower,
    rounded: (usize, usize),
    stuck: Option<Unexplained>,
    led: bool,
}

struct Guide {
    start: Instant,
    seconds: f64,
    /// The follower of the run as far as it got, and earlier states to which the search can return.
    at: Follower,
    kept: Vec<Follower>,
}

/// Follows a run through the model, with the faults of the run. The faults that the plan declares are not used.
#[must_use]
pub fn follow_run(plan: &Arc<CellPlan>, run: &Run) -> Followed {
    let plan = with_programs(plan);
    let at = Follower::new(&plan, run);
    let kept = vec![at.clone()];
    let mut guide = Guide { start: Instant::now(), seconds: plan.budget.seconds, at, kept };
    let stuck = guide.follow();
    let mut follower = guide.at;
    follower.count_lost();
    let unsure = matches!(&stuck, Ok(Some(stuck)) if !stuck.however
        && (follower.was_late(BACK) || follower.is_tied(stuck.task.index())));
    let mut out = follower.out;
    out.inputs = follower.done.len() as u64;
    out.guessed = follower.guessed;
    out.rounded = follower.roundings.len() as u64;
    match stuck {
        Ok(unexplained) => {
            out.unsure = unsure;
            out.unexplained = unexplained;
        }
        Err(by) => out.ended_by = Some(by),
    }
    out
}

impl Guide {
    fn follow(&mut self) -> Result<Option<Unexplained>, String> {
        loop {
            let far = self.at.done.len() + KEEP_EVERY;
            match self.at.go(far) {
                Stop::Over => return Ok(None),
                Stop::Far => self.keep(),
                Stop::Stuck(stuck) => {
                    if stuck.however || !self.round_otherwise(&stuck, DEEP)? {
                        return Ok(Some(stuck));
                    }
                }
            }
            if self.start.elapsed().as_secs_f64() > self.seconds {
                return Err(format!("{} seconds", self.seconds));
            }
        }
    }

    fn keep(&mut self) {
        self.kept.push(self.at.clone());
        if self.kept.len() > BACK.div_ceil(KEEP_EVERY) + 2 {
            self.kept.remove(0);
        }
    }

    /// Tries other roundings of earlier times until the model can follow the run past `stuck`. Returns whether it can.
    /// If no single rounding leads [`BEYOND`] inputs further, a second rounding is added to the best trials.
    fn round_otherwise(&mut self, stuck: &Unexplained, deep: usize) -> Result<bool, String> {
        let mut better = self.trials(stuck)?;
        if better.first().is_some_and(|trial| trial.led) {
            let trial = better.swap_remove(0);
            self.adopt(trial.follower, trial.rounded);
            return Ok(true);
        }
        better.sort_by_key(|trial| Reverse(trial.follower.done.len()));
        better.truncate(if deep > 1 { WIDTH } else { 0 });
        for Trial { follower, rounded, stuck, .. } in better {
            let (at, kept) = (self.at.clone(), self.kept.clone());
            self.adopt(follower, rounded);
            if let Some(stuck) = stuck
                && self.round_otherwise(&stuck, deep - 1)?
            {
                return Ok(true);
            }
            (self.at, self.kept) = (at, kept);
        }
        Ok(false)
    }

    /// Continues from the state of a trial. Drops the kept states that already contain the input whose time the
    /// trial rounds otherwise.
    fn adopt(&mut self, follower: Follower, rounded: (usize, usize)) {
        self.kept.retain(|kept| !kept.done.contains(&rounded));
        self.at = follower;
    }

    /// Tries other roundings. Returns all trials that follow more inputs, or only the first trial that follows [`BEYOND`]
    /// more inputs.
    fn trials(&self, stuck: &Unexplained) -> Result<Vec<Trial>, String> {
        let reached = self.at.done.len();
        let node = self.at.node_of(stuck.task);
        let mut candidates: Vec<(usize, usize)> = self.at.done.iter().rev().take(BACK).copied().collect();
        candidates.insert(0, self.at.stuck_at(stuck.task));
        // Inputs of the stuck input's node come first.
        candidates.sort_by_key(|&(task, _)| self.at.node_of(TaskId::from_index(task)) != node);
        let mut better = Vec::new();
        for rounded in candidates {
            let before = |follower: &&Follower| !follower.done.contains(&rounded);
            let Some(before) = self.kept.iter().rev().find(before) else { continue };
            for by in Rounding::ALL {
                if self.start.elapsed().as_secs_f64() > self.seconds {
                    return Err(format!("{} seconds", self.seconds));
                }
                let mut follower = before.clone();
                follower.roundings.clone_from(&self.at.roundings);
                if follower.roundings.insert(rounded, by) == Some(by) {
                    continue;
                }
                let stuck = match follower.go(reached + BEYOND) {
                    Stop::Over | Stop::Far => None,
                    Stop::Stuck(stuck) => Some(stuck),
                };
                let led = stuck.is_none();
                if led {
                    return Ok(vec![Trial { follower, rounded, stuck, led }]);
                }
                if follower.done.len() > reached {
                    better.push(Trial { follower, rounded, stuck, led });
                }
            }
        }
        Ok(better)
    }
}
