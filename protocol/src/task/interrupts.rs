//! Interruption (R15, R16, D15): the task's thread, the handlers that interrupted it and each other, and its timers.
//!
//! | call | what it does |
//! |---|---|
//! | [`wait`](Interrupts::wait), [`end_wait`](Interrupts::end_wait) | the running thread begins, or ends, to wait |
//! | [`conclude`](Interrupts::conclude) | a wait is over: if the thread that waits runs, it is to be told; if handlers run above it, the end is kept until they have ended |
//! | [`outranks`](Interrupts::outranks), [`is_interruptible`](Interrupts::is_interruptible) | whether something may interrupt the running thread, now |
//! | [`begin`](Interrupts::begin), [`resume`](Interrupts::resume) | a handler interrupts the running thread; it ends, and the thread goes on |
//! | [`delay`](Interrupts::delay), [`start`](Interrupts::start), [`stop`](Interrupts::stop), [`time_is_over`](Interrupts::time_is_over) | the task's delays and timers, which the node's Timer counts |
//!
//! Between two inputs at most [`DEPTH`] handlers run, none ranks lower than what it interrupted, and each thread below the
//! running one waits or has its end kept. No two delays and timers of a task have one name.

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

/// How many handlers run at a time, each having interrupted the one before.
pub(crate) const DEPTH: usize = ServiceOrder::LEVELS + 2;

/// How many timers of one task run at a time.
pub(crate) const TIMERS: usize = 8;

/// The task's thread, or a handler.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Level {
    /// What a message must outrank to interrupt it. Of the task's thread that is the rank of `self`.
    rank: u8,
    atomic: bool,
    pub pending: Pending,
    /// How its wait ended while a handler ran above it.
    pub finished: Option<Finished>,
}

impl Level {
    const NEW: Self = Self { rank: 0, atomic: false, pending: Pending::Nothing, finished: None };
}

/// The task's threads and timers.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Interrupts {
    /// The thread that runs: the task's own, or the handler that interrupted last.
    running: Level,
    /// What was interrupted, `depth` of them: the task's thread, then handlers.
    interrupted: Box<[Level]>,
    depth: u8,
    /// The handler that began last ran for a message at its cap (D76).
    capped_last: bool,
    /// Tells the starts of the task's delays and timers apart.
    next_turn: u8,
    timers: Timers,
}

impl Default for Interrupts {
    fn default() -> Self {
        Self {
            running: Level::NEW,
            interrupted: Box::new([Level::NEW; DEPTH]),
            depth: 0,
            capped_last: false,
            next_turn: 0,
            timers: Timers::default(),
        }
    }
}

impl Interrupts {
    /// What the running thread waits for.
    pub const fn pending(&self) -> Pending {
        self.running.pending
    }

    /// The running thread waits from here on.
    pub const fn wait(&mut self, pending: Pending) {
        self.running.pending = pending;
    }

    /// The running thread waits no more. Returns what it waited for.
    pub const fn end_wait(&mut self) -> Pending {
        core::mem::replace(&mut self.running.pending, Pending::Nothing)
    }

    /// The task's thread and the handlers that run, the interrupting after the interrupted.
    pub fn threads(&self) -> impl Iterator<Item = &Level> {
        self.interrupted.iter().take(usize::from(self.depth)).chain([&self.running])
    }

    /// Whether a thread waits so.
    pub fn waits(&self, wait: Pending) -> bool {
        self.threads().any(|level| level.pending == wait)
    }

    /// The desks at which a thread waits.
    pub fn open_desks(&self) -> impl Iterator<Item = u16> {
        self.threads()
            .filter_map(|level| if let Pending::Reply(desk) = level.pending { Some(desk) } else { None })
    }

    /// How many handlers run, each having interrupted the one before or the task's thread.
    pub const fn depth(&self) -> u8 {
        self.depth
    }

    /// Begins or ends an atomic section of the running thread: only the lease interrupts it there.
    pub const fn set_atomic(&mut self, atomic: bool) {
        self.running.atomic = atomic;
    }

    /// Ends the wait of the thread that waits so. True where it runs: it is to be told now, else when it
    /// [resumes](Self::resume).
    pub fn conclude(&mut self, wait: Pending, finished: &Finished) -> bool {
        if self.running.pending == wait {
            self.running.pending = Pending::Nothing;
            return true;
        }
        let mut below = self.interrupted.iter_mut().take(usize::from(self.depth));
        if let Some(level) = below.find(|level| level.pending == wait) {
            (level.pending, level.finished) = (Pending::Nothing, Some(*finished));
        }
        false
    }

