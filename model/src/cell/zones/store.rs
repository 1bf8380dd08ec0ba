//! The kept states of a search by zones: for each control, the zones with which it was reached.

use crate::cell::run_state::canon::Left;
use crate::zone::dbm::Dbm;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

/// How a part of a state's zone was reached: from which kept state, and by which answers of the run.
pub struct Origin {
    pub parent: Option<u32>,
    pub answers: Box<[u16]>,
    pub zone: Dbm,
}

/// A kept state.
pub struct State {
    /// The number of the state's control.
    pub control: u32,
    /// The times of the state. `None` if another state includes these times.
    pub zone: Option<Dbm>,
    /// The other state that includes the times of this one.
    heir: Option<u32>,
    pub origins: Vec<Origin>,
    /// Expanded states whose times it has, too, if it is a hull.
    also: Vec<u32>,
    pub depth: u32,
    /// The least time since the start at which it is reached, as far as is known.
    pub since: u64,
}

/// A zone of a control.
struct Known {
    left: Left,
    zone: Dbm,
    /// The state that is still to be expanded with these times; `None` if they have been expanded.
    state: Option<u32>,
    /// The states that have these times.
    states: Vec<u32>,
    /// Whether it has more times than were reached.
    is_hull: bool,
}

/// A state that is about to be kept.
struct New {
    number: u32,
    left: Left,
    since: u64,
    zone: Dbm,
    origins: Vec<Origin>,
    also: Vec<u32>,
}

/// All kept states of a search.
#[derive(Default)]
pub struct Store {
    pub states: Vec<State>,
    /// The controls by number.
    pub controls: Vec<Box<[u8]>>,
    numbers: HashMap<Box<[u8]>, u32>,
    /// For each control without its remaining faults, the known zones.
    known: HashMap<Box<[u8]>, Vec<Known>>,
    /// The states that are still to be expanded, the earliest first, and some whose times others have.
    open: BinaryHeap<Reverse<(u64, u32)>>,
    /// The most zones of one control: more of them become their hull.
    most: usize,
}

impl Store {
    /// `most`: the most zones of one control. More of them become their hull.
    pub fn new(most: usize) -> Self {
        Self { most, ..Self::default() }
    }

    /// How the times of a state were reached.
    pub fn origins(&self, state: u32) -> impl Iterator<Item = &Origin> {
        let state = &self.states[state as usize];
        let also = state.also.iter().flat_map(|&at| &self.states[at as usize].origins);
        state.origins.iter().chain(also)
    }

    /// The state that has the times of this one now.
    pub fn heir(&self, mut state: u32) -> u32 {
        while let Some(heir) = self.states[state as usize].heir {
            state = heir;
        }
        state
    }

    /// Keeps a state unless kept states cover its times. `core` is the control without its remaining faults. Returns the
    /// states that include its times then.
    pub fn insert(
        &mut self,
        control: Box<[u8]>,
        (left, core): (Left, Box<[u8]>),
        origin: Origin,
        (depth, since): (u32, u64),
    ) -> Vec<u32> {
        let known = self.known.entry(core).or_default();
        if let Some(covering) = covering(known, left, &origin.zone) {
            return covering.states.clone();
        }
        let number = u32::try_from(self.states.len()).unwrap_or(u32::MAX);
        let next = u32::try_from(self.controls.len()).unwrap_or(u32::MAX);
        let control = *self.numbers.entry(control).or_insert_with_key(|control| {
            self.controls.push(control.clone());
            next
        });
        let mut new =
            New { number, left, since, zone: origin.zone.clone(), origins: vec![origin], also: Vec::new() };
        new.cover(known, &mut self.states);
        new.merge(known, &mut self.states);
        let is_hull = new.becomes_hull(known, &mut self.states, self.most);
        let New { zone, origins, also, since, .. } = new;
        known.push(Known { left, zone: zone.clone(), state: Some(number), states: vec![number], is_hull });
        self.states.push(State { control, zone: Some(zone), heir: None, origins, also, depth, since });
        self.open.push(Reverse((since, number)));
        vec![number]
    }

