//! Canonical states (D51): the packed bytes that a model checker hashes.
//!
//! A packed state holds remaining times instead of instants, rounds relative to the least one in use on their port and
//! sequences relative to the next one of their source. So two states that differ by a shift of time or ids have the
//! same bytes. A distance that outgrows its field is an [`Overflow`], never a saturated value.

use super::inbox::{Held, Inbox};
use super::memory::{Fate, Remembered, Window};
use super::rendezvous::{Arrived, Rendezvous};
use super::{CommTask, Command, Pending};
use crate::ids::{Incarnation, MessageId, PortId, Round, Seq24, TaskId};
use crate::packet::{Class, Contents};
use crate::request::{Ranked, ServiceOrder, TimeId};
use crate::table::NodeTable;
use crate::ticks::Ticks;

/// What packed ids are relative to.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// For each port, the least round in use anywhere in the cell.
    pub rounds: &'a [Round],
    /// For each task, the next sequence number it will use.
    pub sequences: &'a [Seq24],
    /// Whether nodes restart: if not, everyone's first life needs no bytes.
    pub lives: bool,
}

impl Frame<'_> {
    /// The round that a packed zero is loaded as.
    pub const ROUND: Round = Round(0x1000);
    /// The next sequence that packed sequences are loaded relative to.
    pub const SEQUENCE: Seq24 = Seq24::new(0x1000);

    fn round(&self, port: PortId, round: Round) -> Result<u8, Overflow> {
        let base = self.rounds.get(port.index()).copied().unwrap_or_default();
        u8::try_from(round.steps_from(base)).map_err(|_| Overflow)
    }

    fn sequence(&self, source: TaskId, sequence: Seq24) -> Result<u8, Overflow> {
        let next = self.sequences.get(source.index()).copied().unwrap_or_default();
        u8::try_from(next.steps_from(sequence)).map_err(|_| Overflow)
    }
}

/// A state does not fit its packed form: a distance outgrew a byte, or the bytes ran out. The checker treats it as an
/// absorbing, visible failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Overflow;

impl core::fmt::Display for Overflow {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("a state does not fit its packed form")
    }
}

impl core::error::Error for Overflow {}

/// Writes packed bytes.
#[derive(Debug)]
pub(crate) struct Writer<'a> {
    bytes: &'a mut [u8],
    at: usize,
}

impl<'a> Writer<'a> {
    pub fn new(bytes: &'a mut [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    pub fn byte(&mut self, byte: u8) -> Result<(), Overflow> {
        *self.bytes.get_mut(self.at).ok_or(Overflow)? = byte;
        self.at += 1;
        Ok(())
    }

    fn count(&mut self, count: usize) -> Result<(), Overflow> {
        self.byte(u8::try_from(count).map_err(|_| Overflow)?)
    }

    /// What is left until `instant`: 255 for never.
    fn left(&mut self, instant: Ticks, now: Ticks) -> Result<(), Overflow> {
        if instant == Ticks::FAR {
            return self.byte(u8::MAX);
        }
        let left = u8::try_from((instant - now).0).ok().filter(|&left| left != u8::MAX);
        self.byte(left.ok_or(Overflow)?)
    }

    fn contents(&mut self, contents: &Contents) -> Result<(), Overflow> {
        self.count(contents.as_bytes().len())?;
        contents.as_bytes().iter().try_for_each(|&byte| self.byte(byte))
    }
}

/// Reads packed bytes back. Reading past the end gives zeros, which no `store` produces and no `load` panics on.
#[derive(Debug)]
pub(crate) struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    pub fn byte(&mut self) -> u8 {
        let byte = self.bytes.get(self.at).copied().unwrap_or(0);
        self.at += 1;
        byte
    }

    fn left(&mut self) -> Ticks {
        match self.byte() {
            u8::MAX => Ticks::FAR,
            left => Ticks(u64::from(left)),
        }
    }

    fn round(&mut self) -> Round {
        Frame::ROUND.plus(u16::from(self.byte()))
    }

    fn sequence(&mut self) -> Seq24 {
        let back = u32::from(self.byte());
        Frame::SEQUENCE.plus(Seq24::MODULUS - back)
    }

    fn contents(&mut self) -> Contents {
        let len = usize::from(self.byte()).min(12);
        let mut bytes = [0; 12];
        for byte in bytes.iter_mut().take(len) {
            *byte = self.byte();
        }
        Contents::new(&bytes[..len]).unwrap_or_default()
    }
}

