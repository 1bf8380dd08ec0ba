//! Work-coupled tasks (§2; D30, D61): one of the two acts, and when it fails the other takes over.
//!
//! A time_out cannot tell a dead partner from a slow one, so the one that acts holds a *lease*. The other sends it
//! *beats*; every answer has its number, and a beat echoes the newest answer that came. Only such an echo renews the
//! lease, and it counts from when the echoed answer was *sent*: whoever sends the beats has that answer, so it knows an
//! instant, on its own clock and no earlier, from which to wait longer than the lease before it takes over. So both
//! never act at a time, however slow the network, as long as the take-over exceeds the lease by the clocks' drift and
//! a tick.
//!
//! Each time in office has an *epoch* of its own, and actuators drop commands of an older one. The primary's epochs are
//! odd and the standby's even, so both can count up without hearing of each other. The primary says the epoch that it
//! would act in before it does, with an answer, and begins by an echo of that: so whenever the standby takes over it
//! has heard of every epoch that the primary began (D80). A node that starts again has forgotten the epochs, and where it
//! begins may seem newer than any: it says so until it has heard of one, and nobody takes its own for news (D135).
//!
//! With `<->` the roles are exchanged at a take-over. The one that took over acts alone until its partner is back, so
//! a partner that was away must not take over before it knows that the other one depends on its beats: an answer says so.

use super::inbox::Held;
use super::levels::Finished;
use super::rendezvous::is_older;
use super::{CommTask, Outbox, Pending};
use crate::cell::CoupleDecl;
use crate::ids::{Incarnation, MessageId, PortId, Seq24, TaskId};
use crate::mapping;
use crate::observe::{Event, Observation, Reason};
use crate::packet::{Contents, Kind, Packet};
use crate::request::{Call, Fault, PUBLISHED_BYTES, ReplyTo, Signal};
use crate::rules::LeaseRule;
use crate::table::{NodeTable, Port};
use crate::ticks::Ticks;
use serde::{Deserialize, Serialize};

/// How many answers whose echo may still come are remembered.
const ANSWERS: usize = 4;

/// What one of the two tasks is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) enum Post {
    /// It does not act: it waits to be given the lease, or to take over.
    Waits,
    /// It acts until this instant, unless the lease is renewed.
    Leased(Ticks),
    /// It acts after a take-over, and nobody can take over from it.
    Alone,
    /// It does not act any more in this life.
    Passive,
}

/// A beat that was answered. To the one who answered: until when its echo renews the lease. To the other: until when
/// echoing it may be of use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Answered {
    pub beat: Seq24,
    pub until: Ticks,
}

/// One task's side of a couple.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Lease {
    /// The couple's position in the cell.
    pub couple: u8,
    pub primary: bool,
    pub partner: TaskId,
    pub post: Post,
    /// The epoch it acts under, or the newest that it heard of, or that it would act under.
    pub epoch: u8,
    /// Whether `epoch` is one that the task would act under: its answers say so, and nobody has acted in it.
    pub proposed: bool,
    /// Whether it has started again and since then neither heard of an epoch nor acted: then `epoch` is a guess.
    pub guessed: bool,
    /// The partner's life: the answers below went to it, and the echo is of one of its answers.
    pub life: Option<Incarnation>,
    /// The last beats that were answered, newest first.
    pub answered: [Option<Answered>; ANSWERS],
    /// The newest of all that were answered: a copy of an older one counts for nothing, so no answer counts from a copy's.
    pub newest: Option<Seq24>,
    /// The newest own beat that was answered: the next one echoes it, while that can renew anything.
    pub echo: Option<Answered>,
    /// When the next beat is sent.
    pub beat_at: Ticks,
    /// When this task takes over if no answer comes.
    pub takeover_at: Ticks,
    /// What the answers carry, and what the partner's carried last.
    pub published: Contents,
    pub said: Contents,
    /// What the task has not been told yet.
    pub call: Option<Call>,
}

