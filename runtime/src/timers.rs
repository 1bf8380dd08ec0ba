//! The paper's Timer (Figure 3) behind its lock. It serves the `delay`s of the tasks; their time_outs are the
//! communication tasks' own (D41).

use crate::alarm::Alarm;
use crate::clock::{FAR, Micros};
use crate::effects::{Effect, Effects, Stamped};
use crate::sync::{Mutex, lock};
use imrs_protocol::{Input, TaskId, Ticks, TimeId, Timer};
use std::sync::Arc;

pub(crate) struct Timers {
    alarm: Arc<Alarm>,
    slot: usize,
    state: Mutex<State>,
}

struct State {
    timer: Timer,
    last: Micros,
    /// Entries that no thread sleeps for: the Timer thread looks after them.
    unattended: Vec<(TaskId, TimeId, Micros)>,
}

impl Timers {
    pub fn new(timer: Timer, tasks: usize, alarm: Arc<Alarm>, slot: usize, now: Micros) -> Self {
        let state = State { timer, last: now, unattended: Vec::with_capacity(tasks) };
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
        // Time that passed here since the task asked is not added to its delay.
        let length = length - Ticks(state.last.saturating_sub(at));
        state.forget(owner, id);
        if !state.timer.arm(owner, id, turn, length) {
            // A full Timer ends the delay at once rather than never.
            let stamped = Stamped { at: state.last, input: Input::TimeOut { id, turn } };
            effects.queue.push_back(Effect::Feed(owner, stamped));
        } else if effects.waiter != Some(owner) {
            let until = state.last.saturating_add(length.0);
            state.unattended.push((owner, id, until));
        }
        self.publish(&state);
    }

    pub fn disarm(&self, at: Micros, owner: TaskId, id: TimeId, effects: &mut Effects) {
        let mut state = lock(&self.state);
        state.advance(at, effects);
        state.timer.disarm(owner, id);
        state.forget(owner, id);
        self.publish(&state);
    }

    /// Lets time pass: tasks whose delay is over are told.
    pub fn advance(&self, now: Micros, effects: &mut Effects) {
        let mut state = lock(&self.state);
        state.advance(now, effects);
        self.publish(&state);
    }

    /// The entries with what is left of each, and when it was so.
    pub fn entries(&self) -> (Vec<(TaskId, TimeId, Ticks)>, Micros) {
        let state = lock(&self.state);
        (state.timer.entries(), state.last)
    }

    fn publish(&self, state: &State) {
        let next = state.unattended.iter().map(|&(_, _, until)| until).min();
        self.alarm.publish(self.slot, next.unwrap_or(FAR));
    }
}

impl State {
    fn advance(&mut self, now: Micros, effects: &mut Effects) {
        let elapsed = now.saturating_sub(self.last);
        self.last += elapsed;
        let (last, unattended) = (self.last, &mut self.unattended);
        self.timer.advance(Ticks(elapsed), |owner, id, turn| {
            unattended.retain(|&(o, i, _)| (o, i) != (owner, id));
            let stamped = Stamped { at: last, input: Input::TimeOut { id, turn } };
            effects.queue.push_back(Effect::Feed(owner, stamped));
        });
    }

    fn forget(&mut self, owner: TaskId, id: TimeId) {
        self.unattended.retain(|&(o, i, _)| (o, i) != (owner, id));
    }
}
