//! The communication task `T_ic` (§5): the port manipulator of one task.
//!
//! It is a pure state machine. [`CommTask::handle`] takes one input and fills an outbox; it reads no clock, takes no
//! lock, allocates nothing and accepts every input in every state. Time reaches it only as [`Input::Advance`]. The
//! drivers (the model checker, the threaded runtime, the simulator, the validator) differ in where inputs come from.
//!
//! Of the four layers of §5.2, `requests` and `messages` are the user layer: they talk with the task; [`mapping`](crate::mapping) turns names into packets,
//! [`route`](crate::route) finds the succeeding node, and the primitive layer is the driver's link.

mod bury;
mod counts;
mod desk;
mod fragments;
mod heads;
mod ignores;
mod inbox;
pub mod invariants;
mod lease;
mod levels;
mod memory;
mod messages;
mod rendezvous;
mod requests;
mod timers;
mod view;
mod walk;
mod whole;

pub use bury::Coming;
pub(crate) use fragments::Parts;

use crate::cell::Usage;
use crate::ids::{Incarnation, MessageId, NodeId, PortId, Seq24, TaskId};
use crate::observe::{Event, Observation, Reason};
use crate::packet::{Class, Contents, Packet};
use crate::queue::Slot;
use crate::request::{Request, ServiceOrder, Signal, TimeId};
use crate::table::{NodeTable, Port};
use crate::ticks::Ticks;
use alloc::boxed::Box;
use alloc::vec::Vec;
use counts::Counts;
use desk::{Desk, Overdue};
use heads::Heads;
use inbox::Inbox;
use lease::{Guard, Lease};
use levels::{DEPTH, Finished, Level};
use memory::Fate;
use rendezvous::{At, Rendezvous};
use serde::{Deserialize, Serialize};
use timers::Timers;

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

/// What a thread of the task waits for: one outstanding communication (R93).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) enum Pending {
    Nothing,
    Get {
        port: Option<PortId>,
        source: Option<TaskId>,
        deadline: Ticks,
    },
    /// The answers to the request at this desk; its deadline stands there.
    Reply(u16),
    /// The rendezvous at this position of the list; its deadline stands there.
    Meeting(u16),
    /// A delay, and which start of it.
    Delay(TimeId, u8),
    /// The end of an action outside.
    Work,
    /// The lease (D61).
    Lease,
    /// Nothing, but a handler runs between two of its statements.
    Boundary,
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
    /// Sends what is not answered.
    Sends,
    /// Sends what is answered, at this desk.
    Asks(u16),
    Receives(u16),
    Meets(u16),
    /// Answers for others (D11).
    Replies,
    /// Takes such answers.
    Hears,
    /// Carries the beats of its couple (D61).
    Beats,
}

/// One of the task's ports.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Local {
    port: PortId,
    role: Role,
    counters: Counts,
    /// The fragments of the next message or answer (D28).
    staged: Parts,
}

/// The life of a source's node that it was last heard in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
struct Known {
    task: TaskId,
    life: Option<Incarnation>,
}

/// A communication task. Sized from the declaration by [`CommTask::new`], which makes its only allocations.
///
/// Serialised whole it is a keyframe of a recording; the packed bytes of an [`Encode`](crate::Encode) are for checkers.
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
    /// The task's thread, then the handlers that run; `depth` of them.
    levels: Box<[Level]>,
    depth: u8,
    /// The handler that began last ran for a message at its cap (D76).
    capped_last: bool,
    /// Numbers the rounds of rejections (D58).
    rejections: u64,
    timers: Timers,
    /// Only under the rule variant that accepts late replies: the last command that timed out.
    overdue: Option<Overdue>,
    order: ServiceOrder,
    locals: Box<[Local]>,
    desks: Box<[Desk]>,
    inboxes: Box<[Inbox]>,
    meetings: Box<[Rendezvous]>,
    heads: Heads,
    /// How many GETs over all ports were served (D58).
    served: u64,
    /// One per task that may send to this one, ascending.
    lives: Box<[Known]>,
    /// Its side of its couple, if it is in one (D61).
    lease: Option<Lease>,
    /// Of each couple that gives it orders: the newest epoch (D61).
    guards: Box<[Guard]>,
    /// The message the task took last (D28).
    taken: (Option<Contents>, Parts),
    /// Room for those that are rejected together; empty between two inputs.
    #[serde(skip)]
    turned: Vec<Slot>,
}

