//! Judges a whole run: compares each buffer of a task with a plain list that this module keeps from the node's
//! observations.
//!
//! The search cannot judge these rules, because a single state does not hold its past. The random walks of `cell::guard`
//! and the runs of `imrs simulate` are judged from their start.
//!
//! - A message is handed over at most once, and dropped as a duplicate only after a copy of it was accepted.
//! - A GET takes the most urgent message; a full buffer loses the least urgent one.
//! - Rejections are counted one by one. Of several capped messages, the one that was rejected first goes first.
//! - A message expires only when its time is over, and the buffer holds the same messages as the list, in the same order.
//! - Encoding a packet to its 32 bytes and decoding it changes nothing, except that its remaining time is rounded down.

mod buffer;

use super::plan::CellScenario;
use super::{Effect, NodeState};
use crate::state::Violation;
use buffer::{Buffer, Waiting, buffers, cap};
use imrs_protocol::{
    CellTable, Class, CommTask, Event, HeldView, Input, MessageId, NodeInput, Observation, Packet, PortId,
    Reason, Request, ServiceOrder, TaskId, Ticks,
};
use std::sync::Arc;

/// The lists of a run, with which the nodes' buffers are compared.
#[derive(Clone, Debug)]
pub(crate) struct History {
    plan: Arc<CellScenario>,
    /// For each node, the ticks that its clock has counted since the run began.
    clocks: Vec<u64>,
    tasks: Vec<Listed>,
    /// The source and the id of the packet that is arriving.
    arriving: Option<(TaskId, MessageId)>,
    /// The number of observations so far. The next field is the number of steps. Both number the events of the run.
    events: u64,
    steps: u64,
}

/// What the lists know of a task: its order of service, its last GET and its buffers.
#[derive(Clone, Debug, Default)]
struct Listed {
    order: ServiceOrder,
    /// Whether the `order` changed in this step: counts of rejections may change with it.
    reordered: bool,
    /// The GET of this step, if there is one: its port and its source.
    get: Option<(Option<PortId>, Option<TaskId>)>,
    /// A message that was rejected before it entered a buffer: its source, its number, and the step.
    rejected: Option<(TaskId, u32, u64)>,
    buffers: Vec<Buffer>,
    /// Whether the last message for which a handler began was capped.
    capped_last: bool,
}

/// Whether a packet is the same after encoding and decoding. The search passes packets as values. Only this check encodes
/// packets, as a real link does.
fn survives(packet: &Packet, table: &CellTable) -> bool {
    let hash = |port| table.port(port).map(|port| port.hash);
    let Some(of_port) = hash(packet.port) else { return false };
    let bytes = packet.encode(table.digest(), of_port);
    let Ok(back) = Packet::decode(&bytes, table.digest(), hash) else { return false };
    // The encoding keeps 24 bits of the remaining time, and cuts a time beyond its scale (D47).
    let lost = packet.remaining.0.saturating_sub(back.remaining.0);
    let cut = packet.remaining.0 >> 42 > 0;
    let exact = back.remaining <= packet.remaining && (cut || lost <= packet.remaining.0 >> 23 | 9);
    exact && Packet { remaining: packet.remaining, ..back } == *packet
}

