//! A 4-ary heap of slot numbers, ordered by one instant per slot.

use super::{Slot, narrow};
use crate::ticks::Instant;
use alloc::boxed::Box;
use alloc::vec;
use serde::{Deserialize, Serialize};

/// The number of low bits of a word that hold the slot number; the upper bits hold the instant.
const NUMBER_BITS: u32 = 16;
/// The words of empty places, one per position in a group: greater than every other word, and pairwise different.
const NOTHING: [u64; 4] = {
    let step = 1 << NUMBER_BITS;
    [u64::MAX - 3 * step, u64::MAX - 2 * step, u64::MAX - step, u64::MAX]
};

/// The place of the least word: the last of the first group, so that the four children of a place share one group.
const ROOT: usize = 3;

/// Four adjacent words: half a cache line, never split over two lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[repr(align(32))]
struct Group([u64; 4]);

/// A 4-ary min-heap of slot numbers, ordered by an instant per number; a caller's key breaks ties. The children of
/// the place `i` are group `i - 2`.
///
/// An entry is one word, the instant above the number, so a comparison needs the key only if the instants are equal.
/// All instants from 2^48 - 5 ticks on (8.9 years of microseconds) count as equal.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Heap {
    groups: Box<[Group]>,
    /// For each number in the heap, its place, counted from `ROOT`. For a number that is not in the heap, the
    /// value that [`keep`](Self::keep) stored for it.
    places: Box<[u16]>,
    len: u16,
}

/// The instant from which on all instants count as equal.
const LAST: u64 = (1 << (u64::BITS - NUMBER_BITS)) - 5;

/// Packs a number and its instant into a word.
fn word(instant: Instant, slot: Slot) -> u64 {
    // Symbolic times, and numbers that occur together with them, can only be compared, not packed into a
    // word. So their words are equal, and the keys decide.
    #[cfg(feature = "checker")]
    if crate::ticks::symbolic::has_zone() {
        return LAST << NUMBER_BITS | u64::from(slot);
    }
    (instant.0.min(LAST) << NUMBER_BITS) | u64::from(slot)
}

/// The number in a word.
#[expect(clippy::cast_possible_truncation, reason = "the low bits are the number")]
const fn slot(word: u64) -> Slot {
    word as Slot
}

const fn is_nothing(word: u64) -> bool {
    word >= NOTHING[0]
}

const fn parent(at: usize) -> usize {
    at / 4 + 2
}

const fn is_tie(a: u64, b: u64) -> bool {
    (a ^ b) >> NUMBER_BITS == 0
}

fn is_less<K: Ord>(a: u64, b: u64, key: &impl Fn(Slot) -> K) -> bool {
    if is_tie(a, b) { key(slot(a)) < key(slot(b)) } else { a < b }
}

/// The position of the least of four words.
#[inline]
fn least<K: Ord>(Group(group): &Group, key: &impl Fn(Slot) -> K) -> usize {
    let [a, b, c, d] = *group;
    let (left, low) = if b < a { (1, b) } else { (0, a) };
    let (right, high) = if d < c { (3, d) } else { (2, c) };
    let at = if high < low { right } else { left };
    if (a ^ b).min(c ^ d).min(low ^ high) >> NUMBER_BITS == 0 { least_of_equals(group, at, key) } else { at }
}

/// Breaks a tie by key. `at` is the position of one of several least words with the same instant.
#[cold]
fn least_of_equals<K: Ord>(group: &[u64; 4], at: usize, key: &impl Fn(Slot) -> K) -> usize {
    let equal = (0..4).filter(|&i| is_tie(group[i], group[at]));
    equal.min_by_key(|&i| key(slot(group[i]))).unwrap_or(at)
}

impl Heap {
    /// A heap for the numbers below `capacity`. Allocates here and nowhere else.
    pub fn new(capacity: u16) -> Self {
        let capacity = usize::from(capacity);
        let groups = if capacity == 0 { 0 } else { (ROOT + capacity).div_ceil(4) };
        Self { groups: vec![Group(NOTHING); groups].into(), places: vec![0; capacity].into(), len: 0 }
    }

    pub fn capacity(&self) -> usize {
        self.places.len()
    }

    #[expect(clippy::len_without_is_empty, reason = "as of the queue")]
    pub fn len(&self) -> usize {
        usize::from(self.len)
    }

    fn word_at(&self, at: usize) -> Option<u64> {
        Some(self.groups.get(at / 4)?.0[at % 4])
    }

    fn put(&mut self, at: usize, word: u64) {
        if let Some(Group(group)) = self.groups.get_mut(at / 4) {
            group[at % 4] = word;
        }
    }

