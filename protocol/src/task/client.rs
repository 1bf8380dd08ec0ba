//! The client: what the task sends, and the answers that it waits for (§4.1; D5, D6, D12).
//!
//! | input | what comes of it |
//! |---|---|
//! | [`send`](Client::send) | a class-1 message has gone, or the task waits for the answers at a desk |
//! | [`answer`](Client::answer), [`third_party`](Client::third_party) | a packet of an answer; the last one that was missing ends the wait |
//! | [`advance`](Client::advance) | the deadline ends the wait, or the request is sent again under the same id |
//! | [`unsent`](Client::unsent), [`restarted`](Client::restarted) | a copy never left the node; a node that was asked has a new life |
//! | [`close`](Client::close) | the task gives the request up |
//!
//! A wait that ends is returned, never told: whoever calls knows whether the thread that waits is the one that runs.
//! Between two inputs a desk is open exactly where a thread waits at it, and then the answer of somebody is missing, its
//! deadline is not over and no copy is overdue.

mod answers;
mod check;
mod desk;
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
use desk::{Answer, Desk, Phase};
use serde::{Deserialize, Serialize};

/// The task's requests, and what was answered to the last one of each port.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Client {
    desks: Box<[Desk]>,
    overdue: Option<Overdue>,
}

/// Under the variant that takes late answers: the command that timed out last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
struct Overdue {
    port: PortId,
    to: TaskId,
    id: MessageId,
}

/// What became of a message that the task wanted to send.
pub(crate) enum Sent {
    /// So many copies of it have gone.
    Copies(u16),
    /// The task waits for the answers at this desk.
    Asked(u16),
}

/// The port, the life and the contents of a message.
type Message<'a> = (&'a Port, Ticks, Contents);

impl Client {
    /// With a desk for each port that the task asks on.
    pub fn new(table: &NodeTable, own: &Own) -> Self {
        let ports = own.ports(table, |role| matches!(role, Role::Asks(_)));
        let desks = ports.map(|(endpoint, port)| Desk::new(port, own.task, endpoint)).collect();
        Self { desks, overdue: None }
    }