impl CommTask {
    /// How many timers of one task run at a time.
    pub const TIMERS: usize = 8;
    /// How many entries of the node's Timer one task can have: its timers, and a delay of every thread.
    pub const ENTRIES: usize = Self::TIMERS + DEPTH + 1;

    /// The communication task of `task` in this life of its node. `restarted` says that an earlier life may have run
    /// commands: for as long as any of them can live, commands are answered with RESTARTED (D49).
    #[must_use]
    pub fn new(table: &NodeTable, task: TaskId, incarnation: Incarnation, restarted: bool) -> Self {
        let mut new = Self {
            task,
            incarnation,
            restarted,
            now: Ticks::ZERO,
            next_sequence: Seq24::default(),
            next_turn: 0,
            arrivals: 0,
            quarantine_until: Ticks::ZERO,
            levels: Box::new([Level::NEW; DEPTH + 1]),
            depth: 0,
            capped_last: false,
            rejections: 1,
            timers: Timers::default(),
            overdue: None,
            order: ServiceOrder::default(),
            locals: Box::default(),
            desks: Box::default(),
            inboxes: Box::default(),
            meetings: Box::default(),
            heads: Heads::default(),
            served: 0,
            lives: Box::default(),
            lease: None,
            guards: Box::default(),
            taken: (None, Parts::default()),
            turned: Vec::new(),
        };
        let (mut locals, mut desks) = (Vec::new(), Vec::new());
        let (mut inboxes, mut meetings, mut sources) = (Vec::new(), Vec::new(), Vec::new());
        let (mut guards, mut longest) = (Vec::new(), 1);
        for &id in table.ports_of(task) {
            let Some(port) = table.port(id) else { continue };
            let Some(party) = port.party(task) else { continue };
            let asks = port.decl.class == Class::Command;
            let local = index(locals.len());
            let mut fragments = port.decl.fragments;
            let role = match party.usage {
                Usage::Query | Usage::Response
                    if let Some((at, couple)) = lease::couple_of(table, id, task) =>
                {
                    new.lease = Some(Lease::new(at, couple, task, restarted));
                    Role::Beats
                }
                Usage::Send | Usage::Query if asks => {
                    desks.push(Desk::new(port, task, local));
                    Role::Asks(index(desks.len() - 1))
                }
                Usage::Send | Usage::Query => Role::Sends,
                Usage::Receive if port.decl.usage == Usage::Reply => Role::Hears,
                Usage::Receive | Usage::Response => {
                    longest = longest.max(fragments);
                    fragments = port.decl.answer_fragments;
                    inboxes.push(Inbox::new(port, task, local));
                    sources.extend(port.peers(task));
                    guards.extend(port.decl.guard.map(Guard::new));
                    Role::Receives(index(inboxes.len() - 1))
                }
                Usage::Reply => {
                    fragments = port.decl.answer_fragments;
                    Role::Replies
                }
                Usage::Waitfor => {
                    meetings.push(Rendezvous::new(id, port.parties.len(), table.rules().rounds));
                    Role::Meets(index(meetings.len() - 1))
                }
            };
            let staged = Parts::new(fragments);
            locals.push(Local { port: id, role, counters: Counts::default(), staged });
        }
        if restarted {
            new.quarantine_until = table.quarantine(task);
        }
        sources.sort_unstable();
        sources.dedup();
        new.lives = sources.into_iter().map(|task| Known { task, life: None }).collect();
        guards.sort_unstable_by_key(|guard| guard.couple);
        guards.dedup();
        new.guards = guards.into();
        new.taken.1 = Parts::new(longest);
        let most = inboxes.iter().map(|inbox: &Inbox| inbox.queue.capacity()).max();
        new.turned = Vec::with_capacity(most.unwrap_or_default());
        (new.locals, new.desks) = (locals.into(), desks.into());
        new.heads = Heads::new(&inboxes, meetings.len());
        (new.inboxes, new.meetings) = (inboxes.into(), meetings.into());
        new
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

    /// Takes one input and fills the outbox. Total: no input in any state panics. The task gets at most one signal of it.
    pub fn handle(&mut self, table: &NodeTable, input: Input, out: &mut impl Outbox) {
        self.handle_at(table, &input, out);
    }

    /// The same with an input that stays where it is: inputs are long, and drivers keep them until they are taken.
    pub fn handle_at(&mut self, table: &NodeTable, input: &Input, out: &mut impl Outbox) {
        let waited = !self.is_idle();
        let request = matches!(input, Input::Request(_));
        match input {
            Input::Advance(elapsed) => self.advance(table, *elapsed, out),
            Input::Request(request) => self.request(table, request, out),
            Input::Packet(packet) => self.packet(table, packet, out),
            Input::TimeOut { id, turn } => self.time_is_over(*id, *turn, out),
            Input::Unsent(id) => self.unsent(*id),
            Input::PeerRestarted(node) => self.peer_restarted(table, *node, out),
        }
        // What was asked meanwhile by a thread that waits is answered: it gets no second signal.
        if !(request && waited) {
            self.offer_to_waiting(table, out);
        }
    }

    /// How long from the last [`Input::Advance`] until time alone makes this task act; `None`: never.
    #[must_use]
    pub fn next_expiry(&self) -> Option<Ticks> {
        let wait = match self.top().pending {
            Pending::Get { deadline, .. } => deadline,
            Pending::Reply(desk) => self.desks[usize::from(desk)].due(),
            Pending::Nothing
            | Pending::Meeting(_)
            | Pending::Delay(..)
            | Pending::Work
            | Pending::Lease
            | Pending::Boundary => Ticks::FAR,
        };
        let lease = self.lease.as_ref().map_or(Ticks::FAR, Lease::due);
        let waits = wait.min(self.next_offer()).min(lease).min(self.next_end());
        // Of the threads below, only answers are awaited meanwhile.
        let due = if self.depth == 0 {
            waits
        } else {
            self.open_desks().map(|desk| self.desks[desk].due()).fold(waits, Ticks::min)
        };
        (due != Ticks::FAR).then(|| due - self.now)
    }

    /// Lets time pass that ends before [`next_expiry`](Self::next_expiry): all that [`Input::Advance`] does then. For
    /// drivers that know when that is.
    pub fn pass(&mut self, table: &NodeTable, elapsed: Ticks) {
        debug_assert!(self.next_expiry().is_none_or(|left| elapsed < left), "something is due by then");
        self.now += elapsed;
        if !table.rules().charge_residence {
            self.give_back(elapsed);
        }
    }

    /// Whether the thread that runs, the task's own or a handler, has no outstanding request.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        matches!(self.top().pending, Pending::Nothing)
    }

