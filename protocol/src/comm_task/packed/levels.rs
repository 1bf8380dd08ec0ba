//! The packed form of a task's threads, its timers and its `order`.

use super::{CommTask, Frame, Overflow, Reader, Writer};
use crate::comm_task::Pending;
use crate::comm_task::levels::{DEPTH, Finished, Level};
use crate::comm_task::timers::{Started, Timers};
use crate::ids::{PortId, TaskId};
use crate::request::{Outcome, Ranked, ReleasedBy, ServiceOrder, TimeId};

/// The first byte: how many levels the `order` names, and what else there is.
const LEVELS: u8 = 0x0f;
const HANDLERS: u8 = 0x10;
const TIMERS: u8 = 0x20;
const ATOMIC: u8 = 0x40;
const CAPPED: u8 = 0x80;

/// The codes of waits below these name themselves; from them on they count desks and meetings.
const DESKS: u8 = 0x10;
const MEETINGS: u8 = 0x80;

impl CommTask {
    pub(super) fn store_levels(&self, frame: &Frame<'_>, w: &mut Writer<'_>) -> Result<(), Overflow> {
        let named = self.order.ranked();
        let timers = self.timers.0.iter().flatten().count();
        let flag = |set: bool, bit: u8| if set { bit } else { 0 };
        let first = flag(self.depth > 0, HANDLERS)
            | flag(timers > 0, TIMERS)
            | flag(self.levels[0].atomic, ATOMIC)
            | flag(self.capped_last, CAPPED)
            | u8::try_from(named.len()).map_err(|_| Overflow)?;
        w.byte(first)?;
        for ranked in named {
            let (kind, of) = match ranked {
                Ranked::Port(port) => (0, port.index()),
                Ranked::Source(task) => (1, task.index()),
                Ranked::Timers => (2, 0),
                Ranked::Own => (3, 0),
                Ranked::Timer(id) => (4, usize::from(id.0)),
            };
            w.byte(kind)?;
            w.count(of)?;
        }
        if self.depth > 0 {
            w.byte(self.depth)?;
        }
        for (i, level) in self.running().iter().enumerate() {
            self.store_pending(&level.pending, w)?;
            if i > 0 {
                w.byte(level.rank | flag(level.atomic, ATOMIC))?;
            }
            if i < usize::from(self.depth) {
                store_finished(level.finished.as_ref(), frame, w)?;
            }
        }
        if timers > 0 {
            w.count(timers)?;
            let mut last = None;
            while let Some(next) = self
                .timers
                .0
                .iter()
                .flatten()
                .filter(|s| last.is_none_or(|id| s.id > id))
                .min_by_key(|s| s.id)
            {
                w.byte(next.id.0)?;
                w.byte(u8::from(next.ended))?;
                last = Some(next.id);
            }
        }
        Ok(())
    }

    fn store_pending(&self, pending: &Pending, w: &mut Writer<'_>) -> Result<(), Overflow> {
        let place = |base: u8, at: u16, end: u16| {
            u8::try_from(at).ok().filter(|_| at < end).map(|at| base + at).ok_or(Overflow)
        };
        match pending {
            Pending::Nothing => w.byte(0),
            Pending::Get { port, source, deadline } => {
                w.byte(1)?;
                w.count(port.map_or(0, |p| p.index() + 1))?;
                w.count(source.map_or(0, |s| s.index() + 1))?;
                w.left(*deadline, self.now)
            }
            Pending::Delay(id, _) => {
                w.byte(2)?;
                w.byte(id.0)
            }
            Pending::Work => w.byte(3),
            Pending::Boundary => w.byte(4),
            Pending::Lease => w.byte(5),
            Pending::Reply(desk) => w.byte(place(DESKS, *desk, u16::from(MEETINGS - DESKS))?),
            Pending::Meeting(meeting) => w.byte(place(MEETINGS, *meeting, u16::from(MEETINGS))?),
        }
    }

