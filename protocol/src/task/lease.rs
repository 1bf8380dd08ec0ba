//! The lease of a couple: one of two work-coupled tasks acts, and when it fails the other task takes over (§2; D30, D61).
//!
//! A time_out cannot tell a dead partner from a slow one, so the task that acts holds a *lease*. The partner sends
//! *heartbeats* to this task, which answers each one. A heartbeat echoes the newest answer that its sender received. Only
//! such an echo renews the lease, and the lease counts from the *sending* of the echoed answer. The partner received that
//! answer no earlier, and from then on waits longer than the lease before it takes over. So the two never act at the same
//! time, however slow the network, as long as the take-over exceeds the lease by the clock drift and a tick.
//!
//! Each period of acting has its own *epoch*, and actuators drop commands of an older epoch. The primary's epochs are odd
//! and the standby's even, so each task can count up alone. Before the primary acts, its answers propose the epoch, and
//! only an echo of such an answer lets it act. So a standby that takes over has heard of every epoch that the primary began
//! (D80). A restarted task has forgotten the epochs, and its first epoch could seem newer than all others. So it marks its
//! epoch as a guess until it hears of another epoch, and its partner never treats a guess as newer (D135).
//!
//! With `<->` a take-over exchanges the roles. The task that took over acts alone until its partner is back. A partner that
//! comes back may take over only after an answer says that the acting task again depends on its heartbeats.
//!
//! | input | effect |
//! |---|---|
//! | [`advance`](Lease::advance) | the lease ends, the task takes over, or a heartbeat is sent |
//! | [`hear`](Lease::hear) | a heartbeat is answered, and its echo may renew the lease; an answer postpones the take-over |
//! | [`publish`](Lease::publish) | sets what the answers carry from here on |
//! | [`retire`](Lease::retire) | the task stops acting for good, so that its partner takes over |
//!
//! `advance` and `hear` return the epoch if the task begins to act. Between two inputs no task acts past its lease, and a
//! pending call ([`called`](Lease::called)) still describes the present state.

mod check;
mod heartbeats;
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

/// How many recent answers a task remembers, because an echo of each of them may still come.
const ANSWERS: usize = 4;

/// The present role of the task, which is the primary or the standby of a couple.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
enum Post {
    /// The task does not act. It waits for the lease or for the take-over.
    Waits,
    /// The task acts until this instant, unless the lease is renewed.
    Leased(Instant),
    /// The task acts after a take-over, and its partner cannot take over from it.
    Alone,
    /// The task never acts again in this incarnation.
    Passive,
}

/// A heartbeat that was answered. The task that sent the answer notes until when an echo of it renews the lease. The
/// partner notes until when echoing the answer is useful.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
struct Answered {
    heartbeat: Seq24,
    until: Instant,
}

/// The lease state of one task of a couple: of the primary or of the standby.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Lease {
    /// The position of the couple in the cell.
    couple: u8,
    primary: bool,
    partner: TaskId,
    post: Post,
    /// The epoch under which the task acts or would act, or the newest epoch of which it has heard.
    epoch: u8,
    /// Whether `epoch` is a proposal: the task's answers announce it, and no task has acted in it.
    proposed: bool,
    /// Whether `epoch` is a guess: since its restart, the task has neither heard of an epoch nor acted.
    guessed: bool,
    /// The partner's incarnation that received the answers in `answered`, and that sent the answer in `echo`.
    incarnation: Option<Incarnation>,
    /// The partner's heartbeats that this task answered last, newest first.
    answered: [Option<Answered>; ANSWERS],
    /// The newest of the partner's heartbeats that this task answered. An older heartbeat or a copy is answered, too, but
    /// not recorded, because the lease never counts from the answer to a copy.
    newest: Option<Seq24>,
    /// The newest heartbeat of this task that its partner answered. The next heartbeat echoes that answer, as long as the
    /// echo may renew the lease.
    echo: Option<Answered>,
    /// When this task sends its next heartbeat.
    heartbeat_at: Instant,
    /// When this task takes over if no answer comes before that.
    takeover_at: Instant,
    /// The data that this task's answers carry, and the data that the partner's last answer carried.
    published: Contents,
    said: Contents,
    /// The pending call: a fence or a take-over that the task has not been signalled yet.
    call: Option<Call>,
}

/// The codes for the sender's role in the answer to a heartbeat.
const WAITS: u8 = 0;
const LEASED: u8 = 1;
const ALONE: u8 = 2;
/// The length of a heartbeat before its guess flag, and of an answer before the published data.
const ECHO_BYTES: usize = 4;

