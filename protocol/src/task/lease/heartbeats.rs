//! Heartbeats of a couple and their answers: encoding, and what the receiver does with them.

use super::{ALONE, ANSWERS, Answered, ECHO_BYTES, LEASED, Lease, Post, WAITS, is_newer_epoch};
use crate::cell::CoupleDecl;
use crate::ids::{Incarnation, Seq24};
use crate::mapping;
use crate::packet::{Contents, Kind, Packet};
use crate::request::PUBLISHED_BYTES;
use crate::rules::LeaseRule;
use crate::table::Port;
use crate::task::step::{Outbox, Step};
use crate::ticks::{Instant, Ticks};

impl Lease {
    pub(super) fn heartbeat(&mut self, step: &mut Step<'_, impl Outbox>, couple: &CoupleDecl) {
        let Some(port) = step.table.port(couple.via) else { return };
        let ttl = port.party(step.own.task).map_or(Ticks::ZERO, |party| party.time_out);
        let id = step.next_id();
        self.echo = self.echo.filter(|echo| echo.until > step.now());
        let back = self.echo.map_or(0, |echo| id.sequence.steps_from(echo.heartbeat));
        let back = u16::try_from(back).unwrap_or(0).to_le_bytes();
        let whose = self.incarnation.map_or(0, |incarnation| incarnation.0);
        let guessed = u8::from(self.guessed);
        let contents = Contents::new(&[back[0], back[1], self.epoch, whose, guessed]).unwrap_or_default();
        let packet = mapping::message(port, step.own.task, self.partner, id, ttl, contents);
        step.out.transmit(Packet { kind: Kind::Query, ..packet });
        // The next heartbeat's instant counts from the instant at which this one was due, so that lateness does not add up.
        // After a pause one heartbeat is sent, not all those that were missed.
        let next = self.heartbeat_at + couple.every;
        self.heartbeat_at = if next > step.now() { next } else { step.now() + couple.every };
    }

    pub(super) fn hear_heartbeat(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        couple: &CoupleDecl,
        port: &Port,
        packet: &Packet,
    ) {
        // If both tasks wait, only the primary answers, so that it gets the lease.
        if self.post == Post::Passive || (self.post == Post::Waits && !self.primary) {
            return;
        }
        let bytes = packet.contents.as_bytes();
        let Some(&[low, high, epoch, whose]) = bytes.first_chunk() else { return };
        let guessed = bytes.get(ECHO_BYTES).is_some_and(|&guessed| guessed != 0);
        if !self.enter_incarnation(packet.id.incarnation, epoch, guessed) {
            return;
        }
        let back = u32::from(u16::from_le_bytes([low, high]));
        let echoed = packet.id.sequence.plus(Seq24::MODULUS - back);
        let renewed = match step.table.rules().lease {
            LeaseRule::Echoed => {
                // An echo of an answer that an earlier incarnation sent does not count, because that answer was sent before
                // this incarnation began (D81).
                let own = back != 0 && whose == step.own.incarnation.0;
                let answered = self.answered.iter().flatten().find(|a| own && a.heartbeat == echoed);
                answered.map(|answered| answered.until)
            }
            LeaseRule::Heartbeat => Some(step.now() + couple.lease),
        };
        if let Some(until) = renewed.filter(|&until| until > step.now()) {
            match self.post {
                Post::Leased(held) => self.post = Post::Leased(held.max(until)),
                // The task has not been signalled yet that it lost its lease, so it may still believe that it acts. The
                // fence comes first.
                Post::Waits if self.call.is_some() => {}
                // All recorded answers announce this epoch, so a later echo of any of them renews the lease, too.
                Post::Waits => {
                    self.stand(Post::Leased(until));
                    // Under the rule variant `Heartbeat` no answer has proposed the epoch yet.
                    self.propose();
                    (self.proposed, self.guessed) = (false, false);
                }
                Post::Alone => self.post = Post::Leased(until),
                Post::Passive => {}
            }
        }
        self.answer(step, couple, port, packet);
    }

