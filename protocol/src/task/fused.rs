//! Fused steps: two tasks of one node exchange a message in one step (D176), or a task answers and waits for its next message (D200).
//!
//! Without fused steps, a message takes several small steps: a request, a packet, the route, and the input of the other
//! task. So does an answer. A fused step takes a message to a task that waits for it or whose port has room for it, or an
//! answer to a task that waits for it. Each function here first checks that nothing unusual is involved. Then it makes the
//! same changes as the small steps, with the same signals and observations in the same order. If anything is unusual, the
//! function returns false and changes nothing, and the caller takes the small steps.
//!
//! The checker explores the small steps, and compares them with the fused step wherever a fused step applies.

mod getting;
mod meeting;

pub(crate) use getting::{Get, OfTask};

use super::CommTask;
use super::machines::Machines;
use super::own::Role;
use super::wait::Pending;
use crate::mapping;
use crate::node::NodeOutbox;
use crate::observe::{Event, Observation};
use crate::packet::Contents;
use crate::request::{Outcome, ReplyTo, Signal};
use crate::table::Ends;
use crate::ticks::Ticks;

impl Machines {
    /// Whether no handler runs, and nothing that is pending can interrupt the task's own thread while it waits.
    #[inline(always)]
    fn is_plain(&self) -> bool {
        self.lease.is_none()
            && self.interrupts.depth() == 0
            && !self.interrupts.has_ended_timer()
            && !self.server.has_offers()
    }
}

impl CommTask {
    /// Sends a message to `other`, which waits for it in a GET, or has room for it in the port's buffer.
    pub(crate) fn send_fused(
        &mut self,
        other: &mut Self,
        ends: Ends<'_>,
        (contents, time_out): (Contents, Option<Ticks>),
        out: &mut impl NodeOutbox,
    ) -> bool {
        let (Self { own, machines, .. }, Self { own: their, machines: theirs, .. }) =
            (&mut *self, &mut *other);
        let (Ends { port, own: from, peer }, to) = (ends, ends.other());
        let (id, place, there) = (port.id, usize::from(from.place), usize::from(to.place));
        let (role, Role::Receives(inbox)) = (own.endpoints[place].role, their.endpoints[there].role) else {
            return false;
        };
        let origin = (usize::from(inbox), usize::from(peer.back));
        let asks = match role {
            Role::Asks(request) => Some(request),
            Role::Sends => None,
            _ => return false,
        };
        let ttl = from.time_out_of(time_out);
        let message = own.coming_id();
        let handled = theirs.server.is_handled(inbox);
        let awaited = theirs.interrupts.gets(id, own.task, handled);
        let is_usual = port.decl.takes_one_packet()
            && port.decl.guard.is_none()
            && !ttl.is_zero()
            && machines.interrupts.waits_for_nothing()
            && match asks {
                Some(request) => machines.is_plain() && machines.client.is_closed(request),
                None => true,
            }
            && theirs.server.takes_fused(origin, message, their.now)
            && (awaited || (!handled && theirs.is_plain() && theirs.server.has_room(inbox)));
        if !is_usual {
            return false;
        }
        own.next_sequence = message.sequence.next();
        own.endpoints[place].counters.sent += 1;
        out.observe(Some(own.task), Observation::of(Event::Sent, id, their.task, message, ttl));
        out.within(|| mapping::message(port, own.task, their.task, message, ttl, contents));
        if let Some(request) = asks {
            let retry = from.retry;
            let asked = (peer.recipient, message);
            machines.client.open_fused(request, asked, retry, (port, ttl, contents), own.now);
            machines.interrupts.wait(Pending::Reply(request));
        } else {
            out.signal(own.task, Signal::Accepted(1));
        }
        their.endpoints[there].counters.enqueued += 1;
        if awaited {
            let delivery = theirs.server.take_fused(origin, message, (from, ttl, contents), their.now);
            theirs.interrupts.end_wait();
            their.endpoints[there].counters.delivered += 1;
            let delivered = Observation::of(Event::Delivered, id, own.task, message, delivery.budget);
            out.observe(Some(their.task), delivered);
            out.signal(their.task, Signal::Message(delivery));
        } else {
            theirs.server.store_fused(their, origin, message, (from, ttl, contents));
            let enqueued = Observation::of(Event::Enqueued, id, own.task, message, ttl);
            out.observe(Some(their.task), enqueued);
        }
        (self.due, other.due) = (None, None);
        true
    }

    /// Answers a command of `other`, which waits for the answer.
    pub(crate) fn reply_fused(
        &mut self,
        other: &mut Self,
        ends: Ends<'_>,
        (to, contents): (ReplyTo, Contents),
        out: &mut impl NodeOutbox,
    ) -> bool {
        let (Self { own, machines, .. }, Self { own: their, machines: theirs, .. }) =
            (&mut *self, &mut *other);
        let (Ends { port, own: from, peer }, asking) = (ends, ends.other());
        let there = usize::from(asking.place);
        let (Role::Receives(inbox), Role::Asks(request)) =
            (own.endpoints[usize::from(from.place)].role, their.endpoints[there].role)
        else {
            return false;
        };
        let recipient = asking.peers[usize::from(peer.back)].recipient;
        let is_usual = port.decl.takes_one_packet()
            && machines.interrupts.waits_for_nothing()
            && matches!(theirs.interrupts.pending(), Pending::Reply(at) if at == request)
            && theirs.client.waits_only_for(request, recipient, to.id);
        if !is_usual {
            return false;
        }
        let origin = (usize::from(inbox), usize::from(peer.slot));
        let Some(left) = machines.server.answer_fused(origin, to, contents, own.now) else { return false };
        out.observe(Some(own.task), Observation::of(Event::Replied, to.port, to.source, to.id, left));
        out.within(|| mapping::answer(to, own.task, mapping::answer_kind(port), left, contents));
        out.signal(own.task, Signal::Accepted(1));
        let left = theirs.client.close_fused(request, recipient) - their.now;
        theirs.interrupts.end_wait();
        their.endpoints[there].counters.delivered += 1;
        out.observe(Some(their.task), Observation::of(Event::Answered, to.port, own.task, to.id, left));
        out.signal(their.task, Signal::Outcome(Outcome::Reply(contents)));
        (self.due, other.due) = (None, None);
        true
    }
}
