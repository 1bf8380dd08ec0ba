//! The communication task `T_ic` (§5): the port manipulator of one task.
//!
//! It is a pure state machine. [`CommTask::handle`] takes one input and fills an outbox; it reads no clock, takes no
//! lock, allocates nothing and accepts every input in every state. Time reaches it only as [`Input::Advance`]. The
//! drivers (the model checker, the threaded runtime, the simulator, the validator) differ in where inputs come from.
//!
//! Of the four layers of §5.2, `user` talks with the task, [`mapping`](crate::mapping) turns names into packets,
//! [`route`](crate::route) finds the succeeding node, and the primitive layer is the driver's link.

mod ignores;
mod inbox;
pub mod invariants;
mod memory;
mod packed;
mod relative;
mod rendezvous;
mod user;
mod view;

pub use packed::{Frame, Overflow};
pub use relative::{Visit, VisitMut};

use crate::cell::Usage;
use crate::ids::{Incarnation, MessageId, NodeId, PortId, Seq24, TaskId};
use crate::observe::{Event, Observation, PortCounters, Reason};
use crate::packet::{Class, Contents, Packet};
use crate::request::{Outcome, Request, ServiceOrder, Signal, TimeId};
use crate::table::{NodeTable, Port};
use crate::ticks::Ticks;
use alloc::boxed::Box;
use alloc::vec::Vec;
use inbox::{Held, Inbox};
use memory::Source;
use rendezvous::{At, Rendezvous};
use serde::{Deserialize, Serialize};

/// Everything that can happen to a communication task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Input {
    /// So much time has passed since the last input. What became due meanwhile happens once, with less remaining.
    Advance(Ticks),
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

/// Where the effects of [`CommTask::handle`] go. They are carried out after it returned.
pub trait Outbox {
    /// Hands a packet to the route layer.
    fn transmit(&mut self, packet: Packet);
    /// Answers the task.
    fn signal(&mut self, signal: Signal);
    /// Asks the node's Timer for a time_out. `turn` is to come back with it.
    fn arm(&mut self, id: TimeId, turn: u8, length: Ticks);
    /// Takes a request to the Timer back.
    fn disarm(&mut self, id: TimeId);
    /// Notes what happened.
    fn observe(&mut self, observation: Observation) {
        let _ = observation;
    }
}

/// A class-2 message whose answer the task waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Command {
    port: PortId,
    to: TaskId,
    id: MessageId,
    deadline: Ticks,
    contents: Contents,
    /// How often it may still be sent again, and when next (D5).
    copies_left: u8,
    copy_at: Ticks,
    /// Copies that may have left the node.
    copies_out: u8,
}

/// What the task waits for: one outstanding communication (R93).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) enum Pending {
    Nothing,
    Get {
        port: Option<PortId>,
        source: Option<TaskId>,
        deadline: Ticks,
    },
    Reply(Command),
    /// The rendezvous at this position of the list; its deadline stands there.
    Meeting(u16),
    Delay(TimeId, u8),
}

/// Where the parts of a communication task work.
#[derive(Clone, Copy)]
pub(crate) struct Scene<'a> {
    pub table: &'a NodeTable,
    pub task: TaskId,
    pub incarnation: Incarnation,
    pub restarted: bool,
    /// Messages sent to an earlier life of the task may still arrive (D49).
    pub quarantined: bool,
    pub now: Ticks,
}

/// What the task does with a port, and where the state for it stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
enum Role {
    Sends,
    Receives(u16),
    Meets(u16),
}

/// One of the task's ports.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Local {
    port: PortId,
    role: Role,
    counters: PortCounters,
}

/// A communication task. Sized from the declaration by [`CommTask::new`], which makes its only allocations.
///
/// Serialised whole it is a keyframe of a recording; the packed bytes of [`store`](CommTask::store) are for checkers.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CommTask {
    task: TaskId,
    incarnation: Incarnation,
    restarted: bool,
    /// Ticks since `new` or the last `rebase`; every instant below is on this counter.
    now: Ticks,
    next_sequence: Seq24,
    /// Tells the starts of the task's delays and timers apart.
    next_turn: u8,
    /// Numbers messages in the order they were stored: the last key of the service order (D14).
    arrivals: u64,
    /// Until when a restarted task cannot know what its earlier life ran (D49).
    quarantine_until: Ticks,
    pending: Pending,
    /// Only under the rule variant that accepts late replies: the last command that timed out.
    overdue: Option<Command>,
    order: ServiceOrder,
    locals: Box<[Local]>,
    inboxes: Box<[Inbox]>,
    meetings: Box<[Rendezvous]>,
    /// One per task that may send to this one, ascending.
    sources: Box<[Source]>,
}

impl CommTask {
    /// How many delays and timers of one task run at a time.
    pub const TIMERS: usize = 8;

