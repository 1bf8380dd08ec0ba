//! Visits the activations, the timers and the `order` of a task, for the checker's packed states.

use super::timers::{Started, Timers};
use super::{Activation, DEPTH, Interrupts};
use crate::ids::{PortId, Round, TaskId};
use crate::packet::Contents;
use crate::request::{Outcome, Ranked, ReleasedBy, ServiceOrder, TimeId};
use crate::state::{Walk, mark, same_option, same_variant};
use crate::task::wait::{Finished, Pending};
use crate::ticks::Instant;

/// Layout of the first byte: the number of entries of the `order`, and flags.
const LEVELS: u8 = 0x0f;
const HANDLERS: u8 = 0x10;
const TIMERS: u8 = 0x20;
const ATOMIC: u8 = 0x40;
const CAPPED: u8 = 0x80;

/// The codes of the first request and of the first meeting: the code of a wait is one of these numbers plus the
/// position of the request or meeting. All lower codes are fixed.
const REQUESTS: u8 = 0x10;
const MEETINGS: u8 = 0x80;

const RANKED: [Ranked; 5] = [
    Ranked::Port(PortId(0)),
    Ranked::Source(TaskId(0)),
    Ranked::Timers,
    Ranked::Own,
    Ranked::Timer(TimeId(0)),
];

const FINISHED: [Option<Finished>; 12] = [
    None,
    Some(Finished::Outcome(Outcome::Refused)),
    Some(Finished::Outcome(Outcome::TimedOutUnsent)),
    Some(Finished::Outcome(Outcome::TimedOutUnknown)),
    Some(Finished::Outcome(Outcome::PeerRestarted)),
    Some(Finished::Outcome(Outcome::Reply(Contents::EMPTY))),
    Some(Finished::Answers(0)),
    Some(Finished::Released { port: PortId(0), round: Round(0), by: ReleasedBy::AllArrived }),
    Some(Finished::GaveUp { port: PortId(0), round: Round(0), missing: 0 }),
    Some(Finished::TimeOut(TimeId(0))),
    Some(Finished::Granted(0)),
    Some(Finished::Long(0)),
];

impl Interrupts {
    /// Visits the activations, and the order of service, which shares their first byte.
    pub(in crate::task) fn walk<W: Walk>(&mut self, order: &mut ServiceOrder, couple: Option<u8>, w: &mut W) {
        let Self { running, interrupted, depth, capped_last, next_turn, timers } = self;
        if W::READS {
            // This counter of timer starts is not packed: a single thread drives the task in a checker, so no report of an
            // earlier start of a timer is in flight.
            *next_turn = 0;
        }
        let started = timers.slots.iter().flatten().count();
        let ranks = u8::try_from(order.ranked().len()).unwrap_or(LEVELS);
        let first = w.put(
            ranks
                | mark(*depth > 0, HANDLERS)
                | mark(started > 0, TIMERS)
                | mark(if *depth > 0 { interrupted[0].atomic } else { running.atomic }, ATOMIC)
                | mark(*capped_last, CAPPED),
        );
        if W::PACKS {
            walk_order(order, usize::from(first & LEVELS), w);
        }
        if first & HANDLERS != 0 {
            w.byte(depth);
        }
        if W::READS {
            *capped_last = first & CAPPED != 0;
            let most = u8::try_from(DEPTH).unwrap_or(0);
            *depth = if first & HANDLERS != 0 { (*depth).min(most) } else { 0 };
        }
        let top = usize::from(*depth);
        for (i, activation) in interrupted.iter_mut().take(top).chain([running]).enumerate() {
            if W::READS {
                *activation = Activation { atomic: i == 0 && first & ATOMIC != 0, ..Activation::NEW };
            }
            let Activation { rank, atomic, pending, finished } = activation;
            pending.walk(w);
            if i > 0 {
                let byte = w.put(*rank | mark(*atomic, ATOMIC));
                if W::READS {
                    (*rank, *atomic) = (byte & LEVELS, byte & ATOMIC != 0);
                }
            }
            // The running activation has already got the signal of how its wait ended.
            if i < top {
                walk_finished(finished, couple, w);
            }
        }
        if W::READS {
            *timers = Timers::default();
        }
        if first & TIMERS != 0 && W::PACKS {
            walk_timers(timers, started, w);
        }
    }

