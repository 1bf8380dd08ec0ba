//! The communication task `T_ic` (§5): the port manipulator of one task.
//!
//! It is a pure state machine. [`CommTask::handle`] takes one input and fills an outbox; it reads no clock, takes no
//! lock, allocates nothing and accepts every input in every state. Each input comes with the time at which it comes. The
//! drivers (the model checker, the threaded runtime, the simulator, the validator) differ in where inputs come from.
//!
//! It is made of five parts, each of which owns its state and can be read by itself:
//!
//! | part | what it is about |
//! |---|---|
//! | [`client`] | what the task sends, and the answers that it waits for |
//! | [`server`] | the messages that come to it, from their first packet until they are answered |
//! | [`interrupts`] | its thread, the handlers that interrupt it, and its timers |
//! | [`rendezvous`] | the `waitfor`s that it takes part in |
//! | [`lease`] | its side of a couple, of which one acts |
//!
//! [`own`] is what all share: who the task is, its clock, its order of service, its ports. [`machines`] hands each input to
//! the part that it is for, and [`requests`] what the task asks (the user layer of §5.2). Below, [`mapping`](crate::mapping)
//! turns names into packets, [`route`](crate::route) finds the succeeding node, and the primitive layer is the driver's link.

mod client;
mod counts;
#[cfg(test)]
mod fixture;
mod fragments;
#[cfg(feature = "checker")]
mod ignores;
mod interrupts;
pub mod invariants;
mod lease;
mod machines;
mod own;
mod rendezvous;
mod requests;
mod server;
mod state;
mod step;
mod view;
mod violation;
mod wait;
#[cfg(feature = "checker")]
mod walk;

pub(crate) use fragments::Parts;
pub use step::Outbox;
#[cfg(feature = "checker")]
pub use walk::Coming;

use crate::ids::{Incarnation, MessageId, NodeId, PortId, TaskId};
use crate::packet::{Contents, Packet};
use crate::request::{ReplyTo, Request, TimeId};
use crate::table::NodeTable;
use crate::ticks::{Instant, Ticks};
use interrupts::DEPTH;
use lease::Lease;
use machines::Machines;
use own::{Own, Role};
use serde::{Deserialize, Serialize};
use step::Step;
use wait::Pending;

/// Everything that can happen to a communication task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Input {
    /// Nothing but the time at which it comes.
    Time,
    /// Its task asks for something.
    Request(Request),
    /// A packet for its task arrived; the way is already taken from its remaining time.
    Packet(Packet),
    /// The node's Timer says that this delay or timer is over.
    TimeOut {
        /// Which one.
        id: TimeId,
        /// Which start of it: word of an earlier one is stale.
        turn: u8,
    },
    /// The transit buffer dropped a copy of this request before it left the node.
    Unsent(MessageId),
    /// This node has a new incarnation.
    PeerRestarted(NodeId),
}

/// A communication task. Sized from the declaration by [`CommTask::new`], which makes its only allocations.
///
/// Serialised whole it is a keyframe of a recording; the packed bytes of an [`Encode`](crate::Encode) are for checkers.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CommTask {
    own: Own,
    machines: Machines,
    /// When time alone next makes the task act; `None` where that is to be looked up. Derived from the rest.
    #[serde(skip)]
    due: Option<Instant>,
}

impl CommTask {
    /// How many timers of one task run at a time.
    pub const TIMERS: usize = interrupts::TIMERS;
    /// How many entries of the node's Timer one task can have: its timers, and a delay of every thread.
    pub const ENTRIES: usize = Self::TIMERS + DEPTH + 1;

    /// The communication task of `task` in this life of its node. `restarted` says that an earlier life may have run
    /// commands: for as long as any of them can live, commands are answered with RESTARTED (D49).
    #[must_use]
    pub fn new(table: &NodeTable, task: TaskId, incarnation: Incarnation, restarted: bool) -> Self {
        let own = Own::new(table, task, incarnation, restarted);
        let machines = Machines::new(table, &own);
        Self { own, machines, due: None }
    }

    /// The task it belongs to.
    #[must_use]
    pub const fn task(&self) -> TaskId {
        self.own.task
    }

    /// The life of its node.
    #[must_use]
    pub const fn incarnation(&self) -> Incarnation {
        self.own.incarnation
    }

    /// Takes one input at `now` and fills the outbox: first comes what the time since the last input has made due, each once
    /// and with less remaining, then the input. A `now` before the last one is no time (D42). Total: no input in any state
    /// panics. The task gets at most one signal of the time, and one of the input.
    pub fn handle(&mut self, table: &NodeTable, now: Instant, input: &Input, out: &mut impl Outbox) {
        let only_time = matches!(input, Input::Time);
        if only_time || now > self.own.now {
            self.pass(table, now, out);
            if only_time {
                return;
            }
        }
        // What was asked meanwhile by a thread that waits is answered: it gets no second signal.
        let answered = matches!(input, Input::Request(_)) && !self.is_idle();
        let Self { own, machines, due } = self;
        let step = &mut Step { table, own, out };
        match input {
            Input::Time => {}
            Input::Request(request) => machines.request(step, request),
            Input::Packet(packet) => machines.packet(step, packet),
            Input::TimeOut { id, turn } => machines.time_is_over(step, (*id, *turn)),
            Input::Unsent(id) => machines.client.unsent(*id),
            Input::PeerRestarted(node) => machines.peer_restarted(step, *node),
        }
        if !answered {
            machines.offer_to_waiting(step);
        }
        *due = Some(machines.due());
    }

