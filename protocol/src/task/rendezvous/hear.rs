//! Reception of ARRIVE, CONFIRM and ABORT from the other members.

use super::{Arrived, At, Rendezvous};
use crate::ids::{Round, TaskId};
use crate::observe::{Event, Observation, Reason};
use crate::packet::{Kind, Meeting, Packet};
use crate::request::ReleasedBy;
use crate::rules::Confirmation;
use crate::table::Peer;
use crate::task::step::Outbox;
use crate::ticks::{Instant, Ticks};

impl Rendezvous {
    /// Takes a packet of another member.
    pub(super) fn hear(&mut self, at: &mut At<'_, '_, impl Outbox>, peer: &Peer, packet: &Packet) {
        let from = usize::from(peer.party);
        let meeting = packet.meeting();
        if packet.kind == Kind::Confirm {
            return self.hear_confirm(at, from, packet, meeting.round);
        }
        match self.members[from].incarnation {
            Some(incarnation) if incarnation != packet.id.incarnation => {
                if packet.id.incarnation.is_older_than(incarnation) {
                    return self.drop_packet(at, packet, Reason::StaleIncarnation);
                }
                self.forget(from);
            }
            Some(_) | None => {}
        }
        self.members[from].incarnation = Some(packet.id.incarnation);
        if packet.kind == Kind::Abort {
            self.hear_abort(at, from, meeting);
        } else {
            self.hear_arrival(at, peer, packet);
        }
    }

    fn hear_arrival(&mut self, at: &mut At<'_, '_, impl Outbox>, peer: &Peer, packet: &Packet) {
        let from = usize::from(peer.party);
        let Meeting { round, released, arguments } = packet.meeting();
        if at.step.own.turns_away(at.step.table, peer) {
            // The packet may be meant for an earlier incarnation of this task. Its sender may have been released together
            // with that incarnation.
            return self.drop_packet(at, packet, Reason::StaleIncarnation);
        }
        let arrived = Arrived { round, expires: at.now() + packet.remaining, arguments };
        if !self.numbered {
            self.record(at, from, arrived);
            return self.release_if_complete(at);
        }
        self.hear_of(round);
        if self.deadline.is_none() {
            if round.is_newer_than(self.announced) {
                self.record(at, from, arrived);
            } else if self.owes_confirm && self.released == Some(round) && !self.members[from].reborn {
                self.record(at, from, arrived);
                self.confirm_if_owed(at);
            } else {
                self.answer_late(at, from, packet);
            }
        } else if self.says_released(at, round, released) {
            self.release(at, ReleasedBy::Confirm(at.port.parties[from].task));
            if round.is_newer_than(self.announced) {
                self.record(at, from, arrived);
            }
        } else if self.announced.is_newer_than(round) {
            self.answer_late(at, from, packet);
        } else if self.record(at, from, arrived) {
            if round.is_newer_than(self.announced) {
                self.rejoin(at, round);
            }
            self.release_if_complete(at);
        }
    }

    fn hear_confirm(&mut self, at: &mut At<'_, '_, impl Outbox>, from: usize, packet: &Packet, round: Round) {
        self.hear_of(round);
        // A CONFIRM names the incarnation whose arrival it confirms: a CONFIRM for an earlier incarnation releases no member
        // (D67).
        let mine = round == self.announced && packet.id.incarnation == at.step.own.incarnation;
        if mine {
            self.members[from].confirmed = true;
        }
        if mine && self.deadline.is_some() {
            self.release(at, ReleasedBy::Confirm(packet.source));
        } else if !mine {
            self.drop_packet(at, packet, Reason::OldRound);
        }
    }

