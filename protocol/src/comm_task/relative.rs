//! Everything relative in a state (D51): instants, rounds, sequences, epochs. One list of them serves looking, moving the
//! clock and shifting ids; and here is what of a state is dead.

use super::desk::Phase;
use super::lease::{Guard, Post};
use super::levels::Finished;
use super::memory::{Fate, Memory, Remembered, Window};
use super::rendezvous::{Arrived, Rendezvous};
use super::{CommTask, Pending};
use crate::ids::{PortId, Round, Seq24, TaskId};
use crate::request::Call;
use crate::ticks::Ticks;

/// Looks at everything relative in a state.
pub trait Visit {
    /// An instant on the task's own counter.
    fn instant(&mut self, instant: Ticks);
    /// A round of a port.
    fn round(&mut self, port: PortId, round: Round);
    /// A sequence number of a source.
    fn sequence(&mut self, source: TaskId, sequence: Seq24);
    /// An epoch of the couple at this position in the cell.
    fn epoch(&mut self, couple: u8, epoch: u8) {
        let _ = (couple, epoch);
    }
}

/// Changes everything relative in a state.
pub trait VisitMut {
    /// An instant on the task's own counter.
    fn instant(&mut self, instant: &mut Ticks);
    /// A round of a port.
    fn round(&mut self, port: PortId, round: &mut Round);
    /// A sequence number of a source.
    fn sequence(&mut self, source: TaskId, sequence: &mut Seq24);
    /// An epoch of the couple at this position in the cell. Those of the primary are odd, so only an even shift
    /// changes nothing.
    fn epoch(&mut self, couple: u8, epoch: &mut u8) {
        let _ = (couple, epoch);
    }
}

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

/// Walks everything relative, once for looking and once for changing: `relatives!(self, v)` or `relatives!(self, v, mut)`.
macro_rules! relatives {
    ($self:ident, $v:ident $(, $m:ident)?) => {{
        let own = $self.task;
        $v.sequence(own, & $($m)? $self.next_sequence);
        $v.instant(& $($m)? $self.quarantine_until);
        if let Some(overdue) = & $($m)? $self.overdue {
            $v.sequence(own, & $($m)? overdue.id.sequence);
        }
        let running = usize::from($self.depth);
        for level in & $($m)? $self.levels[..=running] {
            if let Pending::Get { deadline, .. } = & $($m)? level.pending {
                $v.instant(deadline);
            }
            match & $($m)? level.finished {
                Some(Finished::Released { port, round, .. } | Finished::GaveUp { port, round, .. }) => {
                    $v.round(*port, round);
                }
                Some(Finished::Granted(epoch)) => {
                    if let Some(lease) = &$self.lease {
                        $v.epoch(lease.couple, epoch);
                    }
                }
                Some(Finished::Outcome(_) | Finished::Answers(_) | Finished::Long(_) | Finished::TimeOut(_)) | None => {}
            }
        }
        for desk in & $($m)? $self.desks {
            if desk.phase != Phase::Open {
                continue;
            }
            $v.instant(& $($m)? desk.deadline);
            $v.instant(& $($m)? desk.copy_at);
            for asked in & $($m)? desk.asked {
                $v.sequence(own, & $($m)? asked.id.sequence);
            }
        }
        if let Some(lease) = & $($m)? $self.lease {
            let (couple, partner) = (lease.couple, lease.partner);
            $v.epoch(couple, & $($m)? lease.epoch);
            if let Some(Call::TakeOver(epoch)) = & $($m)? lease.call {
                $v.epoch(couple, epoch);
            }
            for answered in & $($m)? lease.answered {
                if let Some(answered) = answered {
                    $v.sequence(partner, & $($m)? answered.beat);
                    $v.instant(& $($m)? answered.until);
                }
            }
            if let Some(newest) = & $($m)? lease.newest {
                $v.sequence(partner, newest);
            }
            if let Some(echo) = & $($m)? lease.echo {
                $v.sequence(own, & $($m)? echo.beat);
                $v.instant(& $($m)? echo.until);
            }
            $v.instant(& $($m)? lease.beat_at);
            $v.instant(& $($m)? lease.takeover_at);
            if let Post::Leased(until) = & $($m)? lease.post {
                $v.instant(until);
            }
        }
        for guard in & $($m)? $self.guards {
            $v.epoch(guard.couple, & $($m)? guard.epoch);
            $v.instant(& $($m)? guard.until);
        }
        for inbox in & $($m)? $self.inboxes {
            let tasks = inbox.sources.iter().map(|source| source.task);
            if let Some(long) = & $($m)? inbox.long {
                for (assembly, task) in (& $($m)? long.assemblies).into_iter().zip(tasks) {
                    if assembly.is_open() {
                        $v.sequence(task, & $($m)? assembly.id.sequence);
                        $v.instant(& $($m)? assembly.expires);
                    }
                }
            }
            for source in & $($m)? inbox.sources {
                let task = source.task;
                match & $($m)? source.memory {
                    Memory::Command(None) => {}
                    Memory::Command(Some(command)) => {
                        $v.sequence(task, & $($m)? command.id.sequence);
                        $v.instant(& $($m)? command.sender_until);
                        $v.instant(& $($m)? command.until);
                        if let Fate::Delivered(budget_ends) = & $($m)? command.fate {
                            $v.instant(budget_ends);
                        }
                    }
                    Memory::Status(window) => {
                        if let Some(newest) = & $($m)? window.newest {
                            $v.sequence(task, newest);
                            $v.instant(& $($m)? window.until);
                        }
                    }
                }
            }
        }
        for meeting in & $($m)? $self.meetings {
            let port = meeting.port;
            $v.round(port, & $($m)? meeting.announced);
            $v.round(port, & $($m)? meeting.fresh);
            if let Some(released) = & $($m)? meeting.released {
                $v.round(port, released);
            }
            if let Some(deadline) = & $($m)? meeting.deadline {
                $v.instant(deadline);
            }
            $v.instant(& $($m)? meeting.resend_at);
            $v.instant(& $($m)? meeting.copy_at);
            for member in & $($m)? meeting.members {
                if let Some(arrived) = & $($m)? member.arrived {
                    $v.round(port, & $($m)? arrived.round);
                    $v.instant(& $($m)? arrived.expires);
                }
                if let Some(barred) = & $($m)? member.barred {
                    $v.round(port, barred);
                }
            }
        }
    }};
}