    /// The time of the last input, on the task's own clock.
    #[must_use]
    pub const fn now(&self) -> Instant {
        self.own.now
    }

    /// When time alone next makes this task act: until then an [`Input::Time`] does nothing.
    #[must_use]
    pub fn next_deadline(&self) -> Instant {
        self.due.unwrap_or_else(|| self.machines.due())
    }

    /// The task's clock goes on, and what is due happens.
    #[inline(never)]
    fn pass(&mut self, table: &NodeTable, now: Instant, out: &mut impl Outbox) {
        let elapsed = now - self.own.now;
        self.own.now += elapsed;
        if !table.rules().charge_residence {
            self.machines.server.give_back(&self.own, elapsed);
            self.due = None;
        }
        if self.next_deadline() <= self.own.now {
            self.act(table, out);
        }
    }

    /// What time alone makes the task do.
    fn act(&mut self, table: &NodeTable, out: &mut impl Outbox) {
        let step = &mut Step { table, own: &mut self.own, out };
        self.machines.advance(step);
        self.machines.offer_to_waiting(step);
        self.due = Some(self.machines.due());
    }

    /// Whether the thread that runs, the task's own or a handler, has no outstanding request.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        matches!(self.machines.interrupts.pending(), Pending::Nothing)
    }

    /// How many handlers run, each having interrupted the one before or the task's thread.
    #[must_use]
    pub const fn depth(&self) -> u8 {
        self.machines.interrupts.depth()
    }

    /// Fragment `index` of the message the task took last; the first one is 0. A packed state leaves it out: a checker
    /// reads it when the message comes.
    #[must_use]
    pub fn fragment(&self, index: u8) -> Option<&Contents> {
        self.machines.server.fragment(index)
    }

    /// What a task answered to the last request on a port, where several were asked or an answer takes several packets:
    /// until the next request there. A packed state leaves it out once the request has ended: a checker reads it with the
    /// signal.
    #[must_use]
    pub fn answer_of(&self, port: PortId, task: TaskId) -> Option<&Contents> {
        self.answer_fragment(port, task, 0)
    }

    /// Fragment `index` of [`answer_of`](Self::answer_of); the first one is 0.
    #[must_use]
    pub fn answer_fragment(&self, port: PortId, task: TaskId, index: u8) -> Option<&Contents> {
        self.machines.client.answer_fragment(self.own.desk(port)?, task, index)
    }

    /// The requests whose answers the task waits for: port, who was asked, and the id.
    pub fn outstanding(&self) -> impl Iterator<Item = (PortId, TaskId, MessageId)> {
        self.machines.client.outstanding()
    }

    /// Whether a reply to this message would still go out.
    #[must_use]
    pub fn can_answer(&self, to: &ReplyTo) -> bool {
        let server = &self.machines.server;
        self.own.role(to.port) == Some(Role::Replies)
            || self.own.inbox(to.port).is_some_and(|inbox| server.can_answer(inbox, to, self.own.now))
    }

    /// The message of a task that was taken on this port and not answered: one at most (D75).
    #[must_use]
    pub fn owed(&self, port: PortId, task: TaskId) -> Option<ReplyTo> {
        self.machines.server.owed(self.own.inbox(port)?, task)
    }

    /// Whether this task may act now: it holds the lease of its couple, or took over (D61). A task in no couple always may.
    #[must_use]
    pub fn is_active(&self) -> bool {
        self.machines.lease.as_ref().is_none_or(Lease::acts)
    }

    /// The epoch that this task acts under, or the newest it heard of; `None` where it is in no couple.
    #[must_use]
    pub fn epoch(&self) -> Option<u8> {
        self.machines.lease.as_ref().map(Lease::epoch)
    }

    /// How long from [`now`](Self::now) this task may act without hearing from its partner: what is left
    /// of its lease. `None` where no lease ends by itself: the task is in no couple, acts alone after a take-over, or does not act.
    ///
    /// A driver that was stopped asks whether the lease is over that it has not looked at since.
    #[must_use]
    pub fn lease_left(&self) -> Option<Ticks> {
        self.machines.lease.as_ref()?.left(self.own.now)
    }

    /// What the partner published last (D61).
    #[must_use]
    pub fn partner_published(&self) -> Option<&Contents> {
        self.machines.lease.as_ref().map(Lease::said)
    }
}
