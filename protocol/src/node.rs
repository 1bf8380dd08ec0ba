//! A node (§5.1, D38): its communication tasks, one transit buffer, one Timer, and the demultiplexing between them.
//!
//! Single-threaded drivers call [`Node::step`]; the threaded runtime takes a node apart. Both use [`route`](crate::route).

mod fused;
#[cfg(feature = "checker")]
mod orders;
mod replace;
#[cfg(feature = "checker")]
mod walk;
mod work;

use crate::ids::{Incarnation, MessageId, NodeId, TaskId};
use crate::observe::{Event, Observation, Reason};
use crate::packet::Packet;
use crate::request::{Request, Signal, TimeId};
use crate::route::{self, Arrival};
use crate::rules::JobRequest;
use crate::table::NodeTable;
use crate::task::{CommTask, Input, Outbox};
use crate::ticks::{Instant, Ticks};
use crate::timer::Timer;
use crate::transit::{RouteOutbox, Transit};
use alloc::boxed::Box;
use alloc::collections::VecDeque;
pub use fused::{Fusible, Gathering, Members};
use serde::{Deserialize, Serialize};
use work::Work;

/// An input of a node. A driver passes it to [`Node::step`] with its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum NodeInput {
    /// Time has passed, and nothing else happened.
    Time,
    /// A request of a task.
    Request(TaskId, Request),
    /// A packet came in over a link.
    Packet {
        /// The neighbour that sent the packet over the link.
        from: NodeId,
        /// The packet.
        packet: Packet,
        /// The link delay to take from the remaining time: no less than the link's bound (D20).
        charge: Ticks,
    },
    /// Another node, neighbour or not, has a new incarnation.
    PeerRestarted(NodeId),
    /// A packet of this task's command never left the node, although the node gave it to its link.
    Unsent(TaskId, MessageId),
}

/// Where the effects of a node go.
pub trait NodeOutbox {
    /// Whether the link to the neighbour `next` takes a packet now. If not, packets stay in the transit buffer.
    fn ready(&mut self, next: NodeId) -> bool {
        let _ = next;
        true
    }
    /// Sends a packet to the neighbour `next`.
    fn link(&mut self, next: NodeId, packet: Packet);
    /// Answers a task.
    fn signal(&mut self, task: TaskId, signal: Signal);
    /// Reports what happened at a task or, if the task is `None`, elsewhere in the node.
    fn observe(&mut self, _: Option<TaskId>, _: Observation) {}
    /// Reports the packet that a fused step passes between two tasks of the node. Only a call of the closure builds it (D207).
    fn within(&mut self, _: impl FnOnce() -> Packet) {}
}

/// The parts of a node, for a driver that puts them behind several locks.
#[derive(Clone, Debug)]
pub struct Parts {
    /// The node's table of the cell.
    pub table: NodeTable,
    /// The communication tasks, ascending by task.
    pub tasks: Box<[CommTask]>,
    /// The node's transit buffer.
    pub transit: Transit,
    /// The node's Timer.
    pub timer: Timer,
}

/// A node.
#[derive(Clone, Debug)]
pub struct Node {
    parts: Parts,
    /// The time of the last input. Each part has its own clock. It may show an earlier time, because it stops while
    /// [`counts`](Self::counts) is false.
    now: Instant,
    /// Pending effects within the node, in order. Empty after each [`step`](Self::step).
    work: VecDeque<Work>,
}

/// Preallocated room for the effects of one input: every copy of a message to 64 members, and their answers.
const WORK: usize = 256;

