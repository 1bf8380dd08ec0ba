//! The Timer of a node (Figure 3, §5.1.2): serves the delays and timers of the node's tasks.
//!
//! Its JOB_REQUEST is a standing offer (D22): a task arms an entry when it wants one, and the Timer never waits for a
//! busy task. The communication tasks' own time_outs need no entry here (D41).

use crate::ids::TaskId;
use crate::queue::Queue;
use crate::request::TimeId;
use crate::ticks::Ticks;

#[derive(Clone, Copy, Debug)]
struct Entry {
    owner: TaskId,
    id: TimeId,
    turn: u8,
    expires: Ticks,
}

/// The Timer: `{src_id, id, length}` entries, earliest first.
#[derive(Clone, Debug)]
pub struct Timer {
    now: Ticks,
    armed: u64,
    queue: Queue<Entry>,
}

impl Timer {
    /// A Timer with room for `capacity` entries.
    #[must_use]
    pub fn new(capacity: u16) -> Self {
        Self { now: Ticks::ZERO, armed: 0, queue: Queue::new(capacity) }
    }

    /// Starts an entry; one of the same owner and id is replaced. False when the Timer is full. `turn` comes back with
    /// the entry: it tells the owner this start of it from an earlier one.
    pub fn arm(&mut self, owner: TaskId, id: TimeId, turn: u8, length: Ticks) -> bool {
        self.disarm(owner, id);
        let expires = self.now + length;
        let key = (u128::from(expires.0) << 64) | u128::from(self.armed);
        self.armed += 1;
        self.queue.push(key, Entry { owner, id, turn, expires }).is_ok()
    }

    /// Takes an entry back. False when there is none.
    pub fn disarm(&mut self, owner: TaskId, id: TimeId) -> bool {
        let found =
            self.queue.iter().find(|(_, _, e)| e.owner == owner && e.id == id).map(|(_, slot, _)| slot);
        found.and_then(|slot| self.queue.remove(slot)).is_some()
    }

    /// Time passes: names every entry that is over, earliest first, and removes it.
    pub fn advance(&mut self, elapsed: Ticks, mut due: impl FnMut(TaskId, TimeId, u8)) {
        self.now += elapsed;
        while let Some(entry) = self.queue.pop_if(|entry| entry.expires <= self.now) {
            due(entry.owner, entry.id, entry.turn);
        }
    }

    /// How long from the last `advance` until an entry is over.
    #[must_use]
    pub fn next_expiry(&self) -> Option<Ticks> {
        self.queue.first().map(|(_, _, entry)| entry.expires - self.now)
    }

    /// The internal clock goes back to zero; behaviour does not change.
    pub fn rebase(&mut self) {
        let now = core::mem::take(&mut self.now);
        self.queue.rekey(|old, entry| {
            entry.expires = entry.expires - now;
            (old & u128::from(u64::MAX)) | (u128::from(entry.expires.0) << 64)
        });
    }

    /// The entries with what is left of each, earliest first.
    #[must_use]
    pub fn entries(&self) -> alloc::vec::Vec<(TaskId, TimeId, Ticks)> {
        self.queue.sorted().into_iter().map(|(_, _, e)| (e.owner, e.id, e.expires - self.now)).collect()
    }
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
