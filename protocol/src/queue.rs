//! A bounded queue ordered by packed keys: the most urgent entry first (§III).
//!
//! A 4-ary heap of keys apart from their entries: sifting moves 24 bytes, never a message. Every entry can be removed
//! by its slot, which is how eviction and cancelling work without a scan of the heap's order.

use alloc::boxed::Box;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};

/// Names an entry while it is in the queue.
pub(crate) type Slot = u32;

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Queue<T> {
    /// The heap: the least key is at 0, the children of `i` at `4 i + 1 ..= 4 i + 4`.
    heap: Vec<(u128, Slot)>,
    entries: Box<[Option<T>]>,
    /// Where in the heap the entry of a slot stands.
    positions: Box<[u32]>,
    free: Vec<Slot>,
}

/// A queue of nothing, which takes no memory.
impl<T> Default for Queue<T> {
    fn default() -> Self {
        Self::new(0)
    }
}

impl<T> Queue<T> {
    /// A queue of at most `capacity` entries. The only allocation it ever makes.
    pub fn new(capacity: u16) -> Self {
        let n = usize::from(capacity);
        Self {
            heap: Vec::with_capacity(n),
            entries: (0..n).map(|_| None).collect(),
            positions: (0..n).map(|_| 0).collect(),
            free: (0..u32::from(capacity)).rev().collect(),
        }
    }

    pub fn len(&self) -> usize {
        self.heap.len()
    }

    pub fn capacity(&self) -> usize {
        self.entries.len()
    }

    /// Adds an entry, or hands it back when the queue is full.
    pub fn push(&mut self, key: u128, entry: T) -> Result<Slot, T> {
        let Some(slot) = self.free.pop() else { return Err(entry) };
        self.entries[slot as usize] = Some(entry);
        self.heap.push((key, slot));
        self.sift_up(self.heap.len() - 1);
        Ok(slot)
    }

    /// The entry with the least key.
    pub fn first(&self) -> Option<(u128, Slot, &T)> {
        let &(key, slot) = self.heap.first()?;
        self.entries[slot as usize].as_ref().map(|entry| (key, slot, entry))
    }

    /// Takes an entry out.
    pub fn remove(&mut self, slot: Slot) -> Option<T> {
        let entry = self.entries.get_mut(slot as usize)?.take()?;
        let position = self.positions[slot as usize] as usize;
        self.free.push(slot);
        let last = self.heap.len() - 1;
        self.heap.swap(position, last);
        self.heap.pop();
        if position < last {
            self.positions[self.heap[position].1 as usize] = narrow(position);
            self.sift_down(position);
            self.sift_up(position);
        }
        Some(entry)
    }

    /// Takes out the entry with the least key, if `take` wants it.
    pub fn pop_if(&mut self, take: impl FnOnce(&T) -> bool) -> Option<T> {
        let (_, slot, entry) = self.first()?;
        if take(entry) { self.remove(slot) } else { None }
    }

    /// All entries in no particular order.
    pub fn iter(&self) -> impl Iterator<Item = (u128, Slot, &T)> {
        self.heap
            .iter()
            .filter_map(|&(key, slot)| self.entries[slot as usize].as_ref().map(|e| (key, slot, e)))
    }

    /// All entries, most urgent first. Allocates: for views and canonical states, not for the message path.
    pub fn sorted(&self) -> Vec<(u128, Slot, &T)> {
        let mut all: Vec<_> = self.iter().collect();
        all.sort_unstable_by_key(|&(key, ..)| key);
        all
    }

    /// As [`rekey`](Self::rekey), from the most urgent entry on. A heap in full order is a heap.
    pub fn rekey_in_order(&mut self, change: impl FnMut(u128, &mut T) -> u128) {
        self.heap.sort_unstable();
        self.rekey(change);
    }

