//! The kept states of a search by zones: for each control, the zones with which it was reached.

use crate::cell::run_state::canon::Left;
use crate::zone::dbm::Dbm;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};
use std::sync::Arc;

/// How a part of a state's zone was reached: from which kept state, and with which answers to the run's comparisons of
/// times.
pub struct Origin {
    pub parent: Option<u32>,
    pub answers: Box<[u16]>,
    pub zone: Dbm,
}

/// A kept state.
pub struct State {
    /// The number of the state's control. The next field is the number of the control's group.
    pub control: u32,
    group: u32,
    /// The times of the state. `None`: another state includes these times.
    pub zone: Option<Dbm>,
    /// The other state that includes the times of this state.
    heir: Option<u32>,
    pub origins: Vec<Origin>,
    pub depth: u32,
}

/// When a state is expanded, and its number. The states with the most remaining faults come first, because they cover states
/// with fewer. Among these, the states come first whose control was reached first. If a control is reached again, it is thus
/// expanded before the controls that follow from it, and these are then reached with larger zones.
type Turn = Reverse<(Reverse<u32>, u32, u32)>;

/// A zone of a control.
struct Known {
    left: Left,
    zone: Dbm,
    /// The state that is still to be expanded with this zone; `None` if the zone has been expanded.
    state: Option<u32>,
    /// The states whose times are in this zone.
    states: Vec<u32>,
}

/// The controls that differ only in their remaining faults.
#[derive(Default)]
struct Group {
    /// The numbers of these controls.
    controls: Vec<(Left, u32)>,
    known: Vec<Known>,
}

/// All kept states of a search.
#[derive(Default)]
pub struct Store {
    /// The greatest number of zones of a control with the same remaining faults.
    most: usize,
    /// How many times zones became their hull.
    pub hulls: u64,
    /// The number of states whose times another state includes.
    passed: usize,
    pub states: Vec<State>,
    /// The controls by number.
    pub controls: Vec<Arc<[u8]>>,
    /// The number of the group for each control without its remaining faults.
    numbers: HashMap<Box<[u8]>, u32>,
    groups: Vec<Group>,
    /// The states that are still to be expanded. Some entries are out of date: another state has taken over their times.
    open: BinaryHeap<Turn>,
}

impl Store {
    /// A store without states. If a control would have more than `most` zones, the store keeps their hull instead.
    pub fn new(most: usize) -> Self {
        Self { most, ..Self::default() }
    }

    /// The state that now has the times of this state.
    pub fn heir(&self, mut state: u32) -> u32 {
        while let Some(heir) = self.states[state as usize].heir {
            state = heir;
        }
        state
    }

    /// Keeps a state, unless kept states cover its times. `bytes` is the state's control, and `core` is the control
    /// without the remaining faults. Returns the states that include the new state's times afterwards.
    pub fn insert(
        &mut self,
        bytes: Box<[u8]>,
        (left, core): (Left, Box<[u8]>),
        origin: Origin,
        depth: u32,
    ) -> Vec<u32> {
        let number_of = |len: usize| u32::try_from(len).unwrap_or(u32::MAX);
        let group = *self.numbers.entry(core).or_insert_with(|| {
            self.groups.push(Group::default());
            number_of(self.groups.len() - 1)
        });
        let Group { controls, known } = &mut self.groups[group as usize];
        if let Some(covering) = covering(known, left, &origin.zone) {
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
        let (mut zone, mut origins) = (origin.zone.clone(), vec![origin]);
        let states = &mut self.states;
        self.passed += replace(known, states, (left, &zone), number).1;
        // The new state joins with states that are still to be expanded, if the union of both zones is a zone.
        while let Some((at, state, merged)) = known.iter().enumerate().find_map(|(at, old)| {
            let state = old.state.filter(|_| old.left == left)?;
            zone.merged(&old.zone).map(|merged| (at, state, merged))
        }) {
            known.swap_remove(at);
            let state = &mut states[state as usize];
            state.pass_to(number);
            self.passed += 1;
            origins.append(&mut state.origins);
            zone = merged;
        }
        let is_like = |old: &&Known| old.left == left;
        if known.iter().filter(is_like).count() >= self.most {
            self.hulls += 1;
            zone = known.iter().filter(is_like).fold(zone, |all, old| all.hull(&old.zone));
            let (mut others, passed) = replace(known, states, (left, &zone), number);
            origins.append(&mut others);
            self.passed += passed;
        }
        known.push(Known { left, zone: zone.clone(), state: Some(number), states: vec![number] });
        states.push(State { control, group, zone: Some(zone), heir: None, origins, depth });
        self.open.push(Reverse((Reverse(left.total()), control, number)));
        vec![number]
    }

    /// The next states to be expanded: at most `most`, all with the same number of remaining faults. From then on no other
    /// state joins with them.
    pub fn next(&mut self, most: usize) -> Vec<u32> {
        let mut next = Vec::new();
        while next.len() < most
            && let Some(&Reverse((Reverse(left), _, number))) = self.open.peek()
        {
            let state = &self.states[number as usize];
            if state.zone.is_some() && next.first().is_some_and(|&(first, _)| first != left) {
                break;
            }
            self.open.pop();
            if state.zone.is_none() {
                continue;
            }
            next.push((left, number));
            let known = &mut self.groups[state.group as usize].known;
            if let Some(at) = known.iter().position(|known| known.state == Some(number)) {
                known[at].state = None;
                merge_expanded(known, at);
            }
        }
        next.into_iter().map(|(_, number)| number).collect()
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
/// Returns how these states were reached, and their number.
fn replace(
    known: &mut Vec<Known>,
    states: &mut [State],
    (left, zone): (Left, &Dbm),
    new: u32,
) -> (Vec<Origin>, usize) {
    let (mut origins, mut passed) = (Vec::new(), 0);
    known.retain(|old| {
        let covers = left.covers(old.left) && old.zone.is_in(zone);
        if covers && let Some(at) = old.state {
            let state = &mut states[at as usize];
            state.pass_to(new);
            passed += 1;
            origins.append(&mut state.origins);
        }
        !covers
    });
    (origins, passed)
}

/// The newest zone that covers the times `zone` and was reached with at least the faults `left`.
fn covering<'a>(known: &'a [Known], left: Left, zone: &Dbm) -> Option<&'a Known> {
    known.iter().rev().find(|known| known.left.covers(left) && zone.is_in(&known.zone))
}

impl State {
    fn pass_to(&mut self, heir: u32) {
        (self.zone, self.heir) = (None, Some(heir));
    }
}

/// Joins an expanded zone with other expanded zones, if their union is a zone.
fn merge_expanded(known: &mut Vec<Known>, mut at: usize) {
    loop {
        let one = &known[at];
        let mut merged = known.iter().enumerate().filter_map(|(j, other)| {
            let may = j != at && other.state.is_none() && one.left == other.left;
            may.then(|| one.zone.merged(&other.zone)).flatten().map(|zone| (j, zone))
        });
        let Some((j, zone)) = merged.next() else { return };
        known[at].zone = zone;
        let states = std::mem::take(&mut known[j].states);
        known[at].states.extend(states);
        known.swap_remove(j);
        // `swap_remove` has put the last zone in the place of the removed one.
        at = if at == known.len() { j } else { at };
    }
}
