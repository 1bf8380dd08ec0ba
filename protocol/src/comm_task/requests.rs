//! The user layer down (§5.2.1): what the task asks for.

use super::desk::{Answer, Phase};
use super::memory::Fate;
use super::{CommTask, Outbox, Pending, Role, note};
use crate::ids::{MessageId, PortId, TaskId};
use crate::mapping;
use crate::observe::Event;
use crate::packet::Contents;
use crate::queue::Slot;
use crate::request::{Fault, ReplyTo, Request, Signal, Target};
use crate::rules::{Aging, Memory, TimeStamp};
use crate::table::{NodeTable, Port};
use crate::ticks::Ticks;

impl CommTask {
    /// The task's request: it always outranks what the communication task is doing (§5.2.1).
    pub(super) fn request(&mut self, table: &NodeTable, request: &Request, out: &mut impl Outbox) {
        let done = match *request {
            Request::Cancel => Ok(Some(self.cancel(table, out))),
            Request::Abandon => Ok(Some(self.abandon(table, out))),
            Request::Reply { to, contents } => self.reply(table, to, contents, out).map(Some),
            Request::Done => self.done().map(Some),
            _ if self.top().pending != Pending::Nothing => Err(Fault::Busy),
            Request::Order(order) => {
                self.set_order(order);
                Ok(Some(Signal::Accepted(0)))
            }
            Request::Send { port, to, contents, time_out } => {
                self.send(table, port, to, contents, time_out, out)
            }
            Request::Part { port, index, contents } => self.stage(port, index, contents).map(Some),
            Request::Get { port, source, time_out } => self.get(table, port, source, time_out, out),
            Request::Arrive { port, arguments, time_out } => {
                self.arrive(table, port, arguments, time_out, out)
            }
            Request::Handle { port, handled } => self.set_handled(port, handled).map(Some),
            Request::Delay { id, length } => self.delay(id, length, out),
            Request::Start { id, length } => self.start(id, length, out),
            Request::Stop { id } => {
                self.stop(id, out);
                Ok(Some(Signal::Accepted(0)))
            }
            Request::Boundary => {
                self.boundary(table, out);
                Ok(None)
            }
            Request::Work => {
                self.top_mut().pending = Pending::Work;
                Ok(None)
            }
            Request::Return => self.resume(table, out).map(|()| None),
            Request::Atomic(atomic) => {
                self.top_mut().atomic = atomic;
                Ok(Some(Signal::Accepted(0)))
            }
            Request::Lease => self.await_lease(),
            Request::Publish(contents) => self.publish(contents).map(Some),
            Request::End => {
                if let Some(lease) = &mut self.lease {
                    lease.retire();
                }
                Ok(Some(Signal::Accepted(0)))
            }
        };
        match done {
            Ok(Some(signal)) => out.signal(signal),
            Ok(None) => {}
            Err(fault) => {
                // What was staged for a message that is not sent is no part of the next one.
                if let Request::Send { port, .. } | Request::Reply { to: ReplyTo { port, .. }, .. } = *request
                {
                    self.unstage(port);
                }
                out.signal(Signal::Fault(fault));
            }
        }
    }

    fn send(
        &mut self,
        table: &NodeTable,
        id: PortId,
        to: Target,
        contents: Contents,
        time_out: Option<Ticks>,
        out: &mut impl Outbox,
    ) -> Result<Option<Signal>, Fault> {
        let (port, party) = mapping::own_end(table, id, self.task)?;
        // The declared life is what receivers and a restarted node reckon with: a request may only shorten it.
        let life = time_out.map_or(party.time_out, |wanted| wanted.min(party.time_out));
        let contents = if port.decl.guard.is_some() { self.under_lease(port, contents)? } else { contents };
        let local = usize::from(party.place);
        let message = (port, life, contents);
        match self.locals[local].role {
            Role::Sends => {
                let copies = match mapping::only_peer(port, self.task, to) {
                    Some(peer) => {
                        self.staged(local)?;
                        self.send_packets(table, local, peer, message, out);
                        1
                    }
                    None => {
                        let peers = mapping::destinations(port, self.task, to)?;
                        self.staged(local)?;
                        let mut copies = 0;
                        for peer in peers {
                            self.send_packets(table, local, peer, message, out);
                            copies += 1;
                        }
                        copies
                    }
                };
                self.locals[local].staged.clear();
                Ok(Some(Signal::Accepted(copies)))
            }
            Role::Asks(desk) => {
                let only = mapping::only_peer(port, self.task, to);
                let asked = match only {
                    Some(_) => 1,
                    None => mapping::destinations(port, self.task, to)?.count(),
                };
                if self.desks[usize::from(desk)].phase != Phase::Closed {
                    return Err(Fault::Busy);
                }
                self.staged(local)?;
                let packets = self.locals[local].staged.fragments().unwrap_or(1);
                self.desks[usize::from(desk)].forget();
                match only {
                    Some(peer) => self.ask(table, (desk, local), (peer, packets), message, out),
                    None => {
                        for peer in mapping::destinations(port, self.task, to)? {
                            self.ask(table, (desk, local), (peer, packets), message, out);
                        }
                    }
                }
                self.await_answers((desk, local), asked > 1, party.retry, message);
                self.locals[local].staged.clear();
                Ok(None)
            }
            Role::Receives(_) | Role::Meets(_) | Role::Replies | Role::Hears | Role::Beats => {
                Err(Fault::WrongUsage)
            }
        }
    }