/// Hands the visitor values where the walk has references.
struct ByRef<'a, V>(&'a mut V);

impl<V: Visit> ByRef<'_, V> {
    fn instant(&mut self, instant: &Ticks) {
        self.0.instant(*instant);
    }
    fn round(&mut self, port: PortId, round: &Round) {
        self.0.round(port, *round);
    }
    fn sequence(&mut self, source: TaskId, sequence: &Seq24) {
        self.0.sequence(source, *sequence);
    }
    fn epoch(&mut self, couple: u8, epoch: &u8) {
        self.0.epoch(couple, *epoch);
    }
}

impl CommTask {
    /// Looks at everything relative.
    pub fn visit(&self, visitor: &mut impl Visit) {
        let mut v = ByRef(visitor);
        relatives!(self, v);
        for inbox in &self.inboxes {
            for (slot, held) in inbox.queue.iter() {
                v.sequence(held.source, &held.sequence);
                v.instant(&held.expires);
                v.instant(&inbox.queue.side(slot).not_before);
            }
        }
    }

    /// Changes everything relative. The order of instants must stay as it is.
    pub fn visit_mut(&mut self, v: &mut impl VisitMut) {
        relatives!(self, v, mut);
        for inbox in &mut self.inboxes {
            inbox.queue.change_all(|held, aged| {
                v.sequence(held.source, &mut held.sequence);
                v.instant(&mut held.expires);
                v.instant(&mut aged.not_before);
            });
        }
        self.touch_all();
    }

    /// Sets the internal clock back to zero; behaviour does not change. Dead state is dropped first, so that no
    /// forgotten instant lies before the new zero.
    pub fn rebase(&mut self) {
        struct Back(Ticks);
        impl VisitMut for Back {
            fn instant(&mut self, instant: &mut Ticks) {
                if *instant != Ticks::FAR {
                    *instant = *instant - self.0;
                }
            }
            fn round(&mut self, _: PortId, _: &mut Round) {}
            fn sequence(&mut self, _: TaskId, _: &mut Seq24) {}
        }
        self.bury();
        let now = self.now;
        self.visit_mut(&mut Back(now));
        self.now = Ticks::ZERO;
    }

    /// Moves the internal clock `ahead`, and every instant with it; behaviour does not change, however far, because
    /// no instant ever leaves the task (D37).
    pub fn set_ahead(&mut self, ahead: Ticks) {
        struct Ahead(Ticks);
        impl VisitMut for Ahead {
            fn instant(&mut self, instant: &mut Ticks) {
                *instant += self.0;
            }
            fn round(&mut self, _: PortId, _: &mut Round) {}
            fn sequence(&mut self, _: TaskId, _: &mut Seq24) {}
        }
        self.visit_mut(&mut Ahead(ahead));
        self.now += ahead;
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
