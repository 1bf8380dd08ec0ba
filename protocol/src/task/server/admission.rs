//! Admission of messages to the bounded_buffer, and eviction (§5.1.1, D60).

use super::inbox::{Admission, RetryState};
use super::memory::CommandStatus;
use super::{Held, Origin, Server, discard, rest_of};
use crate::ids::{Incarnation, MessageId, TaskId};
use crate::mapping;
use crate::observe::{Event, Reason};
use crate::packet::{Class, Control, Packet};
use crate::request::ReplyTo;
use crate::table::Port;
use crate::task::step::{Outbox, Step};
use crate::ticks::{Instant, Ticks};

impl Server {
    /// Extends the deadline of a waiting command if a copy of the command comes that has more time left. A link charges an
    /// upper bound, so the copy with the most time left shows best when the sender's wait ends (D20). Of a message of
    /// several packets only the first complete copy counts.
    pub(super) fn prolong(
        &mut self,
        (inbox, source): Origin,
        packet: &Packet,
        reserved: Ticks,
        now: Instant,
    ) {
        let sender_until = now + packet.remaining;
        let expires = sender_until - reserved;
        let inbox = &mut self.inboxes[inbox];
        let Some(slot) = inbox.find(packet.source, packet.id) else { return };
        let short = packet.fragment == 0 && !packet.more;
        if !short || inbox.queue.get(slot).is_none_or(|held| held.fragments > 1 || held.expires >= expires) {
            return;
        }
        inbox.queue.change(slot, |held, _| held.expires = expires);
        if let Some(dedup) = inbox.sources[source].command_mut() {
            dedup.sender_until = dedup.sender_until.max(sender_until);
            dedup.until = dedup.until.max(sender_until);
        }
    }

    /// Whether the newcomer is the latest message of its source, on a port that keeps only the latest. Drops the message
    /// that the newcomer replaces.
    pub(super) fn supersedes(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        inbox: usize,
        newcomer: &Held,
    ) -> bool {
        let Some((slot, held)) = self.inboxes[inbox].of_source(newcomer.source) else { return true };
        let same_incarnation = held.incarnation == newcomer.incarnation;
        if newcomer.class == Class::Status
            && same_incarnation
            && held.sequence.is_newer_than(newcomer.sequence)
        {
            return false;
        }
        if let Some(old) = self.inboxes[inbox].queue.remove(slot) {
            discard(step, &self.inboxes[inbox], &old, Reason::Superseded);
        }
        true
    }

    pub(super) fn store(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        (port, (inbox, source)): (&Port, Origin),
        (message, retry): (Held, RetryState),
    ) {
        let message = Held { arrival: self.arrivals, ..message };
        self.arrivals += 1;
        let entry = &mut self.inboxes[inbox];
        let (id, endpoint) = (entry.port, entry.endpoint);
        let left = message.expires - step.now();
        let (slot, lost) = match entry.admit(message, retry, self.served) {
            Admission::Kept(slot) => (Some(slot), None),
            Admission::Replaced(slot, evicted) => (Some(slot), Some((evicted, Reason::Evicted))),
            Admission::Turned => (None, Some((message, Reason::Refused))),
        };
        if let Some(slot) = slot {
            if let Some(long) = &mut entry.long {
                long.keep((slot, source), rest_of(message.fragments));
            }
            step.count(endpoint, |c| c.enqueued += 1);
            step.note(Event::Enqueued, id, message.source, message.id(), left);
        }
        let Some((lost, reason)) = lost else { return };
        step.count(endpoint, |c| if slot.is_none() { c.refused += 1 } else { c.evicted += 1 });
        let left = lost.expires - step.now();
        step.note(Event::Discarded(reason), id, lost.source, lost.id(), left);
        if lost.class == Class::Command {
            self.refuse(step, (port, inbox), lost.source, lost.id());
        }
    }

    /// Tells the source of a refused command at once that it was refused (D21). Every copy gets the same answer (D52).
    fn refuse(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        (port, inbox): (&Port, usize),
        source: TaskId,
        message: MessageId,
    ) {
        let entry = &mut self.inboxes[inbox];
        if let Some(at) = entry.source(source) {
            entry.settle(at, message, CommandStatus::Refused);
        }
        let ttl = port.party(source).map_or(Ticks::ZERO, |party| party.time_out);
        let to = ReplyTo { port: port.id, source, id: message };
        step.out.transmit(mapping::control(to, step.own.task, Control::Refused, ttl));
    }

    /// Whether this is the incarnation of the source from which this task last heard.
    #[inline]
    pub(super) fn knows(&self, source: TaskId, incarnation: Incarnation) -> bool {
        // Fast path: many tasks receive from only one other task.
        if let [only] = &*self.incarnations {
            return only.task == source && only.incarnation == Some(incarnation);
        }
        let at = self.incarnations.binary_search_by_key(&source, |known| known.task);
        at.is_ok_and(|at| self.incarnations[at].incarnation == Some(incarnation))
    }

    /// Whether a message is from the present incarnation of its source. A new incarnation clears the dedup entries of
    /// the earlier one, and drops its waiting commands, because no task waits for their answers.
    pub(super) fn enter_incarnation(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        source: TaskId,
        incarnation: Incarnation,
    ) -> bool {
        let Ok(at) = self.incarnations.binary_search_by_key(&source, |known| known.task) else {
            return false;
        };
        match self.incarnations[at].incarnation {
            Some(known) if incarnation.is_older_than(known) => return false,
            Some(known) if known != incarnation => {
                for inbox in 0..self.inboxes.len() {
                    if let Some(entry) = self.inboxes[inbox].source(source) {
                        self.withdraw_superseded(step, (inbox, entry));
                        self.inboxes[inbox].forget(entry);
                        self.touch(step.own, inbox);
                    }
                }
            }
            Some(_) | None => {}
        }
        self.incarnations[at].incarnation = Some(incarnation);
        true
    }

    /// Drops the waiting command of a source that sends a newer one: a source has only one outstanding request per port, so
    /// the source has given up the older command (D12).
    pub(super) fn withdraw_superseded(&mut self, step: &mut Step<'_, impl Outbox>, (inbox, source): Origin) {
        let entry = &self.inboxes[inbox].sources[source];
        let task = entry.task;
        let Some(id) = entry.command().filter(|old| old.waits(step.now())).map(|old| old.id) else { return };
        if let Some(withdrawn) = self.inboxes[inbox].withdraw(task, id) {
            discard(step, &self.inboxes[inbox], &withdrawn, Reason::Superseded);
        }
    }
}
