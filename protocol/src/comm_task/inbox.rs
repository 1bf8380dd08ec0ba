//! The bounded_buffer of a port at its receiving task (§5.1.1).

use crate::ids::{MessageId, PortId, TaskId};
use crate::packet::{Class, Contents};
use crate::queue::{Queue, Slot};
use crate::ticks::Ticks;
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
}

/// A port's buffer.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Inbox {
    pub port: PortId,
    pub queue: Queue<Held>,
}

/// What happened to a message offered to a full buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Admission {
    /// It is in.
    Kept,
    /// It is in, and this one went for it.
    Replaced(Held),
    /// It is not in.
    Turned,
}

impl Inbox {
    pub fn new(port: PortId, capacity: u16) -> Self {
        Self { port, queue: Queue::new(capacity) }
    }

    /// The order of service within a port (D14): least time_out first, then commands, then the lower source, then the
    /// earlier arrival. The order among ports is the user layer's.
    pub fn key(held: &Held, arrival: u64) -> u128 {
        let class = u128::from(held.class == Class::Status);
        let source = u128::from(held.source.0);
        let arrival = u128::from(arrival & ((1 << 47) - 1));
        (u128::from(held.expires.0) << 64) | (class << 63) | (source << 47) | arrival
    }

    /// The same key for a message whose expiry or source was changed: its arrival stays.
    pub fn key_again(old: u128, held: &Held) -> u128 {
        Self::key(held, u64::try_from(old & ((1 << 47) - 1)).unwrap_or(0))
    }

    /// Offers a message (D60): of status messages the one with most time left goes, the newcomer included; a command
    /// is turned away unless it is more urgent than the least urgent one held.
    pub fn admit(&mut self, held: Held, arrival: u64) -> Admission {
        let key = Self::key(&held, arrival);
        if self.queue.push(key, held).is_ok() {
            return Admission::Kept;
        }
        let last = self.queue.iter().max_by_key(|&(key, ..)| key).map(|(key, slot, _)| (key, slot));
        match last {
            Some((last_key, slot)) if last_key > key => {
                let evicted = self.queue.remove(slot);
                let _ = self.queue.push(key, held);
                evicted.map_or(Admission::Kept, Admission::Replaced)
            }
            Some(_) | None => Admission::Turned,
        }
    }

    /// The most urgent message, of one source or of any.
    pub fn head(&self, source: Option<TaskId>) -> Option<(u128, Slot, &Held)> {
        match source {
            None => self.queue.first(),
            Some(source) => {
                let of_source = self.queue.iter().filter(|(_, _, held)| held.source == source);
                of_source.min_by_key(|&(key, ..)| key)
            }
        }
    }

    /// Takes out a message by its source and id.
    pub fn withdraw(&mut self, source: TaskId, id: MessageId) -> Option<Held> {
        let slot =
            self.queue.iter().find(|(_, _, h)| h.source == source && h.id == id).map(|(_, slot, _)| slot)?;
        self.queue.remove(slot)
    }
}
