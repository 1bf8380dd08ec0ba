//! The client: messages that the task sends, and the answers to its outstanding requests (§4.1; D5, D6, D12).
//!
//! | input | effect |
//! |---|---|
//! | [`send`](Client::send) | sends a class-1 message, or opens a request at which the task waits for answers |
//! | [`answer`](Client::answer), [`third_party`](Client::third_party) | takes a packet of an answer; the last one ends the wait |
//! | [`advance`](Client::advance) | ends the wait at the deadline, or retransmits the request under the same id |
//! | [`unsent`](Client::unsent), [`restarted`](Client::restarted) | a copy never left the node; an asked node restarted |
//! | [`close`](Client::close) | the task cancels the request |
//!
//! An [`Outstanding`] is the state of one request whose answers are awaited. The end of a wait is returned and not
//! signalled here: only the caller knows whether the waiting activation is the running one. Between two inputs a request is
//! open exactly if an activation waits at that request. Then an answer is missing, the deadline has not passed, and no copy
//! is overdue.

mod answers;
mod check;
mod outstanding;
#[cfg(feature = "checker")]
mod walk;

use super::own::{Own, Role, are_alike};
use super::step::{Outbox, Step};
use super::wait::Ended;
use crate::ids::{MessageId, PortId, TaskId};
use crate::mapping;
use crate::observe::Event;
use crate::packet::{Contents, Packet};
use crate::request::{Answers, Fault, Outcome, Target};
use crate::table::{NodeTable, Party, Port};
use crate::ticks::{Instant, Ticks};
use alloc::boxed::Box;
use outstanding::{Answer, Outstanding, Phase};
use serde::{Deserialize, Serialize};

/// The task's outstanding requests, one for each port on which it asks, with the answers to the last request on the port.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Client {
    requests: Box<[Outstanding]>,
    overdue: Option<Overdue>,
}

/// The command that timed out last. The field exists for the rule variant that accepts late replies, under which the command's
/// answer may still come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
struct Overdue {
    port: PortId,
    to: TaskId,
    id: MessageId,
}

/// The result of sending a message.
pub(crate) enum Sent {
    /// This many copies of a class-1 message were sent.
    Copies(u16),
    /// The task waits for the answers to the request at this position.
    Request(u16),
}

/// A message: its port, its TTL and its contents.
type Message<'a> = (&'a Port, Ticks, Contents);

impl Client {
    /// A client without requests. The client has room for one request on each port on which the task asks.
    pub fn new(table: &NodeTable, own: &Own) -> Self {
        let ports = own.ports(table, |role| matches!(role, Role::Asks(_)));
        let requests = ports.map(|(endpoint, port)| Outstanding::new(port, own.task, endpoint)).collect();
        Self { requests, overdue: None }
    }

    /// SEND, or a query if that is the port's usage: sends a copy to each receiver (R26, R40).
    pub fn send(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        (party, to): (&Party, Target),
        message: Message<'_>,
    ) -> Result<Sent, Fault> {
        let place = usize::from(party.place);
        let (port, own) = (message.0, step.own.task);
        let only = mapping::only_peer(party, to).map(|peer| (peer.recipient.into(), peer.task));
        match step.own.endpoints[place].role {
            Role::Sends => {
                let mut copies = 0;
                if let Some((_, peer)) = only {
                    step.own.staged(place)?;
                    send_packets(step, place, peer, message);
                    copies = 1;
                } else {
                    let peers = mapping::destinations(port, own, to)?;
                    step.own.staged(place)?;
                    for (_, peer) in peers {
                        send_packets(step, place, peer, message);
                        copies += 1;
                    }
                }
                step.own.endpoints[place].staged.clear();
                Ok(Sent::Copies(copies))
            }
            Role::Asks(at) => {
                let asked = match only {
                    Some(_) => 1,
                    None => mapping::destinations(port, own, to)?.count(),
                };
                let request = &mut self.requests[usize::from(at)];
                if request.phase != Phase::Closed {
                    return Err(Fault::Busy);
                }
                step.own.staged(place)?;
                request.forget();
                match only {
                    Some(peer) => ask(step, (&mut *request, place), peer, message),
                    None => {
                        for peer in mapping::destinations(port, own, to)? {
                            ask(step, (&mut *request, place), peer, message);
                        }
                    }
                }
                request.open_for(asked > 1, party.retry, message, step.now());
                request.parts.copy(&step.own.endpoints[place].staged);
                step.own.endpoints[place].staged.clear();
                Ok(Sent::Request(at))
            }
            Role::Receives(_) | Role::Meets(_) | Role::Replies | Role::Hears | Role::Heartbeats => {
                Err(Fault::WrongUsage)
            }
        }
    }

