//! Picks times for a path of zones, and replays it on plain ticks.

use super::runner::{From, Run};
use super::search::{Hit, Search, is_sampled};
use crate::cell::plan::{CellFaults, CellPlan, Times};
use crate::cell::run_state::CellMove;
use crate::cell::unpacked::Unpacked;
use crate::cell::verdict::{Finding, Phase};
use crate::cell::waiting::for_ever;
use crate::cell::{starve, story};
use crate::zone::dbm::Dbm;
use crate::zone::forks::again;
use std::sync::Arc;

/// A part of a path: moves, and the ticks after them in which nothing happens.
struct Leg {
    moves: Vec<CellMove>,
    silent: u64,
}

/// The finding, with moves at plain ticks that lead to it; `None` if no such moves were found.
pub fn told(
    plan: &Arc<CellPlan>,
    (phase, hypothesis): (Phase, usize),
    faults: &CellFaults,
    search: &mut Search,
    hit: &Hit,
) -> Option<Finding> {
    let legs = legs(search, hit)?;
    let plan = &Arc::new(CellPlan { times: Times::Every, ..CellPlan::clone(plan) });
    let moves = replayed(plan, (phase, faults), &legs, hit)?;
    let shown = starve::decided(plan, &moves, hit.shown.clone());
    Some(story::finding(plan, (phase, hypothesis), faults, moves, &shown))
}

/// The legs from the start to a finding, at times picked from its zone backwards.
fn legs(search: &mut Search, hit: &Hit) -> Option<Vec<Leg>> {
    let (mut run, mut zone, _) = rerun(search, hit.state, &hit.answers)?;
    run.moves.truncate(hit.moves);
    run.silent_until = None;
    let mut at = hit.state;
    let mut legs = Vec::new();
    loop {
        let point = zone.point();
        let silent = run.silent_until.map_or(0, |until| point[usize::from(until)] - run.now);
        legs.push(Leg { moves: std::mem::take(&mut run.moves), silent: u64::try_from(silent).ok()? });
        let Some(state) = at else { break };
        // The times of the state from which this leg began.
        let control = &search.store.states[state as usize];
        let times = &point[..control.zone.as_ref()?.len()];
        let origin = control.origins.iter().find(|origin| origin.zone.has(times))?;
        let (parent, answers) = (origin.parent, origin.answers.clone());
        let terms;
        (run, zone, terms) = rerun(search, parent, &answers)?;
        let (&(now, moved), others) = terms.split_first()?;
        for (&(variable, offset), &value) in others.iter().zip(&times[1..]) {
            let apart = value - offset + moved;
            zone.constrain(variable, now, apart).ok()?;
            zone.constrain(now, variable, -apart).ok()?;
        }
        at = parent;
    }
    legs.reverse();
    Some(legs)
}

/// A variable and an offset.
type Term = (usize, i64);

/// Makes a run again. Returns its zone, too, and the terms of the times at its end.
fn rerun(search: &mut Search, state: Option<u32>, answers: &[u16]) -> Option<(Run, Dbm, Vec<Term>)> {
    let Search { runner, store, .. } = search;
    let (zone, control) = match state {
        Some(at) => {
            let state = &store.states[at as usize];
            (state.zone.clone()?, store.controls[state.control as usize].clone())
        }
        None => (Dbm::zero(), Box::default()),
    };
    let from = if state.is_some() { From::Kept(&control) } else { From::Start };
    let ((run, terms), zone) = again(&zone, answers, |forks| {
        let run = runner.run(forks, from, is_sampled(state));
        let terms = forks.cut().times().terms();
        (run, terms)
    });
    Some((run, zone, terms))
}

/// The moves on plain ticks, if the last of them shows the finding.
fn replayed(
    plan: &Arc<CellPlan>,
    (phase, faults): (Phase, &CellFaults),
    legs: &[Leg],
    hit: &Hit,
) -> Option<Vec<CellMove>> {
    let mut replay =
        Replay { cell: Unpacked::new(plan, phase, faults), moves: Vec::new(), until: 0, last: Vec::new() };
    replay.last = replay.cell.shown();
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
    let run_state = &replay.cell.run_state;
    replay.last.extend([false, true].into_iter().filter_map(|goes_on| for_ever(run_state, goes_on)));
    replay.last.iter().any(|shown| shown.is_same(&hit.shown)).then_some(replay.moves)
}

/// A replay on plain ticks.
struct Replay {
    cell: Unpacked,
    moves: Vec<CellMove>,
    /// The tick until which time has passed on the path.
    until: u64,
    /// What the last move showed.
    last: Vec<crate::cell::judge::Shown>,
}

impl Replay {
    /// Makes a move, if it is possible.
    fn take(&mut self, step: CellMove) -> Option<()> {
        let mut moves = Vec::new();
        self.cell.run_state.moves(&mut moves);
        if !moves.contains(&step) {
            return None;
        }
        self.cell.take(step);
        self.moves.push(step);
        self.last = self.cell.shown();
        Some(())
    }

    /// Lets time pass. What may happen before the end of the wait does not: actions go on, packets stay on their links.
    fn wait(&mut self) -> Option<()> {
        loop {
            let left = self.until - self.cell.run_state.passed;
            let mut moves = Vec::new();
            self.cell.run_state.moves(&mut moves);
            if moves.contains(&CellMove::Pass) {
                match self.cell.run_state.next_event() {
                    Some(next) if next.0 <= left => self.take(CellMove::Pass)?,
                    // Nothing happens in the last tick.
                    _ => return Some(()),
                }
                if self.cell.run_state.passed == self.until {
                    return Some(());
                }
            } else {
                let goes_on = |step: &&CellMove| matches!(step, CellMove::GoOn(..) | CellMove::Stay(_));
                let step = *moves.iter().find(goes_on)?;
                self.take(step)?;
            }
        }
    }
}
