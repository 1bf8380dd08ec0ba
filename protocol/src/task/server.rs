//! The server: messages to the task, from their first packet until they are answered (§5.1.1, §5.2.1).
//!
//! | input | effect |
//! |---|---|
//! | [`hear`](Server::hear) | a packet of a message is stored, dropped, or returned for the running activation to take |
//! | [`next`](Server::next) | a GET takes the most urgent message, if there is one |
//! | [`deliver`](Server::deliver) | the task gets the message, and its execution budget begins |
//! | [`reply`](Server::reply) | the task answers the message; copies get the same answer |
//! | [`first_offer`](Server::first_offer) | returns the message that may interrupt the running activation first |
//! | [`reject_the_others`](Server::reject_the_others) | other due messages are rejected: offered again later, one rank higher |
//! | [`advance`](Server::advance) | drops expired messages and fragments |
//! | [`reroute`](Server::reroute) | adapts the deadlines of waiting commands to the routes of another table |
//!
//! A packet of a message passes these checks in turn. The packet has no more fragments than the port allows, and time is
//! left to answer it. No copy of a command to an earlier incarnation of the task can still arrive (D49). The packet is from
//! the present incarnation of its source, and its message is new (`memory`). All fragments of the message are here
//! (`assembly`), and no newer epoch has begun (`epochs`).
//!
//! Between two inputs no expired message waits, the ready set (`ready`) agrees with a scan of all inboxes, and the dedup
//! entry of every waiting command has the status `Held`. Rule variants that keep no memory or extend TTLs break only the
//! last of these.

mod admission;
mod assembly;
mod check;
mod delivery;
mod epochs;
mod inbox;
mod memory;
mod offers;
mod ready;
mod reroute;
mod view;
#[cfg(feature = "checker")]
mod walk;

use super::fragments::Parts;
use super::interrupts::Interrupts;
use super::own::{Own, Role, are_alike};
use super::step::{Outbox, Step};
use crate::ids::{Incarnation, PortId, TaskId};
use crate::mapping;
use crate::observe::{Event, Reason};
use crate::packet::{Class, Contents, Control, Packet};
use crate::queue::Slot;
use crate::rules::{Memory, TimeStamp};
use crate::table::{Ends, NodeTable};
use crate::ticks::{Instant, Ticks};
use alloc::boxed::Box;
use alloc::vec::Vec;
use epochs::Guard;
use inbox::{Inbox, RetryState};
use memory::{CommandStatus, DedupEntry, Seen};
use ready::ReadySet;
use serde::{Deserialize, Serialize};

pub(crate) use delivery::send_answer;
pub(crate) use inbox::Held;

/// The waiting messages of a task, and the dedup entries of the messages that it received.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Server {
    inboxes: Box<[Inbox]>,
    ready: ReadySet,
    /// The number of GETs over all ports that were served (D58).
    served: u64,
    /// Numbers messages in the order in which they are stored: the last key of the order of service (D14).
    arrivals: u64,
    /// The number of the next group of rejections: messages that are rejected together have the same number (D58).
    rejections: u64,
    /// The last known incarnation of each task that may send to this one, ascending by task.
    incarnations: Box<[Known]>,
    /// The newest lease epoch of each couple (primary and standby) that commands this task (D61).
    guards: Box<[Guard]>,
    /// The message that the task took last (D28).
    taken: (Option<Contents>, Parts),
    /// Scratch buffer for messages that are rejected together. It is empty between two inputs.
    #[serde(skip)]
    turned: Vec<Slot>,
}

/// A source, with the incarnation of its node from which this task heard last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
struct Known {
    task: TaskId,
    incarnation: Option<Incarnation>,
}

/// A message that the running activation takes as it arrives.
pub(crate) struct Arrival {
    pub origin: Origin,
    pub held: Held,
    /// Whether a handler for the message interrupts the running activation; otherwise the running activation waits for the
    /// message in a GET.
    pub interrupts: bool,
}

/// An inbox, and the position of a source in it.
pub(crate) type Origin = (usize, usize);

/// Limit of counters in a deserialised state. Counters grow by one per input, so no recording makes a counter below this
/// limit overflow.
const MOST: u64 = 1 << 62;

impl Server {
    /// A server with an inbox for each port on which the task receives.
    pub fn new(table: &NodeTable, own: &Own) -> Self {
        let (mut inboxes, mut sources, mut guards, mut longest) = (Vec::new(), Vec::new(), Vec::new(), 1);
        for (endpoint, port) in own.ports(table, |role| matches!(role, Role::Receives(_))) {
            longest = longest.max(port.decl.fragments);
            inboxes.push(Inbox::new(port, own.task, endpoint));
            sources.extend(port.peers(own.task));
            guards.extend(port.decl.guard.map(Guard::new));
        }
        sources.sort_unstable();
        sources.dedup();
        guards.sort_unstable_by_key(|guard: &Guard| guard.couple);
        guards.dedup();
        let most = inboxes.iter().map(|inbox: &Inbox| inbox.queue.capacity()).max();
        Self {
            ready: ReadySet::new(&inboxes),
            inboxes: inboxes.into(),
            served: 0,
            arrivals: 0,
            rejections: 1,
            incarnations: sources.into_iter().map(|task| Known { task, incarnation: None }).collect(),
            guards: guards.into(),
            taken: (None, Parts::new(longest)),
            turned: Vec::with_capacity(most.unwrap_or_default()),
        }
    }

