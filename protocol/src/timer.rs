//! The Timer of a node, which counts the delays and timers of the node's tasks (Figure 3, §5.1.2).
//!
//! The Timer's JOB_REQUEST is a standing offer: a task arms an entry at any time, and the Timer never waits for a busy task
//! (D22). The time_outs that communication tasks count themselves need no entry (D41). Arming and disarming cost O(log n),
//! or O(1) for an entry that is soon disarmed (D123). The end of k entries costs O(k log n), and waiting costs nothing.

mod entries;
#[cfg(feature = "checker")]
mod walk;

use crate::ids::TaskId;
use crate::index::Index;
use crate::queue::{self, Queue};
use crate::request::TimeId;
use crate::ticks::{Instant, Ticks};
use alloc::vec::Vec;
use entries::{Entry, FRESH, Fresh, NOBODY, name};

/// A timer queue of `{src_id, id, length}` entries, earliest first.
#[derive(Clone, Debug)]
pub struct Timer {
    now: Instant,
    armed: u64,
    fresh: Fresh,
    queue: Queue<Entry>,
    /// Maps the owner and id of an entry to its slot in the queue.
    index: Index,
}

impl Timer {
    /// A Timer with room for `capacity` entries.
    #[must_use]
    pub fn new(capacity: u16) -> Self {
        let (queue, index) = (Queue::new(capacity), Index::new(capacity));
        Self { now: Instant::START, armed: 0, fresh: Fresh::NONE, queue, index }
    }

    /// Arms an entry. It replaces an entry of the same owner and id. Returns false if the Timer is full. When the entry
    /// ends, the Timer returns `turn`. The owner compares it, to recognise an entry that it has restarted since.
    pub fn arm(&mut self, owner: TaskId, id: TimeId, turn: u8, length: Ticks) -> bool {
        let (expires, armed) = (self.now + length, self.armed);
        self.armed += 1;
        let (name, entry) = (name(owner, id), Entry { owner, id, turn, expires, armed });
        if let Some(at) = self.fresh.find(name) {
            self.fresh.put(at, entry);
            return true;
        }
        if let (_, Some(slot)) = self.index.look(name) {
            self.queue.change(slot, |old, ()| *old = entry);
            return true;
        }
        let at = match self.fresh.find(NOBODY) {
            Some(_) if self.is_full() => return false,
            Some(hole) => hole,
            None => match self.settle_one() {
                Some(hole) => hole,
                None => return false,
            },
        };
        self.fresh.put(at, entry);
        true
    }

    fn is_full(&self) -> bool {
        self.queue.len() + self.fresh.iter().count() >= self.queue.capacity()
    }

    /// Moves one of the recently armed entries into the queue. Returns its place among these entries, which is now free;
    /// `None` if the Timer is full.
    #[inline(never)]
    fn settle_one(&mut self) -> Option<usize> {
        if self.is_full() {
            return None;
        }
        let at = usize::from(self.fresh.next) % FRESH;
        self.fresh.next = self.fresh.next.wrapping_add(1);
        let entry = self.fresh.remove(at);
        let name = name(entry.owner, entry.id);
        let (place, _) = self.index.look(name);
        if let Ok(slot) = self.queue.push(entry) {
            self.index.note(place, name, slot);
        }
        Some(at)
    }

    /// Removes an entry. Returns false if there is no such entry.
    pub fn disarm(&mut self, owner: TaskId, id: TimeId) -> bool {
        let name = name(owner, id);
        if let Some(at) = self.fresh.find(name) {
            self.fresh.remove(at);
            return true;
        }
        let slot = self.index.remove(name);
        slot.and_then(|slot| self.queue.remove(slot)).is_some()
    }

    /// Sets the remaining time of an entry, whatever it was armed for. Zero ends it with the next `advance`, even if no time
    /// passes. Only for a checker that follows a recorded node: there, entries that end within one tick may end in any
    /// order, and a node may notice late. Returns false if there is no such entry.
    #[cfg(feature = "checker")]
    pub fn put(&mut self, owner: TaskId, id: TimeId, left: Ticks) -> bool {
        let (name, expires) = (name(owner, id), self.now + left);
        if let Some(at) = self.fresh.find(name) {
            self.fresh.entries[at].expires = expires;
            return true;
        }
        let (_, known) = self.index.look(name);
        let Some(slot) = known else { return false };
        self.queue.change(slot, |entry, ()| entry.expires = expires);
        true
    }