/// Present bits of a rendezvous and of a member.
const WAITS: u8 = 1;
const RELEASED: u8 = 2;
const FRESH: u8 = 4;
const OWES: u8 = 8;
const COPIES: u8 = 16;
const ARRIVED: u8 = 1;
const BARRED: u8 = 2;
const REBORN: u8 = 4;

impl CommTask {
    /// Writes the canonical bytes of this state and returns how many. Call [`bury`](Self::bury) first.
    ///
    /// Left out are the counters and the arguments of waitfors: nothing that happens depends on them.
    ///
    /// # Errors
    /// [`Overflow`] when a distance outgrows its field or `out` is too short.
    pub fn store(&self, table: &NodeTable, frame: &Frame<'_>, out: &mut [u8]) -> Result<usize, Overflow> {
        let mut w = Writer::new(out);
        self.store_pending(frame, &mut w)?;
        if table.rules().refuse_late_replies {
            // Without the variant there is never an overdue command.
        } else {
            w.byte(u8::from(self.overdue.is_some()))?;
            if let Some(command) = &self.overdue {
                self.store_command(command, frame, &mut w)?;
            }
        }
        if frame.lives {
            w.left(self.quarantine_until, self.now)?;
            w.byte(self.incarnation.0)?;
            w.byte(u8::from(self.restarted))?;
        }
        w.count(self.order.ranked().len())?;
        for ranked in self.order.ranked() {
            let (kind, of) = match ranked {
                Ranked::Port(port) => (0, port.index()),
                Ranked::Source(task) => (1, task.index()),
                Ranked::Timers => (2, 0),
                Ranked::Own => (3, 0),
            };
            w.byte(kind)?;
            w.count(of)?;
        }
        for inbox in &self.inboxes {
            w.count(inbox.queue.len())?;
            for (_, _, held) in inbox.queue.sorted() {
                w.count(held.source.index())?;
                store_id(held.source, held.id, frame, &mut w)?;
                w.byte(u8::from(held.class == Class::Status))?;
                w.left(held.expires, self.now)?;
                w.contents(&held.contents)?;
            }
        }
        for source in &self.sources {
            self.store_source(source, frame, &mut w)?;
        }
        for meeting in &self.meetings {
            self.store_meeting(meeting, frame, &mut w)?;
        }
        Ok(w.at)
    }

    fn store_pending(&self, frame: &Frame<'_>, w: &mut Writer<'_>) -> Result<(), Overflow> {
        match &self.pending {
            Pending::Nothing => w.byte(0),
            Pending::Get { port, source, deadline } => {
                w.byte(1)?;
                w.count(port.map_or(0, |p| p.index() + 1))?;
                w.count(source.map_or(0, |s| s.index() + 1))?;
                w.left(*deadline, self.now)
            }
            Pending::Reply(command) => {
                w.byte(2)?;
                self.store_command(command, frame, w)
            }
            Pending::Meeting(meeting) => {
                w.byte(3)?;
                w.count(usize::from(*meeting))
            }
            Pending::Delay(id, _) => {
                w.byte(4)?;
                w.byte(id.0)
            }
        }
    }

    fn store_command(&self, c: &Command, frame: &Frame<'_>, w: &mut Writer<'_>) -> Result<(), Overflow> {
        w.count(c.port.index())?;
        w.count(c.to.index())?;
        store_id(self.task, c.id, frame, w)?;
        w.left(c.deadline, self.now)?;
        w.contents(&c.contents)?;
        w.byte(c.copies_left)?;
        w.left(c.copy_at, self.now)?;
        w.byte(c.copies_out)
    }

    fn store_source(
        &self,
        source: &super::Source,
        frame: &Frame<'_>,
        w: &mut Writer<'_>,
    ) -> Result<(), Overflow> {
        if frame.lives {
            w.byte(source.life.map_or(0, |life| life.0.wrapping_add(1)))?;
        }
        match &source.command {
            None => w.byte(0)?,
            Some(c) => {
                w.byte(match c.fate {
                    Fate::Held => 1,
                    Fate::Delivered(_) => 2,
                    Fate::Refused => 3,
                    Fate::Answered(_) => 4,
                })?;
                w.count(c.port.index())?;
                store_id(source.task, c.id, frame, w)?;
                w.left(c.sender_until, self.now)?;
                w.left(c.until, self.now)?;
                match &c.fate {
                    Fate::Delivered(budget_ends) => w.left(*budget_ends, self.now)?,
                    Fate::Answered(contents) => w.contents(contents)?,
                    Fate::Held | Fate::Refused => {}
                }
            }
        }
        match source.status.newest {
            None => w.byte(0),
            Some(newest) => {
                w.byte(1)?;
                w.byte(frame.sequence(source.task, newest)?)?;
                w.left(source.status.until, self.now)?;
                source.status.seen.to_le_bytes().iter().try_for_each(|&byte| w.byte(byte))
            }
        }
    }

