//! Runs a cell on plain ticks with a fixed time for each action and each packet, in every order of what happens in one tick.

use super::found::Found;
use crate::cell::run_state::CellMove;
use crate::cell::unpacked::Unpacked;
use crate::cell::verdict::Kind;
use crate::cell_state::CellState;
use std::collections::BTreeMap;
use std::mem::discriminant;

/// The most moves that are tried in all orders together.
const MOST: u32 = 4_000;

/// The most states in which a standstill is looked for.
const STANDSTILLS: u32 = 32;

/// An action or a packet of a run, counted from the start: the how-many-th of its task and activation, or of its link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Number {
    Action(u8, u8, u32),
    Packet(u8, u32),
}

/// The number of ticks that an action or a packet takes, and the move that ends it. [`CellMove::GoOn`] stands for any end of an action.
pub type Timing = BTreeMap<Number, (u64, CellMove)>;

/// Counts the actions and packets of a run.
#[derive(Clone, Default)]
pub struct Numbers {
    /// The actions that have begun, by task and activation.
    begun: BTreeMap<(u8, u8), u32>,
    /// The running actions, each with its count and the tick at which it began.
    running: BTreeMap<(u8, u8), (u32, u64)>,
    /// For each link, the packets that were sent over it, and the counts of those that are on it.
    links: BTreeMap<u8, (u32, Vec<u32>)>,
}

impl Numbers {
    /// The action or packet that ends with a move, or is put off by it.
    pub fn of(&self, cell: &CellState, step: CellMove) -> Option<Number> {
        match step {
            CellMove::Acted(task, level, ..) | CellMove::GoOn(task, level) => {
                let (count, _) = self.running.get(&(task, level))?;
                Some(Number::Action(task, level, *count))
            }
            CellMove::Stay(link) => Some(Number::Packet(link, *self.links.get(&link)?.1.first()?)),
            _ => {
                let (link, at) = place(cell, step.packet()?)?;
                Some(Number::Packet(link, *self.links.get(&link)?.1.get(at)?))
            }
        }
    }

    /// Notes what ends with the move that is about to be made.
    pub fn end(&mut self, cell: &CellState, step: CellMove) {
        match step {
            CellMove::Acted(task, level, ..) => {
                self.running.remove(&(task, level));
            }
            CellMove::Duplicate(_) => {}
            _ => {
                if let Some((link, at)) = step.packet().and_then(|packet| place(cell, packet))
                    && let Some((_, on_link)) = self.links.get_mut(&link)
                {
                    on_link.remove(at);
                }
            }
        }
    }

    /// Notes what began with the last move.
    pub fn note(&mut self, cell: &CellState, tick: u64) {
        let mut before = std::mem::take(&mut self.running);
        for (task, body) in (0_u8..).zip(&cell.bodies) {
            for action in body.actor.iter().flat_map(|actor| &actor.running) {
                let key = (task, action.level);
                let known = before.remove(&key).unwrap_or_else(|| {
                    let count = self.begun.entry(key).or_default();
                    *count += 1;
                    (*count, tick)
                });
                self.running.insert(key, known);
            }
        }
        for carried in &cell.in_flight {
            let on = cell.in_flight.iter().filter(|other| other.link == carried.link).count();
            let (sent, on_link) = self.links.entry(carried.link).or_default();
            while on_link.len() < on {
                *sent += 1;
                on_link.push(*sent);
            }
        }
    }
}

/// Whether a move ends its action or packet as `ends` says.
fn ends_as(step: CellMove, ends: CellMove) -> bool {
    match (step, ends) {
        (CellMove::Acted(..), CellMove::GoOn(..)) => true,
        (CellMove::Acted(..), _) => step == ends,
        _ => discriminant(&step) == discriminant(&ends),
    }
}

/// The link of a packet, and its place among the packets of this link.
fn place(cell: &CellState, packet: u8) -> Option<(u8, usize)> {
    let link = cell.in_flight.get(usize::from(packet))?.link;
    let ahead = cell.in_flight.iter().take(usize::from(packet)).filter(|other| other.link == link);
    Some((link, ahead.count()))
}

