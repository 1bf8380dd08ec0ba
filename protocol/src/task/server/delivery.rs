//! What happens to a waiting message until it is answered: GET, delivery with the execution budget, and REPLY (§5.2.1).

use super::inbox::{Admission, Inbox, RetryState};
use super::memory::{CommandStatus, DedupEntry, Memory};
use super::{Held, Origin, Server, rest_of};
use crate::ids::{MessageId, TaskId};
use crate::mapping;
use crate::observe::Event;
use crate::packet::{Class, Contents};
use crate::queue::Slot;
use crate::request::{Delivery, Fault, ReplyTo};
use crate::rules::{self, Aging};
use crate::table::{Party, Port};
use crate::task::own::Own;
use crate::task::step::{Outbox, Step};
use crate::ticks::{Instant, Ticks};

impl Server {
    /// Removes and returns the most urgent message of one inbox, or of all inboxes without a handler. The message may be
    /// limited to one source.
    pub fn next(
        &mut self,
        step: &Step<'_, impl Outbox>,
        inbox: Option<u16>,
        source: Option<TaskId>,
    ) -> Option<(Origin, Held)> {
        let (at, slot) = self.most_urgent(step.own, inbox, source)?;
        if inbox.is_none() && source.is_none() && step.table.rules().aging != Aging::Off {
            // This counts the GET as a bypass of every other port without a handler.
            self.served += 1;
        }
        self.take(step.own, at, slot)
    }

    /// Chooses the message for a GET. In a GET over all ports, a port that was bypassed too often goes first (D58); then
    /// urgency, class, `order`, port, source and arrival decide. A port with a handler is served only if the GET names it
    /// (D14).
    fn most_urgent(&self, own: &Own, inbox: Option<u16>, source: Option<TaskId>) -> Option<(usize, Slot)> {
        let head = |at: usize| self.inboxes.get(at)?.head(source).map(|(slot, _)| (at, slot));
        if let Some(inbox) = inbox {
            return head(usize::from(inbox));
        }
        if source.is_none() {
            return head(self.next_served(own)?);
        }
        let open = self.inboxes.iter().enumerate().filter(|(_, inbox)| !inbox.handled);
        let ready = open.filter_map(|(at, inbox)| {
            let (slot, message) = inbox.head(source)?;
            let rank = own.order.rank(inbox.port, message.source);
            Some(((message.expires, message.class, rank, inbox.port), (at, slot)))
        });
        ready.min_by_key(|&(key, _)| key).map(|(_, place)| place)
    }

    /// Removes a message from a port's buffer to deliver it.
    pub fn take(&mut self, own: &Own, inbox: usize, slot: Slot) -> Option<(Origin, Held)> {
        let entry = &mut self.inboxes[inbox];
        let held = entry.queue.remove(slot)?;
        entry.begin(self.served);
        self.taken.0 = Some(held.contents);
        match entry.body(slot) {
            Some(body) => self.taken.1.copy(body),
            None => self.taken.1.clear(),
        }
        let source = entry.source(held.source)?;
        self.touch(own, inbox);
        Some(((inbox, source), held))
    }

    /// Like [`take`](Self::take), for a message that the task takes as it arrives, so that the buffer never stored it.
    pub(super) fn take_assembled(&mut self, (inbox, source): Origin, held: &Held) {
        self.taken.0 = Some(held.contents);
        if held.fragments < 2 {
            return self.taken.1.clear();
        }
        if let Some(assembly) = self.inboxes[inbox].assembly(source) {
            self.taken.1.fill(rest_of(held.fragments), assembly.contents.iter().skip(1));
        }
    }

    /// Fragment `index` of the message that the task took last; the first one is 0.
    pub fn fragment(&self, index: u8) -> Option<&Contents> {
        if index == 0 { self.taken.0.as_ref() } else { self.taken.1.get(index) }
    }