    /// SEND, or a query where that is the port's usage (R26, R40): a copy to each task it is for.
    pub fn send(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        (party, to): (&Party, Target),
        message: Message<'_>,
    ) -> Result<Sent, Fault> {
        let place = usize::from(party.place);
        let (port, own) = (message.0, step.own.task);
        let only = mapping::only_peer(port, own, to);
        match step.own.endpoints[place].role {
            Role::Sends => {
                let mut copies = 0;
                if let Some(peer) = only {
                    step.own.staged(place)?;
                    send_packets(step, place, peer, message);
                    copies = 1;
                } else {
                    let peers = mapping::destinations(port, own, to)?;
                    step.own.staged(place)?;
                    for peer in peers {
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
                let desk = &mut self.desks[usize::from(at)];
                if desk.phase != Phase::Closed {
                    return Err(Fault::Busy);
                }
                step.own.staged(place)?;
                desk.forget();
                match only {
                    Some(peer) => ask(step, (&mut *desk, place), peer, message),
                    None => {
                        for peer in mapping::destinations(port, own, to)? {
                            ask(step, (&mut *desk, place), peer, message);
                        }
                    }
                }
                desk.open_for(asked > 1, party.retry, message, step.now());
                desk.parts.copy(&step.own.endpoints[place].staged);
                step.own.endpoints[place].staged.clear();
                Ok(Sent::Asked(at))
            }
            Role::Receives(_) | Role::Meets(_) | Role::Replies | Role::Hears | Role::Beats => {
                Err(Fault::WrongUsage)
            }
        }
    }

    /// When time alone makes a desk act.
    pub fn due(&self, desk: u16) -> Instant {
        self.desks[usize::from(desk)].due()
    }

    /// The task takes back what it asked at a desk.
    pub fn close(&mut self, desk: u16) {
        self.desks[usize::from(desk)].close();
    }

    /// The task takes back all that it asked.
    pub fn close_all(&mut self) {
        self.desks.iter_mut().for_each(Desk::close);
    }

    /// The task is told how its request to several ended: what was answered may be read until it asks again.
    pub fn tell(&mut self, desk: u16) -> (PortId, Answers) {
        let desk = &mut self.desks[usize::from(desk)];
        desk.tell();
        (desk.port, desk.answers())
    }

    /// Likewise of an answer in several packets: the first one.
    pub fn tell_long(&mut self, desk: u16) -> Contents {
        let desk = &mut self.desks[usize::from(desk)];
        desk.tell();
        desk.long_answer().unwrap_or_default()
    }

    /// Fragment `index` of what a task answered to the last request on a desk's port.
    pub fn answer_fragment(&self, desk: u16, task: TaskId, index: u8) -> Option<&Contents> {
        let asked = self.desks[usize::from(desk)].asked.iter().find(|asked| asked.task == task)?;
        (asked.answer == Answer::Answered).then(|| asked.contents.get(index)).flatten()
    }

    /// The requests whose answers the task waits for: port, who was asked, and the id.
    pub fn outstanding(&self) -> impl Iterator<Item = (PortId, TaskId, MessageId)> {
        self.desks.iter().flat_map(|desk| desk.open().map(|asked| (desk.port, asked.task, asked.id)))
    }

    /// The port of a desk, who has not answered there, and until when they may.
    pub fn wait_at(&self, desk: u16) -> (PortId, Option<TaskId>, Instant) {
        let desk = &self.desks[usize::from(desk)];
        (desk.port, desk.open().next().map(|asked| asked.task), desk.deadline)
    }

    /// Something is [`due`](Self::due) at a desk: what is over ends, else it is sent again.
    pub fn advance(&mut self, step: &mut Step<'_, impl Outbox>, desk: u16) -> Option<Ended> {
        let at = usize::from(desk);
        let desk = &self.desks[at];
        if desk.deadline > step.now() {
            self.send_again(step, at);
            return None;
        }
        let port = desk.port;
        step.count(port, |c| c.timed_out += 1);
        let mut outcome = Outcome::TimedOutUnknown;
        for asked in self.desks[at].open() {
            let unsent = asked.packets_out == 0;
            let event = if unsent { Event::TimedOutUnsent } else { Event::TimedOut };
            if unsent {
                outcome = Outcome::TimedOutUnsent;
            }
            step.note(event, port, asked.task, asked.id, Ticks::ZERO);
            if !step.table.rules().refuse_late_replies {
                self.overdue = Some(Overdue { port, to: asked.task, id: asked.id });
            }
        }
        Some(self.end(at, outcome))
    }

    /// D5: the same message_ID inside the one budget, to those that have not answered.
    fn send_again(&mut self, step: &mut Step<'_, impl Outbox>, at: usize) {
        let desk = &mut self.desks[at];
        let Some(port) = step.table.port(desk.port) else { return };
        desk.copies_left = desk.copies_left.saturating_sub(1);
        desk.copy_at = if desk.copies_left > 0 { step.now() + port.decl.resend } else { Instant::NEVER };
        let left = desk.deadline - step.now();
        let fragments = desk.parts.fragments().unwrap_or(1);
        let stamp = step.stamp(left);
        let Desk { asked, contents, parts, .. } = desk;
        for asked in asked.iter_mut().filter(|asked| asked.answer == Answer::Open) {
            asked.packets_out = asked.packets_out.saturating_add(u16::from(fragments));
            let (to, id) = (asked.task, asked.id);
            step.count(port.id, |c| c.resent += 1);
            step.note(Event::Resent, port.id, to, id, left);
            let first = mapping::message(port, step.own.task, to, id, stamp, *contents);
            mapping::in_fragments(Packet { resent: true, ..first }, &*parts, |p| step.out.transmit(p));
        }
    }

    /// Whether a state that was read has the desks of a new one.
    pub fn is_like(&self, new: &Self) -> bool {
        are_alike(&self.desks, &new.desks, Desk::is_like)
    }

    /// Whether there is such a desk.
    pub fn has(&self, desk: u16) -> bool {
        usize::from(desk) < self.desks.len()
    }
}

/// A class-2 message to one of the tasks that are asked.
fn ask(
    step: &mut Step<'_, impl Outbox>,
    (desk, place): (&mut Desk, usize),
    peer: TaskId,
    message: Message<'_>,
) {
    let packets = step.own.endpoints[place].staged.fragments().unwrap_or(1);
    let id = send_packets(step, place, peer, message);
    if let Some(asked) = desk.find(peer) {
        let asked = &mut desk.asked[asked];
        (asked.id, asked.answer, asked.packets_out) = (id, Answer::Open, u16::from(packets));
    }
}

/// Sends a message, with what was staged for it, to one task.
fn send_packets(
    step: &mut Step<'_, impl Outbox>,
    place: usize,
    to: TaskId,
    (port, life, contents): Message<'_>,
) -> MessageId {
    let id = step.next_id();
    let packet = mapping::message(port, step.own.task, to, id, step.stamp(life), contents);
    step.own.endpoints[place].counters.sent += 1;
    step.note(Event::Sent, port.id, to, id, life);
    mapping::in_fragments(packet, &step.own.endpoints[place].staged, |packet| step.out.transmit(packet));
    id
}

#[cfg(test)]
mod tests;
