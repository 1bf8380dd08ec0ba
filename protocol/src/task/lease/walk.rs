//! Visits the fields of a lease, for the checker's packed states.

use super::{Answered, Lease, Post};
use crate::ids::{Incarnation, Seq24, TaskId};
use crate::request::Call;
use crate::state::{Walk, mark};
use crate::ticks::Instant;

/// Layout of the first byte: the role, and flags.
const POST: u8 = 0x03;
const ECHO: u8 = 0x04;
const FENCED: u8 = 0x08;
const TOOK_OVER: u8 = 0x10;
const NEWEST: u8 = 0x20;
const PROPOSED: u8 = 0x40;
const MET: u8 = 0x80;

impl Lease {
    pub(in crate::task) fn walk<W: Walk>(&mut self, own: TaskId, w: &mut W) {
        let Self {
            couple,
            primary: _,
            partner,
            post,
            epoch,
            proposed,
            guessed,
            incarnation,
            answered,
            newest,
            echo,
            heartbeat_at,
            takeover_at,
            published,
            said,
            call,
        } = self;
        let (couple, partner) = (*couple, *partner);
        let code = match post {
            Post::Waits => 0,
            Post::Leased(_) => 1,
            Post::Alone => 2,
            Post::Passive => 3,
        };
        let first = w.put(
            code | mark(newest.is_some(), NEWEST)
                | mark(*proposed, PROPOSED)
                | mark(incarnation.is_some(), MET)
                | mark(echo.is_some(), ECHO)
                | mark(*call == Some(Call::Fenced), FENCED)
                | mark(matches!(call, Some(Call::TakeOver(_))), TOOK_OVER),
        );
        w.epoch(couple, epoch);
        if W::READS {
            *proposed = first & PROPOSED != 0;
            *post = match first & POST {
                0 => Post::Waits,
                1 => Post::Leased(Instant::START),
                2 => Post::Alone,
                _ => Post::Passive,
            };
            (*heartbeat_at, *takeover_at) = (Instant::NEVER, Instant::NEVER);
            *guessed = false;
        }
        // The epoch of a take-over is not packed, because it equals the field `epoch`.
        match call {
            Some(Call::TakeOver(into)) if !W::PACKS => w.epoch(couple, into),
            _ if W::READS && first & FENCED != 0 => *call = Some(Call::Fenced),
            _ if W::READS => *call = (first & TOOK_OVER != 0).then_some(Call::TakeOver(*epoch)),
            _ => {}
        }
        let mut met = incarnation.unwrap_or(Incarnation(0));
        if w.incarnations() {
            w.byte(&mut met.0);
            w.flag(guessed);
        } else if W::READS {
            met = Incarnation(0);
        } else if met != Incarnation(0) {
            // In a world without restarts only a forged answer can name another incarnation.
            w.overflows();
        }
        if W::READS {
            *incarnation = (first & MET != 0).then_some(met);
        }
        match post {
            Post::Waits => {
                w.instant(heartbeat_at);
                w.instant(takeover_at);
            }
            Post::Leased(until) => w.instant(until),
            Post::Alone | Post::Passive => {}
        }
        if let Some(echo) = w.some(echo, first & ECHO != 0, Answered::BLANK) {
            echo.walk(own, w);
        }
        if let Some(newest) = w.some(newest, first & NEWEST != 0, Seq24::default()) {
            w.sequence(partner, newest);
        }
        let count = w.count(answered.iter().flatten().count());
        if W::READS {
            *answered = Default::default();
            answered.iter_mut().take(count).for_each(|place| *place = Some(Answered::BLANK));
        }
        answered.iter_mut().flatten().for_each(|answered| answered.walk(partner, w));
        w.contents(published);
        w.contents(said);
    }
}

impl Answered {
    const BLANK: Self = Self { heartbeat: Seq24::new(0), until: Instant::START };

    fn walk<W: Walk>(&mut self, source: TaskId, w: &mut W) {
        let Self { heartbeat, until } = self;
        w.sequence(source, heartbeat);
        w.instant(until);
    }
}

impl Lease {
    /// Drops dead state: answers and echoes that can no longer renew a lease at `now`.
    pub fn bury(&mut self, now: Instant) {
        for answered in &mut self.answered {
            *answered = answered.filter(|a| a.until > now && self.post != Post::Passive);
        }
        self.answered.sort_by_key(Option::is_none);
        if self.post == Post::Passive {
            self.newest = None;
        }
        self.echo = self.echo.filter(|echo| echo.until > now);
    }
}