    /// Whether an interrupted activation has left a meeting of this port, and has yet to read the members' arguments.
    pub(in crate::task) fn is_unread(&self, port: PortId) -> bool {
        self.threads().any(|activation| match &activation.finished {
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
}

fn walk_order<W: Walk>(order: &mut ServiceOrder, count: usize, w: &mut W) {
    let mut named = [Ranked::Own; ServiceOrder::LEVELS];
    let count = count.min(named.len());
    if !W::READS {
        named[..count].copy_from_slice(order.ranked());
    }
    for ranked in &mut named[..count] {
        w.one_of(&RANKED, ranked, same_variant);
        match ranked {
            Ranked::Port(port) => w.small(&mut port.0),
            Ranked::Source(task) => w.small(&mut task.0),
            Ranked::Timer(id) => w.byte(&mut id.0),
            Ranked::Timers | Ranked::Own => w.byte(&mut 0),
        }
    }
    if W::READS {
        *order = ServiceOrder::new(&named[..count]).unwrap_or_default();
    }
}

/// Visits the timers in the order of their names, because behaviour does not depend on their slots.
fn walk_timers<W: Walk>(timers: &mut Timers, started: usize, w: &mut W) {
    let Timers { slots, ended } = timers;
    let mut sorted: [_; super::TIMERS] = core::array::from_fn(|at| (slots[at], *ended & (1 << at) != 0));
    sorted.sort_unstable_by_key(|(started, _)| started.map_or(u16::MAX, |started| u16::from(started.id.0)));
    let started = w.count(started);
    for (place, over) in sorted.iter_mut().take(started) {
        // `turn` counts the starts of the timer, and is not packed: a single thread drives the task in a checker, so no
        // report of an earlier start of the timer is in flight.
        let Started { id, turn: _ } = place.get_or_insert(Started { id: TimeId(0), turn: 0 });
        w.byte(&mut id.0);
        w.flag(over);
    }
    if W::READS {
        *slots = sorted.map(|(started, _)| started);
        *ended = (0..).zip(sorted).fold(0, |bits, (at, (_, over))| bits | u8::from(over) << at);
    }
}

impl Pending {
    fn walk<W: Walk>(&mut self, w: &mut W) {
        let code = match *self {
            Self::Nothing => 0,
            Self::Get { .. } => 1,
            Self::Delay(..) => 2,
            Self::Work => 3,
            Self::Boundary => 4,
            Self::Lease => 5,
            Self::Reply(request) => usize::from(REQUESTS) + usize::from(request),
            Self::Meeting(meeting) => usize::from(MEETINGS) + usize::from(meeting),
        };
        if matches!(self, Self::Reply(_)) && code >= usize::from(MEETINGS) {
            w.overflows();
        }
        let code = w.count(code);
        if W::READS {
            let code = u8::try_from(code).unwrap_or(0);
            *self = match code {
                1 => Self::Get { port: None, source: None, deadline: Instant::START },
                2 => Self::Delay(TimeId(0), 0),
                3 => Self::Work,
                4 => Self::Boundary,
                5 => Self::Lease,
                0 | 6..REQUESTS => Self::Nothing,
                REQUESTS..MEETINGS => Self::Reply(u16::from(code - REQUESTS)),
                MEETINGS.. => Self::Meeting(u16::from(code - MEETINGS)),
            };
        }
        match self {
            Self::Get { port, source, deadline } => {
                *port = or_none(w, port.map(|port| port.0)).map(PortId);
                *source = or_none(w, source.map(|source| source.0)).map(TaskId);
                w.instant(deadline);
            }
            Self::Delay(id, _) => w.byte(&mut id.0),
            // The number `code` alone determines these waits.
            Self::Nothing | Self::Work | Self::Boundary | Self::Lease | Self::Reply(_) | Self::Meeting(_) => {
            }
        }
    }
}

/// Visits a number plus one, or zero for `None`.
fn or_none<W: Walk>(w: &mut W, number: Option<u16>) -> Option<u16> {
    let read = w.count(number.map_or(0, |number| usize::from(number) + 1));
    u16::try_from(read).ok()?.checked_sub(1)
}

fn walk_finished<W: Walk>(finished: &mut Option<Finished>, couple: Option<u8>, w: &mut W) {
    let outcome = |a: &Option<Finished>| if let Some(Finished::Outcome(of)) = a { Some(*of) } else { None };
    w.one_of(&FINISHED, finished, |a, b| match (outcome(a), outcome(b)) {
        (Some(a), Some(b)) => same_variant(&a, &b),
        (None, None) => same_option(a, b),
        (Some(_), None) | (None, Some(_)) => false,
    });
    match finished {
        Some(Finished::Outcome(Outcome::Reply(contents))) => w.contents(contents),
        Some(Finished::Answers(request) | Finished::Long(request)) => w.small(request),
        Some(Finished::Released { port, round, by }) => {
            w.small(&mut port.0);
            w.round(*port, round);
            let task = match by {
                ReleasedBy::AllArrived => None,
                ReleasedBy::Confirm(task) => Some(task.0),
            };
            *by = or_none(w, task).map_or(ReleasedBy::AllArrived, |task| ReleasedBy::Confirm(TaskId(task)));
        }
        Some(Finished::GaveUp { port, round, missing }) => {
            w.small(&mut port.0);
            w.round(*port, round);
            w.long(missing);
        }
        Some(Finished::TimeOut(id)) => w.byte(&mut id.0),
        Some(Finished::Granted(epoch)) => match couple {
            Some(couple) => w.epoch(couple, epoch),
            None => w.byte(epoch),
        },
        Some(Finished::Outcome(
            Outcome::Refused | Outcome::TimedOutUnsent | Outcome::TimedOutUnknown | Outcome::PeerRestarted,
        ))
        | None => {}
    }
}
