//! The state of one outstanding class-2 request. Each port on which the task asks has one such state (§4.1, D5, D6, D12).

use crate::ids::{MessageId, PortId, TaskId};
use crate::observe::Reason;
use crate::packet::{Contents, Packet};
use crate::request::Answers;
use crate::table::Port;
use crate::task::fragments::{Assembly, Parts, Progress};
use crate::task::own::are_alike;
use crate::ticks::{Instant, Ticks};
use alloc::boxed::Box;
use serde::{Deserialize, Serialize};

/// The state of a request.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) enum Phase {
    /// No request is outstanding. The answers to the last request can be read.
    #[default]
    Closed,
    /// A request is outstanding.
    Open,
    /// The request ended while a handler ran above the activation that waits for it. The answers stay here until that
    /// activation resumes, and no other request may begin.
    Ended,
}

/// The state of a request towards one of the tasks that it asks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) enum Answer {
    #[default]
    NotAsked,
    Open,
    Answered,
    Refused,
    Restarted,
}

/// A task that may be asked on the port, and the state of the request towards this task.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Recipient {
    pub task: TaskId,
    /// The task's position among the parties of the port.
    pub party: u8,
    pub id: MessageId,
    pub answer: Answer,
    /// The number of packets of the request that may have left the node.
    pub packets_out: u16,
    /// The task's answer, or a third-party reply in its place (D11).
    pub contents: Assembly,
    /// The port and the sender of an incomplete answer, because fragments of two senders do not make one answer.
    pub by: Option<(PortId, TaskId)>,
}

/// The state of one outstanding request, or of the last one, on one port.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Outstanding {
    pub port: PortId,
    /// The position of the endpoint of the request's port.
    pub endpoint: u16,
    pub phase: Phase,
    /// Whether the request goes to several tasks.
    pub set: bool,
    pub deadline: Instant,
    /// How many retransmissions remain, and when the next is due (D5).
    pub copies_left: u8,
    pub copy_at: Instant,
    pub contents: Contents,
    pub parts: Parts,
    /// All tasks that the task may ask on the port, in the order of the port's parties.
    pub recipients: Box<[Recipient]>,
}

impl Recipient {
    /// Whether the answer of this task to the message with this id is missing.
    #[inline]
    pub fn waits_for(&self, id: MessageId) -> bool {
        self.answer == Answer::Open && self.id == id
    }

    /// Takes a packet of the task's answer, or returns the reason to drop it.
    pub fn take(&mut self, packet: &Packet) -> Result<Progress, Reason> {
        let index = packet.fragment.saturating_add(u8::from(packet.more));
        if usize::from(index) >= self.contents.contents.len() {
            return Err(Reason::NotAllowed);
        }
        let whole = packet.fragment == 0 && !packet.more;
        let by = (packet.port, packet.source);
        if self.contents.is_open() && self.by != Some(by) {
            // The sender whose fragments began an answer completes that answer. Only an answer in one packet may take its
            // place (D11).
            if !whole {
                return Err(Reason::Unexpected);
            }
            self.contents.begin(MessageId::default());
        }
        self.by = (!whole).then_some(by);
        Ok(self.contents.put(packet, Instant::NEVER))
    }
}

impl Outstanding {
    pub fn new(port: &Port, own: TaskId, endpoint: u16) -> Self {
        let fragments = port.decl.answer_fragments;
        let recipient = |task| Recipient {
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
            endpoint,
            phase: Phase::Closed,
            set: false,
            deadline: Instant::NEVER,
            copies_left: 0,
            copy_at: Instant::NEVER,
            contents: Contents::EMPTY,
            parts: Parts::new(port.decl.fragments),
            recipients: port.peers(own).map(recipient).collect(),
        }
    }

    /// The next instant at which time alone makes this request act.
    pub fn due(&self) -> Instant {
        match self.phase {
            Phase::Open => self.deadline.min(self.copy_at),
            Phase::Closed | Phase::Ended => Instant::NEVER,
        }
    }

    /// The asked tasks whose answers are missing.
    pub fn open(&self) -> impl Iterator<Item = &Recipient> {
        let open = self.phase == Phase::Open;
        self.recipients.iter().filter(move |recipient| open && recipient.answer == Answer::Open)
    }

