//! The fields of a Timer.

use super::Timer;
use super::entries::{Entry, Fresh, NOBODY};
use crate::state::{Pass, Walk, restart};
use alloc::vec::Vec;

impl Timer {
    /// The internal clock goes back to zero; behaviour does not change.
    pub fn rebase(&mut self) {
        let now = self.now;
        self.walk(&mut restart(now));
    }

    /// Walks the entries, earliest first.
    pub fn walk<W: Walk>(&mut self, w: &mut W) {
        w.clock(&mut self.now);
        let Self {
            now: _,
            // Only the order of arming matters: that in which entries are packed.
            armed,
            fresh,
            queue,
            // Rebuilt by arming.
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
            // One thread drives a packed node: no word of an earlier start can still be on its way.
            turn: _,
            expires,
            armed: _,
        } = self;
        w.small(&mut owner.0);
        w.byte(&mut id.0);
        w.instant(expires);
    }
}
