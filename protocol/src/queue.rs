//! A bounded priority queue with stable slots: the most urgent entry first (§III). A *watched* queue keeps a second order, by
//! the instant at which an entry is due. The entry to evict (D60) is searched for only when the queue is full (D108).
//!
//! Each order is a heap of 8-byte words with a 2-byte position per slot ([`Heap`]). So sifting never moves an entry, an entry
//! can be removed by its slot, and each change costs O(log n).

mod check;
mod heap;

pub use heap::Heap;

use crate::ticks::Instant;
use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};

/// Identifies an entry as long as the entry is in the queue.
pub type Slot = u16;

/// The number that stands for no slot: a queue has at most 65,535 entries.
const NONE: Slot = Slot::MAX;

/// An instant, and the number that decides between entries of the same instant.
///
/// The two are not one packed number: a checker's instants may be symbols, which can only be compared ([`Instant`]).
pub type Key = (Instant, u64);

/// The key of an empty slot.
const LAST: Key = (Instant::NEVER, u64::MAX);

/// An entry of a queue, with the keys by which the queue orders its entries.
pub trait Entry {
    /// What a watched queue stores beside each entry: it decides when the caller must look at the entry again.
    type Side: Copy + Default;

    /// The urgency: the least key is served first. Keys are unique within a queue.
    fn key(&self) -> Key;
    /// The instant at which the caller must look at the entry again.
    fn due(&self, side: &Self::Side) -> Instant;
    /// Whether the entry is evicted before all entries that do not yield, however urgent it is.
    fn yields(&self) -> bool;
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(bound(
    serialize = "T: Serialize, T::Side: Serialize",
    deserialize = "T: Deserialize<'de>, T::Side: Deserialize<'de>"
))]
pub struct Queue<T: Entry> {
    entries: Box<[Option<T>]>,
    /// The orders over the slots. Absent for a capacity of at most one, unless the queue is watched.
    order: Option<Box<Order<T::Side>>>,
}

/// The orders that a queue keeps over its slots.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Order<S> {
    /// The heap by urgency. For a free slot it stores the next free slot instead: a free list.
    urgent: Heap,
    free: Slot,
    /// Cache of the entry to evict; `None` after any change that may affect it.
    #[serde(skip)]
    last: Option<Slot>,
    watch: Option<Watch<S>>,
    /// Whether no entry was added since the queue was created or cleared. Then all slots are free, in their first order.
    #[serde(skip)]
    is_as_new: bool,
}

/// The second order of a watched queue, beside urgency: by the instant at which the caller must look at an entry again.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Watch<S> {
    sides: Box<[S]>,
    due: Heap,
}

/// A queue of capacity 0, which takes no memory.
impl<T: Entry> Default for Queue<T> {
    fn default() -> Self {
        Self::new(0)
    }
}

fn urgency<T: Entry>(entries: &[Option<T>], slot: Slot) -> Key {
    entries[usize::from(slot)].as_ref().map_or(LAST, Entry::key)
}

fn due<T: Entry>(entries: &[Option<T>], sides: &[T::Side], slot: Slot) -> (Instant, Key) {
    let (entry, side) = (entries[usize::from(slot)].as_ref(), &sides[usize::from(slot)]);
    entry.map_or((Instant::NEVER, LAST), |entry| (entry.due(side), entry.key()))
}

impl<S: Copy + Default> Order<S> {
    /// The orders of an empty queue: all slots are free, and the lowest is taken first.
    fn new(capacity: u16) -> Self {
        let urgent = Heap::new(capacity);
        let mut new = Self { urgent, free: NONE, last: None, watch: None, is_as_new: true };
        new.free_all();
        new
    }

    fn free_all(&mut self) {
        (self.free, self.is_as_new) = (NONE, true);
        for slot in (0..narrow(self.urgent.capacity())).rev() {
            self.give_back(slot);
        }
    }

    fn give_back(&mut self, slot: Slot) {
        self.urgent.keep(slot, self.free);
        self.free = slot;
    }

    /// Takes the first free slot for an entry that was just stored there.
    #[inline]
    fn put<T: Entry<Side = S>>(&mut self, entries: &[Option<T>], slot: Slot, key: Key, side: S) {
        self.free = self.urgent.kept(slot);
        self.is_as_new = false;
        self.urgent.push(slot, key.0, |slot| urgency(entries, slot));
        if let Some(Watch { sides, due: order }) = &mut self.watch {
            sides[usize::from(slot)] = side;
            let key = |slot| due(entries, sides, slot);
            order.push(slot, key(slot).0, key);
        }
    }

    /// Removes an entry from all orders, before it leaves its slot.
    fn take_out<T: Entry<Side = S>>(&mut self, entries: &[Option<T>], slot: Slot) {
        self.urgent.remove(slot, |slot| urgency(entries, slot));
        self.forget(entries, slot);
    }

    /// Removes the most urgent entry from all orders.
    #[inline]
    fn pop<T: Entry<Side = S>>(&mut self, entries: &[Option<T>], slot: Slot) {
        self.urgent.pop(|slot| urgency(entries, slot));
        self.forget(entries, slot);
    }

