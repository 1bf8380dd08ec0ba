//! The transit buffer of the route layer behind its lock, and how packets get from the buffer to the link (§5.2.3, D19).
//!
//! One thread at a time sends. Any other thread leaves its packets in the buffer and goes on. So packets reach the link in order
//! of urgency, many packets for one neighbour leave together, and no thread waits for another one's syscall.

use crate::clock::{self, Micros};
use crate::link::Link;
use crate::node::effects::{Effect, Effects, Stamped};
use crate::node::local_task::LocalTasks;
use crate::observe::ring::Ring;
use crate::sync::alarm::Alarm;
use crate::sync::combining_lock::CombiningLock;
use crate::sync::{AtomicU64, Mutex, Ordering, lock};
use imrs_protocol::{
    Input, Instant, MessageId, NodeId, NodeTable, Observation, Packet, RouteOutbox, TaskId, Ticks, Transit,
    TransitView,
};
use imrs_wire::envelope::MAX_PACKETS;
use std::sync::Arc;

pub(crate) struct Dispatch {
    table: NodeTable,
    link: Option<Arc<dyn Link>>,
    /// The most packets that one call hands to the link, and that a thread gathers for such a call.
    pub at_once: usize,
    locals: Arc<LocalTasks>,
    alarm: Arc<Alarm>,
    slot: usize,
    buffer: Mutex<Buffer>,
    sender: CombiningLock<Box<[Batch]>>,
    sent: Box<[(NodeId, AtomicU64)]>,
}

struct Buffer {
    transit: Transit,
    ring: Ring,
}

/// The packets that leave for one neighbour next.
struct Batch {
    next: NodeId,
    packets: Vec<Packet>,
    /// How many packets the link takes now; zero while the link is not ready for this neighbour.
    most: usize,
}

impl Dispatch {
    pub fn new(
        table: NodeTable,
        transit: Transit,
        link: Option<Arc<dyn Link>>,
        locals: Arc<LocalTasks>,
        alarm: Arc<Alarm>,
        now: Micros,
    ) -> Self {
        let neighbours: Vec<NodeId> = table.neighbours(table.node).collect();
        // While another thread sends, this thread puts its gathered packets into the buffer: at most a quarter of its
        // room.
        let room = (usize::from(transit.view().capacity) / 4).max(MAX_PACKETS);
        let at_once = link.as_ref().map_or(MAX_PACKETS, |link| link.at_once()).min(room);
        let batch = |&next: &NodeId| Batch { next, packets: Vec::with_capacity(at_once), most: 0 };
        let mut buffer = Buffer { transit, ring: Ring::new() };
        // The buffer is still empty: this call only sets its clock.
        buffer.advance(&table, now, &locals, &mut Effects::of_an_onlooker());
        Self {
            link,
            at_once,
            slot: locals.list.len(),
            locals,
            alarm,
            buffer: Mutex::new(buffer),
            sender: CombiningLock::new(neighbours.iter().map(batch).collect()),
            sent: neighbours.iter().map(|&next| (next, AtomicU64::new(0))).collect(),
            table,
        }
    }

    /// Lets time pass in the buffer: drops expired packets and tells their sources.
    pub fn advance(&self, now: Micros, effects: &mut Effects) {
        let mut buffer = lock(&self.buffer);
        if buffer.transit.is_empty() {
            return;
        }
        buffer.advance(&self.table, now, &self.locals, effects);
        self.publish(&buffer);
    }

    /// Lets a thread try to send again, because the link can take packets for a neighbour again.
    pub fn ready(&self) {
        self.sender.want();
    }

    /// Sends the packets that this thread has gathered, and all others that can be sent. If another thread is sending,
    /// puts the gathered packets into the buffer: the other thread checks the buffer again before it stops sending.
    pub fn pump(&self, now: Micros, effects: &mut Effects) {
        let link = self.link.as_deref();
        if !effects.leaving.is_empty() {
            let mut leaving = std::mem::take(&mut effects.leaving);
            match link.and_then(|link| self.sender.enter().map(|turn| (link, turn))) {
                Some((link, mut batches)) => self.send_once(link, &mut batches, &mut leaving, now, effects),
                None => {
                    self.offer(leaving.drain(..), effects);
                    self.sender.want();
                }
            }
            effects.leaving = leaving;
        }
        if let Some(link) = link {
            self.sender.take(|batches| self.send_once(link, batches, &mut Vec::new(), now, effects));
        }
    }

