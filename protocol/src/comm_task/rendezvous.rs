//! `waitfor`: the n-way rendezvous with confirmation (§4.3; D1 to D3, D54 to D57).
//!
//! A task that reaches the waitfor announces a *round* to every other member. It is released when it holds the
//! arrivals of all others in one round, each with more than the safety margin left, or when it learns that another
//! member was released from that round. Nothing but its own time_out ends its wait without a release.

use super::counts::Counts;
use super::{Outbox, Scene};
use crate::cell::MAX_MEMBERS;
use crate::ids::{Incarnation, MessageId, PortId, Round, Seq24, TaskId};
use crate::observe::{Event, MeetingState, MeetingView, MemberView, Observation, Reason};
use crate::packet::{Class, Kind, MAX_HOPS, Meeting, Packet, Seal};
use crate::request::ReleasedBy;
use crate::rules::Confirmation;
use crate::table::Port;
use crate::ticks::Ticks;
use alloc::boxed::Box;
use serde::{Deserialize, Serialize};

/// What one member holds of another one's arrival.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Arrived {
    pub round: Round,
    /// When the sender's patience ends, on this task's counter: an arrival lives no longer than its sender waits (D3).
    pub expires: Ticks,
    pub arguments: [u8; 8],
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Member {
    pub arrived: Option<Arrived>,
    /// The freshest round the member gave up: later copies of its arrival there do not count (D54).
    pub barred: Option<Round>,
    /// The life of the member that it was last heard in.
    pub life: Option<Incarnation>,
    /// The member restarted since this task's last release: that release says nothing about the new life.
    pub reborn: bool,
    /// Known to have released the round that this task is in; shown, not acted on.
    pub confirmed: bool,
    /// What it brought to the round that this task left last: what comes after that changes nothing of it.
    pub told: Option<[u8; 8]>,
}

/// One task's side of a rendezvous.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Rendezvous {
    pub port: PortId,
    /// Whether meetings are numbered: the variant without rounds keeps all of them alike (D3).
    pub numbered: bool,
    /// The last round this task announced; while it waits, the round it waits in.
    pub announced: Round,
    /// The freshest round heard of.
    pub fresh: Round,
    /// The round this task last released.
    pub released: Option<Round>,
    /// While waiting: when this task's patience ends.
    pub deadline: Option<Ticks>,
    /// While waiting: when the arrival is announced again.
    pub resend_at: Ticks,
    /// All parties of the port, owner first; the own entry stays empty.
    pub members: Box<[Member]>,
    /// How many more copies of the CONFIRM of `released` are to be sent, and when the next one.
    pub copies_left: u8,
    pub copy_at: Ticks,
    /// Released by a CONFIRM without all arrivals; confirms when it has them (`EveryComplete`).
    pub owes_confirm: bool,
    /// What this task tells the others.
    pub arguments: [u8; 8],
}

/// Where a rendezvous method works: the surroundings, the port and the counters of this task's end.
pub(crate) struct At<'a> {
    pub scene: &'a Scene<'a>,
    pub port: &'a Port,
    pub counters: &'a mut Counts,
    /// The task is released from this round: to be told.
    pub released: Option<(Round, ReleasedBy)>,
}

impl Rendezvous {
    pub fn new(port: PortId, parties: usize, numbered: bool) -> Self {
        Self {
            port,
            numbered,
            announced: Round::default(),
            fresh: Round::default(),
            released: None,
            deadline: None,
            resend_at: Ticks::FAR,
            members: (0..parties).map(|_| Member::default()).collect(),
            copies_left: 0,
            copy_at: Ticks::FAR,
            owes_confirm: false,
            arguments: [0; 8],
        }
    }

    /// The earliest instant at which time alone makes this task act.
    pub fn due(&self) -> Ticks {
        self.deadline.unwrap_or(Ticks::FAR).min(self.resend_at).min(self.copy_at)
    }