impl Node {
    /// The node of `table` in this incarnation. `restarted`: whether an earlier incarnation may have run.
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
        Self { parts, now: Instant::START, work: VecDeque::with_capacity(room) }
    }

    /// Takes the node apart into its parts.
    #[must_use]
    pub fn into_parts(self) -> Parts {
        self.parts
    }

    /// The node's parts, read-only.
    #[must_use]
    pub const fn parts(&self) -> &Parts {
        &self.parts
    }

    /// The node's parts, for code that packs or reads states, or shifts their times.
    pub const fn parts_mut(&mut self) -> &mut Parts {
        &mut self.parts
    }

    /// A communication task of this node.
    #[must_use]
    pub fn task(&self, task: TaskId) -> Option<&CommTask> {
        self.parts.tasks.get(self.parts.table.place(task)?)
    }

    /// The time of the last input that the node has taken.
    #[must_use]
    pub const fn now(&self) -> Instant {
        self.now
    }

    /// Takes one input at `now` and carries out all its effects within the node. Timers and expiries that are
    /// due by `now` happen first. A `now` before the last one counts as no elapsed time (D42).
    pub fn step(&mut self, now: Instant, input: NodeInput, out: &mut impl NodeOutbox) {
        if let NodeInput::Request(task, request) = &input {
            if now > self.now {
                self.step(now, NodeInput::Time, out);
            }
            if self.fuse(*task, request, out) {
                // The fused step adds no packet to the transit buffer, but a link may be ready now for packets that wait there.
                if !self.parts.transit.is_empty() {
                    self.flush(out);
                }
                return;
            }
        }
        self.small_steps(now, input, out);
    }

    /// Like [`step`](Self::step), but never combines small steps into a fused step, because a checker explores each small step.
    pub fn small_steps(&mut self, now: Instant, input: NodeInput, out: &mut impl NodeOutbox) {
        self.begin(now, input, out);
        while let Some(work) = self.work.pop_front() {
            // A packet that is alone in the queue goes straight to its task: nothing observes the steps in between.
            if let Work::Route(packet) = work
                && self.work.is_empty()
                && let Some(place) = self.parts.table.place(packet.destination)
            {
                self.hand_at(place, Ticks::ZERO, &Input::Packet(packet), out);
            } else {
                self.carry_out(work, out);
            }
        }
        if !self.parts.transit.is_empty() {
            self.flush(out);
        }
    }

    /// As [`step`](Self::step), but leaves the effects pending for a checker (`orders`, D39). Time passes for all parts at once.
    pub fn begin(&mut self, now: Instant, input: NodeInput, out: &mut impl NodeOutbox) {
        if now > self.now && input != NodeInput::Time {
            self.step(now, NodeInput::Time, out);
        }
        match input {
            NodeInput::Time => self.pass(now, out),
            NodeInput::Request(task, request) => self.hand_to(task, &Input::Request(request), out),
            NodeInput::Packet { from, packet, charge } => self.arrive(from, packet, charge, out),
            NodeInput::Unsent(task, id) => self.work.push_back(Work::Task(task, Input::Unsent(id))),
            NodeInput::PeerRestarted(node) => {
                for i in 0..self.parts.tasks.len() {
                    let task = self.parts.tasks[i].task();
                    self.work.push_back(Work::Task(task, Input::PeerRestarted(node)));
                }
            }
        }
    }

    /// Whether effects within the node are pending.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        !self.work.is_empty()
    }

    /// The packets among the pending effects.
    pub fn work_packets(&self) -> impl Iterator<Item = &Packet> {
        self.work.iter().filter_map(|work| match work {
            Work::Route(packet) | Work::Task(_, Input::Packet(packet)) => Some(packet),
            #[cfg(feature = "checker")]
            Work::Pass(..) => None,
            Work::Task(..) | Work::Arm(..) | Work::Disarm(..) => None,
        })
    }

    /// Whether the node's clock runs (D22). Under the blocking reading of Figure 3 the Timer waits until every task answers
    /// its JOB_REQUEST. A working task does not answer, so no CLICK reaches the node's communication tasks.
    #[must_use]
    pub fn counts(&self) -> bool {
        match self.parts.table.rules().job_request {
            JobRequest::Standing => true,
            JobRequest::Blocking => !self.parts.tasks.iter().any(CommTask::is_working),
        }
    }

    /// How long from [`now`](Self::now) until time alone makes this node act; `None`: it never does.
    #[must_use]
    pub fn time_left(&self) -> Option<Ticks> {
        self.times_left().reduce(Ticks::min)
    }

    /// For each part of this node that has a deadline: how long from [`now`](Self::now) until time alone makes the part act.
    pub fn times_left(&self) -> impl Iterator<Item = Ticks> {
        let Parts { table: _, tasks, transit, timer } = &self.parts;
        let tasks = tasks.iter().map(|task| task.next_deadline() - task.now());
        let others = [transit.next_deadline() - transit.now(), timer.next_deadline() - timer.now()];
        tasks.chain(others).filter(|&left| left != Ticks::FAR)
    }

    /// Sends the waiting packets, most urgent first, as far as the links take them (§5.2.3).
    pub fn flush(&mut self, out: &mut impl NodeOutbox) {
        while let Some((next, packet)) = self.parts.transit.next(|next| out.ready(next)) {
            out.link(next, packet);
        }
    }

    fn pass(&mut self, now: Instant, out: &mut impl NodeOutbox) {
        let Some(elapsed) = self.begin_time(now, out) else { return };
        // Time passes in all tasks before any of their packets is delivered: a message must not be charged for time before
        // it was sent.
        let Parts { table, tasks, .. } = &mut self.parts;
        for task in tasks {
            let effects = &mut TaskEffects { task: task.task(), work: &mut self.work, out };
            task.handle(table, task.now() + elapsed, &Input::Time, effects);
        }
        self.empty(out);
        self.pass_in_timer(elapsed);
    }

    /// Advances the node's time and the transit buffer. Returns the elapsed time, or `None` if the clock does not run.
    fn begin_time(&mut self, now: Instant, out: &mut impl NodeOutbox) -> Option<Ticks> {
        let elapsed = now - self.now;
        self.now += elapsed;
        if !self.counts() {
            return None;
        }
        // Time passes in the transit buffer first: a task whose time_out ends now must know whether its packet ever left.
        self.with_transit(out, |transit, table, effects| {
            transit.advance(table, transit.now() + elapsed, effects);
        });
        self.empty(out);
        Some(elapsed)
    }

    fn pass_in_timer(&mut self, elapsed: Ticks) {
        let (timer, work) = (&mut self.parts.timer, &mut self.work);
        timer.advance(timer.now() + elapsed, |task, id, turn| {
            work.push_back(Work::Task(task, Input::TimeOut { id, turn }));
        });
    }

    /// Carries out all pending effects, and the effects that follow from them.
    fn empty(&mut self, out: &mut impl NodeOutbox) {
        while let Some(work) = self.work.pop_front() {
            self.carry_out(work, out);
        }
    }

    fn arrive(&mut self, from: NodeId, packet: Packet, charge: Ticks, out: &mut impl NodeOutbox) {
        match route::arrived(&self.parts.table, from, packet, charge) {
            Arrival::Local(task, packet) => self.work.push_back(Work::Task(task, Input::Packet(packet))),
            Arrival::Relay(packet) => self.work.push_back(Work::Route(packet)),
            Arrival::Discard(reason, packet) => out.observe(None, discarded(reason, &packet)),
        }
    }

    fn hand_to(&mut self, task: TaskId, input: &Input, out: &mut impl NodeOutbox) {
        if let Some(place) = self.parts.table.place(task) {
            self.hand_at(place, Ticks::ZERO, input, out);
        }
    }

    /// Advances the clock of the task at position `place` by `elapsed`, then hands it the input.
    fn hand_at(&mut self, place: usize, elapsed: Ticks, input: &Input, out: &mut impl NodeOutbox) {
        let comm_task = &mut self.parts.tasks[place];
        let effects = &mut TaskEffects { task: comm_task.task(), work: &mut self.work, out };
        comm_task.handle(&self.parts.table, comm_task.now() + elapsed, input, effects);
    }

    fn carry_out(&mut self, work: Work, out: &mut impl NodeOutbox) {
        match work {
            Work::Task(task, input) => self.hand_to(task, &input, out),
            #[cfg(feature = "checker")]
            Work::Pass(task, elapsed) => {
                if let Some(place) = self.parts.table.place(task) {
                    self.hand_at(place, elapsed, &Input::Time, out);
                }
            }
            Work::Route(packet) if self.parts.table.place(packet.destination).is_some() => {
                self.work.push_back(Work::Task(packet.destination, Input::Packet(packet)));
            }
            Work::Route(packet) => {
                self.with_transit(out, |transit, table, effects| transit.offer(table, packet, effects));
            }
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