    /// Puts packets into the buffer for the sending thread, each with the time at which its remaining time was true.
    fn offer(&self, packets: impl Iterator<Item = (Micros, Packet)>, effects: &mut Effects) {
        let mut buffer = lock(&self.buffer);
        for (at, packet) in packets {
            let packet = buffer.charged(&self.table, at, packet, &self.locals, effects);
            buffer.offer(&self.table, packet, &self.locals, effects);
        }
        self.publish(&buffer);
    }

    /// The state of the buffer at an instant, and that instant.
    pub fn view(&self) -> (TransitView, Micros) {
        let buffer = lock(&self.buffer);
        (buffer.transit.view(), buffer.now())
    }

    /// How many packets went to each neighbour.
    pub fn sent(&self) -> impl Iterator<Item = (NodeId, u64)> {
        self.sent.iter().map(|(next, count)| (*next, count.load(Ordering::Relaxed)))
    }

    /// Records what happened to a packet before any state machine saw it.
    pub fn note(&self, at: Micros, observation: Observation) {
        lock(&self.buffer).ring.push(at, observation);
    }

    /// Calls `look` with the buffer's observations.
    pub fn with_ring<R>(&self, look: impl FnOnce(&mut Ring) -> R) -> R {
        look(&mut lock(&self.buffer).ring)
    }

    fn send_once(
        &self,
        link: &dyn Link,
        batches: &mut [Batch],
        leaving: &mut Vec<(Micros, Packet)>,
        now: Micros,
        effects: &mut Effects,
    ) {
        for batch in batches.iter_mut() {
            batch.most = if link.ready(batch.next) { self.at_once } else { 0 };
        }
        let popped = self.fill(batches, leaving, now, effects);
        for (batch, (_, sent)) in batches.iter_mut().zip(&self.sent) {
            if batch.packets.is_empty() {
                continue;
            }
            let full = batch.packets.len() == self.at_once;
            // The clocks are read in this order because a preemption between the two readings then makes the packets
            // look too old, never too young.
            let at = std::time::Instant::now();
            let then = clock::now().max(popped);
            let waited = Ticks(then - popped);
            batch.packets.iter_mut().for_each(|packet| packet.remaining = packet.remaining - waited);
            let taken = link.send_at(batch.next, &batch.packets, at).unwrap_or(0);
            sent.fetch_add(taken as u64, Ordering::Relaxed);
            let more = full || (taken > 0 && taken < batch.packets.len());
            if taken < batch.packets.len() {
                // The call of the link may have taken long, and other threads may have advanced the buffer meanwhile.
                self.offer(batch.packets.drain(taken..).map(|packet| (then, packet)), effects);
            }
            batch.packets.clear();
            if more {
                self.sender.want();
            }
        }
    }

    /// Takes the packets that leave now, for each neighbour the most urgent first. Returns the instant at which their
    /// remaining times are true.
    fn fill(
        &self,
        batches: &mut [Batch],
        leaving: &mut Vec<(Micros, Packet)>,
        now: Micros,
        effects: &mut Effects,
    ) -> Micros {
        let mut buffer = lock(&self.buffer);
        buffer.advance(&self.table, now, &self.locals, effects);
        // Packets bypass the buffer only if they fit into one batch: more packets could leave in another order than
        // that of urgency.
        let few = leaving.len() <= self.at_once;
        for (at, packet) in leaving.drain(..) {
            let packet = buffer.charged(&self.table, at, packet, &self.locals, effects);
            let passes =
                |next: NodeId| few && batches.iter().any(|batch| batch.next == next && batch.takes());
            let passed = buffer.pass(&self.table, packet, passes, &self.locals, effects);
            put(batches, passed);
        }
        loop {
            let takes = |next: NodeId| batches.iter().any(|batch| batch.next == next && batch.takes());
            let next = buffer.transit.next(takes);
            if !put(batches, next) {
                break;
            }
        }
        batches.iter_mut().for_each(Batch::sort);
        self.publish(&buffer);
        buffer.now()
    }

