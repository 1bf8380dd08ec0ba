//! Times between the ends: an action may end before its most time, and a packet arrive before its link's bound.
//!
//! With [`Times::Between`] what a time decides is what comes before what: an action ends at its least time, at its most, or
//! right after anything that happens in the cell between them; a packet arrives after one tick, at its link's bound, or right
//! after anything that happens between them. That tries every order of two things that are near each other, and leaves
//! out how long it then is to what comes later. With [`Times::Every`] nothing is left out but what lies between two ticks.

use super::{Course, bit, small};
use crate::cell::plan::Times;
use crate::floor::script::Running;

impl Course {
    /// Something happened: what waited for that may end or arrive now.
    pub fn stir(&mut self) {
        self.beside.stays.clear();
        self.beside.slow = 0;
    }

    /// Time passed: where every tick counts, what waited may end or arrive now.
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

    /// In how many ticks something that takes so many more at most may end or arrive.
    pub fn to_next_step(&self, most: u32) -> u32 {
        let step = self.plan.step;
        if self.times == Times::Every && most != Running::FOREVER {
            most - (most.saturating_sub(1) / step) * step
        } else {
            most
        }
    }

    /// Nothing waits that is not there any more.
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

    /// An action does not end at its least time.
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
