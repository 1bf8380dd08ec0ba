//! A bounded queue of what waits: the most urgent first (§III), and where it is watched, what is due first, too. Who makes
//! room (D60) is looked for when the queue is full (D108).
//!
//! The order of urgency has a word of eight bytes for each entry and two more for its place ([`Words`]): sifting never moves
//! an entry, each can be removed by its slot, and each change costs O(log n). What is due first is kept likewise.

mod words;

pub use words::Words;

use crate::ticks::Instant;
use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};

/// Names an entry while it is in the queue.
pub type Slot = u16;

/// No slot: a queue has at most 65,535.
const NONE: Slot = Slot::MAX;

/// What decides the places of an entry.
pub trait Entry {
    /// What is kept of an entry beside it where the queue is watched, and decides when it is due.
    type Side: Copy + Default;

    /// Its urgency, an instant in the upper half: the least is served first. No two entries of a queue have the same.
    fn key(&self) -> u128;
    /// When it is to be looked at again.
    fn due(&self, side: &Self::Side) -> Instant;
    /// Whether it makes room before those that do not, however urgent.
    fn yields(&self) -> bool;
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound(
    serialize = "T: Serialize, T::Side: Serialize",
    deserialize = "T: Deserialize<'de>, T::Side: Deserialize<'de>"
))]
pub struct Queue<T: Entry> {
    entries: Box<[Option<T>]>,
    /// What a queue of at most one entry does not need, unless it is watched.
    order: Option<Box<Order<T::Side>>>,
}

/// The places of the entries.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Order<S> {
    /// Beside the place of a slot that is taken, the next one of a slot that is free.
    urgent: Words,
    free: Slot,
    /// Who makes room first, while nothing has changed that since it was looked for.
    #[serde(skip)]
    last: Option<Slot>,
    watch: Option<Watch<S>>,
}

/// What a queue that is watched keeps besides.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Watch<S> {
    sides: Box<[S]>,
    due: Words,
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

fn due<T: Entry>(entries: &[Option<T>], sides: &[T::Side], slot: Slot) -> (Instant, u128) {
    let (entry, side) = (entries[usize::from(slot)].as_ref(), &sides[usize::from(slot)]);
    entry.map_or((Instant::NEVER, u128::MAX), |entry| (entry.due(side), entry.key()))
}

/// The instant in a key.
fn instant(key: u128) -> Instant {
    Instant((key >> 64) as u64)
}

impl<S: Copy + Default> Order<S> {
    /// All slots are free, the lowest is taken first.
    fn new(capacity: u16) -> Self {
        let mut new = Self { urgent: Words::new(capacity), free: NONE, last: None, watch: None };
        new.free_all();
        new
    }

    fn free_all(&mut self) {
        self.free = NONE;
        for slot in (0..narrow(self.urgent.capacity())).rev() {
            self.give_back(slot);
        }
    }

    fn give_back(&mut self, slot: Slot) {
        self.urgent.keep(slot, self.free);
        self.free = slot;
    }

    /// The entry of the first free slot has come.
    #[inline]
    fn put<T: Entry<Side = S>>(&mut self, entries: &[Option<T>], slot: Slot, key: u128, side: S) {
        self.free = self.urgent.kept(slot);
        self.urgent.push(slot, instant(key), |slot| urgency(entries, slot));
        if let Some(Watch { sides, due: order }) = &mut self.watch {
            sides[usize::from(slot)] = side;
            let key = |slot| due(entries, sides, slot);
            order.push(slot, key(slot).0, key);
        }
    }

    /// An entry goes.
    fn take_out<T: Entry<Side = S>>(&mut self, entries: &[Option<T>], slot: Slot) {
        self.urgent.remove(slot, |slot| urgency(entries, slot));
        self.forget(entries, slot);
    }

    /// The most urgent entry goes.
    #[inline]
    fn pop<T: Entry<Side = S>>(&mut self, entries: &[Option<T>], slot: Slot) {
        self.urgent.pop(|slot| urgency(entries, slot));
        self.forget(entries, slot);
    }

