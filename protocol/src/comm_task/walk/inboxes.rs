//! The receiving end of a port.

use super::name_task;
use crate::comm_task::fragments::{Assembly, Parts};
use crate::comm_task::inbox::{Aged, Held, Inbox, Long};
use crate::comm_task::memory::{Fate, Memory, Remembered, Source, Window};
use crate::ids::{Incarnation, MessageId, Seq24, TaskId};
use crate::packet::{Class, Contents};
use crate::queue::{Queue, Slot};
use crate::state::Walk;
use crate::table::{NodeTable, Port};
use crate::ticks::Ticks;
use alloc::vec::Vec;

/// What the port's declaration leaves out.
#[derive(Clone, Copy)]
pub(super) struct Form {
    long: bool,
    long_answers: bool,
    ranks_arrivals: bool,
}

impl Form {
    /// Nothing is left out where there is no table.
    pub fn of(table: Option<&NodeTable>, inbox: &Inbox) -> Self {
        let Some(table) = table else { return Self { long: true, long_answers: true, ranks_arrivals: true } };
        table.port(inbox.port).map_or(
            Self { long: false, long_answers: false, ranks_arrivals: false },
            |port| Self {
                long: port.decl.fragments > 1,
                long_answers: port.decl.answer_fragments > 1,
                ranks_arrivals: arrival_matters(table, port),
            },
        )
    }
}

/// Whether the order in which messages of one source arrived can matter once they wait: where the life of one that waits
/// may become longer, it may become that of another, and then the earlier arrival goes first. The literal penalty (D4)
/// lengthens lives, and so do copies of commands. But a copy does so only while the command is remembered, and where waiting
/// costs life a remembered one waits alone: the next command of its source takes its place (D12).
fn arrival_matters(table: &NodeTable, port: &Port) -> bool {
    port.decl.lengthens_lives() || (port.decl.class == Class::Command && !table.rules().charge_residence)
}

/// What is counted over all ports.
pub(super) struct Counts<'a> {
    arrivals: &'a mut u64,
    rejections: &'a mut u64,
    served: &'a u64,
    /// The first rejections of all that waits and was rejected, ascending: only their order matters.
    first: Vec<u64>,
}

impl<'a> Counts<'a> {
    pub fn new<W: Walk>(
        inboxes: &[Inbox],
        (arrivals, rejections, served): (&'a mut u64, &'a mut u64, &'a mut u64),
        w: &mut W,
    ) -> Self {
        w.left_out(arrivals, || 0);
        w.left_out(rejections, || 1);
        // As if that many had been served: no port was passed over more often.
        w.left_out(served, || u64::from(u8::MAX));
        let mut first = Vec::new();
        if W::WRITES && *rejections > 1 {
            let queues = inboxes.iter().map(|inbox| &inbox.queue);
            let all = queues.flat_map(|queue| queue.iter().map(|(slot, _)| queue.side(slot)));
            first.extend(all.filter(|aged| aged.rejections > 0).map(|aged| aged.rejected_first));
            first.sort_unstable();
        }
        Self { arrivals, rejections, served, first }
    }
}

impl Inbox {
    pub(super) fn walk<W: Walk>(&mut self, form: Form, now: Ticks, counts: &mut Counts<'_>, w: &mut W) {
        let bypassed = self.bypassed(*counts.served);
        let Self { port: _, local: _, queue, handled, latest: _, since, sources, long } = self;
        w.align();
        let waiting = w.bits(6, u8::try_from(queue.len()).unwrap_or(u8::MAX));
        let passed_over = w.flag(bypassed > 0);
        w.bit(handled);
        let bypassed = if passed_over { w.count(usize::from(bypassed)) as u64 } else { 0 };
        w.left_out(since, || if *handled { bypassed } else { *counts.served - bypassed });
        walk_queue((queue, long.as_deref_mut()), (waiting, *handled), (form, now), counts, w);
        for (at, source) in sources.iter_mut().enumerate() {
            source.walk(long.as_deref_mut().and_then(|long| long.answer_mut(at)), form, w);
            if form.long {
                walk_assembly(
                    long.as_deref_mut().and_then(|long| long.assemblies.get_mut(at)),
                    source.task,
                    w,
                );
            }
        }
    }
}

/// The messages that wait, the most urgent first: in which slot one waits does not matter.
fn walk_queue<W: Walk>(
    (queue, mut long): (&mut Queue<Held>, Option<&mut Long>),
    (waiting, handled): (u8, bool),
    (form, now): (Form, Ticks),
    counts: &mut Counts<'_>,
    w: &mut W,
) {
    let mut body = |slot: Slot, held: &Held, w: &mut W| {
        if let Some(body) = long.as_mut().and_then(|long| long.body_mut(slot)) {
            if W::LOADS {
                body.clear();
            }
            if form.long && held.fragments > 1 {
                body.walk(w);
            }
        }
    };
    if W::LOADS {
        queue.clear();
        if handled {
            queue.watch();
        }
        for _ in 0..waiting {
            let (mut held, mut aged) = (Held::BLANK, Aged::default());
            held.walk(&mut aged, 0, (form, now), counts, w);
            *counts.arrivals += 1;
            if aged != Aged::default() {
                queue.watch();
            }
            if let Ok(slot) = queue.push_with(held, aged) {
                body(slot, &held, w);
            }
        }
    } else if W::CHANGES {
        queue.change_all(|held, aged| held.walk(aged, 0, (form, now), counts, w));
    } else if W::WRITES {
        for (slot, held) in queue.sorted() {
            let before =
                |(_, other): &(Slot, &Held)| other.source == held.source && other.arrival < held.arrival;
            let earlier = if form.ranks_arrivals { queue.iter().filter(before).count() } else { 0 };
            let mut held = *held;
            held.walk(&mut queue.side(slot), earlier, (form, now), counts, w);
            body(slot, &held, w);
        }
    } else {
        for (slot, held) in queue.iter() {
            let mut held = *held;
            held.walk(&mut queue.side(slot), 0, (form, now), counts, w);
        }
    }
}

impl Held {
    const BLANK: Self = Self {
        source: TaskId(0),
        incarnation: Incarnation(0),
        sequence: Seq24::new(0),
        class: Class::Command,
        expires: Ticks::ZERO,
        contents: Contents::EMPTY,
        fragments: 1,
        arrival: 0,
    };