    /// The communication task of `task` in this life of its node. `restarted` says that an earlier life may have run
    /// commands: for as long as any of them can live, commands are answered with RESTARTED (D49).
    #[must_use]
    pub fn new(table: &NodeTable, task: TaskId, incarnation: Incarnation, restarted: bool) -> Self {
        let mut locals = Vec::new();
        let (mut inboxes, mut meetings, mut sources) = (Vec::new(), Vec::new(), Vec::new());
        let mut quarantine_until = Ticks::ZERO;
        for &id in table.ports_of(task) {
            let Some(port) = table.port(id) else { continue };
            let Some(party) = port.party(task) else { continue };
            let role = match party.usage {
                Usage::Send | Usage::Query | Usage::Reply => Role::Sends,
                Usage::Receive | Usage::Response => {
                    inboxes.push(Inbox::new(id, port.decl.bounded_buffer));
                    for peer in port.peers(task) {
                        let life = port.party(peer).map_or(Ticks::ZERO, |p| p.time_out);
                        if restarted && port.decl.class == Class::Command {
                            quarantine_until = quarantine_until.max(life + table.bound_between(peer, task));
                        }
                        sources.push(peer);
                    }
                    Role::Receives(index(inboxes.len() - 1))
                }
                Usage::Waitfor => {
                    for party in port.parties.iter().filter(|party| restarted && party.task != task) {
                        let life = party.time_out + table.bound_between(party.task, task);
                        quarantine_until = quarantine_until.max(life);
                    }
                    meetings.push(Rendezvous::new(id, port.parties.len(), table.rules().rounds));
                    Role::Meets(index(meetings.len() - 1))
                }
            };
            locals.push(Local { port: id, role, counters: PortCounters::default() });
        }
        sources.sort_unstable();
        sources.dedup();
        Self {
            task,
            incarnation,
            restarted,
            now: Ticks::ZERO,
            next_sequence: Seq24::default(),
            next_turn: 0,
            arrivals: 0,
            quarantine_until,
            pending: Pending::Nothing,
            overdue: None,
            order: ServiceOrder::default(),
            locals: locals.into(),
            inboxes: inboxes.into(),
            meetings: meetings.into(),
            sources: sources.into_iter().map(Source::new).collect(),
        }
    }

    /// The task it belongs to.
    #[must_use]
    pub const fn task(&self) -> TaskId {
        self.task
    }

    /// The life of its node.
    #[must_use]
    pub const fn incarnation(&self) -> Incarnation {
        self.incarnation
    }

    /// Takes one input and fills the outbox. Total: no input in any state panics.
    pub fn handle(&mut self, table: &NodeTable, input: Input, out: &mut impl Outbox) {
        match input {
            Input::Advance(elapsed) => self.advance(table, elapsed, out),
            Input::Request(request) => self.request(table, request, out),
            Input::Packet(packet) => self.packet(table, &packet, out),
            Input::TimeOut { id, turn } => {
                if self.pending == Pending::Delay(id, turn) {
                    self.pending = Pending::Nothing;
                    out.signal(Signal::TimeOut(id));
                }
            }
            Input::Unsent(id) => {
                if let Pending::Reply(command) = &mut self.pending
                    && command.id == id
                {
                    command.copies_out = command.copies_out.saturating_sub(1);
                }
            }
            Input::PeerRestarted(node) => self.peer_restarted(table, node, out),
        }
    }

    /// How long from the last [`Input::Advance`] until time alone makes this task act; `None`: never.
    #[must_use]
    pub fn next_expiry(&self) -> Option<Ticks> {
        let pending = match &self.pending {
            Pending::Get { deadline, .. } => *deadline,
            Pending::Reply(command) => command.deadline.min(command.copy_at),
            Pending::Nothing | Pending::Meeting(_) | Pending::Delay(..) => Ticks::FAR,
        };
        let meetings = self.meetings.iter().map(Rendezvous::due);
        let buffers =
            self.inboxes.iter().filter_map(|inbox| inbox.queue.first().map(|(_, _, held)| held.expires));
        let due = meetings.chain(buffers).fold(pending, Ticks::min);
        (due != Ticks::FAR).then(|| due - self.now)
    }