    fn store_meeting(&self, m: &Rendezvous, frame: &Frame<'_>, w: &mut Writer<'_>) -> Result<(), Overflow> {
        let fresh = m.fresh != m.announced;
        let flag = |set: bool, bit: u8| if set { bit } else { 0 };
        w.byte(
            flag(m.deadline.is_some(), WAITS)
                | flag(m.released.is_some(), RELEASED)
                | flag(fresh, FRESH)
                | flag(m.owes_confirm, OWES)
                | flag(m.copies_left > 0, COPIES),
        )?;
        w.byte(frame.round(m.port, m.announced)?)?;
        if let Some(deadline) = m.deadline {
            w.left(deadline, self.now)?;
        }
        if let Some(released) = m.released {
            w.byte(frame.round(m.port, released)?)?;
        }
        if fresh {
            w.byte(frame.round(m.port, m.fresh)?)?;
        }
        if m.copies_left > 0 {
            w.byte(m.copies_left)?;
            w.left(m.copy_at, self.now)?;
        }
        for member in &m.members {
            w.byte(
                flag(member.arrived.is_some(), ARRIVED)
                    | flag(member.barred.is_some(), BARRED)
                    | flag(member.reborn, REBORN),
            )?;
            if let Some(arrived) = member.arrived {
                w.byte(frame.round(m.port, arrived.round)?)?;
                w.left(arrived.expires, self.now)?;
            }
            if let Some(barred) = member.barred {
                w.byte(frame.round(m.port, barred)?)?;
            }
            if frame.lives {
                w.byte(member.life.map_or(0, |life| life.0.wrapping_add(1)))?;
            }
        }
        Ok(())
    }

    /// Reads a state back in place and returns how many bytes it took. Ids come back relative to [`Frame::ROUND`] and
    /// [`Frame::SEQUENCE`], time relative to zero. `bytes` must come from [`store`](Self::store) of the same task.
    pub fn load(&mut self, table: &NodeTable, lives: bool, bytes: &[u8]) -> usize {
        let mut r = Reader::new(bytes);
        self.now = Ticks::ZERO;
        self.next_sequence = Frame::SEQUENCE;
        // One thread drives a packed task: no word of an earlier start can still be on its way.
        self.next_turn = 0;
        self.load_pending(lives, &mut r);
        self.overdue = None;
        if !table.rules().refuse_late_replies && r.byte() == 1 {
            self.overdue = Some(self.load_command(lives, &mut r));
        }
        self.quarantine_until = Ticks::ZERO;
        if lives {
            self.quarantine_until = r.left();
            self.incarnation = Incarnation(r.byte());
            self.restarted = r.byte() == 1;
        }
        let mut named = [Ranked::Own; ServiceOrder::LEVELS];
        let levels = usize::from(r.byte()).min(named.len());
        for ranked in named.iter_mut().take(levels) {
            let (kind, of) = (r.byte(), u16::from(r.byte()));
            *ranked = match kind {
                0 => Ranked::Port(PortId(of)),
                1 => Ranked::Source(TaskId(of)),
                2 => Ranked::Timers,
                _ => Ranked::Own,
            };
        }
        self.order = ServiceOrder::new(&named[..levels]).unwrap_or_default();
        self.arrivals = 0;
        for inbox in &mut self.inboxes {
            inbox.queue.clear();
            for _ in 0..r.byte() {
                let source = TaskId(u16::from(r.byte()));
                let id = load_id(&mut r, lives);
                let class = if r.byte() == 1 { Class::Status } else { Class::Command };
                let held = Held { source, id, class, expires: r.left(), contents: r.contents() };
                let _ = inbox.queue.push(Inbox::key(&held, self.arrivals), held);
                self.arrivals += 1;
            }
        }
        for i in 0..self.sources.len() {
            self.load_source(i, lives, &mut r);
        }
        for i in 0..self.meetings.len() {
            let resend = table.port(self.meetings[i].port).map_or(Ticks::FAR, |port| port.decl.resend);
            self.load_meeting(i, resend, lives, &mut r);
        }
        r.at
    }

