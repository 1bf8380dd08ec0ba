//! The orders over a task's inboxes: which one is served next, and where time alone does something first (D108).
//!
//! Each is a heap of positions. After every change of an inbox [`Server::touch`] finds its places again, so that a GET over
//! all ports (§5.2.1) and [`CommTask::next_deadline`](crate::CommTask::next_deadline) look at the first ones only, however many
//! ports there are.

use super::Server;
use super::inbox::Inbox;
use crate::ids::PortId;
use crate::packet::Class;
use crate::queue::Words;
use crate::request::ServiceOrder;
use crate::task::own::{Own, index};
use crate::ticks::Instant;
use serde::{Deserialize, Serialize};

/// The orders.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Heads {
    /// Of the ports without a handler where something waits: the most urgent head.
    urgent: Words,
    /// Of the same: the one that has been passed over longest (D58).
    eldest: Words,
    /// Of the ports with a handler where something waits: where something is to be offered next. There is room for it from
    /// the task's first handler on.
    offers: Words,
    /// Of the ports with a handler, or with messages of several packets: where something expires next. Likewise, or from the
    /// beginning where a message of several packets can come.
    ends: Words,
}

/// D14: what decides between the heads of two ports.
fn urgency(inboxes: &[Inbox], order: &ServiceOrder, at: u16) -> (Instant, Class, u8, PortId) {
    let inbox = &inboxes[usize::from(at)];
    let head = inbox.queue.first();
    head.map_or((Instant::NEVER, Class::Status, u8::MAX, inbox.port), |(_, held)| {
        (held.expires, held.class, order.rank(inbox.port, held.source), inbox.port)
    })
}

/// Of ports that were passed over equally often the lower one goes first: not the more urgent one.
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

impl Heads {
    pub fn new(inboxes: &[Inbox]) -> Self {
        let long = inboxes.iter().any(Inbox::is_long);
        let ports = index(inboxes.len());
        Self {
            urgent: Words::new(ports),
            eldest: Words::new(ports),
            offers: Words::default(),
            ends: if long { Words::new(ports) } else { Words::default() },
        }
    }

    /// Makes room for ports with a handler.
    pub fn watch(&mut self, inboxes: &[Inbox]) {
        if self.offers.capacity() == 0 {
            self.offers = Words::new(index(inboxes.len()));
        }
        if self.ends.capacity() == 0 {
            self.ends = Words::new(index(inboxes.len()));
        }
    }

    fn touch(&mut self, inboxes: &[Inbox], order: &ServiceOrder, at: u16) {
        let inbox = &inboxes[usize::from(at)];
        let head = inbox.queue.first().map(|(_, held)| held.expires);
        let open = head.filter(|_| !inbox.handled);
        self.urgent.set(at, open, |at| urgency(inboxes, order, at));
        // Counts of messages served, ordered as instants are.
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

    /// Whether nothing of a port stands in any order.
    fn is_without(&self, at: u16) -> bool {
        !self.urgent.has(at) && self.offers.capacity() == 0 && self.ends.capacity() == 0
    }

    /// Whether a state that was read has orders over so many inboxes.
    pub fn is_whole(&self, inboxes: usize) -> bool {
        let Self { urgent, eldest, offers, ends } = self;
        urgent.is_whole(inboxes)
            && eldest.is_whole(inboxes)
            && [offers, ends].into_iter().all(|order| order.is_whole(inboxes) || order.is_whole(0))
    }

    /// The first port where an order is not what a look at all of them says.
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
    /// Something changed in an inbox.
    pub(super) fn touch(&mut self, own: &Own, inbox: usize) {
        let at = index(inbox);
        if self.inboxes[inbox].queue.len() > 0 || !self.heads.is_without(at) {
            self.heads.touch(&self.inboxes, &own.order, at);
        }
    }

    /// Everything may have changed.
    pub(super) fn touch_all(&mut self, own: &Own) {
        let Self { heads, inboxes, .. } = self;
        for words in [&mut heads.urgent, &mut heads.eldest, &mut heads.offers, &mut heads.ends] {
            words.clear();
        }
        (0..index(inboxes.len())).for_each(|at| heads.touch(inboxes, &own.order, at));
    }

    /// The inbox without a handler that a GET over all ports takes from (D14): one that was passed over too often, the longest
    /// first (D58), else that with the most urgent head.
    pub(super) fn next_served(&self, own: &Own) -> Option<usize> {
        let eldest = self.heads.eldest.first().map(usize::from);
        let limit = own.bypass_limit();
        eldest
            .filter(|&at| self.inboxes[at].bypassed(self.served) >= limit)
            .or_else(|| self.heads.urgent.first().map(usize::from))
    }

    /// When the first rejected message is to be offered again, whoever could be interrupted.
    pub fn next_offer(&self) -> Instant {
        self.heads.offers.first_instant(|at| next_due(&self.inboxes, at).0)
    }

    /// Whether something waits on a port with a handler.
    pub fn has_offers(&self) -> bool {
        self.heads.offers.len() > 0
    }

    /// An inbox where something has no time left.
    pub(super) fn expired(&self, now: Instant) -> Option<usize> {
        let is_over = |&at: &usize| self.inboxes[at].due() <= now;
        let first = |order: &Words| order.first().map(usize::from).filter(is_over);
        first(&self.heads.urgent).or_else(|| first(&self.heads.ends))
    }

    /// Whether nothing waits, and no fragments do.
    pub fn is_empty(&self) -> bool {
        let Heads { urgent, eldest: _, offers, ends } = &self.heads;
        urgent.len() + offers.len() + ends.len() == 0
    }

    /// When time alone makes something expire.
    pub fn next_end(&self) -> Instant {
        let first = |order: &Words| order.first_instant(|at| self.inboxes[usize::from(at)].due());
        first(&self.heads.urgent).min(first(&self.heads.ends))
    }
}
