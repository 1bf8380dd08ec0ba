//! What one run must obey: each buffer of a task beside a plain list that is written from what the node says of itself.
//!
//! A single state does not show these rules, for it does not say what came before: the search cannot judge them. Whoever follows
//! a run from its start can, as random walks (`cell::guard`) and `imrs simulate` do.
//!
//! - A message is handed over at most once, and dropped as a copy only after its first one was taken.
//! - A GET takes the most urgent message; a full buffer loses the least urgent one.
//! - Rejections are counted one by one, and of messages at their cap the one that was rejected first goes first.
//! - Only what is over expires, and the buffer holds what the list holds, in its order.

use super::plan::FloorPlan;
use super::{Effect, Station};
use crate::state::Violation;
use imrs_protocol::{
    CellTable, Class, CommTask, Event, HeldView, Incarnation, MessageId, NodeInput, Observation, PortId,
    Reason, Request, ServiceOrder, TaskId, Ticks,
};
use std::collections::BTreeSet;
use std::sync::Arc;

/// How far back a class-1 message may be and still be told from one that was seen.
const WINDOW: u32 = 64;

/// The plain lists of a floor.
#[derive(Clone, Debug)]
pub(crate) struct History {
    plan: Arc<FloorPlan>,
    /// What each node's clock has counted since the run began.
    clocks: Vec<u64>,
    tasks: Vec<Listed>,
    /// The packet that is arriving: who sent it, and its id.
    arriving: Option<(TaskId, MessageId)>,
    /// Numbers what happens in the order in which it does.
    events: u64,
}

/// A task: its order of service, its last GET and its buffers.
#[derive(Clone, Debug, Default)]
struct Listed {
    order: ServiceOrder,
    /// The order changed in this step: rejections may change with it.
    reordered: bool,
    /// The GET of this step: on which port, of which source.
    get: Option<(Option<PortId>, Option<TaskId>)>,
    /// Came in and was rejected before it was put into a buffer, and when.
    rejected: Option<(TaskId, u32, u64)>,
    buffers: Vec<Buffer>,
    /// The last handler for a message that began had one at its cap.
    capped_last: bool,
}

#[derive(Clone, Debug)]
struct Buffer {
    port: PortId,
    handled: bool,
    /// How often it was passed over, and how often it may be.
    bypassed: (u16, u16),
    waiting: Vec<Waiting>,
    /// The messages that were taken in, and those that were handed over, of the present incarnation of each source.
    taken: BTreeSet<(TaskId, u32)>,
    heard: BTreeSet<(TaskId, u32)>,
    incarnations: Vec<(TaskId, Incarnation)>,
}

#[derive(Clone, Copy, Debug)]
struct Waiting {
    source: TaskId,
    number: u32,
    class: Class,
    /// On its node's clock, as `not_before`.
    expires: u64,
    not_before: u64,
    arrival: u64,
    rejections: u8,
    first_rejected: u64,
    /// A copy came in this step, or a penalty: both may lengthen its life.
    prolonged: bool,
}

impl Waiting {
    /// The order of service within a port (D14): plainly, as the machine's key says it.
    const fn urgency(&self) -> (u64, Class, TaskId, u64) {
        (self.expires, self.class, self.source, self.arrival)
    }

    fn reject(&mut self, order: &ServiceOrder, port: PortId, event: u64) {
        if self.rejections == 0 {
            self.first_rejected = event;
        }
        self.rejections = (self.rejections + 1).min(cap(order, port, self.source));
    }
}

impl Buffer {
    fn position(&self, source: TaskId, number: u32) -> Option<usize> {
        self.waiting.iter().position(|one| (one.source, one.number) == (source, number))
    }

    /// A message of this incarnation of its source comes: what was known of an earlier one no longer counts.
    fn enter(&mut self, source: TaskId, incarnation: Incarnation) {
        match self.incarnations.iter_mut().find(|(task, _)| *task == source) {
            None => self.incarnations.push((source, incarnation)),
            Some((_, known)) if *known == incarnation => {}
            Some((_, known)) => {
                *known = incarnation;
                self.taken.retain(|(task, _)| *task != source);
                self.heard.retain(|(task, _)| *task != source);
            }
        }
    }