    /// The task reaches the waitfor.
    pub fn reach(&mut self, at: &mut At<'_>, arguments: [u8; 8], patience: Ticks, out: &mut impl Outbox) {
        if self.numbered {
            // D54: joins the round that others wait in, if there is one.
            let fresh = if at.scene.table.rules().join_fresher { self.fresh } else { self.announced };
            self.enter(self.announced.next().fresher(fresh), at.scene.now);
            self.fresh = self.announced;
        }
        self.arguments = arguments;
        self.members.iter_mut().for_each(|member| member.told = None);
        self.owes_confirm = false;
        self.deadline = Some(at.scene.now + patience);
        for member in &mut self.members {
            member.confirmed = false;
        }
        at.counters.sent += 1;
        self.note(Event::Reached, at.scene.task, patience, out);
        self.announce(at, false, out);
        self.release_if_complete(at, out);
    }

    /// The task leaves without a release: its patience ended, or it was cancelled before. Returns who had not arrived.
    pub fn leave(&mut self, at: &mut At<'_>, out: &mut impl Outbox) -> u64 {
        let in_vain = self.deadline.is_some_and(|deadline| deadline <= at.scene.now);
        at.counters.timed_out += u64::from(in_vain);
        let mut missing = 0;
        self.keep_told(at.scene.now);
        for (i, member) in self.members.iter().enumerate().take(MAX_MEMBERS) {
            missing |= u64::from(member.told.is_none() && at.port.parties[i].task != at.scene.task) << i;
        }
        self.deadline = None;
        self.resend_at = Ticks::FAR;
        self.note(Event::GaveUp, at.scene.task, Ticks::ZERO, out);
        if at.scene.table.rules().aborts {
            for i in 0..self.members.len() {
                self.send_abort(at, i, self.announced, self.announced.next(), out);
            }
        }
        missing
    }

    /// Time has passed: sends again what is due. The deadline is the caller's to notice.
    pub fn advance(&mut self, at: &mut At<'_>, out: &mut impl Outbox) {
        if self.copy_at <= at.scene.now {
            self.copies_left = self.copies_left.saturating_sub(1);
            self.copy_at =
                if self.copies_left == 0 { Ticks::FAR } else { at.scene.now + at.port.decl.resend };
            if let Some(round) = self.released {
                at.counters.resent += 1;
                self.confirm(at, round, true, out);
            }
        }
        let patient = self.deadline.is_some_and(|deadline| at.scene.now < deadline);
        if patient && self.resend_at <= at.scene.now {
            at.counters.resent += 1;
            self.announce(at, true, out);
        }
    }

    /// A packet of another member came in.
    pub fn hear(&mut self, at: &mut At<'_>, packet: &Packet, out: &mut impl Outbox) {
        let Some(from) = at.port.party_index(packet.source) else {
            return self.drop_packet(at, packet, Reason::NotAllowed, out);
        };
        let meeting = packet.meeting();
        if packet.kind == Kind::Confirm {
            return self.hear_confirm(at, from, packet, meeting.round, out);
        }
        match self.members[from].life {
            Some(life) if life != packet.id.incarnation => {
                if is_older(packet.id.incarnation, life) {
                    return self.drop_packet(at, packet, Reason::StaleIncarnation, out);
                }
                self.forget(from);
            }
            Some(_) | None => {}
        }
        self.members[from].life = Some(packet.id.incarnation);
        if packet.kind == Kind::Abort {
            self.hear_abort(at, from, meeting, out);
        } else {
            self.hear_arrival(at, from, packet, out);
        }
    }

    /// The node of a member restarted: its arrival is void, and it cannot have been in the meeting released last.
    pub fn forget(&mut self, member: usize) {
        let life = self.members[member].life;
        self.members[member] = Member { life, reborn: true, ..Member::default() };
    }

