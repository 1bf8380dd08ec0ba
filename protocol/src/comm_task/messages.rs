//! The user layer up (§5.2.1): packets for the task.

use super::inbox::{Admission, Aged, Held};
use super::memory::{Fate, Remembered, Seen};
use super::rendezvous::is_older;
use super::{CommTask, Outbox, Pending, Role, note};
use crate::ids::{Incarnation, MessageId, PortId, TaskId};
use crate::mapping;
use crate::observe::{Event, Reason};
use crate::packet::{Class, Control, Kind, Packet};
use crate::queue::Slot;
use crate::request::{Delivery, ReplyTo, Signal};
use crate::rules::{Memory, TimeStamp};
use crate::table::{NodeTable, Port};
use crate::ticks::Ticks;

impl CommTask {
    /// A packet for the task.
    pub(super) fn packet(&mut self, table: &NodeTable, packet: &Packet, out: &mut impl Outbox) {
        let admitted = table.port(packet.port).filter(|port| port.admits(packet.source, self.task));
        let Some((port, role)) = admitted.and_then(|port| Some((port, self.role_at(port)?))) else {
            return self.drop_packet(packet, Reason::NotAllowed, out);
        };
        match (packet.kind, role) {
            (Kind::Send | Kind::Query, Role::Receives(inbox))
                if packet.kind == mapping::message_kind(port) && packet.class == port.decl.class =>
            {
                self.message(table, port, usize::from(inbox), packet, out);
                self.touch(usize::from(inbox));
            }
            (Kind::Reply | Kind::Response, Role::Asks(desk)) if packet.kind == mapping::answer_kind(port) => {
                self.answer(table, desk, packet, out);
            }
            (Kind::Control, Role::Asks(desk)) => self.answer(table, desk, packet, out),
            (Kind::Reply, Role::Hears) => self.third_party(table, packet, out),
            (Kind::Query | Kind::Response, Role::Beats) => {
                self.beat(table, out, |lease, at, out| lease.hear(at, port, packet, out));
            }
            (Kind::Arrive | Kind::Confirm | Kind::Abort, Role::Meets(meeting)) => {
                self.meet(table, meeting, out, |rendezvous, at, out| rendezvous.hear(at, packet, out));
            }
            (
                Kind::Send
                | Kind::Query
                | Kind::Reply
                | Kind::Response
                | Kind::Control
                | Kind::Arrive
                | Kind::Confirm
                | Kind::Abort,
                Role::Sends
                | Role::Asks(_)
                | Role::Receives(_)
                | Role::Meets(_)
                | Role::Replies
                | Role::Hears
                | Role::Beats,
            ) => self.drop_packet(packet, Reason::NotAllowed, out),
        }
    }

    /// A packet of a message for the task: what is new in it goes on once it is whole.
    fn message(
        &mut self,
        table: &NodeTable,
        port: &Port,
        inbox: usize,
        packet: &Packet,
        out: &mut impl Outbox,
    ) {
        let remaining = match table.rules().time_stamp {
            TimeStamp::Remaining => packet.remaining,
            TimeStamp::Absolute => packet.remaining - self.now,
        };
        let way_back = table.bound_between(self.task, packet.source);
        let reserved = match packet.class {
            Class::Command if table.rules().reserve_way_back => way_back,
            Class::Command | Class::Status => Ticks::ZERO,
        };
        if packet.fragment.saturating_add(u8::from(packet.more)) >= port.decl.fragments {
            return self.drop_packet(packet, Reason::NotAllowed, out);
        }
        if remaining <= reserved {
            return self.expire_on_arrival(packet, out);
        }
        let Some(source) = self.inboxes[inbox].source(packet.source) else { return };
        let counted;
        let packet = if remaining == packet.remaining {
            packet
        } else {
            counted = Packet { remaining, ..*packet };
            &counted
        };
        if !self.is_fresh(table, (inbox, source), port, (packet, reserved), out) {
            return;
        }
        let bounds = (reserved, way_back);
        if packet.more || packet.fragment > 0 {
            if let Some((whole, fragments)) = self.assemble((inbox, source), packet, reserved, out) {
                self.take_in(table, port, (inbox, source), (&whole, fragments), bounds, out);
            }
        } else {
            self.overtake((inbox, source), packet, out);
            self.take_in(table, port, (inbox, source), (packet, 1), bounds, out);
        }
    }

