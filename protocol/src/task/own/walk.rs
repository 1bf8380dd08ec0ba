//! The fields that all parts share.

use super::Own;
use crate::state::Walk;
use crate::ticks::Instant;

impl Own {
    /// Walks the clock. The order of service is packed with the threads; life and staged fragments are walked apart, below.
    pub fn walk<W: Walk>(&mut self, w: &mut W) {
        let Self {
            task,
            incarnation: _,
            restarted: _,
            now,
            next_sequence,
            quarantine_until: _,
            order: _,
            endpoints: _,
        } = self;
        w.clock(now);
        w.next_sequence(*task, next_sequence);
    }

    /// Walks the life.
    pub fn walk_life<W: Walk>(&mut self, w: &mut W) {
        if w.lives() {
            w.instant(&mut self.quarantine_until);
            w.byte(&mut self.incarnation.0);
            w.flag(&mut self.restarted);
        } else if W::READS {
            self.quarantine_until = Instant::START;
        }
    }

    /// Walks the fragments that are staged; what else an endpoint has is declared, or counted for monitors alone.
    pub fn walk_staged<W: Walk>(&mut self, w: &mut W) {
        for endpoint in self.endpoints.iter_mut().filter(|endpoint| endpoint.staged.has_room()) {
            endpoint.staged.walk(w);
        }
    }
}
