//! When the Timer thread must wake: at the earliest expiry that nobody waits for (D40).
//!
//! Every machine of the node publishes its next expiry in a slot of its own. The Timer thread sleeps until the earliest
//! and is rung only if an earlier one is published: a stream of messages with equal time_outs never rings it.

use crate::clock::{FAR, Micros, nanos_of};
use crate::sync::{AtomicU64, Ordering, Word, fence};

#[derive(Debug)]
pub(crate) struct Alarm {
    slots: Box<[AtomicU64]>,
    /// What the Timer thread sleeps until.
    target: AtomicU64,
    rung: Word,
    #[cfg(test)]
    pub no_open_target: bool,
}

/// The earliest expiry, and what has been rung so far.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Earliest {
    pub at: Micros,
    rung: u32,
}

impl Alarm {
    pub fn new(slots: usize) -> Self {
        Self {
            slots: (0..slots).map(|_| AtomicU64::new(FAR)).collect(),
            target: AtomicU64::new(FAR),
            rung: Word::new(0),
            #[cfg(test)]
            no_open_target: false,
        }
    }

    /// Says when `slot` next expires. Called under the lock of that machine, so the last word is the newest.
    pub fn publish(&self, slot: usize, at: Micros) {
        let slot = &self.slots[slot];
        if slot.load(Ordering::Relaxed) == at {
            return;
        }
        slot.store(at, Ordering::Relaxed);
        if at == FAR {
            return;
        }
        // Pairs with the one in `earliest`: either that sees the slot, or this sees the open target.
        fence(Ordering::SeqCst);
        if at < self.target.load(Ordering::Relaxed) {
            self.ring();
        }
    }

    /// What `slot` last published.
    pub fn slot(&self, slot: usize) -> Micros {
        self.slots[slot].load(Ordering::Relaxed)
    }

    /// Wakes the Timer thread.
    pub fn ring(&self) {
        self.rung.increment();
        self.rung.wake();
    }

    /// The earliest of all slots; for the Timer thread alone. From here on it is rung for anything earlier.
    pub fn earliest(&self) -> Earliest {
        let rung = self.rung.load();
        // While the slots are looked at, whatever is published rings.
        #[cfg(test)]
        let open = !self.no_open_target;
        #[cfg(not(test))]
        let open = true;
        if open {
            self.target.store(FAR, Ordering::Relaxed);
        }
        fence(Ordering::SeqCst);
        let at = self.slots.iter().map(|slot| slot.load(Ordering::Relaxed)).min().unwrap_or(FAR);
        self.target.store(at, Ordering::Relaxed);
        Earliest { at, rung }
    }

    /// Sleeps until then, or until rung. Without an expiry it sleeps until rung.
    pub fn sleep(&self, until: Earliest) {
        self.rung.wait(until.rung, nanos_of(until.at));
    }
}
