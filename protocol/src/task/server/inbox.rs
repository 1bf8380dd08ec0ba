//! The receiving end of a port at its task: the bounded_buffer (§5.1.1) and the memory of what was taken.

use super::memory::{Fate, Memory, Source};
use crate::cell::PortDecl;
use crate::ids::{Incarnation, MessageId, PortId, Seq24, TaskId};
use crate::packet::{Class, Contents};
use crate::queue::{Entry, Queue, Slot};
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
    /// When its life here ends, on this task's counter; of a command, with the way back taken off (D18).
    pub expires: Instant,
    pub contents: Contents,
    /// How many packets it takes; those after the first one lie in the inbox (D28).
    pub fragments: u8,
    /// Numbers the messages of the task as they were stored. In a state that was read back only the order among those of one
    /// source on one port holds.
    pub arrival: u64,
}

impl Held {
    /// Its id. The parts of it take the room that alignment leaves between others.
    pub const fn id(&self) -> MessageId {
        MessageId { incarnation: self.incarnation, sequence: self.sequence }
    }
}

/// What a waiting message has been through on a port with a handler.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Aged {
    /// How often it was rejected by rank, while that counts (D58), and which rejection was the first.
    pub rejections: u8,
    pub rejected_first: u64,
    /// Before this instant it is not offered again.
    pub not_before: Instant,
}

/// The order of service within a port (D14): least time_out first, then commands, then the lower source, then the earlier
/// arrival. The order among ports is the user layer's.
impl Entry for Held {
    type Side = Aged;

    fn key(&self) -> u128 {
        let class = u128::from(self.class == Class::Status);
        let source = u128::from(self.source.0);
        let arrival = u128::from(self.arrival & ((1 << 47) - 1));
        (u128::from(self.expires.0) << 64) | (class << 63) | (source << 47) | arrival
    }

    fn due(&self, aged: &Aged) -> Instant {
        aged.not_before
    }

    /// All messages of a port are of one class.
    fn yields(&self) -> bool {
        false
    }
}

/// The receiving end of a port.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Inbox {
    pub port: PortId,
    /// Where the port stands among the task's own.
    pub endpoint: u16,
    pub queue: Queue<Held>,
    /// Whether the task has a handler for its messages (D15).
    pub handled: bool,
    /// Whether a message takes the place of the one of the same source that still waits.
    pub latest: bool,
    /// Since which GET over all ports this one has had something to offer, or was not served itself; of one with a handler:
    /// how often others were served meanwhile (D58).
    pub since: u64,
    /// What is remembered of each task that may send here, ascending.
    pub sources: Box<[Source]>,
    /// Room for several packets (D28), where the port's format needs it.
    pub long: Option<Box<Long>>,
}

/// Messages and answers of several packets.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Long {
    /// For each slot of the queue, what comes after the first packet; none where a message takes one.
    bodies: Box<[Parts]>,
    /// For each source, a message that is not whole yet. Likewise.
    pub assemblies: Box<[Assembly]>,
    /// For each source, what comes after the first packet of its answer.
    pub answers: Box<[Parts]>,
}

impl Long {
    /// Keeps what came after the first packet of a whole message beside the slot that has it.
    pub fn keep(&mut self, (slot, source): (Slot, usize), have: u16) {
        let from = self.assemblies.get(source);
        if let (Some(body), Some(assembly)) = (self.bodies.get_mut(usize::from(slot)), from) {
            body.fill(have, assembly.contents.iter().skip(1));
        }
    }

    /// Whether it has the room that another has.
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

/// What happened to a message offered to a full buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Admission {
    /// It is in, in this slot.
    Kept(Slot),
    /// It is in, and this one went for it.
    Replaced(Slot, Held),
    /// It is not in.
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

    /// What became of a command of a source, where it is the one that is remembered. Returns the place of the source, if it
    /// is one of the port's.
    pub fn settle(&mut self, source: TaskId, id: MessageId, fate: Fate) -> Option<usize> {
        let at = self.source(source)?;
        if let Some(remembered) = self.sources[at].command_mut()
            && remembered.id == id
        {
            remembered.fate = fate;
        }
        Some(at)
    }

    /// Whether a state that was read has the port of a new one, its sources and its room.
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

    /// Whether messages of several packets can come.
    pub fn is_long(&self) -> bool {
        self.long.as_ref().is_some_and(|long| !long.assemblies.is_empty())
    }

    /// What comes after the first packet of the message in a slot, where there is room for it.
    pub fn body(&self, slot: Slot) -> Option<&Parts> {
        self.long.as_ref()?.bodies.get(usize::from(slot))
    }

    /// See [`body`](Self::body).
    #[cfg(feature = "checker")]
    pub fn body_mut(&mut self, slot: Slot) -> Option<&mut Parts> {
        self.long.as_mut()?.bodies.get_mut(usize::from(slot))
    }

