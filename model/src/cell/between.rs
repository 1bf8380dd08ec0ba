//! Times between the ends: an action may end before its most time, and a packet arrive before its link's bound.
//!
//! What a time decides is what comes before what. So an action ends at its least time, at its most, or right after anything
//! that happens in the cell between them; a packet arrives after one tick, at its link's bound, or right after anything
//! that happens between them. That tries every order of two things that are near each other. What it leaves out is how long it
//! then is to what comes later.

use super::course::{Course, bit, small};

impl Course {
    /// Something happened: what waited for that may end or arrive now.
    pub fn stir(&mut self) {
        self.beside.stays.clear();
        self.beside.slow = 0;
    }

    /// Nothing waits that is not there any more.
    pub fn settle(&mut self) {
        if !self.between {
            return;
        }
        let (floor, beside) = (&self.floor, &mut self.beside);
        beside.stays.retain(|&(task, level)| {
            let actor = floor.bodies[usize::from(task)].actor.as_ref();
            let running = actor.and_then(|actor| actor.running.iter().find(|action| action.level == level));
            running.is_some_and(|action| action.least == 0 && action.most > 0)
        });
        let full = floor.crossings.iter().fold(0, |full, crossing| full | bit(usize::from(crossing.link)));
        beside.slow &= full;
    }

    /// An action does not end at its least time.
    pub fn go_on(&mut self, task: usize, level: u8) {
        if self.between {
            self.beside.stays.push((small(task), level));
            self.beside.stays.sort_unstable();
            return;
        }
        let Some(actor) = &mut self.floor.bodies[task].actor else { return };
        let actions = actor.running.iter_mut().filter(|action| action.level == level);
        actions.for_each(|action| action.least = action.most);
    }
}
