//! A bounded queue of what waits, in three orders at once: the most urgent first (§III), what is due first, and what makes
//! room first (D60).
//!
//! Each order is a 4-ary heap of slots, two bytes an entry and two more for its place: sifting never moves a message, every
//! entry can be removed by its slot, and each change costs O(log n).

use crate::ticks::Ticks;
use alloc::boxed::Box;
use alloc::vec::Vec;
use core::cmp::Reverse;
use serde::{Deserialize, Serialize};

/// Names an entry while it is in the queue.
pub type Slot = u16;

/// What decides the places of an entry.
pub trait Entry {
    /// Whether urgency is all that matters: then the other two orders are not kept.
    const PLAIN: bool = false;

    /// Its urgency: the least is served first. No two entries of a queue have the same.
    fn key(&self) -> u128;
    /// When it is to be looked at again.
    fn due(&self) -> Ticks;
    /// Whether it makes room before those that do not, however urgent.
    fn yields(&self) -> bool;
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Queue<T> {
    entries: Box<[Option<T>]>,
    free: Vec<Slot>,
    urgent: Heap,
    due: Heap,
    last: Heap,
}

/// A queue of nothing, which takes no memory.
impl<T: Entry> Default for Queue<T> {
    fn default() -> Self {
        Self::new(0)
    }
}

fn urgency<T: Entry>(entries: &[Option<T>], slot: Slot) -> u128 {
    entries[usize::from(slot)].as_ref().map_or(u128::MAX, Entry::key)
}

fn due<T: Entry>(entries: &[Option<T>], slot: Slot) -> (Ticks, u128) {
    entries[usize::from(slot)].as_ref().map_or((Ticks::FAR, u128::MAX), |entry| (entry.due(), entry.key()))
}

fn last<T: Entry>(entries: &[Option<T>], slot: Slot) -> Reverse<(bool, u128)> {
    Reverse(entries[usize::from(slot)].as_ref().map_or((false, 0), |entry| (entry.yields(), entry.key())))
}

impl<T: Entry> Queue<T> {
    /// A queue of at most `capacity` entries. The only allocation it ever makes.
    pub fn new(capacity: u16) -> Self {
        let others = if T::PLAIN { 0 } else { capacity };
        let [urgent, due, last] = [capacity, others, others].map(Heap::new);
        let entries = (0..capacity).map(|_| None).collect();
        Self { entries, free: (0..capacity).rev().collect(), urgent, due, last }
    }

    #[expect(clippy::len_without_is_empty, reason = "public for measurements alone")]
    pub fn len(&self) -> usize {
        self.urgent.slots.len()
    }

    pub fn capacity(&self) -> usize {
        self.entries.len()
    }

    /// Adds an entry, or hands it back when the queue is full.
    pub fn push(&mut self, entry: T) -> Result<Slot, T> {
        let Some(slot) = self.free.pop() else { return Err(entry) };
        self.entries[usize::from(slot)] = Some(entry);
        let entries = &self.entries;
        self.urgent.push(slot, |slot| urgency(entries, slot));
        if !T::PLAIN {
            self.due.push(slot, |slot| due(entries, slot));
            self.last.push(slot, |slot| last(entries, slot));
        }
        Ok(slot)
    }

    pub fn get(&self, slot: Slot) -> Option<&T> {
        self.entries.get(usize::from(slot))?.as_ref()
    }

    /// The most urgent entry.
    pub fn first(&self) -> Option<(Slot, &T)> {
        self.named(self.urgent.first())
    }

    /// The entry that makes room first: of those that yield, or of all if none does, the least urgent one.
    pub fn last(&self) -> Option<(Slot, &T)> {
        self.named(self.last.first())
    }

    /// When the first of them is due: never, where there is none.
    pub fn next_due(&self) -> Ticks {
        self.named(self.due.first()).map_or(Ticks::FAR, |(_, entry)| entry.due())
    }

