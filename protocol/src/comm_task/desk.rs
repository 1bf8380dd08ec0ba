//! The class-2 messages of a task that wait for their answers: one desk for each port it asks on (§4.1, D5, D6, D12).

use super::fragments::{Assembly, Parts, Step};
use super::levels::Finished;
use super::{CommTask, Outbox, Pending, Role, note};
use crate::ids::{MessageId, NodeId, PortId, TaskId};
use crate::mapping;
use crate::observe::{Event, Reason};
use crate::packet::{Contents, Control, Kind, Packet};
use crate::request::{Answers, Outcome};
use crate::table::{NodeTable, Port};
use crate::ticks::Ticks;
use alloc::boxed::Box;
use serde::{Deserialize, Serialize};

/// Whether a request is outstanding.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) enum Phase {
    /// No: what the tasks answered last may be read.
    #[default]
    Closed,
    /// Yes.
    Open,
    /// It ended while a handler ran above the thread that asked, which was not told yet: what was answered stays here
    /// until it is, and nothing else is asked.
    Ended,
}

/// What became of the request at one task.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) enum Answer {
    #[default]
    NotAsked,
    Open,
    Answered,
    Refused,
    Restarted,
}

/// A task that may be asked.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Asked {
    pub task: TaskId,
    /// Its position among the parties of the port.
    pub party: u8,
    pub id: MessageId,
    pub answer: Answer,
    /// Packets of the request that may have left the node.
    pub packets_out: u16,
    /// What it answered, or another for it (D11).
    pub contents: Assembly,
    /// On which port, and who, while fragments are missing: those of two who answer make no message.
    pub by: Option<(PortId, TaskId)>,
}

/// One port on which the task asks.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Desk {
    pub port: PortId,
    /// Where the port stands among the task's own.
    pub local: u16,
    pub phase: Phase,
    /// Whether several tasks were asked.
    pub set: bool,
    pub deadline: Ticks,
    /// How often the request may still be sent again, and when next (D5).
    pub copies_left: u8,
    pub copy_at: Ticks,
    pub contents: Contents,
    pub parts: Parts,
    /// All tasks that may be asked, in the order of the parties.
    pub asked: Box<[Asked]>,
}

/// Under the variant that takes late answers: the command that timed out last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct Overdue {
    pub port: PortId,
    pub to: TaskId,
    pub id: MessageId,
}

impl Desk {
    pub fn new(port: &Port, own: TaskId, local: u16) -> Self {
        let fragments = port.decl.answer_fragments;
        let asked = |task| Asked {
            task,
            party: port.party_index(task).and_then(|i| u8::try_from(i).ok()).unwrap_or(u8::MAX),
            id: MessageId::default(),
            answer: Answer::NotAsked,
            packets_out: 0,
            contents: Assembly::new(fragments),
            by: None,
        };
        Self {
            port: port.id,
            local,
            phase: Phase::Closed,
            set: false,
            deadline: Ticks::FAR,
            copies_left: 0,
            copy_at: Ticks::FAR,
            contents: Contents::EMPTY,
            parts: Parts::new(port.decl.fragments),
            asked: port.peers(own).map(asked).collect(),
        }
    }

    /// When time alone makes this desk act.
    pub fn due(&self) -> Ticks {
        match self.phase {
            Phase::Open => self.deadline.min(self.copy_at),
            Phase::Closed | Phase::Ended => Ticks::FAR,
        }
    }

    /// The tasks whose answers are still waited for.
    pub fn open(&self) -> impl Iterator<Item = &Asked> {
        let open = self.phase == Phase::Open;
        self.asked.iter().filter(move |asked| open && asked.answer == Answer::Open)
    }

    pub fn find(&self, task: TaskId) -> Option<usize> {
        self.asked.iter().position(|asked| asked.task == task)
    }

    /// Which of the open requests has this id.
    pub fn waits_for(&self, id: MessageId) -> Option<usize> {
        let open = self.phase == Phase::Open;
        self.asked.iter().position(|asked| open && asked.answer == Answer::Open && asked.id == id)
    }