    /// Moves the clock forward to `now`, and never back. Removes and reports every entry that has ended, earliest first.
    pub fn advance(&mut self, now: Instant, mut due: impl FnMut(TaskId, TimeId, u8)) {
        self.now = self.now.max(now);
        while let Some(entry) = self.pop_over() {
            due(entry.owner, entry.id, entry.turn);
        }
    }

    /// Removes the entry that ends first, if it has ended.
    fn pop_over(&mut self) -> Option<Entry> {
        let settled = self.queue.first().map(|(_, entry)| entry).filter(|entry| entry.expires <= self.now);
        if self.fresh.end() <= self.now
            && let Some((at, fresh)) = self.fresh.first()
            && settled.is_none_or(|settled| queue::Entry::key(fresh) < queue::Entry::key(settled))
        {
            return Some(self.fresh.remove(at));
        }
        let entry = self.queue.pop_if(|entry| entry.expires <= self.now)?;
        self.index.remove(name(entry.owner, entry.id));
        Some(entry)
    }

    /// The Timer's clock: the time of the last `advance`.
    #[must_use]
    pub const fn now(&self) -> Instant {
        self.now
    }

    /// The instant at which the first entry ends.
    #[must_use]
    pub fn next_deadline(&self) -> Instant {
        self.queue.first().map_or(Instant::NEVER, |(_, entry)| entry.expires).min(self.fresh.end())
    }

    fn sorted(&self) -> Vec<&Entry> {
        let all = self.queue.iter().map(|(_, entry)| entry);
        let mut all: Vec<_> = all.chain(self.fresh.iter().map(|(_, entry)| entry)).collect();
        all.sort_unstable_by_key(|entry| queue::Entry::key(*entry));
        all
    }

