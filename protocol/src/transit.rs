//! The transit buffer and message scheduling of the route layer (§5.1.1, §5.2.3), one per node. Whenever a link is ready,
//! [`Transit::next`] takes out the packet with the smallest remaining time. The buffer removes packets that can no longer
//! arrive in time, so that they delay no other packets (D83). While n packets wait, each operation costs O(log n). Linear
//! searches happen only while the link of the most urgent packet is busy, or when a full buffer must evict.
//!
//! Refusals (D19) wait in a small queue of their own. If they shared the space of messages, a full buffer could not report
//! that it is full, or would drop one command to report on another (D79).

#[cfg(feature = "checker")]
mod walk;

use crate::ids::{MessageId, NodeId, TaskId};
use crate::mapping;
use crate::observe::{Event, Observation, Reason, TransitView};
use crate::packet::{Class, Control, Kind, Packet};
use crate::queue::{Entry, Key, Queue, Slot};
use crate::rules::{Eviction, TimeStamp};
use crate::table::{Hop, NodeTable};
use crate::ticks::Instant;
use alloc::vec::Vec;

/// The receiver of the transit buffer's effects.
pub trait RouteOutbox {
    /// Tells a task of this node that a copy of its request was dropped before the copy left the node.
    fn unsent(&mut self, task: TaskId, id: MessageId);
    /// Hands a packet to the route layer: a refusal for the source of a command.
    fn transmit(&mut self, packet: Packet);
    /// Notes an observation about a packet.
    fn observe(&mut self, observation: Observation) {
        let _ = observation;
    }
}

#[derive(Clone, Copy, Debug)]
struct Waiting {
    packet: Packet,
    expires: Instant,
    /// The instant from which on the packet cannot arrive in time: the packet's deadline less the bounds of the links ahead
    /// (D20).
    leave_by: Instant,
    arrival: u64,
    next: NodeId,
}

/// The order of packets: smallest remaining time first (§5.1.1), then commands before status, then the order of arrival.
impl Entry for Waiting {
    type Side = ();

    fn key(&self) -> Key {
        let class = u64::from(self.packet.class == Class::Status);
        (self.expires, (class << 63) | (self.arrival & (u64::MAX >> 1)))
    }

    fn due(&self, (): &()) -> Instant {
        self.leave_by
    }

    fn yields(&self) -> bool {
        self.packet.class == Class::Status
    }
}

/// How many refusals can wait at most.
const WORDS: u16 = 4;

/// The transit buffer of one node.
#[derive(Clone, Debug)]
pub struct Transit {
    now: Instant,
    arrivals: u64,
    queue: Queue<Waiting>,
    /// The refusals for sources of commands that wait in this buffer to leave.
    words: Queue<Waiting>,
    forwarded: u64,
    discarded: [u64; Reason::ALL.len()],
}

impl Transit {
    /// A buffer for `capacity` packets.
    #[must_use]
    pub fn new(capacity: u16) -> Self {
        Self {
            now: Instant::START,
            arrivals: 0,
            queue: Queue::watched(capacity),
            words: Queue::watched(capacity.min(WORDS)),
            forwarded: 0,
            discarded: [0; Reason::ALL.len()],
        }
    }