    /// A class-2 message to one of the tasks that are asked (R26, R40).
    fn ask(
        &mut self,
        table: &NodeTable,
        (desk, local): (u16, usize),
        (peer, packets): (TaskId, u8),
        message: (&Port, Ticks, Contents),
        out: &mut impl Outbox,
    ) {
        let id = self.send_packets(table, local, peer, message, out);
        let desk = &mut self.desks[usize::from(desk)];
        if let Some(asked) = desk.find(peer) {
            let asked = &mut desk.asked[asked];
            (asked.id, asked.answer, asked.packets_out) = (id, Answer::Open, u16::from(packets));
        }
    }

    /// The task waits for the answers to what it asked.
    fn await_answers(
        &mut self,
        (desk, local): (u16, usize),
        set: bool,
        retries: u8,
        (port, life, contents): (&Port, Ticks, Contents),
    ) {
        let deadline = self.now + life;
        let copy_at = if retries > 0 { self.now + port.decl.resend } else { Ticks::FAR };
        self.top_mut().pending = Pending::Reply(desk);
        let desk = &mut self.desks[usize::from(desk)];
        (desk.phase, desk.set, desk.deadline) = (Phase::Open, set, deadline);
        (desk.copies_left, desk.copy_at) = (retries, copy_at);
        desk.contents = contents;
        desk.parts.copy(&self.locals[local].staged);
    }

    /// Sends a message, with what was staged for it, to one task.
    fn send_packets(
        &mut self,
        table: &NodeTable,
        local: usize,
        to: TaskId,
        (port, life, contents): (&Port, Ticks, Contents),
        out: &mut impl Outbox,
    ) -> MessageId {
        let id = MessageId { incarnation: self.incarnation, sequence: self.next_sequence };
        self.next_sequence = self.next_sequence.next();
        let packet = mapping::message(port, self.task, to, id, self.stamp(table, life), contents);
        let local = &mut self.locals[local];
        local.counters.sent += 1;
        note(out, Event::Sent, packet.port, to, id, life);
        mapping::in_fragments(packet, &local.staged, |packet| out.transmit(packet));
        id
    }

    fn unstage(&mut self, port: PortId) {
        if let Some(local) = self.local(port) {
            local.staged.clear();
        }
    }

    /// The time a message carries: what remains (§5.1), or under the variant the instant on this node's clock.
    pub(super) fn stamp(&self, table: &NodeTable, life: Ticks) -> Ticks {
        match table.rules().time_stamp {
            TimeStamp::Remaining => life,
            TimeStamp::Absolute => self.now + life,
        }
    }

    /// §5.2.1, procedure `get`: the most urgent message over the port heads, or remember what was asked for.
    fn get(
        &mut self,
        table: &NodeTable,
        port: Option<PortId>,
        source: Option<TaskId>,
        time_out: Option<Ticks>,
        out: &mut impl Outbox,
    ) -> Result<Option<Signal>, Fault> {
        if let Some(id) = port {
            match table.port(id).and_then(|port| self.role_at(port)) {
                None => return Err(Fault::NotYourPort),
                Some(Role::Receives(_)) => {}
                Some(
                    Role::Sends | Role::Asks(_) | Role::Meets(_) | Role::Replies | Role::Hears | Role::Beats,
                ) => {
                    return Err(Fault::WrongUsage);
                }
            }
        }
        if self.serve(table, port, source, out) {
            return Ok(None);
        }
        if time_out == Some(Ticks::ZERO) {
            return Ok(Some(Signal::Nothing));
        }
        let deadline = time_out.map_or(Ticks::FAR, |t| self.now + t);
        self.top_mut().pending = Pending::Get { port, source, deadline };
        Ok(None)
    }

