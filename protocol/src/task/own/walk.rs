//! Visits the state that all parts share, for the checker's packed states.

use super::Own;
use crate::state::Walk;
use crate::ticks::Instant;

impl Own {
    /// Visits the clock. The `order` is packed with the activations. The functions below visit the incarnation and the
    /// staged fragments.
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

    /// Visits the incarnation.
    pub fn walk_incarnation<W: Walk>(&mut self, w: &mut W) {
        if w.incarnations() {
            w.instant(&mut self.quarantine_until);
            w.byte(&mut self.incarnation.0);
            w.flag(&mut self.restarted);
        } else if W::READS {
            self.quarantine_until = Instant::START;
        }
    }

    /// Visits the staged fragments. The other fields of an endpoint follow from the declaration, or are counters for
    /// monitors.
    pub fn walk_staged<W: Walk>(&mut self, w: &mut W) {
        for endpoint in self.endpoints.iter_mut().filter(|endpoint| endpoint.staged.has_room()) {
            endpoint.staged.walk(w);
        }
    }
}