impl Listed {
    /// Judges a GET that takes a queued message: no other message that suits the GET may be more urgent.
    fn taken_by_get(&self, at: usize, waits: usize) -> Result<(), Violation> {
        let Some((port, source)) = self.get else { return Ok(()) };
        let (buffer, taken) = (&self.buffers[at], &self.buffers[at].waiting[waits]);
        let of_source = |one: &&Waiting| source.is_none_or(|source| one.source == source);
        if buffer.waiting.iter().filter(of_source).any(|one| one.urgency() < taken.urgency()) {
            return Err(Violation::NotMostUrgent);
        }
        if port.is_some() || source.is_some() {
            return Ok(());
        }
        // A GET over all ports must take from the port that was bypassed too often, or, if there is none, from the port
        // with the most urgent message.
        let open = || self.buffers.iter().filter(|buffer| !buffer.handled && !buffer.waiting.is_empty());
        let most = open().map(|buffer| buffer.bypassed.0).max().unwrap_or(0);
        let wrong = if most >= buffer.bypassed.1 {
            buffer.bypassed.0 < most
        } else {
            let key = |buffer: &Buffer| {
                let head = buffer.waiting.iter().min_by_key(|one| one.urgency())?;
                Some((head.expires, head.class, self.order.rank(buffer.port, head.source), buffer.port))
            };
            open().any(|other| key(other) < key(buffer))
        };
        if wrong { Err(Violation::NotMostUrgent) } else { Ok(()) }
    }

    /// Judges a handler that begins for a queued message. Messages that were capped earlier must go first, and so must
    /// messages of the same port that are due and more urgent.
    fn handler_begins(&mut self, at: usize, waits: usize, now: u64) -> Result<(), Violation> {
        let is_capped =
            |buffer: &Buffer, one: &Waiting| one.rejections >= cap(&self.order, buffer.port, one.source);
        let rank =
            |port: PortId, one: &Waiting| self.order.rank(port, one.source).saturating_sub(one.rejections);
        let (buffer, first) = (&self.buffers[at], &self.buffers[at].waiting[waits]);
        let capped = is_capped(buffer, first);
        let handled = self.buffers.iter().filter(|other| other.handled);
        let mut due = handled
            .flat_map(|other| other.waiting.iter().map(move |one| (other, one)))
            .filter(|(_, one)| one.not_before <= now);
        let before = due.any(|(other, one)| match (capped, is_capped(other, one)) {
            (true, true) => one.first_rejected < first.first_rejected,
            (false, true) => !self.capped_last && rank(other.port, one) <= rank(buffer.port, first),
            (true, false) => false,
            (false, false) => {
                let key = |one: &Waiting| (rank(buffer.port, one), one.urgency());
                other.port == buffer.port && key(one) < key(first)
            }
        });
        self.capped_last = capped;
        if before { Err(Violation::NotMostUrgent) } else { Ok(()) }
    }
}

impl History {
    pub fn new(plan: &Arc<CellScenario>, nodes: &[NodeState]) -> Self {
        let mut tasks = vec![Listed::default(); plan.tasks.len()];
        for task in nodes.iter().flat_map(|node_state| &node_state.node.parts().tasks) {
            tasks[task.task().index()].buffers = buffers(&plan.cell, task);
        }
        let clocks = vec![0; nodes.len()];
        Self { plan: Arc::clone(plan), clocks, tasks, arriving: None, events: 0, steps: 0 }
    }

    /// Forgets the lists of the tasks of a restarted node.
    pub fn forget(&mut self, node_state: &NodeState) {
        for task in &node_state.node.parts().tasks {
            let buffers = buffers(&self.plan.cell, task);
            self.tasks[task.task().index()] = Listed { buffers, ..Listed::default() };
        }
    }

    /// Called before a node takes `input`, `elapsed` ticks after its last input.
    pub fn begin(&mut self, node: usize, elapsed: Ticks, input: &NodeInput) {
        self.clocks[node] += elapsed.0;
        self.begin_anew();
        match *input {
            NodeInput::Packet { packet, .. } => self.arriving = Some((packet.source, packet.id)),
            NodeInput::Request(task, ref request) => {
                let listed = &mut self.tasks[task.index()];
                match *request {
                    Request::Order(order) => (listed.order, listed.reordered) = (order, true),
                    Request::Get { port, source, .. } => listed.get = Some((port, source)),
                    _ => {}
                }
            }
            NodeInput::Time | NodeInput::PeerRestarted(_) | NodeInput::Unsent(..) => {}
        }
    }

