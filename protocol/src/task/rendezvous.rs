//! The n-way rendezvous `waitfor`, with confirmation (§4.3; D1 to D3, D54 to D57).
//!
//! A task that reaches the waitfor announces a *round* to every other member. It is released when it holds the arrivals of all
//! others in one round, each with more patience left than the margin. It is also released when it learns that another member was
//! released from that round. Without a release, only its own time_out or its task's CANCEL ends the wait.
//!
//! | input | effect |
//! |---|---|
//! | [`reach`](Rendezvous::reach) | sends ARRIVE to all others; releases at once if all are here |
//! | [`hear`](Rendezvous::hear) of ARRIVE | may complete the round |
//! | [`hear`](Rendezvous::hear) of CONFIRM | releases, if it is of the round and incarnation in which the task waits |
//! | [`hear`](Rendezvous::hear) of ABORT | voids an arrival; may name a fresher round or prove a release |
//! | [`advance`](Rendezvous::advance) | retransmits what is due |
//! | [`leave`](Rendezvous::leave) | the patience ended, or the wait was cancelled: sends ABORT, except under one variant |
//! | [`forget`](Rendezvous::forget) | a member's node restarted: voids its arrival |
//!
//! [`At::released`] reports a release. Between two inputs the task waits in this rendezvous exactly if `deadline` is set.
//! It has heard of no round fresher than `fresh`, and holds no arrival in a round that the member gave up.

mod check;
mod fused;
mod hear;
#[cfg(feature = "checker")]
mod ignores;
mod meetings;
mod send;
mod view;
#[cfg(feature = "checker")]
mod walk;

pub(crate) use fused::Arrival;
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

/// An arrival of another member.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
struct Arrived {
    round: Round,
    /// When the sender's patience ends, on this task's clock: an arrival counts only as long as its sender waits (D3).
    expires: Instant,
    arguments: [u8; 8],
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
struct Member {
    arrived: Option<Arrived>,
    /// The freshest round that the member gave up: copies of its arrival in that round or an older one do not count (D54).
    barred: Option<Round>,
    /// The incarnation of the member's node from which this task last heard.
    incarnation: Option<Incarnation>,
    /// Whether the member restarted since this task's last release. Its new incarnation was then not part of that meeting.
    reborn: bool,
    /// Whether the member is known to have been released from this task's round. Only monitors see this.
    confirmed: bool,
    /// The member's arguments in the last round that this task left. Later packets do not change these arguments.
    told: Option<[u8; 8]>,
}

impl Member {
    /// Whether the member waits in this round, as far as this task knows.
    fn is_here(&self, round: Round, now: Instant) -> bool {
        self.arrived.is_some_and(|arrived| arrived.round == round && arrived.expires > now)
    }
}

/// One task's side of a rendezvous.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Rendezvous {
    port: PortId,
    /// Whether meetings are numbered. Under the rule variant without rounds, all meetings have the same number (D3).
    numbered: bool,
    /// The round that this task announced last. While it waits, it waits in this round.
    announced: Round,
    /// The freshest round that this task has heard of.
    fresh: Round,
    /// The round from which this task was last released.
    released: Option<Round>,
    /// While the task waits: the end of its patience.
    deadline: Option<Instant>,
    /// While the task waits: when the next ARRIVE is sent.
    resend_at: Instant,
    /// The members in the order of the port's parties, owner first. The task's own entry stays empty.
    members: Box<[Member]>,
    /// The remaining copies of the CONFIRM of `released`, and when the next one is sent.
    copies_left: u8,
    copy_at: Instant,
    /// Whether a CONFIRM released the task before it held all arrivals. Under `EveryComplete` the task sends its CONFIRM
    /// once it holds all arrivals.
    owes_confirm: bool,
    /// The arguments that this task sends to the other members.
    arguments: [u8; 8],
}

/// The step context of a rendezvous: the step, the port, and the position of its endpoint.
struct At<'a, 'b, O> {
    step: &'a mut Step<'b, O>,
    port: &'b Port,
    endpoint: usize,
    /// The round from which the task was released in this step, and how.
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

    /// The next instant at which time alone makes this task act.
    fn due(&self) -> Instant {
        self.deadline.unwrap_or(Instant::NEVER).min(self.resend_at).min(self.copy_at)
    }

    /// Begins to wait: the task reaches the rendezvous.
    fn reach(&mut self, at: &mut At<'_, '_, impl Outbox>, arguments: [u8; 8], patience: Ticks) {
        self.begin(at, arguments, patience);
        self.release_if_complete(at);
    }

    /// Begins to wait, even if all others have arrived.
    fn begin(&mut self, at: &mut At<'_, '_, impl Outbox>, arguments: [u8; 8], patience: Ticks) {
        if self.numbered {
            // The task joins the round in which other members wait, if there is one (D54).
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
    }

    /// Ends the wait without a release, because the patience ended or the wait was cancelled. Returns the missing members as
    /// a bit mask.
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

    /// Retransmits the packets that are due. The caller handles the deadline of the wait.
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

    /// Forgets the arrival of a member whose node restarted. The member's new incarnation was not part of the last released
    /// meeting.
    fn forget(&mut self, member: usize) {
        let incarnation = self.members[member].incarnation;
        self.members[member] = Member { incarnation, reborn: true, ..Member::default() };
    }

    /// Whether this task will never wait in `round` again, because rounds only grow.
    fn is_over(&self, round: Round) -> bool {
        self.announced.is_newer_than(round) || (round == self.announced && self.deadline.is_none())
    }

    /// Enters a round, and forgets everything that would seem fresh once the round numbers wrap: bars of earlier rounds, a
    /// release half the number circle ago, and arrivals whose patience has ended.
    fn enter(&mut self, round: Round, now: Instant) {
        self.announced = round;
        self.released = self.released.filter(|released| !released.is_newer_than(round));
        for member in &mut self.members {
            if member.barred.is_some_and(|barred| barred != round && !barred.is_newer_than(round)) {
                member.barred = None;
            }
            if member.arrived.is_some_and(|arrived| arrived.expires <= now) {
                member.arrived = None;
            }
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

    /// The least remaining patience of the other members, if all of them have arrived.
    fn least_patience(&self, at: &At<'_, '_, impl Outbox>) -> Option<Ticks> {
        let mut least = Ticks::FAR;
        // The loop goes backwards: if members arrive in the order of the list, the last ones are missing longest.
        for (member, party) in self.members.iter().zip(&at.port.parties).rev() {
            if party.task != at.step.own.task {
                let arrived = member.arrived.filter(|_| member.is_here(self.announced, at.now()))?;
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

    /// A member's arrival in this task's round. If meetings are numbered, the arrival counts even after the member's
    /// patience has ended.
    fn came(&self, member: &Member, now: Instant) -> Option<Arrived> {
        let is_over = |arrived: &Arrived| !self.numbered && arrived.expires <= now;
        member.arrived.filter(|arrived| arrived.round == self.announced && !is_over(arrived))
    }

    /// Keeps the arguments of the members in the round that this task leaves.
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
