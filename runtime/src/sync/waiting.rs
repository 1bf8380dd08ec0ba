//! How a task's thread waits for what others bring, and how they wake it: one word that both change.
//!
//! ```text
//!                      goes, sleep                     mark: there is something for it
//!   RUNNING <-----------------------------> SLEEPING ------------------------------> READY
//!      ^  \---- go_away, come_home -------> AWAY -------- and the bell rings --------> READY
//!      |   \--- listens ------------------> LISTENING --- and the bell rings --------> READY
//!      |    \-- begins to look, looks no more -> LOOKING ----------------------------> READY
//!      \-------------------------------------- comes in ----------------------------- READY
//! ```
//!
//! What is brought while the thread looks is left to it. While it runs, what may wait is. So whoever changes the word from
//! `RUNNING` asks after that whether something was left, and who leaves something asks after that for the word.

use crate::sync::awake::Presence;
use crate::sync::plant::{Plants, Sound};
use crate::sync::station::Bell;
use crate::sync::{Ordering, Word, fence};
use std::sync::Arc;

/// The task's thread runs.
const RUNNING: u32 = 0;
/// The task's thread sleeps, or is about to.
const SLEEPING: u32 = 1;
/// There is something for the task's thread, or its program has ended: sleeping is over.
const READY: u32 = 2;
/// The task's thread waits elsewhere, or is about to: the bell calls it.
pub(super) const AWAY: u32 = 3;
/// The task's program is a future that waits, or is about to: the bell calls it.
const LISTENING: u32 = 4;
/// The task's thread looks at its word, and works off what it finds in the inbox.
const LOOKING: u32 = 5;

/// The bugs that the explorers must find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plant {
    /// The holder does not look into the inbox after it has let go of the lock.
    NoSecondLook,
    /// The word is looked at, but not changed, when mail comes.
    NoMark,
    /// The word is marked, but nobody is woken.
    NoWake,
    /// Who waits elsewhere is not called.
    NoBell,
    /// Stopping does not wake.
    SilentStop,
    /// Nothing orders the inbox and the lock.
    NoFence,
    /// Input that finds the lock held and the inbox full is gone.
    DropsWhenFull,
    /// Who looked at the word sleeps without looking once more.
    SleepsBlindly,
    /// Who left input to a thread that looked does not mind whether it still does.
    TrustsTheLook,
    /// Who left input to a thread that ran does not mind whether it still does.
    TrustsTheRun,
    /// Who goes to sleep does not mind what was left while it ran.
    SleepsOnIt,
    /// Who begins to look does not either.
    LooksPastIt,
    /// Neither who left something to a thread that ran, nor that thread, has a fence between what it writes and what it reads.
    NoFenceForARunner,
}

/// What two cores write in turn, in a line of the cache of its own.
#[repr(align(64))]
struct Line<T>(T);

/// What is left to a task's thread.
pub(super) enum Leave {
    /// All: it looks.
    All,
    /// What may wait: it runs.
    SomeOfIt,
    Nothing,
}

/// What a task's thread did when its word was marked: it is [called](Waiting::call) by that.
#[derive(Clone, Copy)]
pub(super) struct Was(u32);

impl Was {
    /// It needs no call.
    pub const RUNNING: Self = Self(RUNNING);
}

/// The wait of a task's thread.
pub(super) struct Waiting<P = Sound> {
    word: Line<Word>,
    pub presence: Presence,
    /// Where the task's thread may wait elsewhere.
    bell: Option<Arc<dyn Bell>>,
    pub plant: P,
}

impl<P: Plants<Plant>> Waiting<P> {
    pub fn new(bell: Option<Arc<dyn Bell>>, plant: P) -> Self {
        Self { word: Line(Word::new(RUNNING)), presence: Presence::new(), bell, plant }
    }

    /// What is left to the thread now.
    pub fn leaves(&self) -> Leave {
        match self.word.0.load() {
            LOOKING => Leave::All,
            RUNNING => Leave::SomeOfIt,
            _ => Leave::Nothing,
        }
    }

    fn is_running(&self) -> bool {
        self.word.0.load() == RUNNING
    }

    pub fn is_looking(&self) -> bool {
        self.word.0.load() == LOOKING
    }

    /// Whether there is something for the task's thread.
    pub fn is_ready(&self) -> bool {
        self.word.0.load() == READY
    }

