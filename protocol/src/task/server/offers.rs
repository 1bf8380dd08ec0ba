//! Messages for handlers: which one interrupts first, and how the others are rejected (D16, D58).

use super::inbox::RetryState;
use super::{Held, Server};
use crate::ids::PortId;
use crate::observe::Event;
use crate::queue::{Entry, Slot};
use crate::request::ServiceOrder;
use crate::rules::Aging;
use crate::table::NodeTable;
use crate::task::interrupts::{Interrupts, Offer, Turn, What, cap};
use crate::task::own::Own;
use crate::task::step::{Outbox, Step};
use crate::ticks::Ticks;

/// Whether a message may interrupt the running activation. Each rejection has raised its rank by one.
pub(super) fn outranks(
    table: &NodeTable,
    own: &Own,
    threads: &Interrupts,
    port: PortId,
    held: &Held,
    retry: RetryState,
) -> bool {
    let base = own.order.rank(port, held.source);
    let rank = base.saturating_sub(retry.rejections);
    threads.outranks(table, own, rank, retry.rejections >= cap(base))
}

impl Server {
    /// The first message, in the order of service, of those that are due and may interrupt the running activation.
    pub fn first_offer(&self, table: &NodeTable, own: &Own, threads: &Interrupts) -> Option<Offer> {
        let (limit, due_by) = (own.bypass_limit(), threads.due_by(own.now));
        let handled = self.inboxes.iter().enumerate().filter(|(_, inbox)| inbox.handled);
        let offers = handled.flat_map(|(i, inbox)| {
            let due = inbox.queue.all_due(due_by);
            let due = due.map(|(slot, held)| (slot, held, inbox.queue.side(slot)));
            let ready =
                due.filter(|&(_, held, retry)| outranks(table, own, threads, inbox.port, held, retry));
            ready.map(move |(slot, held, retry)| {
                let base = own.order.rank(inbox.port, held.source);
                let turn = if retry.rejections >= cap(base) {
                    threads.capped_turn(retry.rejected_first)
                } else if inbox.bypassed(self.served) >= limit {
                    Turn::Bypassed(u16::MAX - inbox.bypassed(self.served))
                } else {
                    Turn::InOrder
                };
                let rank = base.saturating_sub(retry.rejections);
                let key = (turn, rank, held.expires, held.class, inbox.port, held.key().1);
                Offer { key, what: What::Message(i, slot) }
            })
        });
        offers.min()
    }

    /// Counts a bypass for each other port that also has a due message that may interrupt the running activation (D58).
    pub fn count_bypasses(&mut self, step: &Step<'_, impl Outbox>, threads: &Interrupts, first: What) {
        if step.table.rules().aging == Aging::Off {
            return;
        }
        let due_by = threads.due_by(step.now());
        for (i, inbox) in self.inboxes.iter_mut().enumerate() {
            let (port, queue) = (inbox.port, &inbox.queue);
            let other = !matches!(first, What::Message(taken, _) if taken == i);
            let ready = |(slot, held): (Slot, &Held)| {
                outranks(step.table, step.own, threads, port, held, queue.side(slot))
            };
            if other && inbox.handled && queue.all_due(due_by).any(ready) {
                inbox.since = inbox.since.saturating_add(1);
            }
        }
    }

    /// Rejects every message that is due and does not outrank the running activation (R16, D58).
    pub fn reject_the_others(&mut self, step: &mut Step<'_, impl Outbox>, threads: &Interrupts) {
        let (due_by, round) = (threads.due_by(step.now()), self.rejections);
        for i in 0..self.inboxes.len() {
            let inbox = &mut self.inboxes[i];
            let (id, endpoint) = (inbox.port, inbox.endpoint);
            if !inbox.handled || inbox.queue.next_due() > due_by {
                continue;
            }
            let (queue, turned) = (&mut inbox.queue, &mut self.turned);
            let is_ready = |slot, held| outranks(step.table, step.own, threads, id, held, queue.side(slot));
            let due = queue.all_due(due_by).filter(|&(slot, held)| !is_ready(slot, held));
            turned.extend(due.map(|(slot, _)| slot));
            turned.sort_unstable_by_key(|&slot| queue.get(slot).map(Entry::key));
            for &slot in &*turned {
                queue.change(slot, |held, retry| reject(step, id, (held, retry), round));
                self.rejections = round + 1;
            }
            step.count(endpoint, |c| c.rejected += turned.len() as u64);
            turned.clear();
            self.touch(step.own, i);
        }
    }

    /// Rejects a message on arrival: the message was offered before it is stored, and does not outrank the running
    /// activation (R25).
    pub(super) fn reject_arrived(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        inbox: usize,
        message: (&mut Held, &mut RetryState),
    ) {
        let inbox = &self.inboxes[inbox];
        step.count(inbox.endpoint, |c| c.rejected += 1);
        reject(step, inbox.port, message, self.rejections);
        self.rejections += 1;
    }

    /// Applies a new `order`. A message that was capped stays capped. The rejections of other messages count up to the new
    /// cap at most. So no change of the `order` makes a capped message wait again (D16, D58).
    pub fn reorder(&mut self, own: &Own, old: &ServiceOrder) {
        for inbox in &mut self.inboxes {
            let port = inbox.port;
            inbox.queue.adjust(|held, retry| {
                let [before, after] = [old, &own.order].map(|order| cap(order.rank(port, held.source)));
                retry.rejections =
                    if retry.rejections >= before { after } else { retry.rejections.min(after) };
            });
        }
        self.touch_all(own);
    }
}

/// Rejects a message: it is offered again after the penalty, one rank higher (D4, D58).
fn reject(
    step: &mut Step<'_, impl Outbox>,
    port: PortId,
    (held, retry): (&mut Held, &mut RetryState),
    round: u64,
) {
    let penalty = step.table.port(port).and_then(|port| port.decl.penalty);
    let length = penalty.map_or(step.table.cell().tick, |penalty| penalty.length);
    let now = step.now();
    let left = held.expires - now;
    step.note(Event::Rejected, port, held.source, held.id(), left);
    if penalty.is_some_and(|penalty| penalty.literal) {
        // The procedure `save` of the Appendix adds the penalty to the deadline. The message is then less urgent, but has
        // more time left.
        held.expires += length;
        retry.not_before = now + length.max(Ticks(1));
        return;
    }
    retry.not_before = now + length.min(Ticks(left.whole(Ticks(2)))).max(Ticks(1));
    if step.table.rules().aging == Aging::Bounded {
        if retry.rejections == 0 {
            retry.rejected_first = round;
        }
        let cap = cap(step.own.order.rank(port, held.source));
        retry.rejections = retry.rejections.saturating_add(1).min(cap);
    }
}
