//! The receiver's state of one port: the bounded_buffer (§5.1.1) and the dedup entries of its sources.

use super::memory::{CommandStatus, Memory, Source};
use crate::cell::PortDecl;
use crate::ids::{Incarnation, MessageId, PortId, Seq24, TaskId};
use crate::packet::{Class, Contents};
use crate::queue::{Entry, Key, Queue, Slot};
use crate::table::Port;
use crate::task::fragments::{Assembly, Parts};
use crate::task::own::are_alike;
use crate::ticks::Instant;
use alloc::boxed::Box;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};

/// A waiting message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Held {
    pub source: TaskId,
    pub incarnation: Incarnation,
    pub sequence: Seq24,
    pub class: Class,
    /// When the message's remaining time ends, on this task's clock. For a command the link delay of the reply is subtracted
    /// (D18).
    pub expires: Instant,
    pub contents: Contents,
    /// The number of fragments of the message. The inbox stores the fragments after the first one (D28).
    pub fragments: u8,
    /// The number of the message in the order in which the task stored its messages. In a decoded state, only the order
    /// among messages of one source on one port is meaningful.
    pub arrival: u64,
}

impl Held {
    /// The message id. The two fields of the id are stored apart, because they fit into the padding of the struct.
    pub const fn id(&self) -> MessageId {
        MessageId { incarnation: self.incarnation, sequence: self.sequence }
    }
}

/// The rejections and the penalty of a waiting message, on a port with a handler.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct RetryState {
    /// The number of rejections by rank, up to the cap, and the number of the group of rejections with the first one (D58).
    pub rejections: u8,
    pub rejected_first: u64,
    /// The instant before which the message is not offered again.
    pub not_before: Instant,
}

/// The order of service within a port: earliest deadline, then commands, then the lower source, then the earlier arrival.
/// The server decides the order among ports (D14).
impl Entry for Held {
    type Side = RetryState;

    fn key(&self) -> Key {
        let class = u64::from(self.class == Class::Status);
        let source = u64::from(self.source.0);
        let arrival = self.arrival & ((1 << 47) - 1);
        (self.expires, (class << 63) | (source << 47) | arrival)
    }

    fn due(&self, retry: &RetryState) -> Instant {
        retry.not_before
    }

    /// Always false: all messages of a port have the same class, so none yields to another class.
    fn yields(&self) -> bool {
        false
    }
}

/// An inbox: the receiver's state of one port.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Inbox {
    pub port: PortId,
    /// The position of the endpoint of the inbox's port.
    pub endpoint: u16,
    pub queue: Queue<Held>,
    /// Whether the task has a handler for messages of this port (D15).
    pub handled: bool,
    /// Whether a message replaces the waiting message of the same source.
    pub latest: bool,
    /// On a port without a handler: the count of GETs over all ports at the time when the port became non-empty or was last
    /// served. On a port with a handler: how often other ports were served since that time (D58).
    pub since: u64,
    /// The dedup entries per source, ascending by task: in the order of the port's [peers](crate::table::Peer).
    pub sources: Box<[Source]>,
    /// Storage for fragments after the first, if the port's format needs any (D28).
    pub long: Option<Box<Long>>,
}

/// Storage for messages and answers of several fragments.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Long {
    /// For each slot of the queue, the fragments after the first. Empty if messages take one packet.
    bodies: Box<[Parts]>,
    /// For each source, an incomplete message. Empty if messages take one packet.
    pub assemblies: Box<[Assembly]>,
    /// For each source, the fragments of its answer after the first.
    pub answers: Box<[Parts]>,
}

impl Long {
    /// Moves the fragments of a complete message to the slot where it waits.
    pub fn keep(&mut self, (slot, source): (Slot, usize), have: u16) {
        let from = self.assemblies.get(source);
        if let (Some(body), Some(assembly)) = (self.bodies.get_mut(usize::from(slot)), from) {
            body.fill(have, assembly.contents.iter().skip(1));
        }
    }

    /// Whether the storage has the capacities of `other`.
    fn is_like(&self, other: &Self) -> bool {
        are_alike(&self.bodies, &other.bodies, Parts::has_room_of)
            && are_alike(&self.answers, &other.answers, Parts::has_room_of)
            && are_alike(&self.assemblies, &other.assemblies, Assembly::has_room_of)
    }