    pub(super) fn load_levels(&mut self, r: &mut Reader<'_>) {
        let first = r.byte();
        let mut named = [Ranked::Own; ServiceOrder::LEVELS];
        let count = usize::from(first & LEVELS).min(named.len());
        for ranked in named.iter_mut().take(count) {
            let (kind, of) = (r.byte(), u16::from(r.byte()));
            *ranked = match kind {
                0 => Ranked::Port(PortId(of)),
                1 => Ranked::Source(TaskId(of)),
                2 => Ranked::Timers,
                4 => Ranked::Timer(TimeId(u8::try_from(of).unwrap_or(0))),
                _ => Ranked::Own,
            };
        }
        self.order = ServiceOrder::new(&named[..count]).unwrap_or_default();
        self.capped_last = first & CAPPED != 0;
        self.depth = if first & HANDLERS != 0 { r.byte().min(u8::try_from(DEPTH).unwrap_or(0)) } else { 0 };
        for i in 0..=usize::from(self.depth) {
            let mut level = Level { pending: load_pending(r), ..Level::NEW };
            if i > 0 {
                let byte = r.byte();
                (level.rank, level.atomic) = (byte & LEVELS, byte & ATOMIC != 0);
            } else {
                level.atomic = first & ATOMIC != 0;
            }
            if i < usize::from(self.depth) {
                level.finished = load_finished(r);
            }
            self.levels[i] = level;
        }
        self.timers = Timers::default();
        if first & TIMERS != 0 {
            let count = usize::from(r.byte());
            for slot in self.timers.0.iter_mut().take(count) {
                *slot = Some(Started { id: TimeId(r.byte()), turn: 0, ended: r.byte() == 1 });
            }
        }
    }
}

fn load_pending(r: &mut Reader<'_>) -> Pending {
    let at = |byte: u8| byte.checked_sub(1).map(u16::from);
    match r.byte() {
        1 => Pending::Get {
            port: at(r.byte()).map(PortId),
            source: at(r.byte()).map(TaskId),
            deadline: r.left(),
        },
        2 => Pending::Delay(TimeId(r.byte()), 0),
        3 => Pending::Work,
        4 => Pending::Boundary,
        5 => Pending::Lease,
        0 | 6..DESKS => Pending::Nothing,
        code @ DESKS..MEETINGS => Pending::Reply(u16::from(code - DESKS)),
        code @ MEETINGS.. => Pending::Meeting(u16::from(code - MEETINGS)),
    }
}

fn store_finished(
    finished: Option<&Finished>,
    frame: &Frame<'_>,
    w: &mut Writer<'_>,
) -> Result<(), Overflow> {
    match finished {
        None => w.byte(0),
        Some(Finished::Outcome(outcome)) => match outcome {
            Outcome::Refused => w.byte(1),
            Outcome::TimedOutUnsent => w.byte(2),
            Outcome::TimedOutUnknown => w.byte(3),
            Outcome::PeerRestarted => w.byte(4),
            Outcome::Reply(contents) => {
                w.byte(5)?;
                w.contents(contents)
            }
        },
        Some(Finished::Answers(desk)) => {
            w.byte(6)?;
            w.count(usize::from(*desk))
        }
        Some(Finished::Released { port, round, by }) => {
            w.byte(7)?;
            w.count(port.index())?;
            w.byte(frame.round(*port, *round)?)?;
            w.count(match by {
                ReleasedBy::AllArrived => 0,
                ReleasedBy::Confirm(task) => task.index() + 1,
            })
        }
        Some(Finished::GaveUp { port, round, missing }) => {
            w.byte(8)?;
            w.count(port.index())?;
            w.byte(frame.round(*port, *round)?)?;
            missing.to_le_bytes().iter().try_for_each(|&byte| w.byte(byte))
        }
        Some(Finished::TimeOut(id)) => {
            w.byte(9)?;
            w.byte(id.0)
        }
        Some(Finished::Granted(epoch)) => {
            w.byte(10)?;
            w.byte(*epoch)
        }
        Some(Finished::Long(desk)) => {
            w.byte(11)?;
            w.count(usize::from(*desk))
        }
    }
}

fn load_finished(r: &mut Reader<'_>) -> Option<Finished> {
    Some(match r.byte() {
        1 => Finished::Outcome(Outcome::Refused),
        2 => Finished::Outcome(Outcome::TimedOutUnsent),
        3 => Finished::Outcome(Outcome::TimedOutUnknown),
        4 => Finished::Outcome(Outcome::PeerRestarted),
        5 => Finished::Outcome(Outcome::Reply(r.contents())),
        6 => Finished::Answers(u16::from(r.byte())),
        7 => Finished::Released {
            port: PortId(u16::from(r.byte())),
            round: r.round(),
            by: r
                .byte()
                .checked_sub(1)
                .map_or(ReleasedBy::AllArrived, |task| ReleasedBy::Confirm(TaskId(task.into()))),
        },
        8 => Finished::GaveUp {
            port: PortId(u16::from(r.byte())),
            round: r.round(),
            missing: u64::from_le_bytes(core::array::from_fn(|_| r.byte())),
        },
        9 => Finished::TimeOut(TimeId(r.byte())),
        10 => Finished::Granted(r.byte()),
        11 => Finished::Long(u16::from(r.byte())),
        _ => return None,
    })
}
