//! The baseline of the deadline queue (goal P8): the same operations with the heap of the standard library.

use super::queues::Waiting;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// The baseline of the deadline queue. The standard library's heap holds keys, which refer to entries in a slab. If an
/// entry is removed from the slab, its key stays in the heap, and is skipped when it comes to the top.
pub struct Heaps {
    entries: Vec<Option<Waiting>>,
    free: Vec<u16>,
    urgent: BinaryHeap<Reverse<Placed>>,
    due: Option<BinaryHeap<Reverse<Placed>>>,
}

/// A key: the deadline, number and place of an entry.
type Placed = (u64, u64, u16);

impl Heaps {
    /// Makes the heaps without entries. If `two` is true, a second heap contains each key, too.
    #[must_use]
    pub fn new(capacity: u16, two: bool) -> Self {
        let heap = || BinaryHeap::with_capacity(usize::from(capacity));
        Self {
            entries: (0..capacity).map(|_| None).collect(),
            free: (0..capacity).collect(),
            urgent: heap(),
            due: two.then(heap),
        }
    }

    /// Adds an entry. Returns its place in the slab, or `None` if there is no room.
    pub fn push(&mut self, waiting: Waiting) -> Option<u16> {
        let place = self.free.pop()?;
        let key = Reverse((waiting.deadline, waiting.number, place));
        self.urgent.push(key);
        if let Some(due) = &mut self.due {
            due.push(key);
        }
        self.entries[usize::from(place)] = Some(waiting);
        Some(place)
    }

    /// Removes the entry at a place, whatever its urgency.
    pub fn take(&mut self, place: u16) -> Option<Waiting> {
        let taken = self.entries[usize::from(place)].take()?;
        self.free.push(place);
        Some(taken)
    }

    fn is_left(entries: &[Option<Waiting>], (_, number, place): Placed) -> bool {
        entries[usize::from(place)].as_ref().is_some_and(|waiting| waiting.number == number)
    }

    /// Removes the most urgent entry. Then removes the keys of entries that are gone from the top of the second heap.
    pub fn pop(&mut self) -> Option<Waiting> {
        let first = loop {
            let Reverse(key) = self.urgent.pop()?;
            if Self::is_left(&self.entries, key) {
                break self.take(key.2);
            }
        };
        if let Some(due) = &mut self.due {
            while due.peek().is_some_and(|Reverse(key)| !Self::is_left(&self.entries, *key)) {
                due.pop();
            }
        }
        first
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use imrs_protocol::queue::{Entry, Queue};

    #[test]
    fn the_baseline_does_the_job_of_the_queue_it_is_compared_with() {
        for two in [false, true] {
            let mut heaps = Heaps::new(100, two);
            let mut queue = if two { Queue::watched(100) } else { Queue::new(100) };
            for number in 0..100 {
                let waiting = || Waiting { deadline: number % 7, number, packet: [number; 4] };
                let place = heaps.push(waiting()).expect("room");
                let slot = queue.push(waiting()).ok().expect("room");
                // Some entries are removed although they are not the most urgent.
                if number % 5 < 2 {
                    let taken = heaps.take(place).map(|waiting| waiting.number);
                    assert_eq!(taken, queue.remove(slot).map(|waiting| waiting.number));
                }
            }
            loop {
                let (own, other) = (queue.pop_if(|_| true), heaps.pop());
                assert_eq!(own.as_ref().map(Entry::key), other.as_ref().map(Entry::key));
                if own.is_none() {
                    break;
                }
            }
        }
    }
}
