//! The requests that a task waits to have answered, and messages of several packets.

use super::{name_port, name_task, own_id};
use crate::comm_task::desk::{Answer, Asked, Desk, Phase};
use crate::comm_task::fragments::{Assembly, Parts};
use crate::ids::{Incarnation, MessageId, TaskId};
use crate::state::Walk;
use crate::table::NodeTable;

/// What the port's declaration leaves out.
#[derive(Clone, Copy)]
pub(super) struct Form {
    retries: bool,
    long: bool,
    long_answers: bool,
}

impl Form {
    /// Nothing is left out where there is no table.
    pub fn of(table: Option<&NodeTable>, desk: &Desk) -> Self {
        let Some(table) = table else { return Self { retries: true, long: true, long_answers: true } };
        table.port(desk.port).map_or(Self { retries: false, long: false, long_answers: false }, |port| Self {
            retries: port.parties.iter().any(|party| party.retry > 0),
            long: port.decl.fragments > 1,
            long_answers: port.decl.answer_fragments > 1,
        })
    }
}

/// What became of the request to one task, where the desk is not closed.
const fn one(phase: Phase) -> Answer {
    match phase {
        Phase::Closed | Phase::Open => Answer::Open,
        Phase::Ended => Answer::Answered,
    }
}

impl Desk {
    pub(super) fn walk<W: Walk>(&mut self, form: Form, own: (TaskId, Incarnation), w: &mut W) {
        if W::LOADS {
            self.close();
        }
        let Self { port: _, local: _, phase, set, deadline, copies_left, copy_at, contents, parts, asked } =
            self;
        w.align();
        let code = w.bits(2, *phase as u8);
        w.left_out(phase, || {
            [Phase::Closed, Phase::Open, Phase::Ended, Phase::Closed][usize::from(code & 3)]
        });
        // What was answered last is read with the word that it was answered.
        if *phase == Phase::Closed {
            return w.left_out(set, || false);
        }
        w.bit(set);
        if *phase == Phase::Open {
            w.instant(deadline);
            w.contents(contents);
            if form.retries {
                w.byte(copies_left);
                w.instant(copy_at);
            }
            if form.long {
                parts.walk(w);
            }
        }
        if *set {
            for asked in asked.iter_mut() {
                let code = w.code(asked.answer as u8);
                w.left_out(&mut asked.answer, || Answer::of(code));
                if asked.answer != Answer::NotAsked {
                    asked.walk(*phase, form, own, w);
                }
            }
        } else {
            let at = asked.iter().position(|asked| asked.answer == one(*phase));
            let at = w.count(at.unwrap_or(usize::from(u8::MAX)));
            if let Some(asked) = asked.get_mut(at) {
                w.left_out(&mut asked.answer, || one(*phase));
                asked.walk(*phase, form, own, w);
            }
        }
    }
}

impl Answer {
    const fn of(code: u8) -> Self {
        match code {
            1 => Self::Open,
            2 => Self::Answered,
            3 => Self::Refused,
            4 => Self::Restarted,
            _ => Self::NotAsked,
        }
    }
}

impl Asked {
    /// Without what became of it: that comes before.
    fn walk<W: Walk>(&mut self, phase: Phase, form: Form, own: (TaskId, Incarnation), w: &mut W) {
        let Self { task: _, party: _, id, answer, packets_out, contents, by } = self;
        if W::LOADS {
            contents.begin(MessageId::default());
        }
        // Of a request that ended nobody's answer is waited for.
        if *answer == Answer::Open && phase == Phase::Open {
            own_id(own, id, w);
        }
        if *answer == Answer::Open {
            *packets_out = u16::try_from(w.count(usize::from(*packets_out))).unwrap_or(*packets_out);
        }
        if form.long_answers {
            contents.have = w.word(contents.have);
            contents.walk_fragments(w);
            // Whose answer it is that is not whole.
            if *answer == Answer::Open && contents.is_open() {
                let (mut port, mut task) = by.unwrap_or_default();
                name_port(&mut port, w);
                name_task(&mut task, w);
                w.left_out(by, || Some((port, task)));
            }
        } else if *answer == Answer::Answered {
            let mut first = contents.contents.first().copied().unwrap_or_default();
            w.contents(&mut first);
            if let Some(slot) = contents.contents.first_mut().filter(|_| W::LOADS) {
                (*slot, contents.have) = (first, 1);
            }
        }
    }
}

impl Parts {
    /// The fragments that are here.
    pub(super) fn walk<W: Walk>(&mut self, w: &mut W) {
        let have = w.word(self.have());
        if W::LOADS {
            self.clear();
        }
        for i in (1..=15).filter(|i| have & (1 << (i - 1)) != 0) {
            let mut contents = self.get(i).copied().unwrap_or_default();
            w.contents(&mut contents);
            if W::LOADS {
                self.put(i, contents);
            }
        }
    }
}

impl Assembly {
    /// Its fragments: which are here comes before, whose they are and until when behind.
    pub(super) fn walk_fragments<W: Walk>(&mut self, w: &mut W) {
        let Self { id: _, have, fragments, expires: _, contents } = self;
        let known = w.code(fragments.unwrap_or(0));
        w.left_out(fragments, || Some(known).filter(|&known| known > 0));
        let here = contents.iter_mut().enumerate().filter(|(i, _)| *have & (1 << i) != 0);
        here.for_each(|(_, contents)| w.contents(contents));
    }
}
