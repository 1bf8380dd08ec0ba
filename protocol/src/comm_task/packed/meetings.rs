//! The packed form of a rendezvous.

use super::{CommTask, Frame, Overflow, Reader, Writer};
use crate::comm_task::levels::Finished;
use crate::comm_task::rendezvous::{Arrived, Rendezvous};
use crate::ids::{Incarnation, PortId};
use crate::ticks::Ticks;

/// Present bits of a rendezvous and of a member.
const WAITS: u8 = 1;
const RELEASED: u8 = 2;
const FRESH: u8 = 4;
const OWES: u8 = 8;
const COPIES: u8 = 16;
const BRINGS: u8 = 32;
const ARRIVED: u8 = 1;
const BARRED: u8 = 2;
const REBORN: u8 = 4;
const BROUGHT: u8 = 8;
const TOLD: u8 = 16;

impl CommTask {
    pub(super) fn store_meeting(
        &self,
        m: &Rendezvous,
        frame: &Frame<'_>,
        w: &mut Writer<'_>,
    ) -> Result<(), Overflow> {
        let fresh = m.fresh != m.announced;
        let flag = |set: bool, bit: u8| if set { bit } else { 0 };
        w.byte(
            flag(m.deadline.is_some(), WAITS)
                | flag(m.released.is_some(), RELEASED)
                | flag(fresh, FRESH)
                | flag(m.owes_confirm, OWES)
                | flag(m.copies_left > 0, COPIES)
                | flag(m.arguments != [0; 8], BRINGS),
        )?;
        w.byte(frame.round(m.port, m.announced)?)?;
        if let Some(deadline) = m.deadline {
            w.left(deadline, self.now)?;
        }
        if let Some(released) = m.released {
            w.byte(frame.round(m.port, released)?)?;
        }
        if fresh {
            w.byte(frame.round(m.port, m.fresh)?)?;
        }
        if m.copies_left > 0 {
            w.byte(m.copies_left)?;
            w.left(m.copy_at, self.now)?;
        }
        if m.arguments != [0; 8] {
            w.arguments(&m.arguments)?;
        }
        let unread = self.is_unread(m.port);
        for member in &m.members {
            let brought =
                member.arrived.map(|arrived| arrived.arguments).filter(|brought| *brought != [0; 8]);
            let told = member.told.filter(|_| unread);
            w.byte(
                flag(member.arrived.is_some(), ARRIVED)
                    | flag(member.barred.is_some(), BARRED)
                    | flag(member.reborn, REBORN)
                    | flag(brought.is_some(), BROUGHT)
                    | flag(told.is_some(), TOLD),
            )?;
            if let Some(arrived) = member.arrived {
                w.byte(frame.round(m.port, arrived.round)?)?;
                w.left(arrived.expires, self.now)?;
            }
            brought.iter().chain(&told).try_for_each(|arguments| w.arguments(arguments))?;
            if let Some(barred) = member.barred {
                w.byte(frame.round(m.port, barred)?)?;
            }
            if frame.lives {
                w.byte(member.life.map_or(0, |life| life.0.wrapping_add(1)))?;
            }
        }
        Ok(())
    }

    /// Whether a thread that a handler interrupts left a meeting of this port: it has not read yet what the others brought.
    fn is_unread(&self, port: PortId) -> bool {
        self.running().iter().any(|level| match &level.finished {
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

    pub(super) fn load_meeting(&mut self, i: usize, resend: Ticks, lives: bool, r: &mut Reader<'_>) {
        let m = &mut self.meetings[i];
        let flags = r.byte();
        m.announced = r.round();
        m.deadline = (flags & WAITS != 0).then(|| r.left());
        m.released = (flags & RELEASED != 0).then(|| r.round());
        m.fresh = if flags & FRESH != 0 { r.round() } else { m.announced };
        m.resend_at = m
            .deadline
            .map_or(Ticks::FAR, |deadline| Rendezvous::resend_instant(deadline, Ticks::ZERO, resend));
        m.owes_confirm = flags & OWES != 0;
        (m.copies_left, m.copy_at) = (0, Ticks::FAR);
        if flags & COPIES != 0 {
            (m.copies_left, m.copy_at) = (r.byte(), r.left());
        }
        m.arguments = if flags & BRINGS != 0 { r.arguments() } else { [0; 8] };
        for member in &mut m.members {
            let flags = r.byte();
            member.arrived = (flags & ARRIVED != 0).then(|| {
                let (round, expires) = (r.round(), r.left());
                let arguments = if flags & BROUGHT != 0 { r.arguments() } else { [0; 8] };
                Arrived { round, expires, arguments }
            });
            member.told = (flags & TOLD != 0).then(|| r.arguments());
            member.barred = (flags & BARRED != 0).then(|| r.round());
            member.reborn = flags & REBORN != 0;
            member.life = if lives { r.byte().checked_sub(1).map(Incarnation) } else { Some(Incarnation(0)) };
            member.confirmed = false;
        }
    }
}
