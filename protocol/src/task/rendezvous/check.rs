//! The invariants of a rendezvous between two inputs.

use super::{Meetings, Rendezvous};
use crate::table::NodeTable;
use crate::task::interrupts::Interrupts;
use crate::task::own::{Own, index};
use crate::task::violation::Violation;
use crate::task::wait::Pending;
use crate::ticks::{Instant, Ticks};

impl Meetings {
    /// Checks that an activation waits at exactly the rendezvous whose deadline is set, that each rendezvous is consistent,
    /// and that all are in the right order.
    ///
    /// # Errors
    /// The first violation found.
    pub fn check(&self, table: &NodeTable, own: &Own, threads: &Interrupts) -> Result<(), Violation> {
        for (at, meeting) in self.list.iter().enumerate() {
            if threads.waits(Pending::Meeting(index(at))) != meeting.deadline.is_some() {
                return Err(Violation::MeetingAndWaitDiffer(meeting.port));
            }
            meeting.check(table, own.now)?;
        }
        let act = |at: u16| (self.list[usize::from(at)].due(), at);
        let mut meetings = self.list.iter().enumerate().map(|(at, meeting)| (index(at), meeting));
        let wrong = meetings.find(|&(at, _)| self.next.has(at) != (act(at).0 != Instant::NEVER));
        let right = self.next.is_in_order(|at| act(at).0, act);
        let wrong = wrong.map(|(_, meeting)| meeting).or(self.list.first().filter(|_| !right));
        wrong.map_or(Ok(()), |meeting| Err(Violation::OutOfOrder(meeting.port)))
    }
}

impl Rendezvous {
    /// Checks the instants of a rendezvous against its deadline, and its rounds against each other.
    ///
    /// # Errors
    /// The first violation found.
    pub(super) fn check(&self, table: &NodeTable, now: Instant) -> Result<(), Violation> {
        let period = table.port(self.port).map_or(Ticks::FAR, |port| port.decl.resend);
        let is_due = match self.deadline {
            Some(deadline) if deadline < now => return Err(Violation::Overdue(deadline)),
            Some(deadline) => self.is_resent_whole_periods_before(deadline, now, period),
            None => self.resend_at == Instant::NEVER,
        };
        let copies = self.copy_at >= now && (self.copies_left > 0 || self.copy_at == Instant::NEVER);
        if !is_due || !copies {
            return Err(Violation::ResendInstant(self.port));
        }
        let never_announced = self.released.is_some_and(|released| released.is_newer_than(self.announced));
        if never_announced || self.announced.is_newer_than(self.fresh) {
            return Err(Violation::Rounds(self.port));
        }
        if self.owes_confirm && (self.deadline.is_some() || self.released.is_none()) {
            return Err(Violation::OwesConfirm(self.port));
        }
        let parties = table.port(self.port).map_or(&[][..], |port| &port.parties);
        for (member, party) in self.members.iter().zip(parties) {
            if let (Some(arrived), Some(barred)) = (member.arrived, member.barred)
                && !arrived.round.is_newer_than(barred)
            {
                return Err(Violation::HoldsBarred(self.port, party.task, arrived.round));
            }
        }
        Ok(())
    }

    fn is_resent_whole_periods_before(&self, deadline: Instant, now: Instant, period: Ticks) -> bool {
        // A hull of zones may have more instants than whole periods (D209).
        #[cfg(feature = "checker")]
        if crate::ticks::symbolic::has_zone() {
            return self.resend_at == Instant::NEVER || self.resend_at <= deadline;
        }
        self.resend_at == Self::resend_instant(deadline, now, period)
    }

    /// When the next ARRIVE is sent: the first instant after `now` that lies a whole number of periods before the deadline
    /// (D55).
    pub(super) fn resend_instant(deadline: Instant, now: Instant, period: Ticks) -> Instant {
        let more = (deadline - now - Ticks(1)).whole(period);
        if more == 0 { Instant::NEVER } else { deadline - Ticks(more * period.0.max(1)) }
    }
}