    /// The task is told: what was answered may be read until it asks again.
    pub fn tell(&mut self) {
        self.phase = Phase::Closed;
    }

    /// Takes back the request.
    pub fn close(&mut self) {
        self.phase = Phase::Closed;
        self.settle();
        self.forget();
    }

    /// Forgets what was answered.
    pub fn forget(&mut self) {
        // Of who was not asked since there is nothing to forget.
        for asked in self.asked.iter_mut().filter(|asked| asked.answer != Answer::NotAsked) {
            (asked.answer, asked.packets_out, asked.id) = (Answer::NotAsked, 0, MessageId::default());
            asked.by = None;
            asked.contents.begin(MessageId::default());
            asked.contents.contents.fill(Contents::EMPTY);
        }
    }

    fn settle(&mut self) {
        (self.deadline, self.copy_at, self.copies_left) = (Ticks::FAR, Ticks::FAR, 0);
        self.contents = Contents::EMPTY;
        self.parts.clear();
    }

    /// The first packet of the one answer, where answers take several.
    pub fn long_answer(&self) -> Option<Contents> {
        let answered = self.asked.iter().find(|asked| asked.answer == Answer::Answered)?;
        answered.contents.get(0).copied()
    }

    /// How a request to several tasks stands.
    pub fn answers(&self) -> Answers {
        let mut answers = Answers::default();
        for asked in &self.asked {
            let bit = 1_u64.checked_shl(u32::from(asked.party)).unwrap_or(0);
            answers.asked |= bit;
            match asked.answer {
                Answer::NotAsked => answers.asked &= !bit,
                Answer::Open if asked.packets_out == 0 => answers.unsent |= bit,
                Answer::Open => {}
                Answer::Answered => answers.answered |= bit,
                Answer::Refused => answers.refused |= bit,
                Answer::Restarted => answers.restarted |= bit,
            }
        }
        answers
    }
}

impl CommTask {
    /// What a task answered to the last request on a port, where several were asked or an answer takes several packets:
    /// until the next request there. A packed state leaves it out once the
    /// request has ended: a checker reads it with the signal.
    #[must_use]
    pub fn answer_of(&self, port: PortId, task: TaskId) -> Option<&Contents> {
        self.answer_fragment(port, task, 0)
    }

    /// Fragment `index` of [`answer_of`](Self::answer_of); the first one is 0.
    #[must_use]
    pub fn answer_fragment(&self, port: PortId, task: TaskId, index: u8) -> Option<&Contents> {
        let Role::Asks(desk) = self.role(port)? else { return None };
        let asked = self.desks[usize::from(desk)].asked.iter().find(|asked| asked.task == task)?;
        (asked.answer == Answer::Answered).then(|| asked.contents.get(index)).flatten()
    }

    /// The requests whose answers the task waits for: port, who was asked, and the id.
    pub fn outstanding(&self) -> impl Iterator<Item = (PortId, TaskId, MessageId)> {
        self.desks.iter().flat_map(|desk| desk.open().map(|asked| (desk.port, asked.task, asked.id)))
    }

    /// D5: the same message_ID inside the one budget, to those that have not answered.
    fn send_again(&mut self, table: &NodeTable, at: usize, out: &mut impl Outbox) {
        let desk = &mut self.desks[at];
        let Some(port) = table.port(desk.port) else { return };
        desk.copies_left = desk.copies_left.saturating_sub(1);
        desk.copy_at = if desk.copies_left > 0 { self.now + port.decl.resend } else { Ticks::FAR };
        let left = desk.deadline - self.now;
        let fragments = desk.parts.fragments().unwrap_or(1);
        let stamp = self.stamp(table, left);
        for i in 0..self.desks[at].asked.len() {
            let asked = &mut self.desks[at].asked[i];
            if asked.answer != Answer::Open {
                continue;
            }
            asked.packets_out = asked.packets_out.saturating_add(u16::from(fragments));
            let (to, id) = (asked.task, asked.id);
            self.count(port.id, |c| c.resent += 1);
            note(out, Event::Resent, port.id, to, id, left);
            let desk = &self.desks[at];
            let first = mapping::message(port, self.task, to, id, stamp, desk.contents);
            mapping::in_fragments(Packet { resent: true, ..first }, &desk.parts, |p| out.transmit(p));
        }
    }