    /// The thread comes in, under the lock. Others read the word's line. Who looked may be called just now: what was left to it
    /// before is seen after this.
    pub fn comes_in(&self) {
        if !self.is_running() {
            self.word.0.swap(RUNNING);
        }
    }

    /// The future is polled, under the lock.
    pub fn is_polled(&self) {
        self.word.0.store(RUNNING);
    }

    /// Says that there is something for the thread, for ever where nothing makes it come in.
    pub fn ready(&self) -> Was {
        Was(self.word.0.swap(READY))
    }

    /// Says that there is mail.
    pub fn mark(&self) -> Was {
        if self.plant.has(Plant::NoMark) {
            return Was(self.word.0.load());
        }
        let was = self.ready();
        if self.plant.has(Plant::NoWake) { Was::RUNNING } else { was }
    }

    /// Makes the thread look, that did this until its word was marked.
    pub fn call(&self, Was(was): Was) {
        if was == SLEEPING || was == AWAY {
            self.presence.returns();
        }
        if was == SLEEPING {
            self.word.0.wake();
        }
        if self.plant.has(Plant::NoBell) {
            return;
        }
        if let Some(bell) = self.bell.as_ref().filter(|_| was == AWAY || was == LISTENING) {
            bell.ring();
        }
    }

    /// Says to a thread that looks that something was left to it. False where it looks no longer, or was called before.
    pub fn call_looker(&self) -> bool {
        self.word.0.replace(LOOKING, READY) || self.plant.has(Plant::TrustsTheLook)
    }

    /// Sleeps until the word is marked or `deadline` has passed, unless something `was_left`. False where there was something.
    pub fn sleep(&self, deadline: Option<u64>, was_left: impl FnOnce() -> bool) -> bool {
        if !self.goes(SLEEPING, was_left) {
            return false;
        }
        self.word.0.wait(SLEEPING, deadline);
        self.comes(SLEEPING);
        true
    }

    /// The thread is about to wait so. False where there is something for it.
    pub fn goes(&self, to: u32, was_left: impl FnOnce() -> bool) -> bool {
        // Before the word says so: who calls the thread counts it back.
        self.presence.goes();
        if self.plant.has(Plant::SleepsBlindly) {
            self.word.0.store(to);
            return true;
        }
        if !self.word.0.replace(RUNNING, to) {
            self.presence.returns();
            return false;
        }
        if self.asks(was_left) {
            self.comes(to);
            return false;
        }
        true
    }

    /// The thread waits so no longer. False where it was called.
    pub fn comes(&self, from: u32) -> bool {
        let uncalled = self.word.0.replace(from, RUNNING);
        if uncalled {
            self.presence.returns();
        }
        uncalled
    }

    /// The future waits from here on. False where there is something for it.
    pub fn listens(&self, was_left: impl FnOnce() -> bool) -> bool {
        if !self.word.0.replace(RUNNING, LISTENING) {
            return false;
        }
        let left = self.asks(was_left);
        if left {
            self.word.0.replace(LISTENING, RUNNING);
        }
        !left
    }

    /// The thread begins to look. True where there is something already.
    pub fn begins_to_look(&self, was_left: impl FnOnce() -> bool) -> bool {
        !self.word.0.replace(RUNNING, LOOKING) || (!self.plant.has(Plant::LooksPastIt) && self.asks(was_left))
    }

    /// The thread looks no more. True where it was called.
    pub fn ends_its_look(&self) -> bool {
        !self.word.0.replace(LOOKING, RUNNING)
    }

    /// Whether something was left to the thread while it ran: asked once its word says that it runs no longer.
    fn asks(&self, was_left: impl FnOnce() -> bool) -> bool {
        if self.plant.has(Plant::SleepsOnIt) {
            return false;
        }
        // Pairs with the one in `runs_no_longer`: either that sees the word, or this sees what was left.
        self.fence_for_a_runner();
        was_left()
    }

    /// Whether the thread runs no longer to which something was left: asked once that lies there.
    pub fn runs_no_longer(&self) -> bool {
        if self.plant.has(Plant::TrustsTheRun) {
            return false;
        }
        self.fence_for_a_runner();
        !self.is_running()
    }

    fn fence_for_a_runner(&self) {
        if !self.plant.has(Plant::NoFenceForARunner) {
            fence(Ordering::SeqCst);
        }
    }

    #[cfg(test)]
    pub fn time_out(&self) {
        self.word.0.time_out();
    }
}
