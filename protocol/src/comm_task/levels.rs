//! Interruption (R15, R16, D15): the task's thread, the handlers that interrupted it and each other, and which of what
//! waits is offered to whom (D16, D58).

use super::inbox::{Aged, Held};
use super::{CommTask, Outbox, Pending, note};
use crate::ids::{PortId, Round};
use crate::observe::{Event, Observation};
use crate::packet::Class;
use crate::queue::{Entry, Slot};
use crate::request::{Call, Fault, Outcome, ReleasedBy, ServiceOrder, Signal, TimeId};
use crate::rules::Aging;
use crate::table::NodeTable;
use crate::ticks::Ticks;
use serde::{Deserialize, Serialize};

/// How many handlers run at a time, each having interrupted the one before.
pub(crate) const DEPTH: usize = ServiceOrder::LEVELS + 2;

/// How a wait ended. It is told at once, or when the handlers above the thread that waited have ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) enum Finished {
    Outcome(Outcome),
    /// The request at this desk, to several tasks.
    Answers(u16),
    /// The request at this desk, with an answer in several packets.
    Long(u16),
    Released {
        port: PortId,
        round: Round,
        by: ReleasedBy,
    },
    GaveUp {
        port: PortId,
        round: Round,
        missing: u64,
    },
    TimeOut(TimeId),
    Granted(u8),
}

/// The task's thread, or a handler.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Level {
    /// What a message must outrank to interrupt it. Of the task's thread that is the rank of `self`.
    pub rank: u8,
    pub atomic: bool,
    pub pending: Pending,
    /// How its wait ended while a handler ran above it.
    pub finished: Option<Finished>,
}

impl Level {
    pub const NEW: Self = Self { rank: 0, atomic: false, pending: Pending::Nothing, finished: None };
}

/// Something that may interrupt the current thread, in the order of service: the lesser key first.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Offer {
    key: (Turn, u8, Ticks, Class, PortId, u128),
    what: What,
}

/// What goes first whatever its rank and urgency.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Turn {
    /// The task lost its lease, or takes over (D61).
    Lease,
    /// It was rejected as often as ranks stand above it: the one that was rejected first (D58).
    Capped(u64),
    /// Its port was passed over too often: the one passed over most, counted down.
    Bypassed(u16),
    InOrder,
    /// It is at its cap, but so was the one before: what outranks by itself comes between, or a flood of rejected messages
    /// would keep the first rank from its turn.
    CappedAgain(u64),
}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum What {
    Lease,
    Timer(usize),
    Message(usize, Slot),
}

impl CommTask {
    pub(super) fn top(&self) -> &Level {
        &self.levels[usize::from(self.depth)]
    }

    pub(super) fn top_mut(&mut self) -> &mut Level {
        &mut self.levels[usize::from(self.depth)]
    }

    /// The task's thread and the handlers that run, the interrupting after the interrupted.
    pub(super) fn running(&self) -> &[Level] {
        &self.levels[..=usize::from(self.depth)]
    }

    /// How many handlers run, each having interrupted the one before or the task's thread.
    #[must_use]
    pub const fn depth(&self) -> u8 {
        self.depth
    }

    /// Ends the wait of the thread that waits so: tells it, or leaves word for when it resumes.
    pub(super) fn conclude(&mut self, wait: Pending, finished: Finished, out: &mut impl Outbox) {
        let top = self.top_mut();
        if top.pending == wait {
            top.pending = Pending::Nothing;
            return self.tell(finished, out);
        }
        let below = self.levels.iter_mut().take(usize::from(self.depth));
        for level in below.filter(|level| level.pending == wait).take(1) {
            (level.pending, level.finished) = (Pending::Nothing, Some(finished));
        }
    }

    pub(super) fn tell(&mut self, finished: Finished, out: &mut impl Outbox) {
        out.signal(match finished {
            Finished::Outcome(outcome) => Signal::Outcome(outcome),
            Finished::Answers(desk) => {
                let desk = &mut self.desks[usize::from(desk)];
                desk.tell();
                Signal::Answers { port: desk.port, answers: desk.answers() }
            }
            Finished::Long(desk) => {
                let desk = &mut self.desks[usize::from(desk)];
                desk.tell();
                Signal::Outcome(Outcome::Reply(desk.long_answer().unwrap_or_default()))
            }
            Finished::Released { port, round, by } => Signal::Released { port, round, by },
            Finished::GaveUp { port, round, missing } => Signal::GaveUp { port, round, missing },
            Finished::TimeOut(id) => Signal::TimeOut(id),
            Finished::Granted(epoch) => Signal::Granted(epoch),
        });
    }

