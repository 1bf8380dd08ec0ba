//! The fields of a communication task and of its parts, each listed once (see [`state`](crate::state)).

mod desks;
mod inboxes;
mod lease;
mod levels;
mod meetings;

use super::desk::Overdue;
use super::{CommTask, Known, Local};
use crate::ids::{Incarnation, MessageId, PortId, Round, Seq24, TaskId};
use crate::state::{Change, Decode, Encode, Frame, Look, Overflow, Visit, VisitMut, Walk};
use crate::table::NodeTable;
use crate::ticks::Ticks;

impl CommTask {
    /// Writes the canonical bytes of this state and returns how many. Call [`bury`](Self::bury) first.
    ///
    /// # Errors
    /// [`Overflow`] when a distance outgrows its field or `out` is too short.
    pub fn store(&mut self, table: &NodeTable, frame: &Frame<'_>, out: &mut [u8]) -> Result<usize, Overflow> {
        let mut w = Encode::new(out, frame, self.now);
        self.walk(Some(table), &mut w);
        w.finish()
    }

    /// Reads a state back in place and returns how many bytes it took. Ids come back relative to [`Frame::ROUND`] and
    /// [`Frame::SEQUENCE`], time relative to zero. `bytes` must come from [`store`](Self::store) of the same task.
    pub fn load(&mut self, table: &NodeTable, lives: bool, bytes: &[u8]) -> usize {
        let mut w = Decode::new(bytes, lives);
        self.walk(Some(table), &mut w);
        if self.inboxes.iter().any(|inbox| inbox.handled) {
            self.heads.watch(&self.inboxes);
        }
        self.touch_all();
        w.finish()
    }

    /// Looks at everything relative. Nothing changes.
    pub fn visit(&mut self, visitor: &mut impl Visit) {
        self.walk(None, &mut Look(visitor));
    }

    /// Changes everything relative. The order of instants must stay as it is.
    pub fn visit_mut(&mut self, visitor: &mut impl VisitMut) {
        self.walk(None, &mut Change(visitor));
        self.touch_all();
    }

    /// Sets the internal clock back to zero; behaviour does not change. Dead state is dropped first, so that no
    /// forgotten instant lies before the new zero.
    pub fn rebase(&mut self) {
        struct Back(Ticks);
        impl VisitMut for Back {
            fn instant(&mut self, instant: &mut Ticks) {
                if *instant != Ticks::FAR {
                    *instant = *instant - self.0;
                }
            }
            fn round(&mut self, _: PortId, _: &mut Round) {}
            fn sequence(&mut self, _: TaskId, _: &mut Seq24) {}
        }
        self.bury();
        let now = self.now;
        self.visit_mut(&mut Back(now));
        self.now = Ticks::ZERO;
    }

    /// Moves the internal clock `ahead`, and every instant with it; behaviour does not change, however far, because
    /// no instant ever leaves the task (D37).
    pub fn set_ahead(&mut self, ahead: Ticks) {
        struct Ahead(Ticks);
        impl VisitMut for Ahead {
            fn instant(&mut self, instant: &mut Ticks) {
                *instant += self.0;
            }
            fn round(&mut self, _: PortId, _: &mut Round) {}
            fn sequence(&mut self, _: TaskId, _: &mut Seq24) {}
        }
        self.visit_mut(&mut Ahead(ahead));
        self.now += ahead;
    }

    /// The one list of its fields. What the declaration of a port leaves out is left out where there is a table.
    fn walk<W: Walk>(&mut self, table: Option<&NodeTable>, w: &mut W) {
        let Self {
            task,
            incarnation,
            restarted,
            now,
            next_sequence,
            next_turn,
            arrivals,
            quarantine_until,
            levels,
            depth,
            capped_last,
            rejections,
            timers,
            overdue,
            order,
            locals,
            desks,
            inboxes,
            meetings,
            heads: _, // The orders over its ports follow from these.
            served,
            lives,
            lease,
            guards,
            taken,
            turned: _, // Empty between two inputs.
        } = self;
        let own = *task;
        let at = *now;
        // All instants are relative to it.
        w.left_out(now, || Ticks::ZERO);
        w.next_sequence(own, next_sequence);
        // One thread drives a packed task: no word of an earlier start of a timer can still be on its way.
        w.left_out(next_turn, || 0);
        // Whoever takes a message reads it at once.
        if W::LOADS {
            taken.0 = None;
            taken.1.clear();
        }
        let couple = lease.as_ref().map(|lease| lease.couple);
        levels::walk((order, capped_last, timers), (depth, levels), couple, w);
        if table.is_none_or(|table| !table.rules().refuse_late_replies) {
            w.align();
            w.present(overdue);
            w.align();
            if let Some(Overdue { port, to, id }) = overdue {
                name_port(port, w);
                name_task(to, w);
                own_id((own, *incarnation), id, w);
            }
        } else {
            w.left_out(overdue, || None);
        }
        if w.lives() {
            w.instant(quarantine_until);
            w.life(incarnation);
            w.align();
            w.bit(restarted);
            w.align();
        } else {
            w.left_out(quarantine_until, || Ticks::ZERO);
        }
        for Known { task: _, life } in lives.iter_mut() {
            w.heard(life);
        }
        for Local { port: _, role: _, counters: _, staged } in
            locals.iter_mut().filter(|local| local.staged.has_room())
        {
            staged.walk(w);
        }
        let life = *incarnation;
        for desk in desks.iter_mut() {
            desk.walk(desks::Form::of(table, desk), (own, life), w);
        }
        let mut counts = inboxes::Counts::new(inboxes, (arrivals, rejections, served), w);
        for inbox in inboxes.iter_mut() {
            inbox.walk(inboxes::Form::of(table, inbox), at, &mut counts, w);
        }
        for meeting in meetings.iter_mut() {
            let resend =
                table.and_then(|table| table.port(meeting.port)).map_or(Ticks::FAR, |port| port.decl.resend);
            let unread = levels::is_unread(&levels[..=usize::from(*depth)], meeting.port);
            meeting.walk(unread, resend, w);
        }
        if let Some(lease) = lease {
            lease.walk(own, w);
        }
        for guard in guards.iter_mut() {
            guard.walk(at, w);
        }
    }
}

/// A number of two bytes that fits one in every state that a checker keeps.
fn number<W: Walk>(w: &mut W, number: u16) -> u16 {
    u16::try_from(w.count(usize::from(number))).unwrap_or(number)
}

/// An id of the task's own: where lives are not told apart, it is of this one.
fn own_id<W: Walk>((own, life): (TaskId, Incarnation), id: &mut MessageId, w: &mut W) {
    w.id(own, id);
    if W::LOADS && !w.lives() {
        id.incarnation = life;
    }
}

/// A port that something names.
fn name_port<W: Walk>(port: &mut PortId, w: &mut W) {
    port.0 = number(w, port.0);
}

/// A task that something names.
fn name_task<W: Walk>(task: &mut TaskId, w: &mut W) {
    task.0 = number(w, task.0);
}