    /// Whether the machine may call this message one that it has seen.
    fn knows(&self, source: TaskId, number: u32, class: Class) -> bool {
        self.taken.contains(&(source, number))
            || self.taken.iter().filter(|(task, _)| *task == source).any(|&(_, newer)| match class {
                Class::Command => newer > number,
                Class::Status => newer > number + WINDOW,
            })
    }
}

/// How many rejections make a message outrank the task's own thread (D58).
fn cap(order: &ServiceOrder, port: PortId, source: TaskId) -> u8 {
    order.rank(port, source).max(1)
}

fn buffers(table: &CellTable, task: &CommTask) -> Vec<Buffer> {
    let of_port = |&port: &PortId| {
        task.queue_view(port, 0).map(|view| Buffer {
            port,
            handled: view.handled,
            bypassed: (0, view.bypass_limit),
            waiting: Vec::new(),
            taken: BTreeSet::new(),
            heard: BTreeSet::new(),
            incarnations: Vec::new(),
        })
    };
    table.ports_of(task.task()).iter().filter_map(of_port).collect()
}

impl Listed {
    /// A GET of this step takes a message that waited: nothing that it asks for is more urgent.
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
        // Over all ports: one that was passed over too often, or the one with the most urgent message.
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

    /// A message that waited begins its handler: none goes first that was rejected up to its cap earlier, and none of the
    /// same port that is due and more urgent.
    fn handler_begins(&mut self, at: usize, waits: usize, now: u64) -> Result<(), Violation> {
        let is_capped =
            |buffer: &Buffer, one: &Waiting| one.rejections >= cap(&self.order, buffer.port, one.source);
        let rank =
            |port: PortId, one: &Waiting| self.order.rank(port, one.source).saturating_sub(one.rejections);
        let (buffer, first) = (&self.buffers[at], &self.buffers[at].waiting[waits]);
        let capped = is_capped(buffer, first);
        let handled = self.buffers.iter().filter(|other| other.handled);
        let due = |other: &Buffer| {
            other.waiting.iter().filter(|one| one.not_before <= now).copied().collect::<Vec<_>>()
        };
        let before = handled.flat_map(|other| due(other).into_iter().map(move |one| (other, one))).any(
            |(other, one)| match (capped, is_capped(other, &one)) {
                (true, true) => one.first_rejected < first.first_rejected,
                (false, true) => !self.capped_last && rank(other.port, &one) <= rank(buffer.port, first),
                (true, false) => false,
                (false, false) => {
                    let key = |one: &Waiting| (rank(buffer.port, one), one.urgency());
                    other.port == buffer.port && key(&one) < key(first)
                }
            },
        );
        self.capped_last = capped;
        if before { Err(Violation::NotMostUrgent) } else { Ok(()) }
    }
}

impl History {
    pub fn new(plan: &Arc<FloorPlan>, stations: &[Station]) -> Self {
        let mut tasks = vec![Listed::default(); plan.tasks.len()];
        for task in stations.iter().flat_map(|station| &station.node.parts().tasks) {
            tasks[task.task().index()].buffers = buffers(&plan.cell, task);
        }
        let clocks = vec![0; stations.len()];
        Self { plan: Arc::clone(plan), clocks, tasks, arriving: None, events: 0 }
    }

    /// A node starts anew: what its tasks knew is gone.
    pub fn forget(&mut self, station: &Station) {
        for task in &station.node.parts().tasks {
            let buffers = buffers(&self.plan.cell, task);
            self.tasks[task.task().index()] = Listed { buffers, ..Listed::default() };
        }
    }

    /// Before a node does this.
    pub fn begin(&mut self, node: usize, input: &NodeInput) {
        self.arriving = None;
        for task in &mut self.tasks {
            (task.get, task.rejected) = (None, None);
        }
        match *input {
            NodeInput::Advance(ticks) => self.clocks[node] += ticks.0,
            NodeInput::Packet { packet, .. } => self.arriving = Some((packet.source, packet.id)),
            NodeInput::Request(task, ref request) => {
                let listed = &mut self.tasks[task.index()];
                match *request {
                    Request::Order(order) => (listed.order, listed.reordered) = (order, true),
                    Request::Get { port, source, .. } => listed.get = Some((port, source)),
                    _ => {}
                }
            }
            NodeInput::PeerRestarted(_) => {}
        }
    }

