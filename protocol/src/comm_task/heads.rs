//! The orders over a task's ports and waitfors: which one is served next, and where time alone does something first (D108).
//!
//! Each is a heap of positions. After every change of a port's buffer [`CommTask::touch`] finds the port's places again, so
//! that a GET over all ports (§5.2.1) and [`CommTask::next_expiry`] look at the first ones only, however many ports there are.

use super::inbox::Inbox;
use super::rendezvous::Rendezvous;
use super::{CommTask, Pending, index};
use crate::ids::PortId;
use crate::packet::Class;
use crate::queue::Words;
use crate::request::ServiceOrder;
use crate::ticks::Ticks;
use serde::{Deserialize, Serialize};

/// The orders.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Heads {
    /// Of the ports without a handler where something waits: the most urgent head.
    pub urgent: Words,
    /// Of the same: the one that has been passed over longest (D58).
    pub eldest: Words,
    /// Of the ports with a handler where something waits: where something is to be offered next. There is room for it from
    /// the task's first handler on.
    pub offers: Words,
    /// Of the ports with a handler, or with messages of several packets: where something expires next. Likewise, or from the
    /// beginning where a message of several packets can come.
    pub ends: Words,
    /// Of the waitfors: where something is to be done next.
    pub meetings: Words,
}

/// D14: what decides between the heads of two ports.
fn urgency(inboxes: &[Inbox], order: &ServiceOrder, at: u16) -> (Ticks, Class, u8, PortId) {
    let inbox = &inboxes[usize::from(at)];
    let head = inbox.queue.first();
    head.map_or((Ticks::FAR, Class::Status, u8::MAX, inbox.port), |(_, held)| {
        (held.expires, held.class, order.rank(inbox.port, held.source), inbox.port)
    })
}

/// Of ports that were passed over equally often the lower one goes first: not the more urgent one.
fn age(inboxes: &[Inbox], at: u16) -> (u64, Class, PortId) {
    let inbox = &inboxes[usize::from(at)];
    let class = inbox.queue.first().map_or(Class::Status, |(_, held)| held.class);
    (inbox.since, class, inbox.port)
}

fn next_due(inboxes: &[Inbox], at: u16) -> (Ticks, u16) {
    (inboxes[usize::from(at)].queue.next_due(), at)
}

fn end(inboxes: &[Inbox], at: u16) -> (Ticks, u16) {
    (inboxes[usize::from(at)].due(), at)
}

fn next_act(meetings: &[Rendezvous], at: u16) -> (Ticks, u16) {
    (meetings[usize::from(at)].due(), at)
}

impl Heads {
    pub fn new(inboxes: &[Inbox], meetings: usize) -> Self {
        let long = inboxes.iter().any(|inbox| inbox.is_long());
        let ports = index(inboxes.len());
        Self {
            urgent: Words::new(ports),
            eldest: Words::new(ports),
            offers: Words::default(),
            ends: if long { Words::new(ports) } else { Words::default() },
            meetings: Words::new(index(meetings)),
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
        self.eldest.set(at, open.map(|_| Ticks(inbox.since)), |at| age(inboxes, at));
        if self.offers.capacity() > 0 {
            let offered = head.filter(|_| inbox.handled).map(|_| inbox.queue.next_due());
            self.offers.set(at, offered, |at| next_due(inboxes, at));
        }
        if self.ends.capacity() > 0 {
            let special = inbox.handled || inbox.is_long();
            let ends = Some(inbox.due()).filter(|&due| special && due != Ticks::FAR);
            self.ends.set(at, ends, |at| end(inboxes, at));
        }
    }

    /// Finds a waitfor's place.
    pub fn touch_meeting(&mut self, meetings: &[Rendezvous], at: u16) {
        let due = Some(meetings[usize::from(at)].due()).filter(|&due| due != Ticks::FAR);
        self.meetings.set(at, due, |at| next_act(meetings, at));
    }

    /// Whether nothing of a port stands in any order.
    fn is_without(&self, at: u16) -> bool {
        !self.urgent.has(at) && self.offers.capacity() == 0 && self.ends.capacity() == 0
    }
}

impl CommTask {
    /// Something changed in a port's buffer.
    pub(super) fn touch(&mut self, inbox: usize) {
        let at = index(inbox);
        if self.inboxes[inbox].queue.len() > 0 || !self.heads.is_without(at) {
            self.heads.touch(&self.inboxes, &self.order, at);
        }
    }

