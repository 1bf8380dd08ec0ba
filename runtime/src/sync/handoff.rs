//! The hand-off between threads and one communication task (D39, D40).
//!
//! The communication task is a data structure run by whoever brings it input. Two doors lead to it:
//!
//! - [`Handoff::deliver`] is for everybody: whoever gets the lock works for all (flat combining); whoever does not,
//!   leaves the input in the [`Inbox`] and goes on. The holder of the lock looks into it once more after it has let
//!   go, so nothing stays behind.
//! - [`Handoff::enter_and`] is for the task's own thread, which needs the answer.
//!
//! The answer is mail: written under the lock, together with the word that says so, on which the task's thread [waits](Waiting).
//! While that says that the thread looks, what is brought is left to it: it is there at once, and its communication task
//! stays where it is, in the near cache of one core (D128). To a thread that runs is left what may wait until it comes in (D130).
//!
//! The shared part knows nothing of messages: it is generic over the [`Station`], so that the tests can explore every
//! interleaving with a station of two states.

use crate::sync::awake::Presence;
use crate::sync::inbox::Inbox;
use crate::sync::lead::Away;
use crate::sync::plant::{Plants, Sound};
pub(crate) use crate::sync::station::{Bell, Entry, Rest, Station};
pub(crate) use crate::sync::waiting::Plant;
use crate::sync::waiting::{AWAY, Leave, Waiting, Was};
use crate::sync::{Mutex, MutexGuard, Ordering, fence, lock, try_lock};
use std::collections::VecDeque;
use std::sync::Arc;

pub(crate) struct Handoff<S: Station, P = Sound> {
    core: Mutex<Core<S>>,
    pub inbox: Inbox<S::Input>,
    waiting: Waiting<P>,
}

struct Core<S: Station> {
    station: S,
    mail: Option<S::Mail>,
    /// The spare inbox: swapped with the full one.
    batch: Vec<S::Input>,
    resting: bool,
    stopped: bool,
}

impl<S: Station> Handoff<S> {
    /// `bell` calls the task's thread where it waits elsewhere ([`go_away`](Self::go_away)).
    pub fn new(station: S, bell: Option<Arc<dyn Bell>>) -> Self {
        Self::planted(station, bell, Sound)
    }
}

impl<S: Station, P: Plants<Plant>> Handoff<S, P> {
    /// As [`new`](Handoff::new), with a bug.
    pub fn planted(station: S, bell: Option<Arc<dyn Bell>>, plant: P) -> Self {
        let batch = Inbox::<S::Input>::spare();
        Self {
            core: Mutex::new(Core { station, mail: None, batch, resting: false, stopped: false }),
            inbox: Inbox::new(),
            waiting: Waiting::new(bell, plant),
        }
    }

    /// Whether the task's thread runs, told to all others.
    pub const fn presence(&self) -> &Presence {
        &self.waiting.presence
    }

    /// Brings input from anywhere. It has been taken, or will be by whoever holds the lock or has it next.
    pub fn deliver(&self, input: S::Input, effects: &mut S::Effects) {
        let left = match self.waiting.leaves() {
            Leave::All => self.leave(input).map(|()| self.call_looker(effects)),
            Leave::SomeOfIt if S::may_wait(&input) => {
                self.inbox.leave_to_runner(input).map(|()| self.look_after_runner(effects))
            }
            Leave::SomeOfIt | Leave::Nothing => Err(input),
        };
        let Err(input) = left else { return };
        if let Some(core) = try_lock(&self.core) {
            self.work(core, Some(input), effects);
        } else if let Err(input) = self.leave(input) {
            if self.has(Plant::DropsWhenFull) {
                return;
            }
            // The lock is held for a bounded time, so this wait is bounded too.
            self.work(lock(&self.core), Some(input), effects);
        }
        self.second_look(effects);
    }

    /// As [`deliver`](Self::deliver), for several inputs under one lock: takes all of `inputs`, the first one first.
    pub fn deliver_all(&self, inputs: &mut VecDeque<S::Input>, effects: &mut S::Effects) {
        if self.waiting.is_looking() {
            while let Some(input) = inputs.pop_front() {
                if let Err(input) = self.leave(input) {
                    inputs.push_front(input);
                    break;
                }
            }
            if inputs.is_empty() {
                return self.call_looker(effects);
            }
        }
        if let Some(core) = try_lock(&self.core) {
            self.work(core, inputs.drain(..), effects);
        }
        while let Some(input) = inputs.pop_front() {
            if let Err(input) = self.leave(input) {
                self.work(lock(&self.core), std::iter::once(input).chain(inputs.drain(..)), effects);
            }
        }
        self.second_look(effects);
    }

