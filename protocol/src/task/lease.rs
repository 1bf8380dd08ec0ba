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
//!
//! | input | what comes of it |
//! |---|---|
//! | [`advance`](Lease::advance) | the lease ends, the task takes over, a beat is sent |
//! | [`hear`](Lease::hear) | a beat of the partner is answered, and its echo may renew the lease; an answer puts the take-over off |
//! | [`publish`](Lease::publish) | what the answers carry from here on |
//! | [`retire`](Lease::retire) | the task does not act any more: its partner shall take over |
//!
//! The first two give the epoch where the task begins to act. Between two inputs nobody acts past its lease, and what the
//! task was not told yet ([`called`](Lease::called)) is so.

mod beats;
mod check;
#[cfg(feature = "checker")]
mod walk;

use super::own::{Own, Role, couple_of};
use super::step::{Outbox, Step};
use crate::cell::CoupleDecl;
use crate::ids::{Incarnation, PortId, Seq24, TaskId};
use crate::observe::{Event, Observation};
use crate::packet::{CONTENTS_BYTES, Contents, Kind, Packet};
use crate::request::{Call, Fault, PUBLISHED_BYTES};
use crate::table::{NodeTable, Port};
use crate::ticks::{Instant, Ticks};
use serde::{Deserialize, Serialize};

/// How many answers whose echo may still come are remembered.
const ANSWERS: usize = 4;

/// What one of the two tasks is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
enum Post {
    /// It does not act: it waits to be given the lease, or to take over.
    Waits,
    /// It acts until this instant, unless the lease is renewed.
    Leased(Instant),
    /// It acts after a take-over, and nobody can take over from it.
    Alone,
    /// It does not act any more in this life.
    Passive,
}

/// A beat that was answered. To the one who answered: until when its echo renews the lease. To the other: until when
/// echoing it may be of use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
struct Answered {
    beat: Seq24,
    until: Instant,
}

/// One task's side of a couple.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Lease {
    /// The couple's position in the cell.
    couple: u8,
    primary: bool,
    partner: TaskId,
    post: Post,
    /// The epoch it acts under, or the newest that it heard of, or that it would act under.
    epoch: u8,
    /// Whether `epoch` is one that the task would act under: its answers say so, and nobody has acted in it.
    proposed: bool,
    /// Whether it has started again and since then neither heard of an epoch nor acted: then `epoch` is a guess.
    guessed: bool,
    /// The partner's life: the answers below went to it, and the echo is of one of its answers.
    life: Option<Incarnation>,
    /// The last beats that were answered, newest first.
    answered: [Option<Answered>; ANSWERS],
    /// The newest of all that were answered: a copy of an older one counts for nothing, so no answer counts from a copy's.
    newest: Option<Seq24>,
    /// The newest own beat that was answered: the next one echoes it, while that can renew anything.
    echo: Option<Answered>,
    /// When the next beat is sent.
    beat_at: Instant,
    /// When this task takes over if no answer comes.
    takeover_at: Instant,
    /// What the answers carry, and what the partner's carried last.
    published: Contents,
    said: Contents,
    /// What the task has not been told yet.
    call: Option<Call>,
}

/// How a beat's answer says what its sender does.
const WAITS: u8 = 0;
const LEASED: u8 = 1;
const ALONE: u8 = 2;
/// The bytes of a beat before whether it guesses, and those of an answer before what was published.
const ECHO_BYTES: usize = 4;

impl Lease {
    /// The task's side of its couple at the start of its node's life, the first one or a later one; none where it is in none.
    pub fn new(table: &NodeTable, own: &Own) -> Option<Self> {
        let beats = own.endpoints.iter().rfind(|endpoint| endpoint.role == Role::Beats)?;
        let (couple, decl) = couple_of(table, beats.port, own.task)?;
        let (primary, restarted) = (decl.primary == own.task, own.restarted);
        // A restarted standby waits for the whole take-over: its earlier life may have renewed the lease just before.
        let armed = !primary && !decl.mutual;
        Some(Self {
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
            beat_at: if primary && !decl.mutual { Instant::NEVER } else { Instant::START },
            takeover_at: if armed { Instant::START + decl.takeover } else { Instant::NEVER },
            published: Contents::EMPTY,
            said: Contents::EMPTY,
            call: None,
        })
    }

    /// Whether the task may act now.
    pub const fn acts(&self) -> bool {
        matches!(self.post, Post::Leased(_) | Post::Alone)
    }

    /// The earliest instant at which time alone makes this task act.
    pub fn due(&self) -> Instant {
        match self.post {
            Post::Waits => self.beat_at.min(self.takeover_at),
            Post::Leased(until) => until,
            Post::Alone | Post::Passive => Instant::NEVER,
        }
    }

    /// The task ended or panicked: its partner shall take over.
    pub fn retire(&mut self) {
        self.stop(Post::Passive);
        self.call = None;
    }

    /// The couple that it is a side of.
    #[cfg(feature = "checker")]
    pub const fn couple(&self) -> u8 {
        self.couple
    }

    /// The epoch that the task acts under, or the newest it heard of.
    pub const fn epoch(&self) -> u8 {
        self.epoch
    }