    pub fn new(decl: &PortDecl, sources: usize) -> Option<Box<Self>> {
        let long = decl.fragments > 1;
        let (slots, open) = if long { (decl.bounded_buffer, sources) } else { (0, 0) };
        (long || decl.answer_fragments > 1).then(|| {
            Box::new(Self {
                bodies: (0..slots).map(|_| Parts::new(decl.fragments)).collect(),
                assemblies: (0..open).map(|_| Assembly::new(decl.fragments)).collect(),
                answers: (0..sources).map(|_| Parts::new(decl.answer_fragments)).collect(),
            })
        })
    }
}

/// The result of offering a message to the buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Admission {
    /// The message is stored in this slot.
    Kept(Slot),
    /// The message is stored in this slot, and the other message was evicted for it.
    Replaced(Slot, Held),
    /// The message was refused.
    Turned,
}

impl Inbox {
    pub fn new(port: &Port, own: TaskId, endpoint: u16) -> Self {
        let decl = &port.decl;
        let mut sources: Vec<Source> = port.peers(own).map(|peer| Source::new(peer, decl)).collect();
        sources.sort_unstable_by_key(|source| source.task);
        Self {
            port: port.id,
            endpoint,
            queue: Queue::new(decl.bounded_buffer),
            handled: false,
            latest: decl.latest,
            since: 0,
            long: Long::new(decl, sources.len()),
            sources: sources.into(),
        }
    }

    /// Sets the status of a command, if the source's dedup entry is about that command.
    pub fn settle(&mut self, source: usize, id: MessageId, status: CommandStatus) {
        if let Some(dedup) = self.sources[source].command_mut()
            && dedup.id == id
        {
            dedup.status = status;
        }
    }

    /// Validates a deserialised inbox: its port, sources and capacities must be those of a new inbox.
    pub fn is_like(&self, new: &Self) -> bool {
        let long = match (&self.long, &new.long) {
            (Some(read), Some(new)) => read.is_like(new),
            (None, None) => true,
            (Some(_), None) | (None, Some(_)) => false,
        };
        let status = |memory: &Memory| matches!(memory, Memory::Status(_));
        let is = |a: &Source, b: &Source| a.task == b.task && status(&a.memory) == status(&b.memory);
        (self.port, self.endpoint, self.latest) == (new.port, new.endpoint, new.latest)
            && self.queue.is_whole(new.queue.capacity())
            && self.queue.iter().all(|(_, held)| self.source(held.source).is_some())
            && are_alike(&self.sources, &new.sources, is)
            && self.since < super::MOST
            && long
    }

    /// Whether messages of this port may take several packets.
    pub fn is_long(&self) -> bool {
        self.long.as_ref().is_some_and(|long| !long.assemblies.is_empty())
    }

    /// The fragments, after the first one, of the message in a slot; `None` if the port's messages take one packet.
    pub fn body(&self, slot: Slot) -> Option<&Parts> {
        self.long.as_ref()?.bodies.get(usize::from(slot))
    }

    /// As [`body`](Self::body), but mutable.
    #[cfg(feature = "checker")]
    pub fn body_mut(&mut self, slot: Slot) -> Option<&mut Parts> {
        self.long.as_mut()?.bodies.get_mut(usize::from(slot))
    }

    /// The incomplete message of a source, if messages may take several packets.
    pub fn assembly(&self, source: usize) -> Option<&Assembly> {
        self.long.as_ref()?.assemblies.get(source)
    }

    /// As [`assembly`](Self::assembly), but mutable.
    pub fn assembly_mut(&mut self, source: usize) -> Option<&mut Assembly> {
        self.long.as_mut()?.assemblies.get_mut(source)
    }

    /// Drops the fragments of an incomplete message. Returns whether there were any.
    pub fn close(&mut self, source: usize, id: MessageId) -> bool {
        self.assembly_mut(source).is_some_and(|assembly| assembly.close(id))
    }

    /// The fragments, after the first one, of the answer to a source; `None` if answers take one packet.
    pub fn answer(&self, source: usize) -> Option<&Parts> {
        self.long.as_ref()?.answers.get(source)
    }

    /// As [`answer`](Self::answer), but mutable.
    pub fn answer_mut(&mut self, source: usize) -> Option<&mut Parts> {
        self.long.as_mut()?.answers.get_mut(source)
    }

    /// Forgets the earlier incarnation of a source: its dedup entry and its incomplete message.
    pub fn forget(&mut self, source: usize) {
        self.sources[source].forget();
        if let Some(assembly) = self.assembly_mut(source) {
            assembly.have = 0;
        }
    }