    /// Everything may have changed.
    pub(super) fn touch_all(&mut self) {
        let Self { heads, inboxes, meetings, order, .. } = self;
        for words in
            [&mut heads.urgent, &mut heads.eldest, &mut heads.offers, &mut heads.ends, &mut heads.meetings]
        {
            words.clear();
        }
        (0..index(inboxes.len())).for_each(|at| heads.touch(inboxes, order, at));
        (0..index(meetings.len())).for_each(|at| heads.touch_meeting(meetings, at));
    }

    /// The port without a handler that a GET over all ports takes from (D14): one that was passed over too often, the longest
    /// first (D58), else that with the most urgent head.
    pub(super) fn next_served(&self) -> Option<usize> {
        let eldest = self.heads.eldest.first().map(usize::from);
        let limit = self.bypass_limit();
        eldest
            .filter(|&at| self.inboxes[at].bypassed(self.served) >= limit)
            .or_else(|| self.heads.urgent.first().map(usize::from))
    }

    /// When the first rejected message is to be offered again, whoever could be interrupted.
    pub(super) fn next_due(&self) -> Ticks {
        self.heads.offers.first().map_or(Ticks::FAR, |at| next_due(&self.inboxes, at).0)
    }

    /// Whether something waits on a port with a handler.
    pub(super) fn has_offers(&self) -> bool {
        self.heads.offers.len() > 0
    }

    /// A port where something has no time left.
    pub(super) fn expired(&self) -> Option<usize> {
        let firsts = [self.heads.urgent.first(), self.heads.ends.first()];
        let mut ports = firsts.into_iter().flatten().map(usize::from);
        ports.find(|&at| self.inboxes[at].due() <= self.now)
    }

    /// When time alone makes something of a port expire, or a waitfor act.
    pub(super) fn next_end(&self) -> Ticks {
        let firsts = [self.heads.urgent.first(), self.heads.ends.first()];
        let ports = firsts.into_iter().flatten().map(|at| self.inboxes[usize::from(at)].due());
        ports.fold(self.next_act(), Ticks::min)
    }

    /// When a waitfor acts next.
    pub(super) fn next_act(&self) -> Ticks {
        self.heads.meetings.first().map_or(Ticks::FAR, |at| next_act(&self.meetings, at).0)
    }

    /// The desks that wait for answers: of every one a thread waits for them.
    pub(super) fn open_desks(&self) -> impl Iterator<Item = usize> {
        self.running().iter().filter_map(|level| match level.pending {
            Pending::Reply(desk) => Some(usize::from(desk)),
            Pending::Nothing
            | Pending::Get { .. }
            | Pending::Meeting(_)
            | Pending::Delay(..)
            | Pending::Work
            | Pending::Lease
            | Pending::Boundary => None,
        })
    }

    /// The first port or waitfor where an order is not what a look at all of them says.
    pub(super) fn out_of_order(&self) -> Option<PortId> {
        let Self { heads, inboxes, meetings, order, .. } = self;
        let ports = || (0_u16..).zip(inboxes.iter());
        let is = |at: u16, inbox: &Inbox| {
            let waits = inbox.queue.len() > 0;
            let open = waits && !inbox.handled;
            let ends = (inbox.handled || inbox.is_long()) && inbox.due() != Ticks::FAR;
            heads.urgent.has(at) == open
                && heads.eldest.has(at) == open
                && heads.offers.has(at) == (waits && inbox.handled)
                && heads.ends.has(at) == ends
                && inbox.queue.is_in_order()
        };
        if let Some((_, inbox)) = ports().find(|&(at, inbox)| !is(at, inbox)) {
            return Some(inbox.port);
        }
        let urgent = |at| urgency(inboxes, order, at);
        let age = |at| age(inboxes, at);
        let offer = |at| next_due(inboxes, at);
        let end = |at| end(inboxes, at);
        let right = heads.urgent.is_in_order(|at| urgent(at).0, urgent)
            && heads.eldest.is_in_order(|at| Ticks(age(at).0), age)
            && heads.offers.is_in_order(|at| offer(at).0, offer)
            && heads.ends.is_in_order(|at| end(at).0, end);
        if !right {
            return inboxes.first().map(|inbox| inbox.port);
        }
        let acts = |meeting: &Rendezvous| meeting.due() != Ticks::FAR;
        let mut waitfors = (0_u16..).zip(meetings.iter());
        let wrong = waitfors.find(|&(at, meeting)| heads.meetings.has(at) != acts(meeting));
        let act = |at| next_act(meetings, at);
        let right = heads.meetings.is_in_order(|at| act(at).0, act);
        wrong.map(|(_, meeting)| meeting).or(meetings.first().filter(|_| !right)).map(|meeting| meeting.port)
    }
}
