//! The hand-off between threads and one domain of communication tasks: a combining lock with an inbox (D39, D40, D186).
//!
//! A communication task is a data structure, and the thread that brings input runs it. There are two ways to call it:
//!
//! - [`Handoff::deliver`] is for every thread. If the lock is free, the thread takes it and works for all threads (flat
//!   combining). If not, the thread leaves its input in the [`Inbox`] and goes on. The holder rechecks the inbox after
//!   unlocking, so no input stays behind.
//! - [`Handoff::enter_and`] is for the task's own thread, which needs the answer.
//!
//! The answer (`Completion`) is written under the lock, together with the word on which the task's thread [waits](Waiting).
//! While that word says that the thread spins, other threads leave their input to it. The thread spins on the inbox, too, so its
//! communication task stays in one core's cache (D128). If the thread runs, they leave only input that may wait (D130).
//!
//! The shared part knows nothing of messages: it is generic over the [`Protected`], so that tests can explore its interleavings
//! with a state machine of two states.

use crate::sync::awake::ThreadState;
use crate::sync::inbox::{self, Inbox, Taker};
use crate::sync::lead::Away;
use crate::sync::plant::{Plants, Sound};
pub(crate) use crate::sync::protected::{Entry, Protected, Rest, ThreadWaker};
pub(crate) use crate::sync::waiting::Plant;
use crate::sync::waiting::{AWAY, Waiting, Was};
use crate::sync::{Mutex, MutexGuard, Ordering, fence, lock, try_lock};
use std::collections::VecDeque;
use std::sync::Arc;

pub(crate) struct Handoff<S: Protected, P = Sound> {
    core: Mutex<Core<S>>,
    pub inbox: Inbox<S::Input>,
    waiting: Waiting<P>,
}

struct Core<S: Protected> {
    protected: S,
    completion: Option<S::Completion>,
    taker: Taker,
    resting: bool,
    stopped: bool,
}

impl<S: Protected> Handoff<S> {
    /// Makes the hand-off. `waker` wakes the task's thread in the link's socket ([`go_away`](Self::go_away)).
    pub fn new(protected: S, waker: Option<Arc<dyn ThreadWaker>>) -> Self {
        Self::planted(protected, waker, Sound)
    }
}

impl<S: Protected, P: Plants<Plant>> Handoff<S, P> {
    /// As [`new`](Handoff::new), with a bug planted for a test.
    pub fn planted(protected: S, waker: Option<Arc<dyn ThreadWaker>>, plant: P) -> Self {
        let (inbox, taker) = Inbox::new();
        Self {
            core: Mutex::new(Core { protected, completion: None, taker, resting: false, stopped: false }),
            inbox,
            waiting: Waiting::new(waker, plant),
        }
    }

    /// Whether the task's thread runs, visible to all other threads.
    pub const fn thread_state(&self) -> &ThreadState {
        &self.waiting.thread_state
    }

    /// Brings input from any thread. On return the input has been taken, or will be soon: by the current or the next
    /// holder of the lock, or by the task's thread.
    pub fn deliver(&self, mut input: S::Input, effects: &mut S::Effects) {
        let may_wait = S::may_wait(&input) && self.inbox.is_entered();
        if !self.waiting.may_take(may_wait)
            && let Some(core) = try_lock(&self.core)
        {
            self.work(core, Some(&mut input), effects);
            return self.second_look(effects);
        }
        match self.inbox.leave(input) {
            Ok(is_too_much) if self.waiting.takes(may_wait && !is_too_much) => return,
            Ok(true) => self.inbox.is_too_much(),
            Ok(false) => {}
            Err(_) if self.has(Plant::DropsWhenFull) => return,
            // The lock is held for a bounded time, so this wait is bounded too.
            Err(mut input) => self.work(lock(&self.core), Some(&mut input), effects),
        }
        self.second_look(effects);
    }

    /// As [`deliver`](Self::deliver), for several inputs under one lock: takes all of `inputs`, in order.
    pub fn deliver_all(&self, inputs: &mut VecDeque<S::Input>, effects: &mut S::Effects) {
        if !self.waiting.may_take(false)
            && let Some(core) = try_lock(&self.core)
        {
            self.work(core, inputs.iter_mut(), effects);
            inputs.clear();
        }
        while let Some(input) = inputs.pop_front() {
            if let Err(mut input) = self.leave(input)
                && !self.has(Plant::DropsWhenFull)
            {
                self.work(lock(&self.core), std::iter::once(&mut input).chain(inputs.iter_mut()), effects);
                inputs.clear();
            }
        }
        if !self.waiting.takes(false) && !self.has(Plant::LeavesItsBundle) {
            self.second_look(effects);
        }
    }

    /// As [`deliver`](Self::deliver), but on return the input has been taken.
    pub fn deliver_now(&self, mut input: S::Input, effects: &mut S::Effects) {
        self.work(lock(&self.core), Some(&mut input), effects);
        self.second_look(effects);
    }

    /// Brings one input from the task's own thread, as [`enter_and`](Self::enter_and) does.
    #[cfg(test)]
    pub fn enter(&self, input: S::Input, effects: &mut S::Effects) -> Entry<S::Completion> {
        self.enter_and(input, |_| None, effects)
    }