    /// Changes every entry and its key, which `change` gets; the queue is put in order again afterwards.
    pub fn rekey(&mut self, mut change: impl FnMut(u128, &mut T) -> u128) {
        for (key, slot) in &mut self.heap {
            if let Some(entry) = self.entries[*slot as usize].as_mut() {
                *key = change(*key, entry);
            }
        }
        for position in (0..self.heap.len()).rev() {
            self.sift_down(position);
        }
        for (position, &(_, slot)) in self.heap.iter().enumerate() {
            self.positions[slot as usize] = narrow(position);
        }
    }

    /// Removes everything.
    pub fn clear(&mut self) {
        while let Some(&(_, slot)) = self.heap.first() {
            self.remove(slot);
        }
        // Slots are handed out from the same order whatever went before: two equal queues stay equal in the future.
        self.free.sort_unstable_by(|a, b| b.cmp(a));
    }

    fn sift_up(&mut self, mut at: usize) {
        let moving = self.heap[at];
        while at > 0 {
            let parent = (at - 1) / 4;
            if self.heap[parent].0 <= moving.0 {
                break;
            }
            self.place(at, self.heap[parent]);
            at = parent;
        }
        self.place(at, moving);
    }

    fn sift_down(&mut self, mut at: usize) {
        let moving = self.heap[at];
        loop {
            let first = 4 * at + 1;
            let children = first..(first + 4).min(self.heap.len());
            let Some(least) = children.min_by_key(|&child| self.heap[child].0) else { break };
            if self.heap[least].0 >= moving.0 {
                break;
            }
            self.place(at, self.heap[least]);
            at = least;
        }
        self.place(at, moving);
    }

    fn place(&mut self, at: usize, item: (u128, Slot)) {
        self.heap[at] = item;
        self.positions[item.1 as usize] = narrow(at);
    }
}

#[expect(clippy::cast_possible_truncation, reason = "a queue has at most 65,535 entries")]
const fn narrow(position: usize) -> u32 {
    position as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::collections::BTreeMap;
    use proptest::prelude::*;

    proptest! {
        /// Against a sorted map: pushes, pops, removals of any entry, re-keying.
        #[test]
        fn behaves_like_a_sorted_map(steps in proptest::collection::vec((0..4_u8, any::<u16>(), any::<u16>()), 0..200)) {
            let mut queue = Queue::new(20);
            let mut model: BTreeMap<u128, (Slot, u16)> = BTreeMap::new();
            for (n, (what, a, b)) in steps.into_iter().enumerate() {
                let key = (u128::from(a) << 64) | n as u128;
                match what {
                    0 | 1 => match queue.push(key, b) {
                        Ok(slot) => { model.insert(key, (slot, b)); }
                        Err(back) => { prop_assert_eq!(back, b); prop_assert_eq!(model.len(), 20); }
                    },
                    2 => {
                        let popped = queue.pop_if(|_| true);
                        prop_assert_eq!(popped, model.pop_first().map(|(_, (_, v))| v));
                    }
                    _ => {
                        let nth = model.iter().nth(usize::from(b) % 20).map(|(&k, &v)| (k, v));
                        if let Some((k, (slot, v))) = nth {
                            prop_assert_eq!(queue.remove(slot), Some(v));
                            prop_assert_eq!(queue.remove(slot), None);
                            model.remove(&k);
                        }
                    }
                }
                prop_assert_eq!(queue.len(), model.len());
                prop_assert_eq!(queue.first().map(|(k, _, &v)| (k, v)), model.first_key_value().map(|(&k, &(_, v))| (k, v)));
                prop_assert_eq!(queue.capacity(), 20);
            }
            let in_order: Vec<_> = queue.sorted().into_iter().map(|(k, _, &v)| (k, v)).collect();
            prop_assert_eq!(in_order, model.iter().map(|(&k, &(_, v))| (k, v)).collect::<Vec<_>>());
            queue.rekey(|_, v| u128::from(!*v));
            let mut values: Vec<_> = model.values().map(|&(_, v)| v).collect();
            values.sort_unstable_by(|a, b| b.cmp(a));
            let popped: Vec<_> = core::iter::from_fn(|| queue.pop_if(|_| true)).collect();
            prop_assert_eq!(popped, values);
        }
    }
}