/// Where a lease works.
pub(crate) struct Beating<'a> {
    pub table: &'a NodeTable,
    pub task: TaskId,
    pub incarnation: Incarnation,
    pub now: Ticks,
    /// The number of the task's next message.
    pub next: &'a mut Seq24,
}

impl Beating<'_> {
    fn couple(&self, lease: &Lease) -> Option<&CoupleDecl> {
        self.table.cell().couples.get(usize::from(lease.couple))
    }
}

/// How a beat's answer says what its sender does.
const WAITS: u8 = 0;
const LEASED: u8 = 1;
const ALONE: u8 = 2;
/// The bytes of a beat before whether it guesses, and those of an answer before what was published.
const ECHO_BYTES: usize = 4;

impl Lease {
    /// The side of `task` in the couple at this position, at the start of its node's life, the first one or a later one.
    pub fn new(couple: u8, decl: &CoupleDecl, task: TaskId, restarted: bool) -> Self {
        let primary = decl.primary == task;
        // A restarted standby waits for the whole take-over: its earlier life may have renewed the lease just before.
        let armed = !primary && !decl.mutual;
        Self {
            couple,
            primary,
            partner: if primary { decl.standby } else { decl.primary },
            post: Post::Waits,
            // An earlier life may have taken over without having heard of anybody.
            epoch: if restarted { 2 } else { 0 },
            proposed: false,
            guessed: restarted,
            life: None,
            answered: [None; ANSWERS],
            newest: None,
            echo: None,
            beat_at: if primary && !decl.mutual { Ticks::FAR } else { Ticks::ZERO },
            takeover_at: if armed { decl.takeover } else { Ticks::FAR },
            published: Contents::EMPTY,
            said: Contents::EMPTY,
            call: None,
        }
    }

    /// Whether the task may act now.
    pub const fn acts(&self) -> bool {
        matches!(self.post, Post::Leased(_) | Post::Alone)
    }

    /// The earliest instant at which time alone makes this task act.
    pub fn due(&self) -> Ticks {
        match self.post {
            Post::Waits => self.beat_at.min(self.takeover_at),
            Post::Leased(until) => until,
            Post::Alone | Post::Passive => Ticks::FAR,
        }
    }

    /// The task ended or panicked: its partner shall take over.
    pub fn retire(&mut self) {
        self.stop(Post::Passive);
        self.call = None;
    }

    /// Time has passed: the lease ends, the task takes over, a beat is sent.
    pub fn advance(&mut self, at: &mut Beating<'_>, out: &mut impl Outbox) {
        let Some(couple) = at.couple(self).cloned() else { return };
        match self.post {
            Post::Leased(until) if until <= at.now => {
                self.stop(if couple.mutual { Post::Waits } else { Post::Passive });
                self.beat_at = if couple.mutual { at.now } else { Ticks::FAR };
                self.call = Some(Call::Fenced);
            }
            Post::Waits if self.takeover_at <= at.now => {
                self.propose();
                self.stop(Post::Alone);
                self.guessed = false;
                self.call = Some(Call::TakeOver(self.epoch));
            }
            Post::Waits | Post::Leased(_) | Post::Alone | Post::Passive => {}
        }
        if self.post == Post::Waits && self.beat_at <= at.now {
            self.beat(at, &couple, out);
        }
    }

    /// A beat of the partner, or its answer to one.
    pub fn hear(&mut self, at: &mut Beating<'_>, port: &Port, packet: &Packet, out: &mut impl Outbox) {
        let Some(couple) = at.couple(self).cloned() else { return };
        match packet.kind {
            Kind::Query => self.hear_beat(at, &couple, port, packet, out),
            Kind::Response => self.hear_answer(at, &couple, packet),
            Kind::Send | Kind::Reply | Kind::Arrive | Kind::Confirm | Kind::Abort | Kind::Control => {}
        }
    }

    /// Stops what it did so far. What was answered meanwhile is of no use to the next time in office: its epoch is over.
    fn stop(&mut self, post: Post) {
        self.stand(post);
        self.disown();
    }

    fn stand(&mut self, post: Post) {
        self.post = post;
        self.takeover_at = Ticks::FAR;
        self.beat_at = Ticks::FAR;
        self.echo = None;
    }