/// A run that has been made in part.
#[derive(Clone)]
struct Run {
    cell: Unpacked,
    numbers: Numbers,
    moves: Vec<CellMove>,
    /// How many of the actions and packets that have a time are over.
    ended: usize,
}

/// Moves that lead to a finding by the tick `until`, with these times; `None` if none were found. An action, timer or packet
/// without a time in `timing` ends as soon as it may.
pub fn moves_with(found: &Found, timing: &Timing, until: u64) -> Option<Vec<CellMove>> {
    let cell = Unpacked::new(&found.every, found.phase, &found.faults);
    let mut first = Run { cell, numbers: Numbers::default(), moves: Vec::new(), ended: 0 };
    first.numbers.note(&first.cell.run_state.cell, 0);
    let (mut open, mut tries) = (vec![first], STANDSTILLS);
    for _ in 0..MOST {
        let mut run = open.pop()?;
        if run.cell.shown().iter().any(|last| last.is_same(&found.shown)) {
            return Some(run.moves);
        }
        if run.cell.run_state.passed > until {
            continue;
        }
        let mut moves = Vec::new();
        run.cell.run_state.moves(&mut moves);
        // A standstill comes after everything that has a time.
        if found.shown.kind == Kind::Standstill
            && run.ended == timing.len()
            && moves.contains(&CellMove::Pass)
        {
            tries -= 1;
            let moves = found.standstill(run.moves.clone());
            if moves.is_some() || tries == 0 {
                return moves;
            }
        }
        moves.retain(|&step| run.keeps(timing, step));
        // The first order is tried first.
        let others = moves.split_off(1.min(moves.len()));
        for step in others.into_iter().rev() {
            let mut other = run.clone();
            other.take(timing, step);
            open.push(other);
        }
        if let Some(step) = moves.pop() {
            run.take(timing, step);
            open.push(run);
        }
    }
    None
}

impl Run {
    /// Whether a move keeps to these times.
    fn keeps(&self, timing: &Timing, step: CellMove) -> bool {
        let cell = &self.cell.run_state.cell;
        let number = self.numbers.of(cell, step);
        let fixed = number.and_then(|number| timing.get(&number));
        let took = match number {
            Some(Number::Action(task, level, _)) => {
                let begun = self.numbers.running.get(&(task, level)).map_or(0, |&(_, tick)| tick);
                self.cell.run_state.passed - begun
            }
            Some(Number::Packet(link, _)) if step.packet().is_none() => {
                cell.in_flight.iter().find(|carried| carried.link == link).map_or(0, |carried| carried.age.0)
            }
            _ => step.packet().map_or(0, |packet| cell.in_flight[usize::from(packet)].age.0),
        };
        match (step, fixed) {
            (CellMove::Pass | CellMove::Take(..) | CellMove::Begin(_) | CellMove::Choose(..), _) => true,
            (CellMove::GoOn(..) | CellMove::Stay(_), fixed) => fixed.is_some_and(|&(ticks, _)| took < ticks),
            (CellMove::Acted(..), Some(&(ticks, ends))) => took == ticks && ends_as(step, ends),
            (_, Some(&(ticks, ends))) if number.is_some() => took == ticks && ends_as(step, ends),
            (CellMove::Acted(..) | CellMove::Deliver(_), None) => true,
            _ => false,
        }
    }

    fn take(&mut self, timing: &Timing, step: CellMove) {
        let number = self.numbers.of(&self.cell.run_state.cell, step);
        let ends = |&(_, ends): &(u64, CellMove)| ends_as(step, ends);
        self.ended += usize::from(number.and_then(|number| timing.get(&number)).is_some_and(ends));
        self.numbers.end(&self.cell.run_state.cell, step);
        self.cell.take(step);
        self.numbers.note(&self.cell.run_state.cell, self.cell.run_state.passed);
        self.moves.push(step);
    }
}
