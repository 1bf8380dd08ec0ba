//! A node (§5.1, D38): its communication tasks, one transit buffer, one Timer, and the demultiplexing between them.
//!
//! Single-threaded drivers call [`Node::step`]; the threaded runtime takes a node apart and puts every part behind its
//! own lock. Both call the same pure functions of [`route`](crate::route).

use crate::ids::{Incarnation, MessageId, NodeId, TaskId};
use crate::observe::{Event, Observation, Reason};
use crate::packet::Packet;
use crate::request::{Request, Signal, TimeId};
use crate::route::{self, Arrival, Departure};
use crate::rules::JobRequest;
use crate::state::{Walk, same_variant};
use crate::table::NodeTable;
use crate::task::{CommTask, Input, Outbox};
use crate::ticks::Ticks;
use crate::timer::Timer;
use crate::transit::{RouteOutbox, Transit};
use alloc::boxed::Box;
use alloc::collections::VecDeque;
use serde::{Deserialize, Serialize};

/// Everything that can happen to a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum NodeInput {
    /// So much time has passed since the last input.
    Advance(Ticks),
    /// A task asks for something.
    Request(TaskId, Request),
    /// A packet came in over a link.
    Packet {
        /// The neighbour that handed it over.
        from: NodeId,
        /// The packet.
        packet: Packet,
        /// What the way is taken to have cost (D20).
        charge: Ticks,
    },
    /// A neighbour or a farther node has a new incarnation.
    PeerRestarted(NodeId),
}

/// Where the effects of a node go.
pub trait NodeOutbox {
    /// Whether the link to the succeeding node takes a packet now; where not, packets stay in the transit buffer.
    fn ready(&mut self, next: NodeId) -> bool {
        let _ = next;
        true
    }
    /// Sends a packet to the succeeding node.
    fn link(&mut self, next: NodeId, packet: Packet);
    /// Answers a task.
    fn signal(&mut self, task: TaskId, signal: Signal);
    /// Notes what happened at a task, or in the transit buffer.
    fn observe(&mut self, at: Option<TaskId>, observation: Observation) {
        let _ = (at, observation);
    }
}

/// The parts of a node, for a driver that puts each behind its own lock.
#[derive(Clone, Debug)]
pub struct Parts {
    /// The table.
    pub table: NodeTable,
    /// The communication tasks, ascending by task.
    pub tasks: Box<[CommTask]>,
    /// The transit buffer.
    pub transit: Transit,
    /// The Timer.
    pub timer: Timer,
}

/// A node.
#[derive(Clone, Debug)]
pub struct Node {
    parts: Parts,
    /// For each task of the cell, where it stands among those of this node, if it is one of them.
    places: Box<[u16]>,
    /// Effects within the node that are not carried out yet. Empty between steps.
    work: VecDeque<Work>,
}

#[derive(Clone, Copy, Debug)]
enum Work {
    Route(Packet),
    Task(TaskId, Input),
    Arm(TaskId, TimeId, u8, Ticks),
    Disarm(TaskId, TimeId),
}

/// The kinds of effects that a state can have.
const WORKS: [Work; 7] = [
    Work::Route(Packet::BLANK),
    Work::Task(TaskId(0), Input::Packet(Packet::BLANK)),
    Work::Task(TaskId(0), Input::Unsent(MessageId::BLANK)),
    Work::Task(TaskId(0), Input::TimeOut { id: TimeId(0), turn: 0 }),
    Work::Arm(TaskId(0), TimeId(0), 0, Ticks::ZERO),
    Work::Disarm(TaskId(0), TimeId(0)),
    Work::Task(TaskId(0), Input::PeerRestarted(NodeId(0))),
];

impl Work {
    fn is_like(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Task(_, a), Self::Task(_, b)) => same_variant(a, b),
            (a, b) => same_variant(a, b),
        }
    }

    fn walk<W: Walk>(&mut self, w: &mut W) {
        w.one_of(&WORKS, self, Self::is_like);
        let task = match self {
            // It says itself from whom it is.
            Self::Route(packet) => &mut { packet.source },
            Self::Task(task, _) | Self::Arm(task, ..) | Self::Disarm(task, _) => task,
        };
        w.small(&mut task.0);
        let task = *task;
        // One thread drives a packed node: no word of an earlier start of a delay can still be on its way.
        match self {
            Self::Route(packet) | Self::Task(_, Input::Packet(packet)) => packet.walk(w),
            Self::Task(_, Input::Unsent(id)) => {
                w.byte(&mut id.incarnation.0);
                w.sequence(task, &mut id.sequence);
            }
            Self::Task(_, Input::TimeOut { id, turn: _ }) | Self::Disarm(_, id) => w.byte(&mut id.0),
            Self::Arm(_, id, _, length) => {
                w.byte(&mut id.0);
                length.0 = w.count(usize::try_from(length.0).unwrap_or(usize::MAX)) as u64;
            }
            Self::Task(_, Input::PeerRestarted(node)) => w.small(&mut node.0),
            Self::Task(_, Input::Advance(_) | Input::Request(_)) => {}
        }
    }
}

