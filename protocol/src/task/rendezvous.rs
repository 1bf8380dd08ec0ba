//! `waitfor`: the n-way rendezvous with confirmation (§4.3; D1 to D3, D54 to D57).
//!
//! A task that reaches the waitfor announces a *round* to every other member. It is released when it holds the
//! arrivals of all others in one round, each with more than the safety margin left, or when it learns that another
//! member was released from that round. Nothing but its own time_out, or its task's CANCEL, ends its wait without a release.
//!
//! | input | what comes of it |
//! |---|---|
//! | [`reach`](Rendezvous::reach) | ARRIVE to all others; released at once if all are here |
//! | [`hear`](Rendezvous::hear) | an ARRIVE may complete the round; a CONFIRM of the round waited in releases; an ABORT takes an arrival back, and may call to a fresher round or tell of a release |
//! | [`advance`](Rendezvous::advance) | what is due is sent again |
//! | [`leave`](Rendezvous::leave) | patience ended, or the wait was cancelled: ABORT to all others (but under the variant without) |
//! | [`forget`](Rendezvous::forget) | a member's node restarted: its arrival is void |
//!
//! A release is left in [`At::released`]. Between two inputs the task waits here exactly where there is a deadline, no
//! round heard of is fresher than `fresh`, and no arrival is held of a round that its member gave up.

mod check;
mod hear;
#[cfg(feature = "checker")]
mod ignores;
mod meetings;
mod send;
mod view;
#[cfg(feature = "checker")]
mod walk;

pub(crate) use meetings::Meetings;

use super::counts::Counts;
use super::step::{Outbox, Step};
use crate::cell::MAX_MEMBERS;
use crate::ids::{Incarnation, PortId, Round, TaskId};
use crate::observe::{Event, Observation};
use crate::request::ReleasedBy;
use crate::rules::Confirmation;
use crate::table::Port;
use crate::ticks::{Instant, Ticks};
use alloc::boxed::Box;
use serde::{Deserialize, Serialize};

/// What one member holds of another one's arrival.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
struct Arrived {
    round: Round,
    /// When the sender's patience ends, on this task's counter: an arrival lives no longer than its sender waits (D3).
    expires: Instant,
    arguments: [u8; 8],
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
struct Member {
    arrived: Option<Arrived>,
    /// The freshest round the member gave up: later copies of its arrival there do not count (D54).
    barred: Option<Round>,
    /// The life of the member that it was last heard in.
    life: Option<Incarnation>,
    /// The member restarted since this task's last release: that release says nothing about the new life.
    reborn: bool,
    /// Known to have released the round that this task is in; shown, not acted on.
    confirmed: bool,
    /// What it brought to the round that this task left last: what comes after that changes nothing of it.
    told: Option<[u8; 8]>,
}

/// One task's side of a rendezvous.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Rendezvous {
    port: PortId,
    /// Whether meetings are numbered: the variant without rounds keeps all of them alike (D3).
    numbered: bool,
    /// The last round this task announced; while it waits, the round it waits in.
    announced: Round,
    /// The freshest round heard of.
    fresh: Round,
    /// The round this task last released.
    released: Option<Round>,
    /// While waiting: when this task's patience ends.
    deadline: Option<Instant>,
    /// While waiting: when the arrival is announced again.
    resend_at: Instant,
    /// All parties of the port, owner first; the own entry stays empty.
    members: Box<[Member]>,
    /// How many more copies of the CONFIRM of `released` are to be sent, and when the next one.
    copies_left: u8,
    copy_at: Instant,
    /// Released by a CONFIRM without all arrivals; confirms when it has them (`EveryComplete`).
    owes_confirm: bool,
    /// What this task tells the others.
    arguments: [u8; 8],
}

/// Where a rendezvous works: the step, the port, and where that stands among the task's own.
struct At<'a, 'b, O> {
    step: &'a mut Step<'b, O>,
    port: &'b Port,
    endpoint: usize,
    /// The task is released from this round: to be told.
    released: Option<(Round, ReleasedBy)>,
}