    /// Hands over the most urgent message of what is asked for; false where there is none.
    pub(super) fn serve(
        &mut self,
        table: &NodeTable,
        port: Option<PortId>,
        source: Option<TaskId>,
        out: &mut impl Outbox,
    ) -> bool {
        let Some((inbox, slot)) = self.most_urgent(table, port, source) else { return false };
        if port.is_none() && source.is_none() && table.rules().aging != Aging::Off {
            // All other ports without a handler were passed over.
            self.served += 1;
        }
        let Some(message) = self.take(inbox, slot) else { return false };
        self.hand_over(inbox, &message, out);
        true
    }

    /// D14: a GET chooses among port heads: first one that was passed over too often (D58); then by urgency, class,
    /// `order`, port, source and arrival. Ports with a handler are not looked at unless they are named.
    fn most_urgent(
        &self,
        table: &NodeTable,
        port: Option<PortId>,
        source: Option<TaskId>,
    ) -> Option<(usize, Slot)> {
        let head = |at: usize| self.inboxes.get(at)?.head(source).map(|(slot, _)| (at, slot));
        if let Some(port) = port {
            let Some(Role::Receives(inbox)) = self.role_at(table.port(port)?) else { return None };
            return head(usize::from(inbox));
        }
        if source.is_none() {
            return head(self.next_served()?);
        }
        let open = self.inboxes.iter().enumerate().filter(|(_, inbox)| !inbox.handled);
        let heads = open.filter_map(|(at, inbox)| {
            let (slot, message) = inbox.head(source)?;
            let rank = self.order.rank(inbox.port, message.source);
            Some(((message.expires, message.class, rank, inbox.port), (at, slot)))
        });
        heads.min_by_key(|&(key, _)| key).map(|(_, place)| place)
    }

    fn reply(
        &mut self,
        table: &NodeTable,
        to: ReplyTo,
        contents: Contents,
        out: &mut impl Outbox,
    ) -> Result<Signal, Fault> {
        let (port, party) = mapping::own_end(table, to.port, self.task)?;
        let local = usize::from(party.place);
        let inbox = match self.locals[local].role {
            Role::Replies => {
                if !port.peers(self.task).any(|peer| peer == to.source) {
                    return Err(Fault::NotAPeer);
                }
                self.staged(local)?;
                self.locals[local].counters.sent += 1;
                self.send_answer((port, local), to, party.time_out, contents, out);
                return Ok(Signal::Accepted(1));
            }
            Role::Receives(inbox) => usize::from(inbox),
            Role::Sends | Role::Asks(_) | Role::Meets(_) | Role::Hears | Role::Beats => {
                return Err(Fault::NothingToAnswer);
            }
        };
        let Some(at) = self.inboxes[inbox].source(to.source) else { return Err(Fault::NothingToAnswer) };
        let left = self.answerable(inbox, at, to)?;
        self.staged(local)?;
        let entry = &mut self.inboxes[inbox];
        if let Some(remembered) = entry.sources[at].command_mut() {
            remembered.fate = Fate::Answered(contents);
        }
        if let Some(answer) = entry.answer_mut(at) {
            answer.copy(&self.locals[local].staged);
        }
        if table.rules().memory == Memory::UntilAnswered {
            entry.sources[at].remember(None);
        }
        self.send_answer((port, local), to, left, contents, out);
        Ok(Signal::Accepted(1))
    }

    /// Whether a reply to this message would still go out.
    #[must_use]
    pub fn can_answer(&self, to: &ReplyTo) -> bool {
        match self.role(to.port) {
            Some(Role::Replies) => true,
            Some(Role::Receives(inbox)) => {
                let inbox = usize::from(inbox);
                let source = self.inboxes[inbox].source(to.source);
                source.is_some_and(|source| self.answerable(inbox, source, *to).is_ok())
            }
            Some(Role::Sends | Role::Asks(_) | Role::Hears | Role::Meets(_) | Role::Beats) | None => false,
        }
    }

    /// The message of a task that was taken on this port and not answered: one at most (D75).
    #[must_use]
    pub fn owed(&self, port: PortId, task: TaskId) -> Option<ReplyTo> {
        let Some(Role::Receives(inbox)) = self.role(port) else { return None };
        let inbox = self.inboxes.get(usize::from(inbox))?;
        let known = inbox.sources[inbox.source(task)?].command()?;
        matches!(known.fate, Fate::Delivered(_)).then_some(ReplyTo { port, source: task, id: known.id })
    }