    /// Delivers a message to the task, whose execution budget then begins.
    pub fn deliver(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        (inbox, source): Origin,
        message: &Held,
    ) -> Delivery {
        let entry = &mut self.inboxes[inbox];
        let (port, endpoint) = (entry.port, entry.endpoint);
        entry.settle(source, message.id(), CommandStatus::Delivered(message.expires));
        if entry.close(source, message.id()) {
            self.touch(step.own, inbox);
        }
        let budget = message.expires - step.now();
        step.count(endpoint, |c| c.delivered += 1);
        step.note(Event::Delivered, port, message.source, message.id(), budget);
        Delivery {
            from: ReplyTo { port, source: message.source, id: message.id() },
            class: message.class,
            budget,
            contents: message.contents,
            fragments: message.fragments,
        }
    }

    /// Records the task's answer to a message. Returns the time for which the sender still waits.
    pub fn reply(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        (inbox, source): Origin,
        to: ReplyTo,
        contents: Contents,
    ) -> Result<Ticks, Fault> {
        let entry = &mut self.inboxes[inbox];
        let place = usize::from(entry.endpoint);
        let left = entry.answerable(source, to, step.now())?;
        step.own.staged(place)?;
        entry.settle(source, to.id, CommandStatus::Answered(contents));
        if let Some(answer) = entry.answer_mut(source) {
            answer.copy(&step.own.endpoints[place].staged);
        }
        if step.table.rules().memory == rules::Memory::UntilAnswered {
            entry.sources[source].remember(None);
        }
        Ok(left)
    }

    /// [`reply`](Self::reply) in a fused step. Returns `None`, and changes nothing, if the message cannot be answered.
    #[inline(always)]
    pub fn answer_fused(
        &mut self,
        (inbox, source): Origin,
        to: ReplyTo,
        contents: Contents,
        now: Instant,
    ) -> Option<Ticks> {
        let entry = &mut self.inboxes[inbox];
        let left = entry.answerable(source, to, now).ok()?;
        entry.sources[source].command_mut()?.status = CommandStatus::Answered(contents);
        Some(left)
    }

    /// Whether [`hear`](Self::hear) would simply take this message in: the message is new, and no earlier command of its
    /// source waits.
    #[inline(always)]
    pub fn takes_fused(&self, (inbox, source): Origin, id: MessageId, now: Instant) -> bool {
        let inbox = &self.inboxes[inbox];
        let known = &inbox.sources[source];
        !inbox.latest && known.is_next(id, now) && self.knows(known.task, id.incarnation)
    }

    /// [`hear`](Self::hear) and [`deliver`](Self::deliver) in a fused step (one step for sender and receiver), for a message for
    /// which [`takes_fused`](Self::takes_fused) is true.
    #[inline(always)]
    pub fn take_fused(
        &mut self,
        origin: Origin,
        id: MessageId,
        (from, ttl, contents): (&Party, Ticks, Contents),
        now: Instant,
    ) -> Delivery {
        let class = self.remember_fused(origin, id, CommandStatus::Delivered(now + ttl), (from, ttl, now));
        self.taken.0 = Some(contents);
        self.taken.1.clear();
        let from = ReplyTo { port: self.inboxes[origin.0].port, source: from.task, id };
        Delivery { from, class, budget: ttl, contents, fragments: 1 }
    }

    /// Whether the buffer of a port takes another message without evicting one.
    pub fn has_room(&self, inbox: u16) -> bool {
        let queue = &self.inboxes[usize::from(inbox)].queue;
        queue.len() < queue.capacity()
    }