    /// Time has passed: what is over ends, what is due is sent again.
    pub(super) fn advance_desk(&mut self, table: &NodeTable, at: usize, out: &mut impl Outbox) {
        let desk = &self.desks[at];
        if desk.due() > self.now {
            return;
        }
        if desk.deadline > self.now {
            return self.send_again(table, at, out);
        }
        let port = desk.port;
        self.count(port, |c| c.timed_out += 1);
        let mut outcome = Outcome::TimedOutUnknown;
        for asked in self.desks[at].open() {
            let unsent = asked.packets_out == 0;
            let event = if unsent { Event::TimedOutUnsent } else { Event::TimedOut };
            if unsent {
                outcome = Outcome::TimedOutUnsent;
            }
            note(out, event, port, asked.task, asked.id, Ticks::ZERO);
            if !table.rules().refuse_late_replies {
                self.overdue = Some(Overdue { port, to: asked.task, id: asked.id });
            }
        }
        self.end_request(at, outcome, out);
    }

    /// The answer of one task came in, or its refusal: the request ends with the last one.
    fn mark(&mut self, at: usize, asked: usize, event: Event, out: &mut impl Outbox) {
        let desk = &mut self.desks[at];
        let (port, left) = (desk.port, desk.deadline - self.now);
        let asked = &mut desk.asked[asked];
        let contents = asked.contents.get(0).copied().unwrap_or_default();
        let (answer, outcome) = match event {
            Event::Answered => (Answer::Answered, Outcome::Reply(contents)),
            Event::RefusedByPeer => (Answer::Refused, Outcome::Refused),
            _ => (Answer::Restarted, Outcome::PeerRestarted),
        };
        asked.answer = answer;
        let (task, id) = (asked.task, asked.id);
        let local = desk.local;
        self.count_at(local, |c| match answer {
            Answer::Answered => c.delivered += 1,
            Answer::Refused => c.refused += 1,
            Answer::Restarted | Answer::NotAsked | Answer::Open => {}
        });
        note(out, event, port, task, id, left);
        if self.desks[at].open().next().is_none() {
            self.end_request(at, outcome, out);
        }
    }

    fn end_request(&mut self, at: usize, outcome: Outcome, out: &mut impl Outbox) {
        let desk = &mut self.desks[at];
        desk.settle();
        let long = desk.asked.iter().any(|asked| asked.contents.contents.len() > 1);
        let at = super::index(at);
        let finished = match outcome {
            _ if desk.set => Finished::Answers(at),
            Outcome::Reply(_) if long => Finished::Long(at),
            Outcome::Reply(_)
            | Outcome::Refused
            | Outcome::TimedOutUnsent
            | Outcome::TimedOutUnknown
            | Outcome::PeerRestarted => Finished::Outcome(outcome),
        };
        if matches!(finished, Finished::Outcome(_)) {
            // The outcome says all there is.
            desk.close();
        } else {
            desk.phase = Phase::Ended;
        }
        self.conclude(Pending::Reply(at), finished, out);
    }

    /// An answer to the task's own class-2 message.
    pub(super) fn answer(&mut self, table: &NodeTable, at: u16, packet: &Packet, out: &mut impl Outbox) {
        let at = usize::from(at);
        let desk = &self.desks[at];
        let open = |asked: &Asked| asked.answer == Answer::Open && asked.id == packet.id;
        let from =
            desk.find(packet.source).filter(|&from| desk.phase == Phase::Open && open(&desk.asked[from]));
        match from {
            Some(asked) => self.answered(at, asked, packet, out),
            None => self.late_answer(table, packet, out),
        }
    }