    /// Whether the message was not taken before, and comes from the present life of its source.
    fn is_fresh(
        &mut self,
        table: &NodeTable,
        (inbox, source): (usize, usize),
        port: &Port,
        (packet, reserved): (&Packet, Ticks),
        out: &mut impl Outbox,
    ) -> bool {
        if packet.class == Class::Command && self.turns_away(table, packet.source) {
            // D49: it may be a copy of one that the earlier life ran.
            self.control(packet, Control::Restarted, out);
            return false;
        }
        if !self.enter_life(packet.source, packet.id.incarnation, out) {
            self.drop_packet(packet, Reason::StaleIncarnation, out);
            return false;
        }
        match self.inboxes[inbox].sources[source].look_up(packet.id, self.now) {
            Seen::New => return true,
            Seen::Again(Fate::Held) => self.prolong((inbox, source), packet, reserved),
            Seen::Older | Seen::Again(Fate::Lapsed | Fate::Delivered(_)) => {}
            // Of several fragments the last one is answered.
            Seen::Again(_) if packet.more => {}
            Seen::Again(Fate::Refused) => self.control(packet, Control::Refused, out),
            Seen::Again(Fate::Answered(contents)) => {
                let kind = mapping::answer_kind(port);
                let to = ReplyTo { port: packet.port, source: packet.source, id: packet.id };
                let answer = mapping::answer(to, self.task, kind, packet.remaining, contents);
                let more = self.inboxes[inbox].answer(source);
                mapping::in_fragments(answer, more, |packet| out.transmit(packet));
            }
        }
        self.duplicate(packet, out);
        false
    }

    /// A copy of a command that waits: what a link charges is only a bound (D20), so the one that has most time left says
    /// best when the sender's wait ends. Of a long message the first whole copy counts.
    fn prolong(&mut self, (inbox, source): (usize, usize), packet: &Packet, reserved: Ticks) {
        let sender_until = self.now + packet.remaining;
        let expires = sender_until - reserved;
        let inbox = &mut self.inboxes[inbox];
        let Some(slot) = inbox.find(packet.source, packet.id) else { return };
        let short = packet.fragment == 0 && !packet.more;
        if !short || inbox.queue.get(slot).is_none_or(|held| held.fragments > 1 || held.expires >= expires) {
            return;
        }
        inbox.queue.change(slot, |held, _| held.expires = expires);
        if let Some(remembered) = inbox.sources[source].command_mut() {
            remembered.sender_until = remembered.sender_until.max(sender_until);
            remembered.until = remembered.until.max(sender_until);
        }
    }

    /// A whole message that is new: handed over at once if the task has asked for it, offered if there is a handler, else
    /// stored (R24, R25).
    fn take_in(
        &mut self,
        table: &NodeTable,
        port: &Port,
        (inbox, source): (usize, usize),
        (packet, fragments): (&Packet, u8),
        (reserved, way_back): (Ticks, Ticks),
        out: &mut impl Outbox,
    ) {
        let contents = match port.decl.guard {
            None => packet.contents,
            Some(couple) => {
                let said = self.within_epoch(table, port, (couple, inbox, source), packet, out);
                let Some(contents) = said else { return };
                contents
            }
        };
        let now = self.now;
        // What a link charges is only a bound: this copy may have been charged more than a later one will be. So copies
        // are remembered as long as the declared life lets any of them arrive, not as long as this one seems to live.
        let declared = port.party(packet.source).map_or(Ticks::ZERO, |party| party.time_out);
        let until = now + declared.max(packet.remaining) + way_back;
        match packet.class {
            Class::Status => {
                self.inboxes[inbox].sources[source].admit(packet.id.sequence, now, until);
            }
            Class::Command => {
                self.withdraw_superseded((inbox, source), out);
                if table.rules().memory != Memory::None {
                    let sender_until = now + packet.remaining;
                    let new = Remembered { id: packet.id, fate: Fate::Held, sender_until, until };
                    self.inboxes[inbox].sources[source].remember(Some(new));
                }
            }
        }
        let mut held = Held {
            source: packet.source,
            incarnation: packet.id.incarnation,
            sequence: packet.id.sequence,
            class: packet.class,
            expires: now + packet.remaining - reserved,
            contents,
            fragments,
            arrival: 0,
        };
        let mut aged = Aged::default();
        if self.inboxes[inbox].latest && !self.supersedes(inbox, &held, out) {
            self.inboxes[inbox].close(source, held.id());
            return self.discard(packet.port, &held, Reason::Superseded, out);
        }
        if self.wants(inbox, packet) {
            self.top_mut().pending = Pending::Nothing;
            let local = self.inboxes[inbox].local;
            self.count_at(local, |c| c.enqueued += 1);
            self.take_assembled((inbox, source), &held);
            return self.hand_over(inbox, &held, out);
        }
        if self.inboxes[inbox].handled && self.interruptible(false) {
            if self.held_outranks(table, packet.port, &held, aged) {
                self.count(packet.port, |c| c.enqueued += 1);
                self.take_assembled((inbox, source), &held);
                return self.interrupt(inbox, &held, out);
            }
            self.reject_arrived(table, packet.port, (&mut held, &mut aged), out);
        }
        self.store_message(port, (inbox, source), (held, aged), out);
        self.inboxes[inbox].close(source, held.id());
    }