    /// Stores a message in its port's buffer in a fused step, as [`hear`](Self::hear) does. The caller has checked that the
    /// port has no handler, that its buffer [has room](Self::has_room), and that [`takes_fused`](Self::takes_fused) is true
    /// for the message.
    pub fn store_fused(
        &mut self,
        own: &Own,
        origin: Origin,
        id: MessageId,
        (from, ttl, contents): (&Party, Ticks, Contents),
    ) {
        let class = self.remember_fused(origin, id, CommandStatus::Held, (from, ttl, own.now));
        let held = Held {
            source: from.task,
            incarnation: id.incarnation,
            sequence: id.sequence,
            class,
            expires: own.now + ttl,
            contents,
            fragments: 1,
            arrival: self.arrivals,
        };
        self.arrivals += 1;
        let inbox = &mut self.inboxes[origin.0];
        let stored = inbox.admit(held, RetryState::default(), self.served);
        // The ready set depends only on the most urgent message of each port.
        if inbox.queue.first().map(|(slot, _)| Admission::Kept(slot)) == Some(stored) {
            self.touch(own, origin.0);
        }
    }

    /// Records a message from a task of this node, so that its copies are recognised. No link has charged the message.
    /// Returns its class.
    #[inline(always)]
    fn remember_fused(
        &mut self,
        (inbox, source): Origin,
        id: MessageId,
        status: CommandStatus,
        (from, ttl, now): (&Party, Ticks, Instant),
    ) -> Class {
        let until = now + from.time_out.max(ttl);
        match &mut self.inboxes[inbox].sources[source].memory {
            Memory::Command(entry) => {
                *entry = Some(DedupEntry { id, status, sender_until: now + ttl, until });
                Class::Command
            }
            Memory::Status(window) => {
                window.admit(id.sequence, now, until);
                Class::Status
            }
        }
    }

    /// Whether the task has a handler for messages of an inbox.
    #[inline]
    pub fn is_handled(&self, inbox: u16) -> bool {
        self.inboxes[usize::from(inbox)].handled
    }

    /// Whether the server would still send a reply to this message.
    pub fn can_answer(&self, inbox: u16, to: &ReplyTo, now: Instant) -> bool {
        let inbox = &self.inboxes[usize::from(inbox)];
        inbox.source(to.source).is_some_and(|source| inbox.answerable(source, *to, now).is_ok())
    }

    /// The message of `task` that this task took from an inbox and has not answered; there is at most one (D75).
    pub fn owed(&self, inbox: u16, task: TaskId) -> Option<ReplyTo> {
        let inbox = self.inboxes.get(usize::from(inbox))?;
        let known = inbox.sources[inbox.source(task)?].command()?;
        let owes = matches!(known.status, CommandStatus::Delivered(_));
        owes.then_some(ReplyTo { port: inbox.port, source: task, id: known.id })
    }
}

impl Inbox {
    /// The time for which the sender still waits, if the message can still be answered.
    #[inline(always)]
    fn answerable(&self, source: usize, to: ReplyTo, now: Instant) -> Result<Ticks, Fault> {
        // When the dedup entry has ended, the sender's wait has ended, too.
        let known = self.sources[source].command().filter(|c| c.until > now);
        let Some(dedup) = known else { return Err(Fault::Late) };
        if dedup.id != to.id {
            // If a newer command has replaced the entry, the sender has given up this command.
            let newer = dedup.id.sequence.is_newer_than(to.id.sequence);
            return Err(if newer { Fault::Late } else { Fault::NothingToAnswer });
        }
        let CommandStatus::Delivered(budget_ends) = dedup.status else { return Err(Fault::NothingToAnswer) };
        if budget_ends <= now {
            return Err(Fault::Late);
        }
        Ok(dedup.sender_until - now)
    }
}

/// Sends an answer with the fragments that the task has handed over for it.
pub(crate) fn send_answer(
    step: &mut Step<'_, impl Outbox>,
    (port, place): (&Port, usize),
    to: ReplyTo,
    left: Ticks,
    contents: Contents,
) {
    step.note(Event::Replied, to.port, to.source, to.id, left);
    let packet = mapping::answer(to, step.own.task, mapping::answer_kind(port), left, contents);
    let staged = &mut step.own.endpoints[place].staged;
    mapping::in_fragments(packet, &*staged, |packet| step.out.transmit(packet));
    staged.clear();
}