    /// No echo of what was answered so far makes the task act.
    fn disown(&mut self) {
        self.proposed = false;
        self.answered = [None; ANSWERS];
    }

    /// Chooses the epoch that the task would act in, if it has not yet.
    fn propose(&mut self) {
        if !self.proposed {
            self.disown();
            (self.epoch, self.proposed) = (self.next_epoch(), true);
        }
    }

    /// The next of this side's epochs: those of the primary are odd.
    const fn next_epoch(&self) -> u8 {
        let own = self.epoch % 2 == self.primary as u8;
        self.epoch.wrapping_add(if own { 2 } else { 1 })
    }

    fn beat(&mut self, at: &mut Beating<'_>, couple: &CoupleDecl, out: &mut impl Outbox) {
        let Some(port) = at.table.port(couple.via) else { return };
        let life = port.party(at.task).map_or(Ticks::ZERO, |party| party.time_out);
        let id = MessageId { incarnation: at.incarnation, sequence: *at.next };
        *at.next = at.next.next();
        self.echo = self.echo.filter(|echo| echo.until > at.now);
        let back = self.echo.map_or(0, |echo| id.sequence.steps_from(echo.beat));
        let back = u16::try_from(back).unwrap_or(0).to_le_bytes();
        let whose = self.life.map_or(0, |life| life.0);
        let guessed = u8::from(self.guessed);
        let contents = Contents::new(&[back[0], back[1], self.epoch, whose, guessed]).unwrap_or_default();
        let packet = mapping::message(port, at.task, self.partner, id, life, contents);
        out.transmit(Packet { kind: Kind::Query, ..packet });
        // Counted from when it was due, so that lateness does not add up; after a pause one beat, not all that were due.
        let next = self.beat_at + couple.every;
        self.beat_at = if next > at.now { next } else { at.now + couple.every };
    }

    fn hear_beat(
        &mut self,
        at: &Beating<'_>,
        couple: &CoupleDecl,
        port: &Port,
        packet: &Packet,
        out: &mut impl Outbox,
    ) {
        // Of two that wait the primary answers, so that it gets the lease.
        if self.post == Post::Passive || (self.post == Post::Waits && !self.primary) {
            return;
        }
        let bytes = packet.contents.as_bytes();
        let Some(&[low, high, epoch, whose]) = bytes.first_chunk() else { return };
        let guessed = bytes.get(ECHO_BYTES).is_some_and(|&guessed| guessed != 0);
        if !self.enter_life(packet.id.incarnation, epoch, guessed) {
            return;
        }
        let back = u32::from(u16::from_le_bytes([low, high]));
        let echoed = packet.id.sequence.plus(Seq24::MODULUS - back);
        let renewed = match at.table.rules().lease {
            LeaseRule::Echoed => {
                // An earlier life may have answered the same beat: that was sooner.
                let own = back != 0 && whose == at.incarnation.0;
                let answered = self.answered.iter().flatten().find(|a| own && a.beat == echoed);
                answered.map(|answered| answered.until)
            }
            LeaseRule::Heartbeat => Some(at.now + couple.lease),
        };
        if let Some(until) = renewed.filter(|&until| until > at.now) {
            match self.post {
                Post::Leased(held) => self.post = Post::Leased(held.max(until)),
                // Not before the task knows that it was fenced: it may still be about to act.
                Post::Waits if self.call.is_some() => {}
                // All answers that can be echoed say this epoch, so each of them renews the lease, too.
                Post::Waits => {
                    self.stand(Post::Leased(until));
                    // A plain heartbeat is no echo.
                    self.propose();
                    (self.proposed, self.guessed) = (false, false);
                }
                Post::Alone => self.post = Post::Leased(until),
                Post::Passive => {}
            }
        }
        self.answer(at, couple, port, packet, out);
    }