    fn publish(&self, buffer: &Buffer) {
        self.alarm.publish(self.slot, buffer.transit.next_deadline().0);
    }
}

/// Puts a packet into the batch of its neighbour. Returns whether there was a packet.
fn put(batches: &mut [Batch], packet: Option<(NodeId, Packet)>) -> bool {
    let Some((next, packet)) = packet else { return false };
    batches.iter_mut().filter(|batch| batch.next == next).for_each(|batch| batch.packets.push(packet));
    true
}

impl Batch {
    /// Sorts each datagram into the order in which the buffer would have given it out. It does not sort the whole
    /// batch. Otherwise more than 63 later messages of a source might overtake an earlier one, which would then count
    /// as already seen (D75, D129).
    fn sort(&mut self) {
        let urgency = |packet: &Packet| (packet.remaining, packet.class);
        self.packets.chunks_mut(MAX_PACKETS).for_each(|datagram| datagram.sort_by_key(urgency));
    }

    fn takes(&self) -> bool {
        self.packets.len() < self.most
    }
}

impl Buffer {
    /// The instant up to which time has passed in the buffer.
    const fn now(&self) -> Micros {
        self.transit.now().0
    }

    /// Reduces the packet's remaining time, which was true at `at`, by the time since then.
    fn charged(
        &mut self,
        table: &NodeTable,
        at: Micros,
        packet: Packet,
        locals: &LocalTasks,
        effects: &mut Effects,
    ) -> Packet {
        if at > self.now() {
            self.advance(table, at, locals, effects);
        }
        Packet { remaining: packet.remaining - (self.transit.now() - Instant(at)), ..packet }
    }

    fn pass(
        &mut self,
        table: &NodeTable,
        packet: Packet,
        ready: impl FnOnce(NodeId) -> bool,
        locals: &LocalTasks,
        effects: &mut Effects,
    ) -> Option<(NodeId, Packet)> {
        let mut out = Out { at: self.now(), ring: &mut self.ring, locals, effects };
        self.transit.pass(table, packet, ready, &mut out)
    }

    fn advance(&mut self, table: &NodeTable, now: Micros, locals: &LocalTasks, effects: &mut Effects) {
        let mut out = Out { at: self.now().max(now), ring: &mut self.ring, locals, effects };
        self.transit.advance(table, Instant(now), &mut out);
    }

    fn offer(&mut self, table: &NodeTable, packet: Packet, locals: &LocalTasks, effects: &mut Effects) {
        let mut out = Out { at: self.now(), ring: &mut self.ring, locals, effects };
        self.transit.offer(table, packet, &mut out);
    }
}

struct Out<'a> {
    at: Micros,
    ring: &'a mut Ring,
    locals: &'a LocalTasks,
    effects: &'a mut Effects,
}

impl RouteOutbox for Out<'_> {
    /// The report goes into the task's inbox before the buffer's lock is released. A task whose time_out is due
    /// advances the buffer first, so it finds the report whichever thread dropped the packet. Because of its stamp 0,
    /// the report comes before the decision on that time_out.
    fn unsent(&mut self, task: TaskId, id: MessageId) {
        let stamped = Stamped { at: 0, input: Input::Unsent(id) };
        let Some(local) = self.locals.of(task) else { return };
        let effect = match local.leave(stamped) {
            Ok(()) => Effect::Wake(task),
            Err(stamped) => Effect::Feed(task, stamped),
        };
        self.effects.queue.push_back(effect);
    }

    fn transmit(&mut self, packet: Packet) {
        self.effects.queue.push_back(Effect::Transmit(self.at, packet));
    }

    fn observe(&mut self, observation: Observation) {
        self.ring.push(self.at, observation);
    }
}
