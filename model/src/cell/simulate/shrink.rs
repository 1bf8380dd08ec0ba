//! Shrinks the schedule of a finding, as long as the schedule still shows the same finding.
//!
//! First, faults are left out: there are few of them, each left-out fault may save many choices, and a person reads them
//! first. Then the numbers in the other faults are lowered. Then the choices are lowered, down to 0 if possible.

use super::driver::Source;
use super::run::{Limit, Run, run};
use super::schedule::{Chooser, Fault, Schedule, Tape};
use crate::cell::judge::Shown;
use crate::cell::plan::CellPlan;
use std::sync::Arc;

/// The greatest number of steps that shrinking one finding may take.
const MOST_STEPS: u64 = 4_000_000;

/// Shrinks one schedule.
pub(super) struct Shrinker<'a> {
    pub plan: &'a Arc<CellPlan>,
    /// The finding that the schedule must show.
    pub shown: &'a Shown,
    /// The limit of a run. Its stop flag also stops shrinking.
    pub limit: Limit<'a>,
    /// The smallest schedule so far that shows the finding.
    pub best: Schedule,
    pub spent: u64,
}

/// The number of moves in a run to this finding; `None` if the run does not show the finding.
pub(super) fn moves_to(run: &Run, shown: &Shown) -> Option<usize> {
    run.shown.iter().find(|(_, known)| known.is_same(shown)).map(|&(at, _)| at)
}

impl Shrinker<'_> {
    /// Shrinks the schedule. Returns false if shrinking was stopped, or took too many steps.
    pub fn shrink(&mut self) -> bool {
        loop {
            let before = self.best.clone();
            let tape = self.best.tape.clone();
            let faults = self.best.faults.clone();
            reduce(faults, &mut |faults| {
                self.shows(|| Schedule { faults: faults.to_vec(), tape: tape.clone() })
            });
            self.simplify();
            self.choices();
            if self.is_spent() {
                return false;
            }
            if self.best == before {
                return true;
            }
        }
    }

    fn is_spent(&self) -> bool {
        self.spent >= MOST_STEPS || self.limit.is_stopped()
    }

    /// Tries a schedule, and keeps the schedule if it shows the same finding. `None`: shrinking was stopped.
    fn shows(&mut self, schedule: impl FnOnce() -> Schedule) -> Option<bool> {
        if self.is_spent() {
            return None;
        }
        let schedule = schedule();
        let run = run(self.plan, &schedule.faults, Source::Tape(&schedule.tape), self.limit);
        self.spent += run.moves.len() as u64 + 1;
        let shows = moves_to(&run, self.shown).is_some();
        if shows {
            self.best = schedule;
        }
        Some(shows)
    }

    /// Lowers the numbers of the schedule's faults, such as instants and durations.
    fn simplify(&mut self) {
        for at in 0..self.best.faults.len() {
            if let Fault::Stop { node, at: instant, restart: Some(_) } = self.best.faults[at] {
                let mut schedule = self.best.clone();
                schedule.faults[at] = Fault::Stop { node, at: instant, restart: None };
                self.shows(|| schedule);
            }
            for (number, from) in numbers(&self.best.faults[at]).into_iter().enumerate() {
                lower(from, &mut |value| {
                    let mut schedule = self.best.clone();
                    schedule.faults[at] = with_number(&schedule.faults[at], number, value);
                    self.shows(|| schedule)
                });
            }
        }
    }

    /// Sets choices to 0, or lowers them.
    fn choices(&mut self) {
        let chosen = flat(&self.best.tape);
        let faults = self.best.faults.clone();
        let with = |chosen: &[Choice]| Schedule { faults: faults.clone(), tape: tape(chosen) };
        let mut chosen = reduce(chosen, &mut |chosen| self.shows(|| with(chosen)));
        for at in 0..chosen.len() {
            let now = u64::from(chosen[at].2);
            let least = lower((1, now), &mut |value| {
                chosen[at].2 = u32::try_from(value).unwrap_or(u32::MAX);
                self.shows(|| with(&chosen))
            });
            chosen[at].2 = u32::try_from(least).unwrap_or(u32::MAX);
        }
        // A choice past the end of the tape is 0, so zeros at the end of a tape are left out.
        self.best.tape = tape(&flat(&self.best.tape));
    }
}

/// Binary search for the least number from `least` to `now` for which `holds` is true. Assumes that `holds` is true for all
/// larger numbers, and for `now`. If `holds` returns `None`, the search ends.
fn lower((least, now): (u64, u64), holds: &mut dyn FnMut(u64) -> Option<bool>) -> u64 {
    if now <= least {
        return now;
    }
    let (mut fails, mut held) = match holds(least) {
        Some(true) => return least,
        Some(false) => (least, now),
        None => return now,
    };
    while held - fails > 1 {
        let middle = fails + (held - fails) / 2;
        match holds(middle) {
            Some(true) => held = middle,
            Some(false) => fails = middle,
            None => break,
        }
    }
    held
}