    fn wants(&self, inbox: usize, packet: &Packet) -> bool {
        let handled = self.inboxes[inbox].handled;
        matches!(self.top().pending, Pending::Get { port, source, .. }
            if port.map_or(!handled, |p| p == packet.port) && source.is_none_or(|s| s == packet.source))
    }

    /// On a port where the latest message counts: whether this one is it. The one it takes the place of goes.
    fn supersedes(&mut self, inbox: usize, newcomer: &Held, out: &mut impl Outbox) -> bool {
        let Some((slot, held)) = self.inboxes[inbox].of_source(newcomer.source) else { return true };
        let same_life = held.incarnation == newcomer.incarnation;
        if newcomer.class == Class::Status && same_life && held.sequence.is_newer_than(newcomer.sequence) {
            return false;
        }
        if let Some(old) = self.inboxes[inbox].queue.remove(slot) {
            let port = self.inboxes[inbox].port;
            self.discard(port, &old, Reason::Superseded, out);
        }
        true
    }

    pub(super) fn discard(&mut self, port: PortId, held: &Held, reason: Reason, out: &mut impl Outbox) {
        self.count(port, |c| c.dropped += 1);
        note(out, Event::Discarded(reason), port, held.source, held.id(), held.expires - self.now);
    }

    fn store_message(
        &mut self,
        port: &Port,
        (inbox, source): (usize, usize),
        (message, aged): (Held, Aged),
        out: &mut impl Outbox,
    ) {
        let message = Held { arrival: self.arrivals, ..message };
        self.arrivals += 1;
        let served = self.served;
        let entry = &mut self.inboxes[inbox];
        let (id, local) = (entry.port, entry.local);
        let left = message.expires - self.now;
        let (slot, lost) = match entry.admit(message, aged, served) {
            Admission::Kept(slot) => (Some(slot), None),
            Admission::Replaced(slot, evicted) => (Some(slot), Some((evicted, Reason::Evicted))),
            Admission::Turned => (None, Some((message, Reason::Refused))),
        };
        if let Some(slot) = slot {
            if let Some(long) = &mut entry.long {
                long.keep((slot, source), rest_of(message.fragments));
            }
            self.count_at(local, |c| c.enqueued += 1);
            note(out, Event::Enqueued, id, message.source, message.id(), left);
        }
        let Some((lost, reason)) = lost else { return };
        self.count(id, |c| if slot.is_none() { c.refused += 1 } else { c.evicted += 1 });
        note(out, Event::Discarded(reason), id, lost.source, lost.id(), lost.expires - self.now);
        if lost.class == Class::Command {
            self.refuse(port, inbox, lost.source, lost.id(), out);
        }
    }

    /// D21: the source of a refused command hears of it at once, and again for every copy (D52).
    fn refuse(
        &mut self,
        port: &Port,
        inbox: usize,
        source: TaskId,
        message: MessageId,
        out: &mut impl Outbox,
    ) {
        if let Some(at) = self.inboxes[inbox].source(source)
            && let Some(remembered) = self.inboxes[inbox].sources[at].command_mut()
            && remembered.id == message
        {
            remembered.fate = Fate::Refused;
        }
        let life = port.party(source).map_or(Ticks::ZERO, |party| party.time_out);
        let to = ReplyTo { port: port.id, source, id: message };
        let word = Control::Refused.to_contents();
        out.transmit(mapping::answer(to, self.task, Kind::Control, life, word));
    }

    fn control(&self, request: &Packet, control: Control, out: &mut impl Outbox) {
        if request.more {
            return;
        }
        let to = ReplyTo { port: request.port, source: request.source, id: request.id };
        let word = control.to_contents();
        out.transmit(mapping::answer(to, self.task, Kind::Control, request.remaining, word));
    }