    fn answer(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        couple: &CoupleDecl,
        port: &Port,
        heartbeat: &Packet,
    ) {
        if self.post == Post::Waits {
            self.propose();
        }
        let mut bytes = [0; ECHO_BYTES + PUBLISHED_BYTES];
        bytes[0] = match self.post {
            Post::Waits | Post::Passive => WAITS,
            Post::Leased(_) => LEASED,
            Post::Alone => ALONE,
        };
        (bytes[1], bytes[2], bytes[3]) = (self.epoch, step.own.incarnation.0, u8::from(self.guessed));
        let published = self.published.as_bytes();
        let len = published.len().min(PUBLISHED_BYTES);
        bytes[ECHO_BYTES..ECHO_BYTES + len].copy_from_slice(&published[..len]);
        let contents = Contents::new(&bytes[..ECHO_BYTES + len]).unwrap_or_default();
        let ttl = port.party(step.own.task).map_or(Ticks::ZERO, |party| party.time_out);
        if self.newest.is_none_or(|newest| heartbeat.id.sequence.is_newer_than(newest)) {
            self.newest = Some(heartbeat.id.sequence);
            self.answered.rotate_right(1);
            self.answered[0] =
                Some(Answered { heartbeat: heartbeat.id.sequence, until: step.now() + couple.lease });
        }
        let to = mapping::reply_to(heartbeat);
        step.out.transmit(mapping::answer(to, step.own.task, Kind::Response, ttl, contents));
    }

    pub(super) fn hear_answer(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        couple: &CoupleDecl,
        packet: &Packet,
    ) {
        if self.post != Post::Waits || packet.id.incarnation != step.own.incarnation {
            return;
        }
        let bytes = packet.contents.as_bytes();
        let Some(&[mode, epoch, incarnation, guessed]) = bytes.first_chunk() else { return };
        let incarnation = Incarnation(incarnation);
        if self.incarnation.is_some_and(|known| incarnation.is_older_than(known)) {
            return;
        }
        if self.incarnation.replace(incarnation) != Some(incarnation) {
            (self.answered, self.newest, self.echo) = ([None; ANSWERS], None, None);
        }
        self.hear_of(epoch, guessed != 0);
        // An echo that can no longer renew the lease is treated as absent, even before a heartbeat drops it.
        self.echo = self.echo.filter(|echo| echo.until > step.now());
        let newest = self.echo.is_none_or(|echo| packet.id.sequence.is_newer_than(echo.heartbeat));
        if newest {
            // The partner's lease counts from the sending of the answer. By the time at which this task would take over,
            // that lease has ended whatever the drift, so a later echo is of no use.
            self.echo = Some(Answered { heartbeat: packet.id.sequence, until: step.now() + couple.takeover });
            self.said = Contents::new(bytes.get(ECHO_BYTES..).unwrap_or(&[])).unwrap_or_default();
        }
        // An answer that is older than the newest one may postpone the take-over, but not cancel it.
        let may = !couple.mutual || mode == LEASED || self.takeover_at != Instant::NEVER;
        self.takeover_at = if mode == ALONE && newest {
            Instant::NEVER
        } else if may {
            step.now() + couple.takeover
        } else {
            self.takeover_at
        };
    }

    /// Whether a heartbeat is from the partner's present incarnation. A new incarnation has received no answer. The
    /// partner's earlier incarnation may have acted in an epoch that is unknown now, and so may an earlier incarnation of
    /// this task: so one epoch of each side is skipped. If the partner guesses, its earlier incarnation may have guessed,
    /// too, and may have acted two epochs above that guess.
    fn enter_incarnation(&mut self, incarnation: Incarnation, epoch: u8, guessed: bool) -> bool {
        if self.incarnation.is_some_and(|known| incarnation.is_older_than(known)) {
            return false;
        }
        self.hear_of(epoch, guessed);
        if self.incarnation != Some(incarnation) {
            (self.incarnation, self.answered, self.newest) = (Some(incarnation), [None; ANSWERS], None);
            if !self.acts() {
                self.epoch = self.epoch.wrapping_add(if guessed { 4 } else { 2 });
                self.disown();
            }
        }
        true
    }

    /// Takes note of the partner's epoch. If exactly one side guesses, both use the epoch of the side that knows. A
    /// proposal that this side made from a guess is then void, even if both have the same number.
    fn hear_of(&mut self, epoch: u8, guessed: bool) {
        if self.acts() {
            return;
        }
        let taken = match (self.guessed, guessed) {
            (true, false) => true,
            (false, true) => false,
            (true, true) | (false, false) => is_newer_epoch(epoch, self.epoch),
        };
        if taken {
            self.epoch = epoch;
            self.disown();
        }
        self.guessed &= guessed;
    }
}
