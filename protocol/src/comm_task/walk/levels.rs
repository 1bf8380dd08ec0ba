//! A task's threads, its timers and its `order`.

use super::{name_port, number};
use crate::comm_task::Pending;
use crate::comm_task::levels::{DEPTH, Finished, Level};
use crate::comm_task::timers::{Started, Timers};
use crate::ids::{PortId, Round, TaskId};
use crate::packet::Contents;
use crate::request::{Outcome, Ranked, ReleasedBy, ServiceOrder, TimeId};
use crate::state::Walk;
use crate::ticks::Ticks;

/// The codes of waits below these name themselves; from them on they count desks and meetings.
const DESKS: u8 = 0x10;
const MEETINGS: u8 = 0x80;

/// The threads of a task with what ranks them.
pub(super) fn walk<W: Walk>(
    (order, capped_last, timers): (&mut ServiceOrder, &mut bool, &mut Timers),
    (depth, levels): (&mut u8, &mut [Level]),
    couple: Option<u8>,
    w: &mut W,
) {
    w.align();
    let count = w.bits(4, u8::try_from(order.ranked().len()).unwrap_or(u8::MAX));
    let handlers = w.flag(*depth > 0);
    let some_timers = w.flag(timers.0.iter().any(Option::is_some));
    w.bit(&mut levels[0].atomic);
    w.bit(capped_last);
    w.align();
    if count > 0 {
        walk_order(order, usize::from(count), w);
    } else {
        w.left_out(order, ServiceOrder::default);
    }
    if handlers {
        w.byte(depth);
        *depth = (*depth).min(u8::try_from(DEPTH).unwrap_or(0));
    } else {
        w.left_out(depth, || 0);
    }
    for (i, level) in levels.iter_mut().enumerate().take(usize::from(*depth) + 1) {
        level.walk((i > 0, i < usize::from(*depth)), couple, w);
    }
    timers.walk(some_timers, w);
}

/// So many levels of an `order`.
fn walk_order<W: Walk>(order: &mut ServiceOrder, count: usize, w: &mut W) {
    let mut named = [Ranked::Own; ServiceOrder::LEVELS];
    named.iter_mut().zip(order.ranked()).for_each(|(named, ranked)| *named = *ranked);
    let count = count.min(named.len());
    named.iter_mut().take(count).for_each(|named| ranked(named, w));
    w.left_out(order, || ServiceOrder::new(&named[..count]).unwrap_or_default());
}

/// Whether a thread that a handler interrupts left a meeting of this port: it has not read yet what the others brought.
pub(super) fn is_unread(running: &[Level], port: PortId) -> bool {
    running.iter().any(|level| match &level.finished {
        Some(Finished::Released { port: of, .. } | Finished::GaveUp { port: of, .. }) => *of == port,
        Some(
            Finished::Outcome(_)
            | Finished::Answers(_)
            | Finished::Long(_)
            | Finished::TimeOut(_)
            | Finished::Granted(_),
        )
        | None => false,
    })
}

/// One level of an `order`: what it is, and of which number.
fn ranked<W: Walk>(ranked: &mut Ranked, w: &mut W) {
    let (kind, of) = match *ranked {
        Ranked::Port(port) => (0, port.0),
        Ranked::Source(task) => (1, task.0),
        Ranked::Timers => (2, 0),
        Ranked::Own => (3, 0),
        Ranked::Timer(id) => (4, u16::from(id.0)),
    };
    let kind = w.code(kind);
    let of = number(w, of);
    if W::LOADS {
        *ranked = match kind {
            0 => Ranked::Port(PortId(of)),
            1 => Ranked::Source(TaskId(of)),
            2 => Ranked::Timers,
            4 => Ranked::Timer(TimeId(u8::try_from(of).unwrap_or(0))),
            _ => Ranked::Own,
        };
    }
}

impl Level {
    /// A handler, or the task's thread: that has no rank of its own, and its `atomic` stands with the `order`.
    fn walk<W: Walk>(&mut self, (is_handler, is_interrupted): (bool, bool), couple: Option<u8>, w: &mut W) {
        let Self { rank, atomic, pending, finished } = self;
        pending.walk(w);
        w.align();
        if is_handler {
            *rank = w.bits(4, *rank);
            // Two bits stand for nothing.
            w.bits(2, 0);
            w.bit(atomic);
        } else {
            w.left_out(rank, || Self::NEW.rank);
        }
        w.align();
        if is_interrupted {
            walk_finished(finished, couple, w);
        } else {
            w.left_out(finished, || None);
        }
    }
}

impl Pending {
    fn code(&self) -> Option<u8> {
        let place =
            |base: u8, at: u16, end: u16| u8::try_from(at).ok().filter(|_| at < end).map(|at| base + at);
        match self {
            Self::Nothing => Some(0),
            Self::Get { .. } => Some(1),
            Self::Delay(..) => Some(2),
            Self::Work => Some(3),
            Self::Boundary => Some(4),
            Self::Lease => Some(5),
            Self::Reply(desk) => place(DESKS, *desk, u16::from(MEETINGS - DESKS)),
            Self::Meeting(meeting) => place(MEETINGS, *meeting, u16::from(MEETINGS)),
        }
    }

