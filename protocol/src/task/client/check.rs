//! The invariants of a client between two inputs.

use super::Client;
use super::outstanding::{Outstanding, Phase};
use crate::ids::MessageId;
use crate::task::interrupts::Interrupts;
use crate::task::own::{Own, index};
use crate::task::violation::Violation;
use crate::task::wait::{Finished, Pending};
use crate::ticks::Instant;

impl Client {
    /// Checks that an activation waits at each open request, and that no retransmission or deadline of the request is
    /// overdue.
    ///
    /// # Errors
    /// The first violation found.
    pub(in crate::task) fn check(&self, own: &Own, threads: &Interrupts) -> Result<(), Violation> {
        self.requests.iter().enumerate().try_for_each(|(at, request)| request.check(index(at), own, threads))
    }
}

impl Outstanding {
    fn check(&self, at: u16, own: &Own, threads: &Interrupts) -> Result<(), Violation> {
        let waits = threads.waits(Pending::Reply(at));
        let mut ends = threads.threads().map(|activation| activation.finished);
        let ended = ends.any(|end| matches!(end, Some(Finished::Answers(d) | Finished::Long(d)) if d == at));
        if waits != (self.phase == Phase::Open) || ended != (self.phase == Phase::Ended) {
            return Err(Violation::WaitsForNothing(self.port));
        }
        if self.phase != Phase::Open {
            return Ok(());
        }
        if self.deadline < own.now {
            return Err(Violation::Overdue(self.deadline));
        }
        let is_own =
            |id: MessageId| id.incarnation == own.incarnation && own.next_sequence.is_newer_than(id.sequence);
        if self.open().next().is_none() || !self.open().all(|recipient| is_own(recipient.id)) {
            return Err(Violation::WaitsForNothing(self.port));
        }
        let due = self.copy_at < own.now;
        let idle = self.copies_left == 0 && self.copy_at != Instant::NEVER;
        if due || idle { Err(Violation::ResendInstant(self.port)) } else { Ok(()) }
    }
}
