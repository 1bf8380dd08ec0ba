//! A hash index of fixed size: small keys to slots of a queue, without allocating.

use crate::queue::Slot;
use alloc::boxed::Box;
use alloc::vec;

/// Open addressing with linear probing; at most half full, so that a search looks at few places.
#[derive(Clone, Debug)]
pub(crate) struct Index {
    places: Box<[Option<(u32, Slot)>]>,
}

impl Index {
    /// An index for `capacity` keys. The only allocation it ever makes.
    pub fn new(capacity: u16) -> Self {
        let places = (usize::from(capacity) * 2).next_power_of_two();
        Self { places: vec![None; places].into_boxed_slice() }
    }

    /// Where the probing for a key begins: the high bits of a product by the golden ratio.
    fn home(&self, key: u32) -> usize {
        let mixed = key.wrapping_mul(0x9e37_79b9) >> 8;
        mixed as usize & (self.places.len() - 1)
    }

    fn after(&self, place: usize) -> usize {
        (place + 1) & (self.places.len() - 1)
    }

    /// Where a key stands.
    fn find(&self, key: u32) -> Option<usize> {
        let mut place = self.home(key);
        while let Some((known, _)) = self.places[place] {
            if known == key {
                return Some(place);
            }
            place = self.after(place);
        }
        None
    }

    /// Notes the slot of a key that is not known. There must be fewer keys than the capacity.
    pub fn insert(&mut self, key: u32, slot: Slot) {
        let mut place = self.home(key);
        while self.places[place].is_some() {
            place = self.after(place);
        }
        self.places[place] = Some((key, slot));
    }

    /// Forgets a key and says where it was.
    pub fn remove(&mut self, key: u32) -> Option<Slot> {
        let mut hole = self.find(key)?;
        let (_, slot) = self.places[hole].take()?;
        // What was pushed past the hole by others moves back into it, so that every search still finds its key.
        let mut place = self.after(hole);
        while let Some((other, _)) = self.places[place] {
            let mask = self.places.len() - 1;
            let from_home = place.wrapping_sub(self.home(other)) & mask;
            let from_hole = place.wrapping_sub(hole) & mask;
            if from_home >= from_hole {
                self.places[hole] = self.places[place].take();
                hole = place;
            }
            place = self.after(place);
        }
        Some(slot)
    }

    pub fn clear(&mut self) {
        self.places.fill(None);
    }
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
                    index.insert(key, slot);
                    map.insert(key, slot);
                } else if !insert {
                    prop_assert_eq!(index.remove(key), map.remove(&key));
                }
                for key in 0..40 {
                    let place = index.find(key);
                    prop_assert_eq!(place.and_then(|p| index.places[p]).map(|(_, s)| s), map.get(&key).copied());
                }
            }
            index.clear();
            prop_assert!((0..40).all(|key| index.find(key).is_none()));
        }
    }

    /// Names of timers are tasks with a small number behind them: a search among all of them looks at few places.
    #[test]
    fn keys_spread() {
        let mut index = Index::new(512);
        let keys = || (0..64_u32).flat_map(|task| (0..8).map(move |id| (task << 8) | id));
        keys().enumerate().for_each(|(slot, key)| index.insert(key, u16::try_from(slot).unwrap()));
        let mask = index.places.len() - 1;
        let steps = |key| index.find(key).map(|place| place.wrapping_sub(index.home(key)) & mask).unwrap();
        let (all, worst) = keys().map(steps).fold((0, 0), |(all, worst), n| (all + n, worst.max(n)));
        assert!(all < 512 && worst < 16, "{all} steps for 512 keys, {worst} for one");
    }
}
