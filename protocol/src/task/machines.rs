//! The dispatcher: it hands each input to the part that the input concerns, and passes that part's results to the other
//! parts.

use super::client::Client;
use super::interrupts::{Interrupts, Offer, What};
use super::lease::Lease;
use super::own::{Own, Role, index};
use super::rendezvous::Meetings;
use super::server::{Held, Origin, Server};
use super::step::{Outbox, Step};
use super::violation::Violation;
use super::wait::{Ended, Finished, Pending};
use crate::ids::{NodeId, PortId, TaskId};
use crate::mapping;
use crate::observe::{Event, Observation, Reason};
use crate::packet::{Kind, Packet};
use crate::request::{Call, Fault, Outcome, Signal, TimeId};
use crate::table::NodeTable;
use crate::ticks::{Instant, Ticks};
use serde::{Deserialize, Serialize};

/// The parts of a communication task. Each part owns its state.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Machines {
    pub client: Client,
    pub server: Server,
    pub interrupts: Interrupts,
    pub meetings: Meetings,
    /// The lease state, if the task is the primary or the standby of a couple (D61).
    pub lease: Option<Lease>,
}

impl Machines {
    pub fn new(table: &NodeTable, own: &Own) -> Self {
        Self {
            client: Client::new(table, own),
            server: Server::new(table, own),
            interrupts: Interrupts::default(),
            meetings: Meetings::new(table, own),
            lease: Lease::new(table, own),
        }
    }

    /// Whether the task has yet to hear that it lost its lease (a fence), or that it takes over.
    fn called(&self) -> bool {
        self.lease.as_ref().is_some_and(Lease::called)
    }

    /// Whether a handler may interrupt the running activation while that activation waits.
    fn is_interruptible(&self) -> bool {
        self.interrupts.is_interruptible(false, self.called())
    }

    /// Dispatches a packet by its kind and the role of its port.
    pub fn packet(&mut self, step: &mut Step<'_, impl Outbox>, packet: &Packet) {
        let port = step.table.port(packet.port);
        let Some(ends) = port.and_then(|port| port.ends(step.own.task, packet.source)) else {
            let endpoint = step.own.place(packet.port).map_or(u16::MAX, index);
            return step.drop_packet(endpoint, packet, Reason::NotAllowed);
        };
        let (port, endpoint) = (ends.port, ends.own.place);
        let role = step.own.endpoints[usize::from(endpoint)].role;
        match (packet.kind, role) {
            (Kind::Send | Kind::Query, Role::Receives(inbox))
                if packet.kind == mapping::message_kind(port) && packet.class == port.decl.class =>
            {
                let threads = (&self.interrupts, self.called());
                let arrival = self.server.hear(step, threads, (ends, inbox), packet);
                match arrival {
                    Some(arrival) if arrival.interrupts => {
                        self.interrupt(step, arrival.origin, &arrival.held);
                    }
                    Some(arrival) => {
                        self.interrupts.end_wait();
                        self.hand_over(step, arrival.origin, &arrival.held);
                    }
                    None => {}
                }
            }
            (Kind::Reply | Kind::Response | Kind::Control, Role::Asks(request))
                if packet.kind == Kind::Control || packet.kind == mapping::answer_kind(port) =>
            {
                let ended = self.client.answer(step, (ends, request), packet);
                self.end(step, ended);
            }
            (Kind::Reply, Role::Hears) => {
                let ended = self.client.third_party(step, endpoint, packet);
                self.end(step, ended);
            }
            (Kind::Query | Kind::Response, Role::Heartbeats) => {
                let granted = self.lease.as_mut().and_then(|lease| lease.hear(step, port, packet));
                self.grant(step, granted);
            }
            (Kind::Arrive | Kind::Confirm | Kind::Abort, Role::Meets(meeting)) => {
                let ended = self.meetings.hear(step, meeting, (ends.peer, packet));
                self.end(step, ended);
            }
            (
                Kind::Send
                | Kind::Query
                | Kind::Reply
                | Kind::Response
                | Kind::Control
                | Kind::Arrive
                | Kind::Confirm
                | Kind::Abort,
                Role::Sends
                | Role::Asks(_)
                | Role::Receives(_)
                | Role::Meets(_)
                | Role::Replies
                | Role::Hears
                | Role::Heartbeats,
            ) => step.drop_packet(endpoint, packet, Reason::NotAllowed),
        }
    }