impl<O: Outbox> At<'_, '_, O> {
    fn now(&self) -> Instant {
        self.step.own.now
    }

    fn counters(&mut self) -> &mut Counts {
        &mut self.step.own.endpoints[self.endpoint].counters
    }
}

impl Rendezvous {
    fn new(port: PortId, parties: usize, numbered: bool) -> Self {
        Self {
            port,
            numbered,
            announced: Round::default(),
            fresh: Round::default(),
            released: None,
            deadline: None,
            resend_at: Instant::NEVER,
            members: (0..parties).map(|_| Member::default()).collect(),
            copies_left: 0,
            copy_at: Instant::NEVER,
            owes_confirm: false,
            arguments: [0; 8],
        }
    }

    /// The earliest instant at which time alone makes this task act.
    fn due(&self) -> Instant {
        self.deadline.unwrap_or(Instant::NEVER).min(self.resend_at).min(self.copy_at)
    }

    /// The task reaches the waitfor.
    fn reach(&mut self, at: &mut At<'_, '_, impl Outbox>, arguments: [u8; 8], patience: Ticks) {
        if self.numbered {
            // D54: joins the round that others wait in, if there is one.
            let fresh = if at.step.table.rules().join_fresher { self.fresh } else { self.announced };
            self.enter(self.announced.next().fresher(fresh), at.now());
            self.fresh = self.announced;
        }
        self.arguments = arguments;
        self.members.iter_mut().for_each(|member| member.told = None);
        self.owes_confirm = false;
        self.deadline = Some(at.now() + patience);
        for member in &mut self.members {
            member.confirmed = false;
        }
        at.counters().sent += 1;
        self.note(Event::Reached, at.step.own.task, patience, at);
        self.announce(at, false);
        self.release_if_complete(at);
    }

    /// The task leaves without a release: its patience ended, or it was cancelled before. Returns who had not arrived.
    fn leave(&mut self, at: &mut At<'_, '_, impl Outbox>) -> u64 {
        let in_vain = self.deadline.is_some_and(|deadline| deadline <= at.now());
        at.counters().timed_out += u64::from(in_vain);
        let mut missing = 0;
        self.keep_told(at.now());
        for (i, member) in self.members.iter().enumerate().take(MAX_MEMBERS) {
            missing |= u64::from(member.told.is_none() && at.port.parties[i].task != at.step.own.task) << i;
        }
        self.deadline = None;
        self.resend_at = Instant::NEVER;
        self.note(Event::GaveUp, at.step.own.task, Ticks::ZERO, at);
        if at.step.table.rules().aborts {
            for i in 0..self.members.len() {
                self.send_abort(at, i, self.announced, self.announced.next());
            }
        }
        missing
    }

    /// Time has passed: sends again what is due. The deadline is the caller's to notice.
    fn advance(&mut self, at: &mut At<'_, '_, impl Outbox>) {
        if self.copy_at <= at.now() {
            self.copies_left = self.copies_left.saturating_sub(1);
            self.copy_at =
                if self.copies_left == 0 { Instant::NEVER } else { at.now() + at.port.decl.resend };
            if let Some(round) = self.released {
                at.counters().resent += 1;
                self.confirm(at, round, true);
            }
        }
        let patient = self.deadline.is_some_and(|deadline| at.now() < deadline);
        if patient && self.resend_at <= at.now() {
            at.counters().resent += 1;
            self.announce(at, true);
        }
    }

    /// The node of a member restarted: its arrival is void, and it cannot have been in the meeting released last.
    fn forget(&mut self, member: usize) {
        let life = self.members[member].life;
        self.members[member] = Member { life, reborn: true, ..Member::default() };
    }

    /// Whether this task will never wait in `round` again: rounds only grow.
    fn is_over(&self, round: Round) -> bool {
        self.announced.is_newer_than(round) || (round == self.announced && self.deadline.is_none())
    }