    /// Whether a handler may interrupt the current thread: it waits, or stands between two statements.
    pub(super) fn interruptible(&self, at_boundary: bool) -> bool {
        let top = self.top();
        let room = usize::from(self.depth) < DEPTH;
        // D61: who lost its lease must stop acting, whatever section it is in.
        let open = !top.atomic || self.called().is_some();
        room && open && (at_boundary || top.pending != Pending::Nothing)
    }

    /// In a plain GET there is no thread to interrupt.
    fn is_idle_get(&self) -> bool {
        self.depth == 0 && matches!(self.top().pending, Pending::Get { .. })
    }

    /// What a message must outrank.
    fn rank_of_top(&self) -> u8 {
        if self.depth == 0 { self.order.own() } else { self.top().rank }
    }

    fn outranks(&self, table: &NodeTable, rank: u8, capped: bool) -> bool {
        !table.rules().obey_order
            || self.is_idle_get()
            || rank < self.rank_of_top()
            || (capped && self.depth == 0)
    }

    /// How many rejections make a message outrank the task's own thread (D58).
    pub(super) const fn cap(base: u8) -> u8 {
        if base == 0 { 1 } else { base }
    }

    pub(super) fn held_outranks(&self, table: &NodeTable, port: PortId, held: &Held, aged: Aged) -> bool {
        let base = self.order.rank(port, held.source);
        let rank = base.saturating_sub(aged.rejections);
        self.outranks(table, rank, aged.rejections >= Self::cap(base))
    }

    /// How often a port may be passed over before it goes first (D58).
    pub(super) fn bypass_limit(&self) -> u16 {
        super::index(self.locals.len() + self.order.ranked().len()).max(4)
    }

    /// When the first rejected message is to be offered again, where that could matter.
    pub(super) fn next_offer(&self) -> Ticks {
        if !self.interruptible(false) {
            return Ticks::FAR;
        }
        self.next_due()
    }

    /// The task says what outranks what (D16). What was rejected so often that it outranks the thread does so under the new
    /// order, too, and nothing counts for more than the new order's ranks: so no change of order takes a turn away (D58).
    pub(super) fn set_order(&mut self, order: ServiceOrder) {
        let old = core::mem::replace(&mut self.order, order);
        for inbox in &mut self.inboxes {
            let port = inbox.port;
            inbox.queue.adjust(|held, aged| {
                let [before, after] = [old, order].map(|order| Self::cap(order.rank(port, held.source)));
                aged.rejections = if aged.rejections >= before { after } else { aged.rejections.min(after) };
            });
        }
        self.touch_all();
    }

    /// A timer that is over and outranks the thread that could be interrupted: it should have been offered.
    pub(super) fn kept_timer(&self, table: &NodeTable) -> Option<TimeId> {
        let mut ended = self.timers.ended().map(|(id, _)| id).filter(|_| self.interruptible(false));
        ended.find(|&id| self.outranks(table, self.order.timer(id), false))
    }

    /// Until when messages are due to be offered: in a plain GET all are.
    fn due_by(&self) -> Ticks {
        if self.is_idle_get() { Ticks::FAR } else { self.now }
    }

    /// Offers what waits to the current thread, if that waits: while nothing is due this looks at no port, else at each of
    /// them and at everything that is due.
    pub(super) fn offer_to_waiting(&mut self, table: &NodeTable, out: &mut impl Outbox) {
        if matches!(self.top().pending, Pending::Nothing) {
            return;
        }
        let any = (self.has_offers() && self.next_due() <= self.due_by())
            || self.timers.ended().next().is_some()
            || self.called().is_some();
        if any && self.interruptible(false) {
            self.offer(table, out);
        }
    }