    /// The action of the running thread has ended.
    pub fn done(&mut self) -> Result<(), Fault> {
        if self.running.pending == Pending::Work {
            self.end_wait();
            return Ok(());
        }
        Err(if self.waits(Pending::Work) { Fault::Busy } else { Fault::WrongUsage })
    }

    /// Whether a handler may interrupt the running thread: it waits, or stands between two statements. `called`: the lease
    /// has word for the task.
    pub fn is_interruptible(&self, at_boundary: bool, called: bool) -> bool {
        let running = &self.running;
        let room = usize::from(self.depth) < DEPTH;
        // D61: who lost its lease must stop acting, whatever section it is in.
        let open = !running.atomic || called;
        room && open && (at_boundary || running.pending != Pending::Nothing)
    }

    /// In a plain GET there is no thread to interrupt.
    fn is_idle_get(&self) -> bool {
        self.depth == 0 && matches!(self.running.pending, Pending::Get { .. })
    }

    /// What a message must outrank.
    fn rank_of_running(&self, own: &Own) -> u8 {
        if self.depth == 0 { own.order.own() } else { self.running.rank }
    }

    /// Whether what has this rank may interrupt the running thread. `capped`: it was rejected as often as it can be.
    pub fn outranks(&self, table: &NodeTable, own: &Own, rank: u8, capped: bool) -> bool {
        !table.rules().obey_order
            || self.is_idle_get()
            || rank < self.rank_of_running(own)
            || (capped && self.depth == 0)
    }

    /// Whether a message of this port and source is what the running thread waits for in a GET.
    pub fn gets(&self, id: PortId, from: TaskId, handled: bool) -> bool {
        matches!(self.running.pending, Pending::Get { port, source, .. }
            if port.map_or(!handled, |port| port == id) && source.is_none_or(|source| source == from))
    }

    /// Until when messages are due to be offered: in a plain GET all are.
    pub fn due_by(&self, now: Instant) -> Instant {
        if self.is_idle_get() { Instant::NEVER } else { now }
    }

    /// Whose turn it is that was rejected so often, and so early.
    pub fn capped_turn(&self, rejected_first: u64) -> Turn {
        if self.capped_last { Turn::CappedAgain(rejected_first) } else { Turn::Capped(rejected_first) }
    }

    /// It was the turn of what was offered first.
    pub fn note_turn(&mut self, turn: Turn) {
        match turn {
            Turn::Capped(_) | Turn::CappedAgain(_) => self.capped_last = true,
            Turn::Bypassed(_) | Turn::InOrder => self.capped_last = false,
            Turn::Lease => {}
        }
    }

    /// D15: a handler never ranks lower than what it interrupted.
    pub fn begin(&mut self, own: &Own, rank: u8) {
        let rank = rank.min(self.rank_of_running(own));
        if self.running.pending == Pending::Nothing {
            self.wait(Pending::Boundary);
        }
        let interrupted = core::mem::replace(&mut self.running, Level { rank, ..Level::NEW });
        self.interrupted[usize::from(self.depth)] = interrupted;
        self.depth += 1;
    }

    /// A handler ended (R16). The thread below goes on where it was. Returns how its wait ended meanwhile, if it did.
    pub fn resume(&mut self) -> Result<Option<Finished>, Fault> {
        if self.depth == 0 {
            return Err(Fault::NotInterrupted);
        }
        self.drop_running();
        Ok(self.running.finished.take())
    }

    /// Ends the running handler and goes back to what it interrupted; without a handler, the task's thread begins anew. Returns
    /// whether there was a handler.
    pub fn drop_running(&mut self) -> bool {
        self.running = Level::NEW;
        let handler = self.depth > 0;
        if handler {
            self.depth -= 1;
            core::mem::swap(&mut self.running, &mut self.interrupted[usize::from(self.depth)]);
        }
        handler
    }

    /// Whether a state that was read has so many threads, and all that they wait for is there.
    pub fn is_whole(&self, is: impl Fn(Pending) -> bool) -> bool {
        let named = |level: &Level| {
            let ended = match level.finished {
                Some(Finished::Answers(desk) | Finished::Long(desk)) => is(Pending::Reply(desk)),
                _ => true,
            };
            is(level.pending) && ended
        };
        let whole = self.interrupted.len() == DEPTH && usize::from(self.depth) <= DEPTH;
        whole && self.timers.is_whole() && self.interrupted.iter().chain([&self.running]).all(named)
    }
}

#[cfg(test)]
mod tests;