    fn named(&self, slot: Option<Slot>) -> Option<(Slot, &T)> {
        slot.and_then(|slot| Some((slot, self.get(slot)?)))
    }

    /// Takes an entry out.
    pub fn remove(&mut self, slot: Slot) -> Option<T> {
        self.get(slot)?;
        let entries = &self.entries;
        self.urgent.remove(slot, |slot| urgency(entries, slot));
        if !T::PLAIN {
            self.due.remove(slot, |slot| due(entries, slot));
            self.last.remove(slot, |slot| last(entries, slot));
        }
        self.free.push(slot);
        self.entries[usize::from(slot)].take()
    }

    /// Takes out the most urgent entry, if `take` wants it.
    pub fn pop_if(&mut self, take: impl FnOnce(&T) -> bool) -> Option<T> {
        let (slot, entry) = self.first()?;
        if take(entry) { self.remove(slot) } else { None }
    }

    /// Takes out the entry that is due first, if it is by `now`.
    pub fn pop_due(&mut self, now: Ticks) -> Option<T> {
        let (slot, entry) = self.named(self.due.first())?;
        if entry.due() <= now { self.remove(slot) } else { None }
    }

    /// All entries in no particular order.
    pub fn iter(&self) -> impl Iterator<Item = (Slot, &T)> {
        self.urgent.slots.iter().filter_map(|&slot| self.named(Some(slot)))
    }

    /// The entries that are due by `now`, in no particular order. Costs as many steps as there are of them.
    pub fn all_due(&self, now: Ticks) -> impl Iterator<Item = (Slot, &T)> {
        let is_due = move |slot: Slot| self.get(slot).is_some_and(|entry| entry.due() <= now);
        self.due.upper(is_due).filter_map(|slot| self.named(Some(slot)))
    }

    /// All entries, most urgent first. Allocates: for views and canonical states, not for the message path.
    pub fn sorted(&self) -> Vec<(Slot, &T)> {
        let mut all: Vec<_> = self.iter().collect();
        all.sort_unstable_by_key(|(_, entry)| entry.key());
        all
    }

    /// Changes one entry and finds its new places.
    pub fn change(&mut self, slot: Slot, change: impl FnOnce(&mut T)) {
        let Some(entry) = self.entries.get_mut(usize::from(slot)).and_then(Option::as_mut) else { return };
        change(entry);
        let entries = &self.entries;
        self.urgent.moved(slot, |slot| urgency(entries, slot));
        if !T::PLAIN {
            self.due.moved(slot, |slot| due(entries, slot));
            self.last.moved(slot, |slot| last(entries, slot));
        }
    }

    /// Changes every entry; the queue is put in order again afterwards.
    pub fn change_all(&mut self, change: impl FnMut(&mut T)) {
        self.entries.iter_mut().flatten().for_each(change);
        let entries = &self.entries;
        self.urgent.order(|slot| urgency(entries, slot));
        self.due.order(|slot| due(entries, slot));
        self.last.order(|slot| last(entries, slot));
    }

    /// Changes what decides no entry's place.
    pub fn adjust(&mut self, change: impl FnMut(&mut T)) {
        self.entries.iter_mut().flatten().for_each(change);
    }

    /// Removes everything.
    pub fn clear(&mut self) {
        if self.urgent.slots.is_empty() && self.free.is_sorted_by(|a, b| a >= b) {
            return;
        }
        self.entries.fill_with(|| None);
        [&mut self.urgent, &mut self.due, &mut self.last].into_iter().for_each(|heap| heap.slots.clear());
        // Slots are handed out from the same order whatever went before: two equal queues stay equal in the future.
        self.free.clear();
        self.free.extend((0..narrow(self.entries.len())).rev());
    }
}

/// Slots in the order of a key that the queue knows: the least is at 0, the children of `i` at `4 i + 1 ..= 4 i + 4`.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Heap {
    slots: Vec<Slot>,
    /// Where a slot stands.
    positions: Box<[u16]>,
}