    /// The number with the least instant.
    pub fn first(&self) -> Option<Slot> {
        self.word_at(ROOT).filter(|&word| !is_nothing(word)).map(slot)
    }

    /// The least instant, or never for an empty heap; `exact` looks up an instant too great for a word.
    #[inline]
    pub fn first_instant(&self, exact: impl FnOnce(Slot) -> Instant) -> Instant {
        match self.word_at(ROOT) {
            Some(word) if word >> NUMBER_BITS < LAST => Instant(word >> NUMBER_BITS),
            Some(word) if !is_nothing(word) => exact(slot(word)),
            Some(_) | None => Instant::NEVER,
        }
    }

    /// The numbers of all entries in no particular order.
    pub fn iter(&self) -> impl Iterator<Item = Slot> {
        self.heap().map(slot)
    }

    fn heap(&self) -> impl Iterator<Item = u64> {
        self.groups.iter().flat_map(|Group(group)| group).skip(ROOT).take(self.len()).copied()
    }

    /// Visits the heap from its root, parents before children, and skips the subtree below a number for which `is_in` is
    /// false. If `is_in` means "before some instant", the visited numbers are all such numbers.
    pub fn upper(&self, is_in: impl Fn(Slot) -> bool) -> impl Iterator<Item = Slot> {
        let mut at = Some(ROOT);
        let taken = |at: usize| at < ROOT + self.len();
        core::iter::from_fn(move || {
            loop {
                let place = at?;
                let number = self.word_at(place).filter(|_| taken(place)).map(slot);
                let found = number.filter(|&number| is_in(number));
                let child = 4 * (place - 2);
                at = match found {
                    Some(_) if taken(child) => Some(child),
                    Some(_) | None => self.beside(place),
                };
                if found.is_some() {
                    return found;
                }
            }
        })
    }

    /// The place that follows `place` in the order of [`upper`](Self::upper) if the subtree below `place` is skipped.
    fn beside(&self, mut place: usize) -> Option<usize> {
        while place > ROOT {
            if place % 4 < 3 && place + 1 < ROOT + self.len() {
                return Some(place + 1);
            }
            place = parent(place);
        }
        None
    }

    fn place_of(&self, number: Slot) -> Option<usize> {
        let place = ROOT + usize::from(*self.places.get(usize::from(number))?);
        let stands = self.word_at(place).is_some_and(|word| !is_nothing(word) && slot(word) == number);
        stands.then_some(place)
    }

    /// Stores a value for a number outside the heap, until the number is pushed.
    pub fn keep(&mut self, number: Slot, kept: u16) {
        if let Some(place) = self.places.get_mut(usize::from(number)) {
            *place = kept;
        }
    }

    /// The value that [`keep`](Self::keep) stored for a number outside the heap.
    pub fn kept(&self, number: Slot) -> u16 {
        self.places.get(usize::from(number)).copied().unwrap_or_default()
    }

    pub fn has(&self, number: Slot) -> bool {
        self.place_of(number).is_some()
    }

    /// Adds a number that is not in the heap.
    #[inline]
    pub fn push<K: Ord>(&mut self, number: Slot, instant: Instant, key: impl Fn(Slot) -> K) {
        let at = ROOT + self.len();
        self.len += 1;
        self.sift_up(at, word(instant, number), &key);
    }

    /// Removes a number, if it is in the heap.
    pub fn remove<K: Ord>(&mut self, number: Slot, key: impl Fn(Slot) -> K) {
        if let Some(place) = self.place_of(number) {
            self.remove_at(place, &key);
        }
    }

    fn remove_at<K: Ord>(&mut self, place: usize, key: &impl Fn(Slot) -> K) {
        let last = self.take_last();
        if place < ROOT + self.len() {
            self.settle(place, last, key);
        }
    }

    /// Removes the number with the least instant.
    #[inline]
    pub fn pop<K: Ord>(&mut self, key: impl Fn(Slot) -> K) {
        if self.len > 0 {
            let last = self.take_last();
            if self.len > 0 {
                self.sift_down(ROOT, last, &key);
            }
        }
    }

    /// Removes and returns the last word.
    #[inline]
    fn take_last(&mut self) -> u64 {
        self.len -= 1;
        let end = ROOT + self.len();
        let group = self.groups.get_mut(end / 4);
        group.map_or(u64::MAX, |Group(group)| core::mem::replace(&mut group[end % 4], NOTHING[end % 4]))
    }

    /// Restores the order after the instant or key of a number changed.
    pub fn moved<K: Ord>(&mut self, number: Slot, instant: Instant, key: impl Fn(Slot) -> K) {
        if let Some(place) = self.place_of(number) {
            self.settle(place, word(instant, number), &key);
        }
    }