    /// How often other ports were served since this port became non-empty or was last served. `served` is the number
    /// of GETs over all ports (D58).
    pub fn bypassed(&self, served: u64) -> u16 {
        let times = match (self.queue.len(), self.handled) {
            (0, _) => 0,
            (_, true) => self.since,
            (_, false) => served.saturating_sub(self.since),
        };
        u16::try_from(times).unwrap_or(u16::MAX)
    }

    /// Restarts the count of GETs that served other ports, because this port became non-empty or was served.
    pub fn begin(&mut self, served: u64) {
        self.since = if self.handled { 0 } else { served };
    }

    /// The position of a source in this inbox, if only the task is known. For a packet, its [ends](crate::table::Ends) give
    /// the position.
    pub fn source(&self, task: TaskId) -> Option<usize> {
        self.sources.binary_search_by_key(&task, |source| source.task).ok()
    }

    /// The next instant at which a message expires, be it complete or incomplete.
    pub fn due(&self) -> Instant {
        let first = self.queue.first().map_or(Instant::NEVER, |(_, held)| held.expires);
        let Some(long) = &self.long else { return first };
        long.assemblies.iter().filter(|a| a.is_open()).map(|a| a.expires).fold(first, Instant::min)
    }

    /// Which message is the most urgent, and when it expires: no two messages have the same number of arrival.
    pub fn front(&self) -> Option<(u64, Instant)> {
        self.queue.first().map(|(_, held)| (held.arrival, held.expires))
    }

    /// Stores a message. A full buffer evicts its least urgent message if the newcomer is more urgent; otherwise the
    /// newcomer is refused (D60).
    ///
    /// `served` is explained at [`bypassed`](Self::bypassed).
    pub fn admit(&mut self, held: Held, retry: RetryState, served: u64) -> Admission {
        if self.queue.len() == 0 {
            self.begin(served);
        }
        if let Ok(slot) = self.queue.push_with(held, retry) {
            return Admission::Kept(slot);
        }
        match self.queue.last().map(|(slot, last)| (slot, last.key())) {
            Some((slot, last)) if last > held.key() => {
                let evicted = self.queue.remove(slot);
                match (evicted, self.queue.push_with(held, retry)) {
                    (Some(evicted), Ok(slot)) => Admission::Replaced(slot, evicted),
                    (None, Ok(slot)) => Admission::Kept(slot),
                    (_, Err(_)) => Admission::Turned,
                }
            }
            Some(_) | None => Admission::Turned,
        }
    }

    /// The most urgent message of all sources, or of one source. For one source this takes a linear search.
    pub fn head(&self, source: Option<TaskId>) -> Option<(Slot, &Held)> {
        match source {
            None => self.queue.first(),
            Some(source) => {
                let of_source = self.queue.iter().filter(|(_, held)| held.source == source);
                of_source.min_by_key(|(_, held)| held.key())
            }
        }
    }

    /// The waiting message of a source, on ports where each source has at most one. This takes a linear search over at most
    /// as many messages as there are sources.
    pub fn of_source(&self, source: TaskId) -> Option<(Slot, &Held)> {
        self.queue.iter().find(|(_, held)| held.source == source)
    }

    /// The slot of a waiting command. This takes a linear search, because each source has at most one waiting command
    /// (D75). Variants that forget commands early (no residence, the literal penalty, no memory) may queue a command twice;
    /// the later copy then counts.
    pub fn find(&self, source: TaskId, id: MessageId) -> Option<Slot> {
        let alike = self.queue.iter().filter(|(_, held)| held.source == source && held.id() == id);
        alike.max_by_key(|(_, held)| held.arrival).map(|(slot, _)| slot)
    }

    /// Removes a command by its source and id.
    pub fn withdraw(&mut self, source: TaskId, id: MessageId) -> Option<Held> {
        let slot = self.find(source, id)?;
        self.queue.remove(slot)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::own::Endpoint;

    /// The memory that a receiver needs for an idle port with one source and room for one message, in either class. The
    /// heaps of the ready set take two words and two positions of this memory.
    #[test]
    fn an_idle_port_takes_at_most_256_bytes() {
        let orders = 2 * (size_of::<u64>() + size_of::<u16>());
        let parts = [
            size_of::<Endpoint>(),
            size_of::<Inbox>(),
            size_of::<Source>(),
            size_of::<Option<Held>>(),
            orders,
        ];
        assert!(parts.iter().sum::<usize>() <= 256, "{parts:?}");
    }
}
