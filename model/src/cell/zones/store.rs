//! The kept states of a search by zones: for each control, the zones with which it was reached.

use super::growth::Growth;
use super::origins::{List, Origin, Origins};
use crate::cell::plan::CellPlan;
use crate::cell::run_state::canon::Left;
use crate::zone::dbm::{Dbm, KeptZones};
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};
use std::sync::Arc;

/// Where the times of a state are.
enum Place {
    /// The state is still to be expanded. Its times are those of a zone of its control.
    Open,
    /// The state has been expanded with the zone at this place among the kept zones.
    Kept(usize),
    /// Another state, with this number, includes these times.
    Passed(u32),
}

/// A kept state.
pub struct State {
    /// The number of the state's control. The next field is the number of the control's group.
    pub control: u32,
    group: u32,
    place: Place,
    /// How the state was reached. The states that it includes were reached in the same ways.
    origins: List,
    pub depth: u32,
}

/// When a state is expanded, and its number. The states with the most remaining faults come first, because they cover states
/// with fewer. Among these, the states come first whose control was reached first. If a control is reached again, it is thus
/// expanded before the controls that follow from it, and these are then reached with larger zones.
type Turn = Reverse<(Reverse<u32>, u32, u32)>;

/// A set of times (a zone) with which the search has reached one control: one value of everything else in a state.
struct Known {
    left: Left,
    zone: Dbm,
    /// The state that is still to be expanded with this zone; `None` if the zone has been expanded.
    state: Option<u32>,
    /// The states whose times are in this zone.
    states: Vec<u32>,
    /// How the zone has grown since it was expanded.
    growth: Growth,
}

/// The controls that differ only in their remaining faults.
#[derive(Default)]
struct Group {
    /// The numbers of these controls.
    controls: Vec<(Left, u32)>,
    known: Vec<Known>,
}

/// When a zone is widened: it gets times with which its control may not have been reached.
#[derive(Clone, Copy, Default)]
pub struct Widening {
    /// The greatest number of zones of a control with the same remaining faults. If there would be more, the store keeps their hull.
    pub most: usize,
    /// Whether a zone that grows and grows is [accelerated](super::growth).
    pub accelerates: bool,
}

impl Widening {
    /// No zone is widened.
    pub const NONE: Self = Self { most: usize::MAX, accelerates: false };

    pub fn of(plan: &CellPlan) -> Self {
        Self { most: plan.zones, accelerates: !plan.everything }
    }
}

/// All kept states of a search.
#[derive(Default)]
pub struct Store {
    widening: Widening,
    /// How many times zones were accelerated. The next field says how many times zones became their hull.
    pub accelerated: u64,
    pub hulls: u64,
    /// The number of states whose times another state includes.
    passed: usize,
    pub states: Vec<State>,
    /// The zones of the states that have been expanded.
    kept: KeptZones,
    origins: Origins,
    /// The controls by number.
    pub controls: Vec<Arc<[u8]>>,
    /// The number of the group for each control without its remaining faults.
    numbers: HashMap<Box<[u8]>, u32>,
    groups: Vec<Group>,
    /// The states that are still to be expanded. Some entries are out of date: another state has taken over their times.
    open: BinaryHeap<Turn>,
}

impl Store {
    /// A store without states.
    pub fn new(widening: Widening) -> Self {
        Self { widening, ..Self::default() }
    }

    /// The next search that widens less than this one; `None` if this one widened no zone.
    pub fn less_widening(&self) -> Option<Widening> {
        match (self.accelerated, self.hulls) {
            (0, 0) => None,
            (0, _) => Some(Widening::NONE),
            _ => Some(Widening { accelerates: false, ..self.widening }),
        }
    }

    /// The state that now has the times of this state.
    pub fn heir(&self, mut state: u32) -> u32 {
        while let Place::Passed(heir) = self.states[state as usize].place {
            state = heir;
        }
        state
    }

    /// The times of a state; `None`: another state includes them.
    pub fn zone(&self, number: u32) -> Option<Dbm> {
        let state = &self.states[number as usize];
        match state.place {
            Place::Passed(_) => None,
            Place::Kept(at) => Some(self.kept.zone(at)),
            Place::Open => {
                let known = &self.groups[state.group as usize].known;
                known.iter().find(|known| known.state == Some(number)).map(|known| known.zone.clone())
            }
        }
    }

    /// How the times of a state were reached.
    pub fn origins(&self, state: u32) -> impl Iterator<Item = Origin> {
        self.origins.of(self.states[state as usize].origins)
    }