    /// Goes on to a round. What the circle of rounds would show as fresh again one day is forgotten: a bar before this
    /// round, a release half the circle ago, and an arrival whose patience ended before this task came.
    fn enter(&mut self, round: Round, now: Instant) {
        self.announced = round;
        self.released = self.released.filter(|released| !released.is_newer_than(round));
        for member in &mut self.members {
            member.barred = member.barred.filter(|&b| b == round || b.is_newer_than(round));
            member.arrived = member.arrived.filter(|arrived| arrived.expires > now);
        }
    }

    fn rejoin(&mut self, at: &mut At<'_, '_, impl Outbox>, round: Round) {
        if !at.step.table.rules().join_fresher {
            return;
        }
        self.enter(round, at.now());
        for member in &mut self.members {
            member.confirmed = false;
        }
        self.note(Event::Rejoined, at.step.own.task, self.left(at.now()), at);
        self.announce(at, false);
    }

    fn left(&self, now: Instant) -> Ticks {
        self.deadline.unwrap_or(now) - now
    }

    fn is_here(&self, member: &Member, now: Instant) -> bool {
        member.arrived.is_some_and(|a| a.round == self.announced && a.expires > now)
    }

    /// The least patience left among the others, if all of them are here.
    fn least_patience(&self, at: &At<'_, '_, impl Outbox>) -> Option<Ticks> {
        let mut least = Ticks::FAR;
        // From the end: those who come in the order of the list are missed there longest.
        for (member, party) in self.members.iter().zip(&at.port.parties).rev() {
            if party.task != at.step.own.task {
                let arrived = member.arrived.filter(|_| self.is_here(member, at.now()))?;
                least = least.min(arrived.expires - at.now());
            }
        }
        Some(least)
    }

    fn release_if_complete(&mut self, at: &mut At<'_, '_, impl Outbox>) {
        if self.deadline.is_none() {
            return;
        }
        match self.least_patience(at) {
            Some(least) if least > at.port.margin => self.release(at, ReleasedBy::AllArrived),
            Some(least) => self.note(Event::WithinMargin, at.step.own.task, least, at),
            None => {}
        }
    }

    fn release(&mut self, at: &mut At<'_, '_, impl Outbox>, by: ReleasedBy) {
        let round = self.announced;
        let left = self.left(at.now());
        self.keep_told(at.now());
        self.released = Some(round);
        self.deadline = None;
        self.resend_at = Instant::NEVER;
        self.copies_left = 0;
        self.copy_at = Instant::NEVER;
        for member in &mut self.members {
            member.reborn = false;
        }
        at.counters().delivered += 1;
        let event = match by {
            ReleasedBy::AllArrived => Event::ReleasedComplete,
            ReleasedBy::Confirm(_) => Event::ReleasedByConfirm,
        };
        self.note(event, at.step.own.task, left, at);
        at.released = Some((round, by));
        let complete = by == ReleasedBy::AllArrived;
        match at.step.table.rules().confirmation {
            Confirmation::None => {}
            Confirmation::FirstComplete if !complete => {}
            Confirmation::EveryComplete if !complete => {
                self.owes_confirm = true;
                self.confirm_if_owed(at);
            }
            Confirmation::FirstComplete | Confirmation::EveryComplete | Confirmation::PassOn => {
                self.confirm_with_copies(at, round);
            }
        }
        if !self.numbered {
            for member in &mut self.members {
                member.arrived = None;
            }
        }
    }

    /// A member's arrival in this task's round; one whose patience ended just before was here all the same.
    fn came(&self, member: &Member, now: Instant) -> Option<Arrived> {
        let is_over = |arrived: &Arrived| !self.numbered && arrived.expires <= now;
        member.arrived.filter(|arrived| arrived.round == self.announced && !is_over(arrived))
    }

    /// What the members brought to the round that this task leaves now.
    fn keep_told(&mut self, now: Instant) {
        for i in 0..self.members.len() {
            self.members[i].told = self.came(&self.members[i], now).map(|arrived| arrived.arguments);
        }
    }

    fn note(&self, event: Event, peer: TaskId, remaining: Ticks, at: &mut At<'_, '_, impl Outbox>) {
        let number = u32::from(self.announced.0);
        at.step.out.observe(Observation { event, port: self.port, peer, number, remaining });
    }
}

#[cfg(test)]
mod tests;
