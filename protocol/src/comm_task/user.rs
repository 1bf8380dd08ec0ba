//! The user layer (§5.2.1): the interface with the task, down (its requests) and up (messages for it).

use super::inbox::{Admission, Held};
use super::memory::{Fate, Remembered, Seen};
use super::rendezvous::is_older;
use super::{CommTask, Command, Outbox, Pending, Role, held, note};
use crate::ids::{Incarnation, MessageId, PortId, TaskId};
use crate::mapping;
use crate::observe::{Event, Reason};
use crate::packet::{Class, Contents, Control, Kind, Packet};
use crate::request::{Delivery, Fault, Outcome, ReplyTo, Request, Signal, Target};
use crate::rules::{Memory, TimeStamp};
use crate::table::{NodeTable, Port};
use crate::ticks::Ticks;

impl CommTask {
    /// The task's request: it always outranks what the communication task is doing (§5.2.1).
    pub(super) fn request(&mut self, table: &NodeTable, request: Request, out: &mut impl Outbox) {
        let done = match request {
            Request::Order(order) => {
                self.order = order;
                Ok(Some(Signal::Accepted(0)))
            }
            Request::Cancel => Ok(Some(self.cancel(table, out))),
            Request::Reply { to, contents } => self.reply(table, to, contents, out),
            _ if self.pending != Pending::Nothing => Err(Fault::Busy),
            Request::Send { port, to, contents, time_out } => {
                self.send(table, port, to, contents, time_out, out)
            }
            Request::Get { port, source, time_out } => self.get(port, source, time_out, out),
            Request::Arrive { port, arguments, time_out } => {
                self.arrive(table, port, arguments, time_out, out)
            }
            Request::Delay { id, length } => {
                let turn = self.next_turn;
                self.next_turn = turn.wrapping_add(1);
                self.pending = Pending::Delay(id, turn);
                out.arm(id, turn, length);
                Ok(None)
            }
            Request::Part { .. }
            | Request::Handle { .. }
            | Request::Start { .. }
            | Request::Stop { .. }
            | Request::Boundary
            | Request::Work
            | Request::Done
            | Request::Return
            | Request::Atomic(_)
            | Request::Lease
            | Request::Publish(_)
            | Request::Abandon => Err(Fault::WrongUsage),
        };
        match done {
            Ok(Some(signal)) => out.signal(signal),
            Ok(None) => {}
            Err(fault) => out.signal(Signal::Fault(fault)),
        }
    }

