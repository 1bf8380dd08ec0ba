//! The paper's Timer (Figure 3) behind its lock. It serves the `delay`s of the tasks. Each communication task keeps its own
//! time_outs (D41).

use crate::clock::Micros;
use crate::node::effects::{Effect, Effects, Stamped};
use crate::sync::alarm::Alarm;
use crate::sync::{Mutex, lock};
use imrs_protocol::{CommTask, Input, Instant, TaskId, Ticks, TimeId, Timer};
use std::sync::Arc;

pub(crate) struct Timers {
    alarm: Arc<Alarm>,
    slot: usize,
    state: Mutex<State>,
}

struct State {
    /// The entries of tasks whose own thread sleeps until the expiry.
    attended: Timer,
    /// The entries that the Timer thread serves, because no other thread sleeps until their expiry. They have a Timer
    /// of their own, so that the Timer thread finds its next expiry without a search.
    unattended: Timer,
}

impl Timers {
    /// `timer` must be empty, with room for the entries of all `tasks` tasks of the node.
    pub fn new(timer: Timer, tasks: usize, alarm: Arc<Alarm>, slot: usize, now: Micros) -> Self {
        let room = u16::try_from(tasks.saturating_mul(CommTask::ENTRIES)).unwrap_or(u16::MAX);
        let mut state = State { attended: timer, unattended: Timer::new(room) };
        // No timer is armed yet: this call only sets the clock.
        state.advance(now, &mut Effects::of_an_onlooker());
        Self { alarm, slot, state: Mutex::new(state) }
    }

    pub fn arm(
        &self,
        at: Micros,
        owner: TaskId,
        (id, turn): (TimeId, u8),
        length: Ticks,
        effects: &mut Effects,
    ) {
        let mut state = lock(&self.state);
        state.advance(at, effects);
        // The delay counts from `at`, when the task made its request, not from the Timer's present.
        let length = length - (state.now() - Instant(at));
        state.disarm(owner, id);
        let timer = if effects.waiter == Some(owner) { &mut state.attended } else { &mut state.unattended };
        if !timer.arm(owner, id, turn, length) {
            // If the Timer is full, the delay ends at once: otherwise it would never end.
            let stamped = Stamped { at: state.now().0, input: Input::TimeOut { id, turn } };
            effects.queue.push_back(Effect::Feed(owner, stamped));
        }
        self.publish(&state);
    }

    pub fn disarm(&self, at: Micros, owner: TaskId, id: TimeId, effects: &mut Effects) {
        let mut state = lock(&self.state);
        state.advance(at, effects);
        state.disarm(owner, id);
        self.publish(&state);
    }

    /// Lets time pass, and tells tasks whose delay is over.
    pub fn advance(&self, now: Micros, effects: &mut Effects) {
        let mut state = lock(&self.state);
        state.advance(now, effects);
        self.publish(&state);
    }

    /// The entries with their remaining times at an instant, soonest first, and that instant.
    pub fn entries(&self) -> (Vec<(TaskId, TimeId, Ticks)>, Micros) {
        let state = lock(&self.state);
        let mut entries = state.attended.entries();
        entries.extend(state.unattended.entries());
        entries.sort_by_key(|&(_, _, left)| left);
        (entries, state.now().0)
    }

    fn publish(&self, state: &State) {
        self.alarm.publish(self.slot, state.unattended.next_deadline().0);
    }
}

impl State {
    fn now(&self) -> Instant {
        self.unattended.now()
    }

    fn advance(&mut self, now: Micros, effects: &mut Effects) {
        let now = self.now().max(Instant(now));
        for timer in [&mut self.attended, &mut self.unattended] {
            timer.advance(now, |owner, id, turn| {
                let stamped = Stamped { at: now.0, input: Input::TimeOut { id, turn } };
                effects.queue.push_back(Effect::Feed(owner, stamped));
            });
        }
    }

    fn disarm(&mut self, owner: TaskId, id: TimeId) {
        if !self.attended.disarm(owner, id) {
            self.unattended.disarm(owner, id);
        }
    }
}
