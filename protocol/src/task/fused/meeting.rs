//! A member's part in a fused arrival at a `waitfor` (D193). `node/fused/gathering.rs` goes through the members.

use crate::observe::Observation;
use crate::table::{NodeTable, Party, Port};
use crate::task::CommTask;
use crate::task::rendezvous::Arrival;
use crate::task::step::{Outbox, Step};
use crate::task::wait::Pending;
use crate::ticks::Ticks;

impl CommTask {
    /// The arrival of which the other members hear when this task, the member at this position, reaches the
    /// `waitfor`. `None` if this member's state requires small steps.
    pub(crate) fn may_reach(
        &self,
        (port, member): (&Port, usize),
        arguments: [u8; 8],
        patience: Ticks,
    ) -> Option<Arrival> {
        let Self { own, machines, .. } = self;
        let is_usual = machines.interrupts.waits_for_nothing() && machines.is_plain();
        let rendezvous = machines.meetings.at(port.parties[member].meeting);
        if is_usual { rendezvous.may_reach(own, (port, member), (arguments, patience)) } else { None }
    }

    /// Whether this task, the member at this position, can hear of the arrival in a fused step.
    #[inline(always)]
    pub(crate) fn may_hear(&self, (port, party, member): (&Port, &Party, usize), arrival: &Arrival) -> bool {
        let Self { own, machines, .. } = self;
        machines.meetings.at(party.meeting).may_hear(own, (port, member), arrival)
    }

    /// Reaches the `waitfor` as [`may_reach`](Self::may_reach) allows.
    pub(crate) fn reach_fused<'a>(
        &'a mut self,
        table: &'a NodeTable,
        (port, member): (&'a Port, usize),
        arrival: &Arrival,
        out: &'a mut impl Outbox,
    ) {
        let Self { own, machines, due } = self;
        let Party { place, meeting, .. } = port.parties[member];
        machines.interrupts.wait(Pending::Meeting(meeting));
        let step = &mut Step { table, own, out };
        let ended = machines.meetings.reach_fused(step, (port, place.into(), meeting), (member, arrival));
        machines.end(step, ended);
        *due = None;
    }

    /// Hears of an arrival as [`may_hear`](Self::may_hear) allows.
    #[inline(always)]
    pub(crate) fn hear_fused(&mut self, party: &Party, arrival: &Arrival, observe: impl FnOnce(Observation)) {
        let Self { own, machines, .. } = self;
        machines.meetings.at_mut(party.meeting).hear_fused(own.now, arrival, observe);
    }

    /// Releases this member, which has heard of the last arrival.
    pub(crate) fn release_fused<'a>(
        &'a mut self,
        table: &'a NodeTable,
        (port, member): (&'a Port, usize),
        out: &'a mut impl Outbox,
    ) {
        let Self { own, machines, due } = self;
        let Party { place, meeting, .. } = port.parties[member];
        let step = &mut Step { table, own, out };
        let ended = machines.meetings.release_fused(step, (port, place.into(), meeting), member);
        machines.end(step, ended);
        *due = None;
    }
}
