//! The communication task `T_ic`, the port manipulator of one task (§5).
//!
//! It is a pure state machine. [`CommTask::handle`] takes one input with its time and fills an outbox. It reads no clock, takes
//! no lock, accepts every input in every state, and allocates only for the first handler of a port. The drivers (model checker,
//! threaded runtime, simulator, replay of recordings) differ only in where the inputs come from.
//!
//! A communication task consists of five parts. Each part owns its state and can be read by itself:
//!
//! | part | responsible for |
//! |---|---|
//! | [`client`] | messages that the task sends, and their answers |
//! | [`server`] | messages to the task, from their first packet until they are answered |
//! | [`interrupts`] | the task's own thread, the handlers that interrupt it, and its timers |
//! | [`rendezvous`] | the `waitfor`s in which it takes part |
//! | [`lease`] | its side of a couple, of which one task acts |
//!
//! All parts share [`own`]: identity, clock, order of service, ports. [`machines`] dispatches each input to its part, and
//! [`requests`] does so for the task's requests (the user layer of §5.2). Below them, [`mapping`](crate::mapping) turns names
//! into packets, [`route`](crate::route) finds the next hop, and the driver's link is the primitive layer.

mod client;
mod counts;
#[cfg(test)]
mod fixture;
mod fragments;
mod fused;
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
pub(crate) use fused::{Get, OfTask};
pub use step::Outbox;
#[cfg(feature = "checker")]
pub use walk::Coming;

use crate::ids::{Incarnation, MessageId, NodeId, PortId, TaskId};
use crate::packet::{Contents, Packet};
use crate::request::{ReplyTo, Request, TimeId};
use crate::table::{CellTable, NodeTable};
use crate::ticks::{Instant, Ticks};
use interrupts::DEPTH;
use lease::Lease;
use machines::Machines;
use own::{Own, Role};
use serde::{Deserialize, Serialize};
use step::Step;
use wait::Pending;

/// An input of a communication task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Input {
    /// No event: only the time passes.
    Time,
    /// The task makes a request.
    Request(Request),
    /// A packet arrives for the task. The link delays are already subtracted from its remaining time.
    Packet(Packet),
    /// The node's Timer reports that this delay or timer has ended.
    TimeOut {
        /// The name of the delay or timer.
        id: TimeId,
        /// The number of the start of this delay or timer. A report with the number of an earlier start is stale.
        turn: u8,
    },
    /// The transit buffer dropped a copy of the request with this id before the copy left the node.
    Unsent(MessageId),
    /// The named node has a new incarnation.
    PeerRestarted(NodeId),
    /// The named node has stopped in order: its tasks answer no request any more. What they sent before stays valid.
    PeerStopped(NodeId),
}

/// The communication task of one task. [`CommTask::new`] allocates its storage, sized from the declaration. Only the first
/// [`Request::Handle`] of a port allocates more (D108).
///
/// Serialised as a whole, a communication task is a keyframe of a recording. The packed bytes of an
/// [`Encode`](crate::Encode) are for checkers.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CommTask {
    own: Own,
    machines: Machines,
    /// Cache of the next deadline; `None` if it must be recomputed.
    #[serde(skip)]
    due: Option<Instant>,
}

impl CommTask {
    /// How many timers of one task can run at the same time.
    pub const TIMERS: usize = interrupts::TIMERS;
    /// How many entries of the node's Timer one task can use: its timers, and one delay per activation.
    pub const ENTRIES: usize = Self::TIMERS + DEPTH + 1;

    /// The communication task of `task` in this incarnation of its node. `restarted` says that an earlier incarnation may
    /// have run commands. Until no copy of those commands can arrive any more, commands are answered with RESTARTED (D49).
    #[must_use]
    pub fn new(table: &NodeTable, task: TaskId, incarnation: Incarnation, restarted: bool) -> Self {
        let own = Own::new(table, task, incarnation, restarted);
        let machines = Machines::new(table, &own);
        Self { own, machines, due: None }
    }

    /// The task for which this communication task speaks.
    #[must_use]
    pub const fn task(&self) -> TaskId {
        self.own.task
    }

    /// The incarnation of the task's node.
    #[must_use]
    pub const fn incarnation(&self) -> Incarnation {
        self.own.incarnation
    }

    /// Takes one input at `now` and fills the outbox. First everything happens that became due since the last input, then
    /// the input is taken. A retransmission that is overdue is sent once, with the time that remains now. An earlier `now`
    /// than the last one counts as no time (D42). The function is total: no input in any state makes it panic. The task gets
    /// at most one signal for the time that passed, and one for the input.
    pub fn handle(&mut self, table: &NodeTable, now: Instant, input: &Input, out: &mut impl Outbox) {
        let only_time = matches!(input, Input::Time);
        if only_time || now > self.own.now {
            self.pass(table, now, out);
            if only_time {
                return;
            }
        }
        // A request of a waiting activation gets its signal below; an offer before it would be a second signal.
        let answered = matches!(input, Input::Request(_)) && !self.is_idle();
        self.due = None;
        let Self { own, machines, .. } = self;
        let step = &mut Step { table, own, out };
        match input {
            Input::Time => {}
            Input::Request(request) => machines.request(step, request),
            Input::Packet(packet) => machines.packet(step, packet),
            Input::TimeOut { id, turn } => machines.time_is_over(step, (*id, *turn)),
            Input::Unsent(id) => machines.client.unsent(*id),
            Input::PeerRestarted(node) => machines.peer_restarted(step, *node),
            Input::PeerStopped(node) => machines.peer_stopped(step, *node),
        }
        if !answered {
            machines.offer_to_waiting(step);
        }
    }