impl Heap {
    fn new(capacity: u16) -> Self {
        let positions = (0..capacity).map(|_| 0).collect();
        Self { slots: Vec::with_capacity(usize::from(capacity)), positions }
    }

    fn first(&self) -> Option<Slot> {
        self.slots.first().copied()
    }

    fn push<K: Ord>(&mut self, slot: Slot, key: impl Fn(Slot) -> K) {
        self.slots.push(slot);
        self.sift_up(self.slots.len() - 1, &key);
    }

    fn remove<K: Ord>(&mut self, slot: Slot, key: impl Fn(Slot) -> K) {
        let position = usize::from(self.positions[usize::from(slot)]);
        self.slots.swap_remove(position);
        if let Some(&moved) = self.slots.get(position) {
            self.place(position, moved);
            self.moved(moved, key);
        }
    }

    fn moved<K: Ord>(&mut self, slot: Slot, key: impl Fn(Slot) -> K) {
        let position = usize::from(self.positions[usize::from(slot)]);
        self.sift_down(position, &key);
        self.sift_up(usize::from(self.positions[usize::from(slot)]), &key);
    }

    fn order<K: Ord>(&mut self, key: impl Fn(Slot) -> K) {
        for position in (0..self.slots.len()).rev() {
            self.sift_down(position, &key);
        }
    }

    /// The slots of the greatest part around the first one of which `is_in` holds, parents before children: where that
    /// holds of all slots below some key, these.
    fn upper(&self, is_in: impl Fn(Slot) -> bool) -> impl Iterator<Item = Slot> {
        let mut at = Some(0);
        core::iter::from_fn(move || {
            loop {
                let position = at?;
                let slot = self.slots.get(position).copied();
                let found = slot.filter(|&slot| is_in(slot));
                let child = 4 * position + 1;
                at = match found {
                    Some(_) if child < self.slots.len() => Some(child),
                    Some(_) | None => self.beside(position),
                };
                if found.is_some() {
                    return found;
                }
            }
        })
    }

    /// The next position to look at when those below one are done with.
    fn beside(&self, mut position: usize) -> Option<usize> {
        while position > 0 {
            if !position.is_multiple_of(4) && position + 1 < self.slots.len() {
                return Some(position + 1);
            }
            position = (position - 1) / 4;
        }
        None
    }

    fn sift_up<K: Ord>(&mut self, mut at: usize, key: &impl Fn(Slot) -> K) {
        let moving = self.slots[at];
        let own = key(moving);
        while at > 0 {
            let parent = (at - 1) / 4;
            if key(self.slots[parent]) <= own {
                break;
            }
            self.place(at, self.slots[parent]);
            at = parent;
        }
        self.place(at, moving);
    }

    fn sift_down<K: Ord>(&mut self, mut at: usize, key: &impl Fn(Slot) -> K) {
        let moving = self.slots[at];
        let own = key(moving);
        loop {
            let first = 4 * at + 1;
            let children = first..(first + 4).min(self.slots.len());
            let Some(least) = children.min_by_key(|&child| key(self.slots[child])) else { break };
            if key(self.slots[least]) >= own {
                break;
            }
            self.place(at, self.slots[least]);
            at = least;
        }
        self.place(at, moving);
    }

    fn place(&mut self, at: usize, slot: Slot) {
        self.slots[at] = slot;
        self.positions[usize::from(slot)] = narrow(at);
    }
}