    fn hear_abort(&mut self, at: &mut At<'_, '_, impl Outbox>, from: usize, meeting: Meeting) {
        let Meeting { round, released, .. } = meeting;
        let task = at.port.parties[from].task;
        self.note(Event::PartnerAborted, task, Ticks::ZERO, at);
        let numbered = self.numbered;
        let member = &mut self.members[from];
        if member.arrived.is_some_and(|a| !a.round.is_newer_than(round)) {
            member.arrived = None;
        }
        if !numbered {
            return;
        }
        member.barred = Some(member.barred.map_or(round, |barred| barred.fresher(round)));
        // An ABORT of a round that this task has left says nothing about its present round (D68).
        if self.is_over(round) {
            return;
        }
        if self.deadline.is_some() && self.says_released(at, round, released) {
            return self.release(at, ReleasedBy::Confirm(task));
        }
        let next = meeting.next_round();
        self.hear_of(round);
        self.hear_of(next);
        if self.deadline.is_some() && next.is_newer_than(self.announced) {
            self.rejoin(at, next);
            self.release_if_complete(at);
        }
    }

    /// Whether a packet of `round` with this `released` field proves that its sender was released from the round in which
    /// this task waits. If the field equals the packet's round, the sender was never released yet (D69).
    fn says_released(&self, at: &At<'_, '_, impl Outbox>, round: Round, released: Round) -> bool {
        // A restarted task cannot tell by the round alone whether a meeting was its own or one of its earlier incarnation.
        // So it ignores the field `released` until its first release (D67).
        let believes = !at.step.own.restarted || self.released.is_some();
        at.step.table.rules().last_released && believes && released != round && released == self.announced
    }

    /// Stores an arrival, unless its sender gave up that round or has arrived in a fresher one. Returns whether it was
    /// stored.
    pub(super) fn record(&mut self, at: &mut At<'_, '_, impl Outbox>, from: usize, arrived: Arrived) -> bool {
        let member = &mut self.members[from];
        // An arrival whose patience has ended does not count.
        let held = member.arrived.filter(|held| held.expires > at.now());
        let barred = member.barred.is_some_and(|barred| !arrived.round.is_newer_than(barred));
        let behind = held.is_some_and(|held| held.round.is_newer_than(arrived.round));
        if barred || behind {
            at.counters().dropped += 1;
            self.note(Event::Discarded(Reason::OldRound), at.port.parties[from].task, Ticks::ZERO, at);
            return false;
        }
        let again = held.filter(|held| held.round == arrived.round);
        let expires = again.map_or(arrived.expires, |held| held.expires.max(arrived.expires));
        member.arrived = Some(Arrived { expires, ..arrived });
        if again.is_none() {
            let observation = self.arrival(at.now(), at.port.parties[from].task, &arrived);
            at.step.out.observe(observation);
        } else {
            at.counters().duplicates += 1;
        }
        true
    }

    /// What this task observes when a member has arrived.
    #[inline]
    pub(super) fn arrival(&self, now: Instant, peer: TaskId, arrived: &Arrived) -> Observation {
        let Arrived { round, expires, .. } = *arrived;
        let (event, port, number) = (Event::PartnerArrived, self.port, u32::from(round.0));
        Observation { event, port, peer, number, remaining: expires - now }
    }

    /// Answers a late arrival: by CONFIRM if this task was last released from the arrival's round, and by ABORT otherwise
    /// (D54).
    fn answer_late(&mut self, at: &mut At<'_, '_, impl Outbox>, from: usize, packet: &Packet) {
        let round = packet.meeting().round;
        if !at.step.table.rules().answer_late_arrivals {
            return self.drop_packet(at, packet, Reason::OldRound);
        }
        if self.released == Some(round) && !self.members[from].reborn {
            if at.step.table.rules().confirmation != Confirmation::None {
                self.send_confirm(at, from, round, packet.id.incarnation, true);
            }
        } else if at.step.table.rules().aborts {
            let waiting = self.deadline.is_some();
            let next = if waiting { self.announced } else { self.announced.next().fresher(self.fresh) };
            self.send_abort(at, from, round, next);
        }
    }

    /// Notes a round that the task heard of, if that round is fresher than its own. Rounds more than half the number circle
    /// apart have no order.
    pub(super) fn hear_of(&mut self, round: Round) {
        if self.numbered && round.is_newer_than(self.announced) {
            self.fresh = self.fresh.fresher(round);
        }
    }

    fn drop_packet(&self, at: &mut At<'_, '_, impl Outbox>, packet: &Packet, reason: Reason) {
        at.counters().dropped += 1;
        self.note(Event::Discarded(reason), packet.source, packet.remaining, at);
    }
}