    /// An entry has gone from the order of urgency.
    #[inline]
    fn forget<T: Entry<Side = S>>(&mut self, entries: &[Option<T>], slot: Slot) {
        if let Some(Watch { sides, due: order }) = &mut self.watch {
            order.remove(slot, |slot| due(entries, sides, slot));
        }
        self.give_back(slot);
        if self.last == Some(slot) {
            self.last = None;
        }
    }

    /// What decides places has changed everywhere.
    fn renew<T: Entry<Side = S>>(&mut self, entries: &[Option<T>]) {
        let key = |slot| urgency(entries, slot);
        self.urgent.order(|slot| instant(key(slot)), key);
        if let Some(Watch { sides, due: order }) = &mut self.watch {
            let key = |slot| due(entries, sides, slot);
            order.order(|slot| key(slot).0, key);
        }
        self.last = None;
    }

    fn is_right<T: Entry<Side = S>>(&self, entries: &[Option<T>]) -> bool {
        let key = |slot| urgency(entries, slot);
        let urgent = self.urgent.is_in_order(|slot| instant(key(slot)), key);
        let dues = self.watch.as_ref().is_none_or(|watch| {
            let key = |slot| due(entries, &watch.sides, slot);
            watch.due.len() == self.urgent.len() && watch.due.is_in_order(|slot| key(slot).0, key)
        });
        let last = (0..).zip(entries).filter_map(|(slot, entry)| Some((slot, entry.as_ref()?)));
        let last = last.max_by_key(|(_, entry)| (entry.yields(), entry.key())).map(|(slot, _)| slot);
        let held = entries.iter().flatten().count() == self.urgent.len();
        urgent && dues && held && (self.last.is_none() || self.last == last)
    }
}

impl<T: Entry> Queue<T> {
    /// A queue of at most `capacity` entries. It allocates now, and when it is watched first.
    pub fn new(capacity: u16) -> Self {
        let entries = (0..capacity).map(|_| None).collect();
        Self { entries, order: (capacity > 1).then(|| Box::new(Order::new(capacity))) }
    }

    /// As [`new`](Self::new), and watched.
    pub fn watched(capacity: u16) -> Self {
        let mut new = Self::new(capacity);
        new.watch();
        new
    }

    /// From here on it is known what is due first.
    pub fn watch(&mut self) {
        if self.watching().is_some() {
            return;
        }
        let entries = &self.entries;
        let order = self.order.get_or_insert_with(|| {
            let mut order = Order::new(narrow(entries.len()));
            if let Some(Some(one)) = entries.first() {
                order.put(entries, 0, one.key(), T::Side::default());
            }
            Box::new(order)
        });
        let sides: Box<[T::Side]> = vec![T::Side::default(); entries.len()].into();
        let mut due_first = Words::new(narrow(entries.len()));
        for slot in order.urgent.iter() {
            let key = |slot| due(entries, &sides, slot);
            due_first.push(slot, key(slot).0, key);
        }
        order.watch = Some(Watch { sides, due: due_first });
    }

    fn watching(&self) -> Option<&Watch<T::Side>> {
        self.order.as_ref()?.watch.as_ref()
    }

    #[expect(clippy::len_without_is_empty, reason = "public for measurements alone")]
    pub fn len(&self) -> usize {
        match &self.order {
            Some(order) => order.urgent.len(),
            None => usize::from(self.entries.first().is_some_and(Option::is_some)),
        }
    }

    pub fn capacity(&self) -> usize {
        self.entries.len()
    }

    /// Adds an entry, or hands it back when the queue is full.
    pub fn push(&mut self, entry: T) -> Result<Slot, T> {
        self.push_with(entry, T::Side::default())
    }

    /// As [`push`](Self::push), with what is kept beside it where the queue is watched.
    #[inline]
    pub fn push_with(&mut self, entry: T, side: T::Side) -> Result<Slot, T> {
        let slot = self.order.as_ref().map_or(0, |order| order.free);
        let Some(vacant) = self.entries.get_mut(usize::from(slot)) else { return Err(entry) };
        let Some(order) = self.order.as_deref_mut() else {
            return if vacant.is_some() { Err(entry) } else { Ok((*vacant = Some(entry), slot).1) };
        };
        let (key, yields) = (entry.key(), entry.yields());
        *vacant = Some(entry);
        order.put(&self.entries, slot, key, side);
        if let Some(last) = order.last.and_then(|last| self.entries[usize::from(last)].as_ref())
            && (yields, key) > (last.yields(), last.key())
        {
            order.last = Some(slot);
        }
        Ok(slot)
    }

