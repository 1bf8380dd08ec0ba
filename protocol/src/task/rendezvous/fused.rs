//! A rendezvous in a fused arrival: all members are on one node, and hear of the arrival at once (D193).

use super::{Arrived, At, Meetings, Rendezvous};
use crate::ids::{Incarnation, Round};
use crate::table::Port;
use crate::task::own::Own;
use crate::task::step::{Outbox, Step};
use crate::task::wait::Ended;
use crate::ticks::{Instant, Ticks};

/// What the other members hear once a task reaches the waitfor.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Arrival {
    /// The position of the arriving task among the members.
    from: usize,
    incarnation: Incarnation,
    round: Round,
    patience: Ticks,
    arguments: [u8; 8],
    /// Whether the arriving task is the last member: then every member is released.
    is_last: bool,
}

impl Arrival {
    /// Whether every member is released.
    pub const fn releases(&self) -> bool {
        self.is_last
    }
}

impl Rendezvous {
    /// What the other members hear when this task, which does not wait anywhere, reaches the waitfor. `None` if the arrival
    /// requires small steps.
    pub fn may_reach(
        &self,
        own: &Own,
        (port, from): (&Port, usize),
        (arguments, patience): ([u8; 8], Ticks),
    ) -> Option<Arrival> {
        let (incarnation, round) = (own.incarnation, self.announced.next().fresher(self.fresh));
        let mut arrival = Arrival { from, incarnation, round, patience, arguments, is_last: false };
        arrival.is_last =
            self.completes(own.now, (port, from), &Arrival { patience: Ticks::FAR, ..arrival })?;
        Some(arrival)
    }

    /// Whether the member at this position can hear of the arrival in a fused step: the arriving task's first arrival in
    /// its round, after which either all members are released or none.
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
        is_new
            && round == self.announced
            && self.completes(own.now, (port, member), arrival) == Some(arrival.is_last)
    }

    /// Whether all members have arrived, besides this member and the one that arrives now. `None` if they have, but one of
    /// their arrivals is within the margin, or of another incarnation.
    fn completes(&self, now: Instant, (port, member): (&Port, usize), arrival: &Arrival) -> Option<bool> {
        let (mut least, mut is_known) = (arrival.patience, true);
        // The loop goes backwards: if members arrive in the order of the list, the last ones are missing longest.
        for (i, other) in self.members.iter().enumerate().rev() {
            if i == member || i == arrival.from {
                continue;
            }
            let here = other.arrived.filter(|a| a.round == arrival.round && a.expires > now);
            let Some(here) = here else { return Some(false) };
            least = least.min(here.expires - now);
            is_known &= other.incarnation == Some(arrival.incarnation);
        }
        (is_known && least > port.margin).then_some(true)
    }

    /// Stores an arrival. If it is the last one, releases this member.
    fn hear_at_once(&mut self, at: &mut At<'_, '_, impl Outbox>, own: usize, arrival: &Arrival) {
        let Arrival { from, incarnation, round, patience, arguments, is_last } = *arrival;
        self.members[from].incarnation = Some(incarnation);
        self.hear_of(round);
        self.record(at, from, Arrived { round, expires: at.now() + patience, arguments });
        if is_last {
            self.release_if_complete(at);
            self.note_confirms(own);
        }
    }

    /// Notes the CONFIRMs of all other members, each of which was released in the same step.
    fn note_confirms(&mut self, own: usize) {
        for (i, member) in self.members.iter_mut().enumerate() {
            member.confirmed |= i != own;
        }
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
            rendezvous.reach(at, arrival.arguments, arrival.patience);
            if arrival.is_last {
                rendezvous.note_confirms(own);
            }
        })
        .1
    }

    /// [`hear`](Self::hear) of an arrival in a fused step that [`may_hear`](Rendezvous::may_hear) allows.
    pub fn hear_fused<'a, O: Outbox>(
        &mut self,
        step: &mut Step<'a, O>,
        at: (&'a Port, usize, u16),
        (own, arrival): (usize, &Arrival),
    ) -> Option<Ended> {
        self.run_at(step, at, |rendezvous, at| rendezvous.hear_at_once(at, own, arrival)).1
    }
}
