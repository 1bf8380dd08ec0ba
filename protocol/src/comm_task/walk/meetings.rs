//! A rendezvous.

use crate::comm_task::rendezvous::{Arrived, Member, Rendezvous};
use crate::ids::PortId;
use crate::state::Walk;
use crate::ticks::Ticks;

impl Rendezvous {
    /// `unread`: a thread that was interrupted has not read yet what the others brought. The arrival is announced again every
    /// `resend` ticks.
    pub(super) fn walk<W: Walk>(&mut self, unread: bool, resend: Ticks, w: &mut W) {
        let Self {
            port,
            numbered: _,
            announced,
            fresh,
            released,
            deadline,
            resend_at,
            members,
            copies_left,
            copy_at,
            owes_confirm,
            arguments,
        } = self;
        w.align();
        w.present(deadline);
        w.present(released);
        let fresher = w.flag(fresh != announced);
        w.bit(owes_confirm);
        let copies = w.flag(*copies_left > 0);
        let brings = w.flag(*arguments != [0; 8]);
        w.round(*port, announced);
        if let Some(deadline) = deadline {
            w.instant(deadline);
        }
        if let Some(released) = released {
            w.round(*port, released);
        }
        if fresher {
            w.round(*port, fresh);
        } else {
            *fresh = *announced;
        }
        let waits_until = *deadline;
        w.derived(resend_at, || {
            waits_until.map_or(Ticks::FAR, |deadline| Self::resend_instant(deadline, Ticks::ZERO, resend))
        });
        if copies {
            w.byte(copies_left);
            w.instant(copy_at);
        } else {
            w.left_out(copies_left, || 0);
            w.derived(copy_at, || Ticks::FAR);
        }
        if brings {
            w.arguments(arguments);
        } else {
            w.left_out(arguments, || [0; 8]);
        }
        for member in members.iter_mut() {
            member.walk(*port, unread, w);
        }
    }
}

impl Member {
    fn walk<W: Walk>(&mut self, port: PortId, unread: bool, w: &mut W) {
        let Self { arrived, barred, life, reborn, confirmed, told } = self;
        w.align();
        w.present(arrived);
        w.present(barred);
        w.bit(reborn);
        let brought = w.flag(arrived.is_some_and(|arrived| arrived.arguments != [0; 8]));
        let mut read_later = told.filter(|_| unread);
        w.present(&mut read_later);
        if let Some(Arrived { round, expires, arguments }) = arrived {
            w.round(port, round);
            w.instant(expires);
            if brought {
                w.arguments(arguments);
            }
        }
        if let Some(told) = &mut read_later {
            w.arguments(told);
        }
        // What a thread has read already matters no more.
        w.left_out(told, || read_later);
        if let Some(barred) = barred {
            w.round(port, barred);
        }
        w.heard(life);
        // It is shown, not acted on.
        w.left_out(confirmed, || false);
    }
}