/// A choice that is not 0: its chooser, its position on that chooser's tape, and its value.
type Choice = (Chooser, usize, u32);

fn flat(tape: &Tape) -> Vec<Choice> {
    let all = tape
        .iter()
        .flat_map(|(&who, made)| made.iter().enumerate().map(move |(at, &choice)| (who, at, choice)));
    all.filter(|&(.., choice)| choice != 0).collect()
}

fn tape(choices: &[Choice]) -> Tape {
    let mut tape = Tape::new();
    for &(who, at, choice) in choices {
        let made = tape.entry(who).or_default();
        made.resize(made.len().max(at + 1), 0);
        made[at] = choice;
    }
    tape
}

/// Delta debugging: leaves out smaller and smaller parts of a list as long as `holds` is true for the remaining list. At
/// the end no single item can be left out. If `holds` returns `None`, the function ends early.
fn reduce<T: Clone>(mut all: Vec<T>, holds: &mut dyn FnMut(&[T]) -> Option<bool>) -> Vec<T> {
    if all.is_empty() || holds(&[]) == Some(true) {
        return Vec::new();
    }
    let mut part = all.len().div_ceil(2);
    loop {
        let mut at = 0;
        let mut left_out = false;
        while at < all.len() {
            let rest = [&all[..at], &all[(at + part).min(all.len())..]].concat();
            let holds = if rest.is_empty() { Some(false) } else { holds(&rest) };
            match holds {
                Some(true) => (all, left_out) = (rest, true),
                Some(false) => at += part,
                None => return all,
            }
        }
        match part {
            1 if !left_out => return all,
            1 => {}
            _ => part = part.div_ceil(2),
        }
    }
}

/// For each number in a fault, the least value that it may have, and its present value.
fn numbers(fault: &Fault) -> Vec<(u64, u64)> {
    match *fault {
        Fault::Lose { nth, .. }
        | Fault::Copy { nth, .. }
        | Fault::Overtake { nth, .. }
        | Fault::Fail { nth, .. } => {
            vec![(1, nth.into())]
        }
        Fault::Stop { at, restart, .. } => vec![(0, at), (0, restart.unwrap_or(0))],
        Fault::Cut { at, lasts, .. } => vec![(0, at), (0, lasts.unwrap_or(0))],
        Fault::Pause { at, lasts, .. } => vec![(0, at), (1, lasts.into())],
        Fault::Drift { at, .. } => vec![(0, at)],
    }
}

/// The same fault with another value for one of its numbers.
fn with_number(fault: &Fault, number: usize, value: u64) -> Fault {
    let mut fault = fault.clone();
    match (&mut fault, number) {
        (
            Fault::Lose { nth, .. }
            | Fault::Copy { nth, .. }
            | Fault::Overtake { nth, .. }
            | Fault::Fail { nth, .. },
            _,
        ) => *nth = u32::try_from(value).unwrap_or(u32::MAX),
        (
            Fault::Stop { at, .. }
            | Fault::Cut { at, .. }
            | Fault::Pause { at, .. }
            | Fault::Drift { at, .. },
            0,
        ) => *at = value,
        (Fault::Pause { lasts, .. }, _) => *lasts = u32::try_from(value).unwrap_or(u32::MAX),
        (Fault::Stop { restart: span, .. } | Fault::Cut { lasts: span, .. }, _) => {
            span.iter_mut().for_each(|span| *span = value);
        }
        (Fault::Drift { .. }, _) => {}
    }
    fault
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_is_needed() {
        for needed in [vec![], vec![3], vec![0, 17], vec![5, 6, 19], (0..20).collect()] {
            let mut asked = 0;
            let holds = &mut |left: &[u32]| {
                asked += 1;
                Some(needed.iter().all(|one| left.contains(one)))
            };
            assert_eq!(reduce((0..20).collect(), holds), needed);
            assert!(asked < 400, "{asked}");
        }
    }

    #[test]
    fn the_least_number_is_found_in_few_tries() {
        for (least, now, needed) in
            [(0, 0, 0), (1, 1, 1), (0, 1_000_000, 0), (1, 1_000_000, 123_457), (0, 9, 9)]
        {
            let mut asked = 0;
            let holds = &mut |value| {
                asked += 1;
                Some(value >= needed)
            };
            assert_eq!(lower((least, now), holds), needed);
            assert!(asked <= 21, "{asked}");
        }
    }
}