/// How many effects of one input a node has room for without allocating: every copy of a message to 64 members, and
/// what they answer.
const WORK: usize = 256;

/// No place: a node has at most 65,535 tasks.
const ELSEWHERE: u16 = u16::MAX;

impl Node {
    /// The node of `table` in this life.
    #[must_use]
    pub fn new(table: NodeTable, incarnation: Incarnation, restarted: bool, transit_capacity: u16) -> Self {
        let tasks: Box<[CommTask]> = table
            .tasks_on(table.node)
            .map(|task| CommTask::new(&table, task, incarnation, restarted))
            .collect();
        let timers = u16::try_from(tasks.len().saturating_mul(CommTask::ENTRIES)).unwrap_or(u16::MAX);
        let room = WORK + tasks.len();
        let parts =
            Parts { table, tasks, transit: Transit::new(transit_capacity), timer: Timer::new(timers) };
        let mut places = alloc::vec![ELSEWHERE; parts.table.cell().tasks.len()].into_boxed_slice();
        for (place, task) in (0_u16..).zip(&parts.tasks) {
            places[task.task().index()] = place;
        }
        Self { parts, places, work: VecDeque::with_capacity(room) }
    }

    /// Its parts.
    #[must_use]
    pub fn into_parts(self) -> Parts {
        self.parts
    }

    /// Its parts, to look at.
    #[must_use]
    pub const fn parts(&self) -> &Parts {
        &self.parts
    }

    /// Its parts, for canonical states.
    pub const fn parts_mut(&mut self) -> &mut Parts {
        &mut self.parts
    }

    /// A communication task of this node.
    #[must_use]
    pub fn task(&self, task: TaskId) -> Option<&CommTask> {
        self.parts.tasks.get(usize::from(*self.places.get(task.index())?))
    }

    /// Takes one input and carries out everything that follows from it within the node.
    pub fn step(&mut self, input: NodeInput, out: &mut impl NodeOutbox) {
        self.begin(input, out);
        while let Some(work) = self.work.pop_front() {
            // Nobody looks between the steps here: a packet that nothing waits before needs no place in the row.
            if let Work::Route(packet) = work
                && self.work.is_empty()
                && let Departure::Local(task) = route::departing(&self.parts.table, &packet)
            {
                self.hand_to(task, Input::Packet(packet), out);
            } else {
                self.carry_out(work, out);
            }
        }
        self.flush(out);
    }

    /// Takes one input and leaves what follows from it within the node to [`proceed`](Self::proceed): for a checker
    /// that looks between the steps (D39). Time passes at once for all parts.
    pub fn begin(&mut self, input: NodeInput, out: &mut impl NodeOutbox) {
        match input {
            NodeInput::Advance(elapsed) => self.advance(elapsed, out),
            NodeInput::Request(task, request) => self.hand_to(task, Input::Request(request), out),
            NodeInput::Packet { from, packet, charge } => self.arrive(from, packet, charge, out),
            NodeInput::PeerRestarted(node) => {
                for i in 0..self.parts.tasks.len() {
                    let task = self.parts.tasks[i].task();
                    self.work.push_back(Work::Task(task, Input::PeerRestarted(node)));
                }
            }
        }
    }

    /// Carries out the next effect within the node. False when there is none: then [`flush`](Self::flush).
    pub fn proceed(&mut self, out: &mut impl NodeOutbox) -> bool {
        let Some(work) = self.work.pop_front() else { return false };
        self.carry_out(work, out);
        true
    }

