//! The transit buffer and message scheduling of the route layer (§5.1.1, §5.2.3): one per node, the smallest time_out
//! first, emptied by [`Transit::next`] whenever a link can take a packet. What can no longer arrive in time holds up nothing
//! else: it is removed here (D83). A packet costs O(log n), n packets waiting; only while the link that the most urgent one
//! needs is busy are the others looked through.
//!
//! The words of a refusal (D19) wait in places of their own: where they had to find room among the messages, a full
//! buffer could never say that it is full, or would drop one command to tell of another (D79).

#[cfg(feature = "checker")]
mod walk;

use crate::ids::{MessageId, NodeId, TaskId};
use crate::mapping;
use crate::observe::{Event, Observation, Reason, TransitView};
use crate::packet::{Class, Control, Kind, Packet};
use crate::queue::{Entry, Queue, Slot};
use crate::route::{self, Departure};
use crate::rules::{Eviction, TimeStamp};
use crate::table::NodeTable;
use crate::ticks::{Instant, Ticks};
use alloc::vec::Vec;

/// Where the effects of the transit buffer go.
pub trait RouteOutbox {
    /// Tells a task of this node that a copy of its request was dropped before it left.
    fn unsent(&mut self, task: TaskId, id: MessageId);
    /// Hands a packet to the route layer: the word of a refusal to its source.
    fn transmit(&mut self, packet: Packet);
    /// Notes what happened.
    fn observe(&mut self, observation: Observation) {
        let _ = observation;
    }
}

#[derive(Clone, Copy, Debug)]
struct Waiting {
    packet: Packet,
    expires: Instant,
    /// When it can arrive no more: the bounds of the links ahead are taken from its life (D20).
    leave_by: Instant,
    arrival: u64,
    next: NodeId,
}

/// Smallest time_out first (§5.1.1), commands before status, then in order of arrival.
impl Entry for Waiting {
    type Side = ();

    fn key(&self) -> u128 {
        let class = u128::from(self.packet.class == Class::Status);
        (u128::from(self.expires.0) << 64) | (class << 63) | u128::from(self.arrival & (u64::MAX >> 1))
    }

    fn due(&self, (): &()) -> Instant {
        self.leave_by
    }

    fn yields(&self) -> bool {
        self.packet.class == Class::Status
    }
}

/// How many words of a refusal wait at most.
const WORDS: u16 = 4;

/// The transit buffer of one node.
#[derive(Clone, Debug)]
pub struct Transit {
    now: Instant,
    arrivals: u64,
    queue: Queue<Waiting>,
    /// Words of a refusal on their way to the source.
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

    /// How many messages wait; words of a refusal do not count.
    #[must_use]
    pub fn len(&self) -> usize {
        self.queue.len()
    }

