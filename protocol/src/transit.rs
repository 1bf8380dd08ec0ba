//! The transit buffer and message scheduling of the route layer (§5.1.1, §5.2.3): one per node, the smallest time_out
//! first, emptied by [`Transit::next`] whenever a link can take a packet.
//!
//! The words of a refusal (D19) wait in places of their own: where they had to find room among the messages, a full
//! buffer could never say that it is full, or would drop one command to tell of another (D79).

use crate::comm_task::{Frame, Overflow};
use crate::ids::{MessageId, NodeId, TaskId};
use crate::mapping;
use crate::observe::{Event, Observation, Reason, TransitView};
use crate::packed::{Eye, Pen};
use crate::packet::{Class, Control, Kind, Packet};
use crate::queue::{Queue, Slot};
use crate::request::ReplyTo;
use crate::route::{self, Departure};
use crate::rules::Eviction;
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

/// How many words of a refusal wait at most.
const WORDS: u16 = 4;

/// The transit buffer of one node.
#[derive(Clone, Debug)]
pub struct Transit {
    now: Ticks,
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
            now: Ticks::ZERO,
            arrivals: 0,
            queue: Queue::new(capacity),
            words: Queue::new(capacity.min(WORDS)),
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
        if packet.control() == Some(Control::RefusedOnTheWay) && packet.kind == Kind::Control {
            // One word too many is one that its source never hears: D66 leaves its command to the time_out.
            if self.words.push(key, waiting).is_err() {
                self.discard(table, &packet, Reason::Refused, out);
            }
            return;
        }
        if self.queue.push(key, waiting).is_ok() {
            return;
        }
        let Some(slot) = self.victim(table, key, &waiting) else {
            return self.discard(table, &packet, Reason::Refused, out);
        };
        if let Some(evicted) = self.queue.remove(slot) {
            self.discard(table, &evicted.left(self.now), Reason::Evicted, out);
        }
        let _ = self.queue.push(key, waiting);
    }

    /// Which held packet makes room for a newcomer; `None`: the newcomer itself goes.
    fn victim(&self, table: &NodeTable, key: u128, newcomer: &Waiting) -> Option<Slot> {
        if table.rules().eviction == Eviction::ByTime {
            // The literal reading of §III: time_out alone decides.
            let least_urgent = self.queue.iter().max_by_key(|&(key, ..)| key)?;
            return (least_urgent.0 > key).then_some(least_urgent.1);
        }
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
            self.rekey(|expires| expires + elapsed);
        }
        while let Some(waiting) = self.queue.pop_if(|w| w.expires <= self.now) {
            self.discard(table, &waiting.left(self.now), Reason::ExpiredInTransit, out);
        }
        while let Some(word) = self.words.pop_if(|w| w.expires <= self.now) {
            self.discard(table, &word.left(self.now), Reason::ExpiredInTransit, out);
        }
    }

    fn rekey(&mut self, expires: impl Fn(Ticks) -> Ticks) {
        for queue in [&mut self.queue, &mut self.words] {
            queue.rekey(|old, waiting| {
                waiting.expires = expires(waiting.expires);
                (old & u128::from(u64::MAX)) | (u128::from(waiting.expires.0) << 64)
            });
        }
    }

    /// Takes out the most urgent packet whose link is ready, with its residence here charged.
    pub fn next(&mut self, mut ready: impl FnMut(NodeId) -> bool) -> Option<(NodeId, Packet)> {
        let message = open(&self.queue, &mut ready);
        let word = open(&self.words, &mut ready);
        let waiting = match (message, word) {
            (None, None) => return None,
            // Of equal urgency the word goes first: which of the two came first is in no packed state.
            (message, Some((key, slot))) if message.is_none_or(|(other, _)| key >> 64 <= other >> 64) => {
                self.words.remove(slot)?
            }
            (message, _) => self.queue.remove(message?.1)?,
        };
        self.forwarded += 1;
        Some((waiting.next, waiting.left(self.now)))
    }

    /// How long from the last `advance` until a packet expires.
    #[must_use]
    pub fn next_expiry(&self) -> Option<Ticks> {
        let firsts = self.queue.first().into_iter().chain(self.words.first());
        firsts.map(|(_, _, waiting)| waiting.expires - self.now).min()
    }

    /// The internal clock goes back to zero; behaviour does not change.
    pub fn rebase(&mut self) {
        let now = core::mem::take(&mut self.now);
        self.rekey(|expires| expires - now);
    }

    /// The waiting messages, most urgent first, with what remains of each.
    #[must_use]
    pub fn waiting(&self) -> alloc::vec::Vec<Packet> {
        self.queue.sorted().into_iter().map(|(_, _, w)| w.left(self.now)).collect()
    }

    /// The waiting words of a refusal, likewise.
    #[must_use]
    pub fn words(&self) -> alloc::vec::Vec<Packet> {
        self.words.sorted().into_iter().map(|(_, _, w)| w.left(self.now)).collect()
    }

    /// Writes the canonical bytes of what waits (D51) and returns how many.
    ///
    /// # Errors
    /// [`Overflow`] when a distance outgrows its field or `out` is too short.
    pub fn store(&self, frame: &Frame<'_>, out: &mut [u8]) -> Result<usize, Overflow> {
        let mut pen = Pen::new(out);
        // Seven bits of messages, and one that says whether words follow.
        let messages = u8::try_from(self.queue.len()).ok().filter(|&n| n < WITH_WORDS).ok_or(Overflow)?;
        pen.byte(messages | if self.words.len() > 0 { WITH_WORDS } else { 0 })?;
        if self.words.len() > 0 {
            pen.small(self.words.len())?;
        }
        let mut at = pen.at;
        for (_, _, waiting) in self.queue.sorted().into_iter().chain(self.words.sorted()) {
            at += waiting.left(self.now).store(frame, out.get_mut(at..).ok_or(Overflow)?)?;
        }
        Ok(at)
    }

    /// Reads back what waits, time relative to zero and ids as [`Packet::load`] says, and returns how many bytes it took.
    pub fn load(&mut self, table: &NodeTable, lives: bool, bytes: &[u8]) -> usize {
        let mut eye = Eye::new(bytes);
        (self.now, self.arrivals) = (Ticks::ZERO, 0);
        self.queue.clear();
        self.words.clear();
        let head = eye.byte();
        let messages = usize::from(head & !WITH_WORDS);
        let words = if head & WITH_WORDS != 0 { usize::from(eye.byte()) } else { 0 };
        let mut at = eye.at;
        for i in 0..messages + words {
            let (packet, len) = Packet::load(bytes.get(at..).unwrap_or(&[]), lives);
            at += len;
            let Departure::Link(next) = route::departing(table, &packet) else { continue };
            let waiting = Waiting { packet, expires: packet.remaining, next };
            let queue = if i < messages { &mut self.queue } else { &mut self.words };
            let _ = queue.push(key(&waiting, self.arrivals), waiting);
            self.arrivals += 1;
        }
        at
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

/// Set in the first packed byte where words of a refusal wait.
const WITH_WORDS: u8 = 0x80;

impl Waiting {
    /// The packet with its residence charged.
    fn left(&self, now: Ticks) -> Packet {
        Packet { remaining: self.expires - now, ..self.packet }
    }
}

/// The most urgent entry whose link is ready.
fn open(queue: &Queue<Waiting>, ready: &mut impl FnMut(NodeId) -> bool) -> Option<(u128, Slot)> {
    let (key, slot, first) = queue.first()?;
    if ready(first.next) {
        return Some((key, slot));
    }
    let open = queue.iter().filter(|(_, _, w)| ready(w.next));
    open.min_by_key(|&(key, ..)| key).map(|(key, slot, _)| (key, slot))
}

/// Smallest time_out first (§5.1.1), commands before status, then in order of arrival.
fn key(waiting: &Waiting, arrival: u64) -> u128 {
    let class = u128::from(waiting.packet.class == Class::Status);
    (u128::from(waiting.expires.0) << 64) | (class << 63) | u128::from(arrival & (u64::MAX >> 1))
}