    /// `earlier` messages of its source came before it and wait as well.
    fn walk<W: Walk>(
        &mut self,
        aged: &mut Aged,
        earlier: usize,
        (form, now): (Form, Ticks),
        counts: &mut Counts<'_>,
        w: &mut W,
    ) {
        let Self { source, incarnation, sequence, class, expires, contents, fragments, arrival } = self;
        let Aged { rejections, rejected_first, not_before } = aged;
        name_task(source, w);
        w.life(incarnation);
        w.sequence(*source, sequence);
        w.align();
        let status = w.flag(*class == Class::Status);
        w.left_out(class, || if status { Class::Status } else { Class::Command });
        let rejected = w.flag(*rejections > 0);
        let later = w.flag(*not_before > now);
        w.instant(expires);
        w.contents(contents);
        if rejected {
            w.byte(rejections);
            let rank = w.count(counts.first.partition_point(|first| *first < *rejected_first));
            w.left_out(rejected_first, || 1 + rank as u64);
            if W::LOADS {
                *counts.rejections = (*counts.rejections).max(*rejected_first + 1);
            }
        }
        if later {
            w.instant(not_before);
        } else {
            w.derived(not_before, || Ticks::ZERO);
        }
        if form.ranks_arrivals {
            let earlier = w.count(earlier) as u64;
            w.left_out(arrival, || earlier);
        } else {
            w.left_out(arrival, || *counts.arrivals);
        }
        if form.long {
            w.byte(fragments);
        }
    }
}

impl Source {
    /// What is remembered of it, with its answer after the first packet.
    fn walk<W: Walk>(&mut self, mut answer: Option<&mut Parts>, form: Form, w: &mut W) {
        let Self { task, memory } = self;
        if W::LOADS
            && let Some(answer) = &mut answer
        {
            answer.clear();
        }
        match memory {
            Memory::Command(command) => {
                let code = w.code(command.as_ref().map_or(0, |command| command.fate.code()));
                if W::LOADS {
                    *command = Fate::blank(code).map(Remembered::blank);
                }
                let Some(Remembered { id, fate, sender_until, until }) = command else { return };
                w.id(*task, id);
                w.instant(sender_until);
                w.instant(until);
                match fate {
                    Fate::Delivered(budget_ends) => w.instant(budget_ends),
                    Fate::Answered(contents) => {
                        w.contents(contents);
                        if let Some(answer) = answer.filter(|_| form.long_answers) {
                            answer.walk(w);
                        }
                    }
                    Fate::Held | Fate::Lapsed | Fate::Refused => {}
                }
            }
            Memory::Status(Window { newest, seen, until }) => {
                let some = w.code(u8::from(newest.is_some())) != 0;
                if W::LOADS {
                    (*newest, *seen, *until) = (some.then(Seq24::default), 0, Ticks::ZERO);
                }
                if let Some(newest) = newest {
                    w.sequence(*task, newest);
                    w.instant(until);
                    *seen = w.long(*seen);
                }
            }
        }
    }
}

impl Remembered {
    const fn blank(fate: Fate) -> Self {
        let id = MessageId { incarnation: Incarnation(0), sequence: Seq24::new(0) };
        Self { id, fate, sender_until: Ticks::ZERO, until: Ticks::ZERO }
    }
}

impl Fate {
    const fn code(&self) -> u8 {
        match self {
            Self::Held => 1,
            Self::Delivered(_) => 2,
            Self::Refused => 3,
            Self::Answered(_) => 4,
            Self::Lapsed => 5,
        }
    }

    const fn blank(code: u8) -> Option<Self> {
        Some(match code {
            0 => return None,
            1 => Self::Held,
            2 => Self::Delivered(Ticks::ZERO),
            3 => Self::Refused,
            5 => Self::Lapsed,
            _ => Self::Answered(Contents::EMPTY),
        })
    }
}

/// A message that is not whole yet.
fn walk_assembly<W: Walk>(assembly: Option<&mut Assembly>, source: TaskId, w: &mut W) {
    let Some(assembly) = assembly else {
        w.word(0);
        return;
    };
    assembly.have = w.word(assembly.have);
    if assembly.is_open() {
        assembly.walk_fragments(w);
        w.id(source, &mut assembly.id);
        w.instant(&mut assembly.expires);
    }
}
