//! The step context of a communication task: what its parts work with during one input, and the outbox for effects.

use super::counts::Counts;
use super::own::Own;
use crate::ids::{MessageId, PortId, TaskId};
use crate::observe::{Event, Observation, Reason};
use crate::packet::Packet;
use crate::request::{Signal, TimeId};
use crate::rules::TimeStamp;
use crate::table::NodeTable;
use crate::ticks::{Instant, Ticks};

/// The receiver of the effects of [`CommTask::handle`](crate::CommTask::handle). A driver carries them out after `handle` has
/// returned.
pub trait Outbox {
    /// Whether the outbox takes the packets of a rendezvous. If not, the task makes none: in a fused step the members need no
    /// packets.
    const TRANSMITS: bool = true;

    /// Hands a packet of the task to the route layer.
    fn transmit(&mut self, packet: Packet);
    /// Gives the task a signal.
    fn signal(&mut self, signal: Signal);
    /// Arms an entry of the node's Timer. When the entry ends, the Timer reports it with this `turn`.
    fn arm(&mut self, id: TimeId, turn: u8, length: Ticks);
    /// Disarms an entry of the node's Timer.
    fn disarm(&mut self, id: TimeId);
    /// Records an observation.
    fn observe(&mut self, observation: Observation) {
        let _ = observation;
    }
}

/// The step context: the cell's table, the task's shared state, and the outbox.
pub(crate) struct Step<'a, O> {
    pub table: &'a NodeTable,
    pub own: &'a mut Own,
    pub out: &'a mut O,
}

impl<O: Outbox> Step<'_, O> {
    pub fn now(&self) -> Instant {
        self.own.now
    }

    /// Emits an observation about a message.
    pub fn note(&mut self, event: Event, port: PortId, peer: TaskId, id: MessageId, remaining: Ticks) {
        self.out.observe(Observation::of(event, port, peer, id, remaining));
    }

    /// Changes the counters of the endpoint at this position.
    pub fn count(&mut self, endpoint: u16, count: impl FnOnce(&mut Counts)) {
        if let Some(endpoint) = self.own.endpoints.get_mut(usize::from(endpoint)) {
            count(&mut endpoint.counters);
        }
    }

    /// Takes the id for the task's next message, and advances the sequence.
    pub fn next_id(&mut self) -> MessageId {
        let id = self.own.coming_id();
        self.own.next_sequence = id.sequence.next();
        id
    }

    /// The time that a packet carries: the message's remaining time (§5.1), or, under the rule variant with absolute times, an
    /// instant on this node's clock.
    pub fn stamp(&self, ttl: Ticks) -> Ticks {
        match self.table.rules().time_stamp {
            TimeStamp::Remaining => ttl,
            TimeStamp::Absolute => (self.own.now + ttl) - Instant::START,
        }
    }

    pub fn duplicate(&mut self, endpoint: u16, packet: &Packet) {
        self.count(endpoint, |c| c.duplicates += 1);
        let event = Event::Discarded(Reason::Duplicate);
        self.note(event, packet.port, packet.source, packet.id, packet.remaining);
    }

    pub fn drop_packet(&mut self, endpoint: u16, packet: &Packet, reason: Reason) {
        self.count(endpoint, |c| c.dropped += 1);
        self.note(Event::Discarded(reason), packet.port, packet.source, packet.id, packet.remaining);
    }
}