    /// Offers everything that is due to the current thread, which can be interrupted. True where a handler begins.
    pub(super) fn offer(&mut self, table: &NodeTable, out: &mut impl Outbox) -> bool {
        let first = self.first_offer(table);
        self.reject_the_others(table, out);
        let Some(first) = first else { return false };
        self.count_bypasses(table, first.what);
        match first.key.0 {
            Turn::Capped(_) | Turn::CappedAgain(_) => self.capped_last = true,
            Turn::Bypassed(_) | Turn::InOrder => self.capped_last = false,
            Turn::Lease => {}
        }
        match first.what {
            What::Lease => {
                if let Some(call) = self.take_call() {
                    self.top_mut().atomic = false;
                    self.begin_handler(0);
                    self.note_handler(Event::Interrupted, 0, out);
                    out.signal(Signal::Interrupt(call));
                }
            }
            What::Timer(at) => {
                let id = self.timers.take(at);
                let rank = self.order.timer(id);
                self.begin_handler(rank);
                self.note_handler(Event::Interrupted, u32::from(id.0), out);
                out.signal(Signal::Interrupt(Call::Timer(id)));
            }
            What::Message(inbox, slot) => {
                if let Some(held) = self.take(inbox, slot) {
                    self.interrupt(inbox, &held, out);
                }
            }
        }
        true
    }

    fn first_offer(&self, table: &NodeTable) -> Option<Offer> {
        let (limit, due_by) = (self.bypass_limit(), self.due_by());
        let handled = self.inboxes.iter().enumerate().filter(|(_, inbox)| inbox.handled);
        let messages = handled.flat_map(|(i, inbox)| {
            let due = inbox.queue.all_due(due_by);
            let due = due.map(|(slot, held)| (slot, held, inbox.queue.side(slot)));
            let ready = due.filter(|&(_, held, aged)| self.held_outranks(table, inbox.port, held, aged));
            ready.map(move |(slot, held, aged)| {
                let base = self.order.rank(inbox.port, held.source);
                let capped = aged.rejections >= Self::cap(base);
                let turn = if capped && self.capped_last {
                    Turn::CappedAgain(aged.rejected_first)
                } else if capped {
                    Turn::Capped(aged.rejected_first)
                } else if inbox.bypassed(self.served) >= limit {
                    Turn::Bypassed(u16::MAX - inbox.bypassed(self.served))
                } else {
                    Turn::InOrder
                };
                let rank = base.saturating_sub(aged.rejections);
                Offer {
                    key: (turn, rank, held.expires, held.class, inbox.port, held.key()),
                    what: What::Message(i, slot),
                }
            })
        });
        let timers = self.timers.ended().filter_map(|(id, at)| {
            let rank = self.order.timer(id);
            let key = (Turn::InOrder, rank, Ticks::ZERO, Class::Command, PortId(0), u128::from(id.0));
            self.outranks(table, rank, false).then_some(Offer { key, what: What::Timer(at) })
        });
        let lease = self.called().map(|_| Offer {
            key: (Turn::Lease, 0, Ticks::ZERO, Class::Command, PortId(0), 0),
            what: What::Lease,
        });
        messages.chain(timers).chain(lease).min()
    }

    /// Ports whose offer was as good as any, but for their place in the order, were passed over (D58).
    fn count_bypasses(&mut self, table: &NodeTable, first: What) {
        if table.rules().aging == Aging::Off {
            return;
        }
        let due_by = self.due_by();
        for i in 0..self.inboxes.len() {
            let inbox = &self.inboxes[i];
            let (port, handled) = (inbox.port, inbox.handled);
            let other = !matches!(first, What::Message(taken, _) if taken == i);
            let queue = &inbox.queue;
            let ready = |(slot, held): (Slot, &Held)| self.held_outranks(table, port, held, queue.side(slot));
            if other && handled && queue.all_due(due_by).any(ready) {
                self.inboxes[i].since = self.inboxes[i].since.saturating_add(1);
            }
        }
    }

    /// Every message that is due and does not outrank the current thread is rejected (R16, D58).
    fn reject_the_others(&mut self, table: &NodeTable, out: &mut impl Outbox) {
        let (due_by, round) = (self.due_by(), self.rejections);
        for i in 0..self.inboxes.len() {
            let inbox = &mut self.inboxes[i];
            let id = inbox.port;
            if !inbox.handled || inbox.queue.next_due() > due_by {
                continue;
            }
            let mut queue = core::mem::take(&mut inbox.queue);
            let mut turned = core::mem::take(&mut self.turned);
            let outranks = |slot, held| self.held_outranks(table, id, held, queue.side(slot));
            let due = queue.all_due(due_by).filter(|&(slot, held)| !outranks(slot, held));
            turned.extend(due.map(|(slot, _)| slot));
            turned.sort_unstable_by_key(|&slot| queue.get(slot).map(Entry::key));
            for &slot in &turned {
                queue.change(slot, |held, aged| self.reject(table, id, (held, aged), round, out));
                self.rejections = round + 1;
            }
            self.count(id, |c| c.rejected += turned.len() as u64);
            turned.clear();
            (self.inboxes[i].queue, self.turned) = (queue, turned);
            self.touch(i);
        }
    }

