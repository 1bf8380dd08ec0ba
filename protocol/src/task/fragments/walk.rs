//! Visits fragments, for the checker's packed states.

use super::{Assembly, Parts};
use crate::ids::{Incarnation, MessageId, TaskId};
use crate::packet::Contents;
use crate::state::Walk;
use crate::ticks::Instant;

impl Parts {
    pub fn walk<W: Walk>(&mut self, w: &mut W) {
        if !W::PACKS {
            return;
        }
        let mut have = self.have();
        w.word(&mut have);
        if W::READS {
            self.clear();
        }
        for i in (1..=15).filter(|i| have & (1 << (i - 1)) != 0) {
            let mut contents = self.get(i).copied().unwrap_or(Contents::EMPTY);
            w.contents(&mut contents);
            if W::READS {
                self.put(i, contents);
            }
        }
    }
}

impl Assembly {
    /// Visits an incomplete answer. Its id and its deadline are those of the request to which it belongs.
    pub fn walk_answer<W: Walk>(&mut self, w: &mut W) {
        w.word(&mut self.have);
        self.walk_fragments(w);
        if W::READS {
            (self.id, self.expires) = (MessageId::default(), Instant::NEVER);
        }
    }

    /// Visits an incomplete message of `source`.
    pub fn walk_message<W: Walk>(&mut self, source: TaskId, w: &mut W) {
        w.word(&mut self.have);
        if self.is_open() {
            self.walk_fragments(w);
            w.id(source, Incarnation(0), &mut self.id);
            w.instant(&mut self.expires);
        }
    }

    fn walk_fragments<W: Walk>(&mut self, w: &mut W) {
        let Self { id: _, have, fragments, expires: _, contents } = self;
        let known = w.put(fragments.unwrap_or(0));
        if W::READS {
            *fragments = Some(known).filter(|&fragments| fragments > 0);
        }
        let here = contents.iter_mut().enumerate().filter(|(i, _)| *have & (1 << i) != 0);
        here.for_each(|(_, contents)| w.contents(contents));
    }
}