    /// Whether the request at this position is closed: the request has ended, and the task knows how.
    #[inline]
    pub fn is_closed(&self, request: u16) -> bool {
        self.requests[usize::from(request)].phase == Phase::Closed
    }

    /// [`send`](Self::send) in a fused step (one step for sender and receiver): the only recipient has already taken the message.
    #[inline(always)]
    pub fn open_fused(
        &mut self,
        request: u16,
        (recipient, id): (u16, MessageId),
        retry: u8,
        message: Message<'_>,
        now: Instant,
    ) {
        let request = &mut self.requests[usize::from(request)];
        request.forget();
        request.sent(recipient.into(), id, 1);
        request.open_for(false, retry, message, now);
    }

    /// Whether the request still waits for the answer of this recipient alone, to the message with this id.
    #[inline(always)]
    pub fn waits_only_for(&self, request: u16, recipient: u16, id: MessageId) -> bool {
        let request = &self.requests[usize::from(request)];
        let asked = &request.recipients[usize::from(recipient)];
        !request.set && request.phase == Phase::Open && asked.waits_for(id)
    }

    /// [`answer`](Self::answer) in a fused step, for an answer for which [`waits_only_for`](Self::waits_only_for) is true.
    /// Returns the deadline that the request had.
    #[inline(always)]
    pub fn close_fused(&mut self, request: u16, recipient: u16) -> Instant {
        let request = &mut self.requests[usize::from(request)];
        let deadline = request.deadline;
        request.close_only(recipient.into());
        deadline
    }

    /// The next instant at which time alone makes a request act.
    pub fn due(&self, request: u16) -> Instant {
        self.requests[usize::from(request)].due()
    }

    /// Cancels the request at a position.
    pub fn close(&mut self, request: u16) {
        self.requests[usize::from(request)].close();
    }

    /// Cancels all requests.
    pub fn close_all(&mut self) {
        self.requests.iter_mut().for_each(Outstanding::close);
    }

    /// Reports the outcome of a request to several tasks. The answers stay readable until the next request on the port.
    pub fn tell(&mut self, request: u16) -> (PortId, Answers) {
        let request = &mut self.requests[usize::from(request)];
        request.tell();
        (request.port, request.answers())
    }

    /// Reports an answer of several fragments: returns the first fragment. The other fragments stay readable until the next
    /// request on the port.
    pub fn tell_long(&mut self, request: u16) -> Contents {
        let request = &mut self.requests[usize::from(request)];
        request.tell();
        request.long_answer().unwrap_or_default()
    }

    /// Fragment `index` of a task's answer. The answer is to the last request on the port of `request`.
    pub fn answer_fragment(&self, request: u16, task: TaskId, index: u8) -> Option<&Contents> {
        let recipient =
            self.requests[usize::from(request)].recipients.iter().find(|recipient| recipient.task == task)?;
        (recipient.answer == Answer::Answered).then(|| recipient.contents.get(index)).flatten()
    }

    /// The outstanding requests whose answers are missing: the port, the task that was asked, and the message id.
    pub fn outstanding(&self) -> impl Iterator<Item = (PortId, TaskId, MessageId)> {
        self.requests
            .iter()
            .flat_map(|request| request.open().map(|recipient| (request.port, recipient.task, recipient.id)))
    }

