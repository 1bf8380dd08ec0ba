//! A task's side of its couple, and what an actuator remembers of a couple.

use crate::comm_task::lease::{Answered, Guard, Lease, Post};
use crate::ids::{Incarnation, Seq24, TaskId};
use crate::request::Call;
use crate::state::Walk;
use crate::ticks::Ticks;

impl Guard {
    /// One that nothing older can reach any more admits everything.
    pub(super) fn walk<W: Walk>(&mut self, now: Ticks, w: &mut W) {
        if !W::LOADS && self.until <= now {
            *self = Self { until: now, ..Self::new(self.couple) };
        }
        let Self { couple, epoch, until } = self;
        w.epoch(*couple, epoch);
        w.instant(until);
    }
}

impl Post {
    const fn code(self) -> u8 {
        match self {
            Self::Waits => 0,
            Self::Leased(_) => 1,
            Self::Alone => 2,
            Self::Passive => 3,
        }
    }

    const fn blank(code: u8) -> Self {
        match code {
            0 => Self::Waits,
            1 => Self::Leased(Ticks::ZERO),
            2 => Self::Alone,
            _ => Self::Passive,
        }
    }
}

impl Answered {
    const BLANK: Self = Self { beat: Seq24::new(0), until: Ticks::ZERO };

    fn walk<W: Walk>(&mut self, source: TaskId, w: &mut W) {
        let Self { beat, until } = self;
        w.sequence(source, beat);
        w.instant(until);
    }
}

impl Lease {
    pub(super) fn walk<W: Walk>(&mut self, own: TaskId, w: &mut W) {
        let Self {
            couple,
            primary: _,
            partner,
            post,
            epoch,
            proposed,
            guessed,
            life,
            answered,
            newest,
            echo,
            beat_at,
            takeover_at,
            published,
            said,
            call,
        } = self;
        w.align();
        let code = w.bits(2, post.code());
        w.left_out(post, || Post::blank(code));
        let echoes = w.flag(echo.is_some());
        w.left_out(echo, || echoes.then_some(Answered::BLANK));
        let fenced = w.flag(*call == Some(Call::Fenced));
        let takes_over = w.flag(matches!(call, Some(Call::TakeOver(_))));
        w.present(newest);
        w.bit(proposed);
        w.present(life);
        w.epoch(*couple, epoch);
        w.left_out(call, || match (fenced, takes_over) {
            (true, _) => Some(Call::Fenced),
            (false, true) => Some(Call::TakeOver(*epoch)),
            (false, false) => None,
        });
        if let Some(Call::TakeOver(told)) = call
            && W::CHANGES
        {
            w.epoch(*couple, told);
        }
        walk_life((life, guessed), w);
        match post {
            Post::Waits => {
                w.instant(beat_at);
                w.instant(takeover_at);
            }
            Post::Leased(until) => w.instant(until),
            Post::Alone | Post::Passive => {}
        }
        if *post != Post::Waits {
            w.derived(beat_at, || Ticks::FAR);
            w.derived(takeover_at, || Ticks::FAR);
        }
        if let Some(echo) = echo {
            echo.walk(own, w);
        }
        if let Some(newest) = newest {
            w.sequence(*partner, newest);
        }
        let count = w.count(answered.iter().flatten().count());
        if W::LOADS {
            *answered = Default::default();
            answered.iter_mut().take(count).for_each(|answered| *answered = Some(Answered::BLANK));
        }
        answered.iter_mut().flatten().for_each(|answered| answered.walk(*partner, w));
        w.contents(published);
        w.contents(said);
    }
}

/// The partner's life and whether the own epoch is a guess: where lives are told apart.
fn walk_life<W: Walk>((life, guessed): (&mut Option<Incarnation>, &mut bool), w: &mut W) {
    let mut known = life.unwrap_or_default();
    if w.lives() {
        w.life(&mut known);
        *guessed = w.code(u8::from(*guessed)) != 0;
    } else {
        // A forged answer may speak of a life where there are none.
        if known != Incarnation::default() {
            w.fail();
        }
        w.left_out(guessed, || false);
    }
    if W::LOADS {
        *life = life.map(|_| known);
    }
}
