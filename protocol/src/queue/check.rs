//! Checks of a queue: after each step of a test or of a checker, and of a queue that was read from a file.

use super::{Entry, NONE, Order, Queue, Watch, due, urgency};
use alloc::vec;

impl<S: Copy + Default> Order<S> {
    fn is_right<T: Entry<Side = S>>(&self, entries: &[Option<T>]) -> bool {
        let key = |slot| urgency(entries, slot);
        let urgent = self.urgent.is_in_order(|slot| key(slot).0, key);
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
    /// Validates a deserialised queue: it has room for `capacity` entries, and its orders name each entry exactly
    /// once. No operation on such a queue goes out of bounds. Call it before anything else.
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
        // Every free slot must be in the free list exactly once, and the list must end after that many slots.
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

    /// Whether each order agrees with a full scan of the entries.
    pub fn is_in_order(&self) -> bool {
        self.order.as_ref().is_none_or(|order| order.is_right(&self.entries))
    }
}