    /// Called before a communication task takes `input`.
    pub fn begin_input(&mut self, input: &Input) {
        self.begin_anew();
        if let Input::Packet(packet) = input {
            self.arriving = Some((packet.source, packet.id));
        }
    }

    fn begin_anew(&mut self) {
        self.arriving = None;
        for task in &mut self.tasks {
            (task.get, task.rejected) = (None, None);
        }
    }

    /// The clock of a node, as far as a task of the node has noticed the time.
    fn now(&self, node: usize, node_state: &NodeState, task: TaskId) -> u64 {
        self.clocks[node] - node_state.node.late(task).0
    }

    /// Judges a step of a node by its effects.
    ///
    /// # Errors
    /// The rule that the node's step broke.
    pub fn judge(
        &mut self,
        node: usize,
        node_state: &NodeState,
        effects: &[Effect],
    ) -> Result<(), Violation> {
        self.steps += 1;
        for effect in effects {
            match effect {
                Effect::Seen(_, Some(task), observation) => {
                    self.events += 1;
                    self.seen(node, node_state, *task, observation)?;
                }
                Effect::Sent(_, packet) if !survives(packet, &self.plan.cell) => {
                    return Err(Violation::Garbled);
                }
                Effect::Seen(_, None, _) | Effect::Sent(..) | Effect::Signalled(..) => {}
            }
        }
        node_state
            .node
            .parts()
            .tasks
            .iter()
            .try_for_each(|task| self.compare(self.now(node, node_state, task.task()), task))
    }