    /// Whether no packet waits.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.queue.len() == 0 && self.words.len() == 0
    }

    /// How many messages wait; refusals do not count.
    #[must_use]
    pub fn len(&self) -> usize {
        self.queue.len()
    }

    /// Whether the buffer is full: a new message then evicts another one or is refused.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.queue.len() == self.queue.capacity()
    }

    /// Stores a packet, or drops it if it can no longer arrive in time. In a full buffer a command evicts the status
    /// message with most time left. Otherwise a newcomer evicts the least urgent packet of its own class if the newcomer is
    /// more urgent; if not, the newcomer is refused (D60).
    pub fn offer(&mut self, table: &NodeTable, packet: Packet, out: &mut impl RouteOutbox) {
        let Some(way) = table.way_to(packet.destination) else {
            return self.discard(table, &packet, Reason::Unroutable, out);
        };
        let waiting = self.waits(table, packet, way);
        if waiting.leave_by <= self.now {
            return self.discard(table, &packet, Reason::ExpiredInTransit, out);
        }
        if packet.control() == Some(Control::RefusedOnTheWay) && packet.kind == Kind::Control {
            // If there is no room, the refusal is dropped, and the refused command ends with its time_out (D66).
            if self.words.push(waiting).is_err() {
                self.discard(table, &packet, Reason::Refused, out);
            }
            return;
        }
        if self.queue.push(waiting).is_ok() {
            return;
        }
        let Some(slot) = self.victim(table, &waiting) else {
            return self.discard(table, &packet, Reason::Refused, out);
        };
        if let Some(evicted) = self.queue.remove(slot) {
            self.discard(table, &evicted.left(self.now), Reason::Evicted, out);
        }
        let _ = self.queue.push(waiting);
    }

    /// [`offer`](Self::offer) and [`next`](Self::next) in one: if the buffer is empty and the link is ready, the packet
    /// leaves without being queued. Otherwise the packet is offered.
    pub fn pass(
        &mut self,
        table: &NodeTable,
        packet: Packet,
        ready: impl FnOnce(NodeId) -> bool,
        out: &mut impl RouteOutbox,
    ) -> Option<(NodeId, Packet)> {
        let way = table.way_to(packet.destination).filter(|way| self.is_empty() && ready(way.next));
        let Some(way) = way else {
            self.offer(table, packet, out);
            return None;
        };
        let waiting = self.waits(table, packet, way);
        if waiting.leave_by <= self.now {
            self.discard(table, &packet, Reason::ExpiredInTransit, out);
            return None;
        }
        self.forwarded += 1;
        Some((way.next, waiting.left(self.now)))
    }

    /// The stored packet that is evicted for a newcomer; `None` if the newcomer is refused.
    fn victim(&mut self, table: &NodeTable, newcomer: &Waiting) -> Option<Slot> {
        if table.rules().eviction == Eviction::ByTime {
            // Under the literal reading of §III, the time_out alone decides which packet is evicted.
            let (slot, least_urgent) = self.queue.iter().max_by_key(|(_, waiting)| waiting.key())?;
            return (least_urgent.key() > newcomer.key()).then_some(slot);
        }
        let (slot, last) = self.queue.last()?;
        let goes = match (last.yields(), newcomer.yields()) {
            (true, false) => true,
            (false, true) => false,
            (true, true) | (false, false) => last.key() > newcomer.key(),
        };
        goes.then_some(slot)
    }

    fn waits(&mut self, table: &NodeTable, packet: Packet, way: Hop) -> Waiting {
        let expires = self.now + packet.remaining;
        let leave_by = leave_by(table, &packet, expires, way);
        let arrival = self.arrivals;
        self.arrivals += 1;
        Waiting { packet, expires, leave_by, arrival, next: way.next }
    }

    /// Sends all waiting packets by the routes of `table`, which replaced another table. Packets that cannot arrive in time
    /// by their new routes are dropped.
    pub fn reroute(&mut self, table: &NodeTable, out: &mut impl RouteOutbox) {
        for queue in [&mut self.queue, &mut self.words] {
            queue.change_all(|waiting, ()| {
                // This never returns, because both tables reach the same tasks.
                let Some(way) = table.way_to(waiting.packet.destination) else { return };
                waiting.next = way.next;
                waiting.leave_by = leave_by(table, &waiting.packet, waiting.expires, way);
            });
        }
        self.advance(table, self.now, out);
    }

    /// Advances the clock to `now`, never back, and drops the packets that can no longer arrive in time.
    pub fn advance(&mut self, table: &NodeTable, now: Instant, out: &mut impl RouteOutbox) {
        let elapsed = now - self.now;
        self.now += elapsed;
        if !table.rules().charge_residence {
            for queue in [&mut self.queue, &mut self.words] {
                queue.change_all(|waiting, ()| {
                    waiting.expires += elapsed;
                    waiting.leave_by += elapsed;
                });
            }
        }
        while let Some(waiting) = self.queue.pop_due(self.now) {
            self.discard(table, &waiting.left(self.now), Reason::ExpiredInTransit, out);
        }
        while let Some(word) = self.words.pop_due(self.now) {
            self.discard(table, &word.left(self.now), Reason::ExpiredInTransit, out);
        }
    }

    /// Takes out the most urgent packet whose link is ready, and charges its residence in this buffer.
    pub fn next(&mut self, mut ready: impl FnMut(NodeId) -> bool) -> Option<(NodeId, Packet)> {
        if self.is_empty() {
            return None;
        }
        let message = open(&self.queue, &mut ready);
        let word = open(&self.words, &mut ready);
        let waiting = match (message, word) {
            (None, None) => return None,
            // If the refusal and the message are equally urgent, the refusal goes first, because packed states do not
            // record which of the two arrived first.
            (message, Some((expires, slot))) if message.is_none_or(|(other, _)| expires <= other) => {
                self.words.remove(slot)?
            }
            (message, _) => self.queue.remove(message?.1)?,
        };
        self.forwarded += 1;
        Some((waiting.next, waiting.left(self.now)))
    }

    /// The buffer's clock: the time of the last `advance`.
    #[must_use]
    pub const fn now(&self) -> Instant {
        self.now
    }

    /// The next instant at which a waiting packet can no longer arrive in time.
    #[must_use]
    pub fn next_deadline(&self) -> Instant {
        self.queue.next_due().min(self.words.next_due())
    }

    /// The waiting messages, most urgent first, with their remaining times.
    #[must_use]
    pub fn waiting(&self) -> Vec<Packet> {
        self.queue.sorted().into_iter().map(|(_, w)| w.left(self.now)).collect()
    }

    /// The waiting refusals, most urgent first, with their remaining times.
    #[must_use]
    pub fn words(&self) -> Vec<Packet> {
        self.words.sorted().into_iter().map(|(_, w)| w.left(self.now)).collect()
    }

    /// The state of the buffer, as a monitor sees it.
    #[must_use]
    pub fn view(&self) -> TransitView {
        let mut next: Vec<NodeId> = self.queue.iter().map(|(_, w)| w.next).collect();
        next.sort_unstable();
        next.dedup();
        let firsts = self.queue.first().into_iter().chain(self.words.first());
        TransitView {
            len: u16::try_from(self.queue.len()).unwrap_or(u16::MAX),
            capacity: u16::try_from(self.queue.capacity()).unwrap_or(u16::MAX),
            min_slack: firsts.map(|(_, waiting)| waiting.expires - self.now).min(),
            forwarded: self.forwarded,
            discarded: self.discarded.into(),
            next,
        }
    }

    fn discard(&mut self, table: &NodeTable, packet: &Packet, reason: Reason, out: &mut impl RouteOutbox) {
        self.discarded[reason as usize] += 1;
        out.observe(Observation {
            event: Event::Discarded(reason),
            port: packet.port,
            peer: packet.destination,
            number: packet.id.sequence.get(),
            remaining: packet.remaining,
        });
        let asks = matches!(packet.kind, Kind::Send | Kind::Query);
        if !asks || packet.class != Class::Command {
            return;
        }
        if table.is_here(packet.source) {
            out.unsent(packet.source, packet.id);
        }
        if reason != Reason::ExpiredInTransit {
            // Tells the source of the command that this copy found no space (D19).
            let (to, word) = (mapping::reply_to(packet), Control::RefusedOnTheWay);
            out.transmit(mapping::control(to, packet.destination, word, packet.remaining));
        }
    }
}

impl Waiting {
    /// The packet, charged with its residence in this buffer.
    fn left(&self, now: Instant) -> Packet {
        Packet { remaining: self.expires - now, ..self.packet }
    }
}

/// The instant from which on a packet cannot arrive before it expires.
fn leave_by(table: &NodeTable, packet: &Packet, expires: Instant, way: Hop) -> Instant {
    // Two variants of the rules keep such a packet: in one links charge nothing, in the other a late reply is still
    // accepted.
    let answers = matches!(packet.kind, Kind::Reply | Kind::Response);
    let late =
        (answers && !table.rules().refuse_late_replies) || table.rules().time_stamp == TimeStamp::Absolute;
    if late || expires == Instant::NEVER { expires } else { expires - way.bound }
}

/// The most urgent entry whose link is ready.
fn open(queue: &Queue<Waiting>, ready: &mut impl FnMut(NodeId) -> bool) -> Option<(Instant, Slot)> {
    let (slot, first) = queue.first()?;
    if ready(first.next) {
        return Some((first.expires, slot));
    }
    let open = queue.iter().filter(|(_, waiting)| ready(waiting.next));
    open.min_by_key(|(_, waiting)| waiting.key()).map(|(slot, waiting)| (waiting.expires, slot))
}