    fn hear_arrival(&mut self, at: &mut At<'_>, from: usize, packet: &Packet, out: &mut impl Outbox) {
        let Meeting { round, released, arguments } = packet.meeting();
        if at.scene.quarantined && !at.scene.table.is_here(packet.source) {
            // It may be meant for an earlier life of this task, and its sender may have been released with that one.
            return self.drop_packet(at, packet, Reason::StaleIncarnation, out);
        }
        let arrived = Arrived { round, expires: at.scene.now + packet.remaining, arguments };
        if !self.numbered {
            self.record(at, from, arrived, out);
            return self.release_if_complete(at, out);
        }
        self.hear_of(round);
        if self.deadline.is_none() {
            if round.is_newer_than(self.announced) {
                self.record(at, from, arrived, out);
            } else if self.owes_confirm && self.released == Some(round) && !self.members[from].reborn {
                self.record(at, from, arrived, out);
                self.confirm_if_owed(at, out);
            } else {
                self.answer_late(at, from, packet, out);
            }
        } else if self.says_released(at, round, released) {
            self.release(at, ReleasedBy::Confirm(at.port.parties[from].task), out);
            if round.is_newer_than(self.announced) {
                self.record(at, from, arrived, out);
            }
        } else if self.announced.is_newer_than(round) {
            self.answer_late(at, from, packet, out);
        } else if self.record(at, from, arrived, out) {
            if round.is_newer_than(self.announced) {
                self.rejoin(at, round, out);
            }
            self.release_if_complete(at, out);
        }
    }

    fn hear_confirm(
        &mut self,
        at: &mut At<'_>,
        from: usize,
        packet: &Packet,
        round: Round,
        out: &mut impl Outbox,
    ) {
        self.hear_of(round);
        // The CONFIRM names the life of the arrival it confirms: one meant for an earlier life releases nobody.
        let mine = round == self.announced && packet.id.incarnation == at.scene.incarnation;
        if mine {
            self.members[from].confirmed = true;
        }
        if mine && self.deadline.is_some() {
            self.release(at, ReleasedBy::Confirm(packet.source), out);
        } else if !mine {
            self.drop_packet(at, packet, Reason::OldRound, out);
        }
    }

    fn hear_abort(&mut self, at: &mut At<'_>, from: usize, meeting: Meeting, out: &mut impl Outbox) {
        let Meeting { round, released, .. } = meeting;
        let task = at.port.parties[from].task;
        self.note(Event::PartnerAborted, task, Ticks::ZERO, out);
        let numbered = self.numbered;
        let member = &mut self.members[from];
        if member.arrived.is_some_and(|a| !a.round.is_newer_than(round)) {
            member.arrived = None;
        }
        if !numbered {
            return;
        }
        member.barred = Some(member.barred.map_or(round, |barred| barred.fresher(round)));
        // Word of a round that this task has left says nothing about the one it is in (D68).
        if self.is_over(round) {
            return;
        }
        if self.deadline.is_some() && self.says_released(at, round, released) {
            return self.release(at, ReleasedBy::Confirm(task), out);
        }
        let next = meeting.next_round();
        self.hear_of(round);
        self.hear_of(next);
        if self.deadline.is_some() && next.is_newer_than(self.announced) {
            self.rejoin(at, next, out);
            self.release_if_complete(at, out);
        }
    }

    /// Whether this task will never wait in `round` again: rounds only grow.
    pub fn is_over(&self, round: Round) -> bool {
        self.announced.is_newer_than(round) || (round == self.announced && self.deadline.is_none())
    }

    /// Whether a packet of `round` with this `released` field proves that its sender released the round waited in.
    /// A field equal to the packet's round means that its sender has released nothing yet.
    fn says_released(&self, at: &At<'_>, round: Round, released: Round) -> bool {
        // A restarted task cannot tell its own meeting from one of its earlier life by the number alone, so it does
        // not believe the hint before its first release.
        let believes = !at.scene.restarted || self.released.is_some();
        at.scene.table.rules().last_released && believes && released != round && released == self.announced
    }