    fn answer(
        &mut self,
        at: &Beating<'_>,
        couple: &CoupleDecl,
        port: &Port,
        beat: &Packet,
        out: &mut impl Outbox,
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
        (bytes[1], bytes[2], bytes[3]) = (self.epoch, at.incarnation.0, u8::from(self.guessed));
        let published = self.published.as_bytes();
        let len = published.len().min(PUBLISHED_BYTES);
        bytes[ECHO_BYTES..ECHO_BYTES + len].copy_from_slice(&published[..len]);
        let contents = Contents::new(&bytes[..ECHO_BYTES + len]).unwrap_or_default();
        let to = ReplyTo { port: port.id, source: beat.source, id: beat.id };
        let life = port.party(at.task).map_or(Ticks::ZERO, |party| party.time_out);
        if self.newest.is_none_or(|newest| beat.id.sequence.is_newer_than(newest)) {
            self.newest = Some(beat.id.sequence);
            self.answered.rotate_right(1);
            self.answered[0] = Some(Answered { beat: beat.id.sequence, until: at.now + couple.lease });
        }
        out.transmit(mapping::answer(to, at.task, Kind::Response, life, contents));
    }

    fn hear_answer(&mut self, at: &Beating<'_>, couple: &CoupleDecl, packet: &Packet) {
        if self.post != Post::Waits || packet.id.incarnation != at.incarnation {
            return;
        }
        let bytes = packet.contents.as_bytes();
        let Some(&[mode, epoch, life, guessed]) = bytes.first_chunk() else { return };
        let life = Incarnation(life);
        if self.life.is_some_and(|known| is_older(life, known)) {
            return;
        }
        if self.life.replace(life) != Some(life) {
            (self.answered, self.newest, self.echo) = ([None; ANSWERS], None, None);
        }
        self.hear_of(epoch, guessed != 0);
        // One that is of no use any more counts as none, whether a beat has dropped it since or not.
        self.echo = self.echo.filter(|echo| echo.until > at.now);
        let newest = self.echo.is_none_or(|echo| packet.id.sequence.is_newer_than(echo.beat));
        if newest {
            // The lease counts from when the answer was sent, so whatever the clocks do an echo is of no use after that.
            self.echo = Some(Answered { beat: packet.id.sequence, until: at.now + couple.takeover });
            self.said = Contents::new(bytes.get(ECHO_BYTES..).unwrap_or(&[])).unwrap_or_default();
        }
        // An older answer was sent earlier than the newest one, so it may only put the take-over off.
        let may = !couple.mutual || mode == LEASED || self.takeover_at != Ticks::FAR;
        self.takeover_at = if mode == ALONE && newest {
            Ticks::FAR
        } else if may {
            at.now + couple.takeover
        } else {
            self.takeover_at
        };
    }

    /// Whether a beat comes from the partner's present life. A new life has got none of the answers, and an earlier one, of
    /// either side, may have acted in an epoch that nobody knows of any more: of each side one is left out. One that guesses may
    /// have had an earlier life that guessed, too, and acted: that was two above its guess.
    fn enter_life(&mut self, life: Incarnation, epoch: u8, guessed: bool) -> bool {
        if self.life.is_some_and(|known| is_older(life, known)) {
            return false;
        }
        self.hear_of(epoch, guessed);
        if self.life != Some(life) {
            (self.life, self.answered, self.newest) = (Some(life), [None; ANSWERS], None);
            if !self.acts() {
                self.epoch = self.epoch.wrapping_add(if guessed { 4 } else { 2 });
                self.disown();
            }
        }
        true
    }

    /// The partner says an epoch. If exactly one side guesses, both use the epoch of the side that knows. What this side proposed from a
    /// guess is over then, though it may be the same number.
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

    /// Drops what can never matter again.
    pub fn bury(&mut self, now: Ticks) {
        for answered in &mut self.answered {
            *answered = answered.filter(|a| a.until > now && self.post != Post::Passive);
        }
        self.answered.sort_by_key(Option::is_none);
        if self.post == Post::Passive {
            self.newest = None;
        }
        self.echo = self.echo.filter(|echo| echo.until > now);
    }
}

/// Wrap-safe order of epochs.
pub(crate) const fn is_newer_epoch(epoch: u8, than: u8) -> bool {
    let steps = epoch.wrapping_sub(than);
    steps != 0 && steps < 128
}