    /// The position of the asked task whose open request has this id.
    pub fn waits_for(&self, id: MessageId) -> Option<usize> {
        let open = self.phase == Phase::Open;
        self.recipients.iter().position(|recipient| open && recipient.waits_for(id))
    }

    /// Notes that a message of `packets` packets was sent to a recipient.
    #[inline]
    pub fn sent(&mut self, recipient: usize, id: MessageId, packets: u8) {
        let recipient = &mut self.recipients[recipient];
        (recipient.id, recipient.answer, recipient.packets_out) = (id, Answer::Open, packets.into());
    }

    /// Notes that the outcome was reported. The answers stay readable until the next request.
    pub fn tell(&mut self) {
        self.phase = Phase::Closed;
    }

    /// Cancels the request.
    pub fn close(&mut self) {
        self.phase = Phase::Closed;
        self.settle();
        self.forget();
    }

    /// As [`close`](Self::close), for a request that asked only this recipient and keeps no part of its answer.
    #[inline]
    pub fn close_only(&mut self, recipient: usize) {
        self.phase = Phase::Closed;
        self.settle();
        let asked = &mut self.recipients[recipient];
        (asked.answer, asked.packets_out, asked.id) = (Answer::NotAsked, 0, MessageId::default());
        asked.contents.begin(MessageId::default());
    }

    /// Forgets the answers.
    #[inline]
    pub fn forget(&mut self) {
        // A recipient that the last request did not ask has nothing to forget.
        for recipient in self.recipients.iter_mut().filter(|recipient| recipient.answer != Answer::NotAsked) {
            (recipient.answer, recipient.packets_out, recipient.id) =
                (Answer::NotAsked, 0, MessageId::default());
            recipient.by = None;
            recipient.contents.begin(MessageId::default());
            recipient.contents.contents.fill(Contents::EMPTY);
        }
    }

    /// Opens the request, after its messages were sent: from now on its answers are awaited.
    #[inline]
    pub fn open_for(
        &mut self,
        set: bool,
        retries: u8,
        (port, ttl, contents): (&Port, Ticks, Contents),
        now: Instant,
    ) {
        (self.phase, self.set, self.deadline, self.contents) = (Phase::Open, set, now + ttl, contents);
        self.copies_left = retries;
        self.copy_at = if retries > 0 { now + port.decl.resend } else { Instant::NEVER };
    }

    /// Validates a deserialised request: its port and its capacities must be those of a new request.
    pub fn is_like(&self, new: &Self) -> bool {
        let is = |read: &Recipient, new: &Recipient| {
            (read.task, read.party) == (new.task, new.party) && read.contents.has_room_of(&new.contents)
        };
        (self.port, self.endpoint) == (new.port, new.endpoint)
            && self.parts.has_room_of(&new.parts)
            && are_alike(&self.recipients, &new.recipients, is)
    }

    /// Clears the deadline, the retransmissions and the id of the request.
    #[inline]
    pub fn settle(&mut self) {
        (self.deadline, self.copy_at, self.copies_left) = (Instant::NEVER, Instant::NEVER, 0);
        self.contents = Contents::EMPTY;
        self.parts.clear();
    }

    /// The first packet of the only answer, if answers may take several packets.
    pub fn long_answer(&self) -> Option<Contents> {
        let answered = self.recipients.iter().find(|recipient| recipient.answer == Answer::Answered)?;
        answered.contents.get(0).copied()
    }

    /// The state of a request to several tasks.
    pub fn answers(&self) -> Answers {
        let mut answers = Answers::default();
        for recipient in &self.recipients {
            let bit = 1_u64.checked_shl(u32::from(recipient.party)).unwrap_or(0);
            answers.asked |= bit;
            match recipient.answer {
                Answer::NotAsked => answers.asked &= !bit,
                Answer::Open if recipient.packets_out == 0 => answers.unsent |= bit,
                Answer::Open => {}
                Answer::Answered => answers.answered |= bit,
                Answer::Refused => answers.refused |= bit,
                Answer::Restarted => answers.restarted |= bit,
            }
        }
        answers
    }
}
