//! A class-2 message that waits for its answers: one desk for each port that the task asks on (§4.1, D5, D6, D12).

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

/// Whether a request is outstanding.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) enum Phase {
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
pub(super) enum Answer {
    #[default]
    NotAsked,
    Open,
    Answered,
    Refused,
    Restarted,
}

/// A task that may be asked.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Asked {
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
pub(super) struct Desk {
    pub port: PortId,
    /// Where the port stands among the task's own.
    pub endpoint: u16,
    pub phase: Phase,
    /// Whether several tasks were asked.
    pub set: bool,
    pub deadline: Instant,
    /// How often the request may still be sent again, and when next (D5).
    pub copies_left: u8,
    pub copy_at: Instant,
    pub contents: Contents,
    pub parts: Parts,
    /// All tasks that may be asked, in the order of the parties.
    pub asked: Box<[Asked]>,
}

impl Asked {
    /// Takes a packet of its answer; the reason where it is none.
    pub fn take(&mut self, packet: &Packet) -> Result<Progress, Reason> {
        let index = packet.fragment.saturating_add(u8::from(packet.more));
        if usize::from(index) >= self.contents.contents.len() {
            return Err(Reason::NotAllowed);
        }
        let whole = packet.fragment == 0 && !packet.more;
        let by = (packet.port, packet.source);
        if self.contents.is_open() && self.by != Some(by) {
            // D11: who began first goes on, unless somebody says it all at once.
            if !whole {
                return Err(Reason::Unexpected);
            }
            self.contents.begin(MessageId::default());
        }
        self.by = (!whole).then_some(by);
        Ok(self.contents.put(packet, Instant::NEVER))
    }
}

impl Desk {
    pub fn new(port: &Port, own: TaskId, endpoint: u16) -> Self {
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
            endpoint,
            phase: Phase::Closed,
            set: false,
            deadline: Instant::NEVER,
            copies_left: 0,
            copy_at: Instant::NEVER,
            contents: Contents::EMPTY,
            parts: Parts::new(port.decl.fragments),
            asked: port.peers(own).map(asked).collect(),
        }
    }

    /// When time alone makes this desk act.
    pub fn due(&self) -> Instant {
        match self.phase {
            Phase::Open => self.deadline.min(self.copy_at),
            Phase::Closed | Phase::Ended => Instant::NEVER,
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

    /// The request is out: from here on its answers are waited for.
    pub fn open_for(
        &mut self,
        set: bool,
        retries: u8,
        (port, life, contents): (&Port, Ticks, Contents),
        now: Instant,
    ) {
        (self.phase, self.set, self.deadline, self.contents) = (Phase::Open, set, now + life, contents);
        self.copies_left = retries;
        self.copy_at = if retries > 0 { now + port.decl.resend } else { Instant::NEVER };
    }

    /// Whether it has the port of a new one, and room for the same answers.
    pub fn is_like(&self, new: &Self) -> bool {
        let is = |read: &Asked, new: &Asked| {
            (read.task, read.party) == (new.task, new.party) && read.contents.has_room_of(&new.contents)
        };
        (self.port, self.endpoint) == (new.port, new.endpoint)
            && self.parts.has_room_of(&new.parts)
            && are_alike(&self.asked, &new.asked, is)
    }

    /// Nothing is outstanding.
    pub fn settle(&mut self) {
        (self.deadline, self.copy_at, self.copies_left) = (Instant::NEVER, Instant::NEVER, 0);
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
