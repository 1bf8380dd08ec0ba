//! The ready set: heaps over the inboxes of a task. They tell which port is served next, and in which inbox a message is
//! offered or expires next (D108).
//!
//! Each heap holds inbox positions. [`Server::touch`] restores their order after every change of an inbox. So a GET over all
//! ports (§5.2.1) and [`CommTask::next_deadline`](crate::CommTask::next_deadline) look only at the roots, however many ports
//! there are.

use super::Server;
use super::inbox::Inbox;
use crate::ids::PortId;
use crate::packet::Class;
use crate::queue::Heap;
use crate::request::ServiceOrder;
use crate::task::own::{Own, index};
use crate::ticks::Instant;
use serde::{Deserialize, Serialize};

/// The ready set: heaps over the ports, each in another order.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct ReadySet {
    /// Non-empty ports without a handler, by the urgency of their first message.
    urgent: Heap,
    /// Non-empty ports without a handler, by how long GETs have served other ports instead (D58).
    eldest: Heap,
    /// Non-empty ports with a handler, by the instant of their next offer. Allocated with the task's first handler.
    offers: Heap,
    /// Ports with a handler or with messages of several packets, by the instant at which the next message or fragment
    /// expires. Allocated with the first handler, or from the start if messages may take several packets.
    ends: Heap,
}

/// The key that orders the first messages of two ports (D14).
fn urgency(inboxes: &[Inbox], order: &ServiceOrder, at: u16) -> (Instant, Class, u8, PortId) {
    let inbox = &inboxes[usize::from(at)];
    let head = inbox.queue.first();
    head.map_or((Instant::NEVER, Class::Status, u8::MAX, inbox.port), |(_, held)| {
        (held.expires, held.class, order.rank(inbox.port, held.source), inbox.port)
    })
}

/// The key that orders ports by how often GETs have served other ports instead. Ties are broken by class and then by
/// the lower port, not by urgency.
fn age(inboxes: &[Inbox], at: u16) -> (u64, Class, PortId) {
    let inbox = &inboxes[usize::from(at)];
    let class = inbox.queue.first().map_or(Class::Status, |(_, held)| held.class);
    (inbox.since, class, inbox.port)
}

fn next_due(inboxes: &[Inbox], at: u16) -> (Instant, u16) {
    (inboxes[usize::from(at)].queue.next_due(), at)
}

fn end(inboxes: &[Inbox], at: u16) -> (Instant, u16) {
    (inboxes[usize::from(at)].due(), at)
}

impl ReadySet {
    pub fn new(inboxes: &[Inbox]) -> Self {
        let long = inboxes.iter().any(Inbox::is_long);
        let ports = index(inboxes.len());
        Self {
            urgent: Heap::new(ports),
            eldest: Heap::new(ports),
            offers: Heap::default(),
            ends: if long { Heap::new(ports) } else { Heap::default() },
        }
    }

    /// Allocates the heaps that ports with a handler need.
    pub fn watch(&mut self, inboxes: &[Inbox]) {
        if self.offers.capacity() == 0 {
            self.offers = Heap::new(index(inboxes.len()));
        }
        if self.ends.capacity() == 0 {
            self.ends = Heap::new(index(inboxes.len()));
        }
    }

    fn touch(&mut self, inboxes: &[Inbox], order: &ServiceOrder, at: u16) {
        let inbox = &inboxes[usize::from(at)];
        let head = inbox.queue.first().map(|(_, held)| held.expires);
        let open = head.filter(|_| !inbox.handled);
        self.urgent.set(at, open, |at| urgency(inboxes, order, at));
        // The count of bypasses takes the place of the instant in the heap.
        self.eldest.set(at, open.map(|_| Instant(inbox.since)), |at| age(inboxes, at));
        if self.offers.capacity() > 0 {
            let offered = head.filter(|_| inbox.handled).map(|_| inbox.queue.next_due());
            self.offers.set(at, offered, |at| next_due(inboxes, at));
        }
        if self.ends.capacity() > 0 {
            let special = inbox.handled || inbox.is_long();
            let ends = Some(inbox.due()).filter(|&due| special && due != Instant::NEVER);
            self.ends.set(at, ends, |at| end(inboxes, at));
        }
    }

    /// Whether the inbox is in no heap. When `offers` or `ends` is allocated, the answer is false, even for an inbox that
    /// is in no heap.
    fn is_without(&self, at: u16) -> bool {
        !self.urgent.has(at) && self.offers.capacity() == 0 && self.ends.capacity() == 0
    }