#[expect(clippy::cast_possible_truncation, reason = "a queue has at most 65,535 entries")]
const fn narrow(position: usize) -> u16 {
    position as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Clone, Copy, Debug, PartialEq)]
    struct Item {
        key: u128,
        due: u64,
        yields: bool,
    }

    impl Entry for Item {
        fn key(&self) -> u128 {
            self.key
        }
        fn due(&self) -> Ticks {
            Ticks(self.due)
        }
        fn yields(&self) -> bool {
            self.yields
        }
    }

    /// What the queue says against what a plain list says.
    fn agrees(queue: &Queue<Item>, model: &[(Slot, Item)]) -> Result<(), TestCaseError> {
        let named = |found: Option<(Slot, &Item)>| found.map(|(slot, item)| (slot, *item));
        prop_assert_eq!((queue.len(), queue.capacity()), (model.len(), 20));
        prop_assert_eq!(named(queue.first()), model.iter().min_by_key(|(_, i)| i.key).copied());
        prop_assert_eq!(named(queue.last()), model.iter().max_by_key(|(_, i)| (i.yields, i.key)).copied());
        let due = model.iter().map(|(_, i)| Ticks(i.due)).min().unwrap_or(Ticks::FAR);
        prop_assert_eq!(queue.next_due(), due);
        let mut sorted = model.to_vec();
        sorted.sort_by_key(|(_, i)| i.key);
        let found: Vec<_> = queue.sorted().into_iter().map(|(slot, item)| (slot, *item)).collect();
        prop_assert_eq!(&found, &sorted);
        for now in [0, 2, 5, 9] {
            let mut found: Vec<_> = queue.all_due(Ticks(now)).map(|(slot, _)| slot).collect();
            found.sort_unstable();
            let mut all: Vec<_> = model.iter().filter(|(_, i)| i.due <= now).map(|&(slot, _)| slot).collect();
            all.sort_unstable();
            prop_assert_eq!(found, all, "due by {}", now);
        }
        Ok(())
    }

    proptest! {
        /// Against a plain list: pushes, pops, removals and changes of any entry, and of all.
        #[test]
        fn behaves_like_a_list(steps in proptest::collection::vec((0..9_u8, any::<u16>(), 0..10_u64, any::<bool>()), 0..200)) {
            let mut queue = Queue::new(20);
            let mut model: Vec<(Slot, Item)> = Vec::new();
            for (n, (what, a, at, yields)) in steps.into_iter().enumerate() {
                let item = Item { key: (u128::from(a) << 64) | n as u128, due: at, yields };
                let nth = model.get(usize::from(a) % 20).copied();
                match (what, nth) {
                    (0..=3, _) => match queue.push(item) {
                        Ok(slot) => model.push((slot, item)),
                        Err(back) => prop_assert!(back == item && model.len() == 20),
                    },
                    (4, _) => {
                        let popped = queue.pop_if(|_| true);
                        let first = model.iter().min_by_key(|(_, i)| i.key).copied();
                        prop_assert_eq!(popped, first.map(|(_, item)| item));
                        model.retain(|&entry| Some(entry) != first);
                    }
                    (5, _) => {
                        let popped = queue.pop_due(Ticks(4));
                        let first = model.iter().filter(|(_, i)| i.due <= 4).min_by_key(|(_, i)| (i.due, i.key));
                        prop_assert_eq!(popped, first.map(|&(_, item)| item));
                        model.retain(|&(_, item)| Some(item) != popped);
                    }
                    (6, _) => {
                        queue.change_all(|item| item.key ^= 0xff << 64);
                        model.iter_mut().for_each(|(_, item)| item.key ^= 0xff << 64);
                    }
                    (7, Some((slot, old))) => {
                        prop_assert_eq!(queue.remove(slot), Some(old));
                        prop_assert_eq!(queue.remove(slot), None);
                        model.retain(|&(s, _)| s != slot);
                    }
                    (_, Some((slot, _))) => {
                        queue.change(slot, |old| *old = item);
                        model.iter_mut().filter(|(s, _)| *s == slot).for_each(|(_, old)| *old = item);
                    }
                    (_, None) => {}
                }
                agrees(&queue, &model)?;
            }
            queue.clear();
            agrees(&queue, &[])?;
            let again = Item { key: 1, due: 1, yields: false };
            prop_assert_eq!((queue.push(again), queue.push(again)), (Ok(0), Ok(1)));
        }
    }
}