    /// Takes a message out of a port's buffer to hand it over.
    pub(super) fn take(&mut self, inbox: usize, slot: Slot) -> Option<Held> {
        let entry = &mut self.inboxes[inbox];
        let held = entry.queue.remove(slot)?;
        entry.begin(self.served);
        self.taken.0 = Some(held.contents);
        match entry.body(slot) {
            Some(body) => self.taken.1.copy(body),
            None => self.taken.1.clear(),
        }
        self.touch(inbox);
        Some(held)
    }

    /// As [`take`](Self::take), of a message that was never stored.
    fn take_assembled(&mut self, (inbox, source): (usize, usize), held: &Held) {
        self.taken.0 = Some(held.contents);
        if held.fragments < 2 {
            return self.taken.1.clear();
        }
        if let Some(assembly) = self.inboxes[inbox].assembly(source) {
            self.taken.1.fill(rest_of(held.fragments), assembly.contents.iter().skip(1));
        }
    }

    pub(super) fn hand_over(&mut self, inbox: usize, message: &Held, out: &mut impl Outbox) {
        let delivery = self.delivery(inbox, message, out);
        out.signal(Signal::Message(delivery));
    }

    /// The task takes a message: from here on its execution budget runs.
    pub(super) fn delivery(&mut self, inbox: usize, message: &Held, out: &mut impl Outbox) -> Delivery {
        let entry = &mut self.inboxes[inbox];
        let (port, local) = (entry.port, entry.local);
        if let Some(at) = entry.source(message.source) {
            let closed = entry.close(at, message.id());
            if let Some(remembered) = entry.sources[at].command_mut()
                && remembered.id == message.id()
            {
                remembered.fate = Fate::Delivered(message.expires);
            }
            if closed {
                self.touch(inbox);
            }
        }
        let budget = message.expires - self.now;
        self.count_at(local, |c| c.delivered += 1);
        note(out, Event::Delivered, port, message.source, message.id(), budget);
        Delivery {
            from: ReplyTo { port, source: message.source, id: message.id() },
            class: message.class,
            budget,
            contents: message.contents,
            fragments: message.fragments,
        }
    }

    /// Whether a message comes from the present life of its source. What an earlier life left waiting goes with the
    /// memory of it: nobody waits for its answer.
    fn enter_life(&mut self, source: TaskId, life: Incarnation, out: &mut impl Outbox) -> bool {
        let Ok(at) = self.lives.binary_search_by_key(&source, |known| known.task) else { return false };
        match self.lives[at].life {
            Some(known) if is_older(life, known) => return false,
            Some(known) if known != life => {
                for inbox in 0..self.inboxes.len() {
                    if let Some(entry) = self.inboxes[inbox].source(source) {
                        self.withdraw_superseded((inbox, entry), out);
                        self.inboxes[inbox].forget(entry);
                        self.touch(inbox);
                    }
                }
            }
            Some(_) | None => {}
        }
        self.lives[at].life = Some(life);
        true
    }

    /// The source has one outstanding request on a port: a newer command means that it gave the held one up (D12).
    fn withdraw_superseded(&mut self, (inbox, source): (usize, usize), out: &mut impl Outbox) {
        let now = self.now;
        let entry = &self.inboxes[inbox].sources[source];
        let task = entry.task;
        let Some(old) = entry.command() else { return };
        if !matches!(old.fate, Fate::Held) || old.until <= now {
            return;
        }
        let id = old.id;
        if let Some(withdrawn) = self.inboxes[inbox].withdraw(task, id) {
            let port = self.inboxes[inbox].port;
            self.discard(port, &withdrawn, Reason::Superseded, out);
        }
    }

    fn expire_on_arrival(&mut self, packet: &Packet, out: &mut impl Outbox) {
        self.count(packet.port, |c| c.expired += 1);
        let reason = Event::Discarded(Reason::ExpiredOnTheWay);
        note(out, reason, packet.port, packet.source, packet.id, Ticks::ZERO);
    }

    pub(super) fn duplicate(&mut self, packet: &Packet, out: &mut impl Outbox) {
        self.count(packet.port, |c| c.duplicates += 1);
        let reason = Event::Discarded(Reason::Duplicate);
        note(out, reason, packet.port, packet.source, packet.id, packet.remaining);
    }

    pub(super) fn drop_packet(&mut self, packet: &Packet, reason: Reason, out: &mut impl Outbox) {
        self.count(packet.port, |c| c.dropped += 1);
        note(out, Event::Discarded(reason), packet.port, packet.source, packet.id, packet.remaining);
    }
}

/// Which fragments a message has after its first one.
fn rest_of(fragments: u8) -> u16 {
    1_u16.checked_shl(u32::from(fragments.saturating_sub(1))).map_or(u16::MAX, |bit| bit.wrapping_sub(1))
}