    /// The next states to be expanded, at most so many, all reached at the same least time. From then on no other one merges with
    /// them.
    pub fn next(&mut self, most: usize, core: impl Fn(&[u8]) -> Box<[u8]>) -> Vec<u32> {
        let mut next = Vec::new();
        while next.len() < most
            && let Some(&Reverse((since, number))) = self.open.peek()
        {
            let state = &self.states[number as usize];
            if state.zone.is_some() && next.first().is_some_and(|&(first, _)| first != since) {
                break;
            }
            self.open.pop();
            if state.zone.is_none() {
                continue;
            }
            next.push((since, number));
            let known = self.known.get_mut(&core(&self.controls[state.control as usize]));
            if let Some(known) = known
                && let Some(at) = known.iter().position(|known| known.state == Some(number))
            {
                known[at].state = None;
                merge_expanded(known, at);
            }
        }
        next.into_iter().map(|(_, number)| number).collect()
    }

    /// The zones of a control, given without its remaining faults, with at least so many faults left.
    pub fn zones(&self, left: Left, core: &[u8]) -> impl Iterator<Item = &Dbm> {
        let known = self.known.get(core).into_iter().flatten();
        known.filter(move |known| known.left.covers(left)).map(|known| &known.zone)
    }

    /// How many states are still to be expanded, and some whose times others have.
    pub fn open(&self) -> usize {
        self.open.len()
    }

    /// How many states have more times than were reached.
    pub fn hulls(&self) -> u64 {
        self.known.values().flatten().filter(|known| known.is_hull).count() as u64
    }

    /// How many states are kept, without states whose times other states include.
    pub fn len(&self) -> usize {
        self.states.iter().filter(|state| state.zone.is_some()).count()
    }

    /// The least depth of a state that is still to be expanded.
    pub fn least_left(&self) -> Option<u32> {
        let left = self.open.iter().map(|&Reverse((_, number))| &self.states[number as usize]);
        left.filter(|state| state.zone.is_some()).map(|state| state.depth).min()
    }
}

impl New {
    /// Takes the place of the states whose times it has.
    fn cover(&mut self, known: &mut Vec<Known>, states: &mut [State]) {
        known.retain(|old| {
            let covers = self.left.covers(old.left) && old.zone.is_in(&self.zone);
            if covers && let Some(at) = old.state {
                states[at as usize].pass_to(self.number);
            }
            !covers
        });
    }

    /// Joins it with states that are still to be expanded, where the union is a zone.
    fn merge(&mut self, known: &mut Vec<Known>, states: &mut [State]) {
        while let Some((at, merged)) = known.iter().enumerate().find_map(|(at, old)| {
            let both = old.state.is_some() && old.left == self.left && !old.is_hull;
            both.then(|| self.zone.merged(&old.zone)).flatten().map(|merged| (at, merged))
        }) {
            let old = known.swap_remove(at);
            self.take_in(&old, states);
            self.zone = merged;
        }
    }

    /// Becomes the hull of all zones of its control if these have too many states. Returns whether it is one.
    fn becomes_hull(&mut self, known: &mut Vec<Known>, states: &mut [State], most: usize) -> bool {
        let alike = || known.iter().filter(|old| old.left == self.left);
        // Zones that were joined were expanded one by one, too.
        let kept: usize = alike().map(|old| old.states.len()).sum();
        if kept < most && !alike().any(|old| old.is_hull) {
            return false;
        }
        let hull = alike().map(|old| &old.zone).fold(None, |hull: Option<Dbm>, zone| {
            Some(hull.map_or_else(|| zone.clone(), |hull| hull.hull(zone)))
        });
        if let Some(hull) = hull {
            self.zone = hull.widened(&self.zone);
        }
        let left = self.left;
        for old in known.extract_if(.., |old| old.left == left) {
            self.take_in(&old, states);
        }
        self.cover(known, states);
        true
    }

    /// Takes in the times of another state.
    fn take_in(&mut self, old: &Known, states: &mut [State]) {
        match old.state {
            Some(at) => {
                let state = &mut states[at as usize];
                state.pass_to(self.number);
                self.since = self.since.min(state.since);
                self.origins.append(&mut state.origins);
                self.also.append(&mut state.also);
            }
            None => {
                self.also.extend(&old.states);
                self.also.extend(old.states.iter().flat_map(|&at| states[at as usize].also.iter().copied()));
            }
        }
    }
}

/// The first zone that covers these times.
fn covering<'a>(known: &'a [Known], left: Left, zone: &Dbm) -> Option<&'a Known> {
    known.iter().find(|known| known.left.covers(left) && zone.is_in(&known.zone))
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
            let may = j != at && other.state.is_none() && one.left == other.left && !other.is_hull;
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