    /// What is left of the wait of the sender of a message that can still be answered.
    fn answerable(&self, inbox: usize, source: usize, to: ReplyTo) -> Result<Ticks, Fault> {
        // What is not remembered any more is over, and so is its sender's wait.
        let known = self.inboxes[inbox].sources[source].command().filter(|c| c.until > self.now);
        let Some(remembered) = known else { return Err(Fault::Late) };
        if remembered.id != to.id {
            // A newer message took the slot: its sender has given this one up.
            let newer = remembered.id.sequence.is_newer_than(to.id.sequence);
            return Err(if newer { Fault::Late } else { Fault::NothingToAnswer });
        }
        let Fate::Delivered(budget_ends) = remembered.fate else { return Err(Fault::NothingToAnswer) };
        if budget_ends <= self.now {
            return Err(Fault::Late);
        }
        Ok(remembered.sender_until - self.now)
    }

    fn send_answer(
        &mut self,
        (port, local): (&Port, usize),
        to: ReplyTo,
        left: Ticks,
        contents: Contents,
        out: &mut impl Outbox,
    ) {
        note(out, Event::Replied, to.port, to.source, to.id, left);
        let packet = mapping::answer(to, self.task, mapping::answer_kind(port), left, contents);
        let staged = &mut self.locals[local].staged;
        mapping::in_fragments(packet, &*staged, |packet| out.transmit(packet));
        staged.clear();
    }

    fn arrive(
        &mut self,
        table: &NodeTable,
        id: PortId,
        arguments: [u8; 8],
        time_out: Option<Ticks>,
        out: &mut impl Outbox,
    ) -> Result<Option<Signal>, Fault> {
        let (_, party) = mapping::own_end(table, id, self.task)?;
        let Some(Role::Meets(meeting)) = self.role(id) else { return Err(Fault::WrongUsage) };
        if self.meetings[usize::from(meeting)].deadline.is_some() {
            return Err(Fault::Busy);
        }
        // As for messages: the declared patience is what a restarted partner waits for, so it may only be shortened.
        let patience = time_out.map_or(party.time_out, |wanted| wanted.min(party.time_out));
        self.top_mut().pending = Pending::Meeting(meeting);
        self.meet(table, meeting, out, |rendezvous, at, out| rendezvous.reach(at, arguments, patience, out));
        Ok(None)
    }

    fn set_handled(&mut self, port: PortId, handled: bool) -> Result<Signal, Fault> {
        match self.role(port) {
            Some(Role::Receives(inbox)) => {
                let entry = &mut self.inboxes[usize::from(inbox)];
                entry.handled = handled;
                entry.begin(self.served);
                if handled {
                    entry.queue.watch();
                    self.heads.watch(&self.inboxes);
                }
                self.touch(usize::from(inbox));
                Ok(Signal::Accepted(0))
            }
            Some(
                Role::Sends | Role::Asks(_) | Role::Meets(_) | Role::Replies | Role::Hears | Role::Beats,
            ) => Err(Fault::WrongUsage),
            None => Err(Fault::NotYourPort),
        }
    }

    fn done(&mut self) -> Result<Signal, Fault> {
        if self.top().pending == Pending::Work {
            self.top_mut().pending = Pending::Nothing;
            return Ok(Signal::Accepted(0));
        }
        let below = self.running().iter().any(|level| level.pending == Pending::Work);
        Err(if below { Fault::Busy } else { Fault::WrongUsage })
    }

    fn cancel(&mut self, table: &NodeTable, out: &mut impl Outbox) -> Signal {
        match core::mem::replace(&mut self.top_mut().pending, Pending::Nothing) {
            Pending::Meeting(meeting) => {
                self.meet(table, meeting, out, |rendezvous, at, out| rendezvous.leave(at, out));
            }
            Pending::Delay(id, _) => out.disarm(id),
            Pending::Reply(desk) => self.desks[usize::from(desk)].close(),
            Pending::Nothing | Pending::Get { .. } | Pending::Work | Pending::Lease | Pending::Boundary => {}
        }
        Signal::Cancelled
    }

    /// Every wait ends, and every handler: the task begins anew. What waits for it stays.
    fn abandon(&mut self, table: &NodeTable, out: &mut impl Outbox) -> Signal {
        loop {
            self.cancel(table, out);
            *self.top_mut() = super::Level::NEW;
            if self.depth == 0 {
                break;
            }
            self.depth -= 1;
        }
        for desk in &mut self.desks {
            desk.close();
        }
        for local in &mut self.locals {
            local.staged.clear();
        }
        self.stop_all(out);
        Signal::Cancelled
    }
}