    /// Whether the task has no outstanding request.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        self.pending == Pending::Nothing
    }

    fn scene<'a>(&self, table: &'a NodeTable) -> Scene<'a> {
        Scene {
            table,
            task: self.task,
            incarnation: self.incarnation,
            restarted: self.restarted,
            quarantined: self.now < self.quarantine_until && table.rules().quarantine,
            now: self.now,
        }
    }

    fn local(&mut self, port: PortId) -> Option<&mut Local> {
        let at = self.locals.binary_search_by_key(&port, |local| local.port).ok()?;
        self.locals.get_mut(at)
    }

    fn role(&self, port: PortId) -> Option<Role> {
        let at = self.locals.binary_search_by_key(&port, |local| local.port).ok()?;
        Some(self.locals[at].role)
    }

    fn count(&mut self, port: PortId, count: impl FnOnce(&mut PortCounters)) {
        if let Some(local) = self.local(port) {
            count(&mut local.counters);
        }
    }

    /// Runs a step of a rendezvous with its surroundings.
    fn meet<R>(
        &mut self,
        table: &NodeTable,
        meeting: u16,
        step: impl FnOnce(&mut Rendezvous, &mut At<'_>) -> R,
    ) -> Option<R> {
        let scene = self.scene(table);
        let rendezvous = self.meetings.get_mut(usize::from(meeting))?;
        let port: &Port = table.port(rendezvous.port)?;
        let at = self.locals.binary_search_by_key(&rendezvous.port, |local| local.port).ok()?;
        let counters = &mut self.locals[at].counters;
        Some(step(rendezvous, &mut At { scene: &scene, port, counters }))
    }

    /// Time passes (§5.1.2). Only what is due is touched: the rest keeps its expiry instant.
    fn advance(&mut self, table: &NodeTable, elapsed: Ticks, out: &mut impl Outbox) {
        self.now += elapsed;
        if !table.rules().charge_residence {
            self.give_back(elapsed);
        }
        for i in 0..self.inboxes.len() {
            self.discard_expired(i, out);
        }
        match self.pending {
            Pending::Get { deadline, .. } if deadline <= self.now => {
                self.pending = Pending::Nothing;
                out.signal(Signal::Nothing);
            }
            Pending::Reply(command) if command.deadline <= self.now => self.time_out(table, command, out),
            Pending::Reply(command) if command.copy_at <= self.now => self.send_again(table, command, out),
            _ => {}
        }
        for i in 0..self.meetings.len() {
            if self.meetings[i].due() <= self.now {
                self.advance_meeting(table, index(i), out);
            }
        }
    }

    fn advance_meeting(&mut self, table: &NodeTable, meeting: u16, out: &mut impl Outbox) {
        let gave_up = self.meet(table, meeting, |rendezvous, at| {
            rendezvous.advance(at, out);
            let over = rendezvous.deadline.is_some_and(|deadline| deadline <= at.scene.now);
            over.then(|| (rendezvous.port, rendezvous.announced, rendezvous.leave(at, out)))
        });
        if let Some(Some((port, round, missing))) = gave_up {
            self.pending = Pending::Nothing;
            out.signal(Signal::GaveUp { port, round, missing });
        }
    }

    /// The literal reading without residence: waiting costs no life.
    fn give_back(&mut self, elapsed: Ticks) {
        for inbox in &mut self.inboxes {
            inbox.queue.rekey(|key, held| {
                held.expires += elapsed;
                Inbox::key_again(key, held)
            });
        }
    }

    /// Drops what has no time left: simple removal at the local station (§5.1.1).
    fn discard_expired(&mut self, inbox: usize, out: &mut impl Outbox) {
        while let Some(held) = self.inboxes[inbox].queue.pop_if(|held| held.expires <= self.now) {
            let port = self.inboxes[inbox].port;
            self.count(port, |c| c.expired += 1);
            note(out, Event::Discarded(Reason::Expired), port, held.source, held.id, Ticks::ZERO);
        }
    }

    fn time_out(&mut self, table: &NodeTable, command: Command, out: &mut impl Outbox) {
        self.pending = Pending::Nothing;
        if !table.rules().refuse_late_replies {
            self.overdue = Some(command);
        }
        self.count(command.port, |c| c.timed_out += 1);
        let (outcome, event) = if command.copies_out == 0 {
            (Outcome::TimedOutUnsent, Event::TimedOutUnsent)
        } else {
            (Outcome::TimedOutUnknown, Event::TimedOut)
        };
        note(out, event, command.port, command.to, command.id, Ticks::ZERO);
        out.signal(Signal::Outcome(outcome));
    }

    fn peer_restarted(&mut self, table: &NodeTable, node: NodeId, out: &mut impl Outbox) {
        if let Pending::Reply(command) = self.pending
            && table.location(command.to) == Some(node)
        {
            self.pending = Pending::Nothing;
            note(
                out,
                Event::PeerRestarted,
                command.port,
                command.to,
                command.id,
                command.deadline - self.now,
            );
            out.signal(Signal::Outcome(Outcome::PeerRestarted));
        }
        for meeting in &mut self.meetings {
            let Some(port) = table.port(meeting.port) else { continue };
            for (i, party) in port.parties.iter().enumerate() {
                if party.task != self.task && table.location(party.task) == Some(node) {
                    meeting.forget(i);
                }
            }
        }
    }
}

/// Makes an observation about a message.
fn note(out: &mut impl Outbox, event: Event, port: PortId, peer: TaskId, id: MessageId, remaining: Ticks) {
    out.observe(Observation { event, port, peer, number: id.sequence.get(), remaining });
}

/// Positions in a task's own lists; a cell has at most 65,536 ports.
#[expect(clippy::cast_possible_truncation, reason = "a cell has at most 65,536 ports")]
const fn index(i: usize) -> u16 {
    i as u16
}

/// A message held in a buffer, for the queue of a port.
const fn held(packet: &Packet, class: Class, expires: Ticks) -> Held {
    Held { source: packet.source, id: packet.id, class, expires, contents: packet.contents }
}
