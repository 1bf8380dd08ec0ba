//! Picks times for a path that the search by zones found, and replays the path on plain ticks.

use super::origins::Origin;
use super::runner::{From, Run, puts_off};
use super::search::{Hit, Search, is_sampled};
use crate::cell::judge::Shown;
use crate::cell::plan::{CellFaults, CellPlan};
use crate::cell::run_state::CellMove;
use crate::cell::unpacked::Unpacked;
use crate::cell::verdict::{Finding, Phase};
use crate::cell::waiting::for_ever;
use crate::cell::{starve, story};
use crate::zone::dbm::Dbm;
use crate::zone::forks::again;
use std::sync::Arc;

/// A part of a path: some moves, and then ticks in which nothing happens.
pub(super) struct Leg {
    pub moves: Vec<CellMove>,
    pub silent: u64,
}

/// The finding, with moves on plain ticks that lead to it; `None` if no such moves were found.
pub fn told(
    plan: &Arc<CellPlan>,
    (phase, hypothesis): (Phase, usize),
    faults: &CellFaults,
    search: &mut Search,
    hit: &Hit,
) -> Option<Finding> {
    let (mut run, zone, _) = rerun(search, hit.state, &hit.answers)?;
    run.moves.truncate(hit.moves);
    run.silent_until = None;
    let legs = legs_to(search, hit.state, zone, Some(run))?;
    let replay = Replay::of(plan, (phase, faults), &legs)?;
    let moves = replay.shows(&hit.shown).then_some(replay.moves)?;
    let shown = starve::decided(plan, &moves, hit.shown.clone());
    Some(story::finding(plan, (phase, hypothesis), faults, moves, &shown))
}

/// Moves on plain ticks that lead to a kept state, at one of the times in the state's zone.
pub fn moves_to(
    plan: &Arc<CellPlan>,
    of: (Phase, &CellFaults),
    search: &mut Search,
    state: u32,
) -> Option<Vec<CellMove>> {
    let zone = search.store.zone(state)?;
    let legs = legs_to(search, Some(state), zone, None)?;
    Some(Replay::of(plan, of, &legs)?.moves)
}

impl Leg {
    /// The leg for a run: the run's moves, and the silent ticks after them, whose number is read from a point of the
    /// run's zone. Takes the moves out of the run.
    fn of(run: &mut Run, point: &[i64]) -> Option<Self> {
        let silent = run.silent_until.map_or(0, |until| point[usize::from(until)] - run.now);
        Some(Self { moves: std::mem::take(&mut run.moves), silent: u64::try_from(silent).ok()? })
    }
}

/// The legs of a path from the start to the end of a run that begins in the state `at`. Times are picked backwards,
/// from the end to the start. The first variables of the zone are the times of the state.
fn legs_to(
    search: &mut Search,
    mut at: Option<u32>,
    mut zone: Dbm,
    mut last: Option<Run>,
) -> Option<Vec<Leg>> {
    let mut legs = Vec::new();
    loop {
        // A run that leads to the state, at some times of the zone.
        let before = match at {
            Some(state) => {
                let origins: Vec<Origin> = search.store.origins(state).collect();
                Some(origins.into_iter().find_map(|Origin { parent, answers }| {
                    let (run, times, terms) = rerun(search, parent, &answers)?;
                    let reached = times.project(&terms);
                    let point = zone.within(&reached).ok()?.point();
                    Some((parent, run, times, terms, point))
                })?)
            }
            None => None,
        };
        if let Some(mut run) = last.take() {
            let point = before.as_ref().map_or_else(|| zone.point(), |(.., point)| point.clone());
            legs.push(Leg::of(&mut run, &point)?);
        }
        let Some((parent, run, mut cut, terms, point)) = before else {
            legs.reverse();
            return Some(legs);
        };
        let (&(now, moved), others) = terms.split_first()?;
        for (&(variable, offset), &value) in others.iter().zip(&point[1..]) {
            let apart = value - offset + moved;
            cut.constrain(variable, now, apart).ok()?;
            cut.constrain(now, variable, -apart).ok()?;
        }
        (at, zone, last) = (parent, cut, Some(run));
    }
}

/// A time: a variable and an offset.
type Term = (usize, i64);

/// Makes a run again. Returns the run, its zone, and the times of the state at its end, as terms.
fn rerun(search: &mut Search, state: Option<u32>, answers: &[u16]) -> Option<(Run, Dbm, Vec<Term>)> {
    let Search { runners, store, .. } = search;
    let runner = &mut runners[0];
    let (zone, control) = match state {
        Some(at) => {
            let control = store.states[at as usize].control;
            (store.zone(at)?, store.controls[control as usize].clone())
        }
        None => (Dbm::zero(), Arc::default()),
    };
    let from = if state.is_some() { From::Kept(&control) } else { From::Start };
    runner.begin_state();
    let ((run, terms), zone) = again(&zone, answers, |forks| {
        let run = runner.run(forks, from, is_sampled(state));
        let terms = forks.cut().times().terms();
        (run, terms)
    });
    Some((run, zone, terms))
}

/// A replay of a path on plain ticks.
pub(super) struct Replay {
    cell: Unpacked,
    pub moves: Vec<CellMove>,
    /// The tick up to which time has passed on the path.
    until: u64,
    /// The findings of the last move.
    last: Vec<Shown>,
}

impl Replay {
    /// Replays the legs of a path; `None` if some move is not possible.
    pub fn of(plan: &Arc<CellPlan>, (phase, faults): (Phase, &CellFaults), legs: &[Leg]) -> Option<Self> {
        let mut cell = Unpacked::new(plan, phase, faults);
        let mut replay = Self { last: cell.shown(), cell, moves: Vec::new(), until: 0 };
        for leg in legs {
            for &step in &leg.moves {
                if step == CellMove::Pass {
                    replay.until += 1;
                    replay.wait()?;
                } else {
                    replay.take(step)?;
                }
            }
            replay.until += leg.silent;
        }
        Some(replay)
    }

    /// Whether the last move shows this finding.
    pub fn shows(&self, shown: &Shown) -> bool {
        let waits = [false, true].into_iter().filter_map(|goes_on| for_ever(&self.cell.run_state, goes_on));
        self.last.iter().cloned().chain(waits).any(|last| last.is_same(shown))
    }

    /// Makes a move, before which other actions and packets may be put off; `None` if it is not possible.
    fn take(&mut self, step: CellMove) -> Option<()> {
        let mut moves = Vec::new();
        self.cell.run_state.moves(&mut moves);
        if !moves.contains(&step) {
            self.take(*moves.iter().find(|&&step| puts_off(step))?)?;
            return self.take(step);
        }
        self.cell.take(step);
        self.moves.push(step);
        self.last = self.cell.shown();
        Some(())
    }

    /// Lets time pass up to `until`. Nothing happens before that tick, even if it may: actions go on, and packets stay on
    /// their links.
    fn wait(&mut self) -> Option<()> {
        loop {
            let left = self.until - self.cell.run_state.passed;
            let mut moves = Vec::new();
            self.cell.run_state.moves(&mut moves);
            if moves.contains(&CellMove::Pass) {
                match self.cell.run_state.next_event() {
                    Some(next) if next.0 <= left => self.take(CellMove::Pass)?,
                    // The last tick of the wait has been reached.
                    _ => return Some(()),
                }
                if self.cell.run_state.passed == self.until {
                    return Some(());
                }
            } else {
                self.take(*moves.iter().find(|&&step| puts_off(step))?)?;
            }
        }
    }
}
