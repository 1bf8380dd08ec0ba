//! The packed form of a task's side of its couple.

use super::{CommTask, Frame, Overflow, Reader, Writer};
use crate::comm_task::lease::{Answered, Lease, Post};
use crate::ids::Incarnation;
use crate::request::Call;
use crate::ticks::Ticks;

/// The first byte: the post, then what else there is.
const POST: u8 = 0x03;
const ECHO: u8 = 0x04;
const FENCED: u8 = 0x08;
const TOOK_OVER: u8 = 0x10;
const NEWEST: u8 = 0x20;
const PROPOSED: u8 = 0x40;
const MET: u8 = 0x80;

impl CommTask {
    pub(super) fn store_guards(&self, w: &mut Writer<'_>) -> Result<(), Overflow> {
        self.guards.iter().try_for_each(|guard| {
            // A guard that nothing older can reach any more admits everything.
            let alive = guard.until > self.now;
            w.byte(if alive { guard.epoch } else { 0 })?;
            w.left(if alive { guard.until } else { self.now }, self.now)
        })
    }

    pub(super) fn load_guards(&mut self, r: &mut Reader<'_>) {
        for guard in &mut self.guards {
            (guard.epoch, guard.until) = (r.byte(), r.left());
        }
    }

    pub(super) fn store_lease(
        &self,
        lease: &Lease,
        frame: &Frame<'_>,
        w: &mut Writer<'_>,
    ) -> Result<(), Overflow> {
        let post = match lease.post {
            Post::Waits => 0,
            Post::Leased(_) => 1,
            Post::Alone => 2,
            Post::Passive => 3,
        };
        let flag = |set: bool, bit: u8| if set { bit } else { 0 };
        let fenced = lease.call == Some(Call::Fenced);
        let took_over = matches!(lease.call, Some(Call::TakeOver(_)));
        w.byte(
            post | flag(lease.newest.is_some(), NEWEST)
                | flag(lease.proposed, PROPOSED)
                | flag(lease.life.is_some(), MET)
                | flag(lease.echo.is_some(), ECHO)
                | flag(fenced, FENCED)
                | flag(took_over, TOOK_OVER),
        )?;
        w.byte(lease.epoch)?;
        let life = lease.life.map_or(0, |life| life.0);
        match frame.lives {
            true => {
                w.byte(life)?;
                w.byte(u8::from(lease.guessed))?;
            }
            // A forged answer may speak of a life where there are none.
            false if life != 0 => return Err(Overflow),
            false => {}
        }
        match lease.post {
            Post::Waits => {
                w.left(lease.beat_at, self.now)?;
                w.left(lease.takeover_at, self.now)?;
            }
            Post::Leased(until) => w.left(until, self.now)?,
            Post::Alone | Post::Passive => {}
        }
        if let Some(echo) = lease.echo {
            w.byte(frame.sequence(self.task, echo.beat)?)?;
            w.left(echo.until, self.now)?;
        }
        if let Some(newest) = lease.newest {
            w.byte(frame.sequence(lease.partner, newest)?)?;
        }
        w.count(lease.answered.iter().flatten().count())?;
        for answered in lease.answered.iter().flatten() {
            w.byte(frame.sequence(lease.partner, answered.beat)?)?;
            w.left(answered.until, self.now)?;
        }
        w.contents(&lease.published)?;
        w.contents(&lease.said)
    }

    pub(super) fn load_lease(&mut self, lives: bool, r: &mut Reader<'_>) {
        let Some(lease) = &mut self.lease else { return };
        let first = r.byte();
        lease.proposed = first & PROPOSED != 0;
        lease.epoch = r.byte();
        let life = Incarnation(if lives { r.byte() } else { 0 });
        lease.guessed = lives && r.byte() != 0;
        lease.life = (first & MET != 0).then_some(life);
        (lease.beat_at, lease.takeover_at) = (Ticks::FAR, Ticks::FAR);
        lease.post = match first & POST {
            0 => {
                (lease.beat_at, lease.takeover_at) = (r.left(), r.left());
                Post::Waits
            }
            1 => Post::Leased(r.left()),
            2 => Post::Alone,
            _ => Post::Passive,
        };
        lease.call = match (first & FENCED != 0, first & TOOK_OVER != 0) {
            (true, _) => Some(Call::Fenced),
            (false, true) => Some(Call::TakeOver(lease.epoch)),
            (false, false) => None,
        };
        lease.echo = (first & ECHO != 0).then(|| Answered { beat: r.sequence(), until: r.left() });
        lease.newest = (first & NEWEST != 0).then(|| r.sequence());
        lease.answered = Default::default();
        let count = usize::from(r.byte());
        for answered in lease.answered.iter_mut().take(count) {
            *answered = Some(Answered { beat: r.sequence(), until: r.left() });
        }
        lease.published = r.contents();
        lease.said = r.contents();
    }
}