    /// Remembers an arrival, unless its sender has given the round up or is known to be further on.
    fn record(&mut self, at: &mut At<'_>, from: usize, arrived: Arrived, out: &mut impl Outbox) -> bool {
        let member = &mut self.members[from];
        // An arrival lives no longer than its sender waits: one that has ended says nothing any more.
        let held = member.arrived.filter(|held| held.expires > at.scene.now);
        let barred = member.barred.is_some_and(|barred| !arrived.round.is_newer_than(barred));
        let behind = held.is_some_and(|held| held.round.is_newer_than(arrived.round));
        if barred || behind {
            at.counters.dropped += 1;
            self.note(Event::Discarded(Reason::OldRound), at.port.parties[from].task, Ticks::ZERO, out);
            return false;
        }
        let again = held.filter(|held| held.round == arrived.round);
        let expires = again.map_or(arrived.expires, |held| held.expires.max(arrived.expires));
        member.arrived = Some(Arrived { expires, ..arrived });
        if again.is_none() {
            let (task, left) = (at.port.parties[from].task, arrived.expires - at.scene.now);
            out.observe(Observation {
                event: Event::PartnerArrived,
                port: self.port,
                peer: task,
                number: u32::from(arrived.round.0),
                remaining: left,
            });
        } else {
            at.counters.duplicates += 1;
        }
        true
    }

    /// D54: a late arrival of the round released last is confirmed; of any other older round, aborted.
    fn answer_late(&mut self, at: &mut At<'_>, from: usize, packet: &Packet, out: &mut impl Outbox) {
        let round = packet.meeting().round;
        if !at.scene.table.rules().answer_late_arrivals {
            return self.drop_packet(at, packet, Reason::OldRound, out);
        }
        if self.released == Some(round) && !self.members[from].reborn {
            if at.scene.table.rules().confirmation != Confirmation::None {
                self.send_confirm(at, from, round, packet.id.incarnation, true, out);
            }
        } else if at.scene.table.rules().aborts {
            let waiting = self.deadline.is_some();
            let next = if waiting { self.announced } else { self.announced.next().fresher(self.fresh) };
            self.send_abort(at, from, round, next, out);
        }
    }

    /// Goes on to a round. What the circle of rounds would show as fresh again one day is forgotten: a bar before this
    /// round, a release half the circle ago, and an arrival whose patience ended before this task came.
    fn enter(&mut self, round: Round, now: Ticks) {
        self.announced = round;
        self.released = self.released.filter(|released| !released.is_newer_than(round));
        for member in &mut self.members {
            member.barred = member.barred.filter(|&b| b == round || b.is_newer_than(round));
            member.arrived = member.arrived.filter(|arrived| arrived.expires > now);
        }
    }

    /// Takes note of a round that was heard of. Distances are no order across half the circle, so only what is fresher
    /// than the own round counts.
    fn hear_of(&mut self, round: Round) {
        if self.numbered && round.is_newer_than(self.announced) {
            self.fresh = self.fresh.fresher(round);
        }
    }

    fn rejoin(&mut self, at: &mut At<'_>, round: Round, out: &mut impl Outbox) {
        if !at.scene.table.rules().join_fresher {
            return;
        }
        self.enter(round, at.scene.now);
        for member in &mut self.members {
            member.confirmed = false;
        }
        self.note(Event::Rejoined, at.scene.task, self.left(at.scene.now), out);
        self.announce(at, false, out);
    }

    fn left(&self, now: Ticks) -> Ticks {
        self.deadline.unwrap_or(now) - now
    }

    fn is_here(&self, member: &Member, now: Ticks) -> bool {
        member.arrived.is_some_and(|a| a.round == self.announced && a.expires > now)
    }

    /// The least patience left among the others, if all of them are here.
    fn least_patience(&self, at: &At<'_>) -> Option<Ticks> {
        let mut least = Ticks::FAR;
        // From the end: those who come in the order of the list are missed there longest.
        for (member, party) in self.members.iter().zip(&at.port.parties).rev() {
            if party.task != at.scene.task {
                let arrived = member.arrived.filter(|_| self.is_here(member, at.scene.now))?;
                least = least.min(arrived.expires - at.scene.now);
            }
        }
        Some(least)
    }

