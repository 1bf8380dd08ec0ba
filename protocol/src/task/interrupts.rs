//! Interruption: the task's own thread, the handlers that interrupt it and each other, and its timers (R15, R16, D15). An
//! *activation* is the thread or one handler; the type is [`Activation`].
//!
//! | call | effect |
//! |---|---|
//! | [`wait`](Interrupts::wait), [`end_wait`](Interrupts::end_wait) | the running activation begins to wait, or stops waiting |
//! | [`conclude`](Interrupts::conclude) | a wait ended: signal it now, or keep the end until the handlers above have ended |
//! | [`is_interruptible`](Interrupts::is_interruptible) | whether a handler may begin now |
//! | [`outranks`](Interrupts::outranks) | whether something of a given rank may interrupt the running activation |
//! | [`begin`](Interrupts::begin), [`resume`](Interrupts::resume) | a handler interrupts the running activation; a handler ends |
//! | [`delay`](Interrupts::delay), [`start`](Interrupts::start), [`stop`](Interrupts::stop) | arm or disarm the node's Timer |
//! | [`time_is_over`](Interrupts::time_is_over) | the node's Timer reports an end |
//!
//! Between two inputs at most [`DEPTH`] handlers run, and none ranks lower than the activation that it interrupted. Each
//! interrupted activation waits, or the end of its wait is kept. Delays and timers of a task have different names.

mod check;
mod offer;
mod timers;
#[cfg(feature = "checker")]
mod walk;

pub(crate) use offer::{Offer, Turn, What, cap};

use super::own::Own;
use super::wait::{Finished, Pending};
use crate::ids::{PortId, TaskId};
use crate::request::{Fault, ServiceOrder};
use crate::table::NodeTable;
use crate::ticks::Instant;
use alloc::boxed::Box;
use serde::{Deserialize, Serialize};
use timers::Timers;

/// How many handlers can run at the same time, each of which has interrupted the one before.
pub(crate) const DEPTH: usize = ServiceOrder::LEVELS + 2;

/// How many timers of one task can run at the same time.
pub(crate) const TIMERS: usize = 8;

/// An activation: the task's own thread, or a handler.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Activation {
    /// The rank that a message must outrank to interrupt this handler. For the task's own thread, the `order` gives this
    /// rank instead.
    rank: u8,
    atomic: bool,
    pub pending: Pending,
    /// How the activation's wait ended, kept because a handler ran above it.
    pub finished: Option<Finished>,
}

impl Activation {
    const NEW: Self = Self { rank: 0, atomic: false, pending: Pending::Nothing, finished: None };
}

/// The activations and timers of a task.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Interrupts {
    /// The running activation: the task's own thread, or the handler that interrupted last.
    running: Activation,
    /// A stack of the interrupted activations, `depth` deep: the task's own thread, then handlers.
    interrupted: Box<[Activation]>,
    depth: u8,
    /// Whether the last handler began for a capped message: one that was rejected as often as possible (D76).
    capped_last: bool,
    /// The number that the next start of a delay or timer gets. The Timer's report carries it, so that a report of an
    /// earlier start is recognised.
    next_turn: u8,
    timers: Timers,
}

impl Default for Interrupts {
    fn default() -> Self {
        Self {
            running: Activation::NEW,
            interrupted: Box::new([Activation::NEW; DEPTH]),
            depth: 0,
            capped_last: false,
            next_turn: 0,
            timers: Timers::default(),
        }
    }
}

impl Interrupts {
    /// The wait of the running activation.
    pub const fn pending(&self) -> Pending {
        self.running.pending
    }

    /// Whether the running activation does not wait.
    pub const fn waits_for_nothing(&self) -> bool {
        matches!(self.running.pending, Pending::Nothing)
    }

    /// Notes that the running activation waits from now on.
    pub const fn wait(&mut self, pending: Pending) {
        self.running.pending = pending;
    }

    /// Ends the wait of the running activation, and returns it.
    pub const fn end_wait(&mut self) -> Pending {
        core::mem::replace(&mut self.running.pending, Pending::Nothing)
    }

    /// All activations, from the task's own thread up to the running one.
    pub fn threads(&self) -> impl Iterator<Item = &Activation> {
        self.interrupted.iter().take(usize::from(self.depth)).chain([&self.running])
    }

    /// Whether an activation has this wait.
    pub fn waits(&self, wait: Pending) -> bool {
        self.threads().any(|activation| activation.pending == wait)
    }

    /// The positions of the requests for whose answers activations wait.
    pub fn open_requests(&self) -> impl Iterator<Item = u16> {
        self.threads().filter_map(|activation| {
            if let Pending::Reply(request) = activation.pending { Some(request) } else { None }
        })
    }

    /// The number of running handlers: each has interrupted the one before, or the task's own thread.
    pub const fn depth(&self) -> u8 {
        self.depth
    }

    /// Begins or ends an atomic section of the running activation, in which only the lease interrupts.
    pub const fn set_atomic(&mut self, atomic: bool) {
        self.running.atomic = atomic;
    }