    /// Brings input from the task's own thread, and takes the answer if there is one. Each answer is passed to
    /// `more`. If `more` returns another input, this is brought under the same lock.
    pub fn enter_and(
        &self,
        mut input: S::Input,
        more: impl FnMut(&S::Completion) -> Option<S::Input>,
        effects: &mut S::Effects,
    ) -> Entry<S::Completion> {
        let mut core = self.come_in();
        self.drain(&mut core, effects);
        core.feed(&mut input, effects);
        self.go_on(core, more, effects)
    }

    /// As [`enter_and`](Self::enter_and), for a thread that has waited: if there is an answer, `input` is not used.
    pub fn come_back_and(
        &self,
        mut input: S::Input,
        more: impl FnMut(&S::Completion) -> Option<S::Input>,
        effects: &mut S::Effects,
    ) -> Entry<S::Completion> {
        let mut core = self.come_in();
        self.drain(&mut core, effects);
        if core.completion.is_none() {
            core.feed(&mut input, effects);
        }
        self.go_on(core, more, effects)
    }

    fn come_in(&self) -> MutexGuard<'_, Core<S>> {
        let mut core = lock(&self.core);
        self.waiting.comes_in();
        self.inbox.come_in();
        core.resting = false;
        core
    }

    fn go_on(
        &self,
        mut core: MutexGuard<'_, Core<S>>,
        mut more: impl FnMut(&S::Completion) -> Option<S::Input>,
        effects: &mut S::Effects,
    ) -> Entry<S::Completion> {
        let completion = loop {
            let completion = core.completion.take();
            let Some(mut next) = completion.as_ref().and_then(&mut more) else { break completion };
            // Draining the inbox moves its cache line to this core, but a full inbox makes other threads wait for the lock.
            if self.inbox.is_half_full() {
                self.inbox.come_in();
                self.drain(&mut core, effects);
            }
            core.feed(&mut next, effects);
        };
        let stopped = core.stopped;
        core.resting = completion.is_none() && !stopped;
        let rest = if core.resting { Rest::Begins } else { Rest::No };
        let until = core.protected.settle(rest, effects);
        drop(core);
        self.second_look(effects);
        Entry { completion, stopped, until }
    }

    /// As [`enter_and`](Self::enter_and), for one of several tasks that share this hand-off. No thread of these tasks
    /// sleeps here, and their answers are in the protected state. `work` takes an answer from there, or brings the
    /// input. Also returns whether the node stops.
    pub fn enter_shared<R>(
        &self,
        work: impl FnOnce(&mut S, &mut S::Effects) -> R,
        effects: &mut S::Effects,
    ) -> (R, bool) {
        let mut core = lock(&self.core);
        self.drain(&mut core, effects);
        let done = work(&mut core.protected, effects);
        core.protected.settle(Rest::No, effects);
        let stopped = core.stopped;
        drop(core);
        self.second_look(effects);
        (done, stopped)
    }

    /// Sleeps until there is an answer, the node stops, or `deadline` (nanoseconds of the monotonic clock) passes.
    /// Wake-ups may be spurious, so the caller checks again under the lock. Returns false, without sleeping, if there
    /// was an answer or input already.
    pub fn sleep(&self, deadline: Option<u64>) -> bool {
        self.waiting.sleep(deadline, || self.has_left())
    }

    /// Whether there is an answer or input for the task's thread, or the node stops. The thread may check this before it sleeps.
    pub fn is_called(&self) -> bool {
        self.waiting.is_ready()
    }

    /// Whether input was left in the inbox.
    pub fn has_left(&self) -> bool {
        !self.inbox.is_empty()
    }

    /// Spins until an event ends the wait of the task's thread: `look` calls its argument as long as spinning pays.
    /// From the first such call on, other threads leave their input to this thread. `take_in` receives from the
    /// link's socket. Returns whether there is an answer or input for the thread.
    pub fn look(
        &self,
        mut take_in: impl FnMut() -> bool,
        look: impl FnOnce(&mut dyn FnMut() -> bool) -> bool,
    ) -> bool {
        let mut looks = false;
        let mut there = || {
            let begins = !std::mem::replace(&mut looks, true);
            let is_there = || self.is_called() || (self.has_left() && !self.has(Plant::LooksPastIt));
            (begins && self.waiting.begins_to_look()) || is_there() || (take_in() && is_there())
        };
        let found = look(&mut there);
        found || (looks && self.waiting.ends_its_look())
    }

    /// Ends all waits of the task, now and later.
    pub fn stop(&self, effects: &mut S::Effects) {
        let mut core = lock(&self.core);
        core.stopped = true;
        let was = self.waiting.ready();
        drop(core);
        if !self.has(Plant::SilentStop) {
            self.waiting.call(was);
        }
        self.second_look(effects);
    }

    /// Notes that the task's thread never enters again, so that other threads leave no input for it any more.
    pub fn end(&self, effects: &mut S::Effects) {
        self.waiting.ready();
        self.second_look(effects);
    }

    /// Drains the inbox, unless another thread holds the lock.
    pub fn wake(&self, effects: &mut S::Effects) {
        self.second_look(effects);
    }

    /// Calls `visit` with the protected state, from any thread. The visit may change the state and cause effects.
    pub fn visit(&self, visit: impl FnOnce(&mut S, &mut S::Effects), effects: &mut S::Effects) {
        // The inbox is drained first, because its input may lead to an answer, and only `work` marks the word.
        self.second_look(effects);
        let mut core = lock(&self.core);
        visit(&mut core.protected, effects);
        core.protected.work_inside(effects);
        let rest = if core.resting { Rest::GoesOn } else { Rest::No };
        core.protected.settle(rest, effects);
        drop(core);
        self.second_look(effects);
    }

    /// Calls `look` with the protected state under its lock, after draining the inbox.
    pub fn with<R>(&self, look: impl FnOnce(&mut S) -> R, effects: &mut S::Effects) -> R {
        let mut core = lock(&self.core);
        let seen = if self.inbox.is_empty() {
            let seen = look(&mut core.protected);
            drop(core);
            seen
        } else {
            self.work_and(core, None, look, effects)
        };
        self.second_look(effects);
        seen
    }

    /// As [`with`](Self::with), without draining the inbox.
    #[cfg(test)]
    pub fn look_at<R>(&self, look: impl FnOnce(&mut S) -> R) -> R {
        look(&mut lock(&self.core).protected)
    }

    #[cfg(test)]
    pub fn time_out(&self) {
        self.waiting.time_out();
    }

    /// Puts input into the inbox without taking the lock; returns the input if the inbox is full. The next thread
    /// that takes the lock processes it. The caller calls [`wake`](Self::wake) later, so that some thread does.
    pub fn leave(&self, input: S::Input) -> Result<(), S::Input> {
        self.inbox.leave(input).map(|_| ())
    }

    fn work<'a>(
        &self,
        core: MutexGuard<'_, Core<S>>,
        inputs: impl IntoIterator<Item = &'a mut S::Input>,
        effects: &mut S::Effects,
    ) where
        S::Input: 'a,
    {
        self.work_and(core, inputs, |_| (), effects);
    }

    /// Drains the inbox, feeds `inputs`, and then calls `then` with the protected state.
    fn work_and<'a, R>(
        &self,
        mut core: MutexGuard<'_, Core<S>>,
        inputs: impl IntoIterator<Item = &'a mut S::Input>,
        then: impl FnOnce(&mut S) -> R,
        effects: &mut S::Effects,
    ) -> R
    where
        S::Input: 'a,
    {
        let had_completion = core.completion.is_some();
        let overtakes = self.has(Plant::Overtakes);
        if !overtakes {
            self.drain(&mut core, effects);
        }
        for input in inputs {
            core.feed(input, effects);
        }
        if overtakes {
            self.drain(&mut core, effects);
        }
        core.protected.work_inside(effects);
        let new_completion = !had_completion && core.completion.is_some();
        core.resting &= !new_completion;
        let done = then(&mut core.protected);
        let rest = if core.resting { Rest::GoesOn } else { Rest::No };
        core.protected.settle(rest, effects);
        // The word is marked last, because a spinning thread of the task tries to take the lock as soon as it sees the mark.
        let was = if new_completion { self.waiting.mark() } else { Was::RUNNING };
        drop(core);
        self.waiting.call(was);
        done
    }

    /// Takes the inputs in the inbox: at most as many as fit into it, so that the lock is held for a bounded time.
    fn drain(&self, core: &mut Core<S>, effects: &mut S::Effects) {
        for _ in 0..inbox::ROOM {
            let Some(mut input) = self.inbox.take(&mut core.taker) else { return };
            core.feed(&mut input, effects);
        }
    }

    /// Drains the inbox of input that was left while the lock was taken. The fence pairs with the same fence in another thread. A
    /// thread that leaves input stores the inbox count before its fence and tries the lock after it. The holder unlocks before
    /// its fence and loads the count after it. So either the first thread gets the lock, or the holder sees the input.
    fn second_look(&self, effects: &mut S::Effects) {
        if self.has(Plant::NoSecondLook) {
            return;
        }
        loop {
            self.fence();
            if self.inbox.is_empty() {
                return;
            }
            let Some(core) = try_lock(&self.core) else { return };
            self.work(core, None, effects);
        }
    }

    fn fence(&self) {
        if !self.has(Plant::NoFence) {
            fence(Ordering::SeqCst);
        }
    }

    fn has(&self, bug: Plant) -> bool {
        self.waiting.plant.has(bug)
    }
}

impl<S: Protected, P: Plants<Plant>> Away for Handoff<S, P> {
    fn go_away(&self) -> bool {
        self.waiting.goes(AWAY, || self.has_left())
    }

    fn come_home(&self) -> bool {
        self.waiting.comes(AWAY)
    }
}

impl<S: Protected> Core<S> {
    fn feed(&mut self, input: &mut S::Input, effects: &mut S::Effects) {
        if let Some(completion) = self.protected.feed(input, effects) {
            self.completion = Some(completion);
        }
    }
}
