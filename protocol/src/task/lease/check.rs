//! The invariants of a lease between two inputs.

use super::{Lease, Post};
use crate::request::Call;
use crate::task::violation::Violation;
use crate::ticks::Instant;

impl Lease {
    /// Checks that neither the end of the lease nor the take-over is overdue, and that a pending call describes the present
    /// state (D61).
    ///
    /// # Errors
    /// The first violation found.
    pub(in crate::task) fn check(&self, now: Instant) -> Result<(), Violation> {
        let until = match self.post {
            Post::Leased(until) => until,
            Post::Waits => self.takeover_at,
            Post::Alone | Post::Passive => Instant::NEVER,
        };
        if until <= now {
            return Err(Violation::PastLease(until));
        }
        let told = match self.call {
            Some(Call::TakeOver(epoch)) => self.acts() && epoch == self.epoch,
            Some(Call::Fenced) => !self.acts(),
            Some(Call::Message(_) | Call::Timer(_)) => false,
            None => true,
        };
        if told { Ok(()) } else { Err(Violation::WrongCall) }
    }
}