    pub fn get(&self, slot: Slot) -> Option<&T> {
        self.entries.get(usize::from(slot))?.as_ref()
    }

    /// What is kept beside an entry; the default where the queue is not watched.
    pub fn side(&self, slot: Slot) -> T::Side {
        self.watching().and_then(|watch| watch.sides.get(usize::from(slot)).copied()).unwrap_or_default()
    }

    /// The most urgent entry.
    pub fn first(&self) -> Option<(Slot, &T)> {
        self.named(self.order.as_ref().map_or(Some(0), |order| order.urgent.first()))
    }

    /// The entry that makes room first: of those that yield, or of all if none does, the least urgent one. It is looked for
    /// among all, and remembered until it goes.
    pub fn last(&mut self) -> Option<(Slot, &T)> {
        let Some(order) = &self.order else { return self.first() };
        let last = order.last.or_else(|| {
            let all = order.urgent.iter().filter_map(|slot| self.named(Some(slot)));
            all.max_by_key(|(_, entry)| (entry.yields(), entry.key())).map(|(slot, _)| slot)
        });
        if let Some(order) = &mut self.order {
            order.last = last;
        }
        self.named(last)
    }

    /// When the first of them is due: never, where there is none, or the queue is not watched.
    pub fn next_due(&self) -> Instant {
        let Some(watch) = self.watching() else { return Instant::NEVER };
        watch.due.first_instant(|slot| due(&self.entries, &watch.sides, slot).0)
    }

    fn named(&self, slot: Option<Slot>) -> Option<(Slot, &T)> {
        slot.and_then(|slot| Some((slot, self.get(slot)?)))
    }

    /// Takes an entry out.
    pub fn remove(&mut self, slot: Slot) -> Option<T> {
        self.get(slot)?;
        if let Some(order) = &mut self.order {
            order.take_out(&self.entries, slot);
        }
        self.entries[usize::from(slot)].take()
    }

    /// Takes out the most urgent entry, if `take` wants it.
    #[inline]
    pub fn pop_if(&mut self, take: impl FnOnce(&T) -> bool) -> Option<T> {
        let (slot, entry) = self.first()?;
        if !take(entry) {
            return None;
        }
        if let Some(order) = &mut self.order {
            order.pop(&self.entries, slot);
        }
        self.entries[usize::from(slot)].take()
    }

    /// Takes out the entry that is due first, if it is by `now`.
    pub fn pop_due(&mut self, now: Instant) -> Option<T> {
        let slot = self.watching()?.due.first()?;
        if self.next_due() <= now { self.remove(slot) } else { None }
    }

    /// All entries in no particular order.
    pub fn iter(&self) -> impl Iterator<Item = (Slot, &T)> {
        let ordered = self.order.iter().flat_map(|order| order.urgent.iter());
        let one = self.order.is_none().then_some(0);
        ordered.chain(one).filter_map(|slot| self.named(Some(slot)))
    }

    /// The entries of a watched queue that are due by `now`, in no particular order. Costs as many steps as there are of them.
    pub fn all_due(&self, now: Instant) -> impl Iterator<Item = (Slot, &T)> {
        let due_by = move |watch: &Watch<T::Side>, slot| due(&self.entries, &watch.sides, slot).0 <= now;
        let all = self.watching().map(|watch| watch.due.upper(move |slot| due_by(watch, slot)));
        all.into_iter().flatten().filter_map(|slot| self.named(Some(slot)))
    }

    /// All entries, most urgent first. Allocates: for views and canonical states, not for the message path.
    pub fn sorted(&self) -> Vec<(Slot, &T)> {
        let mut all: Vec<_> = self.iter().collect();
        all.sort_unstable_by_key(|(_, entry)| entry.key());
        all
    }

