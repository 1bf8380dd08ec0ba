//! Transmission of ARRIVE, CONFIRM and ABORT to the other members.

use super::{At, Rendezvous};
use crate::ids::{Incarnation, MessageId, Round, Seq24};
use crate::observe::Event;
use crate::packet::{Class, Kind, Meeting, Packet};
use crate::task::step::Outbox;
use crate::ticks::{Instant, Ticks};

impl Rendezvous {
    pub(super) fn confirm_if_owed(&mut self, at: &mut At<'_, '_, impl Outbox>) {
        if let Some(round) = self.released.filter(|_| self.owes_confirm && self.least_patience(at).is_some())
        {
            self.owes_confirm = false;
            self.confirm_with_copies(at, round);
        }
    }

    /// Sends the CONFIRM now, and `losses` more copies later, while the task already runs (D55).
    pub(super) fn confirm_with_copies(&mut self, at: &mut At<'_, '_, impl Outbox>, round: Round) {
        self.copies_left = at.port.decl.losses;
        self.copy_at = if self.copies_left == 0 { Instant::NEVER } else { at.now() + at.port.decl.resend };
        self.confirm(at, round, false);
    }

    pub(super) fn confirm<O: Outbox>(&mut self, at: &mut At<'_, '_, O>, round: Round, resent: bool) {
        self.note(Event::Confirmed, at.step.own.task, Ticks::ZERO, at);
        if !O::TRANSMITS {
            return;
        }
        for i in 0..self.members.len() {
            // A member that has restarted since the release was not in this meeting.
            if !self.members[i].reborn {
                let incarnation = self.members[i].incarnation.unwrap_or_default();
                self.send_confirm(at, i, round, incarnation, resent);
            }
        }
    }

    /// Sends ARRIVE to every other member: separately addressed packets, no broadcast (§4.3, R19).
    pub(super) fn announce<O: Outbox>(&mut self, at: &mut At<'_, '_, O>, resent: bool) {
        let now = at.now();
        let Some(deadline) = self.deadline else { return };
        // The instant of the next ARRIVE counts back from the deadline, so that the last copies leave at fixed distances
        // from the deadline (D55).
        let period = at.port.decl.resend;
        self.resend_at = match self.resend_at + period {
            // `resend_instant` gives the same instant, but with symbolic times its division needs many comparisons.
            next if self.resend_at == now && next < deadline => next,
            _ if self.resend_at == now => Instant::NEVER,
            _ => Self::resend_instant(deadline, now, period),
        };
        if !O::TRANSMITS {
            return;
        }
        let round = self.announced;
        let meeting = Meeting { round, released: self.released.unwrap_or(round), arguments: self.arguments };
        let packet = self.packet(at, Kind::Arrive, meeting);
        for i in 0..self.members.len() {
            send(at, i, Packet { remaining: deadline - now, resent, ..packet });
        }
    }

    pub(super) fn send_confirm(
        &self,
        at: &mut At<'_, '_, impl Outbox>,
        to: usize,
        round: Round,
        incarnation: Incarnation,
        resent: bool,
    ) {
        let meeting = Meeting { round, released: round, arguments: [0; 8] };
        // A late CONFIRM does no harm, because the packet names its round. So the TTL of the CONFIRM is the longest
        // patience of any member.
        let packet = self.packet(at, Kind::Confirm, meeting);
        let id = MessageId { incarnation, ..packet.id };
        send(at, to, Packet { id, resent, ..packet });
    }

    pub(super) fn send_abort(&self, at: &mut At<'_, '_, impl Outbox>, to: usize, round: Round, next: Round) {
        let released = self.released.unwrap_or(round);
        let meeting = Meeting { round, released, arguments: Meeting::abort_arguments(next) };
        let packet = self.packet(at, Kind::Abort, meeting);
        send(at, to, packet);
    }

    /// A packet without its receiver, which the function `send` fills in.
    fn packet(&self, at: &At<'_, '_, impl Outbox>, kind: Kind, meeting: Meeting) -> Packet {
        Packet {
            kind,
            class: Class::Command,
            source: at.step.own.task,
            port: self.port,
            id: MessageId { incarnation: at.step.own.incarnation, sequence: Seq24::default() },
            remaining: at.port.decl.time_out,
            contents: meeting.to_contents(),
            ..Packet::BLANK
        }
    }
}

/// Sends a packet to a member, unless the member is this task itself.
fn send(at: &mut At<'_, '_, impl Outbox>, to: usize, packet: Packet) {
    let destination = at.port.parties[to].task;
    if destination != at.step.own.task {
        at.step.out.transmit(Packet { destination, ..packet });
    }
}
