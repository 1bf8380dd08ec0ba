//! Visits the fields of a rendezvous, for the checker's packed states.

use super::{Arrived, Meetings, Member, Rendezvous};
use crate::ids::{PortId, Round};
use crate::state::{Pass, Walk};
use crate::table::NodeTable;
use crate::task::interrupts::Interrupts;
use crate::task::own::index;
use crate::ticks::{Instant, Ticks};

impl Meetings {
    pub fn walk<W: Walk>(&mut self, table: &NodeTable, threads: &Interrupts, w: &mut W) {
        // The field `next` is rebuilt below.
        let Self { list, next: _ } = self;
        list.iter_mut().for_each(|meeting| meeting.walk(table, threads.is_unread(meeting.port), w));
        if matches!(W::PASS, Pass::Decode | Pass::Change) {
            self.touch_all();
        }
    }
}

impl Rendezvous {
    /// Visits a rendezvous. `unread` says that the task has yet to read the members' arguments of the last meeting.
    pub(super) fn walk<W: Walk>(&mut self, table: &NodeTable, unread: bool, w: &mut W) {
        let Self {
            port,
            numbered: _,
            announced,
            fresh,
            released,
            deadline,
            resend_at,
            members,
            copies_left,
            copy_at,
            owes_confirm,
            arguments,
        } = self;
        let port = *port;
        let [waits, is_released, is_fresh, owes, copies, brings] = w.flags([
            deadline.is_some(),
            released.is_some(),
            fresh != announced,
            *owes_confirm,
            *copies_left > 0,
            *arguments != [0; 8],
        ]);
        *owes_confirm = owes;
        w.round(port, announced);
        if let Some(deadline) = w.some(deadline, waits, Instant::START) {
            w.instant(deadline);
        }
        if let Some(released) = w.some(released, is_released, Round::default()) {
            w.round(port, released);
        }
        if is_fresh {
            w.round(port, fresh);
        } else {
            *fresh = *announced;
        }
        if W::READS {
            (*copies_left, *copy_at, *arguments) = (0, Instant::NEVER, [0; 8]);
        }
        if copies {
            w.byte(copies_left);
            w.instant(copy_at);
        }
        if brings {
            w.arguments(arguments);
        }
        w.derived(resend_at, || {
            let period = table.port(port).map_or(Ticks::FAR, |port| port.decl.resend);
            let again = |deadline| Self::resend_instant(deadline, Instant::START, period);
            deadline.map_or(Instant::NEVER, again)
        });
        members.iter_mut().for_each(|member| member.walk(port, unread, w));
    }
}

impl Member {
    fn walk<W: Walk>(&mut self, port: PortId, unread: bool, w: &mut W) {
        let Self { arrived, barred, incarnation, reborn, confirmed, told } = self;
        let brought = arrived.as_ref().is_some_and(|arrived| arrived.arguments != [0; 8]);
        let [has_arrived, is_barred, is_reborn, has_brought, has_told] =
            w.flags([arrived.is_some(), barred.is_some(), *reborn, brought, unread && told.is_some()]);
        *reborn = is_reborn;
        let blank = Arrived { round: Round::default(), expires: Instant::START, arguments: [0; 8] };
        if let Some(Arrived { round, expires, arguments }) = w.some(arrived, has_arrived, blank) {
            w.round(port, round);
            w.instant(expires);
            if has_brought {
                w.arguments(arguments);
            }
        }
        if let Some(told) = w.some(told, has_told, [0; 8]) {
            w.arguments(told);
        }
        if let Some(barred) = w.some(barred, is_barred, Round::default()) {
            w.round(port, barred);
        }
        w.known_incarnation(incarnation);
        if W::READS {
            // This field is not packed, because only monitors see it.
            *confirmed = false;
        }
    }
}

impl Rendezvous {
    /// Drops dead state, so that states with equal futures are equal.
    pub(super) fn bury(&mut self, now: Instant) {
        if !self.fresh.is_newer_than(self.announced) {
            self.fresh = self.announced;
        }
        let waiting = self.deadline.is_some();
        if !waiting {
            self.arguments = [0; 8];
        }
        let Self { announced, released, owes_confirm: owes, numbered, .. } = *self;
        // Arrivals and bars count in the round in which the task waits and in fresher rounds. While the task owes a CONFIRM,
        // they also count in the released round.
        let counts = |round: Round| {
            !numbered
                || round.is_newer_than(announced)
                || (waiting && round == announced)
                || (owes && released == Some(round))
        };
        for member in &mut self.members {
            // An arrival in this round counts even if its patience has ended, because its member does not count as missing.
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
}

impl Meetings {
    /// Drops dead state in all rendezvous: state that can affect no later behaviour.
    pub fn bury(&mut self, now: Instant) {
        for rendezvous in &mut self.list {
            rendezvous.bury(now);
        }
    }

    /// Rebuilds the heap of the rendezvous.
    pub(super) fn touch_all(&mut self) {
        self.next.clear();
        (0..index(self.list.len())).for_each(|at| self.touch(at));
    }
}