    /// The port of an inbox.
    pub fn port(&self, inbox: usize) -> PortId {
        self.inboxes[inbox].port
    }

    /// Takes a packet of a message. `threads` are the activations; `called` says whether the lease has a pending call.
    pub fn hear(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        threads: (&Interrupts, bool),
        (ends, inbox): (Ends<'_>, u16),
        packet: &Packet,
    ) -> Option<Arrival> {
        let origin = (usize::from(inbox), usize::from(ends.peer.slot));
        let before = self.inboxes[origin.0].front();
        let arrival = self.message(step, threads, (ends, origin), packet);
        let inbox = &self.inboxes[origin.0];
        // If a port has no handler and its messages take one packet, the ready set depends only on the port's most urgent
        // message.
        if inbox.handled || inbox.is_long() || inbox.front() != before {
            self.touch(step.own, origin.0);
        }
        arrival
    }

    /// Checks a packet, and takes the message in once it is complete.
    fn message(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        threads: (&Interrupts, bool),
        (ends, origin): (Ends<'_>, Origin),
        packet: &Packet,
    ) -> Option<Arrival> {
        let remaining = match step.table.rules().time_stamp {
            TimeStamp::Remaining => packet.remaining,
            TimeStamp::Absolute => (Instant::START + packet.remaining) - step.now(),
        };
        let way_back = ends.peer.bound;
        let reserved = match packet.class {
            Class::Command if step.table.rules().reserve_way_back => way_back,
            Class::Command | Class::Status => Ticks::ZERO,
        };
        let endpoint = ends.own.place;
        if packet.fragment.saturating_add(u8::from(packet.more)) >= ends.port.decl.fragments {
            step.drop_packet(endpoint, packet, Reason::NotAllowed);
            return None;
        }
        if remaining <= reserved {
            step.count(endpoint, |c| c.expired += 1);
            let reason = Event::Discarded(Reason::ExpiredOnTheWay);
            step.note(reason, packet.port, packet.source, packet.id, Ticks::ZERO);
            return None;
        }
        let counted;
        let packet = if remaining == packet.remaining {
            packet
        } else {
            counted = Packet { remaining, ..*packet };
            &counted
        };
        if !self.is_fresh(step, (ends, origin), (packet, reserved)) {
            return None;
        }
        let bounds = (reserved, way_back);
        if packet.more || packet.fragment > 0 {
            let (whole, fragments) = self.assemble(step, origin, packet, reserved)?;
            self.take_in(step, threads, (ends, origin), (&whole, fragments), bounds)
        } else {
            self.overtake(step, origin, packet);
            self.take_in(step, threads, (ends, origin), (packet, 1), bounds)
        }
    }

    /// Whether the message is new, and from the present incarnation of its source. If it is a copy, this function answers
    /// it.
    fn is_fresh(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        (ends, (inbox, source)): (Ends<'_>, Origin),
        (packet, reserved): (&Packet, Ticks),
    ) -> bool {
        let endpoint = ends.own.place;
        if packet.class == Class::Command && step.own.turns_away(step.table, ends.peer) {
            // The message may be a copy of a command that the task's earlier incarnation ran (D49).
            control(step, packet, Control::Restarted);
            return false;
        }
        if !self.enter_incarnation(step, packet.source, packet.id.incarnation) {
            step.drop_packet(endpoint, packet, Reason::StaleIncarnation);
            return false;
        }
        match self.inboxes[inbox].sources[source].look_up(packet.id, step.now()) {
            Seen::New => return true,
            Seen::Again(CommandStatus::Held) => self.prolong((inbox, source), packet, reserved, step.now()),
            Seen::Older | Seen::Again(CommandStatus::Lapsed | CommandStatus::Delivered(_)) => {}
            // Of the fragments of a copy, only the last one is answered.
            Seen::Again(_) if packet.more => {}
            Seen::Again(CommandStatus::Refused) => control(step, packet, Control::Refused),
            Seen::Again(CommandStatus::Answered(contents)) => {
                let kind = mapping::answer_kind(ends.port);
                let to = mapping::reply_to(packet);
                let answer = mapping::answer(to, step.own.task, kind, packet.remaining, contents);
                let more = self.inboxes[inbox].answer(source);
                mapping::in_fragments(answer, more, |packet| step.out.transmit(packet));
            }
        }
        step.duplicate(endpoint, packet);
        false
    }

    /// Takes in a complete, new message. If the task waits for the message, the message is delivered at once; if it has a
    /// handler, it is offered; otherwise it is stored (R24, R25).
    fn take_in(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        (threads, called): (&Interrupts, bool),
        (ends, origin): (Ends<'_>, Origin),
        (packet, fragments): (&Packet, u8),
        (reserved, way_back): (Ticks, Ticks),
    ) -> Option<Arrival> {
        let ((inbox, source), from) = (origin, ends.other());
        let contents = match ends.port.decl.guard {
            None => packet.contents,
            Some(couple) => self.within_epoch(step, (ends, origin), couple, packet)?,
        };
        let now = step.now();
        // A link charges an upper bound, so a later copy may have been charged less than this copy. Therefore the dedup
        // entry is kept for the declared TTL, not for the remaining time of this copy (D20).
        let until = now + from.time_out.max(packet.remaining) + way_back;
        match packet.class {
            Class::Status => {
                self.inboxes[inbox].sources[source].admit(packet.id.sequence, now, until);
            }
            Class::Command => {
                self.withdraw_superseded(step, origin);
                if step.table.rules().memory != Memory::None {
                    let sender_until = now + packet.remaining;
                    let new = DedupEntry { id: packet.id, status: CommandStatus::Held, sender_until, until };
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
        let mut retry = RetryState::default();
        if self.inboxes[inbox].latest && !self.supersedes(step, inbox, &held) {
            self.inboxes[inbox].close(source, held.id());
            discard(step, &self.inboxes[inbox], &held, Reason::Superseded);
            return None;
        }
        let handled = self.inboxes[inbox].handled;
        let awaited = threads.gets(packet.port, packet.source, handled);
        let offered = !awaited && handled && threads.is_interruptible(false, called);
        if awaited || (offered && offers::outranks(step.table, step.own, threads, packet.port, &held, retry))
        {
            step.count(ends.own.place, |c| c.enqueued += 1);
            self.take_assembled(origin, &held);
            return Some(Arrival { origin, held, interrupts: !awaited });
        }
        if offered {
            self.reject_arrived(step, inbox, (&mut held, &mut retry));
        }
        self.store(step, (ends.port, origin), (held, retry));
        self.inboxes[inbox].close(source, held.id());
        None
    }

    /// Drops expired messages and fragments: the simple removal at the receiver's node (§5.1.1).
    pub fn advance(&mut self, step: &mut Step<'_, impl Outbox>) {
        while let Some(inbox) = self.expired(step.now()) {
            while let Some(held) =
                self.inboxes[inbox].queue.pop_if(|held: &Held| held.expires <= step.own.now)
            {
                let entry = &mut self.inboxes[inbox];
                if let Some(source) = entry.source(held.source) {
                    entry.settle(source, held.id(), CommandStatus::Lapsed);
                }
                let port = entry.port;
                step.count(entry.endpoint, |c| c.expired += 1);
                let event = Event::Discarded(Reason::Expired);
                step.note(event, port, held.source, held.id(), Ticks::ZERO);
            }
            if self.inboxes[inbox].is_long() {
                self.discard_incomplete(step, inbox);
            }
            self.touch(step.own, inbox);
        }
    }

    /// Extends the deadlines of waiting messages by the time that passed. This serves the rule variant in which waiting does not
    /// reduce the remaining time.
    pub fn give_back(&mut self, own: &Own, elapsed: Ticks) {
        for inbox in &mut self.inboxes {
            inbox.queue.change_all(|held, _| held.expires += elapsed);
        }
        self.touch_all(own);
    }

    /// Notes whether the task has a handler for messages of this port.
    pub fn set_handled(&mut self, own: &Own, inbox: u16, handled: bool) {
        let inbox = usize::from(inbox);
        let entry = &mut self.inboxes[inbox];
        entry.handled = handled;
        entry.begin(self.served);
        if handled {
            entry.queue.watch();
            self.ready.watch(&self.inboxes);
        }
        self.touch(own, inbox);
    }

    /// Validates a deserialised server: its inboxes, sources and capacities must be those of a new server.
    pub fn is_like(&self, new: &Self) -> bool {
        let counts = [self.arrivals, self.rejections, self.served].into_iter().all(|count| count < MOST);
        are_alike(&self.inboxes, &new.inboxes, Inbox::is_like)
            && are_alike(&self.incarnations, &new.incarnations, |read, new| read.task == new.task)
            && are_alike(&self.guards, &new.guards, |read, new| read.couple == new.couple)
            && counts
            && self.ready.is_whole(self.inboxes.len())
            && self.taken.1.has_room_of(&new.taken.1)
    }
}

fn control(step: &mut Step<'_, impl Outbox>, request: &Packet, control: Control) {
    if !request.more {
        let to = mapping::reply_to(request);
        step.out.transmit(mapping::control(to, step.own.task, control, request.remaining));
    }
}

fn discard(step: &mut Step<'_, impl Outbox>, inbox: &Inbox, held: &Held, reason: Reason) {
    step.count(inbox.endpoint, |c| c.dropped += 1);
    let left = held.expires - step.now();
    step.note(Event::Discarded(reason), inbox.port, held.source, held.id(), left);
}

/// A bit mask of the fragments of a message after the first one.
fn rest_of(fragments: u8) -> u16 {
    1_u16.checked_shl(u32::from(fragments.saturating_sub(1))).map_or(u16::MAX, |bit| bit.wrapping_sub(1))
}

#[cfg(test)]
mod tests;