    /// The entries with their remaining times, earliest first.
    #[must_use]
    pub fn entries(&self) -> Vec<(TaskId, TimeId, Ticks)> {
        self.sorted().into_iter().map(|e| (e.owner, e.id, e.expires - self.now)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::{Decode, Encode, Frame, Overflow};
    use proptest::prelude::*;

    #[test]
    fn entries_end_in_order_and_once() {
        let mut timer = Timer::new(3);
        assert!(timer.arm(TaskId(1), TimeId(0), 0, Ticks(5)));
        assert!(timer.arm(TaskId(2), TimeId(0), 0, Ticks(3)));
        assert!(timer.arm(TaskId(1), TimeId(1), 0, Ticks(3)));
        assert!(!timer.arm(TaskId(9), TimeId(9), 0, Ticks(1)), "full");
        assert_eq!(timer.next_deadline(), Instant(3));
        let mut over = Vec::new();
        timer.advance(Instant(2), |owner, id, _| over.push((owner, id)));
        assert_eq!(over, []);
        assert_eq!(timer.next_deadline(), Instant(3));
        timer.rebase();
        timer.advance(timer.now() + Ticks(9), |owner, id, _| over.push((owner, id)));
        assert_eq!(over, [(TaskId(2), TimeId(0)), (TaskId(1), TimeId(1)), (TaskId(1), TimeId(0))]);
        assert_eq!(timer.next_deadline(), Instant::NEVER);
    }

    #[test]
    fn an_entry_that_is_put_ends_then() {
        let mut timer = Timer::new(2);
        timer.arm(TaskId(1), TimeId(0), 7, Ticks(5));
        timer.arm(TaskId(1), TimeId(1), 8, Ticks(5));
        let mut over = Vec::new();
        timer.advance(Instant(4), |_, id, turn| over.push((id, turn)));
        assert!(timer.put(TaskId(1), TimeId(1), Ticks::ZERO) && !timer.put(TaskId(2), TimeId(1), Ticks(1)));
        timer.advance(timer.now(), |_, id, turn| over.push((id, turn)));
        assert_eq!(over, [(TimeId(1), 8)]);
        assert!(timer.put(TaskId(1), TimeId(0), Ticks(3)));
        timer.advance(timer.now() + Ticks(2), |_, id, turn| over.push((id, turn)));
        assert_eq!(over.len(), 1);
        timer.advance(timer.now() + Ticks(1), |_, id, turn| over.push((id, turn)));
        assert_eq!(over, [(TimeId(1), 8), (TimeId(0), 7)]);
        assert!(!timer.put(TaskId(1), TimeId(0), Ticks::ZERO));
    }

    #[test]
    fn reading_undoes_writing() {
        let mut timer = Timer::new(4);
        for (owner, id, length) in [(1, 0, 9), (2, 7, 5000), (3, 255, 9)] {
            timer.arm(TaskId(owner), TimeId(id), 0, Ticks(length));
        }
        timer.advance(Instant(3), |_, _, _| {});
        let bytes = encoded(&mut timer).unwrap();
        let mut back = Timer::new(4);
        back.arm(TaskId(9), TimeId(9), 0, Ticks(1));
        assert_eq!(Decode::read(&bytes, false, |w| back.walk(w)), bytes.len());
        assert_eq!(back.entries(), timer.entries());
        assert!(back.disarm(TaskId(3), TimeId(255)) && !back.disarm(TaskId(9), TimeId(9)));
        timer.arm(TaskId(1), TimeId(1), 0, Ticks(1 << 32));
        assert_eq!(encoded(&mut timer), Err(Overflow));
    }

    fn encoded(timer: &mut Timer) -> Result<Vec<u8>, Overflow> {
        Encode::bytes(&Frame { rounds: &[], sequences: &[], incarnations: false }, |w| timer.walk(w))
    }

    proptest! {
        /// Compares the Timer with a plain list under arm, disarm, put and advance, with more entries than fit into the
        /// unsorted set.
        #[test]
        fn behaves_like_a_list(steps in proptest::collection::vec((0..8_u8, 0..12_u16, 0..6_u64), 0..200)) {
            let mut timer = Timer::new(9);
            let mut model: Vec<(Ticks, usize, TaskId)> = Vec::new();
            for (n, (what, owner, length)) in steps.into_iter().enumerate() {
                let (owner, length) = (TaskId(owner), Ticks(length));
                let known = model.iter().position(|&(_, _, other)| other == owner);
                match (what, known) {
                    (0..=3, _) => {
                        let armed = timer.arm(owner, TimeId(1), 0, length);
                        prop_assert_eq!(armed, known.is_some() || model.len() < 9);
                        model.retain(|&(_, _, other)| other != owner);
                        if armed {
                            model.push((length, n, owner));
                        }
                    }
                    (4, _) => {
                        prop_assert_eq!(timer.disarm(owner, TimeId(1)), known.is_some());
                        model.retain(|&(_, _, other)| other != owner);
                    }
                    (5, Some(at)) => {
                        prop_assert!(timer.put(owner, TimeId(1), length));
                        model[at].0 = length;
                    }
                    (6, _) => timer.rebase(),
                    _ => {
                        let (mut over, mut expected) = (Vec::new(), Vec::new());
                        timer.advance(timer.now() + length, |owner, _, _| over.push(owner));
                        model.sort_unstable();
                        model.retain(|&(left, _, owner)| {
                            if left <= length {
                                expected.push(owner);
                            }
                            left > length
                        });
                        model.iter_mut().for_each(|(left, _, _)| *left = *left - length);
                        prop_assert_eq!(over, expected);
                    }
                }
                model.sort_unstable();
                let left: Vec<_> = model.iter().map(|&(left, _, owner)| (owner, TimeId(1), left)).collect();
                let next = left.first().map_or(Instant::NEVER, |&(_, _, left)| timer.now() + left);
                prop_assert_eq!(timer.next_deadline(), next);
                prop_assert_eq!(timer.entries(), left);
            }
        }
    }

    #[test]
    fn arming_again_replaces_and_disarming_removes() {
        let mut timer = Timer::new(2);
        timer.arm(TaskId(1), TimeId(0), 0, Ticks(5));
        timer.arm(TaskId(1), TimeId(0), 0, Ticks(9));
        assert_eq!(timer.entries(), [(TaskId(1), TimeId(0), Ticks(9))]);
        assert!(timer.disarm(TaskId(1), TimeId(0)));
        assert!(!timer.disarm(TaskId(1), TimeId(0)));
        assert_eq!(timer.next_deadline(), Instant::NEVER);
    }
}