    /// Changes one entry, and what is kept beside it where the queue is watched, and finds its new places.
    pub fn change(&mut self, slot: Slot, change: impl FnOnce(&mut T, &mut T::Side)) {
        let mut side = self.side(slot);
        let Some(entry) = self.entries.get_mut(usize::from(slot)).and_then(Option::as_mut) else { return };
        change(entry, &mut side);
        let key = entry.key();
        let entries = &self.entries;
        let Some(order) = self.order.as_deref_mut() else { return };
        order.urgent.moved(slot, instant(key), |slot| urgency(entries, slot));
        if let Some(Watch { sides, due: order }) = &mut order.watch {
            sides[usize::from(slot)] = side;
            let key = |slot| due(entries, sides, slot);
            order.moved(slot, key(slot).0, key);
        }
        order.last = None;
    }

    /// Changes every entry; the queue is put in order again afterwards.
    pub fn change_all(&mut self, mut change: impl FnMut(&mut T, &mut T::Side)) {
        if self.len() == 0 {
            return;
        }
        self.adjust(&mut change);
        if let Some(order) = &mut self.order {
            order.renew(&self.entries);
        }
    }

    /// Changes what decides no entry's place.
    pub fn adjust(&mut self, mut change: impl FnMut(&mut T, &mut T::Side)) {
        let mut sides =
            self.order.as_mut().and_then(|order| order.watch.as_mut()).map(|watch| &mut watch.sides);
        for (at, entry) in self.entries.iter_mut().enumerate() {
            let Some(entry) = entry else { continue };
            match &mut sides {
                Some(sides) => change(entry, &mut sides[at]),
                None => change(entry, &mut T::Side::default()),
            }
        }
    }

    /// Removes everything.
    pub fn clear(&mut self) {
        self.entries.fill_with(|| None);
        let Some(order) = &mut self.order else { return };
        order.urgent.clear();
        if let Some(watch) = &mut order.watch {
            watch.due.clear();
        }
        // Slots are handed out from the same order whatever went before: two equal queues stay equal in the future.
        order.free_all();
        order.last = None;
    }

    /// Whether a queue that was read from a file has room for `capacity` entries, and its orders name each of them once: then
    /// no operation on it goes out of bounds. Asked before anything else of it.
    pub fn is_whole(&self, capacity: usize) -> bool {
        if self.entries.len() != capacity {
            return false;
        }
        let Some(order) = &self.order else { return capacity <= 1 };
        let (urgent, free) = (&order.urgent, capacity.saturating_sub(order.urgent.len()));
        if !urgent.is_whole(capacity) || self.entries.iter().flatten().count() != urgent.len() {
            return false;
        }
        let held = urgent.iter().all(|slot| self.get(slot).is_some());
        // The free slots are a list: all of them, each once, and an end.
        let mut next = order.free;
        let mut ends = true;
        let mut seen = vec![false; capacity];
        for _ in 0..free {
            let new = seen.get_mut(usize::from(next)).is_some_and(|seen| !core::mem::replace(seen, true));
            ends &= new && self.get(next).is_none();
            next = urgent.kept(next);
        }
        let watched = order.watch.as_ref().is_none_or(|Watch { sides, due }| {
            let same = due.len() == urgent.len() && urgent.iter().all(|slot| due.has(slot));
            sides.len() == capacity && due.is_whole(capacity) && same
        });
        held && ends && next == NONE && watched
    }

