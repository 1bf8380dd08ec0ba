//! How a task's thread waits for answers and input of other threads, and how those threads wake it: one futex word that
//! both sides change.
//!
//! ```text
//!                      goes, sleep                     mark: there is something for it
//!   RUNNING <-----------------------------> SLEEPING ------------------------------> READY
//!      ^  \---- go_away, come_home -------> AWAY --------------- a wake-up ----------> READY
//!      |    \-- begins to look, looks no more -> LOOKING ----------------------------> READY
//!      \--------------------------------------- enters ----------------------------- READY
//! ```
//!
//! While the task's thread spins, other threads leave all input in the inbox for it. While it runs, they leave only
//! input that may wait. So the task's thread checks the inbox after it has changed the word from `RUNNING`. Other
//! threads check the word after they have left input.

use crate::sync::awake::ThreadState;
use crate::sync::plant::{Plants, Sound};
use crate::sync::protected::ThreadWaker;
use crate::sync::{Ordering, Word, fence};
use std::sync::Arc;

/// The task's thread runs.
const RUNNING: u32 = 0;
/// The task's thread sleeps, or is about to.
const SLEEPING: u32 = 1;
/// There is an answer or input for the task's thread, or its program has ended: the thread must not sleep.
const READY: u32 = 2;
/// The task's thread waits in the link, or is about to: then `waker` wakes it.
pub(super) const AWAY: u32 = 3;
/// The task's thread spins on its word; it drains the inbox when it is called.
const LOOKING: u32 = 4;

/// The bugs that the explorers must find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plant {
    /// The lock's holder does not recheck the inbox after unlocking.
    NoSecondLook,
    /// An answer for the task's thread does not set the futex word to `READY`: the word is only read.
    NoMark,
    /// The futex word is set to `READY`, but no thread is woken.
    NoWake,
    /// The waker does not wake a thread that waits in the link.
    NoWaker,
    /// Stopping a task does not wake the task's thread.
    SilentStop,
    /// No fence orders the accesses to the inbox and to the lock.
    NoFence,
    /// Input is dropped if the lock is taken and the inbox is full.
    DropsWhenFull,
    /// A thread that has spun goes to sleep without checking the word again.
    SleepsBlindly,
    /// A thread that left input for a spinning thread does not check whether that thread still spins.
    TrustsTheLook,
    /// A thread that left input for a running thread does not check whether that thread still runs.
    TrustsTheRun,
    /// A thread that goes to sleep does not check for input left while it ran.
    SleepsOnIt,
    /// A thread that begins to spin does not check for input left while it ran.
    LooksPastIt,
    /// A fence between the write and the following read is missing: in a running thread, and in a thread that leaves
    /// input to it.
    NoFenceForARunner,
}

/// A value in a cache line of its own, because two cores write it in turn.
#[repr(align(64))]
struct Line<T>(T);

/// Which input other threads leave in the inbox for a task's thread.
pub(super) enum Leave {
    /// All input, because the thread spins.
    All,
    /// Only input that may wait, because the thread runs.
    SomeOfIt,
    Nothing,
}

/// The state of a task's thread before its word was marked: [`call`](Waiting::call) wakes the thread accordingly.
#[derive(Clone, Copy)]
pub(super) struct Was(u32);

impl Was {
    /// The thread needs no wake-up.
    pub const RUNNING: Self = Self(RUNNING);
}

/// How a task's thread waits and is woken.
pub(super) struct Waiting<P = Sound> {
    word: Line<Word>,
    pub thread_state: ThreadState,
    /// Wakes the task's thread if it waits elsewhere than on its word.
    waker: Option<Arc<dyn ThreadWaker>>,
    pub plant: P,
}

impl<P: Plants<Plant>> Waiting<P> {
    pub fn new(waker: Option<Arc<dyn ThreadWaker>>, plant: P) -> Self {
        Self { word: Line(Word::new(RUNNING)), thread_state: ThreadState::new(), waker, plant }
    }

    /// Which input another thread may leave to the task's thread now.
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