    /// Whether a message that comes now takes the place of another, or is refused.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.queue.len() == self.queue.capacity()
    }

    /// Takes a packet in, unless it cannot arrive in time any more: what cannot is never held. On overflow (D60) status
    /// messages go first, those with most time left before others; then the newcomer is refused unless it is more urgent
    /// than the least urgent one held.
    pub fn offer(&mut self, table: &NodeTable, packet: Packet, out: &mut impl RouteOutbox) {
        let Departure::Link(next) = route::departing(table, &packet) else {
            return self.discard(table, &packet, Reason::Unroutable, out);
        };
        let waiting = self.waits(table, packet, next);
        if waiting.leave_by <= self.now {
            return self.discard(table, &packet, Reason::ExpiredInTransit, out);
        }
        if packet.control() == Some(Control::RefusedOnTheWay) && packet.kind == Kind::Control {
            // One word too many is one that its source never hears: D66 leaves its command to the time_out.
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

    /// An [`offer`](Self::offer) and a [`next`](Self::next) in one, for a packet that finds nothing waiting and a ready link:
    /// it enters no order. Any other one is offered.
    pub fn pass(
        &mut self,
        table: &NodeTable,
        packet: Packet,
        ready: impl FnOnce(NodeId) -> bool,
        out: &mut impl RouteOutbox,
    ) -> Option<(NodeId, Packet)> {
        let next = match route::departing(table, &packet) {
            Departure::Link(next) if self.is_empty() && ready(next) => next,
            Departure::Link(_) | Departure::Local(_) | Departure::Unroutable => {
                self.offer(table, packet, out);
                return None;
            }
        };
        let waiting = self.waits(table, packet, next);
        if waiting.leave_by <= self.now {
            self.discard(table, &packet, Reason::ExpiredInTransit, out);
            return None;
        }
        self.forwarded += 1;
        Some((next, waiting.left(self.now)))
    }

    /// Which held packet makes room for a newcomer; `None`: the newcomer itself goes.
    fn victim(&mut self, table: &NodeTable, newcomer: &Waiting) -> Option<Slot> {
        if table.rules().eviction == Eviction::ByTime {
            // The literal reading of §III: time_out alone decides.
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

    fn waits(&mut self, table: &NodeTable, packet: Packet, next: NodeId) -> Waiting {
        let expires = self.now + packet.remaining;
        let to = table.location(packet.destination);
        let way = to.and_then(|to| table.path_bound(table.node, to)).unwrap_or(Ticks::ZERO);
        // Under the variants the links take nothing, or what has no time left still counts.
        let answers = matches!(packet.kind, Kind::Reply | Kind::Response);
        let late = (answers && !table.rules().refuse_late_replies)
            || table.rules().time_stamp == TimeStamp::Absolute;
        let leave_by = if late || expires == Instant::NEVER { expires } else { expires - way };
        let arrival = self.arrivals;
        self.arrivals += 1;
        Waiting { packet, expires, leave_by, arrival, next }
    }

    /// It is `now`, unless it was later before: what can arrive in time no more is dropped.
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

    /// Takes out the most urgent packet whose link is ready, with its residence here charged.
    pub fn next(&mut self, mut ready: impl FnMut(NodeId) -> bool) -> Option<(NodeId, Packet)> {
        if self.is_empty() {
            return None;
        }
        let message = open(&self.queue, &mut ready);
        let word = open(&self.words, &mut ready);
        let waiting = match (message, word) {
            (None, None) => return None,
            // Of equal urgency the word goes first: which of the two came first is in no packed state.
            (message, Some((expires, slot))) if message.is_none_or(|(other, _)| expires <= other) => {
                self.words.remove(slot)?
            }
            (message, _) => self.queue.remove(message?.1)?,
        };
        self.forwarded += 1;
        Some((waiting.next, waiting.left(self.now)))
    }

    /// The time of the last `advance`.
    #[must_use]
    pub const fn now(&self) -> Instant {
        self.now
    }

    /// When the first packet can arrive in time no more.
    #[must_use]
    pub fn next_deadline(&self) -> Instant {
        self.queue.next_due().min(self.words.next_due())
    }

    /// The waiting messages, most urgent first, with what remains of each.
    #[must_use]
    pub fn waiting(&self) -> Vec<Packet> {
        self.queue.sorted().into_iter().map(|(_, w)| w.left(self.now)).collect()
    }

    /// The waiting words of a refusal, likewise.
    #[must_use]
    pub fn words(&self) -> Vec<Packet> {
        self.words.sorted().into_iter().map(|(_, w)| w.left(self.now)).collect()
    }

    /// How the buffer looks to a monitor.
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
            // D19: the source of a command hears that this copy found no space.
            let (to, word) = (mapping::reply_to(packet), Control::RefusedOnTheWay);
            out.transmit(mapping::control(to, packet.destination, word, packet.remaining));
        }
    }
}

impl Waiting {
    /// The packet with its residence charged.
    fn left(&self, now: Instant) -> Packet {
        Packet { remaining: self.expires - now, ..self.packet }
    }
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