    /// As [`deliver`](Self::deliver), and the input has been taken on return.
    pub fn deliver_now(&self, input: S::Input, effects: &mut S::Effects) {
        self.work(lock(&self.core), Some(input), effects);
        self.second_look(effects);
    }

    /// As [`enter_and`](Self::enter_and), once.
    #[cfg(test)]
    pub fn enter(&self, input: S::Input, effects: &mut S::Effects) -> Entry<S::Mail> {
        self.enter_and(input, |_| None, effects)
    }

    /// Brings input from the task's own thread and takes what there is for it. Goes on under the same lock: as long as there
    /// is an answer for which `more` has another input, that one is brought, too.
    pub fn enter_and(
        &self,
        input: S::Input,
        more: impl FnMut(&S::Mail) -> Option<S::Input>,
        effects: &mut S::Effects,
    ) -> Entry<S::Mail> {
        let mut core = self.come_in();
        self.drain(&mut core, effects);
        core.feed(input, effects);
        self.go_on(core, more, effects)
    }

    /// As [`enter_and`](Self::enter_and), of a thread that has waited: where there is an answer, it brings nothing.
    pub fn come_back_and(
        &self,
        input: S::Input,
        more: impl FnMut(&S::Mail) -> Option<S::Input>,
        effects: &mut S::Effects,
    ) -> Entry<S::Mail> {
        let mut core = self.come_in();
        self.drain(&mut core, effects);
        if core.mail.is_none() {
            core.feed(input, effects);
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
        mut more: impl FnMut(&S::Mail) -> Option<S::Input>,
        effects: &mut S::Effects,
    ) -> Entry<S::Mail> {
        let mail = loop {
            let mail = core.mail.take();
            let Some(next) = mail.as_ref().and_then(&mut more) else { break mail };
            // Not for each: the inbox is on its way between two cores. Never full, so that nobody waits for the lock.
            if self.inbox.is_half_full() {
                self.inbox.come_in();
                self.drain(&mut core, effects);
            }
            core.feed(next, effects);
        };
        let stopped = core.stopped;
        core.resting = mail.is_none() && !stopped;
        let rest = if core.resting { Rest::Begins } else { Rest::No };
        let until = core.station.settle(rest, effects);
        drop(core);
        self.second_look(effects);
        Entry { mail, stopped, until }
    }

    /// As [`enter`](Self::enter), for a task that is a future: it never rests, so others look after its time; and where there
    /// is an answer already, it takes that and brings nothing.
    pub fn enter_awake(&self, input: S::Input, effects: &mut S::Effects) -> Entry<S::Mail> {
        let mut core = lock(&self.core);
        self.waiting.is_polled();
        let (mail, until) = if core.mail.is_some() {
            // Whoever brought it has settled what follows.
            (core.mail.take(), u64::MAX)
        } else {
            self.drain(&mut core, effects);
            if core.mail.is_none() {
                core.feed(input, effects);
            }
            (core.mail.take(), core.station.settle(Rest::No, effects))
        };
        let stopped = core.stopped;
        drop(core);
        self.second_look(effects);
        Entry { mail, stopped, until }
    }

    /// The future waits from here on; the bell calls it. False where there is something for it already.
    pub fn listen(&self) -> bool {
        self.waiting.listens(|| self.has_left())
    }

    /// Sleeps until there is mail, the node stops, or `deadline` (nanoseconds of the monotonic clock) has passed. May
    /// return early for no reason: the caller enters again and looks. False where there was something already.
    pub fn sleep(&self, deadline: Option<u64>) -> bool {
        self.waiting.sleep(deadline, || self.has_left())
    }

    /// Whether there is something for the task's thread, or the node stops: what it may look at before it sleeps.
    pub fn is_called(&self) -> bool {
        self.waiting.is_ready()
    }

    /// Whether something was left.
    pub fn has_left(&self) -> bool {
        !self.inbox.is_empty()
    }

    /// The task's thread looks for what ends its wait: `look` tests for it as often as that is worth it. From the first test
    /// on, what is brought is left to this thread. `take_in` is to bring what may have come elsewhere. Whether there is
    /// something.
    pub fn look(
        &self,
        mut take_in: impl FnMut() -> bool,
        look: impl FnOnce(&mut dyn FnMut() -> bool) -> bool,
    ) -> bool {
        let mut looks = false;
        let mut there = || {
            let begins = !std::mem::replace(&mut looks, true);
            (begins && self.waiting.begins_to_look(|| self.has_left()))
                || self.is_called()
                || (take_in() && self.is_called())
        };
        let found = look(&mut there);
        found || (looks && self.waiting.ends_its_look())
    }

    /// Something was left to the thread that ran.
    fn look_after_runner(&self, effects: &mut S::Effects) {
        if self.waiting.runs_no_longer() {
            self.second_look(effects);
        }
    }

    /// Something was left to the thread that looks.
    fn call_looker(&self, effects: &mut S::Effects) {
        if !self.waiting.call_looker() {
            // It has looked into the inbox since.
            self.second_look(effects);
        }
    }

    /// Ends all waits of the task, now and later.
    pub fn stop(&self, effects: &mut S::Effects) {
        let mut core = lock(&self.core);
        core.stopped = true;
        let was = self.waiting.ready();
        drop(core);
        if self.has(Plant::SilentStop) {
            return;
        }
        self.waiting.call(was);
        self.second_look(effects);
    }

    /// The task's thread does not come in any more: nothing is left to it.
    pub fn end(&self, effects: &mut S::Effects) {
        self.waiting.ready();
        self.second_look(effects);
    }

    /// Works off what is in the inbox, unless somebody is at it.
    pub fn nudge(&self, effects: &mut S::Effects) {
        self.second_look(effects);
    }

    /// Does something with the station that may lead to work, from anywhere.
    pub fn visit(&self, visit: impl FnOnce(&mut S, &mut S::Effects), effects: &mut S::Effects) {
        // What was left may be an answer: only who works it off marks the word.
        self.second_look(effects);
        let mut core = lock(&self.core);
        visit(&mut core.station, effects);
        let rest = if core.resting { Rest::GoesOn } else { Rest::No };
        core.station.settle(rest, effects);
        drop(core);
        self.second_look(effects);
    }

    /// Looks at the station under its lock, once what was left is worked off. Who holds the lock has its duties: so is what
    /// others leave meanwhile.
    pub fn with<R>(&self, look: impl FnOnce(&mut S) -> R, effects: &mut S::Effects) -> R {
        let mut core = lock(&self.core);
        let seen = if self.inbox.is_empty() {
            let seen = look(&mut core.station);
            drop(core);
            seen
        } else {
            self.work_and(core, None, look, effects)
        };
        self.second_look(effects);
        seen
    }

    /// As [`with`](Self::with), without those duties.
    #[cfg(test)]
    pub fn look_at<R>(&self, look: impl FnOnce(&mut S) -> R) -> R {
        look(&mut lock(&self.core).station)
    }

    #[cfg(test)]
    pub fn time_out(&self) {
        self.waiting.time_out();
    }

    /// Puts input into the inbox without taking the lock, or hands it back where the inbox is full. Whoever enters next
    /// finds it; [`nudge`](Self::nudge) makes sure that somebody does.
    pub fn leave(&self, input: S::Input) -> Result<(), S::Input> {
        self.inbox.leave(input)
    }

    fn work(
        &self,
        core: MutexGuard<'_, Core<S>>,
        inputs: impl IntoIterator<Item = S::Input>,
        effects: &mut S::Effects,
    ) {
        self.work_and(core, inputs, |_| (), effects);
    }

    /// Works off what there is, and then does something with the station.
    fn work_and<R>(
        &self,
        mut core: MutexGuard<'_, Core<S>>,
        inputs: impl IntoIterator<Item = S::Input>,
        then: impl FnOnce(&mut S) -> R,
        effects: &mut S::Effects,
    ) -> R {
        let had_mail = core.mail.is_some();
        self.drain(&mut core, effects);
        for input in inputs {
            core.feed(input, effects);
        }
        let new_mail = !had_mail && core.mail.is_some();
        core.resting &= !new_mail;
        let done = then(&mut core.station);
        let rest = if core.resting { Rest::GoesOn } else { Rest::No };
        core.station.settle(rest, effects);
        // Last: the task's thread may be looking, and wants the lock.
        let was = if new_mail { self.waiting.mark() } else { Was::RUNNING };
        drop(core);
        self.waiting.call(was);
        done
    }

    fn drain(&self, core: &mut Core<S>, effects: &mut S::Effects) {
        if self.inbox.is_empty() {
            return;
        }
        self.inbox.take(&mut core.batch);
        let mut batch = std::mem::take(&mut core.batch);
        for input in batch.drain(..) {
            core.feed(input, effects);
        }
        core.batch = batch;
    }

    /// Works off what was left in the inbox by those who did not get the lock. Who fails to get it here leaves the
    /// work to the holder, who comes here after letting go: the fence on both sides makes sure that one of the two
    /// sees it.
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

impl<S: Station, P: Plants<Plant>> Away for Handoff<S, P> {
    fn go_away(&self) -> bool {
        self.waiting.goes(AWAY, || self.has_left())
    }

    fn come_home(&self) -> bool {
        self.waiting.comes(AWAY)
    }
}

impl<S: Station> Core<S> {
    fn feed(&mut self, input: S::Input, effects: &mut S::Effects) {
        if let Some(mail) = self.station.feed(input, effects) {
            self.mail = Some(mail);
        }
    }
}