    /// Does everything that is due by the time of the step, and nothing else (§5.1.2).
    pub fn advance(&mut self, step: &mut Step<'_, impl Outbox>) {
        self.server.advance(step);
        if let Pending::Get { deadline, .. } = self.interrupts.pending()
            && deadline <= step.now()
        {
            self.interrupts.end_wait();
            step.out.signal(Signal::Nothing);
        }
        let mut from = 0;
        while let Some(request) = self.due_request(from, step.now()) {
            let ended = self.client.advance(step, request);
            self.end(step, ended);
            from = request + 1;
        }
        let mut from = 0;
        while let Some((meeting, ended)) = self.meetings.advance(step, from) {
            self.end(step, ended);
            from = meeting + 1;
        }
        let granted = self.lease.as_mut().and_then(|lease| lease.advance(step));
        self.grant(step, granted);
    }

    /// The position of the first outstanding request, from `from` on, whose time_out or retransmission is due.
    fn due_request(&self, from: u16, now: Instant) -> Option<u16> {
        self.interrupts
            .open_requests()
            .filter(|&request| request >= from && self.client.due(request) <= now)
            .min()
    }

    /// The next instant at which time alone makes the task act.
    #[inline]
    pub fn due(&self) -> Instant {
        let wait = match self.interrupts.pending() {
            Pending::Get { deadline, .. } => deadline,
            Pending::Reply(request) => self.client.due(request),
            Pending::Nothing
            | Pending::Meeting(_)
            | Pending::Delay(..)
            | Pending::Work
            | Pending::Lease
            | Pending::Boundary => Instant::NEVER,
        };
        // This is a fast path for most tasks between two inputs: only the wait of the running activation can be due.
        let quiet = self.server.is_empty() && self.meetings.are_quiet() && self.lease.is_none();
        if quiet && self.interrupts.depth() == 0 { wait } else { self.due_with(wait) }
    }

    /// The earlier of two instants: `wait`, at which the wait of the running activation ends, and the next instant at which
    /// anything else is due.
    #[inline(never)]
    fn due_with(&self, wait: Instant) -> Instant {
        // The next offer of a rejected message matters only if a handler could begin.
        let offered = self.server.has_offers() && self.is_interruptible();
        let offer = if offered { self.server.next_offer() } else { Instant::NEVER };
        let lease = self.lease.as_ref().map_or(Instant::NEVER, Lease::due);
        let waits = wait.min(offer).min(lease).min(self.server.next_end()).min(self.meetings.next_act());
        // Of the interrupted activations only those that wait for answers add a deadline: the deadline of a GET counts once
        // its activation resumes, and waitfors and the lease are already included.
        if self.interrupts.depth() == 0 {
            waits
        } else {
            self.interrupts.open_requests().map(|request| self.client.due(request)).fold(waits, Instant::min)
        }
    }

    /// Takes the report of the node's Timer that a delay or a timer has ended.
    pub fn time_is_over(&mut self, step: &mut Step<'_, impl Outbox>, (id, turn): (TimeId, u8)) {
        if self.interrupts.time_is_over(id, turn) {
            self.tell(step, &Finished::TimeOut(id));
        }
    }

    /// Notes that a node has a new incarnation.
    pub fn peer_restarted(&mut self, step: &mut Step<'_, impl Outbox>, node: NodeId) {
        self.peer_stopped(step, node);
        self.meetings.restarted(step, node);
    }

    /// Ends the outstanding requests to tasks of a node that answers none any more. An arrival of such a task still counts: the
    /// task may have been released, and its partners must be released, too.
    pub fn peer_stopped(&mut self, step: &mut Step<'_, impl Outbox>, node: NodeId) {
        while let Some(ended) = self.client.restarted(step, node) {
            self.end(step, Some(ended));
        }
    }

