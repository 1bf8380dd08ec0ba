//! What of a state is dead, so that equal futures have equal states; and the moves of a task's clock.

use super::CommTask;
use super::lease::Guard;
use super::memory::{Fate, Memory, Remembered, Window};
use super::rendezvous::{Arrived, Rendezvous};
use crate::ids::{PortId, Round, Seq24, TaskId};
use crate::state::Clock;
use crate::table::NodeTable;
use crate::ticks::Ticks;

/// A message that may still come to a task: it is on a link or in a buffer, or its sender waits for the answer and may send
/// it again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Coming {
    /// On which port.
    pub port: PortId,
    /// From whom.
    pub source: TaskId,
    /// To whom.
    pub to: TaskId,
    /// Its number.
    pub sequence: Seq24,
}

impl CommTask {
    /// Sets the internal clock back to zero; behaviour does not change. Dead state is dropped first, so that no
    /// forgotten instant lies before the new zero.
    pub fn rebase(&mut self, table: &NodeTable) {
        self.bury();
        let now = self.now;
        self.walk(table, &mut Clock(|instant| instant - now));
    }

    /// Moves the internal clock `ahead`, and every instant with it; behaviour does not change, however far, because
    /// no instant ever leaves the task (D37).
    pub fn set_ahead(&mut self, table: &NodeTable, ahead: Ticks) {
        self.walk(table, &mut Clock(|instant| instant + ahead));
    }

    /// Drops what can never matter again, so that equal futures have equal states. Behaviour does not change.
    pub fn bury(&mut self) {
        let now = self.now;
        if self.quarantine_until <= now {
            self.quarantine_until = now;
        }
        if let Some(lease) = &mut self.lease {
            lease.bury(now);
        }
        for guard in self.guards.iter_mut().filter(|guard| guard.until <= now) {
            *guard = Guard { until: now, ..Guard::new(guard.couple) };
        }
        for inbox in &mut self.inboxes {
            for source in &mut inbox.sources {
                match &mut source.memory {
                    Memory::Command(command) => *command = command.filter(|c| c.until > now),
                    Memory::Status(window) if window.until <= now => *window = Window::default(),
                    Memory::Status(_) => {}
                }
            }
        }
        for meeting in &mut self.meetings {
            meeting.bury(now);
        }
    }
}

impl CommTask {
    /// Forgets which messages it has taken where no copy of them can come any more: for a checker, which knows all that
    /// may still come. Behaviour does not change.
    pub fn bury_seen(&mut self, coming: &[Coming]) {
        let own = self.task;
        for inbox in &mut self.inboxes {
            let port = inbox.port;
            for source in &mut inbox.sources {
                let task = source.task;
                let of_source = |c: &&Coming| (c.port, c.source, c.to) == (port, task, own);
                let copies = || coming.iter().filter(of_source).map(|c| c.sequence);
                // One that is newer than all that was seen is taken, remembered or not.
                let may_come = |newest: Seq24| copies().any(|copy| !copy.is_newer_than(newest));
                match &mut source.memory {
                    Memory::Command(command) => {
                        let is_settled = |c: &Remembered| {
                            matches!(c.fate, Fate::Refused | Fate::Answered(_) | Fate::Lapsed)
                        };
                        *command = command.filter(|c| !is_settled(c) || may_come(c.id.sequence));
                    }
                    Memory::Status(window) => {
                        let Some(newest) = window.newest.filter(|&newest| may_come(newest)) else {
                            *window = Window::default();
                            continue;
                        };
                        let backs = copies().map(|copy| newest.steps_from(copy));
                        let bits = backs.filter(|back| (1..=64).contains(back));
                        window.seen &= bits.fold(0, |bits, back| bits | 1 << (back - 1));
                    }
                }
            }
        }
    }
}

impl Rendezvous {
    fn bury(&mut self, now: Ticks) {
        if !self.fresh.is_newer_than(self.announced) {
            self.fresh = self.announced;
        }
        let waiting = self.deadline.is_some();
        if !waiting {
            self.arguments = [0; 8];
        }
        let Self { announced, released, owes_confirm: owes, numbered, .. } = *self;
        // An arrival counts in the round waited in and in fresher ones, and in the released one for an owed CONFIRM.
        let counts = |round: Round| {
            !numbered
                || round.is_newer_than(announced)
                || (waiting && round == announced)
                || (owes && released == Some(round))
        };
        for member in &mut self.members {
            // Even when its patience has ended, a partner that came to this round was not the one that was missing.
            let came = |a: &Arrived| numbered && waiting && a.round == announced;
            member.arrived = member.arrived.filter(|a| came(a) || (a.expires > now && counts(a.round)));
            if let Some(arrived) = &mut member.arrived {
                arrived.expires = arrived.expires.max(now);
            }
            member.barred = member.barred.filter(|&barred| counts(barred));
            if !waiting {
                member.confirmed = false;
            }
        }
    }

    /// When the arrival is announced again: whole periods before the deadline, later than now (D55).
    pub(super) fn resend_instant(deadline: Ticks, now: Ticks, period: Ticks) -> Ticks {
        let period = period.0.max(1);
        let more = (deadline - now).0.saturating_sub(1) / period;
        if more == 0 { Ticks::FAR } else { deadline - Ticks(more * period) }
    }
}