    /// Completes the removal of an entry from the heap by urgency: updates due order, free list and eviction cache.
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

    /// Rebuilds all orders, after any keys and due instants may have changed.
    fn renew<T: Entry<Side = S>>(&mut self, entries: &[Option<T>]) {
        let key = |slot| urgency(entries, slot);
        self.urgent.order(|slot| key(slot).0, key);
        if let Some(Watch { sides, due: order }) = &mut self.watch {
            let key = |slot| due(entries, sides, slot);
            order.order(|slot| key(slot).0, key);
        }
        self.last = None;
    }
}

impl<T: Entry> Queue<T> {
    /// A queue of at most `capacity` entries. Its storage is allocated here and in [`watch`](Self::watch).
    pub fn new(capacity: u16) -> Self {
        let entries = (0..capacity).map(|_| None).collect();
        Self { entries, order: (capacity > 1).then(|| Box::new(Order::new(capacity))) }
    }

    /// As [`new`](Self::new), but with the order by due instants.
    pub fn watched(capacity: u16) -> Self {
        let mut new = Self::new(capacity);
        new.watch();
        new
    }

    /// Adds the order by due instants: from now on the queue knows which entry is due first.
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
        let mut due_first = Heap::new(narrow(entries.len()));
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

    /// Adds an entry, or returns it if the queue is full.
    pub fn push(&mut self, entry: T) -> Result<Slot, T> {
        self.push_with(entry, T::Side::default())
    }

    /// As [`push`](Self::push), with side data for the entry, which only a watched queue stores.
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

    /// The side data of an entry; the default if the queue is not watched.
    pub fn side(&self, slot: Slot) -> T::Side {
        self.watching().and_then(|watch| watch.sides.get(usize::from(slot)).copied()).unwrap_or_default()
    }

    /// The most urgent entry.
    pub fn first(&self) -> Option<(Slot, &T)> {
        self.named(self.order.as_ref().map_or(Some(0), |order| order.urgent.first()))
    }

    /// The entry to evict: the least urgent of the entries that yield, or of all entries if none yields. A linear search
    /// finds it, and its result is cached until an entry changes.
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

    /// The instant at which the first entry is due. `NEVER` if the queue is empty, or not watched: then it keeps no such order.
    pub fn next_due(&self) -> Instant {
        let Some(watch) = self.watching() else { return Instant::NEVER };
        watch.due.first_instant(|slot| due(&self.entries, &watch.sides, slot).0)
    }

    fn named(&self, slot: Option<Slot>) -> Option<(Slot, &T)> {
        slot.and_then(|slot| Some((slot, self.get(slot)?)))
    }

    /// Removes an entry and returns it.
    pub fn remove(&mut self, slot: Slot) -> Option<T> {
        self.get(slot)?;
        if let Some(order) = &mut self.order {
            order.take_out(&self.entries, slot);
        }
        self.entries[usize::from(slot)].take()
    }

    /// Removes the most urgent entry if `take` accepts it.
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

    /// Removes the entry that is due first, if it is due by `now`.
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

    /// The entries of a watched queue that are due by `now`, in no particular order. Visits O(k) entries for k results.
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

    /// Changes one entry and its side data, and restores both orders.
    pub fn change(&mut self, slot: Slot, change: impl FnOnce(&mut T, &mut T::Side)) {
        let mut side = self.side(slot);
        let Some(entry) = self.entries.get_mut(usize::from(slot)).and_then(Option::as_mut) else { return };
        change(entry, &mut side);
        let key = entry.key();
        let entries = &self.entries;
        let Some(order) = self.order.as_deref_mut() else { return };
        order.urgent.moved(slot, key.0, |slot| urgency(entries, slot));
        if let Some(Watch { sides, due: order }) = &mut order.watch {
            sides[usize::from(slot)] = side;
            let key = |slot| due(entries, sides, slot);
            order.moved(slot, key(slot).0, key);
        }
        order.last = None;
    }

    /// Changes every entry, and rebuilds the orders afterwards.
    pub fn change_all(&mut self, mut change: impl FnMut(&mut T, &mut T::Side)) {
        if self.len() == 0 {
            return;
        }
        self.adjust(&mut change);
        if let Some(order) = &mut self.order {
            order.renew(&self.entries);
        }
    }

    /// Changes every entry without restoring any order: `change` must not affect keys or due instants.
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

    /// Removes all entries.
    pub fn clear(&mut self) {
        if self.is_as_new() {
            return;
        }
        self.entries.fill_with(|| None);
        let Some(order) = &mut self.order else { return };
        order.urgent.clear();
        if let Some(watch) = &mut order.watch {
            watch.due.clear();
        }
        // The free list is reset, so that equal queues give out the same slots, whatever they held before.
        order.free_all();
        order.last = None;
    }

    /// Whether no entry was added since the queue was made or cleared; in a queue of one slot, whether it is empty.
    fn is_as_new(&self) -> bool {
        match &self.order {
            Some(order) => order.is_as_new,
            None => self.len() == 0,
        }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "a queue has at most 65,535 entries")]
const fn narrow(position: usize) -> u16 {
    position as u16
}

#[cfg(test)]
mod tests;