    /// Takes the report of a part that a wait ended.
    pub fn end(&mut self, step: &mut Step<'_, impl Outbox>, ended: Option<Ended>) {
        match ended {
            Some(Ended { wait: Some(wait), finished }) => self.conclude(step, wait, &finished),
            Some(Ended { wait: None, finished }) => self.tell(step, &finished),
            None => {}
        }
    }

    /// Lets the task act under this epoch from now on, and completes the task's request that waits for the lease. If the
    /// task has made no such request, a take-over stays a pending call, and a grant by an echo is only observed.
    fn grant(&mut self, step: &mut Step<'_, impl Outbox>, epoch: Option<u8>) {
        let Some(epoch) = epoch.filter(|_| self.interrupts.waits(Pending::Lease)) else { return };
        self.lease.as_mut().and_then(Lease::take_call);
        self.conclude(step, Pending::Lease, &Finished::Granted(epoch));
    }

    /// Ends a wait. Signals the end of the wait if the running activation waited; otherwise stores it until the waiting
    /// activation resumes.
    fn conclude(&mut self, step: &mut Step<'_, impl Outbox>, wait: Pending, finished: &Finished) {
        if self.interrupts.conclude(wait, finished) {
            self.tell(step, finished);
        }
    }

    fn tell(&mut self, step: &mut Step<'_, impl Outbox>, finished: &Finished) {
        step.out.signal(match *finished {
            Finished::Outcome(outcome) => Signal::Outcome(outcome),
            Finished::Answers(request) => {
                let (port, answers) = self.client.tell(request);
                Signal::Answers { port, answers }
            }
            Finished::Long(request) => Signal::Outcome(Outcome::Reply(self.client.tell_long(request))),
            Finished::Released { port, round, by } => Signal::Released { port, round, by },
            Finished::GaveUp { port, round, missing } => Signal::GaveUp { port, round, missing },
            Finished::TimeOut(id) => Signal::TimeOut(id),
            Finished::Granted(epoch) => Signal::Granted(epoch),
        });
    }

    /// Delivers the most urgent message that matches a GET. Returns false if there is no such message.
    pub fn serve(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        inbox: Option<u16>,
        source: Option<TaskId>,
    ) -> bool {
        let Some((origin, held)) = self.server.next(step, inbox, source) else { return false };
        self.hand_over(step, origin, &held);
        true
    }

    fn hand_over(&mut self, step: &mut Step<'_, impl Outbox>, origin: Origin, held: &Held) {
        let delivery = self.server.deliver(step, origin, held);
        step.out.signal(Signal::Message(delivery));
    }

    /// If the running activation waits, offers it everything that is due. Takes constant time while nothing is due;
    /// otherwise it visits each port and each due message.
    pub fn offer_to_waiting(&mut self, step: &mut Step<'_, impl Outbox>) {
        if self.interrupts.waits_for_nothing() {
            return;
        }
        let due_by = self.interrupts.due_by(step.now());
        let any = (self.server.has_offers() && self.server.next_offer() <= due_by)
            || self.interrupts.has_ended_timer()
            || self.called();
        if any && self.is_interruptible() {
            self.offer(step);
        }
    }

    /// Handles a point between two statements of the running activation, where a handler may begin (D15).
    pub fn boundary(&mut self, step: &mut Step<'_, impl Outbox>) {
        let open = self.interrupts.is_interruptible(true, self.called());
        if !(open && self.offer(step)) {
            step.out.signal(Signal::Accepted(0));
        }
    }

