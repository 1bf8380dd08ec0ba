//! How the thread that runs the node's futures waits: it sleeps, or it waits in the link's socket (D127). Every waker
//! of a future wakes this thread.

use crate::sync::Word;
use crate::sync::handoff::ThreadWaker;
use crate::sync::lead::Away;
use crate::sync::plant::{Plants, Sound};
use std::sync::Arc;

/// The thread polls its futures.
const RUNNING: u32 = 0;
/// The thread sleeps, or is about to.
const SLEEPING: u32 = 1;
/// The thread was called, because a future is ready to be polled.
const CALLED: u32 = 2;
/// The thread waits in the link's socket, or is about to: then `waker` wakes it.
const AWAY: u32 = 3;

pub(crate) struct Park<P = Sound> {
    word: Word,
    waker: Option<Arc<dyn ThreadWaker>>,
    plant: P,
}

/// The bugs that the explorers of schedules (loom and shuttle) must find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plant {
    /// The thread waits although it was called after its last poll.
    GoesBlindly,
    /// A thread that waits in the link's socket is not woken.
    NoWaker,
}

impl Park {
    /// Makes the state of a running thread. `waker` wakes the thread while it waits in the link's socket.
    pub fn new(waker: Option<Arc<dyn ThreadWaker>>) -> Self {
        Self::planted(waker, Sound)
    }
}

impl<P: Plants<Plant>> Park<P> {
    /// As [`new`](Park::new), with a bug planted for a test.
    pub fn planted(waker: Option<Arc<dyn ThreadWaker>>, plant: P) -> Self {
        Self { word: Word::new(RUNNING), waker, plant }
    }

    /// Notes that a future is ready to be polled, and wakes the thread.
    pub fn call(&self) {
        match self.word.swap(CALLED) {
            SLEEPING => self.word.wake(),
            AWAY if self.plant.has(Plant::NoWaker) => {}
            AWAY => self.waker.iter().for_each(|waker| waker.wake()),
            _running_or_called => {}
        }
    }

    /// Notes that the thread is about to poll all futures that are marked by now. A later call keeps the thread from
    /// waiting.
    pub fn begins(&self) {
        // The word is swapped only if the thread was called. If this load misses a call, the call still keeps the
        // thread from waiting later. A swap is needed, not a store: its acquire pairs with the swap in `call`, so the
        // thread sees all writes before the call.
        if self.word.load() != RUNNING {
            self.word.swap(RUNNING);
        }
    }

    /// Sleeps until another thread makes a call. Wake-ups may be spurious.
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
