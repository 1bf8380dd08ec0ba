//! Canonical states (D51): the packed bytes that a model checker hashes.
//!
//! A packed state holds remaining times instead of instants, rounds relative to the least one in use on their port and
//! sequences relative to the next one of their source. So two states that differ by a shift of time or ids have the
//! same bytes. A distance that outgrows its field is an [`Overflow`], never a saturated value.

mod desks;
mod inboxes;
mod lease;
mod levels;
mod meetings;

use super::CommTask;
use super::desk::Overdue;
use crate::ids::{Incarnation, MessageId, PortId, Round, Seq24, TaskId};
use crate::packed::{Eye, Pen};
use crate::packet::Contents;
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

    /// What is left until `instant`: as [`Pen::ticks`] writes it.
    fn left(&mut self, instant: Ticks, now: Ticks) -> Result<(), Overflow> {
        let left = if instant == Ticks::FAR { Ticks::FAR } else { instant - now };
        let mut pen = Pen::new(self.bytes.get_mut(self.at..).ok_or(Overflow)?);
        pen.ticks(left)?;
        self.at += pen.at;
        Ok(())
    }

    fn word(&mut self, word: u16) -> Result<(), Overflow> {
        word.to_le_bytes().iter().try_for_each(|&byte| self.byte(byte))
    }

    /// What a member brings to a meeting, without the zeros at its end.
    fn arguments(&mut self, arguments: &[u8; 8]) -> Result<(), Overflow> {
        let mut pen = Pen::new(self.bytes.get_mut(self.at..).ok_or(Overflow)?);
        pen.arguments(arguments)?;
        self.at += pen.at;
        Ok(())
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
        let mut eye = Eye::new(self.bytes.get(self.at..).unwrap_or(&[]));
        let left = eye.ticks();
        self.at += eye.at;
        left
    }

    fn round(&mut self) -> Round {
        Frame::ROUND.plus(u16::from(self.byte()))
    }

    fn sequence(&mut self) -> Seq24 {
        let back = u32::from(self.byte());
        Frame::SEQUENCE.plus(Seq24::MODULUS - back)
    }

    fn word(&mut self) -> u16 {
        u16::from_le_bytes([self.byte(), self.byte()])
    }

    fn arguments(&mut self) -> [u8; 8] {
        let mut eye = Eye::new(self.bytes.get(self.at..).unwrap_or(&[]));
        let arguments = eye.arguments();
        self.at += eye.at;
        arguments
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

impl CommTask {
    /// Writes the canonical bytes of this state and returns how many. Call [`bury`](Self::bury) first.
    ///
    /// Left out are the counters, what the last message, ended requests and meetings said to a thread that has read it, and
    /// which start of a timer runs: nothing that happens depends on them.
    ///
    /// # Errors
    /// [`Overflow`] when a distance outgrows its field or `out` is too short.
    pub fn store(&self, table: &NodeTable, frame: &Frame<'_>, out: &mut [u8]) -> Result<usize, Overflow> {
        let mut w = Writer::new(out);
        self.store_levels(frame, &mut w)?;
        if !table.rules().refuse_late_replies {
            w.byte(u8::from(self.overdue.is_some()))?;
            if let Some(overdue) = &self.overdue {
                w.count(overdue.port.index())?;
                w.count(overdue.to.index())?;
                store_id(self.task, overdue.id, frame, &mut w)?;
            }
        }
        if frame.lives {
            w.left(self.quarantine_until, self.now)?;
            w.byte(self.incarnation.0)?;
            w.byte(u8::from(self.restarted))?;
            for known in &self.lives {
                w.byte(known.life.map_or(0, |life| life.0.wrapping_add(1)))?;
            }
        }
        for local in self.locals.iter().filter(|local| local.staged.has_room()) {
            local.staged.store(&mut w)?;
        }
        for desk in &self.desks {
            self.store_desk(table, desk, frame, &mut w)?;
        }
        for inbox in &self.inboxes {
            self.store_inbox(table, inbox, frame, &mut w)?;
        }
        for meeting in &self.meetings {
            self.store_meeting(meeting, frame, &mut w)?;
        }
        if let Some(lease) = &self.lease {
            self.store_lease(lease, frame, &mut w)?;
        }
        self.store_guards(&mut w)?;
        Ok(w.at)
    }

    /// Reads a state back in place and returns how many bytes it took. Ids come back relative to [`Frame::ROUND`] and
    /// [`Frame::SEQUENCE`], time relative to zero. `bytes` must come from [`store`](Self::store) of the same task.
    pub fn load(&mut self, table: &NodeTable, lives: bool, bytes: &[u8]) -> usize {
        let mut r = Reader::new(bytes);
        self.now = Ticks::ZERO;
        self.next_sequence = Frame::SEQUENCE;
        // One thread drives a packed task: no word of an earlier start can still be on its way.
        self.next_turn = 0;
        self.taken.0 = None;
        self.taken.1.clear();
        self.load_levels(&mut r);
        self.overdue = None;
        if !table.rules().refuse_late_replies && r.byte() == 1 {
            let (port, to) = (PortId(u16::from(r.byte())), TaskId(u16::from(r.byte())));
            self.overdue = Some(Overdue { port, to, id: self.load_own_id(&mut r, lives) });
        }
        self.quarantine_until = Ticks::ZERO;
        if lives {
            self.quarantine_until = r.left();
            self.incarnation = Incarnation(r.byte());
            self.restarted = r.byte() == 1;
        }
        for known in &mut self.lives {
            known.life = if lives { r.byte().checked_sub(1).map(Incarnation) } else { Some(Incarnation(0)) };
        }
        for local in self.locals.iter_mut().filter(|local| local.staged.has_room()) {
            local.staged.load(&mut r);
        }
        for i in 0..self.desks.len() {
            self.load_desk(table, i, lives, &mut r);
        }
        self.arrivals = 0;
        self.rejections = 1;
        // As if that many had been served: no port was passed over more often.
        self.served = u64::from(u8::MAX);
        for i in 0..self.inboxes.len() {
            self.load_inbox(table, i, lives, &mut r);
        }
        for i in 0..self.meetings.len() {
            let resend = table.port(self.meetings[i].port).map_or(Ticks::FAR, |port| port.decl.resend);
            self.load_meeting(i, resend, lives, &mut r);
        }
        self.load_lease(lives, &mut r);
        self.load_guards(&mut r);
        if self.inboxes.iter().any(|inbox| inbox.handled) {
            self.heads.watch(&self.inboxes);
        }
        self.touch_all();
        r.at
    }

    fn load_own_id(&self, r: &mut Reader<'_>, lives: bool) -> MessageId {
        let id = load_id(r, lives);
        if lives { id } else { MessageId { incarnation: self.incarnation, ..id } }
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