    fn scene<'a>(&self, table: &'a NodeTable) -> Scene<'a> {
        Scene {
            table,
            task: self.task,
            incarnation: self.incarnation,
            restarted: self.restarted,
            quarantined: self.is_quarantined(table),
            now: self.now,
        }
    }

    /// Whether what `source` sent to an earlier life of the task may still arrive (D49). Tasks of the same node restarted with
    /// it: what they send is new (D157).
    fn turns_away(&self, table: &NodeTable, source: TaskId) -> bool {
        self.is_quarantined(table) && !table.is_here(source)
    }

    /// Messages sent to an earlier life of the task may still arrive (D49).
    fn is_quarantined(&self, table: &NodeTable) -> bool {
        self.now < self.quarantine_until && table.rules().quarantine
    }

    fn local_at(&self, port: PortId) -> Option<usize> {
        self.locals.binary_search_by_key(&port, |local| local.port).ok()
    }

    fn local(&mut self, port: PortId) -> Option<&mut Local> {
        let at = self.local_at(port)?;
        self.locals.get_mut(at)
    }

    fn role(&self, port: PortId) -> Option<Role> {
        Some(self.locals[self.local_at(port)?].role)
    }

    /// The same, where the table is at hand: it knows the place of each port.
    fn role_at(&self, port: &Port) -> Option<Role> {
        let place = port.party(self.task)?.place;
        Some(self.locals.get(usize::from(place))?.role)
    }

    fn count(&mut self, port: PortId, count: impl FnOnce(&mut Counts)) {
        if let Some(local) = self.local(port) {
            count(&mut local.counters);
        }
    }

    fn count_at(&mut self, local: u16, count: impl FnOnce(&mut Counts)) {
        if let Some(local) = self.locals.get_mut(usize::from(local)) {
            count(&mut local.counters);
        }
    }

    /// Runs a step of a rendezvous with its surroundings, and tells the task where that releases it.
    fn meet<R, O: Outbox>(
        &mut self,
        table: &NodeTable,
        meeting: u16,
        out: &mut O,
        step: impl FnOnce(&mut Rendezvous, &mut At<'_>, &mut O) -> R,
    ) -> Option<R> {
        let scene = self.scene(table);
        let rendezvous = self.meetings.get_mut(usize::from(meeting))?;
        let id = rendezvous.port;
        let port: &Port = table.port(id)?;
        let at = self.locals.binary_search_by_key(&id, |local| local.port).ok()?;
        let counters = &mut self.locals[at].counters;
        let mut at = At { scene: &scene, port, counters, released: None };
        let due = rendezvous.due();
        let done = step(rendezvous, &mut at, out);
        let released = at.released;
        if rendezvous.due() != due {
            self.heads.touch_meeting(&self.meetings, meeting);
        }
        if let Some((round, by)) = released {
            self.conclude(Pending::Meeting(meeting), Finished::Released { port: id, round, by }, out);
        }
        Some(done)
    }

    /// Time passes (§5.1.2). Only what is due is touched: the rest keeps its expiry instant.
    fn advance(&mut self, table: &NodeTable, elapsed: Ticks, out: &mut impl Outbox) {
        self.now += elapsed;
        if !table.rules().charge_residence {
            self.give_back(elapsed);
        }
        while let Some(i) = self.expired() {
            self.discard_expired(i, out);
            if self.inboxes[i].is_long() {
                self.discard_incomplete(i, out);
            }
            self.touch(i);
        }
        if let Pending::Get { deadline, .. } = self.top().pending
            && deadline <= self.now
        {
            self.top_mut().pending = Pending::Nothing;
            out.signal(Signal::Nothing);
        }
        let mut from = 0;
        while let Some(desk) = self.due_desk(from) {
            self.advance_desk(table, desk, out);
            from = desk + 1;
        }
        if self.next_act() <= self.now {
            for i in 0..self.meetings.len() {
                if self.meetings[i].due() <= self.now {
                    self.advance_meeting(table, index(i), out);
                }
            }
        }
        self.beat(table, out, Lease::advance);
    }

    /// The lowest desk from one on that has something to do.
    fn due_desk(&self, from: usize) -> Option<usize> {
        self.open_desks().filter(|&desk| desk >= from && self.desks[desk].due() <= self.now).min()
    }

    fn advance_meeting(&mut self, table: &NodeTable, meeting: u16, out: &mut impl Outbox) {
        let gave_up = self.meet(table, meeting, out, |rendezvous, at, out| {
            rendezvous.advance(at, out);
            let over = rendezvous.deadline.is_some_and(|deadline| deadline <= at.scene.now);
            over.then(|| (rendezvous.port, rendezvous.announced, rendezvous.leave(at, out)))
        });
        if let Some(Some((port, round, missing))) = gave_up {
            self.conclude(Pending::Meeting(meeting), Finished::GaveUp { port, round, missing }, out);
        }
    }

    /// The literal reading without residence: waiting costs no life.
    fn give_back(&mut self, elapsed: Ticks) {
        for inbox in &mut self.inboxes {
            inbox.queue.change_all(|held, _| held.expires += elapsed);
        }
        self.touch_all();
    }

    /// Drops what has no time left: simple removal at the local station (§5.1.1).
    fn discard_expired(&mut self, inbox: usize, out: &mut impl Outbox) {
        while let Some(held) = self.inboxes[inbox].queue.pop_if(|held| held.expires <= self.now) {
            let entry = &mut self.inboxes[inbox];
            let port = entry.port;
            if let Some(at) = entry.source(held.source)
                && let Some(remembered) = entry.sources[at].command_mut()
                && remembered.id == held.id()
            {
                remembered.fate = Fate::Lapsed;
            }
            self.count(port, |c| c.expired += 1);
            note(out, Event::Discarded(Reason::Expired), port, held.source, held.id(), Ticks::ZERO);
        }
    }

    fn peer_restarted(&mut self, table: &NodeTable, node: NodeId, out: &mut impl Outbox) {
        self.asked_restarted(table, node, out);
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
