//! A hash index of fixed size: small keys to slots of a queue, without allocating.

use crate::queue::Slot;
use alloc::boxed::Box;
use alloc::vec;

/// The number of low bits of an entry that hold the slot. The bits above them hold the key plus one, so no entry is zero:
/// zero marks a free place.
const SLOT_BITS: u32 = 16;
const EMPTY: u64 = 0;

/// A hash index with open addressing and linear probing. It is at most half full, so that a search looks at few places.
#[derive(Clone, Debug)]
pub(crate) struct Index {
    places: Box<[u64]>,
    /// The shift that reduces the hash of a key to the place where probing for it begins.
    shift: u32,
}

/// The place of a key, or the free place where it may be stored.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place(usize);

fn word(key: u32, slot: Slot) -> u64 {
    ((u64::from(key) + 1) << SLOT_BITS) | u64::from(slot)
}

const fn is_of(word: u64, key: u32) -> bool {
    word >> SLOT_BITS == key as u64 + 1
}

#[expect(clippy::cast_possible_truncation, reason = "the low bits are the slot")]
const fn slot(word: u64) -> Slot {
    word as Slot
}

impl Index {
    /// An index for `capacity` keys. No other function of the index allocates.
    pub fn new(capacity: u16) -> Self {
        let places = (usize::from(capacity) * 2).next_power_of_two().max(2);
        Self { places: vec![EMPTY; places].into_boxed_slice(), shift: u32::BITS - places.trailing_zeros() }
    }

    /// The place where probing for a key begins. Multiplying by the golden ratio spreads consecutive keys.
    const fn home(&self, key: u32) -> usize {
        (key.wrapping_mul(0x9e37_79b9) >> self.shift) as usize
    }

    const fn after(&self, place: usize) -> usize {
        (place + 1) & (self.places.len() - 1)
    }

    /// The place and the slot of a key; for a new key, a free place for [`note`](Self::note), valid until the index changes.
    pub fn look(&self, key: u32) -> (Place, Option<Slot>) {
        let mut place = self.home(key);
        loop {
            match self.places[place] {
                EMPTY => return (Place(place), None),
                word if is_of(word, key) => return (Place(place), Some(slot(word))),
                _ => place = self.after(place),
            }
        }
    }

    /// Stores the slot of a key at the place that [`look`](Self::look) returned. There must be fewer keys than the capacity.
    pub fn note(&mut self, Place(place): Place, key: u32, slot: Slot) {
        self.places[place] = word(key, slot);
    }

    /// Removes a key and returns its slot.
    pub fn remove(&mut self, key: u32) -> Option<Slot> {
        let (Place(mut hole), found) = self.look(key);
        found?;
        // Entries that were stored further on, because this place was taken, move back into the hole, so that every
        // search still finds its key.
        let mut place = self.after(hole);
        loop {
            let word = self.places[place];
            if word == EMPTY {
                break;
            }
            let mask = self.places.len() - 1;
            let from_home = place.wrapping_sub(self.home(key_of(word))) & mask;
            let from_hole = place.wrapping_sub(hole) & mask;
            if from_home >= from_hole {
                self.places[hole] = word;
                hole = place;
            }
            place = self.after(place);
        }
        self.places[hole] = EMPTY;
        found
    }

    #[cfg(feature = "checker")]
    pub fn clear(&mut self) {
        self.places.fill(EMPTY);
    }
}

#[expect(clippy::cast_possible_truncation, reason = "a key has 32 bits")]
const fn key_of(word: u64) -> u32 {
    ((word >> SLOT_BITS) - 1) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::collections::BTreeMap;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn behaves_like_a_map(steps in proptest::collection::vec((any::<bool>(), 0..40_u32), 0..200)) {
            let mut index = Index::new(12);
            let mut map = BTreeMap::new();
            for (n, (insert, key)) in steps.into_iter().enumerate() {
                let slot = u16::try_from(n).unwrap();
                if insert && map.len() < 12 && !map.contains_key(&key) {
                    let (place, found) = index.look(key);
                    prop_assert_eq!(found, None);
                    index.note(place, key, slot);
                    map.insert(key, slot);
                } else if !insert {
                    prop_assert_eq!(index.remove(key), map.remove(&key));
                }
                for key in 0..40 {
                    prop_assert_eq!(index.look(key).1, map.get(&key).copied());
                }
            }
            index.clear();
            prop_assert!((0..40).all(|key| index.look(key).1.is_none()));
        }
    }

    /// Timer keys are a task number followed by a small number. Probing stays short with all of them present.
    #[test]
    fn keys_spread() {
        let mut index = Index::new(512);
        let keys = || (0..64_u32).flat_map(|task| (0..8).map(move |id| (task << 8) | id));
        for (slot, key) in keys().enumerate() {
            let (place, _) = index.look(key);
            index.note(place, key, u16::try_from(slot).unwrap());
        }
        let mask = index.places.len() - 1;
        let steps = |key| index.look(key).0.0.wrapping_sub(index.home(key)) & mask;
        let (all, worst) = keys().map(steps).fold((0, 0), |(all, worst), n| (all + n, worst.max(n)));
        assert!(all < 512 && worst < 16, "{all} steps for 512 keys, {worst} for one");
    }
}