    /// Ends a wait. Returns true if the running activation had this wait: then the caller must signal the end now.
    /// Otherwise the end is kept until the waiting activation [resumes](Self::resume).
    pub fn conclude(&mut self, wait: Pending, finished: &Finished) -> bool {
        if self.running.pending == wait {
            self.running.pending = Pending::Nothing;
            return true;
        }
        let mut below = self.interrupted.iter_mut().take(usize::from(self.depth));
        if let Some(activation) = below.find(|activation| activation.pending == wait) {
            (activation.pending, activation.finished) = (Pending::Nothing, Some(*finished));
        }
        false
    }

    /// Notes that the action of the running activation has ended.
    pub fn done(&mut self) -> Result<(), Fault> {
        if self.running.pending == Pending::Work {
            self.end_wait();
            return Ok(());
        }
        Err(if self.waits(Pending::Work) { Fault::Busy } else { Fault::WrongUsage })
    }

    /// Whether a handler may interrupt the running activation, because it waits or is between two statements. `called` says
    /// that the lease has a pending call.
    pub fn is_interruptible(&self, at_boundary: bool, called: bool) -> bool {
        let running = &self.running;
        let room = usize::from(self.depth) < DEPTH;
        // A task that lost its lease must stop acting, even in an atomic section (D61).
        let open = !running.atomic || called;
        room && open && (at_boundary || running.pending != Pending::Nothing)
    }

    /// Whether the task's own thread waits in a GET and no handler runs. A handler that begins then interrupts nothing.
    fn is_idle_get(&self) -> bool {
        self.depth == 0 && matches!(self.running.pending, Pending::Get { .. })
    }

    /// The rank that a message must outrank to interrupt the running activation.
    fn rank_of_running(&self, own: &Own) -> u8 {
        if self.depth == 0 { own.order.own() } else { self.running.rank }
    }

    /// Whether something of this rank may interrupt the running activation. `capped` says that the message was rejected as
    /// often as possible.
    pub fn outranks(&self, table: &NodeTable, own: &Own, rank: u8, capped: bool) -> bool {
        !table.rules().obey_order
            || self.is_idle_get()
            || rank < self.rank_of_running(own)
            || (capped && self.depth == 0)
    }

    /// Whether the running activation waits in a GET for a message of this port and source.
    #[inline]
    pub fn gets(&self, id: PortId, from: TaskId, handled: bool) -> bool {
        matches!(self.running.pending, Pending::Get { port, source, .. }
            if port.map_or(!handled, |port| port == id) && source.is_none_or(|source| source == from))
    }

    /// The instant up to which messages are due to be offered. If the task waits in a GET and no handler runs, all messages
    /// are due.
    pub fn due_by(&self, now: Instant) -> Instant {
        if self.is_idle_get() { Instant::NEVER } else { now }
    }

    /// The first part of the key by which a capped message is offered. Of capped messages, the one that was rejected first goes
    /// first.
    pub fn capped_turn(&self, rejected_first: u64) -> Turn {
        if self.capped_last { Turn::CappedAgain(rejected_first) } else { Turn::Capped(rejected_first) }
    }

    /// Notes whether the offer that was taken was a capped message: after one, messages that outrank by their own rank go first
    /// (D76).
    pub fn note_turn(&mut self, turn: Turn) {
        match turn {
            Turn::Capped(_) | Turn::CappedAgain(_) => self.capped_last = true,
            Turn::Bypassed(_) | Turn::InOrder => self.capped_last = false,
            Turn::Lease => {}
        }
    }

    /// Begins a handler of this rank. Handlers never rank lower than the activation that they interrupt (D15).
    pub fn begin(&mut self, own: &Own, rank: u8) {
        let rank = rank.min(self.rank_of_running(own));
        if self.running.pending == Pending::Nothing {
            self.wait(Pending::Boundary);
        }
        let interrupted = core::mem::replace(&mut self.running, Activation { rank, ..Activation::NEW });
        self.interrupted[usize::from(self.depth)] = interrupted;
        self.depth += 1;
    }

    /// Ends the running handler and resumes the activation below it. Returns how the wait of that activation ended, if the
    /// wait ended meanwhile (R16).
    pub fn resume(&mut self) -> Result<Option<Finished>, Fault> {
        if self.depth == 0 {
            return Err(Fault::NotInterrupted);
        }
        self.drop_running();
        Ok(self.running.finished.take())
    }

    /// Drops the running handler and returns to the activation below. Without a handler, resets the task's own thread.
    /// Returns whether there was a handler.
    pub fn drop_running(&mut self) -> bool {
        self.running = Activation::NEW;
        let handler = self.depth > 0;
        if handler {
            self.depth -= 1;
            core::mem::swap(&mut self.running, &mut self.interrupted[usize::from(self.depth)]);
        }
        handler
    }

    /// Validates deserialised activations: the stack has its capacity, and everything for which an activation waits exists.
    pub fn is_whole(&self, is: impl Fn(Pending) -> bool) -> bool {
        let named = |activation: &Activation| {
            let ended = match activation.finished {
                Some(Finished::Answers(request) | Finished::Long(request)) => is(Pending::Reply(request)),
                _ => true,
            };
            is(activation.pending) && ended
        };
        let whole = self.interrupted.len() == DEPTH && usize::from(self.depth) <= DEPTH;
        whole && self.timers.is_whole() && self.interrupted.iter().chain([&self.running]).all(named)
    }
}

#[cfg(test)]
mod tests;
