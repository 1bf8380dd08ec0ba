//! The states that a search has kept.

use super::course::canon::Left;
use std::collections::HashMap;
use std::collections::hash_map::{DefaultHasher, Entry};
use std::hash::{BuildHasherDefault, Hash, Hasher};

/// Hashes fingerprints to themselves.
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

/// What stands for a state: the fingerprint of what it is, and what may still go wrong in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mark {
    core: u64,
    left: Left,
}

/// Of so many states without an alternative one is kept: which depends on the state alone, so that two ways through it both
/// stop there, and the second goes no further.
const POSTS: u64 = 4;

impl Mark {
    pub fn of((left, core): (Left, &[u8])) -> Self {
        let mut hasher = DefaultHasher::new();
        core.hash(&mut hasher);
        Self { core: hasher.finish(), left }
    }

    /// The fingerprint of what it is.
    pub const fn core(self) -> u64 {
        self.core
    }

    /// Whether it is kept although only one thing can happen next.
    pub fn is_post(self) -> bool {
        self.core.is_multiple_of(POSTS)
    }
}

/// The states that were kept: for each fingerprint, what may still go wrong.
///
/// Two states that differ only in that: the one with less does nothing that the one with more cannot do too. So it is not
/// looked at once the other one was.
#[derive(Default)]
pub(super) struct Seen {
    first: Map<Left>,
    /// Where neither covers the other.
    more: Map<Vec<Left>>,
}

impl Seen {
    /// Whether a state was kept that may do all that this one may.
    pub fn covers(&self, mark: Mark) -> bool {
        let Some(first) = self.first.get(&mark.core) else { return false };
        let others = || self.more.get(&mark.core).into_iter().flatten();
        first.covers(mark.left) || others().any(|other| other.covers(mark.left))
    }

    /// Keeps a state, unless one is kept that covers it.
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