    /// Whether effects within the node are not carried out yet.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        !self.work.is_empty()
    }

    /// The packets among these effects.
    pub fn work_packets(&self) -> impl Iterator<Item = &Packet> {
        self.work.iter().filter_map(|work| match work {
            Work::Route(packet) | Work::Task(_, Input::Packet(packet)) => Some(packet),
            Work::Task(..) | Work::Arm(..) | Work::Disarm(..) => None,
        })
    }

    /// Walks the effects that are not carried out yet. An input that [`begin`](Self::begin) was given and
    /// [`proceed`](Self::proceed) has not handed on has no packed form.
    pub fn walk_work<W: Walk>(&mut self, w: &mut W) {
        let count = w.count(self.work.len());
        if W::READS {
            self.work.clear();
            self.work.resize(count, Work::Route(Packet::BLANK));
        }
        self.work.iter_mut().for_each(|work| work.walk(w));
    }

    /// Whether the clock counts (D22). Under the blocking reading of Figure 3 the Timer waits for the answer of every
    /// task to its JOB_REQUEST, and a task that works gives none: no CLICK reaches the node's communication tasks.
    #[must_use]
    pub fn counts(&self) -> bool {
        match self.parts.table.rules().job_request {
            JobRequest::Standing => true,
            JobRequest::Blocking => !self.parts.tasks.iter().any(CommTask::is_working),
        }
    }

    /// How long from the last [`NodeInput::Advance`] until time alone makes this node act.
    #[must_use]
    pub fn next_expiry(&self) -> Option<Ticks> {
        let tasks = self.parts.tasks.iter().filter_map(CommTask::next_expiry);
        tasks.chain(self.parts.transit.next_expiry()).chain(self.parts.timer.next_expiry()).min()
    }

    /// Sends what waits, most urgent first, as far as the links take it (§5.2.3).
    pub fn flush(&mut self, out: &mut impl NodeOutbox) {
        while let Some((next, packet)) = self.parts.transit.next(|next| out.ready(next)) {
            out.link(next, packet);
        }
    }

    fn advance(&mut self, elapsed: Ticks, out: &mut impl NodeOutbox) {
        if !self.counts() {
            return;
        }
        // The transit buffer first: a task whose time_out ends now must know whether its packet ever left.
        self.with_transit(out, |transit, table, effects| transit.advance(table, elapsed, effects));
        while let Some(work) = self.work.pop_front() {
            self.carry_out(work, out);
        }
        // All tasks before what any of them sends: a message between two of them must not age by the time before it.
        for i in 0..self.parts.tasks.len() {
            self.work.push_back(Work::Task(self.parts.tasks[i].task(), Input::Advance(elapsed)));
        }
        while let Some(work) = self.work.pop_front() {
            self.carry_out(work, out);
        }
        let work = &mut self.work;
        self.parts.timer.advance(elapsed, |task, id, turn| {
            work.push_back(Work::Task(task, Input::TimeOut { id, turn }));
        });
    }

    fn arrive(&mut self, from: NodeId, packet: Packet, charge: Ticks, out: &mut impl NodeOutbox) {
        match route::arrived(&self.parts.table, from, packet, charge) {
            Arrival::Local(task, packet) => self.work.push_back(Work::Task(task, Input::Packet(packet))),
            Arrival::Relay(packet) => self.work.push_back(Work::Route(packet)),
            Arrival::Discard(reason, packet) => out.observe(None, discarded(reason, &packet)),
        }
    }

    fn hand_to(&mut self, task: TaskId, input: Input, out: &mut impl NodeOutbox) {
        let Some(&place) = self.places.get(task.index()) else { return };
        let Some(comm_task) = self.parts.tasks.get_mut(usize::from(place)) else { return };
        comm_task.handle(&self.parts.table, input, &mut TaskEffects { task, work: &mut self.work, out });
    }

    fn carry_out(&mut self, work: Work, out: &mut impl NodeOutbox) {
        match work {
            Work::Task(task, input) => self.hand_to(task, input, out),
            Work::Route(packet) => match route::departing(&self.parts.table, &packet) {
                Departure::Local(task) => self.work.push_back(Work::Task(task, Input::Packet(packet))),
                Departure::Link(_) | Departure::Unroutable => {
                    self.with_transit(out, |transit, table, effects| transit.offer(table, packet, effects));
                }
            },
            Work::Arm(task, id, turn, length) => {
                // A full Timer ends the delay at once rather than never.
                if !self.parts.timer.arm(task, id, turn, length) {
                    self.work.push_back(Work::Task(task, Input::TimeOut { id, turn }));
                }
            }
            Work::Disarm(task, id) => {
                self.parts.timer.disarm(task, id);
            }
        }
    }

    fn with_transit<O: NodeOutbox>(
        &mut self,
        out: &mut O,
        step: impl FnOnce(&mut Transit, &NodeTable, &mut RouteEffects<'_, O>),
    ) {
        let Parts { table, transit, .. } = &mut self.parts;
        step(transit, table, &mut RouteEffects { work: &mut self.work, out });
    }
}

/// The observation of a packet dropped before it reached a communication task.
#[must_use]
pub fn discarded(reason: Reason, packet: &Packet) -> Observation {
    Observation {
        event: Event::Discarded(reason),
        port: packet.port,
        peer: packet.source,
        number: packet.id.sequence.get(),
        remaining: packet.remaining,
    }
}

struct TaskEffects<'a, O> {
    task: TaskId,
    work: &'a mut VecDeque<Work>,
    out: &'a mut O,
}

impl<O: NodeOutbox> Outbox for TaskEffects<'_, O> {
    fn transmit(&mut self, packet: Packet) {
        self.work.push_back(Work::Route(packet));
    }

    fn signal(&mut self, signal: Signal) {
        self.out.signal(self.task, signal);
    }

    fn arm(&mut self, id: TimeId, turn: u8, length: Ticks) {
        self.work.push_back(Work::Arm(self.task, id, turn, length));
    }

    fn disarm(&mut self, id: TimeId) {
        self.work.push_back(Work::Disarm(self.task, id));
    }

    fn observe(&mut self, observation: Observation) {
        self.out.observe(Some(self.task), observation);
    }
}

struct RouteEffects<'a, O> {
    work: &'a mut VecDeque<Work>,
    out: &'a mut O,
}

impl<O: NodeOutbox> RouteOutbox for RouteEffects<'_, O> {
    fn unsent(&mut self, task: TaskId, id: MessageId) {
        self.work.push_back(Work::Task(task, Input::Unsent(id)));
    }

    fn transmit(&mut self, packet: Packet) {
        self.work.push_back(Work::Route(packet));
    }

    fn observe(&mut self, observation: Observation) {
        self.out.observe(None, observation);
    }
}