    /// Whether there is an answer or input for the task's thread.
    pub fn is_ready(&self) -> bool {
        self.word.0.load() == READY
    }

    /// The thread enters, under the lock. It writes only if needed, because other threads read the word's cache line.
    /// This is a swap, because another thread may call the spinning thread at this moment: the acquire pairs with the
    /// `replace` in `call_waiter`, so this thread sees all input that was left before that call.
    pub fn comes_in(&self) {
        if !self.is_running() {
            self.word.0.swap(RUNNING);
        }
    }

    /// Marks the word `READY`. The word stays `READY` until the thread enters.
    pub fn ready(&self) -> Was {
        Was(self.word.0.swap(READY))
    }

    /// Marks the word because there is an answer.
    pub fn mark(&self) -> Was {
        if self.plant.has(Plant::NoMark) {
            return Was(self.word.0.load());
        }
        let was = self.ready();
        if self.plant.has(Plant::NoWake) { Was::RUNNING } else { was }
    }

    /// Wakes the thread from the state that it had before its word was marked.
    pub fn call(&self, Was(was): Was) {
        if was == SLEEPING || was == AWAY {
            self.thread_state.returns();
        }
        if was == SLEEPING {
            self.word.0.wake();
        }
        if self.plant.has(Plant::NoWaker) {
            return;
        }
        if let Some(waker) = self.waker.as_ref().filter(|_| was == AWAY) {
            waker.wake();
        }
    }

    /// Tells a spinning thread that input was left to it. Returns false if the thread no longer spins, or was called before.
    pub fn call_waiter(&self) -> bool {
        self.word.0.replace(LOOKING, READY) || self.plant.has(Plant::TrustsTheLook)
    }

    /// Sleeps until the word is marked or `deadline` passes, unless `was_left` says that there is input. Returns false
    /// if there was input or an answer already.
    pub fn sleep(&self, deadline: Option<u64>, was_left: impl FnOnce() -> bool) -> bool {
        if !self.goes(SLEEPING, was_left) {
            return false;
        }
        self.word.0.wait(SLEEPING, deadline);
        self.comes(SLEEPING);
        true
    }

    /// The thread is about to wait in state `to`. Returns false if there is an answer or input for it.
    pub fn goes(&self, to: u32, was_left: impl FnOnce() -> bool) -> bool {
        // This comes before the word changes, because a thread that sees the new word and wakes this thread counts it
        // as running again.
        self.thread_state.goes();
        if self.plant.has(Plant::SleepsBlindly) {
            self.word.0.store(to);
            return true;
        }
        if !self.word.0.replace(RUNNING, to) {
            self.thread_state.returns();
            return false;
        }
        if self.asks(was_left) {
            self.comes(to);
            return false;
        }
        true
    }

    /// The thread leaves its waiting state `from`. Returns false if it was called.
    pub fn comes(&self, from: u32) -> bool {
        let uncalled = self.word.0.replace(from, RUNNING);
        if uncalled {
            self.thread_state.returns();
        }
        uncalled
    }

    /// The thread begins to spin. Returns true if there is an answer or input for it already.
    pub fn begins_to_look(&self, was_left: impl FnOnce() -> bool) -> bool {
        !self.word.0.replace(RUNNING, LOOKING) || (!self.plant.has(Plant::LooksPastIt) && self.asks(was_left))
    }

    /// The thread stops spinning. Returns true if it was called.
    pub fn ends_its_look(&self) -> bool {
        !self.word.0.replace(LOOKING, RUNNING)
    }

    /// Whether input was left to the thread while it ran. Called after the word has left `RUNNING`.
    fn asks(&self, was_left: impl FnOnce() -> bool) -> bool {
        if self.plant.has(Plant::SleepsOnIt) {
            return false;
        }
        // This fence pairs with the fence in `runs_no_longer`: either the load there sees the new word, or `was_left`
        // sees the new inbox count.
        self.fence_for_a_runner();
        was_left()
    }

    /// Whether the thread to which input was left no longer runs. Called after the input is in the inbox. The fence,
    /// between the store of the inbox count and the load of the word, pairs with the fence in `asks`.
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