    /// Keeps a state with these times, unless kept states cover them. `bytes` is the state's control, and `core` is the control
    /// without the remaining faults. Returns the states that include the new state's times afterwards.
    pub fn insert(
        &mut self,
        bytes: Box<[u8]>,
        (left, core): (Left, Box<[u8]>),
        mut zone: Dbm,
        (parent, answers, depth): (Option<u32>, &[u16], u32),
    ) -> Vec<u32> {
        let number_of = |len: usize| u32::try_from(len).unwrap_or(u32::MAX);
        let group = *self.numbers.entry(core).or_insert_with(|| {
            self.groups.push(Group::default());
            number_of(self.groups.len() - 1)
        });
        let Group { controls, known } = &mut self.groups[group as usize];
        if let Some(covering) = covering(known, left, &zone) {
            return covering.states.clone();
        }
        let number = number_of(self.states.len());
        let next = number_of(self.controls.len());
        let same = controls.iter().find(|(of, _)| *of == left).map(|&(_, control)| control);
        if same.is_none() {
            controls.push((left, next));
            self.controls.push(bytes.into());
        }
        let control = same.unwrap_or(next);
        let mut origins = self.origins.one(parent, answers);
        let states = &mut self.states;
        self.passed += replace(known, states, (left, &zone), number).len();
        // The new state joins with states that are still to be expanded, if the union of both zones is a zone.
        while let Some((at, state, merged)) = known.iter().enumerate().find_map(|(at, old)| {
            let state = old.state.filter(|_| old.left == left)?;
            zone.merged(&old.zone).map(|merged| (at, state, merged))
        }) {
            known.swap_remove(at);
            let state = &mut states[state as usize];
            state.pass_to(number);
            self.passed += 1;
            origins = self.origins.join(origins, state.origins);
            zone = merged;
        }
        let is_like = |old: &&Known| old.left == left;
        if known.iter().filter(is_like).count() >= self.widening.most {
            self.hulls += 1;
            zone = known.iter().filter(is_like).fold(zone, |all, old| all.hull(&old.zone));
            let others = replace(known, states, (left, &zone), number);
            self.passed += others.len();
            origins = others.into_iter().fold(origins, |all, others| self.origins.join(all, others));
        }
        known.push(Known {
            left,
            zone,
            state: Some(number),
            states: vec![number],
            growth: Growth::default(),
        });
        states.push(State { control, group, place: Place::Open, origins, depth });
        self.open.push(Reverse((Reverse(left.total()), control, number)));
        vec![number]
    }

    /// The next states to be expanded, with their times: at most `most`, all with the same number of remaining faults. From then on
    /// no other state joins with them.
    pub fn next(&mut self, most: usize) -> Vec<(u32, Dbm)> {
        let mut next = Vec::new();
        let mut of_batch = None;
        while next.len() < most
            && let Some(&Reverse((Reverse(left), _, number))) = self.open.peek()
        {
            let state = &mut self.states[number as usize];
            let is_open = matches!(state.place, Place::Open);
            if is_open && *of_batch.get_or_insert(left) != left {
                break;
            }
            self.open.pop();
            let known = &mut self.groups[state.group as usize].known;
            if is_open && let Some(at) = known.iter().position(|known| known.state == Some(number)) {
                let ahead = if self.widening.accelerates { ahead(known, at) } else { None };
                if let Some((_, ahead)) = &ahead {
                    self.accelerated += 1;
                    known[at].zone = ahead.clone();
                }
                let zone = known[at].zone.clone();
                state.place = Place::Kept(self.kept.keep(&zone));
                next.push((number, zone));
                known[at].state = None;
                let joins = ahead.or_else(|| partners(known, at, |_| true).next());
                merge_expanded(known, at, joins);
            }
        }
        next
    }

    /// The zones of a control that were reached with at least the faults `left`. `core` is the control without the
    /// remaining faults.
    pub fn zones(&self, left: Left, core: &[u8]) -> impl Iterator<Item = &Dbm> {
        let group = self.numbers.get(core).map(|&group| &self.groups[group as usize]);
        let known = group.into_iter().flat_map(|group| &group.known);
        known.filter(move |known| known.left.covers(left)).map(|known| &known.zone)
    }

    /// The number of kept states, without those whose times another state includes.
    pub const fn len(&self) -> usize {
        self.states.len() - self.passed
    }
}

/// Lets a new state replace the zones whose times it includes, and the states of these zones that are still to be expanded.
/// Returns how each of these states was reached.
fn replace(known: &mut Vec<Known>, states: &mut [State], (left, zone): (Left, &Dbm), new: u32) -> Vec<List> {
    let mut passed = Vec::new();
    known.retain(|old| {
        let covers = left.covers(old.left) && old.zone.is_in(zone);
        if covers && let Some(at) = old.state {
            let state = &mut states[at as usize];
            state.pass_to(new);
            passed.push(state.origins);
        }
        !covers
    });
    passed
}

/// The newest zone that covers the times `zone` and was reached with at least the faults `left`.
fn covering<'a>(known: &'a [Known], left: Left, zone: &Dbm) -> Option<&'a Known> {
    known.iter().rev().find(|known| known.left.covers(left) && zone.is_in(&known.zone))
}

impl State {
    fn pass_to(&mut self, heir: u32) {
        self.place = Place::Passed(heir);
    }
}

/// The expanded zones that may join and whose union with the zone at a place is a zone, each with that union.
fn partners(
    known: &[Known],
    at: usize,
    may_join: impl Fn(&Known) -> bool,
) -> impl Iterator<Item = (usize, Dbm)> {
    let one = &known[at];
    known.iter().enumerate().filter_map(move |(other, expanded)| {
        let may = other != at && expanded.state.is_none() && one.left == expanded.left && may_join(expanded);
        may.then(|| one.zone.merged(&expanded.zone)).flatten().map(|joined| (other, joined))
    })
}

/// An expanded zone that grows and grows, the last time by the zone at a place, and the zone to which it would grow.
fn ahead(known: &[Known], at: usize) -> Option<(usize, Dbm)> {
    partners(known, at, |known| known.growth.may_repeat()).find_map(|(other, joined)| {
        let Known { growth, zone, .. } = &known[other];
        growth.ahead(zone, &joined).map(|ahead| (other, ahead))
    })
}

/// Joins an expanded zone with other expanded zones, if their union is a zone. `joins` is the first of them, with the union.
fn merge_expanded(known: &mut Vec<Known>, mut at: usize, mut joins: Option<(usize, Dbm)>) {
    while let Some((other, joined)) = joins {
        let Known { zone, states, mut growth, .. } = known.swap_remove(other);
        // `swap_remove` has put the last zone in the place of the removed one.
        at = if at == known.len() { other } else { at };
        growth.note(zone);
        let one = &mut known[at];
        one.zone = joined;
        one.states.extend(states);
        one.growth.join(growth);
        joins = partners(known, at, |_| true).next();
    }
}
