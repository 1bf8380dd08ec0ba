//! The kept states: for each control, the zones that were reached.

use crate::cell::run_state::canon::Left;
use crate::zone::dbm::Dbm;
use std::collections::HashMap;

/// How a part of a state's zone was reached: from which state, by which answers.
pub struct Origin {
    pub parent: Option<u32>,
    pub answers: Box<[u16]>,
    pub zone: Dbm,
}

/// A kept state.
pub struct State {
    /// The number of its control.
    pub control: u32,
    /// Empty: other states have its times.
    pub zone: Option<Dbm>,
    pub origins: Vec<Origin>,
    pub depth: u32,
}

/// A zone of a control.
struct Known {
    left: Left,
    zone: Dbm,
    /// The state that is still to be expanded with these times; `None`: they were expanded.
    state: Option<u32>,
}

/// All kept states.
#[derive(Default)]
pub struct Store {
    pub states: Vec<State>,
    /// The controls by number.
    pub controls: Vec<Box<[u8]>>,
    numbers: HashMap<Box<[u8]>, u32>,
    /// For each control without its remaining faults, its zones.
    known: HashMap<Box<[u8]>, Vec<Known>>,
    next: usize,
}

impl Store {
    /// Keeps a state unless kept ones cover its times. `core`: the control without its remaining faults.
    pub fn insert(
        &mut self,
        control: Box<[u8]>,
        (left, core): (Left, Box<[u8]>),
        origin: Origin,
        depth: u32,
    ) {
        let known = self.known.entry(core).or_default();
        if known.iter().any(|known| known.left.covers(left) && origin.zone.is_in(&known.zone)) {
            return;
        }
        let mut zone = origin.zone.clone();
        let mut origins = vec![origin];
        let states = &mut self.states;
        known.retain(|old| {
            let covers = left.covers(old.left) && old.zone.is_in(&zone);
            if covers && let Some(at) = old.state {
                states[at as usize].zone = None;
            }
            !covers
        });
        // States that are still to be expanded become one if their union is a zone.
        while let Some((at, merged)) = known.iter().enumerate().find_map(|(at, old)| {
            let both = old.state.is_some() && old.left == left;
            both.then(|| zone.merged(&old.zone)).flatten().map(|merged| (at, merged))
        }) {
            let old = known.swap_remove(at);
            let state = &mut states[old.state.unwrap_or(0) as usize];
            state.zone = None;
            origins.append(&mut state.origins);
            zone = merged;
        }
        let number = u32::try_from(states.len()).unwrap_or(u32::MAX);
        known.push(Known { left, zone: zone.clone(), state: Some(number) });
        let next = u32::try_from(self.controls.len()).unwrap_or(u32::MAX);
        let control = *self.numbers.entry(control).or_insert_with_key(|control| {
            self.controls.push(control.clone());
            next
        });
        states.push(State { control, zone: Some(zone), origins, depth });
    }

    /// The next state to be expanded. From then on no other one merges with it.
    pub fn next(&mut self, core: impl Fn(&[u8]) -> Box<[u8]>) -> Option<u32> {
        loop {
            let state = self.states.get(self.next)?;
            let number = u32::try_from(self.next).unwrap_or(u32::MAX);
            self.next += 1;
            if state.zone.is_none() {
                continue;
            }
            let known = self.known.get_mut(&core(&self.controls[state.control as usize]));
            if let Some(known) = known {
                known
                    .iter_mut()
                    .filter(|known| known.state == Some(number))
                    .for_each(|known| known.state = None);
                merge_expanded(known);
            }
            return Some(number);
        }
    }

    /// How many states were kept, without those whose times others have.
    pub fn len(&self) -> usize {
        self.states.iter().filter(|state| state.zone.is_some()).count()
    }

    /// The least depth of a state that is still to be expanded.
    pub fn least_left(&self) -> Option<u32> {
        let left = self.states.get(self.next..).unwrap_or_default();
        left.iter().filter(|state| state.zone.is_some()).map(|state| state.depth).min()
    }
}

/// Joins the zones that were expanded, where their union is a zone.
fn merge_expanded(known: &mut Vec<Known>) {
    let may =
        |one: &Known, other: &Known| one.state.is_none() && other.state.is_none() && one.left == other.left;
    loop {
        let pairs = (0..known.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
        let mut merged = pairs
            .filter(|&(i, j)| may(&known[i], &known[j]))
            .filter_map(|(i, j)| Some((i, j, known[i].zone.merged(&known[j].zone)?)));
        let Some((i, j, zone)) = merged.next() else { return };
        known[j].zone = zone;
        known.swap_remove(i);
    }
}