    /// The answer of another task than the one that was asked (D11).
    pub(super) fn third_party(&mut self, table: &NodeTable, packet: &Packet, out: &mut impl Outbox) {
        let found = self.desks.iter().enumerate().find_map(|(at, d)| Some((at, d.waits_for(packet.id)?)));
        match found {
            Some((at, asked)) => self.answered(at, asked, packet, out),
            None => self.late_answer(table, packet, out),
        }
    }

    fn late_answer(&mut self, table: &NodeTable, packet: &Packet, out: &mut impl Outbox) {
        let fits = |o: &Overdue| o.id == packet.id && o.port == packet.port && o.to == packet.source;
        let answers =
            matches!(packet.kind, Kind::Reply | Kind::Response) && self.overdue.is_some_and(|o| fits(&o));
        if answers && !table.rules().refuse_late_replies {
            self.overdue = None;
            return self.tell(Finished::Outcome(Outcome::Reply(packet.contents)), out);
        }
        let stale = super::rendezvous::is_older(packet.id.incarnation, self.incarnation);
        self.drop_packet(packet, if stale { Reason::StaleIncarnation } else { Reason::Unexpected }, out);
    }

    fn answered(&mut self, at: usize, asked: usize, packet: &Packet, out: &mut impl Outbox) {
        let unsent = self.desks[at].asked[asked].packets_out == 0;
        let event = match (packet.kind, packet.control()) {
            (Kind::Reply | Kind::Response, _) => {
                let entry = &mut self.desks[at].asked[asked];
                let index = packet.fragment.saturating_add(u8::from(packet.more));
                if usize::from(index) >= entry.contents.contents.len() {
                    return self.drop_packet(packet, Reason::NotAllowed, out);
                }
                let whole = packet.fragment == 0 && !packet.more;
                let by = (packet.port, packet.source);
                if entry.contents.is_open() && entry.by != Some(by) {
                    // D11: who began first goes on, unless somebody says it all at once.
                    if !whole {
                        return self.drop_packet(packet, Reason::Unexpected, out);
                    }
                    entry.contents.begin(MessageId::default());
                }
                entry.by = (!whole).then_some(by);
                match entry.contents.put(packet, Ticks::FAR) {
                    Step::Whole(_) => Event::Answered,
                    Step::Waits => return,
                    Step::Again => return self.duplicate(packet, out),
                    Step::Broken => return self.drop_packet(packet, Reason::Incomplete, out),
                }
            }
            (_, Some(Control::Refused)) => Event::RefusedByPeer,
            (_, Some(Control::RefusedOnTheWay)) if unsent => Event::RefusedByPeer,
            (_, Some(Control::Restarted)) => Event::PeerRestarted,
            // A copy was refused on the way, but another one may have arrived: only the time_out tells.
            (_, Some(Control::RefusedOnTheWay)) => return,
            (_, None) => return self.drop_packet(packet, Reason::Unexpected, out),
        };
        self.mark(at, asked, event, out);
    }

    /// The transit buffer dropped a packet of one of the task's requests.
    pub(super) fn unsent(&mut self, id: MessageId) {
        for desk in &mut self.desks {
            if let Some(at) = desk.waits_for(id) {
                desk.asked[at].packets_out = desk.asked[at].packets_out.saturating_sub(1);
            }
        }
    }

    /// The node of tasks that were asked has a new incarnation.
    pub(super) fn asked_restarted(&mut self, table: &NodeTable, node: NodeId, out: &mut impl Outbox) {
        for at in 0..self.desks.len() {
            for asked in 0..self.desks[at].asked.len() {
                let entry = &self.desks[at].asked[asked];
                let open = self.desks[at].phase == Phase::Open && entry.answer == Answer::Open;
                if open && table.location(entry.task) == Some(node) {
                    self.mark(at, asked, Event::PeerRestarted, out);
                }
            }
        }
    }
}