    /// After a node did something with these effects.
    ///
    /// # Errors
    /// The rule that it broke.
    pub fn judge(&mut self, node: usize, station: &Station, effects: &[Effect]) -> Result<(), Violation> {
        for effect in effects {
            if let Effect::Seen(_, Some(task), observation) = effect {
                self.events += 1;
                self.seen(node, station, *task, observation)?;
            }
        }
        station.node.parts().tasks.iter().try_for_each(|task| self.compare(node, task))
    }

    fn seen(
        &mut self,
        node: usize,
        station: &Station,
        task: TaskId,
        observation: &Observation,
    ) -> Result<(), Violation> {
        let &Observation { event, port, peer, number, remaining } = observation;
        let (now, events) = (self.clocks[node], self.events);
        let plan = Arc::clone(&self.plan);
        let arriving = self.arriving.filter(|(source, id)| (*source, id.sequence.get()) == (peer, number));
        let incarnation = arriving.map_or(station.life, |(_, id)| id.incarnation);
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
                Some(waits) => buffer.waiting[waits].reject(&listed.order, port, events),
                None => listed.rejected = Some((peer, number, events)),
            },
            Event::Interrupted => {
                if let Some(waits) = waits {
                    return listed.handler_begins(at, waits, now);
                }
                listed.capped_last = false;
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
            // A late copy of a message that waits may expire on its way.
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
                    // A later copy may have more time left: it counts as the first one.
                    Reason::Expired if class == Class::Command => {
                        buffer.taken.remove(&(peer, number));
                    }
                    Reason::Evicted | Reason::Refused => {
                        let expires = lost.map_or(now + remaining.0, |lost| lost.expires);
                        let key = (expires, class, peer, lost.map_or(events, |lost| lost.arrival));
                        if buffer.waiting.iter().any(|one| one.urgency() > key) {
                            return Err(Violation::LostMoreUrgent);
                        }
                        buffer.enter(peer, incarnation);
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

    /// The buffers of a task are what its list says, and are taken over as they are.
    fn compare(&mut self, node: usize, task: &CommTask) -> Result<(), Violation> {
        let (now, table) = (self.clocks[node], &self.plan.cell);
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
            if !view
                .queue
                .is_sorted_by_key(|held: &HeldView| (now + held.entry.remaining.0, held.entry.class))
            {
                return Err(Violation::BufferDiffers);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::floor::Floor;
    use crate::floor::plan::{Errand, TaskPlan};
    use imrs_protocol::{Cell, PortDecl, Ranked, Usage};

    const WRITER: TaskId = TaskId(0);
    const OTHER: TaskId = TaskId(1);
    const READER: TaskId = TaskId(2);

    /// Two tasks write to two ports of a third one: a class-1 port and a class-2 port.
    #[derive(Clone)]
    struct Bench {
        history: History,
        station: Station,
        ports: [PortId; 2],
    }

    impl Bench {
        fn new() -> Self {
            let mut cell = Cell::new("bench", Ticks(1));
            let node = cell.node("n");
            let [writer, other, reader] = ["writer", "other", "reader"].map(|name| cell.task(name, node));
            let senders = [writer, other];
            let port =
                |name| PortDecl::new(name, reader, Usage::Receive, &senders, Ticks(9)).bounded_buffer(3);
            let ports = [cell.port(port("state")), cell.port(port("move").command())];
            let table = Arc::new(CellTable::new(cell).expect("a cell"));
            let plan = Arc::new(FloorPlan::new(table, vec![TaskPlan::new(Errand::Rest); 3]));
            let station = Floor::new(&plan).stations.remove(0);
            let history = History::new(&plan, std::slice::from_ref(&station));
            Self { history, station, ports }
        }

        fn ask(&mut self, request: Request) -> &mut Self {
            self.history.begin(0, &NodeInput::Request(READER, request));
            self
        }

        fn wait(&mut self, ticks: u64) -> &mut Self {
            self.history.begin(0, &NodeInput::Advance(Ticks(ticks)));
            self
        }

        fn see(
            &mut self,
            event: Event,
            port: usize,
            from: TaskId,
            number: u32,
            left: u64,
        ) -> Result<(), Violation> {
            let port = self.ports[port];
            let observation = Observation { event, port, peer: from, number, remaining: Ticks(left) };
            self.history.events += 1;
            self.history.seen(0, &self.station, READER, &observation)
        }

        /// What would be said if this message were handed over next.
        fn would_take(&self, port: usize, from: TaskId, number: u32, left: u64) -> Result<(), Violation> {
            self.clone().see(Event::Delivered, port, from, number, left)
        }

        /// These messages are put into a buffer: number and time left.
        fn hold(&mut self, port: usize, from: TaskId, messages: &[(u32, u64)]) -> &mut Self {
            for &(number, left) in messages {
                self.see(Event::Enqueued, port, from, number, left).expect("a new message");
            }
            self
        }

        fn get(&mut self, port: Option<usize>, source: Option<TaskId>) -> &mut Self {
            let port = port.map(|port| self.ports[port]);
            self.ask(Request::Get { port, source, time_out: None })
        }
    }

    #[test]
    fn a_get_takes_the_most_urgent_message_of_what_it_asks_for() {
        let mut bench = Bench::new();
        bench.hold(0, WRITER, &[(1, 5), (2, 4)]).hold(0, OTHER, &[(1, 3)]).get(Some(0), None);
        let late = bench.see(Event::Delivered, 0, WRITER, 2, 4);
        assert_eq!(late, Err(Violation::NotMostUrgent));
        let mut bench = Bench::new();
        bench.hold(0, WRITER, &[(1, 5), (2, 4)]).hold(0, OTHER, &[(1, 3)]).get(Some(0), Some(WRITER));
        assert_eq!(bench.see(Event::Delivered, 0, WRITER, 2, 4), Ok(()));
    }

    #[test]
    fn of_equal_ones_the_lower_source_goes_first_and_then_the_earlier_arrival() {
        let mut bench = Bench::new();
        bench.hold(0, OTHER, &[(1, 5)]).hold(0, WRITER, &[(1, 5), (2, 5)]).get(Some(0), None);
        assert_eq!(bench.would_take(0, OTHER, 1, 5), Err(Violation::NotMostUrgent));
        assert_eq!(bench.would_take(0, WRITER, 2, 5), Err(Violation::NotMostUrgent));
        assert_eq!(bench.see(Event::Delivered, 0, WRITER, 1, 5), Ok(()));
    }

    #[test]
    fn over_all_ports_the_most_urgent_head_goes_first_or_who_was_passed_over_too_often() {
        let mut bench = Bench::new();
        bench.hold(0, WRITER, &[(1, 3)]).hold(1, OTHER, &[(1, 4)]).get(None, None);
        assert_eq!(bench.would_take(1, OTHER, 1, 4), Err(Violation::NotMostUrgent));
        let passed_over = &mut bench.history.tasks[READER.index()].buffers[1].bypassed;
        passed_over.0 = passed_over.1;
        assert_eq!(bench.would_take(1, OTHER, 1, 4), Ok(()));
        assert_eq!(bench.see(Event::Delivered, 0, WRITER, 1, 3), Err(Violation::NotMostUrgent));
    }

    #[test]
    fn a_message_is_handed_over_once() {
        let mut bench = Bench::new();
        bench.hold(1, WRITER, &[(7, 5)]);
        assert_eq!(bench.see(Event::Enqueued, 1, WRITER, 7, 5), Err(Violation::HandedOverTwice));
        assert_eq!(bench.see(Event::Delivered, 1, WRITER, 7, 5), Ok(()));
        assert_eq!(bench.see(Event::Delivered, 1, WRITER, 7, 5), Err(Violation::HandedOverTwice));
        assert_eq!(bench.see(Event::Enqueued, 1, WRITER, 7, 5), Err(Violation::HandedOverTwice));
    }

    #[test]
    fn only_what_was_taken_in_is_a_copy() {
        let copy = Event::Discarded(Reason::Duplicate);
        let mut bench = Bench::new();
        assert_eq!(bench.see(copy, 1, WRITER, 7, 5), Err(Violation::FalseCopy));
        bench.hold(1, WRITER, &[(7, 5)]);
        assert_eq!(bench.see(copy, 1, WRITER, 7, 5), Ok(()));
        assert_eq!(bench.see(copy, 1, OTHER, 7, 5), Err(Violation::FalseCopy));
        // A command that expired before anybody heard of it may come once more; a status message has been seen.
        bench.wait(5);
        assert_eq!(bench.see(Event::Discarded(Reason::Expired), 1, WRITER, 7, 0), Ok(()));
        assert_eq!(bench.see(copy, 1, WRITER, 7, 2), Err(Violation::FalseCopy));
        bench.hold(0, WRITER, &[(80, 5)]).wait(5);
        assert_eq!(bench.see(Event::Discarded(Reason::Expired), 0, WRITER, 80, 0), Ok(()));
        assert_eq!(bench.see(copy, 0, WRITER, 80, 2), Ok(()));
        // Too far back to be told from one that was seen.
        assert_eq!(bench.see(copy, 0, WRITER, 15, 2), Ok(()));
        assert_eq!(bench.see(copy, 0, WRITER, 16, 2), Err(Violation::FalseCopy));
    }

    #[test]
    fn another_incarnation_of_a_source_begins_anew() {
        let mut bench = Bench::new();
        bench.hold(1, WRITER, &[(0, 5)]);
        assert_eq!(bench.see(Event::Delivered, 1, WRITER, 0, 5), Ok(()));
        let id = MessageId { incarnation: Incarnation(1), ..MessageId::default() };
        bench.history.arriving = Some((WRITER, id));
        assert_eq!(
            bench.see(Event::Discarded(Reason::Duplicate), 1, WRITER, 0, 5),
            Err(Violation::FalseCopy)
        );
        assert_eq!(bench.see(Event::Enqueued, 1, WRITER, 0, 5), Ok(()));
    }

    #[test]
    fn what_expires_is_over_and_what_a_full_buffer_loses_is_the_least_urgent() {
        let mut bench = Bench::new();
        bench.hold(1, WRITER, &[(1, 5), (2, 4)]).wait(4);
        assert_eq!(
            bench.see(Event::Discarded(Reason::Expired), 1, WRITER, 1, 0),
            Err(Violation::ExpiredEarly)
        );
        let mut bench = Bench::new();
        bench.hold(1, WRITER, &[(1, 5), (2, 4), (3, 3)]);
        let evicted = Event::Discarded(Reason::Evicted);
        assert_eq!(bench.see(evicted, 1, WRITER, 2, 4), Err(Violation::LostMoreUrgent));
        let refused = Event::Discarded(Reason::Refused);
        assert_eq!(bench.see(refused, 1, OTHER, 4, 5), Ok(()));
        assert_eq!(bench.see(refused, 1, OTHER, 5, 2), Err(Violation::LostMoreUrgent));
    }

    #[test]
    fn a_late_copy_takes_nothing_out_of_a_buffer() {
        let mut bench = Bench::new();
        bench.hold(1, WRITER, &[(1, 5)]);
        assert_eq!(bench.see(Event::Discarded(Reason::ExpiredOnTheWay), 1, WRITER, 1, 0), Ok(()));
        assert_eq!(bench.see(Event::Discarded(Reason::Duplicate), 1, WRITER, 1, 4), Ok(()));
        assert_eq!(bench.see(Event::Delivered, 1, WRITER, 1, 5), Ok(()));
    }

    #[test]
    fn of_messages_at_their_cap_the_one_that_was_rejected_first_begins_its_handler() {
        let mut bench = Bench::new();
        let ports = bench.ports;
        let order = ServiceOrder::new(&[Ranked::Own, Ranked::Port(ports[0]), Ranked::Port(ports[1])]);
        bench.ask(Request::Order(order.expect("an order")));
        bench.hold(0, WRITER, &[(1, 9)]).hold(0, OTHER, &[(1, 8)]);
        bench.history.tasks[READER.index()].buffers[0].handled = true;
        for source in [WRITER, OTHER] {
            assert_eq!(bench.see(Event::Rejected, 0, source, 1, 8), Ok(()));
        }
        assert_eq!(bench.see(Event::Interrupted, 0, OTHER, 1, 8), Err(Violation::NotMostUrgent));
        assert_eq!(bench.see(Event::Interrupted, 0, WRITER, 1, 9), Ok(()));
    }
}