    fn load_pending(&mut self, lives: bool, r: &mut Reader<'_>) {
        let at = |byte: u8| byte.checked_sub(1).map(u16::from);
        self.pending = match r.byte() {
            1 => Pending::Get {
                port: at(r.byte()).map(PortId),
                source: at(r.byte()).map(TaskId),
                deadline: r.left(),
            },
            2 => Pending::Reply(self.load_command(lives, r)),
            3 => Pending::Meeting(u16::from(r.byte())),
            4 => Pending::Delay(TimeId(r.byte()), 0),
            _ => Pending::Nothing,
        };
    }

    fn load_command(&self, lives: bool, r: &mut Reader<'_>) -> Command {
        Command {
            port: PortId(u16::from(r.byte())),
            to: TaskId(u16::from(r.byte())),
            id: if lives {
                load_id(r, true)
            } else {
                MessageId { incarnation: self.incarnation, sequence: load_id(r, false).sequence }
            },
            deadline: r.left(),
            contents: r.contents(),
            copies_left: r.byte(),
            copy_at: r.left(),
            copies_out: r.byte(),
        }
    }

    fn load_source(&mut self, i: usize, lives: bool, r: &mut Reader<'_>) {
        let life = if lives { r.byte().checked_sub(1).map(Incarnation) } else { Some(Incarnation(0)) };
        let fate = r.byte();
        let command = (fate != 0).then(|| {
            let port = PortId(u16::from(r.byte()));
            let id = load_id(r, lives);
            let (sender_until, until) = (r.left(), r.left());
            let fate = match fate {
                1 => Fate::Held,
                2 => Fate::Delivered(r.left()),
                3 => Fate::Refused,
                _ => Fate::Answered(r.contents()),
            };
            Remembered { port, id, fate, sender_until, until }
        });
        let status = if r.byte() == 0 {
            Window::default()
        } else {
            let newest = Some(r.sequence());
            let until = r.left();
            let mut seen = [0; 8];
            for byte in &mut seen {
                *byte = r.byte();
            }
            Window { newest, seen: u64::from_le_bytes(seen), until }
        };
        let source = &mut self.sources[i];
        (source.life, source.command, source.status) = (life, command, status);
    }

    fn load_meeting(&mut self, i: usize, resend: Ticks, lives: bool, r: &mut Reader<'_>) {
        let m = &mut self.meetings[i];
        let flags = r.byte();
        m.announced = r.round();
        m.deadline = (flags & WAITS != 0).then(|| r.left());
        m.released = (flags & RELEASED != 0).then(|| r.round());
        m.fresh = if flags & FRESH != 0 { r.round() } else { m.announced };
        m.resend_at = m
            .deadline
            .map_or(Ticks::FAR, |deadline| Rendezvous::resend_instant(deadline, Ticks::ZERO, resend));
        m.owes_confirm = flags & OWES != 0;
        (m.copies_left, m.copy_at) = (0, Ticks::FAR);
        if flags & COPIES != 0 {
            (m.copies_left, m.copy_at) = (r.byte(), r.left());
        }
        m.arguments = [0; 8];
        for member in &mut m.members {
            let flags = r.byte();
            member.arrived = (flags & ARRIVED != 0).then(|| {
                let (round, expires) = (r.round(), r.left());
                Arrived { round, expires, arguments: [0; 8] }
            });
            member.barred = (flags & BARRED != 0).then(|| r.round());
            member.reborn = flags & REBORN != 0;
            member.life = if lives { r.byte().checked_sub(1).map(Incarnation) } else { Some(Incarnation(0)) };
            member.confirmed = false;
        }
    }
}

fn store_id(source: TaskId, id: MessageId, frame: &Frame<'_>, w: &mut Writer<'_>) -> Result<(), Overflow> {
    if frame.lives {
        w.byte(id.incarnation.0)?;
    }
    w.byte(frame.sequence(source, id.sequence)?)
}

fn load_id(r: &mut Reader<'_>, lives: bool) -> MessageId {
    let incarnation = Incarnation(if lives { r.byte() } else { 0 });
    MessageId { incarnation, sequence: r.sequence() }
}
