//! The waiting messages as a monitor sees them.

use super::{Held, Server};
use crate::observe::{HeldView, QueueEntry, QueueView};
use crate::queue::Slot;
use crate::task::interrupts::cap;
use crate::task::own::{Own, index};
use crate::ticks::{Instant, Ticks};
use alloc::vec::Vec;

impl Server {
    /// The number of waiting messages of an inbox, and the remaining time of the most urgent one.
    pub fn waiting(&self, inbox: u16, now: Instant) -> (u16, Option<Ticks>) {
        let queue = &self.inboxes[usize::from(inbox)].queue;
        (index(queue.len()), queue.first().map(|(_, held)| held.expires - now))
    }

    /// The `limit` most urgent waiting messages of an inbox.
    pub fn entries(&self, inbox: u16, limit: usize, now: Instant) -> Vec<QueueEntry> {
        let waiting = self.inboxes[usize::from(inbox)].queue.sorted();
        waiting.iter().take(limit).map(|(_, held)| held.entry(now)).collect()
    }

    /// The waiting messages of an inbox, with everything that decides the order of service.
    pub fn queue_view(&self, own: &Own, inbox: u16, limit: usize) -> QueueView {
        let inbox = &self.inboxes[usize::from(inbox)];
        let held = |(slot, held): &(Slot, &Held)| {
            let (retry, base) = (inbox.queue.side(*slot), own.order.rank(inbox.port, held.source));
            HeldView {
                entry: held.entry(own.now),
                arrival: held.arrival,
                fragments: held.fragments,
                rank: inbox.handled.then(|| base.saturating_sub(retry.rejections)),
                rejections: retry.rejections,
                capped: inbox.handled && retry.rejections >= cap(base),
                back_off: retry.not_before - own.now,
            }
        };
        QueueView {
            handled: inbox.handled,
            bypassed: inbox.bypassed(self.served),
            bypass_limit: own.bypass_limit(),
            queue: inbox.queue.sorted().iter().take(limit).map(held).collect(),
        }
    }
}

impl Held {
    fn entry(&self, now: Instant) -> QueueEntry {
        let remaining = self.expires - now;
        QueueEntry { source: self.source, id: self.id(), class: self.class, remaining }
    }
}