/// What a receiver of commands that are given under a lease remembers of the couple, whichever of its ports they come
/// through: the newest epoch, for as long as commands of an older one may still arrive (D61).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Guard {
    /// The couple's position in the cell.
    pub couple: u8,
    pub epoch: u8,
    pub until: Ticks,
}

impl Guard {
    pub const fn new(couple: u8) -> Self {
        Self { couple, epoch: 0, until: Ticks::ZERO }
    }

    /// Whether a command of this epoch is taken. Whoever acted in an older epoch was fenced before the newer one began,
    /// so what it sent is over by `until`.
    pub fn admit(&mut self, epoch: u8, now: Ticks, until: Ticks) -> bool {
        if self.until > now && is_newer_epoch(self.epoch, epoch) {
            return false;
        }
        (self.epoch, self.until) = (epoch, until.max(self.until));
        true
    }
}

/// Whether `port` carries the beats of a couple, and which.
pub(crate) fn couple_of(table: &NodeTable, port: PortId, task: TaskId) -> Option<(u8, &CoupleDecl)> {
    let couples = table.cell().couples.iter().enumerate();
    let mine = |c: &CoupleDecl| c.via == port && (c.primary == task || c.standby == task);
    couples.filter(|(_, c)| mine(c)).find_map(|(i, c)| Some((u8::try_from(i).ok()?, c)))
}

impl CommTask {
    /// Whether this task may act now: it holds the lease of its couple, or took over (D61). A task in no couple always may.
    #[must_use]
    pub fn is_active(&self) -> bool {
        self.lease.as_ref().is_none_or(Lease::acts)
    }

    /// For how long the task acts yet, from the last time that it was told, unless its lease is renewed. `None`: it does
    /// not act, or acts without a lease.
    ///
    /// A driver that was stopped asks whether the lease is over that it has not looked at since.
    #[must_use]
    pub fn lease_left(&self) -> Option<Ticks> {
        match self.lease.as_ref()?.post {
            Post::Leased(until) => Some(until - self.now),
            Post::Waits | Post::Alone | Post::Passive => None,
        }
    }

    /// The epoch that this task acts under, or the newest it heard of; `None` where it is in no couple.
    #[must_use]
    pub fn epoch(&self) -> Option<u8> {
        self.lease.as_ref().map(|lease| lease.epoch)
    }

    /// What the partner published last (D61).
    #[must_use]
    pub fn partner_published(&self) -> Option<&Contents> {
        self.lease.as_ref().map(|lease| &lease.said)
    }