impl Lease {
    /// The lease state at the start of an incarnation; `None` if the task is neither a primary nor a standby.
    pub fn new(table: &NodeTable, own: &Own) -> Option<Self> {
        let heartbeats = own.endpoints.iter().rfind(|endpoint| endpoint.role == Role::Heartbeats)?;
        let (couple, decl) = couple_of(table, heartbeats.port, own.task)?;
        let (primary, restarted) = (decl.primary == own.task, own.restarted);
        // A restarted standby waits for the whole take-over: its earlier incarnation may just have renewed the lease.
        let armed = !primary && !decl.mutual;
        Some(Self {
            couple,
            primary,
            partner: if primary { decl.standby } else { decl.primary },
            post: Post::Waits,
            // An earlier incarnation of this task may have taken over without having heard of any epoch.
            epoch: if restarted { 2 } else { 0 },
            proposed: false,
            guessed: restarted,
            incarnation: None,
            answered: [None; ANSWERS],
            newest: None,
            echo: None,
            heartbeat_at: if primary && !decl.mutual { Instant::NEVER } else { Instant::START },
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

    /// The next instant at which time alone makes this task act.
    pub fn due(&self) -> Instant {
        match self.post {
            Post::Waits => self.heartbeat_at.min(self.takeover_at),
            Post::Leased(until) => until,
            Post::Alone | Post::Passive => Instant::NEVER,
        }
    }

    /// Stops acting, because the task ended or panicked, so that its partner takes over.
    pub fn retire(&mut self) {
        self.stop(Post::Passive);
        self.call = None;
    }

    /// The position of the task's couple in the cell.
    #[cfg(feature = "checker")]
    pub const fn couple(&self) -> u8 {
        self.couple
    }

    /// The epoch under which the task acts, or the newest epoch of which it has heard.
    pub const fn epoch(&self) -> u8 {
        self.epoch
    }

    /// The remaining time of the lease, if a lease runs.
    pub fn left(&self, now: Instant) -> Option<Ticks> {
        match self.post {
            Post::Leased(until) => Some(until - now),
            Post::Waits | Post::Alone | Post::Passive => None,
        }
    }

    /// The data that the partner published last.
    pub const fn said(&self) -> &Contents {
        &self.said
    }

    /// Whether the task has yet to be signalled that it lost its lease (a fence), or that it takes over.
    pub const fn called(&self) -> bool {
        self.call.is_some()
    }

    /// Takes the pending call, so that the task can be signalled.
    pub const fn take_call(&mut self) -> Option<Call> {
        self.call.take()
    }

    /// Begins to wait for the lease. Returns the epoch if the task may act already.
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

    /// Sets the data that the task's answers carry from now on.
    pub fn publish(&mut self, contents: Contents) -> Result<(), Fault> {
        if contents.as_bytes().len() > PUBLISHED_BYTES {
            return Err(Fault::WrongLength);
        }
        self.published = contents;
        Ok(())
    }

    /// The contents of a message on a port that acts under the lease of `couple`, with the epoch appended.
    pub fn with_epoch(&self, couple: u8, contents: Contents) -> Result<Contents, Fault> {
        if self.couple != couple || !self.acts() {
            return Err(Fault::Fenced);
        }
        let (mut bytes, len) = ([0; CONTENTS_BYTES], contents.as_bytes().len());
        *bytes.get_mut(len).ok_or(Fault::WrongLength)? = self.epoch;
        bytes[..len].copy_from_slice(contents.as_bytes());
        Contents::new(&bytes[..=len]).ok_or(Fault::WrongLength)
    }

    /// Does the work that is due: ends the lease, takes over, or sends a heartbeat. Returns the epoch if the task begins to
    /// act.
    pub fn advance(&mut self, step: &mut Step<'_, impl Outbox>) -> Option<u8> {
        self.noting(step, Self::pass)
    }

    /// Takes a heartbeat of the partner, or the partner's answer to a heartbeat. Returns the epoch if the task begins to
    /// act.
    pub fn hear(&mut self, step: &mut Step<'_, impl Outbox>, port: &Port, packet: &Packet) -> Option<u8> {
        self.noting(step, |lease, step| lease.heartbeat_came(step, port, packet))
    }

    /// Runs a step, and emits an observation if the task begins or stops to act in it.
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
                self.heartbeat_at = if couple.mutual { step.now() } else { Instant::NEVER };
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
        if self.post == Post::Waits && self.heartbeat_at <= step.now() {
            self.heartbeat(step, couple);
        }
    }

    fn heartbeat_came(&mut self, step: &mut Step<'_, impl Outbox>, port: &Port, packet: &Packet) {
        let Some(couple) = self.decl(step.table) else { return };
        match packet.kind {
            Kind::Query => self.hear_heartbeat(step, couple, port, packet),
            Kind::Response => self.hear_answer(step, couple, packet),
            Kind::Send | Kind::Reply | Kind::Arrive | Kind::Confirm | Kind::Abort | Kind::Control => {}
        }
    }

    /// Ends the present role. The recorded answers become void, because their epoch is over.
    fn stop(&mut self, post: Post) {
        self.stand(post);
        self.disown();
    }

    fn stand(&mut self, post: Post) {
        self.post = post;
        self.takeover_at = Instant::NEVER;
        self.heartbeat_at = Instant::NEVER;
        self.echo = None;
    }

    /// Voids the recorded answers, so that no echo of them lets the task act.
    fn disown(&mut self) {
        self.proposed = false;
        self.answered = [None; ANSWERS];
    }

    /// Proposes the epoch in which the task would act, if it has not proposed one yet.
    fn propose(&mut self) {
        if !self.proposed {
            self.disown();
            (self.epoch, self.proposed) = (self.next_epoch(), true);
        }
    }

    /// The next epoch of this side: the primary's epochs are odd, the standby's are even.
    const fn next_epoch(&self) -> u8 {
        let own = self.epoch % 2 == self.primary as u8;
        self.epoch.wrapping_add(if own { 2 } else { 1 })
    }

    /// Validates a deserialised lease: it belongs to the same couple and side as a new lease.
    pub fn is_like(&self, new: &Self) -> bool {
        (self.couple, self.primary, self.partner) == (new.couple, new.primary, new.partner)
    }
}

/// Whether `epoch` is newer than `than`, in wrap-safe order.
pub(crate) const fn is_newer_epoch(epoch: u8, than: u8) -> bool {
    let steps = epoch.wrapping_sub(than);
    steps != 0 && steps < 128
}

#[cfg(test)]
mod tests;
