//! Event times between the extremes: an action may end before its most time, a packet may arrive before its link's bound.
//!
//! [`Times::Between`] decides only the order of events. An action ends at its least or most time, or right after any event
//! between them. A packet arrives after one tick, at its link's bound, or right after any event between them. This tries every
//! order of two close events, but not every distance to later ones. [`Times::Every`] tries every tick.

use super::{Course, bit, small};
use crate::cell::plan::Times;
use crate::floor::script::Running;

impl Course {
    /// An event happened: actions and packets that were postponed until an event may end or arrive now.
    pub fn stir(&mut self) {
        self.beside.stays.clear();
        self.beside.slow = 0;
    }

    /// Time passed: with [`Times::Every`], postponed actions and packets may end or arrive at this step.
    pub fn next_step(&mut self) {
        if self.times != Times::Every {
            return;
        }
        let (floor, beside, step) = (&self.floor, &mut self.beside, self.plan.step);
        beside.stays.retain(|&(task, level)| {
            let actor = floor.bodies[usize::from(task)].actor.as_ref();
            let running = actor.and_then(|actor| actor.runs(level));
            running.is_some_and(|action| action.most % step != 0 || action.most == Running::FOREVER)
        });
        for crossing in &floor.crossings {
            let bound = u32::from(floor.links[usize::from(crossing.link)].2);
            if bound.saturating_sub(crossing.age) % step == 0 {
                beside.slow &= !bit(usize::from(crossing.link));
            }
        }
    }

    /// Ticks to the next instant at which an event may happen that is at most `most` ticks away.
    pub fn to_next_step(&self, most: u32) -> u32 {
        let step = self.plan.step;
        if self.times == Times::Every && most != Running::FOREVER {
            most - (most.saturating_sub(1) / step) * step
        } else {
            most
        }
    }

    /// Drops postponements of actions that have ended, and of links without a packet.
    pub fn settle(&mut self) {
        if self.times == Times::Ends {
            return;
        }
        let (floor, beside) = (&self.floor, &mut self.beside);
        beside.stays.retain(|&(task, level)| {
            let actor = floor.bodies[usize::from(task)].actor.as_ref();
            let running = actor.and_then(|actor| actor.runs(level));
            running.is_some_and(|action| action.least == 0 && action.most > 0)
        });
        let full = floor.crossings.iter().fold(0, |full, crossing| full | bit(usize::from(crossing.link)));
        beside.slow &= full;
    }

    /// Postpones the end of an action that may end now.
    pub fn go_on(&mut self, task: usize, level: u8) {
        if self.times != Times::Ends {
            self.beside.stays.push((small(task), level));
            self.beside.stays.sort_unstable();
            return;
        }
        let Some(actor) = &mut self.floor.bodies[task].actor else { return };
        let actions = actor.running.iter_mut().filter(|action| action.level == level);
        actions.for_each(|action| action.least = action.most);
    }
}
