//! The Timer of a node (Figure 3, §5.1.2): serves the delays and timers of the node's tasks.
//!
//! Its JOB_REQUEST is a standing offer (D22): a task arms an entry when it wants one, and the Timer never waits for a
//! busy task. The communication tasks' own time_outs need no entry here (D41). Arming and cancelling cost O(log n),
//! k entries that end cost O(k log n), and waiting costs nothing.

use crate::comm_task::Overflow;
use crate::ids::TaskId;
use crate::index::Index;
use crate::packed::{Eye, Pen};
use crate::queue::{self, Queue};
use crate::request::TimeId;
use crate::ticks::Ticks;

#[derive(Clone, Copy, Debug)]
struct Entry {
    owner: TaskId,
    id: TimeId,
    turn: u8,
    expires: Ticks,
    /// Of entries that end together the one armed first goes first.
    armed: u64,
}

impl queue::Entry for Entry {
    type Side = ();

    fn key(&self) -> u128 {
        (u128::from(self.expires.0) << 64) | u128::from(self.armed)
    }

    fn due(&self, (): &()) -> Ticks {
        self.expires
    }

    fn yields(&self) -> bool {
        false
    }
}

/// The Timer: `{src_id, id, length}` entries, earliest first.
#[derive(Clone, Debug)]
pub struct Timer {
    now: Ticks,
    armed: u64,
    queue: Queue<Entry>,
    /// Where in the queue the entry of an owner and id is.
    index: Index,
}

impl Timer {
    /// A Timer with room for `capacity` entries.
    #[must_use]
    pub fn new(capacity: u16) -> Self {
        Self { now: Ticks::ZERO, armed: 0, queue: Queue::new(capacity), index: Index::new(capacity) }
    }

    /// Starts an entry; one of the same owner and id is replaced. False when the Timer is full. `turn` comes back with
    /// the entry: it tells the owner this start of it from an earlier one.
    pub fn arm(&mut self, owner: TaskId, id: TimeId, turn: u8, length: Ticks) -> bool {
        let (expires, armed) = (self.now + length, self.armed);
        self.armed += 1;
        let entry = Entry { owner, id, turn, expires, armed };
        let (place, known) = self.index.look(name(owner, id));
        if let Some(slot) = known {
            self.queue.change(slot, |old, ()| *old = entry);
            return true;
        }
        let Ok(slot) = self.queue.push(entry) else { return false };
        self.index.note(place, name(owner, id), slot);
        true
    }

    /// Takes an entry back. False when there is none.
    pub fn disarm(&mut self, owner: TaskId, id: TimeId) -> bool {
        let slot = self.index.remove(name(owner, id));
        slot.and_then(|slot| self.queue.remove(slot)).is_some()
    }

    /// Lets an entry end after so long from now, whatever it was armed for; of no time: with the next `advance`, be that of
    /// none, too. For a checker of what a node did: counted in ticks, what ends within one may end in another order than
    /// it was armed in, and a node may notice late. False when there is none.
    pub fn put(&mut self, owner: TaskId, id: TimeId, left: Ticks) -> bool {
        let (_, known) = self.index.look(name(owner, id));
        let Some(slot) = known else { return false };
        self.queue.change(slot, |entry, ()| entry.expires = self.now + left);
        true
    }

    /// Time passes: names every entry that is over, earliest first, and removes it.
    pub fn advance(&mut self, elapsed: Ticks, mut due: impl FnMut(TaskId, TimeId, u8)) {
        self.now += elapsed;
        while let Some(entry) = self.queue.pop_if(|entry| entry.expires <= self.now) {
            self.index.remove(name(entry.owner, entry.id));
            due(entry.owner, entry.id, entry.turn);
        }
    }

    /// How long from the last `advance` until an entry is over.
    #[must_use]
    pub fn next_expiry(&self) -> Option<Ticks> {
        self.queue.first().map(|(_, entry)| entry.expires - self.now)
    }

    /// The internal clock goes back to zero; behaviour does not change.
    pub fn rebase(&mut self) {
        let now = core::mem::take(&mut self.now);
        self.queue.change_all(|entry, ()| entry.expires = entry.expires - now);
    }

    /// The entries with what is left of each, earliest first.
    #[must_use]
    pub fn entries(&self) -> alloc::vec::Vec<(TaskId, TimeId, Ticks)> {
        self.queue.sorted().into_iter().map(|(_, e)| (e.owner, e.id, e.expires - self.now)).collect()
    }

    /// Writes the canonical bytes of the entries (D51) and returns how many.
    ///
    /// # Errors
    /// [`Overflow`] when a length outgrows its field or `out` is too short.
    pub fn store(&self, out: &mut [u8]) -> Result<usize, Overflow> {
        let mut pen = Pen::new(out);
        pen.small(self.queue.len())?;
        for (_, entry) in self.queue.sorted() {
            pen.small(entry.owner.0)?;
            pen.byte(entry.id.0)?;
            pen.ticks(entry.expires - self.now)?;
        }
        Ok(pen.at)
    }