    fn seen(
        &mut self,
        node: usize,
        node_state: &NodeState,
        task: TaskId,
        observation: &Observation,
    ) -> Result<(), Violation> {
        let &Observation { event, port, peer, number, remaining } = observation;
        let (now, events, steps) = (self.now(node, node_state, task), self.events, self.steps);
        let plan = Arc::clone(&self.plan);
        let arriving = self.arriving.filter(|(source, id)| (*source, id.sequence.get()) == (peer, number));
        let incarnation = arriving.map_or(node_state.incarnation, |(_, id)| id.incarnation);
        let listed = &mut self.tasks[task.index()];
        let Some(at) = listed.buffers.iter().position(|buffer| buffer.port == port) else { return Ok(()) };
        let Some(declared) = plan.cell.port(port) else { return Ok(()) };
        let (class, long) = (declared.decl.class, declared.decl.fragments > 1);
        let buffer = &mut listed.buffers[at];
        let waits = buffer.position(peer, number);
        match event {
            Event::Enqueued => {
                buffer.enter(peer, incarnation);
                if waits.is_some() || buffer.heard.contains(&(peer, number)) {
                    return Err(Violation::HandedOverTwice);
                }
                buffer.taken.insert((peer, number));
                let mut one = Waiting {
                    source: peer,
                    number,
                    class,
                    expires: now + remaining.0,
                    not_before: 0,
                    arrival: events,
                    rejections: 0,
                    first_rejected: 0,
                    prolonged: true,
                };
                if let Some((.., event)) =
                    listed.rejected.take_if(|(source, of, _)| (*source, *of) == (peer, number))
                {
                    one.reject(&listed.order, port, event);
                }
                buffer.waiting.push(one);
            }
            Event::Rejected => match waits {
                Some(waits) => {
                    let one = &mut buffer.waiting[waits];
                    one.reject(&listed.order, port, steps);
                    // `compare` reads the penalty after the step. Until then the message goes before no other message.
                    one.not_before = now + 1;
                }
                None => listed.rejected = Some((peer, number, steps)),
            },
            // A message that goes to its handler on arrival does not affect queued messages.
            Event::Interrupted => {
                if let Some(waits) = waits {
                    return listed.handler_begins(at, waits, now);
                }
            }
            Event::Delivered => {
                match waits {
                    Some(waits) if !buffer.handled => listed.taken_by_get(at, waits)?,
                    Some(_) => {}
                    None => buffer.enter(peer, incarnation),
                }
                let buffer = &mut listed.buffers[at];
                buffer.waiting.retain(|one| (one.source, one.number) != (peer, number));
                buffer.taken.insert((peer, number));
                if remaining == Ticks::ZERO {
                    return Err(Violation::Stale);
                }
                if !buffer.heard.insert((peer, number)) {
                    return Err(Violation::HandedOverTwice);
                }
            }
            Event::Discarded(Reason::Duplicate) => {
                buffer.enter(peer, incarnation);
                let known = buffer.knows(peer, number, class);
                match waits {
                    Some(waits) => buffer.waiting[waits].prolonged = true,
                    None if !known && !long => return Err(Violation::FalseCopy),
                    None => {}
                }
            }
            // The list leaves out `ExpiredOnTheWay`, because a late copy of a queued message may expire in flight.
            Event::Discarded(
                reason @ (Reason::Expired
                | Reason::Evicted
                | Reason::Refused
                | Reason::Superseded
                | Reason::StaleEpoch),
            ) => {
                let lost = waits.map(|waits| buffer.waiting.remove(waits));
                let in_time = lost.is_some_and(|lost| lost.expires > now);
                match reason {
                    Reason::Expired if in_time => return Err(Violation::ExpiredEarly),
                    // A later copy of the command may have more time left, and then counts as new.
                    Reason::Expired if class == Class::Command => {
                        buffer.taken.remove(&(peer, number));
                        buffer.lapsed.insert((peer, number));
                    }
                    Reason::Evicted | Reason::Refused => {
                        let expires = lost.map_or(now + remaining.0, |lost| lost.expires);
                        let key = (expires, class, peer, lost.map_or(events, |lost| lost.arrival));
                        if buffer.waiting.iter().any(|one| one.urgency() > key) {
                            return Err(Violation::LostMoreUrgent);
                        }
                        // An evicted message may be of an earlier incarnation than the arriving packet.
                        if lost.is_none() {
                            buffer.enter(peer, incarnation);
                        }
                        buffer.taken.insert((peer, number));
                    }
                    Reason::Superseded if lost.is_none() => {
                        buffer.taken.insert((peer, number));
                    }
                    _ => {}
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Compares the buffers of a task with its lists. Then copies into the lists the values that only the buffers know.
    fn compare(&mut self, now: u64, task: &CommTask) -> Result<(), Violation> {
        let table = &self.plan.cell;
        let listed = &mut self.tasks[task.task().index()];
        let reordered = std::mem::take(&mut listed.reordered);
        for buffer in &mut listed.buffers {
            let Some(view) = task.queue_view(buffer.port, usize::MAX) else { continue };
            let literal = table.port(buffer.port).and_then(|port| port.decl.penalty);
            let literal = literal.is_some_and(|penalty| penalty.literal);
            if view.queue.len() != buffer.waiting.len() {
                return Err(Violation::BufferDiffers);
            }
            (buffer.handled, buffer.bypassed.0) = (view.handled, view.bypassed);
            buffer.bypassed.1 = view.bypass_limit;
            for held in &view.queue {
                let (source, number) = (held.entry.source, held.entry.id.sequence.get());
                let waits = buffer.position(source, number).ok_or(Violation::BufferDiffers)?;
                let one = &mut buffer.waiting[waits];
                let expires = now + held.entry.remaining.0;
                let may_grow = (one.prolonged || literal) && expires >= one.expires;
                if expires != one.expires && !may_grow {
                    return Err(Violation::BufferDiffers);
                }
                one.expires = expires;
                one.prolonged = false;
                one.not_before = now + held.back_off.0;
                if reordered || literal {
                    one.rejections = held.rejections;
                } else if one.rejections != held.rejections {
                    return Err(Violation::Miscounted);
                }
            }
            if !view.queue.is_sorted_by_key(|held: &HeldView| (held.entry.remaining, held.entry.class)) {
                return Err(Violation::BufferDiffers);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
