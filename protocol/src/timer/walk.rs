//! Visits the fields of a Timer, for the checker's packed states.

use super::Timer;
use super::entries::{Entry, Fresh, NOBODY};
use crate::state::{Pass, Walk, restart};
use alloc::vec::Vec;

impl Timer {
    /// Sets the Timer's clock back to zero, and shifts all its instants with it. This changes no behaviour.
    pub fn rebase(&mut self) {
        let now = self.now;
        self.walk(&mut restart(now));
    }

    /// Visits the entries, earliest first.
    pub fn walk<W: Walk>(&mut self, w: &mut W) {
        w.clock(&mut self.now);
        let Self {
            now: _,
            // `armed` is not packed: entries are packed in the order in which they end, and entries that end together in
            // the order of arming.
            armed,
            fresh,
            queue,
            // The index is rebuilt when decoding arms the entries again.
            index,
        } = self;
        if W::PASS == Pass::Change {
            let named = fresh.entries.iter_mut().zip(&fresh.names).filter(|&(_, &name)| name != NOBODY);
            named.for_each(|(entry, _)| entry.walk(w));
            return queue.change_all(|entry, ()| entry.walk(w));
        }
        if !W::READS {
            let mut entries: Vec<Entry> = self.sorted().into_iter().copied().collect();
            w.count(entries.len());
            return entries.iter_mut().for_each(|entry| entry.walk(w));
        }
        *armed = 0;
        *fresh = Fresh::NONE;
        queue.clear();
        index.clear();
        for _ in 0..w.count(0) {
            let mut entry = Fresh::HOLE;
            entry.walk(w);
            self.arm(entry.owner, entry.id, entry.turn, entry.expires - self.now);
        }
    }
}

impl Entry {
    pub fn walk<W: Walk>(&mut self, w: &mut W) {
        let Self {
            owner,
            id,
            // `turn` is not packed: a single thread drives a packed node, so no report of an earlier start of the timer is
            // in flight.
            turn: _,
            expires,
            armed: _,
        } = self;
        w.small(&mut owner.0);
        w.byte(&mut id.0);
        w.instant(expires);
    }
}