    /// Offers everything that is due to the running activation, which can be interrupted. Returns whether a handler begins.
    fn offer(&mut self, step: &mut Step<'_, impl Outbox>) -> bool {
        let message = self.server.first_offer(step.table, step.own, &self.interrupts);
        let timer = self.interrupts.first_timer(step.table, step.own);
        let lease = self.called().then_some(Offer::LEASE);
        let first = message.into_iter().chain(timer).chain(lease).min();
        self.server.reject_the_others(step, &self.interrupts);
        let Some(first) = first else { return false };
        self.server.count_bypasses(step, &self.interrupts, first.what);
        self.interrupts.note_turn(first.key.0);
        match first.what {
            What::Lease => {
                if let Some(call) = self.lease.as_mut().and_then(Lease::take_call) {
                    self.interrupts.set_atomic(false);
                    self.begin(step, (0, 0), call);
                }
            }
            What::Timer(at) => {
                let id = self.interrupts.take_timer(at);
                let rank = step.own.order.timer(id);
                self.begin(step, (rank, id.0), Call::Timer(id));
            }
            What::Message(inbox, slot) => {
                if let Some((origin, held)) = self.server.take(step.own, inbox, slot) {
                    self.interrupt(step, origin, &held);
                }
            }
        }
        true
    }

    fn begin(&mut self, step: &mut Step<'_, impl Outbox>, (rank, number): (u8, u8), call: Call) {
        self.interrupts.begin(step.own, rank);
        note_handler(step, Event::Interrupted, number);
        step.out.signal(Signal::Interrupt(call));
    }

    /// Begins the handler for a message, which interrupts the running activation.
    fn interrupt(&mut self, step: &mut Step<'_, impl Outbox>, origin: Origin, held: &Held) {
        let port = self.server.port(origin.0);
        let rank = step.own.order.rank(port, held.source);
        self.interrupts.begin(step.own, rank);
        let left = held.expires - step.now();
        step.note(Event::Interrupted, port, held.source, held.id(), left);
        let delivery = self.server.deliver(step, origin, held);
        step.out.signal(Signal::Interrupt(Call::Message(delivery)));
    }

    /// Ends a handler: the activation below resumes its wait, which may have ended meanwhile (R16).
    pub fn resume(&mut self, step: &mut Step<'_, impl Outbox>) -> Result<(), Fault> {
        let finished = self.interrupts.resume()?;
        note_handler(step, Event::Resumed, self.interrupts.depth());
        if let Some(finished) = finished {
            // The lease was granted and lost again while the handler ran, so the resumed activation goes on waiting for the
            // lease.
            if matches!(finished, Finished::Granted(_)) && !self.lease.as_ref().is_none_or(Lease::acts) {
                self.interrupts.wait(Pending::Lease);
            } else {
                self.tell(step, &finished);
            }
            return Ok(());
        }
        match self.interrupts.pending() {
            Pending::Boundary => {
                self.interrupts.end_wait();
                self.boundary(step);
            }
            Pending::Get { port, source, deadline } => {
                let inbox = port.map(|port| step.own.receiving(port)).transpose();
                if inbox.is_ok_and(|inbox| self.serve(step, inbox, source)) {
                    self.interrupts.end_wait();
                } else if deadline <= step.now() {
                    self.interrupts.end_wait();
                    step.out.signal(Signal::Nothing);
                }
            }
            Pending::Nothing
            | Pending::Reply(_)
            | Pending::Meeting(_)
            | Pending::Delay(..)
            | Pending::Lease
            | Pending::Work => {}
        }
        Ok(())
    }

    /// Checks the invariants of all parts.
    pub fn check(&self, table: &NodeTable, own: &Own) -> Result<(), Violation> {
        self.server.check(table, own, self.is_interruptible())?;
        self.interrupts.check(table, own, self.called())?;
        self.lease.iter().try_for_each(|lease| lease.check(own.now))?;
        self.client.check(own, &self.interrupts)?;
        self.meetings.check(table, own, &self.interrupts)
    }
}

/// Emits an observation about a handler.
fn note_handler(step: &mut Step<'_, impl Outbox>, event: Event, number: u8) {
    let (port, peer, number) = (PortId::NONE, step.own.task, u32::from(number));
    step.out.observe(Observation { event, port, peer, number, remaining: Ticks::ZERO });
}