    /// How long the task may act without hearing from its partner, where that ends by itself.
    pub fn left(&self, now: Instant) -> Option<Ticks> {
        match self.post {
            Post::Leased(until) => Some(until - now),
            Post::Waits | Post::Alone | Post::Passive => None,
        }
    }

    /// What the partner published last.
    pub const fn said(&self) -> &Contents {
        &self.said
    }

    /// Whether there is something that the task was not told yet.
    pub const fn called(&self) -> bool {
        self.call.is_some()
    }

    /// What the task was not told yet: it is told now.
    pub const fn take_call(&mut self) -> Option<Call> {
        self.call.take()
    }

    /// The task waits for the lease: the epoch, where it has it.
    pub fn await_it(&mut self) -> Result<Option<u8>, Fault> {
        if self.post == Post::Passive {
            return Err(Fault::Fenced);
        }
        if !self.acts() {
            return Ok(None);
        }
        self.call = None;
        Ok(Some(self.epoch))
    }

    /// What the answers carry from here on.
    pub fn publish(&mut self, contents: Contents) -> Result<(), Fault> {
        if contents.as_bytes().len() > PUBLISHED_BYTES {
            return Err(Fault::WrongLength);
        }
        self.published = contents;
        Ok(())
    }

    /// What a message says on the wire through a port that acts under the lease of `couple`: with the epoch behind it.
    pub fn with_epoch(&self, couple: u8, contents: Contents) -> Result<Contents, Fault> {
        if self.couple != couple || !self.acts() {
            return Err(Fault::Fenced);
        }
        let (mut bytes, len) = ([0; CONTENTS_BYTES], contents.as_bytes().len());
        *bytes.get_mut(len).ok_or(Fault::WrongLength)? = self.epoch;
        bytes[..len].copy_from_slice(contents.as_bytes());
        Contents::new(&bytes[..=len]).ok_or(Fault::WrongLength)
    }

    /// Time has passed: the lease ends, the task takes over, a beat is sent.
    pub fn advance(&mut self, step: &mut Step<'_, impl Outbox>) -> Option<u8> {
        self.noting(step, Self::pass)
    }

    /// A beat of the partner, or its answer to one.
    pub fn hear(&mut self, step: &mut Step<'_, impl Outbox>, port: &Port, packet: &Packet) -> Option<u8> {
        self.noting(step, |lease, step| lease.beat_came(step, port, packet))
    }

    /// Does something after which the task may act, or must stop, and notes that.
    fn noting<O: Outbox>(
        &mut self,
        step: &mut Step<'_, O>,
        act: impl FnOnce(&mut Self, &mut Step<'_, O>),
    ) -> Option<u8> {
        let acted = self.acts();
        act(self, step);
        if self.acts() == acted {
            return None;
        }
        let event = match (self.acts(), self.call) {
            (true, Some(Call::TakeOver(_))) => Event::TookOver,
            (true, _) => Event::Granted,
            (false, _) => Event::Fenced,
        };
        let port = self.decl(step.table).map_or(PortId::NONE, |couple| couple.via);
        let (peer, number, remaining) = (self.partner, u32::from(self.epoch), Ticks::ZERO);
        step.out.observe(Observation { event, port, peer, number, remaining });
        self.acts().then_some(self.epoch)
    }

    fn decl<'a>(&self, table: &'a NodeTable) -> Option<&'a CoupleDecl> {
        table.cell().couples.get(usize::from(self.couple))
    }

    fn pass(&mut self, step: &mut Step<'_, impl Outbox>) {
        let Some(couple) = self.decl(step.table) else { return };
        match self.post {
            Post::Leased(until) if until <= step.now() => {
                self.stop(if couple.mutual { Post::Waits } else { Post::Passive });
                self.beat_at = if couple.mutual { step.now() } else { Instant::NEVER };
                self.call = Some(Call::Fenced);
            }
            Post::Waits if self.takeover_at <= step.now() => {
                self.propose();
                self.stop(Post::Alone);
                self.guessed = false;
                self.call = Some(Call::TakeOver(self.epoch));
            }
            Post::Waits | Post::Leased(_) | Post::Alone | Post::Passive => {}
        }
        if self.post == Post::Waits && self.beat_at <= step.now() {
            self.beat(step, couple);
        }
    }

    fn beat_came(&mut self, step: &mut Step<'_, impl Outbox>, port: &Port, packet: &Packet) {
        let Some(couple) = self.decl(step.table) else { return };
        match packet.kind {
            Kind::Query => self.hear_beat(step, couple, port, packet),
            Kind::Response => self.hear_answer(step, couple, packet),
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
        self.takeover_at = Instant::NEVER;
        self.beat_at = Instant::NEVER;
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

    /// Whether a state that was read is of the same side as a new one.
    pub fn is_like(&self, new: &Self) -> bool {
        (self.couple, self.primary, self.partner) == (new.couple, new.primary, new.partner)
    }
}

/// Wrap-safe order of epochs.
pub(crate) const fn is_newer_epoch(epoch: u8, than: u8) -> bool {
    let steps = epoch.wrapping_sub(than);
    steps != 0 && steps < 128
}

#[cfg(test)]
mod tests;