    fn release_if_complete(&mut self, at: &mut At<'_>, out: &mut impl Outbox) {
        if self.deadline.is_none() {
            return;
        }
        match self.least_patience(at) {
            Some(least) if least > at.port.margin => self.release(at, ReleasedBy::AllArrived, out),
            Some(least) => self.note(Event::WithinMargin, at.scene.task, least, out),
            None => {}
        }
    }

    fn release(&mut self, at: &mut At<'_>, by: ReleasedBy, out: &mut impl Outbox) {
        let round = self.announced;
        let left = self.left(at.scene.now);
        self.keep_told(at.scene.now);
        self.released = Some(round);
        self.deadline = None;
        self.resend_at = Ticks::FAR;
        self.copies_left = 0;
        self.copy_at = Ticks::FAR;
        for member in &mut self.members {
            member.reborn = false;
        }
        at.counters.delivered += 1;
        let event = match by {
            ReleasedBy::AllArrived => Event::ReleasedComplete,
            ReleasedBy::Confirm(_) => Event::ReleasedByConfirm,
        };
        self.note(event, at.scene.task, left, out);
        at.released = Some((round, by));
        let complete = by == ReleasedBy::AllArrived;
        match at.scene.table.rules().confirmation {
            Confirmation::None => {}
            Confirmation::FirstComplete if !complete => {}
            Confirmation::EveryComplete if !complete => {
                self.owes_confirm = true;
                self.confirm_if_owed(at, out);
            }
            Confirmation::FirstComplete | Confirmation::EveryComplete | Confirmation::PassOn => {
                self.confirm_with_copies(at, round, out);
            }
        }
        if !self.numbered {
            for member in &mut self.members {
                member.arrived = None;
            }
        }
    }

    /// A member's arrival in this task's round; one whose patience ended just before was here all the same.
    fn came(&self, member: &Member, now: Ticks) -> Option<Arrived> {
        let is_over = |arrived: &Arrived| !self.numbered && arrived.expires <= now;
        member.arrived.filter(|arrived| arrived.round == self.announced && !is_over(arrived))
    }

    /// What the members brought to the round that this task leaves now.
    fn keep_told(&mut self, now: Ticks) {
        for i in 0..self.members.len() {
            self.members[i].told = self.came(&self.members[i], now).map(|arrived| arrived.arguments);
        }
    }

    fn confirm_if_owed(&mut self, at: &mut At<'_>, out: &mut impl Outbox) {
        if let Some(round) = self.released.filter(|_| self.owes_confirm && self.least_patience(at).is_some())
        {
            self.owes_confirm = false;
            self.confirm_with_copies(at, round, out);
        }
    }

    /// Sends the CONFIRM now and leaves `losses` more copies to be sent while the task already runs (D55).
    fn confirm_with_copies(&mut self, at: &mut At<'_>, round: Round, out: &mut impl Outbox) {
        self.copies_left = at.port.decl.losses;
        self.copy_at = if self.copies_left == 0 { Ticks::FAR } else { at.scene.now + at.port.decl.resend };
        self.confirm(at, round, false, out);
    }

    fn confirm(&mut self, at: &mut At<'_>, round: Round, resent: bool, out: &mut impl Outbox) {
        self.note(Event::Confirmed, at.scene.task, Ticks::ZERO, out);
        for i in 0..self.members.len() {
            // A member that restarted since is another one: it was not in this meeting.
            if !self.members[i].reborn {
                let life = self.members[i].life.unwrap_or_default();
                self.send_confirm(at, i, round, life, resent, out);
            }
        }
    }

    /// Announces the arrival to every other member: separately addressed packets, no broadcast (§4.3, R19).
    fn announce(&mut self, at: &mut At<'_>, resent: bool, out: &mut impl Outbox) {
        let now = at.scene.now;
        let Some(deadline) = self.deadline else { return };
        // D55: counted back from the deadline, so that the last copies leave at fixed distances from it.
        self.resend_at = Self::resend_instant(deadline, now, at.port.decl.resend);
        let round = self.announced;
        let meeting = Meeting { round, released: self.released.unwrap_or(round), arguments: self.arguments };
        for i in 0..self.members.len() {
            let packet =
                self.packet(at, i, Kind::Arrive, meeting, deadline - now, at.scene.incarnation, resent);
            send(at, i, packet, out);
        }
    }

