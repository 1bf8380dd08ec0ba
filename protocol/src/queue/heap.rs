//! An order of slots by a key that somebody else knows.

use super::{Slot, narrow};
use alloc::boxed::Box;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};

/// Slots in the order of a key that the queue knows: the least is at 0, the children of `i` at `4 i + 1 ..= 4 i + 4`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Heap {
    slots: Vec<Slot>,
    /// Where a slot stands.
    positions: Box<[u16]>,
}

impl Heap {
    pub fn new(capacity: u16) -> Self {
        let positions = (0..capacity).map(|_| 0).collect();
        Self { slots: Vec::with_capacity(usize::from(capacity)), positions }
    }

    pub fn first(&self) -> Option<Slot> {
        self.slots.first().copied()
    }

    pub fn push<K: Ord>(&mut self, slot: Slot, key: impl Fn(Slot) -> K) {
        self.slots.push(slot);
        self.sift_up(self.slots.len() - 1, &key);
    }

    pub fn remove<K: Ord>(&mut self, slot: Slot, key: impl Fn(Slot) -> K) {
        let position = usize::from(self.positions[usize::from(slot)]);
        self.slots.swap_remove(position);
        if let Some(&moved) = self.slots.get(position) {
            self.place(position, moved);
            self.moved(moved, key);
        }
    }

    pub fn moved<K: Ord>(&mut self, slot: Slot, key: impl Fn(Slot) -> K) {
        let position = usize::from(self.positions[usize::from(slot)]);
        self.sift_down(position, &key);
        self.sift_up(usize::from(self.positions[usize::from(slot)]), &key);
    }

    pub fn order<K: Ord>(&mut self, key: impl Fn(Slot) -> K) {
        for position in (0..self.slots.len()).rev() {
            self.sift_down(position, &key);
        }
    }

    /// The slots of the greatest part around the first one of which `is_in` holds, parents before children: where that
    /// holds of all slots below some key, these.
    pub fn upper(&self, is_in: impl Fn(Slot) -> bool) -> impl Iterator<Item = Slot> {
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

    pub fn clear(&mut self) {
        self.slots.clear();
    }

    fn place(&mut self, at: usize, slot: Slot) {
        self.slots[at] = slot;
        self.positions[usize::from(slot)] = narrow(at);
    }
}