    /// Runs a step of the lease, and tells the task what came of it.
    pub(super) fn beat<O: Outbox>(
        &mut self,
        table: &NodeTable,
        out: &mut O,
        step: impl FnOnce(&mut Lease, &mut Beating<'_>, &mut O),
    ) {
        let Some(lease) = &mut self.lease else { return };
        let acted = lease.acts();
        let next = &mut self.next_sequence;
        let (task, incarnation, now) = (self.task, self.incarnation, self.now);
        step(lease, &mut Beating { table, task, incarnation, now, next }, out);
        let (acts, epoch, call) = (lease.acts(), lease.epoch, lease.call);
        if acts == acted {
            return;
        }
        let event = match (acts, call) {
            (true, Some(Call::TakeOver(_))) => Event::TookOver,
            (true, _) => Event::Granted,
            (false, _) => Event::Fenced,
        };
        let port = table.cell().couples.get(usize::from(lease.couple)).map_or(PortId::NONE, |c| c.via);
        let (peer, number, remaining) = (lease.partner, u32::from(epoch), Ticks::ZERO);
        out.observe(Observation { event, port, peer, number, remaining });
        if acts && self.running().iter().any(|level| level.pending == Pending::Lease) {
            if let Some(lease) = &mut self.lease {
                lease.call = None;
            }
            self.conclude(Pending::Lease, Finished::Granted(epoch), out);
        }
    }

    /// What the lease has for the task that it was not told yet.
    pub(super) fn called(&self) -> Option<Call> {
        self.lease.as_ref().and_then(|lease| lease.call)
    }

    pub(super) fn take_call(&mut self) -> Option<Call> {
        self.lease.as_mut().and_then(|lease| lease.call.take())
    }

    pub(super) fn await_lease(&mut self) -> Result<Option<Signal>, Fault> {
        let waits = self.running().iter().any(|level| level.pending == Pending::Lease);
        let Some(lease) = &mut self.lease else { return Err(Fault::WrongUsage) };
        if waits {
            return Err(Fault::Busy);
        }
        if lease.post == Post::Passive {
            return Err(Fault::Fenced);
        }
        if lease.acts() {
            lease.call = None;
            return Ok(Some(Signal::Granted(lease.epoch)));
        }
        self.top_mut().pending = Pending::Lease;
        Ok(None)
    }

    pub(super) fn publish(&mut self, contents: Contents) -> Result<Signal, Fault> {
        let Some(lease) = &mut self.lease else { return Err(Fault::WrongUsage) };
        if contents.as_bytes().len() > PUBLISHED_BYTES {
            return Err(Fault::WrongLength);
        }
        lease.published = contents;
        Ok(Signal::Accepted(0))
    }

    /// What a message says on the wire: through a port that acts under a lease, with the epoch behind it.
    pub(super) fn under_lease(&self, port: &Port, contents: Contents) -> Result<Contents, Fault> {
        let Some(guard) = port.decl.guard else { return Ok(contents) };
        let lease = self.lease.as_ref().filter(|lease| lease.couple == guard && lease.acts());
        let epoch = lease.ok_or(Fault::Fenced)?.epoch;
        let (mut bytes, len) = ([0; crate::packet::CONTENTS_BYTES], contents.as_bytes().len());
        *bytes.get_mut(len).ok_or(Fault::WrongLength)? = epoch;
        bytes[..len].copy_from_slice(contents.as_bytes());
        Contents::new(&bytes[..=len]).ok_or(Fault::WrongLength)
    }

    /// What a message says under the lease of a couple, without its epoch; `None` where a newer one was heard of. With a newer one goes what still waits of
    /// older ones.
    pub(super) fn within_epoch(
        &mut self,
        table: &NodeTable,
        port: &Port,
        (couple, inbox, source): (u8, usize, usize),
        packet: &Packet,
        out: &mut impl Outbox,
    ) -> Option<Contents> {
        let now = self.now;
        let guard = self.guards.iter_mut().find(|guard| guard.couple == couple)?;
        let declared = port.party(packet.source).map_or(Ticks::ZERO, |party| party.time_out);
        let until = now + declared + table.bound_between(packet.source, self.task);
        let said = packet.contents.as_bytes().split_last();
        let newer = said.is_some_and(|(&e, _)| guard.until > now && is_newer_epoch(e, guard.epoch));
        let heeds = table.rules().heed_epochs;
        let contents = said.filter(|&(&epoch, _)| guard.admit(epoch, now, until) || !heeds);
        let Some((_, bytes)) = contents else {
            self.inboxes[inbox].close(source, packet.id);
            let reason = if said.is_some() { Reason::StaleEpoch } else { Reason::NotAllowed };
            self.drop_packet(packet, reason, out);
            return None;
        };
        if newer && heeds {
            self.drop_orders(table, couple, out);
        }
        Some(Contents::new(bytes).unwrap_or_default())
    }

    /// Drops what still waits of an epoch that has passed, on every port of the couple.
    fn drop_orders(&mut self, table: &NodeTable, couple: u8, out: &mut impl Outbox) {
        for inbox in 0..self.inboxes.len() {
            let port = self.inboxes[inbox].port;
            if table.port(port).is_none_or(|port| port.decl.guard != Some(couple)) {
                continue;
            }
            while let Some(old) = self.inboxes[inbox].queue.pop_if(|_: &Held| true) {
                self.discard(port, &old, Reason::StaleEpoch, out);
            }
            self.touch(inbox);
        }
    }
}
