//! What the thread of the node's futures waits on (D127): asleep, or away in the link. Whatever wakes a future calls it.

use crate::sync::Word;
use crate::sync::handoff::Bell;
use crate::sync::lead::Away;
use crate::sync::plant::{Plants, Sound};
use std::sync::Arc;

/// The thread polls its futures.
const RUNNING: u32 = 0;
/// It sleeps, or is about to.
const SLEEPING: u32 = 1;
/// It was called: there is a future to be polled.
const CALLED: u32 = 2;
/// It waits elsewhere, or is about to: the bell calls it.
const AWAY: u32 = 3;

pub(crate) struct Park<P = Sound> {
    word: Word,
    bell: Option<Arc<dyn Bell>>,
    plant: P,
}

/// The bugs that the explorers must find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plant {
    /// The thread goes though it was called after it had polled.
    GoesBlindly,
    /// Who is away is not called.
    NoBell,
}

impl Park {
    /// `bell` calls the thread where it is away.
    pub fn new(bell: Option<Arc<dyn Bell>>) -> Self {
        Self::planted(bell, Sound)
    }
}

impl<P: Plants<Plant>> Park<P> {
    /// As [`new`](Park::new), with a bug.
    pub fn planted(bell: Option<Arc<dyn Bell>>, plant: P) -> Self {
        Self { word: Word::new(RUNNING), bell, plant }
    }

    /// There is a future to be polled.
    pub fn call(&self) {
        match self.word.swap(CALLED) {
            SLEEPING => self.word.wake(),
            AWAY if self.plant.has(Plant::NoBell) => {}
            AWAY => self.bell.iter().for_each(|bell| bell.ring()),
            _running_or_called => {}
        }
    }

    /// The thread is about to poll whatever was woken until now. Who calls later keeps it from waiting.
    pub fn begins(&self) {
        // Not a store: what was written before the call is seen.
        self.word.swap(RUNNING);
    }

    /// Sleeps until there is a call, or for no reason less long.
    pub fn sleep(&self) {
        if self.goes(SLEEPING) {
            self.word.wait(SLEEPING, None);
            self.word.replace(SLEEPING, RUNNING);
        }
    }

    fn goes(&self, to: u32) -> bool {
        if self.plant.has(Plant::GoesBlindly) {
            self.word.swap(to);
            return true;
        }
        self.word.replace(RUNNING, to)
    }
}

impl<P: Plants<Plant>> Away for Park<P> {
    fn go_away(&self) -> bool {
        self.goes(AWAY)
    }

    fn come_home(&self) -> bool {
        self.word.replace(AWAY, RUNNING)
    }
}