    /// Where and until when a request waits: its port, the first task whose answer is missing, and the deadline.
    pub fn wait_at(&self, request: u16) -> (PortId, Option<TaskId>, Instant) {
        let request = &self.requests[usize::from(request)];
        (request.port, request.open().next().map(|recipient| recipient.task), request.deadline)
    }

    /// Does what is [`due`](Self::due) for the request at this position: times the request out, or retransmits it.
    pub fn advance(&mut self, step: &mut Step<'_, impl Outbox>, request: u16) -> Option<Ended> {
        let at = usize::from(request);
        let request = &self.requests[at];
        if request.deadline > step.now() {
            self.send_again(step, at);
            return None;
        }
        let port = request.port;
        step.count(request.endpoint, |c| c.timed_out += 1);
        let mut outcome = Outcome::TimedOutUnknown;
        for recipient in self.requests[at].open() {
            let unsent = recipient.packets_out == 0;
            let event = if unsent { Event::TimedOutUnsent } else { Event::TimedOut };
            if unsent {
                outcome = Outcome::TimedOutUnsent;
            }
            step.note(event, port, recipient.task, recipient.id, Ticks::ZERO);
            if !step.table.rules().refuse_late_replies {
                self.overdue = Some(Overdue { port, to: recipient.task, id: recipient.id });
            }
        }
        Some(self.end(at, outcome))
    }

    /// Retransmits the request to the tasks that have not answered: the same message_ID, within the same time_out (D5).
    fn send_again(&mut self, step: &mut Step<'_, impl Outbox>, at: usize) {
        let request = &mut self.requests[at];
        let Some(port) = step.table.port(request.port) else { return };
        request.copies_left = request.copies_left.saturating_sub(1);
        request.copy_at =
            if request.copies_left > 0 { step.now() + port.decl.resend } else { Instant::NEVER };
        let left = request.deadline - step.now();
        let fragments = request.parts.fragments().unwrap_or(1);
        let stamp = step.stamp(left);
        let Outstanding { recipients, contents, parts, endpoint, .. } = request;
        for recipient in recipients.iter_mut().filter(|recipient| recipient.answer == Answer::Open) {
            recipient.packets_out = recipient.packets_out.saturating_add(u16::from(fragments));
            let (to, id) = (recipient.task, recipient.id);
            step.count(*endpoint, |c| c.resent += 1);
            step.note(Event::Resent, port.id, to, id, left);
            let first = mapping::message(port, step.own.task, to, id, stamp, *contents);
            mapping::in_fragments(Packet { resent: true, ..first }, &*parts, |p| step.out.transmit(p));
        }
    }

    /// Validates a deserialised client: its requests must match those of a new client.
    pub fn is_like(&self, new: &Self) -> bool {
        are_alike(&self.requests, &new.requests, Outstanding::is_like)
    }

    /// Whether a request exists at this position.
    pub fn has(&self, request: u16) -> bool {
        usize::from(request) < self.requests.len()
    }
}

/// Sends a class-2 message to one of its recipients, and notes the message's id.
fn ask(
    step: &mut Step<'_, impl Outbox>,
    (request, place): (&mut Outstanding, usize),
    (recipient, peer): (usize, TaskId),
    message: Message<'_>,
) {
    let packets = step.own.endpoints[place].staged.fragments().unwrap_or(1);
    let id = send_packets(step, place, peer, message);
    request.sent(recipient, id, packets);
}

/// Sends a message to one task, with the fragments that the own task has handed over for it.
fn send_packets(
    step: &mut Step<'_, impl Outbox>,
    place: usize,
    to: TaskId,
    (port, ttl, contents): Message<'_>,
) -> MessageId {
    let id = step.next_id();
    let packet = mapping::message(port, step.own.task, to, id, step.stamp(ttl), contents);
    step.own.endpoints[place].counters.sent += 1;
    step.note(Event::Sent, port.id, to, id, ttl);
    mapping::in_fragments(packet, &step.own.endpoints[place].staged, |packet| step.out.transmit(packet));
    id
}

#[cfg(test)]
mod tests;
