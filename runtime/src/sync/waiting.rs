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
//! The *inbox* is a ring of slots for input that other threads leave. While the thread spins, other threads leave all
//! input there. While the thread runs, they leave only input that may wait. So the thread changes its word first and
//! then checks the inbox, and the other threads leave input first and then check the word.

use crate::sync::awake::ThreadState;
use crate::sync::plant::{Plants, Sound};
use crate::sync::protected::ThreadWaker;
use crate::sync::{Line, Ordering, Word, fence};
use std::sync::Arc;

/// The task's thread runs.
const RUNNING: u32 = 0;
/// The task's thread sleeps, or is about to.
const SLEEPING: u32 = 1;
/// There is an answer or input for the task's thread, or its program has ended: the thread must not sleep.
const READY: u32 = 2;
/// The task's thread waits in the link's socket, or is about to: then `waker` wakes it.
pub(super) const AWAY: u32 = 3;
/// The task's thread spins on its word and on the inbox.
const LOOKING: u32 = 4;

/// The bugs that the explorers of schedules (loom and shuttle) must find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plant {
    /// The lock's holder does not recheck the inbox after unlocking.
    NoSecondLook,
    /// An answer for the task's thread does not set the futex word to `READY`: the word is only read.
    NoMark,
    /// The futex word is set to `READY`, but no thread is woken.
    NoWake,
    /// The waker does not wake a thread that waits in the link's socket.
    NoWaker,
    /// Stopping a task does not wake the task's thread.
    SilentStop,
    /// No fence orders the accesses to the inbox and to the lock.
    NoFence,
    /// Input is dropped if the lock is taken and the inbox is full.
    DropsWhenFull,
    /// A thread that left inputs of a bundle does not check whether the lock was released meanwhile.
    LeavesItsBundle,
    /// The lock's holder processes its own input before the input that was left in the inbox.
    Overtakes,
    /// A thread that has spun goes to sleep without checking its word again.
    SleepsBlindly,
    /// After leaving input that must not wait, a thread does not check whether the task's thread still spins.
    TrustsTheLook,
    /// After leaving input that may wait, a thread does not check whether the task's thread still runs.
    TrustsTheRun,
    /// A thread goes to sleep without checking for input that was left to it.
    SleepsOnIt,
    /// A spinning thread checks only its word, and not the inbox.
    LooksPastIt,
    /// Both threads lack the fence between their write and their read: the one that leaves input, and the task's
    /// thread.
    NoFenceForARunner,
}

/// The state of a task's thread before its word was marked: [`call`](Waiting::call) wakes the thread accordingly.
#[derive(Clone, Copy)]
pub(super) struct Was(u32);

impl Was {
    /// The value for a thread that ran, and so needs no wake-up.
    pub const RUNNING: Self = Self(RUNNING);
}

/// How a task's thread waits and is woken.
pub(super) struct Waiting<P = Sound> {
    word: Line<Word>,
    pub thread_state: ThreadState,
    /// Wakes the task's thread if it waits in the link's socket, and not on its futex word.
    waker: Option<Arc<dyn ThreadWaker>>,
    pub plant: P,
}

impl<P: Plants<Plant>> Waiting<P> {
    pub fn new(waker: Option<Arc<dyn ThreadWaker>>, plant: P) -> Self {
        Self { word: Line(Word::new(RUNNING)), thread_state: ThreadState::new(), waker, plant }
    }

    fn is_running(&self) -> bool {
        self.word.0.load() == RUNNING
    }

    /// Whether the task's thread will soon take input that other threads leave for it. `may_wait` says whether the
    /// input may wait for a running thread. The result may change at any time, so a thread that has left input [asks
    /// again](Self::takes).
    pub fn may_take(&self, may_wait: bool) -> bool {
        match self.word.0.load() {
            LOOKING => true,
            RUNNING => may_wait,
            _ => false,
        }
    }

    /// Whether there is an answer or input for the task's thread.
    pub fn is_ready(&self) -> bool {
        self.word.0.load() == READY
    }

    /// Notes that the task's thread enters the hand-off; the thread holds the lock. The word is written only if it
    /// changes, because other threads read its cache line. All other writes of the word happen under the lock, too.
    pub fn comes_in(&self) {
        if !self.is_running() {
            self.word.0.store(RUNNING);
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

    /// Wakes the thread if it needs that: `was` is its state before its word was marked.
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

    /// Sleeps until the word is marked or `deadline` passes. Returns false, without sleeping, if there is an answer, or
    /// if `was_left` says that input was left.
    pub fn sleep(&self, deadline: Option<u64>, was_left: impl FnOnce() -> bool) -> bool {
        if !self.goes(SLEEPING, was_left) {
            return false;
        }
        self.word.0.wait(SLEEPING, deadline);
        self.comes(SLEEPING);
        true
    }

    /// Notes that the thread is about to wait, in the state `to`. Returns false if there is an answer or input for the
    /// thread.
    pub fn goes(&self, to: u32, was_left: impl FnOnce() -> bool) -> bool {
        // This must precede the change of the word: a thread that sees the new word and wakes this thread counts it
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

    /// Notes that the thread leaves its waiting state `from`. Returns false if another thread has called it.
    pub fn comes(&self, from: u32) -> bool {
        let uncalled = self.word.0.replace(from, RUNNING);
        if uncalled {
            self.thread_state.returns();
        }
        uncalled
    }

    /// Notes that the thread begins to spin. Returns true if there is an answer or input for the thread already.
    pub fn begins_to_look(&self) -> bool {
        !self.word.0.replace(RUNNING, LOOKING)
    }

    /// Notes that the thread stops spinning. Returns true if another thread has called it.
    pub fn ends_its_look(&self) -> bool {
        !self.word.0.replace(LOOKING, RUNNING)
    }

    /// Whether input was left for the thread while it ran or spun. Called after the word shows that the thread waits.
    fn asks(&self, was_left: impl FnOnce() -> bool) -> bool {
        if self.plant.has(Plant::SleepsOnIt) {
            return false;
        }
        // This fence pairs with the one in `takes`: either the load there sees the new word, or `was_left` here sees
        // the new input.
        self.fence_for_a_runner();
        was_left()
    }

    /// Whether the task's thread will take the input that was left for it a moment ago. `may_wait` says whether the
    /// input may wait for a running thread. The fence is between the store into the inbox and the load of the word.
    /// It pairs with two others: the one in `asks`, and the one that the task's thread makes after a call, before it
    /// rechecks the inbox.
    pub fn takes(&self, may_wait: bool) -> bool {
        self.fence_for_a_runner();
        self.may_take(may_wait)
            || self.plant.has(if may_wait { Plant::TrustsTheRun } else { Plant::TrustsTheLook })
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