    /// A packet for the task.
    pub(super) fn packet(&mut self, table: &NodeTable, packet: &Packet, out: &mut impl Outbox) {
        let admitted = table.port(packet.port).filter(|port| port.admits(packet.source, self.task));
        let (Some(port), Some(role)) = (admitted, self.role(packet.port)) else {
            return self.drop_packet(packet, Reason::NotAllowed, out);
        };
        match (packet.kind, role) {
            (Kind::Send, Role::Receives(inbox)) if packet.class == port.decl.class => {
                self.message(table, port, inbox, packet, out);
            }
            (Kind::Reply | Kind::Control, Role::Sends) => self.answer(table, packet, out),
            (Kind::Arrive | Kind::Confirm | Kind::Abort, Role::Meets(meeting)) => {
                let released = self.meet(table, meeting, |rendezvous, at| {
                    let waited = rendezvous.deadline.is_some();
                    rendezvous.hear(at, packet, out);
                    waited && rendezvous.deadline.is_none()
                });
                if released == Some(true) {
                    self.pending = Pending::Nothing;
                }
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
                Role::Sends | Role::Receives(_) | Role::Meets(_),
            ) => self.drop_packet(packet, Reason::NotAllowed, out),
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
        if self.role(id) != Some(Role::Sends) {
            return Err(Fault::WrongUsage);
        }
        // The declared life is what receivers and a restarted node reckon with: a request may only shorten it.
        let life = time_out.map_or(party.time_out, |wanted| wanted.min(party.time_out));
        match port.decl.class {
            Class::Status => {
                let mut copies = 0;
                for peer in mapping::destinations(port, self.task, to)? {
                    self.send_packet(table, port, peer, life, contents, out);
                    copies += 1;
                }
                Ok(Some(Signal::Accepted(copies)))
            }
            Class::Command => {
                let mut peers = mapping::destinations(port, self.task, to)?;
                let (Some(peer), None) = (peers.next(), peers.next()) else {
                    return Err(Fault::WrongUsage);
                };
                let message = self.send_packet(table, port, peer, life, contents, out);
                let retries = port.decl.retry > 0;
                self.pending = Pending::Reply(Command {
                    port: id,
                    to: peer,
                    id: message,
                    deadline: self.now + life,
                    contents,
                    copies_left: port.decl.retry,
                    copy_at: if retries { self.now + port.decl.resend } else { Ticks::FAR },
                    copies_out: 1,
                });
                Ok(None)
            }
        }
    }

    fn send_packet(
        &mut self,
        table: &NodeTable,
        port: &Port,
        to: TaskId,
        life: Ticks,
        contents: Contents,
        out: &mut impl Outbox,
    ) -> MessageId {
        let id = MessageId { incarnation: self.incarnation, sequence: self.next_sequence };
        self.next_sequence = self.next_sequence.next();
        let packet = mapping::message(port, self.task, to, id, self.stamp(table, life), contents);
        self.count(packet.port, |c| c.sent += 1);
        note(out, Event::Sent, packet.port, to, id, life);
        out.transmit(packet);
        id
    }

    /// The time a message carries: what remains (§5.1), or under the variant the instant on this node's clock.
    fn stamp(&self, table: &NodeTable, life: Ticks) -> Ticks {
        match table.rules().time_stamp {
            TimeStamp::Remaining => life,
            TimeStamp::Absolute => self.now + life,
        }
    }

    /// D5: the same message_ID inside the one budget.
    pub(super) fn send_again(&mut self, table: &NodeTable, mut command: Command, out: &mut impl Outbox) {
        command.copies_left = command.copies_left.saturating_sub(1);
        command.copies_out = command.copies_out.saturating_add(1);
        let Some(port) = table.port(command.port) else { return };
        let more = command.copies_left > 0;
        command.copy_at = if more { self.now + port.decl.resend } else { Ticks::FAR };
        self.pending = Pending::Reply(command);
        let left = command.deadline - self.now;
        let stamp = self.stamp(table, left);
        let packet = mapping::message(port, self.task, command.to, command.id, stamp, command.contents);
        self.count(command.port, |c| c.resent += 1);
        note(out, Event::Resent, command.port, command.to, command.id, left);
        out.transmit(Packet { resent: true, ..packet });
    }

    /// §5.2.1, procedure `get`: the most urgent message over the port heads, or remember what was asked for.
    fn get(
        &mut self,
        port: Option<PortId>,
        source: Option<TaskId>,
        time_out: Option<Ticks>,
        out: &mut impl Outbox,
    ) -> Result<Option<Signal>, Fault> {
        if let Some(id) = port {
            match self.role(id) {
                None => return Err(Fault::NotYourPort),
                Some(Role::Receives(_)) => {}
                Some(Role::Sends | Role::Meets(_)) => return Err(Fault::WrongUsage),
            }
        }
        if let Some((inbox, slot)) = self.most_urgent(port, source) {
            if let Some(message) = self.inboxes[inbox].queue.remove(slot) {
                let port = self.inboxes[inbox].port;
                self.deliver(port, &message, out);
            }
            return Ok(None);
        }
        if time_out == Some(Ticks::ZERO) {
            return Ok(Some(Signal::Nothing));
        }
        let deadline = time_out.map_or(Ticks::FAR, |t| self.now + t);
        self.pending = Pending::Get { port, source, deadline };
        Ok(None)
    }

    /// D14: a GET chooses among port heads by urgency, then class, then `order`, then port, source and arrival.
    fn most_urgent(&self, port: Option<PortId>, source: Option<TaskId>) -> Option<(usize, u32)> {
        let asked = self.inboxes.iter().enumerate().filter(|(_, inbox)| port.is_none_or(|p| p == inbox.port));
        let heads = asked.filter_map(|(i, inbox)| {
            let (key, slot, message) = inbox.head(source)?;
            let rank = self.order.rank(inbox.port, message.source);
            Some(((message.expires, message.class, rank, inbox.port, key), (i, slot)))
        });
        heads.min_by_key(|&(key, _)| key).map(|(_, place)| place)
    }

    fn reply(
        &mut self,
        table: &NodeTable,
        to: ReplyTo,
        contents: Contents,
        out: &mut impl Outbox,
    ) -> Result<Option<Signal>, Fault> {
        let now = self.now;
        mapping::own_end(table, to.port, self.task)?;
        let Ok(at) = self.sources.binary_search_by_key(&to.source, |s| s.task) else {
            return Err(Fault::NothingToAnswer);
        };
        // What is not remembered any more is over, and so is its sender's wait.
        let known = self.sources[at].command.as_mut().filter(|c| c.until > now);
        let Some(remembered) = known else { return Err(Fault::Late) };
        if remembered.port != to.port || remembered.id != to.id {
            // A newer message took the slot: its sender has given this one up.
            let newer = remembered.id.sequence.is_newer_than(to.id.sequence);
            return Err(if newer { Fault::Late } else { Fault::NothingToAnswer });
        }
        let Fate::Delivered(budget_ends) = remembered.fate else { return Err(Fault::NothingToAnswer) };
        if budget_ends <= now {
            return Err(Fault::Late);
        }
        remembered.fate = Fate::Answered(contents);
        let left = remembered.sender_until - now;
        if table.rules().memory == Memory::UntilAnswered {
            self.sources[at].command = None;
        }
        let packet = mapping::answer(to, self.task, Kind::Reply, left, contents);
        note(out, Event::Replied, to.port, to.source, to.id, left);
        out.transmit(packet);
        Ok(Some(Signal::Accepted(1)))
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
        // As for messages: the declared patience is what a restarted partner waits for, so it may only be shortened.
        let patience = time_out.map_or(party.time_out, |wanted| wanted.min(party.time_out));
        self.pending = Pending::Meeting(meeting);
        let waits = self.meet(table, meeting, |rendezvous, at| {
            rendezvous.reach(at, arguments, patience, out);
            rendezvous.deadline.is_some()
        });
        if waits != Some(true) {
            self.pending = Pending::Nothing;
        }
        Ok(None)
    }

    fn cancel(&mut self, table: &NodeTable, out: &mut impl Outbox) -> Signal {
        match core::mem::replace(&mut self.pending, Pending::Nothing) {
            Pending::Meeting(meeting) => {
                self.meet(table, meeting, |rendezvous, at| rendezvous.leave(at, out));
            }
            Pending::Delay(id, _) => out.disarm(id),
            Pending::Nothing | Pending::Get { .. } | Pending::Reply(_) => {}
        }
        Signal::Cancelled
    }

    /// A message for the task (§5.2.1): handed over at once if the task has asked for it, else stored (R24).
    fn message(
        &mut self,
        table: &NodeTable,
        port: &Port,
        inbox: u16,
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
        if remaining <= reserved {
            return self.expire_on_arrival(packet, out);
        }
        let message = held(packet, packet.class, self.now + remaining - reserved);
        // What a link charges is only a bound: this copy may have been charged more than a later one will be. So copies
        // are remembered as long as the declared life lets any of them arrive, not as long as this one seems to live.
        let life = port.party(packet.source).map_or(remaining, |party| party.time_out.max(remaining));
        let until = self.now + life + way_back;
        let fresh = match packet.class {
            Class::Status => self.admit_status(packet, until, out),
            Class::Command => self.admit_command(table, packet, out),
        };
        if !fresh {
            return;
        }
        if packet.class == Class::Command && table.rules().memory != Memory::None {
            let sender_until = self.now + remaining;
            self.remember(
                packet,
                Remembered { port: packet.port, id: packet.id, fate: Fate::Held, sender_until, until },
            );
        }
        if self.wants(packet) {
            self.pending = Pending::Nothing;
            self.count(packet.port, |c| c.enqueued += 1);
            return self.deliver(packet.port, &message, out);
        }
        self.store_message(port, inbox, message, out);
    }

    fn wants(&self, packet: &Packet) -> bool {
        matches!(self.pending, Pending::Get { port, source, .. }
            if port.is_none_or(|p| p == packet.port) && source.is_none_or(|s| s == packet.source))
    }

    fn store_message(&mut self, port: &Port, inbox: u16, message: Held, out: &mut impl Outbox) {
        let arrival = self.arrivals;
        self.arrivals += 1;
        let inbox = &mut self.inboxes[usize::from(inbox)];
        let id = inbox.port;
        let left = message.expires - self.now;
        let lost = match inbox.admit(message, arrival) {
            Admission::Kept => None,
            Admission::Replaced(evicted) => Some(evicted),
            Admission::Turned => Some(message),
        };
        if lost != Some(message) {
            self.count(id, |c| c.enqueued += 1);
            note(out, Event::Enqueued, id, message.source, message.id, left);
        }
        let Some(lost) = lost else { return };
        let (newcomer, reason) =
            if lost == message { (true, Reason::Refused) } else { (false, Reason::Evicted) };
        self.count(id, |c| if newcomer { c.refused += 1 } else { c.evicted += 1 });
        note(out, Event::Discarded(reason), id, lost.source, lost.id, lost.expires - self.now);
        if lost.class == Class::Command {
            self.refuse(port, lost.source, lost.id, out);
        }
    }

    /// D21: the source of a refused command hears of it at once, and again for every copy (D52).
    fn refuse(&mut self, port: &Port, source: TaskId, message: MessageId, out: &mut impl Outbox) {
        let life = port.party(source).map_or(Ticks::ZERO, |party| party.time_out);
        if let Ok(at) = self.sources.binary_search_by_key(&source, |s| s.task)
            && let Some(remembered) = &mut self.sources[at].command
            && remembered.id == message
        {
            remembered.fate = Fate::Refused;
        }
        self.control(ReplyTo { port: port.id, source, id: message }, Control::Refused, life, out);
    }

    fn control(&self, to: ReplyTo, control: Control, life: Ticks, out: &mut impl Outbox) {
        out.transmit(mapping::answer(to, self.task, Kind::Control, life, control.to_contents()));
    }

    fn deliver(&mut self, port: PortId, message: &Held, out: &mut impl Outbox) {
        if let Ok(at) = self.sources.binary_search_by_key(&message.source, |s| s.task)
            && let Some(remembered) = &mut self.sources[at].command
            && remembered.id == message.id
            && message.class == Class::Command
        {
            remembered.fate = Fate::Delivered(message.expires);
        }
        let budget = message.expires - self.now;
        self.count(port, |c| c.delivered += 1);
        note(out, Event::Delivered, port, message.source, message.id, budget);
        out.signal(Signal::Message(Delivery {
            from: ReplyTo { port, source: message.source, id: message.id },
            class: message.class,
            budget,
            contents: message.contents,
            fragments: 1,
        }));
    }

    fn admit_status(&mut self, packet: &Packet, until: Ticks, out: &mut impl Outbox) -> bool {
        let Ok(at) = self.sources.binary_search_by_key(&packet.source, |s| s.task) else { return false };
        if !self.enter_life(at, packet.id.incarnation, out) {
            self.drop_packet(packet, Reason::StaleIncarnation, out);
            return false;
        }
        if !self.sources[at].status.admit(packet.id.sequence, self.now, until) {
            self.duplicate(packet, out);
            return false;
        }
        true
    }

    fn admit_command(&mut self, table: &NodeTable, packet: &Packet, out: &mut impl Outbox) -> bool {
        let to = ReplyTo { port: packet.port, source: packet.source, id: packet.id };
        if self.scene(table).quarantined {
            // D49: it may be a copy of one that the earlier life ran.
            self.control(to, Control::Restarted, packet.remaining, out);
            return false;
        }
        let Ok(at) = self.sources.binary_search_by_key(&packet.source, |s| s.task) else { return false };
        if !self.enter_life(at, packet.id.incarnation, out) {
            self.drop_packet(packet, Reason::StaleIncarnation, out);
            return false;
        }
        match self.sources[at].look_up(packet.id, self.now) {
            Seen::New => {
                self.withdraw_superseded(at, out);
                true
            }
            Seen::Again(fate) => {
                self.duplicate(packet, out);
                let left = packet.remaining;
                match fate {
                    Fate::Held | Fate::Delivered(_) => {}
                    Fate::Refused => self.control(to, Control::Refused, left, out),
                    Fate::Answered(contents) => {
                        out.transmit(mapping::answer(to, self.task, Kind::Reply, left, contents));
                    }
                }
                false
            }
            Seen::Older => {
                self.duplicate(packet, out);
                false
            }
        }
    }

    /// Whether a message comes from the present life of its source. The command that an earlier life left waiting goes
    /// with the memory of it: nobody waits for its answer.
    fn enter_life(&mut self, source: usize, life: Incarnation, out: &mut impl Outbox) -> bool {
        if self.sources[source].life.is_some_and(|known| known != life && !is_older(life, known)) {
            self.withdraw_superseded(source, out);
        }
        self.sources[source].enter_life(life)
    }

    /// The source has one outstanding communication: a newer command means that it gave the held one up.
    fn withdraw_superseded(&mut self, source: usize, out: &mut impl Outbox) {
        let task = self.sources[source].task;
        let now = self.now;
        let held = self.sources[source].command.filter(|c| c.fate == Fate::Held && c.until > now);
        let Some(old) = held else { return };
        let inbox = self.inboxes.iter_mut().find(|inbox| inbox.port == old.port);
        if let Some(withdrawn) = inbox.and_then(|inbox| inbox.withdraw(task, old.id)) {
            self.count(old.port, |c| c.expired += 1);
            note(out, Event::Discarded(Reason::Expired), old.port, task, withdrawn.id, Ticks::ZERO);
        }
    }

    fn remember(&mut self, packet: &Packet, remembered: Remembered) {
        if let Ok(at) = self.sources.binary_search_by_key(&packet.source, |s| s.task) {
            self.sources[at].command = Some(remembered);
        }
    }

    /// An answer to the task's own class-2 message.
    fn answer(&mut self, table: &NodeTable, packet: &Packet, out: &mut impl Outbox) {
        let fits = |c: &Command| c.id == packet.id && c.port == packet.port && c.to == packet.source;
        let command = match self.pending {
            Pending::Reply(command) if fits(&command) => command,
            _ => {
                let late = self.overdue.filter(|c| fits(c) && packet.kind == Kind::Reply);
                if late.is_some() && !table.rules().refuse_late_replies {
                    self.overdue = None;
                    out.signal(Signal::Outcome(Outcome::Reply(packet.contents)));
                    return;
                }
                let stale = is_older(packet.id.incarnation, self.incarnation);
                let reason = if stale { Reason::StaleIncarnation } else { Reason::Unexpected };
                return self.drop_packet(packet, reason, out);
            }
        };
        let (outcome, event) = match (packet.kind, packet.control()) {
            (Kind::Reply, _) => (Outcome::Reply(packet.contents), Event::Answered),
            (_, Some(Control::Refused)) => (Outcome::Refused, Event::RefusedByPeer),
            (_, Some(Control::RefusedOnTheWay)) if command.copies_out == 0 => {
                (Outcome::Refused, Event::RefusedByPeer)
            }
            (_, Some(Control::Restarted)) => (Outcome::PeerRestarted, Event::PeerRestarted),
            // A copy was refused on the way, but another one may have arrived: only the time_out tells.
            (_, Some(Control::RefusedOnTheWay)) => return,
            (_, Some(Control::Probe) | None) => return self.drop_packet(packet, Reason::Unexpected, out),
        };
        self.pending = Pending::Nothing;
        if event == Event::Answered {
            self.count(command.port, |c| c.delivered += 1);
        } else {
            self.count(command.port, |c| c.refused += u64::from(event == Event::RefusedByPeer));
        }
        note(out, event, command.port, command.to, command.id, command.deadline - self.now);
        out.signal(Signal::Outcome(outcome));
    }

    fn expire_on_arrival(&mut self, packet: &Packet, out: &mut impl Outbox) {
        self.count(packet.port, |c| c.expired += 1);
        note(
            out,
            Event::Discarded(Reason::ExpiredOnTheWay),
            packet.port,
            packet.source,
            packet.id,
            Ticks::ZERO,
        );
    }

    fn duplicate(&mut self, packet: &Packet, out: &mut impl Outbox) {
        self.count(packet.port, |c| c.duplicates += 1);
        note(
            out,
            Event::Discarded(Reason::Duplicate),
            packet.port,
            packet.source,
            packet.id,
            packet.remaining,
        );
    }

    fn drop_packet(&mut self, packet: &Packet, reason: Reason, out: &mut impl Outbox) {
        self.count(packet.port, |c| c.dropped += 1);
        note(out, Event::Discarded(reason), packet.port, packet.source, packet.id, packet.remaining);
    }
}
