//! The packed form of a port's receiving end.

use super::{CommTask, Frame, Overflow, Reader, Writer, load_id, store_id};
use crate::comm_task::fragments::Parts;
use crate::comm_task::inbox::{Aged, Held, Inbox};
use crate::comm_task::memory::{Fate, Memory, Remembered, Window};
use crate::ids::{MessageId, TaskId};
use crate::packet::Class;
use crate::table::{NodeTable, Port};
use crate::ticks::Ticks;

/// The first byte of an inbox: how many messages wait, and what else there is.
const WAITING: u8 = 0x3f;
const BYPASSED: u8 = 0x40;
const HANDLED: u8 = 0x80;

/// What is said of a waiting message.
const STATUS: u8 = 1;
const REJECTED: u8 = 2;
const LATER: u8 = 4;

/// What the port's declaration leaves out of the bytes.
#[derive(Clone, Copy)]
struct Form {
    class: Class,
    long: bool,
    long_answers: bool,
    ranks_arrivals: bool,
}

impl Form {
    fn of(table: &NodeTable, inbox: &Inbox) -> Self {
        table.port(inbox.port).map_or(
            Self { class: Class::Status, long: false, long_answers: false, ranks_arrivals: false },
            |port| Self {
                class: port.decl.class,
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

impl CommTask {
    pub(super) fn store_inbox(
        &self,
        table: &NodeTable,
        inbox: &Inbox,
        frame: &Frame<'_>,
        w: &mut Writer<'_>,
    ) -> Result<(), Overflow> {
        let form = Form::of(table, inbox);
        let waiting = u8::try_from(inbox.queue.len()).ok().filter(|&len| len <= WAITING).ok_or(Overflow)?;
        let flag = |set: bool, bit: u8| if set { bit } else { 0 };
        let bypassed = inbox.bypassed(self.served);
        w.byte(waiting | flag(bypassed > 0, BYPASSED) | flag(inbox.handled, HANDLED))?;
        if bypassed > 0 {
            w.count(usize::from(bypassed))?;
        }
        for (slot, held) in inbox.queue.sorted() {
            self.store_held(held, inbox.queue.side(slot), frame, w)?;
            if form.ranks_arrivals {
                let before = |other: &Held| other.source == held.source && other.arrival < held.arrival;
                w.count(inbox.queue.iter().filter(|(_, other)| before(other)).count())?;
            }
            if form.long {
                w.byte(held.fragments)?;
                if let Some(body) = inbox.body(slot).filter(|_| held.fragments > 1) {
                    body.store(w)?;
                }
            }
        }
        (0..inbox.sources.len()).try_for_each(|at| self.store_source((inbox, at), form, frame, w))
    }

    fn store_held(
        &self,
        held: &Held,
        aged: Aged,
        frame: &Frame<'_>,
        w: &mut Writer<'_>,
    ) -> Result<(), Overflow> {
        let flag = |set: bool, bit: u8| if set { bit } else { 0 };
        w.count(held.source.index())?;
        store_id(held.source, held.id(), frame, w)?;
        let (rejected, later) = (aged.rejections > 0, aged.not_before > self.now);
        w.byte(flag(held.class == Class::Status, STATUS) | flag(rejected, REJECTED) | flag(later, LATER))?;
        w.left(held.expires, self.now)?;
        w.contents(&held.contents)?;
        if rejected {
            w.byte(aged.rejections)?;
            // Only the order of first rejections matters: their place among those of all that waits.
            let queues = self.inboxes.iter().map(|inbox| &inbox.queue);
            let all = queues.flat_map(|queue| queue.iter().map(|(slot, _)| queue.side(slot)));
            let before = all.filter(|a| a.rejections > 0 && a.rejected_first < aged.rejected_first);
            w.count(before.count())?;
        }
        if later {
            w.left(aged.not_before, self.now)?;
        }
        Ok(())
    }

    fn store_source(
        &self,
        (inbox, at): (&Inbox, usize),
        form: Form,
        frame: &Frame<'_>,
        w: &mut Writer<'_>,
    ) -> Result<(), Overflow> {
        let source = &inbox.sources[at];
        match &source.memory {
            Memory::Command(command) => {
                self.store_command((source.task, command.as_ref()), inbox.answer(at), form, frame, w)?;
            }
            Memory::Status(window) => match window.newest {
                None => w.byte(0)?,
                Some(newest) => {
                    w.byte(1)?;
                    w.byte(frame.sequence(source.task, newest)?)?;
                    w.left(window.until, self.now)?;
                    window.seen.to_le_bytes().iter().try_for_each(|&byte| w.byte(byte))?;
                }
            },
        }
        if !form.long {
            return Ok(());
        }
        let Some(assembly) = inbox.assembly(at).filter(|assembly| assembly.is_open()) else {
            return w.word(0);
        };
        assembly.store(w)?;
        store_id(source.task, assembly.id, frame, w)?;
        w.left(assembly.expires, self.now)
    }

    fn store_command(
        &self,
        (task, command): (TaskId, Option<&Remembered>),
        answer: Option<&Parts>,
        form: Form,
        frame: &Frame<'_>,
        w: &mut Writer<'_>,
    ) -> Result<(), Overflow> {
        let Some(c) = command else { return w.byte(0) };
        w.byte(match c.fate {
            Fate::Held => 1,
            Fate::Delivered(_) => 2,
            Fate::Refused => 3,
            Fate::Answered(_) => 4,
            Fate::Lapsed => 5,
        })?;
        store_id(task, c.id, frame, w)?;
        w.left(c.sender_until, self.now)?;
        w.left(c.until, self.now)?;
        match &c.fate {
            Fate::Delivered(budget_ends) => w.left(*budget_ends, self.now),
            Fate::Answered(contents) => {
                w.contents(contents)?;
                answer.filter(|_| form.long_answers).map_or(Ok(()), |answer| answer.store(w))
            }
            Fate::Held | Fate::Lapsed | Fate::Refused => Ok(()),
        }
    }

    pub(super) fn load_inbox(&mut self, table: &NodeTable, i: usize, lives: bool, r: &mut Reader<'_>) {
        let form = Form::of(table, &self.inboxes[i]);
        let inbox = &mut self.inboxes[i];
        let first = r.byte();
        inbox.handled = first & HANDLED != 0;
        let bypassed = if first & BYPASSED != 0 { u64::from(r.byte()) } else { 0 };
        inbox.since = if inbox.handled { bypassed } else { self.served - bypassed };
        inbox.queue.clear();
        if inbox.handled {
            inbox.queue.watch();
        }
        for _ in 0..first & WAITING {
            let (mut held, aged) = load_held(r, lives);
            if aged.rejections > 0 {
                self.rejections = self.rejections.max(aged.rejected_first + 1);
            }
            if aged != Aged::default() {
                inbox.queue.watch();
            }
            held.arrival = if form.ranks_arrivals { u64::from(r.byte()) } else { self.arrivals };
            if form.long {
                held.fragments = r.byte();
            }
            let pushed = inbox.queue.push_with(held, aged);
            if let Ok(slot) = pushed
                && let Some(body) = inbox.body_mut(slot)
            {
                body.clear();
                if held.fragments > 1 {
                    body.load(r);
                }
            }
            self.arrivals += 1;
        }
        for at in 0..inbox.sources.len() {
            load_source((inbox, at), form, lives, r);
        }
    }
}

fn load_held(r: &mut Reader<'_>, lives: bool) -> (Held, Aged) {
    let source = TaskId(u16::from(r.byte()));
    let MessageId { incarnation, sequence } = load_id(r, lives);
    let flags = r.byte();
    let class = if flags & STATUS != 0 { Class::Status } else { Class::Command };
    let (expires, contents) = (r.left(), r.contents());
    let (mut rejections, mut rejected_first) = (0, 0);
    if flags & REJECTED != 0 {
        (rejections, rejected_first) = (r.byte(), 1 + u64::from(r.byte()));
    }
    let not_before = if flags & LATER != 0 { r.left() } else { Ticks::ZERO };
    let held = Held { source, incarnation, sequence, class, expires, contents, fragments: 1, arrival: 0 };
    (held, Aged { rejections, rejected_first, not_before })
}

fn load_source((inbox, at): (&mut Inbox, usize), form: Form, lives: bool, r: &mut Reader<'_>) {
    inbox.forget(at);
    if let Some(answer) = inbox.answer_mut(at) {
        answer.clear();
    }
    match form.class {
        Class::Command => {
            let command = load_command(inbox.answer_mut(at), form, lives, r);
            inbox.sources[at].remember(command);
        }
        Class::Status => {
            if r.byte() != 0 {
                let newest = Some(r.sequence());
                let until = r.left();
                let seen = u64::from_le_bytes(core::array::from_fn(|_| r.byte()));
                inbox.sources[at].memory = Memory::Status(Window { newest, seen, until });
            }
        }
    }
    if form.long {
        let have = r.word();
        if let Some(assembly) = inbox.assembly_mut(at).filter(|_| have != 0) {
            assembly.load(have, r);
            (assembly.id, assembly.expires) = (load_id(r, lives), r.left());
        }
    }
}

fn load_command(
    answer: Option<&mut Parts>,
    form: Form,
    lives: bool,
    r: &mut Reader<'_>,
) -> Option<Remembered> {
    let fate = r.byte();
    if fate == 0 {
        return None;
    }
    let id = load_id(r, lives);
    let (sender_until, until) = (r.left(), r.left());
    let fate = match fate {
        1 => Fate::Held,
        2 => Fate::Delivered(r.left()),
        3 => Fate::Refused,
        5 => Fate::Lapsed,
        _ => {
            let contents = r.contents();
            if let Some(answer) = answer.filter(|_| form.long_answers) {
                answer.load(r);
            }
            Fate::Answered(contents)
        }
    };
    Some(Remembered { id, fate, sender_until, until })
}