    /// Validates deserialised heaps: their capacities fit the number of inboxes.
    pub fn is_whole(&self, inboxes: usize) -> bool {
        let Self { urgent, eldest, offers, ends } = self;
        urgent.is_whole(inboxes)
            && eldest.is_whole(inboxes)
            && [offers, ends].into_iter().all(|order| order.is_whole(inboxes) || order.is_whole(0))
    }

    /// The first port for which a heap disagrees with a scan of all inboxes.
    pub fn out_of_order(&self, inboxes: &[Inbox], order: &ServiceOrder) -> Option<PortId> {
        let is = |at: u16, inbox: &Inbox| {
            let waits = inbox.queue.len() > 0;
            let open = waits && !inbox.handled;
            let ends = (inbox.handled || inbox.is_long()) && inbox.due() != Instant::NEVER;
            self.urgent.has(at) == open
                && self.eldest.has(at) == open
                && self.offers.has(at) == (waits && inbox.handled)
                && self.ends.has(at) == ends
                && inbox.queue.is_in_order()
        };
        let mut ports = inboxes.iter().enumerate();
        if let Some((_, inbox)) = ports.find(|&(at, inbox)| !is(index(at), inbox)) {
            return Some(inbox.port);
        }
        let urgent = |at| urgency(inboxes, order, at);
        let age = |at| age(inboxes, at);
        let offer = |at| next_due(inboxes, at);
        let end = |at| end(inboxes, at);
        let right = self.urgent.is_in_order(|at| urgent(at).0, urgent)
            && self.eldest.is_in_order(|at| Instant(age(at).0), age)
            && self.offers.is_in_order(|at| offer(at).0, offer)
            && self.ends.is_in_order(|at| end(at).0, end);
        inboxes.first().filter(|_| !right).map(|inbox| inbox.port)
    }
}

impl Server {
    /// Restores the heaps after a change of an inbox.
    pub(super) fn touch(&mut self, own: &Own, inbox: usize) {
        let at = index(inbox);
        if self.inboxes[inbox].queue.len() > 0 || !self.ready.is_without(at) {
            self.ready.touch(&self.inboxes, &own.order, at);
        }
    }

    /// Rebuilds the heaps after any inboxes changed.
    pub(super) fn touch_all(&mut self, own: &Own) {
        let Self { ready, inboxes, .. } = self;
        for heap in [&mut ready.urgent, &mut ready.eldest, &mut ready.offers, &mut ready.ends] {
            heap.clear();
        }
        (0..index(inboxes.len())).for_each(|at| ready.touch(inboxes, &own.order, at));
    }

    /// The inbox without a handler that a GET over all ports serves (D14). Ports that were bypassed too often go first, the
    /// longest bypassed before the others (D58). Then the port with the most urgent message is served.
    pub(super) fn next_served(&self, own: &Own) -> Option<usize> {
        let eldest = self.ready.eldest.first().map(usize::from);
        let limit = own.bypass_limit();
        eldest
            .filter(|&at| self.inboxes[at].bypassed(self.served) >= limit)
            .or_else(|| self.ready.urgent.first().map(usize::from))
    }

    /// The next instant at which a message for a handler is due to be offered, whether or not the running activation can
    /// then be interrupted.
    pub fn next_offer(&self) -> Instant {
        self.ready.offers.first_instant(|at| next_due(&self.inboxes, at).0)
    }

    /// Whether a message waits at a port with a handler.
    pub fn has_offers(&self) -> bool {
        self.ready.offers.len() > 0
    }

    /// The position of an inbox in which a message or fragment has expired.
    pub(super) fn expired(&self, now: Instant) -> Option<usize> {
        let is_over = |&at: &usize| self.inboxes[at].due() <= now;
        let first = |order: &Heap| order.first().map(usize::from).filter(is_over);
        first(&self.ready.urgent).or_else(|| first(&self.ready.ends))
    }

    /// Whether no message waits, complete or incomplete.
    pub fn is_empty(&self) -> bool {
        let ReadySet { urgent, eldest: _, offers, ends } = &self.ready;
        urgent.len() + offers.len() + ends.len() == 0
    }

    /// Whether no message waits at this inbox. `None` stands for all inboxes without a handler.
    #[inline]
    pub fn has_nothing(&self, inbox: Option<u16>) -> bool {
        inbox.map_or(self.ready.urgent.len(), |inbox| self.inboxes[usize::from(inbox)].queue.len()) == 0
    }

    /// The next instant at which a message or fragment expires.
    pub fn next_end(&self) -> Instant {
        let first = |order: &Heap| order.first_instant(|at| self.inboxes[usize::from(at)].due());
        first(&self.ready.urgent).min(first(&self.ready.ends))
    }
}
