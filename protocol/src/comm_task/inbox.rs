//! The receiving end of a port at its task: the bounded_buffer (§5.1.1) and the memory of what was taken.

use super::fragments::Parts;
use super::memory::Source;
use crate::ids::{MessageId, PortId, TaskId};
use crate::packet::{Class, Contents};
use crate::queue::{Entry, Queue, Slot};
use crate::table::Port;
use crate::ticks::Ticks;
use alloc::boxed::Box;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};

/// A waiting message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Held {
    pub source: TaskId,
    pub id: MessageId,
    pub class: Class,
    /// When its life here ends, on this task's counter; of a command, with the way back taken off (D18).
    pub expires: Ticks,
    pub contents: Contents,
    /// How many packets it takes; those after the first one lie in the inbox (D28).
    pub fragments: u8,
    /// Numbers the messages of the task as they were stored.
    pub arrival: u64,
}

/// What a waiting message has been through on a port with a handler.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Aged {
    /// How often it was rejected by rank, while that counts (D58), and which rejection was the first.
    pub rejections: u8,
    pub rejected_first: u64,
    /// Before this instant it is not offered again.
    pub not_before: Ticks,
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

    fn due(&self, aged: &Aged) -> Ticks {
        aged.not_before
    }

    /// All messages of a port are of one class.
    fn yields(&self) -> bool {
        false
    }
}

/// The receiving end of a port.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Inbox {
    pub port: PortId,
    /// Where the port stands among the task's own.
    pub local: u16,
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
    /// For each slot of the queue, what comes after the first packet.
    pub bodies: Box<[Parts]>,
}

/// What happened to a message offered to a full buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Admission {
    /// It is in, in this slot.
    Kept(Slot),
    /// It is in, and this one went for it.
    Replaced(Slot, Held),
    /// It is not in.
    Turned,
}

impl Inbox {
    pub fn new(port: &Port, own: TaskId, local: u16) -> Self {
        let decl = &port.decl;
        let mut sources: Vec<Source> = port.peers(own).map(|peer| Source::new(peer, decl)).collect();
        sources.sort_unstable_by_key(|source| source.task);
        let bodies = if decl.fragments > 1 { decl.bounded_buffer } else { 0 };
        Self {
            port: port.id,
            local,
            queue: Queue::new(decl.bounded_buffer),
            handled: false,
            latest: decl.latest,
            since: 0,
            sources: sources.into(),
            bodies: (0..bodies).map(|_| Parts::new(decl.fragments)).collect(),
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
    pub fn due(&self) -> Ticks {
        let first = self.queue.first().map_or(Ticks::FAR, |(_, held)| held.expires);
        if self.bodies.is_empty() {
            return first;
        }
        let assemblies = self.sources.iter().map(|source| &source.assembly);
        assemblies.filter(|a| a.is_open()).map(|a| a.expires).fold(first, Ticks::min)
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

    /// Where a command waits. It is looked for likewise: of each source at most one waits (D75).
    pub fn find(&self, source: TaskId, id: MessageId) -> Option<Slot> {
        self.queue.iter().find(|(_, held)| held.source == source && held.id == id).map(|(slot, _)| slot)
    }

    /// Takes out a message by its source and id.
    pub fn withdraw(&mut self, source: TaskId, id: MessageId) -> Option<Held> {
        let slot = self.find(source, id)?;
        self.queue.remove(slot)
    }
}