    /// Moves the task's clock to `now` if nothing is due by then. Returns false, and changes nothing, if something is due,
    /// or if a rule of the cell lets waiting messages change with time.
    #[inline]
    pub fn let_idle_time_pass(&mut self, table: &NodeTable, now: Instant) -> bool {
        let is_idle = now < self.keep_deadline() && table.rules().charge_residence;
        if is_idle {
            self.own.now = self.own.now.max(now);
        }
        is_idle
    }

    /// Adapts to a table that replaced `former` between two inputs, at the task's own time. Each step reads from the table
    /// what depends on a route. Only the deadlines of waiting and incomplete commands are stored, and these reserve the
    /// time for the way back (D18, D184). Commands whose new deadlines have passed are dropped. The outbox gets
    /// observations only.
    pub fn reroute(&mut self, former: &CellTable, table: &NodeTable, out: &mut impl Outbox) {
        let Self { own, machines, due } = self;
        machines.server.reroute(own, former, table);
        machines.server.advance(&mut Step { table, own, out });
        *due = None;
    }

    /// The task's clock: the time of the last input.
    #[must_use]
    pub const fn now(&self) -> Instant {
        self.own.now
    }

    /// The next instant at which time alone makes the task act. Until then an [`Input::Time`] does nothing.
    #[must_use]
    #[inline]
    pub fn next_deadline(&self) -> Instant {
        self.due.unwrap_or_else(|| self.machines.due())
    }

    /// As [`next_deadline`](Self::next_deadline), but also keeps the result for the next input.
    #[inline]
    pub fn keep_deadline(&mut self) -> Instant {
        let due = self.next_deadline();
        self.due = Some(due);
        due
    }

    /// Moves the task's clock to `now`, and does everything that is due by then.
    #[inline(never)]
    fn pass(&mut self, table: &NodeTable, now: Instant, out: &mut impl Outbox) {
        let elapsed = now - self.own.now;
        self.own.now += elapsed;
        if !table.rules().charge_residence {
            self.machines.server.give_back(&self.own, elapsed);
            self.due = None;
        }
        if self.keep_deadline() <= self.own.now {
            self.act(table, out);
        }
    }

    /// Does everything that time alone makes due.
    fn act(&mut self, table: &NodeTable, out: &mut impl Outbox) {
        let step = &mut Step { table, own: &mut self.own, out };
        self.machines.advance(step);
        self.machines.offer_to_waiting(step);
        self.due = Some(self.machines.due());
    }

    /// Whether the running activation, the task's own thread or a handler, has no outstanding request.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        self.machines.interrupts.waits_for_nothing()
    }

    /// The number of running handlers: each has interrupted the one before, or the task's own thread.
    #[must_use]
    pub const fn depth(&self) -> u8 {
        self.machines.interrupts.depth()
    }

    /// Fragment `index` of the message that the task took last; the first one is 0. Packed states leave it out: a
    /// checker reads it when the message is delivered.
    #[must_use]
    pub fn fragment(&self, index: u8) -> Option<&Contents> {
        self.machines.server.fragment(index)
    }

    /// The answer of a task to the last request on a port, if several tasks were asked or answers take several packets.
    /// Valid until the next request on that port. Packed states leave the answer out once the request has ended: a checker
    /// reads it with the signal.
    #[must_use]
    pub fn answer_of(&self, port: PortId, task: TaskId) -> Option<&Contents> {
        self.answer_fragment(port, task, 0)
    }

    /// Fragment `index` of [`answer_of`](Self::answer_of); the first one is 0.
    #[must_use]
    pub fn answer_fragment(&self, port: PortId, task: TaskId, index: u8) -> Option<&Contents> {
        self.machines.client.answer_fragment(self.own.request(port)?, task, index)
    }

    /// The outstanding requests whose answers are missing: the port, the task that was asked, and the message id.
    pub fn outstanding(&self) -> impl Iterator<Item = (PortId, TaskId, MessageId)> {
        self.machines.client.outstanding()
    }

    /// Whether the communication task would still send a reply to this message.
    #[must_use]
    pub fn can_answer(&self, to: &ReplyTo) -> bool {
        let server = &self.machines.server;
        self.own.role(to.port) == Some(Role::Replies)
            || self.own.inbox(to.port).is_some_and(|inbox| server.can_answer(inbox, to, self.own.now))
    }

    /// The message of `task` that the task took on this port and has not answered; there is at most one (D75).
    #[must_use]
    pub fn owed(&self, port: PortId, task: TaskId) -> Option<ReplyTo> {
        self.machines.server.owed(self.own.inbox(port)?, task)
    }

    /// Whether this task may act now: it is neither primary nor standby, holds the lease, or has taken over (D61).
    #[must_use]
    pub fn is_active(&self) -> bool {
        self.machines.lease.as_ref().is_none_or(Lease::acts)
    }

    /// The epoch under which this task acts, or the newest epoch of which it has heard; `None` if it is neither primary nor
    /// standby.
    #[must_use]
    pub fn epoch(&self) -> Option<u8> {
        self.machines.lease.as_ref().map(Lease::epoch)
    }

    /// The remaining lease: how long from [`now`](Self::now) this task may act without hearing from its partner. `None` if no
    /// lease runs: the task is in no couple, acts alone after a take-over, or does not act.
    ///
    /// A driver that was suspended compares this with the time that passed, to learn whether the lease has ended.
    #[must_use]
    pub fn lease_left(&self) -> Option<Ticks> {
        self.machines.lease.as_ref()?.left(self.own.now)
    }

    /// The data that the partner published last (D61).
    #[must_use]
    pub fn partner_published(&self) -> Option<&Contents> {
        self.machines.lease.as_ref().map(Lease::said)
    }
}
