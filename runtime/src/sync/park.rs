//! Where the thread of the node's futures waits: asleep, or away, that is in the link (D127). Every waker of a future calls it.

use crate::sync::Word;
use crate::sync::handoff::ThreadWaker;
use crate::sync::lead::Away;
use crate::sync::plant::{Plants, Sound};
use std::sync::Arc;

/// The thread polls its futures.
const RUNNING: u32 = 0;
/// The thread sleeps, or is about to.
const SLEEPING: u32 = 1;
/// The thread was called: a future is ready to be polled.
const CALLED: u32 = 2;
/// The thread waits in the link, or is about to: the waker wakes it.
const AWAY: u32 = 3;

pub(crate) struct Park<P = Sound> {
    word: Word,
    waker: Option<Arc<dyn ThreadWaker>>,
    plant: P,
}

/// The bugs that the explorers must find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plant {
    /// The thread parks although it was called after its last poll.
    GoesBlindly,
    /// A thread that is away is not woken.
    NoWaker,
}

impl Park {
    /// `waker` wakes the thread while it is away.
    pub fn new(waker: Option<Arc<dyn ThreadWaker>>) -> Self {
        Self::planted(waker, Sound)
    }
}

impl<P: Plants<Plant>> Park<P> {
    /// As [`new`](Park::new), with a bug planted for a test.
    pub fn planted(waker: Option<Arc<dyn ThreadWaker>>, plant: P) -> Self {
        Self { word: Word::new(RUNNING), waker, plant }
    }

    /// Says that a future is ready to be polled, and wakes the thread.
    pub fn call(&self) {
        match self.word.swap(CALLED) {
            SLEEPING => self.word.wake(),
            AWAY if self.plant.has(Plant::NoWaker) => {}
            AWAY => self.waker.iter().for_each(|waker| waker.wake()),
            _running_or_called => {}
        }
    }

    /// The thread is about to poll all futures woken so far. A later call keeps it from waiting.
    pub fn begins(&self) {
        // The word is swapped only if the thread was called. A call that this load misses keeps the thread from waiting
        // later. It is a swap and not a store, because its acquire pairs with the swap in `call`, so the thread sees
        // what was written before the call.
        if self.word.load() != RUNNING {
            self.word.swap(RUNNING);
        }
    }

    /// Sleeps until there is a call. Wake-ups may be spurious.
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
