//! The packed form of a port's receiving end.

use super::{CommTask, Frame, Overflow, Reader, Writer, load_id, store_id};
use crate::comm_task::inbox::{Aged, Held, Inbox};
use crate::comm_task::memory::{Fate, Remembered, Source, Window};
use crate::ids::TaskId;
use crate::packet::Class;
use crate::table::NodeTable;
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
}

impl Form {
    fn of(table: &NodeTable, inbox: &Inbox) -> Self {
        table.port(inbox.port).map_or(
            Self { class: Class::Status, long: false, long_answers: false },
            |port| Self {
                class: port.decl.class,
                long: port.decl.fragments > 1,
                long_answers: port.decl.answer_fragments > 1,
            },
        )
    }
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
            if form.long {
                w.byte(held.fragments)?;
                if let Some(body) = inbox.bodies.get(usize::from(slot)).filter(|_| held.fragments > 1) {
                    body.store(w)?;
                }
            }
        }
        inbox.sources.iter().try_for_each(|source| self.store_source(source, form, frame, w))
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
        store_id(held.source, held.id, frame, w)?;
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
        source: &Source,
        form: Form,
        frame: &Frame<'_>,
        w: &mut Writer<'_>,
    ) -> Result<(), Overflow> {
        match form.class {
            Class::Command => self.store_command(source, form, frame, w)?,
            Class::Status => match source.status.newest {
                None => w.byte(0)?,
                Some(newest) => {
                    w.byte(1)?;
                    w.byte(frame.sequence(source.task, newest)?)?;
                    w.left(source.status.until, self.now)?;
                    source.status.seen.to_le_bytes().iter().try_for_each(|&byte| w.byte(byte))?;
                }
            },
        }
        if !form.long {
            return Ok(());
        }
        if !source.assembly.is_open() {
            return w.word(0);
        }
        source.assembly.store(w)?;
        store_id(source.task, source.assembly.id, frame, w)?;
        w.left(source.assembly.expires, self.now)
    }

    fn store_command(
        &self,
        source: &Source,
        form: Form,
        frame: &Frame<'_>,
        w: &mut Writer<'_>,
    ) -> Result<(), Overflow> {
        let Some(c) = &source.command else { return w.byte(0) };
        w.byte(match c.fate {
            Fate::Held => 1,
            Fate::Delivered(_) => 2,
            Fate::Refused => 3,
            Fate::Answered(_) => 4,
            Fate::Lapsed => 5,
        })?;
        store_id(source.task, c.id, frame, w)?;
        w.left(c.sender_until, self.now)?;
        w.left(c.until, self.now)?;
        match &c.fate {
            Fate::Delivered(budget_ends) => w.left(*budget_ends, self.now),
            Fate::Answered(contents) => {
                w.contents(contents)?;
                if form.long_answers { source.answer.store(w) } else { Ok(()) }
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
            if form.long {
                held.fragments = r.byte();
            }
            let pushed = inbox.queue.push_with(Held { arrival: self.arrivals, ..held }, aged);
            if let Ok(slot) = pushed
                && let Some(body) = inbox.bodies.get_mut(usize::from(slot))
            {
                body.clear();
                if held.fragments > 1 {
                    body.load(r);
                }
            }
            self.arrivals += 1;
        }
        for source in &mut inbox.sources {
            load_source(source, form, lives, r);
        }
    }
}

fn load_held(r: &mut Reader<'_>, lives: bool) -> (Held, Aged) {
    let source = TaskId(u16::from(r.byte()));
    let id = load_id(r, lives);
    let flags = r.byte();
    let class = if flags & STATUS != 0 { Class::Status } else { Class::Command };
    let (expires, contents) = (r.left(), r.contents());
    let (mut rejections, mut rejected_first) = (0, 0);
    if flags & REJECTED != 0 {
        (rejections, rejected_first) = (r.byte(), 1 + u64::from(r.byte()));
    }
    let not_before = if flags & LATER != 0 { r.left() } else { Ticks::ZERO };
    let held = Held { source, id, class, expires, contents, fragments: 1, arrival: 0 };
    (held, Aged { rejections, rejected_first, not_before })
}

fn load_source(source: &mut Source, form: Form, lives: bool, r: &mut Reader<'_>) {
    source.forget();
    source.answer.clear();
    match form.class {
        Class::Command => load_command(source, form, lives, r),
        Class::Status => {
            if r.byte() != 0 {
                let newest = Some(r.sequence());
                let until = r.left();
                let seen = u64::from_le_bytes(core::array::from_fn(|_| r.byte()));
                source.status = Window { newest, seen, until };
            }
        }
    }
    if form.long {
        let have = r.word();
        if have != 0 {
            source.assembly.load(have, r);
            (source.assembly.id, source.assembly.expires) = (load_id(r, lives), r.left());
        }
    }
}

fn load_command(source: &mut Source, form: Form, lives: bool, r: &mut Reader<'_>) {
    let fate = r.byte();
    if fate == 0 {
        return;
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
            if form.long_answers {
                source.answer.load(r);
            }
            Fate::Answered(contents)
        }
    };
    source.command = Some(Remembered { id, fate, sender_until, until });
}
