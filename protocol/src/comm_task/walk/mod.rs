//! The fields of a communication task, each listed once (D165).

mod desks;
mod inboxes;
mod lease;
mod levels;
mod meetings;

use super::CommTask;
use super::desk::Overdue;
use super::levels::Level;
use crate::ids::{MessageId, PortId, TaskId};
use crate::state::{Pass, Walk};
use crate::table::NodeTable;
use crate::ticks::Ticks;
use alloc::vec::Vec;

impl CommTask {
    /// Walks the state. [`bury`](Self::bury) it before it is written.
    ///
    /// A pass that changes it keeps the order of instants; one that reads must read bytes of the same task.
    pub fn walk<W: Walk>(&mut self, table: &NodeTable, w: &mut W) {
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
            // Rebuilt from the inboxes and meetings, below.
            heads,
            served,
            lives,
            lease,
            guards,
            // A thread has read it when the task is packed.
            taken,
            // Empty between two inputs.
            turned: _,
        } = self;
        let own = *task;
        w.clock(now);
        w.next_sequence(own, next_sequence);
        if W::READS {
            // One thread drives a packed task: no word of an earlier start can still be on its way.
            *next_turn = 0;
            taken.0 = None;
            taken.1.clear();
            // These only number what comes: their order is in the ranks of what waits.
            (*arrivals, *rejections) = (0, 1);
            // As if that many had been served: no port was passed over more often.
            *served = u64::from(u8::MAX);
        }
        let couple = lease.as_ref().map(|lease| lease.couple);
        levels::walk(w, (order, capped_last), timers, (levels, depth), couple);
        if !table.rules().refuse_late_replies {
            let is = w.put(u8::from(overdue.is_some())) == 1;
            if let Some(overdue) = w.some(overdue, is, Overdue::BLANK) {
                let Overdue { port, to, id } = overdue;
                w.small(&mut port.0);
                w.small(&mut to.0);
                w.id(own, *incarnation, id);
            }
        } else if W::READS {
            *overdue = None;
        }
        if w.lives() {
            w.instant(quarantine_until);
            w.byte(&mut incarnation.0);
            w.flag(restarted);
        } else if W::READS {
            *quarantine_until = Ticks::ZERO;
        }
        lives.iter_mut().for_each(|known| w.known_life(&mut known.life));
        for local in locals.iter_mut().filter(|local| local.staged.has_room()) {
            local.staged.walk(w);
        }
        desks.iter_mut().for_each(|desk| desk.walk(table, (own, *incarnation), w));
        for at in 0..inboxes.len() {
            let form = inboxes::Form::of(table, inboxes[at].port);
            let waiting = match W::PASS {
                Pass::Encode | Pass::Look => inboxes::waiting(inboxes, form, at),
                Pass::Decode | Pass::Change => Vec::new(),
            };
            let counters = &mut inboxes::Counters { arrivals, rejections };
            inboxes[at].walk(form, (*now, *served), waiting, counters, w);
        }
        let running = &levels[..=usize::from(*depth)];
        meetings
            .iter_mut()
            .for_each(|meeting| meeting.walk(table, levels::is_unread(running, meeting.port), w));
        if let Some(lease) = lease {
            lease.walk(own, w);
        }
        guards.iter_mut().for_each(|guard| guard.walk(w));
        if W::READS && inboxes.iter().any(|inbox| inbox.handled) {
            heads.watch(inboxes);
        }
        if matches!(W::PASS, Pass::Decode | Pass::Change) {
            self.touch_all();
        }
    }
}

impl Overdue {
    const BLANK: Self = Self { port: PortId(0), to: TaskId(0), id: MessageId::BLANK };
}
