//! Event times between the extremes: an action may end before its most time, a packet may arrive before its link's bound.
//!
//! [`Times::Between`] decides only the order of events. An action ends at its least or most time, or right after any event
//! between them. A packet arrives after one tick, at its link's bound, or right after any event between them. So every
//! order of two close events is tried, but not every distance to later events. [`Times::Every`] tries every tick.

use super::{RunState, bit, small};
use crate::cell::plan::Times;
use crate::cell_state::script::Running;
use imrs_protocol::Ticks;

impl RunState {
    /// Called when an event has happened: postponed actions may end now, and postponed packets may arrive now.
    pub fn stir(&mut self) {
        self.beside.stays.clear();
        self.beside.slow = 0;
    }

    /// Called when time has passed: with [`Times::Every`], postponed actions and packets may end or arrive at this step.
    pub fn next_step(&mut self) {
        if self.times != Times::Every {
            return;
        }
        let (cell_state, beside, step) = (&self.cell, &mut self.beside, self.plan.tick_step());
        beside.stays.retain(|&(task, level)| {
            let actor = cell_state.bodies[usize::from(task)].actor.as_ref();
            let running = actor.and_then(|actor| actor.runs(level));
            running.is_some_and(|action| !is_step(action.most, step))
        });
        for carried in &cell_state.in_flight {
            let bound = Ticks(cell_state.links[usize::from(carried.link)].2.into());
            if is_step(bound - carried.age, step) {
                beside.slow &= !bit(usize::from(carried.link));
            }
        }
    }

    /// The time until the next instant at which an event may happen, at most `most`.
    pub fn to_next_step(&self, most: Ticks) -> Ticks {
        match self.plan.tick_step() {
            _ if self.times != Times::Every || most == Running::FOREVER => most,
            1 => most.min(Ticks(1)),
            step => Ticks(most.0 - (most.0.saturating_sub(1) / u64::from(step)) * u64::from(step)),
        }
    }

    /// Drops postponements of actions that have ended, and of links without a packet.
    pub fn settle(&mut self) {
        if self.times == Times::Ends {
            return;
        }
        let (cell_state, beside) = (&self.cell, &mut self.beside);
        beside.stays.retain(|&(task, level)| {
            let actor = cell_state.bodies[usize::from(task)].actor.as_ref();
            let running = actor.and_then(|actor| actor.runs(level));
            running.is_some_and(|action| action.least.is_zero() && !action.most.is_zero())
        });
        let full = cell_state.in_flight.iter().fold(0, |full, carried| full | bit(usize::from(carried.link)));
        beside.slow &= full;
    }

    /// Postpones the end of an action that may end now.
    pub fn go_on(&mut self, task: usize, level: u8) {
        if self.times != Times::Ends {
            self.beside.stays.push((small(task), level));
            self.beside.stays.sort_unstable();
            return;
        }
        let Some(actor) = &mut self.cell.bodies[task].actor else { return };
        let actions = actor.running.iter_mut().filter(|action| action.level == level);
        actions.for_each(|action| action.least = action.most);
    }
}

/// Whether the search stops at an instant that is `left` before the most time.
fn is_step(left: Ticks, step: u32) -> bool {
    left != Running::FOREVER && (step == 1 || left.0.is_multiple_of(step.into()))
}
