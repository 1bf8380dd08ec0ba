//! The transit buffer and message scheduling of the route layer (§5.1.1, §5.2.3): one per node, the smallest time_out
//! first, emptied by [`Transit::next`] whenever a link can take a packet.

use crate::ids::{MessageId, NodeId, TaskId};
use crate::mapping;
use crate::observe::{Event, Observation, Reason, TransitView};
use crate::packet::{Class, Control, Kind, Packet};
use crate::queue::{Queue, Slot};
use crate::request::ReplyTo;
use crate::route::{self, Departure};
use crate::table::NodeTable;
use crate::ticks::Ticks;

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
    expires: Ticks,
    next: NodeId,
}

/// The transit buffer of one node.
#[derive(Clone, Debug)]
pub struct Transit {
    now: Ticks,
    arrivals: u64,
    queue: Queue<Waiting>,
    forwarded: u64,
    discarded: [u64; Reason::ALL.len()],
}

impl Transit {
    /// A buffer for `capacity` packets.
    #[must_use]
    pub fn new(capacity: u16) -> Self {
        Self {
            now: Ticks::ZERO,
            arrivals: 0,
            queue: Queue::new(capacity),
            forwarded: 0,
            discarded: [0; Reason::ALL.len()],
        }
    }

    /// Whether no packet waits.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.queue.len() == 0
    }

    /// How many packets wait.
    #[must_use]
    pub fn len(&self) -> usize {
        self.queue.len()
    }

    /// Takes a packet in. On overflow (D60) what cannot arrive in time any more goes first; then status messages, those
    /// with most time left before others; then the newcomer is refused unless it is more urgent than the least urgent
    /// one held.
    pub fn offer(&mut self, table: &NodeTable, packet: Packet, out: &mut impl RouteOutbox) {
        let Departure::Link(next) = route::departing(table, &packet) else {
            return self.discard(table, &packet, Reason::Unroutable, out);
        };
        let waiting = Waiting { packet, expires: self.now + packet.remaining, next };
        let key = key(&waiting, self.arrivals);
        self.arrivals += 1;
        if self.queue.push(key, waiting).is_ok() {
            return;
        }
        let Some(slot) = self.victim(table, key, &waiting) else {
            return self.discard(table, &packet, Reason::Refused, out);
        };
        if let Some(evicted) = self.queue.remove(slot) {
            self.discard(table, &evicted.packet, Reason::Evicted, out);
        }
        let _ = self.queue.push(key, waiting);
    }

    /// Which held packet makes room for a newcomer; `None`: the newcomer itself goes.
    fn victim(&self, table: &NodeTable, key: u128, newcomer: &Waiting) -> Option<Slot> {
        if !self.can_arrive(table, newcomer) {
            return None;
        }
        let useless = self.queue.iter().find(|(_, _, w)| !self.can_arrive(table, w));
        if let Some((_, slot, _)) = useless {
            return Some(slot);
        }
        let status = self.queue.iter().filter(|(_, _, w)| w.packet.class == Class::Status);
        let last_status = status.max_by_key(|&(key, ..)| key).map(|(key, slot, _)| (key, slot));
        let status_held = last_status.is_some();
        let (last, slot) = match last_status {
            Some(status) => status,
            None if newcomer.packet.class == Class::Status => return None,
            None => self.queue.iter().max_by_key(|&(key, ..)| key).map(|(key, slot, _)| (key, slot))?,
        };
        let yields = newcomer.packet.class == Class::Command && status_held;
        (yields || last > key).then_some(slot)
    }

    /// Whether more is left than the links ahead are taken to cost (D20).
    fn can_arrive(&self, table: &NodeTable, waiting: &Waiting) -> bool {
        let to = table.location(waiting.packet.destination);
        let way = to.and_then(|to| table.path_bound(table.node, to)).unwrap_or(Ticks::ZERO);
        waiting.expires > self.now + way
    }

    /// Time passes; what has none left is dropped.
    pub fn advance(&mut self, table: &NodeTable, elapsed: Ticks, out: &mut impl RouteOutbox) {
        self.now += elapsed;
        if !table.rules().charge_residence {
            self.queue.rekey(|old, waiting| {
                waiting.expires += elapsed;
                (old & u128::from(u64::MAX)) | (u128::from(waiting.expires.0) << 64)
            });
        }
        while let Some(waiting) = self.queue.pop_if(|w| w.expires <= self.now) {
            self.discard(table, &waiting.packet, Reason::ExpiredInTransit, out);
        }
    }

    /// Takes out the most urgent packet whose link is ready, with its residence here charged.
    pub fn next(&mut self, mut ready: impl FnMut(NodeId) -> bool) -> Option<(NodeId, Packet)> {
        let (_, slot, first) = self.queue.first()?;
        let slot = if ready(first.next) {
            slot
        } else {
            let open = self.queue.iter().filter(|(_, _, w)| ready(w.next));
            open.min_by_key(|&(key, ..)| key).map(|(_, slot, _)| slot)?
        };
        let waiting = self.queue.remove(slot)?;
        self.forwarded += 1;
        Some((waiting.next, Packet { remaining: waiting.expires - self.now, ..waiting.packet }))
    }

    /// How long from the last `advance` until a packet expires.
    #[must_use]
    pub fn next_expiry(&self) -> Option<Ticks> {
        self.queue.first().map(|(_, _, waiting)| waiting.expires - self.now)
    }

    /// The internal clock goes back to zero; behaviour does not change.
    pub fn rebase(&mut self) {
        let now = core::mem::take(&mut self.now);
        self.queue.rekey(|old, waiting| {
            waiting.expires = waiting.expires - now;
            (old & u128::from(u64::MAX)) | (u128::from(waiting.expires.0) << 64)
        });
    }

    /// The waiting packets, most urgent first, with what remains of each.
    #[must_use]
    pub fn waiting(&self) -> alloc::vec::Vec<Packet> {
        let with_rest = |w: &Waiting| Packet { remaining: w.expires - self.now, ..w.packet };
        self.queue.sorted().into_iter().map(|(_, _, w)| with_rest(w)).collect()
    }

    /// How the buffer looks to a monitor.
    #[must_use]
    pub fn view(&self) -> TransitView {
        let mut next: alloc::vec::Vec<NodeId> = self.queue.iter().map(|(_, _, w)| w.next).collect();
        next.sort_unstable();
        next.dedup();
        TransitView {
            len: u16::try_from(self.queue.len()).unwrap_or(u16::MAX),
            capacity: u16::try_from(self.queue.capacity()).unwrap_or(u16::MAX),
            min_slack: self.next_expiry(),
            forwarded: self.forwarded,
            discarded: self.discarded,
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
            remaining: Ticks::ZERO,
        });
        if !matches!(packet.kind, Kind::Send | Kind::Query) || packet.class != Class::Command {
            return;
        }
        if table.location(packet.source) == Some(table.node) {
            out.unsent(packet.source, packet.id);
        }
        if reason != Reason::ExpiredInTransit {
            // D19: the source of a command hears that this copy found no space.
            let to = ReplyTo { port: packet.port, source: packet.source, id: packet.id };
            let word = Control::RefusedOnTheWay.to_contents();
            out.transmit(mapping::answer(to, packet.destination, Kind::Control, packet.remaining, word));
        }
    }
}

/// Smallest time_out first (§5.1.1), commands before status, then in order of arrival.
fn key(waiting: &Waiting, arrival: u64) -> u128 {
    let class = u128::from(waiting.packet.class == Class::Status);
    (u128::from(waiting.expires.0) << 64) | (class << 63) | u128::from(arrival & (u64::MAX >> 1))
}