    /// Adds, moves or removes a number: afterwards it is in the heap exactly if it has an instant.
    pub fn set<K: Ord>(&mut self, number: Slot, instant: Option<Instant>, key: impl Fn(Slot) -> K) {
        match (self.place_of(number), instant) {
            (Some(place), Some(instant)) if self.len == 1 => self.put(place, word(instant, number)),
            (Some(place), Some(instant)) => self.settle(place, word(instant, number), &key),
            (Some(place), None) => self.remove_at(place, &key),
            (None, Some(instant)) => self.push(number, instant, key),
            (None, None) => {}
        }
    }

    pub fn clear(&mut self) {
        let groups = (ROOT + self.len()).div_ceil(4).min(self.groups.len());
        self.groups[..groups].fill(Group(NOTHING));
        self.len = 0;
    }

    /// Rebuilds the heap after any instants changed.
    pub fn order<K: Ord>(&mut self, instant: impl Fn(Slot) -> Instant, key: impl Fn(Slot) -> K) {
        for at in (ROOT..ROOT + self.len()).rev() {
            let number = self.word_at(at).map_or(0, slot);
            self.sift_down(at, word(instant(number), number), &key);
        }
    }

    /// Whether every number is in the place that its instant and key require.
    pub fn is_in_order<K: Ord>(&self, instant: impl Fn(Slot) -> Instant, key: impl Fn(Slot) -> K) -> bool {
        let above = |at: usize| if at > ROOT { self.word_at(parent(at)) } else { None };
        let stands = |(at, found): (usize, u64)| {
            found == word(instant(slot(found)), slot(found))
                && self.place_of(slot(found)) == Some(at)
                && above(at).is_none_or(|above| !is_less(found, above, &key))
        };
        let all = || self.groups.iter().flat_map(|Group(group)| group).enumerate();
        let free = |at: usize| at < ROOT || at >= ROOT + self.len();
        (ROOT..).zip(self.heap()).all(stands)
            && all().filter(|&(at, _)| free(at)).all(|(at, &word)| word == NOTHING[at % 4])
    }

    /// Validates a deserialised heap: every word names one of `capacity` numbers, and every number in the heap has
    /// the right place. Call it before anything else.
    pub fn is_whole(&self, capacity: usize) -> bool {
        let groups = if capacity == 0 { 0 } else { (ROOT + capacity).div_ceil(4) };
        let whole = self.places.len() == capacity && self.groups.len() == groups && self.len() <= capacity;
        let placed = |(at, word): (usize, u64)| {
            let number = slot(word);
            !is_nothing(word) && usize::from(number) < capacity && self.place_of(number) == Some(at)
        };
        whole && (ROOT..).zip(self.heap()).all(placed)
    }

    /// Moves a word up or down from `at` until the heap order holds.
    fn settle<K: Ord>(&mut self, at: usize, moving: u64, key: &impl Fn(Slot) -> K) {
        let above = if at > ROOT { self.word_at(parent(at)) } else { None };
        if above.is_some_and(|above| is_less(moving, above, key)) {
            self.sift_up(at, moving, key);
        } else {
            self.sift_down(at, moving, key);
        }
    }

    #[inline]
    fn sift_up<K: Ord>(&mut self, mut at: usize, moving: u64, key: &impl Fn(Slot) -> K) {
        while at > ROOT {
            let parent = parent(at);
            let Some(above) = self.word_at(parent).filter(|&above| is_less(moving, above, key)) else {
                break;
            };
            self.place(at, above);
            at = parent;
        }
        self.place(at, moving);
    }

    fn sift_down<K: Ord>(&mut self, mut at: usize, moving: u64, key: &impl Fn(Slot) -> K) {
        let mut children = at.wrapping_sub(2);
        while let Some(group) = self.groups.get(children) {
            let child = least(group, key);
            let below = group.0[child];
            if !is_less(below, moving, key) {
                break;
            }
            self.place(at, below);
            at = (children << 2) | child;
            children = at.wrapping_sub(2);
        }
        self.place(at, moving);
    }

    fn place(&mut self, at: usize, word: u64) {
        self.put(at, word);
        self.places[usize::from(slot(word))] = narrow(at.wrapping_sub(ROOT));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_word_where_nothing_should_stand_is_no_order() {
        let (instant, key) = (|_: Slot| Instant(7), |slot: Slot| slot);
        let mut heap = Heap::new(4);
        heap.push(0, Instant(7), key);
        assert!(heap.is_in_order(instant, key));
        heap.put(ROOT + 1, word(Instant(7), 1));
        assert!(!heap.is_in_order(instant, key), "behind the last one");
        let mut heap = Heap::new(4);
        heap.put(0, word(Instant(7), 1));
        assert!(!heap.is_in_order(instant, key), "before the first place");
    }
}