    /// The message does not outrank the current thread: it is offered again later, one level higher (D4, D58).
    fn reject(
        &self,
        table: &NodeTable,
        port: PortId,
        (held, aged): (&mut Held, &mut Aged),
        round: u64,
        out: &mut impl Outbox,
    ) {
        let penalty = table.port(port).and_then(|port| port.decl.penalty);
        let length = penalty.map_or(table.cell().tick, |penalty| penalty.length);
        let left = held.expires - self.now;
        note(out, Event::Rejected, port, held.source, held.id(), left);
        if penalty.is_some_and(|penalty| penalty.literal) {
            // The Appendix's `save`: the penalty lengthens the life that it makes less urgent.
            held.expires += length;
            aged.not_before = self.now + length.max(Ticks(1));
            return;
        }
        aged.not_before = self.now + length.min(Ticks(left.0 / 2)).max(Ticks(1));
        if table.rules().aging == Aging::Bounded {
            if aged.rejections == 0 {
                aged.rejected_first = round;
            }
            let cap = Self::cap(self.order.rank(port, held.source));
            aged.rejections = aged.rejections.saturating_add(1).min(cap);
        }
    }

    /// A message for a handler came in and does not outrank the current thread: it was offered before it is stored (R25).
    pub(super) fn reject_arrived(
        &mut self,
        table: &NodeTable,
        port: PortId,
        message: (&mut Held, &mut Aged),
        out: &mut impl Outbox,
    ) {
        self.count(port, |c| c.rejected += 1);
        self.reject(table, port, message, self.rejections, out);
        self.rejections += 1;
    }

    pub(super) fn interrupt(&mut self, inbox: usize, held: &Held, out: &mut impl Outbox) {
        let port = self.inboxes[inbox].port;
        let rank = self.order.rank(port, held.source);
        self.begin_handler(rank);
        note(out, Event::Interrupted, port, held.source, held.id(), held.expires - self.now);
        let delivery = self.delivery(inbox, held, out);
        out.signal(Signal::Interrupt(Call::Message(delivery)));
    }

    /// D15: a handler never ranks lower than what it interrupted.
    fn begin_handler(&mut self, rank: u8) {
        let rank = rank.min(self.rank_of_top());
        if self.top().pending == Pending::Nothing {
            self.top_mut().pending = Pending::Boundary;
        }
        self.depth += 1;
        *self.top_mut() = Level { rank, ..Level::NEW };
    }

    /// A statement boundary (D15).
    pub(super) fn boundary(&mut self, table: &NodeTable, out: &mut impl Outbox) {
        if !(self.interruptible(true) && self.offer(table, out)) {
            out.signal(Signal::Accepted(0));
        }
    }

    /// A handler ended (R16). The thread below goes on where it was: its wait may be over by now.
    pub(super) fn resume(&mut self, table: &NodeTable, out: &mut impl Outbox) -> Result<(), Fault> {
        if self.depth == 0 {
            return Err(Fault::NotInterrupted);
        }
        *self.top_mut() = Level::NEW;
        self.depth -= 1;
        self.note_handler(Event::Resumed, u32::from(self.depth), out);
        if let Some(finished) = self.top_mut().finished.take() {
            // The lease was granted and lost again while the handler ran: the thread goes on waiting for it.
            if matches!(finished, Finished::Granted(_)) && !self.is_active() {
                self.top_mut().pending = Pending::Lease;
                return Ok(());
            }
            self.tell(finished, out);
            return Ok(());
        }
        match self.top().pending {
            Pending::Boundary => {
                self.top_mut().pending = Pending::Nothing;
                self.boundary(table, out);
            }
            Pending::Get { port, source, deadline } => {
                if self.serve(table, port, source, out) {
                    self.top_mut().pending = Pending::Nothing;
                } else if deadline <= self.now {
                    self.top_mut().pending = Pending::Nothing;
                    out.signal(Signal::Nothing);
                }
            }
            Pending::Nothing
            | Pending::Reply(_)
            | Pending::Meeting(_)
            | Pending::Delay(..)
            | Pending::Lease
            | Pending::Work => {}
        }
        Ok(())
    }

    fn note_handler(&self, event: Event, number: u32, out: &mut impl Outbox) {
        let (port, peer) = (PortId::NONE, self.task);
        out.observe(Observation { event, port, peer, number, remaining: Ticks::ZERO });
    }
}