    /// The message of several packets that comes from a source, where one can.
    pub fn assembly(&self, source: usize) -> Option<&Assembly> {
        self.long.as_ref()?.assemblies.get(source)
    }

    /// See [`assembly`](Self::assembly).
    pub fn assembly_mut(&mut self, source: usize) -> Option<&mut Assembly> {
        self.long.as_mut()?.assemblies.get_mut(source)
    }

    /// Forgets the fragments of a message. Whether there were some.
    pub fn close(&mut self, source: usize, id: MessageId) -> bool {
        self.assembly_mut(source).is_some_and(|assembly| assembly.close(id))
    }

    /// What comes after the first packet of the answer to a source, where something can.
    pub fn answer(&self, source: usize) -> Option<&Parts> {
        self.long.as_ref()?.answers.get(source)
    }

    /// See [`answer`](Self::answer).
    pub fn answer_mut(&mut self, source: usize) -> Option<&mut Parts> {
        self.long.as_mut()?.answers.get_mut(source)
    }

    /// A source's node has a new life: nothing that the earlier one sent matters any more.
    pub fn forget(&mut self, source: usize) {
        self.sources[source].forget();
        if let Some(assembly) = self.assembly_mut(source) {
            assembly.have = 0;
        }
    }

    /// How many others were served since this port had something to offer, or was served itself (D58). `served` is the number
    /// of GETs over all ports that were.
    pub fn bypassed(&self, served: u64) -> u16 {
        let times = match (self.queue.len(), self.handled) {
            (0, _) => 0,
            (_, true) => self.since,
            (_, false) => served.saturating_sub(self.since),
        };
        u16::try_from(times).unwrap_or(u16::MAX)
    }

    /// It has something to offer from now on, or was served.
    pub fn begin(&mut self, served: u64) {
        self.since = if self.handled { 0 } else { served };
    }

    /// Where the memory of a source stands.
    pub fn source(&self, task: TaskId) -> Option<usize> {
        self.sources.binary_search_by_key(&task, |source| source.task).ok()
    }

    /// When time alone makes something of this port expire.
    pub fn due(&self) -> Instant {
        let first = self.queue.first().map_or(Instant::NEVER, |(_, held)| held.expires);
        let Some(long) = &self.long else { return first };
        long.assemblies.iter().filter(|a| a.is_open()).map(|a| a.expires).fold(first, Instant::min)
    }

    /// Offers a message (D60): of status messages the one with most time left goes, the newcomer included; a command
    /// is turned away unless it is more urgent than the least urgent one held.
    ///
    /// `served`: see [`bypassed`](Self::bypassed).
    pub fn admit(&mut self, held: Held, aged: Aged, served: u64) -> Admission {
        if self.queue.len() == 0 {
            self.begin(served);
        }
        if let Ok(slot) = self.queue.push_with(held, aged) {
            return Admission::Kept(slot);
        }
        match self.queue.last().map(|(slot, last)| (slot, last.key())) {
            Some((slot, last)) if last > held.key() => {
                let evicted = self.queue.remove(slot);
                match (evicted, self.queue.push_with(held, aged)) {
                    (Some(evicted), Ok(slot)) => Admission::Replaced(slot, evicted),
                    (None, Ok(slot)) => Admission::Kept(slot),
                    (_, Err(_)) => Admission::Turned,
                }
            }
            Some(_) | None => Admission::Turned,
        }
    }

    /// The most urgent message, of any source at once or of one: that is looked for.
    pub fn head(&self, source: Option<TaskId>) -> Option<(Slot, &Held)> {
        match source {
            None => self.queue.first(),
            Some(source) => {
                let of_source = self.queue.iter().filter(|(_, held)| held.source == source);
                of_source.min_by_key(|(_, held)| held.key())
            }
        }
    }

    /// The message of a source that waits, if one does: where at most one of each can. It is looked for among as many
    /// messages as there are sources.
    pub fn of_source(&self, source: TaskId) -> Option<(Slot, &Held)> {
        self.queue.iter().find(|(_, held)| held.source == source)
    }

    /// Where a command waits. It is looked for likewise: of each source at most one waits (D75). Only a variant lets one wait
    /// that was forgotten, so that it can come again (no residence, the literal penalty, no memory): then the later one is meant.
    pub fn find(&self, source: TaskId, id: MessageId) -> Option<Slot> {
        let alike = self.queue.iter().filter(|(_, held)| held.source == source && held.id() == id);
        alike.max_by_key(|(_, held)| held.arrival).map(|(slot, _)| slot)
    }

    /// Takes out a message by its source and id.
    pub fn withdraw(&mut self, source: TaskId, id: MessageId) -> Option<Held> {
        let slot = self.find(source, id)?;
        self.queue.remove(slot)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::own::Endpoint;

    /// What a port of one source takes at its receiver, whatever its class, with room for one message; two words of eight
    /// bytes and their places stand in the orders over the ports.
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
