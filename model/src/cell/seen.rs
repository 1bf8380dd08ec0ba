//! The set of states that a search has kept.

use super::run_state::canon::Left;
use std::collections::HashMap;
use std::collections::hash_map::{DefaultHasher, Entry};
use std::hash::{BuildHasherDefault, Hash, Hasher};

/// A hasher that returns fingerprints unchanged, because they are hashes already.
#[derive(Default)]
struct Same(u64);

impl Hasher for Same {
    fn finish(&self) -> u64 {
        self.0
    }
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.0 = self.0 << 8 | u64::from(byte));
    }
    fn write_u64(&mut self, number: u64) {
        self.0 = number;
    }
}

type Map<T> = HashMap<u64, T, BuildHasherDefault<Same>>;

/// The entry of a state in the set: the fingerprint of its core, and its remaining faults.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mark {
    core: u64,
    left: Left,
}

/// On a chain without a choice one state in four is kept, chosen by its hash. A second path that reaches such a state ends
/// there.
const POSTS: u64 = 4;

/// Whether a kept (stored) state is in the sample in which more is checked: one state in sixteen is, chosen by its
/// fingerprint.
pub(super) const fn is_in_sample(core: u64) -> bool {
    (core / POSTS).is_multiple_of(16)
}

impl Mark {
    pub fn of((left, core): (Left, &[u8])) -> Self {
        let mut hasher = DefaultHasher::new();
        core.hash(&mut hasher);
        Self { core: hasher.finish(), left }
    }

    /// The fingerprint of the state's core: the state without its remaining faults.
    pub const fn core(self) -> u64 {
        self.core
    }

    /// Whether the state is kept (stored) although only one move is possible in it.
    pub fn is_post(self) -> bool {
        self.core.is_multiple_of(POSTS)
    }
}

/// The states that were kept: for each fingerprint, the remaining faults.
///
/// If two states differ only in their remaining faults, the state with more faults allows every move of the other one: it
/// covers the other state. A covered state is not expanded.
#[derive(Default)]
pub(super) struct Seen {
    first: Map<Left>,
    /// Further entries with the same fingerprint, none of which covers another.
    more: Map<Vec<Left>>,
}

impl Seen {
    /// Whether a kept state covers this one.
    pub fn covers(&self, mark: Mark) -> bool {
        let Some(first) = self.first.get(&mark.core) else { return false };
        let others = || self.more.get(&mark.core).into_iter().flatten();
        first.covers(mark.left) || others().any(|other| other.covers(mark.left))
    }

    /// Keeps a state unless a kept state covers it. Returns whether the state is new.
    pub fn insert(&mut self, mark: Mark) -> bool {
        match self.first.entry(mark.core) {
            Entry::Vacant(place) => {
                place.insert(mark.left);
                true
            }
            Entry::Occupied(place) if place.get().covers(mark.left) => false,
            Entry::Occupied(_) => {
                let more = self.more.entry(mark.core).or_default();
                let new = !more.iter().any(|other| other.covers(mark.left));
                if new {
                    more.retain(|&other| !mark.left.covers(other));
                    more.push(mark.left);
                }
                new
            }
        }
    }
}
