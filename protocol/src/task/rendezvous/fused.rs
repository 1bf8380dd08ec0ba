//! A rendezvous in a fused arrival: all members are on one node, and hear of the arrival at once (D193).

use super::{Arrived, At, Meetings, Rendezvous};
use crate::ids::{Incarnation, Round, TaskId};
use crate::observe::Observation;
use crate::request::ReleasedBy;
use crate::table::Port;
use crate::task::own::Own;
use crate::task::step::{Outbox, Step};
use crate::task::wait::Ended;
use crate::ticks::{Instant, Ticks};

/// A task's arrival at the rendezvous, as the other members hear of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Arrival {
    /// The arriving task, and its position among the members.
    task: TaskId,
    from: usize,
    incarnation: Incarnation,
    round: Round,
    patience: Ticks,
    arguments: [u8; 8],
    /// A member that has not arrived; `None` if the arriving task is the last one. Then every member is released.
    missing: Option<usize>,
}

impl Arrival {
    /// Whether every member is released.
    pub const fn releases(&self) -> bool {
        self.missing.is_none()
    }
}

impl Rendezvous {
    /// The arrival of which the other members hear when this task, which waits for nothing, reaches the rendezvous.
    /// `None` if the arrival requires small steps.
    pub fn may_reach(
        &self,
        own: &Own,
        (port, from): (&Port, usize),
        (arguments, patience): ([u8; 8], Ticks),
    ) -> Option<Arrival> {
        let Own { task, incarnation, .. } = *own;
        let round = self.announced.next().fresher(self.fresh);
        let arrival = Arrival { task, from, incarnation, round, patience, arguments, missing: None };
        let missing = self.missing(own.now, (port, from), &Arrival { patience: Ticks::FAR, ..arrival })?;
        Some(Arrival { missing, ..arrival })
    }

    /// Whether the member at this position can hear of the arrival in a fused step: the arriving task's first arrival in
    /// its round, after which either all members are released or none.
    #[inline(always)]
    pub fn may_hear(&self, own: &Own, (port, member): (&Port, usize), arrival: &Arrival) -> bool {
        let Arrival { round, incarnation, .. } = *arrival;
        let other = &self.members[arrival.from];
        let is_new = own.incarnation == incarnation
            && other.incarnation.is_none_or(|known| known == incarnation)
            && other.arrived.is_none_or(|held| held.expires <= own.now || round.is_newer_than(held.round))
            && other.barred.is_none_or(|barred| round.is_newer_than(barred));
        if self.deadline.is_none() {
            return is_new && round.is_newer_than(self.announced);
        }
        let also_lacks =
            |&missing: &usize| missing != member && !self.members[missing].is_here(round, own.now);
        // Usually the member that is missing for the arriving task is missing here, too. Then no other member is looked
        // at.
        is_new
            && round == self.announced
            && (arrival.missing.as_ref().is_some_and(also_lacks)
                || self.missing(own.now, (port, member), arrival).map(|missing| missing.is_none())
                    == Some(arrival.releases()))
    }

    /// A member that has not arrived, besides this member and the one that arrives now. `None` if all have arrived, but one of
    /// their arrivals is within the margin, or of another incarnation.
    #[inline(never)]
    fn missing(
        &self,
        now: Instant,
        (port, member): (&Port, usize),
        arrival: &Arrival,
    ) -> Option<Option<usize>> {
        let (mut first, mut is_known) = (now + arrival.patience, true);
        // The loop goes backwards: if members arrive in the order of the list, the last ones are missing longest.
        for i in (0..self.members.len()).rev().filter(|&i| i != member && i != arrival.from) {
            let other = &self.members[i];
            let Some(Arrived { expires, .. }) = other.arrived.filter(|_| other.is_here(arrival.round, now))
            else {
                return Some(Some(i));
            };
            first = first.min(expires);
            is_known &= other.incarnation == Some(arrival.incarnation);
        }
        (is_known && first - now > port.margin).then_some(None)
    }

    /// Stores an arrival that [`may_hear`](Self::may_hear) allows: the arriving task's first one in its round.
    #[inline(always)]
    pub fn hear_fused(&mut self, now: Instant, arrival: &Arrival, observe: impl FnOnce(Observation)) {
        let Arrival { task, from, incarnation, round, patience, arguments, .. } = *arrival;
        let arrived = Arrived { round, expires: now + patience, arguments };
        let member = &mut self.members[from];
        (member.incarnation, member.arrived) = (Some(incarnation), Some(arrived));
        self.hear_of(round);
        observe(self.arrival(now, task, &arrived));
    }

    /// Releases this member together with all others, whose CONFIRMs it notes.
    fn release_with_all(&mut self, at: &mut At<'_, '_, impl Outbox>, own: usize) {
        self.release(at, ReleasedBy::AllArrived);
        self.members.iter_mut().for_each(|member| member.confirmed = true);
        self.members[own].confirmed = false;
    }
}

impl Meetings {
    /// [`reach`](Self::reach) in a fused step that [`may_reach`](Rendezvous::may_reach) allows.
    pub fn reach_fused<'a, O: Outbox>(
        &mut self,
        step: &mut Step<'a, O>,
        at: (&'a Port, usize, u16),
        (own, arrival): (usize, &Arrival),
    ) -> Option<Ended> {
        self.run_at(step, at, |rendezvous, at| {
            rendezvous.begin(at, arrival.arguments, arrival.patience);
            if arrival.releases() {
                rendezvous.release_with_all(at, own);
            }
        })
        .1
    }

    /// Releases the member at the position `own`, which has heard of the last arrival, together with all others.
    pub fn release_fused<'a, O: Outbox>(
        &mut self,
        step: &mut Step<'a, O>,
        at: (&'a Port, usize, u16),
        own: usize,
    ) -> Option<Ended> {
        self.run_at(step, at, |rendezvous, at| rendezvous.release_with_all(at, own)).1
    }
}