    fn blank(code: u8) -> Self {
        match code {
            1 => Self::Get { port: None, source: None, deadline: Ticks::ZERO },
            2 => Self::Delay(TimeId(0), 0),
            3 => Self::Work,
            4 => Self::Boundary,
            5 => Self::Lease,
            0 | 6..DESKS => Self::Nothing,
            DESKS..MEETINGS => Self::Reply(u16::from(code - DESKS)),
            MEETINGS.. => Self::Meeting(u16::from(code - MEETINGS)),
        }
    }

    fn walk<W: Walk>(&mut self, w: &mut W) {
        let code = self.code().unwrap_or_else(|| {
            w.fail();
            0
        });
        let code = w.code(code);
        if W::LOADS {
            *self = Self::blank(code);
        }
        match self {
            Self::Get { port, source, deadline } => {
                *port = w.maybe(port.map(|port| port.0)).map(PortId);
                *source = w.maybe(source.map(|source| source.0)).map(TaskId);
                w.instant(deadline);
            }
            // Which start of it: see the turns of a task.
            Self::Delay(id, _) => w.byte(&mut id.0),
            Self::Nothing | Self::Work | Self::Boundary | Self::Lease | Self::Reply(_) | Self::Meeting(_) => {
            }
        }
    }
}

/// How a wait ended.
fn walk_finished<W: Walk>(finished: &mut Option<Finished>, couple: Option<u8>, w: &mut W) {
    let code = w.code(finished.as_ref().map_or(0, Finished::code));
    if W::LOADS {
        *finished = Finished::blank(code);
    }
    match finished {
        None => {}
        Some(Finished::Outcome(outcome)) => match outcome {
            Outcome::Reply(contents) => w.contents(contents),
            Outcome::Refused
            | Outcome::TimedOutUnsent
            | Outcome::TimedOutUnknown
            | Outcome::PeerRestarted => {}
        },
        Some(Finished::Answers(desk) | Finished::Long(desk)) => *desk = number(w, *desk),
        Some(Finished::Released { port, round, by }) => {
            name_port(port, w);
            w.round(*port, round);
            let task = match by {
                ReleasedBy::AllArrived => None,
                ReleasedBy::Confirm(task) => Some(task.0),
            };
            *by = w.maybe(task).map_or(ReleasedBy::AllArrived, |task| ReleasedBy::Confirm(TaskId(task)));
        }
        Some(Finished::GaveUp { port, round, missing }) => {
            name_port(port, w);
            w.round(*port, round);
            *missing = w.long(*missing);
        }
        Some(Finished::TimeOut(id)) => w.byte(&mut id.0),
        Some(Finished::Granted(epoch)) => w.epoch(couple.unwrap_or(u8::MAX), epoch),
    }
}

impl Finished {
    const fn code(&self) -> u8 {
        match self {
            Self::Outcome(Outcome::Refused) => 1,
            Self::Outcome(Outcome::TimedOutUnsent) => 2,
            Self::Outcome(Outcome::TimedOutUnknown) => 3,
            Self::Outcome(Outcome::PeerRestarted) => 4,
            Self::Outcome(Outcome::Reply(_)) => 5,
            Self::Answers(_) => 6,
            Self::Released { .. } => 7,
            Self::GaveUp { .. } => 8,
            Self::TimeOut(_) => 9,
            Self::Granted(_) => 10,
            Self::Long(_) => 11,
        }
    }

    fn blank(code: u8) -> Option<Self> {
        let (port, round) = (PortId(0), Round::default());
        Some(match code {
            1 => Self::Outcome(Outcome::Refused),
            2 => Self::Outcome(Outcome::TimedOutUnsent),
            3 => Self::Outcome(Outcome::TimedOutUnknown),
            4 => Self::Outcome(Outcome::PeerRestarted),
            5 => Self::Outcome(Outcome::Reply(Contents::EMPTY)),
            6 => Self::Answers(0),
            7 => Self::Released { port, round, by: ReleasedBy::AllArrived },
            8 => Self::GaveUp { port, round, missing: 0 },
            9 => Self::TimeOut(TimeId(0)),
            10 => Self::Granted(0),
            11 => Self::Long(0),
            _ => return None,
        })
    }
}

impl Timers {
    /// In the order of their names: where they stand does not matter.
    fn walk<W: Walk>(&mut self, some: bool, w: &mut W) {
        if !some {
            return w.left_out(self, Self::default);
        }
        let mut sorted = self.0;
        sorted.sort_unstable_by_key(|slot| slot.map_or(u16::MAX, |started| u16::from(started.id.0)));
        let count = w.count(sorted.iter().flatten().count());
        if W::LOADS {
            let blank = Some(Started { id: TimeId(0), turn: 0, ended: false });
            sorted = Self::default().0;
            sorted.iter_mut().take(count).for_each(|slot| *slot = blank);
        }
        // Which start of it: see the turns of a task.
        for Started { id, turn: _, ended } in sorted.iter_mut().flatten() {
            w.byte(&mut id.0);
            *ended = w.code(u8::from(*ended)) == 1;
        }
        if W::LOADS {
            self.0 = sorted;
        }
    }
}