    /// Reads the entries back, time relative to zero, and returns how many bytes they took.
    pub fn load(&mut self, bytes: &[u8]) -> usize {
        let mut eye = Eye::new(bytes);
        (self.now, self.armed) = (Ticks::ZERO, 0);
        self.queue.clear();
        self.index.clear();
        for _ in 0..eye.byte() {
            let (owner, id) = (TaskId(u16::from(eye.byte())), TimeId(eye.byte()));
            // One thread drives a packed node: no word of an earlier start can still be on its way.
            self.arm(owner, id, 0, eye.ticks());
        }
        eye.at
    }
}

/// An entry's name: a cell has at most 65,536 tasks, and a task 256 ids.
fn name(owner: TaskId, id: TimeId) -> u32 {
    (u32::from(owner.0) << 8) | u32::from(id.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec::Vec;

    #[test]
    fn entries_end_in_order_and_once() {
        let mut timer = Timer::new(3);
        assert!(timer.arm(TaskId(1), TimeId(0), 0, Ticks(5)));
        assert!(timer.arm(TaskId(2), TimeId(0), 0, Ticks(3)));
        assert!(timer.arm(TaskId(1), TimeId(1), 0, Ticks(3)));
        assert!(!timer.arm(TaskId(9), TimeId(9), 0, Ticks(1)), "full");
        assert_eq!(timer.next_expiry(), Some(Ticks(3)));
        let mut over = Vec::new();
        timer.advance(Ticks(2), |owner, id, _| over.push((owner, id)));
        assert_eq!(over, []);
        assert_eq!(timer.next_expiry(), Some(Ticks(1)));
        timer.rebase();
        timer.advance(Ticks(9), |owner, id, _| over.push((owner, id)));
        assert_eq!(over, [(TaskId(2), TimeId(0)), (TaskId(1), TimeId(1)), (TaskId(1), TimeId(0))]);
        assert_eq!(timer.next_expiry(), None);
    }

    #[test]
    fn an_entry_that_is_put_ends_then() {
        let mut timer = Timer::new(2);
        timer.arm(TaskId(1), TimeId(0), 7, Ticks(5));
        timer.arm(TaskId(1), TimeId(1), 8, Ticks(5));
        let mut over = Vec::new();
        timer.advance(Ticks(4), |_, id, turn| over.push((id, turn)));
        assert!(timer.put(TaskId(1), TimeId(1), Ticks::ZERO) && !timer.put(TaskId(2), TimeId(1), Ticks(1)));
        timer.advance(Ticks::ZERO, |_, id, turn| over.push((id, turn)));
        assert_eq!(over, [(TimeId(1), 8)]);
        assert!(timer.put(TaskId(1), TimeId(0), Ticks(3)));
        timer.advance(Ticks(2), |_, id, turn| over.push((id, turn)));
        assert_eq!(over.len(), 1);
        timer.advance(Ticks(1), |_, id, turn| over.push((id, turn)));
        assert_eq!(over, [(TimeId(1), 8), (TimeId(0), 7)]);
        assert!(!timer.put(TaskId(1), TimeId(0), Ticks::ZERO));
    }

    #[test]
    fn loading_undoes_storing() {
        let mut timer = Timer::new(4);
        for (owner, id, length) in [(1, 0, 9), (2, 7, 5000), (3, 255, 9)] {
            timer.arm(TaskId(owner), TimeId(id), 0, Ticks(length));
        }
        timer.advance(Ticks(3), |_, _, _| {});
        let mut bytes = [0; 32];
        let len = timer.store(&mut bytes).unwrap();
        assert!((0..len).all(|short| timer.store(&mut bytes[..short]) == Err(Overflow)));
        timer.store(&mut bytes).unwrap();
        let mut back = Timer::new(4);
        back.arm(TaskId(9), TimeId(9), 0, Ticks(1));
        assert_eq!(back.load(&bytes), len);
        assert_eq!(back.entries(), timer.entries());
        assert!(back.disarm(TaskId(3), TimeId(255)) && !back.disarm(TaskId(9), TimeId(9)));
        timer.arm(TaskId(1), TimeId(1), 0, Ticks(1 << 32));
        assert_eq!(timer.store(&mut bytes), Err(Overflow));
    }

    #[test]
    fn arming_again_replaces_and_disarming_removes() {
        let mut timer = Timer::new(2);
        timer.arm(TaskId(1), TimeId(0), 0, Ticks(5));
        timer.arm(TaskId(1), TimeId(0), 0, Ticks(9));
        assert_eq!(timer.entries(), [(TaskId(1), TimeId(0), Ticks(9))]);
        assert!(timer.disarm(TaskId(1), TimeId(0)));
        assert!(!timer.disarm(TaskId(1), TimeId(0)));
        assert_eq!(timer.next_expiry(), None);
    }
}