    fn send_confirm(
        &self,
        at: &At<'_>,
        to: usize,
        round: Round,
        life: Incarnation,
        resent: bool,
        out: &mut impl Outbox,
    ) {
        let meeting = Meeting { round, released: round, arguments: [0; 8] };
        // Tagged by its round, a CONFIRM can do no harm late: it lives as long as any member may wait for it.
        send(at, to, self.packet(at, to, Kind::Confirm, meeting, at.port.decl.time_out, life, resent), out);
    }

    fn send_abort(&self, at: &At<'_>, to: usize, round: Round, next: Round, out: &mut impl Outbox) {
        let released = self.released.unwrap_or(round);
        let meeting = Meeting { round, released, arguments: Meeting::abort_arguments(next) };
        let packet =
            self.packet(at, to, Kind::Abort, meeting, at.port.decl.time_out, at.scene.incarnation, false);
        send(at, to, packet, out);
    }

    #[expect(clippy::too_many_arguments, reason = "the fields of one packet")]
    fn packet(
        &self,
        at: &At<'_>,
        to: usize,
        kind: Kind,
        meeting: Meeting,
        remaining: Ticks,
        life: Incarnation,
        resent: bool,
    ) -> Packet {
        Packet {
            kind,
            class: Class::Command,
            more: false,
            resent,
            urgent: false,
            hops: MAX_HOPS,
            fragment: 0,
            destination: at.port.parties[to].task,
            source: at.scene.task,
            port: self.port,
            id: MessageId { incarnation: life, sequence: Seq24::default() },
            remaining,
            contents: meeting.to_contents(),
            seal: Seal::NONE,
        }
    }

    fn drop_packet(&self, at: &mut At<'_>, packet: &Packet, reason: Reason, out: &mut impl Outbox) {
        at.counters.dropped += 1;
        self.note(Event::Discarded(reason), packet.source, packet.remaining, out);
    }

    fn note(&self, event: Event, peer: TaskId, remaining: Ticks, out: &mut impl Outbox) {
        let number = u32::from(self.announced.0);
        out.observe(Observation { event, port: self.port, peer, number, remaining });
    }

    /// How this rendezvous looks to a monitor.
    pub fn view(&self, scene: &Scene<'_>, port: &Port) -> MeetingView {
        let waiting = self.deadline.is_some();
        let round = if waiting { self.announced } else { self.announced.next().fresher(self.fresh) };
        let member = |(member, party): (&Member, &crate::table::Party)| {
            let own = party.task == scene.task;
            let held = member.arrived.filter(|a| a.round == round && a.expires > scene.now);
            let remaining = if own { self.deadline } else { held.map(|a| a.expires) };
            MemberView {
                task: party.task,
                arrived: if own { waiting } else { held.is_some() },
                confirmed: waiting && member.confirmed,
                remaining: remaining.map(|expires| expires - scene.now),
            }
        };
        let members: alloc::vec::Vec<_> = self.members.iter().zip(&port.parties).map(member).collect();
        let complete = members.iter().all(|m| m.arrived);
        let state = match (waiting, complete) {
            (false, _) => MeetingState::Away,
            (true, false) => MeetingState::Gathering,
            (true, true) => MeetingState::WithinMargin,
        };
        MeetingView {
            port: self.port,
            round,
            released: self.released.unwrap_or_default(),
            state,
            remaining: self.deadline.map(|deadline| deadline - scene.now),
            members,
        }
    }
}

fn send(at: &At<'_>, to: usize, packet: Packet, out: &mut impl Outbox) {
    if at.port.parties[to].task != at.scene.task {
        out.transmit(packet);
    }
}

/// Whether `a` is an earlier life than `b`, in wrap-safe order.
pub(crate) const fn is_older(a: Incarnation, b: Incarnation) -> bool {
    let steps = b.0.wrapping_sub(a.0);
    steps != 0 && steps < 0x80
}