    /// Whether each order is what a look at all entries says.
    pub fn is_in_order(&self) -> bool {
        self.order.as_ref().is_none_or(|order| order.is_right(&self.entries))
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

    /// When it is due is kept beside it.
    #[derive(Clone, Copy, Debug, PartialEq)]
    struct Item {
        key: u128,
        yields: bool,
    }

    impl Entry for Item {
        type Side = Instant;
        fn key(&self) -> u128 {
            self.key
        }
        fn due(&self, side: &Instant) -> Instant {
            *side
        }
        fn yields(&self) -> bool {
            self.yields
        }
    }

    /// What the queue says against what a plain list says.
    fn agrees(queue: &mut Queue<Item>, model: &[(Slot, Item, u64)]) -> Result<(), TestCaseError> {
        let named = |found: Option<(Slot, &Item)>| found.map(|(slot, item)| (slot, *item));
        prop_assert_eq!((queue.len(), queue.capacity()), (model.len(), 20));
        let all = model.iter().map(|&(slot, item, _)| (slot, item));
        prop_assert_eq!(named(queue.first()), all.clone().min_by_key(|(_, i)| i.key));
        prop_assert_eq!(named(queue.last()), all.clone().max_by_key(|(_, i)| (i.yields, i.key)));
        let due = model.iter().map(|&(_, _, due)| Instant(due)).min().unwrap_or(Instant::NEVER);
        prop_assert_eq!(queue.next_due(), due);
        prop_assert!(queue.is_in_order());
        let mut sorted: Vec<_> = all.collect();
        sorted.sort_by_key(|(_, i)| i.key);
        let found: Vec<_> = queue.sorted().into_iter().map(|(slot, item)| (slot, *item)).collect();
        prop_assert_eq!(&found, &sorted);
        for now in [0, 2, 5, 9] {
            let mut found: Vec<_> = queue.all_due(Instant(now)).map(|(slot, _)| slot).collect();
            found.sort_unstable();
            let mut all: Vec<_> =
                model.iter().filter(|(_, _, due)| *due <= now).map(|&(slot, ..)| slot).collect();
            all.sort_unstable();
            prop_assert_eq!(found, all, "due by {}", now);
        }
        Ok(())
    }

    proptest! {
        /// Against a plain list: pushes, pops, removals and changes of any entry, and of all.
        #[test]
        fn behaves_like_a_list(steps in proptest::collection::vec((0..9_u8, any::<u16>(), 0..10_u64, any::<bool>()), 0..200)) {
            let mut queue = Queue::watched(20);
            let mut model: Vec<(Slot, Item, u64)> = Vec::new();
            for (n, (what, a, at, yields)) in steps.into_iter().enumerate() {
                // Some instants are equal, and some past the end of a word.
                let instant = u64::from(a % 8) << if a & 8 == 0 { 0 } else { 61 };
                let item = Item { key: (u128::from(instant) << 64) | n as u128, yields };
                let nth = model.get(usize::from(a) % 20).copied();
                match (what, nth) {
                    (0..=3, _) => match queue.push_with(item, Instant(at)) {
                        Ok(slot) => model.push((slot, item, at)),
                        Err(back) => prop_assert!(back == item && model.len() == 20),
                    },
                    (4, _) => {
                        let popped = queue.pop_if(|_| true);
                        let first = model.iter().min_by_key(|(_, i, _)| i.key).copied();
                        prop_assert_eq!(popped, first.map(|(_, item, _)| item));
                        model.retain(|&entry| Some(entry) != first);
                    }
                    (5, _) => {
                        let popped = queue.pop_due(Instant(4));
                        let first = model.iter().filter(|(_, _, due)| *due <= 4).min_by_key(|(_, i, due)| (*due, i.key));
                        prop_assert_eq!(popped, first.map(|&(_, item, _)| item));
                        model.retain(|&(_, item, _)| Some(item) != popped);
                    }
                    (6, _) => {
                        queue.change_all(|item, due| (item.key, *due) = (item.key ^ (0xff << 64), Instant(due.0 ^ 3)));
                        model.iter_mut().for_each(|(_, item, due)| (item.key, *due) = (item.key ^ (0xff << 64), *due ^ 3));
                    }
                    (7, Some((slot, old, _))) => {
                        prop_assert_eq!(queue.remove(slot), Some(old));
                        prop_assert_eq!(queue.remove(slot), None);
                        model.retain(|&(s, ..)| s != slot);
                    }
                    (_, Some((slot, ..))) => {
                        queue.change(slot, |old, due| (*old, *due) = (item, Instant(at)));
                        let changed = model.iter_mut().filter(|(s, ..)| *s == slot);
                        changed.for_each(|(_, old, due)| (*old, *due) = (item, at));
                    }
                    (_, None) => {}
                }
                agrees(&mut queue, &model)?;
            }
            queue.clear();
            agrees(&mut queue, &[])?;
            let again = Item { key: 1, yields: false };
            prop_assert_eq!((queue.push(again), queue.push(again)), (Ok(0), Ok(1)));
        }
    }
}
