//! The packed form of the requests that a task waits to have answered.

use super::{CommTask, Frame, Overflow, Reader, Writer, store_id};
use crate::comm_task::desk::{Answer, Asked, Desk, Phase};
use crate::comm_task::fragments::{Assembly, Parts};
use crate::ids::{PortId, TaskId};
use crate::packet::Contents;
use crate::table::NodeTable;
use crate::ticks::Ticks;

/// The first byte of a desk.
const OPEN: u8 = 1;
const ENDED: u8 = 2;
const SET: u8 = 4;

/// What the port's declaration leaves out of the bytes.
#[derive(Clone, Copy)]
struct Form {
    retries: bool,
    long: bool,
    long_answers: bool,
}

impl Form {
    fn of(table: &NodeTable, desk: &Desk) -> Self {
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

impl Asked {
    /// Whose answer it is that is not whole.
    fn missing(&self) -> Option<(PortId, TaskId)> {
        self.by.filter(|_| self.answer == Answer::Open && self.contents.is_open())
    }
}

impl Parts {
    pub(super) fn store(&self, w: &mut Writer<'_>) -> Result<(), Overflow> {
        w.word(self.have())?;
        self.here().try_for_each(|contents| w.contents(contents))
    }

    pub(super) fn load(&mut self, r: &mut Reader<'_>) {
        self.clear();
        let have = r.word();
        for i in (1..=15).filter(|i| have & (1 << (i - 1)) != 0) {
            self.put(i, r.contents());
        }
    }
}

impl Assembly {
    /// Its fragments; whose they are, and until when, is the caller's to write.
    pub(super) fn store(&self, w: &mut Writer<'_>) -> Result<(), Overflow> {
        w.word(self.have)?;
        w.byte(self.fragments.unwrap_or(0))?;
        let here = (0..self.contents.len()).filter(|i| self.have & (1 << i) != 0);
        here.into_iter().try_for_each(|i| w.contents(&self.contents[i]))
    }

    pub(super) fn load(&mut self, have: u16, r: &mut Reader<'_>) {
        self.have = have;
        self.fragments = Some(r.byte()).filter(|&fragments| fragments > 0);
        for (_, slot) in self.contents.iter_mut().enumerate().filter(|(i, _)| have & (1 << i) != 0) {
            *slot = r.contents();
        }
    }
}

impl CommTask {
    pub(super) fn store_desk(
        &self,
        table: &NodeTable,
        desk: &Desk,
        frame: &Frame<'_>,
        w: &mut Writer<'_>,
    ) -> Result<(), Overflow> {
        let form = Form::of(table, desk);
        let phase = match desk.phase {
            Phase::Closed => return w.byte(0),
            Phase::Open => OPEN,
            Phase::Ended => ENDED,
        };
        w.byte(phase | if desk.set { SET } else { 0 })?;
        if desk.phase == Phase::Open {
            w.left(desk.deadline, self.now)?;
            w.contents(&desk.contents)?;
            if form.retries {
                w.byte(desk.copies_left)?;
                w.left(desk.copy_at, self.now)?;
            }
            if form.long {
                desk.parts.store(w)?;
            }
        }
        if desk.set {
            for asked in &desk.asked {
                w.byte(match asked.answer {
                    Answer::NotAsked => 0,
                    Answer::Open => 1,
                    Answer::Answered => 2,
                    Answer::Refused => 3,
                    Answer::Restarted => 4,
                })?;
                if asked.answer != Answer::NotAsked {
                    self.store_asked(desk.phase, asked, form, frame, w)?;
                }
            }
        } else if let Some(at) = desk.asked.iter().position(|asked| asked.answer == one(desk.phase)) {
            w.count(at)?;
            self.store_asked(desk.phase, &desk.asked[at], form, frame, w)?;
        }
        Ok(())
    }

    fn store_asked(
        &self,
        phase: Phase,
        asked: &Asked,
        form: Form,
        frame: &Frame<'_>,
        w: &mut Writer<'_>,
    ) -> Result<(), Overflow> {
        // Of a request that ended nobody's answer is waited for.
        if asked.answer == Answer::Open && phase == Phase::Open {
            store_id(self.task, asked.id, frame, w)?;
        }
        if asked.answer == Answer::Open {
            w.count(usize::from(asked.packets_out))?;
        }
        if form.long_answers {
            asked.contents.store(w)?;
            if let Some((port, task)) = asked.missing() {
                w.count(port.index())?;
                w.count(task.index())?;
            }
        } else if asked.answer == Answer::Answered {
            w.contents(asked.contents.contents.first().unwrap_or(&Contents::EMPTY))?;
        }
        Ok(())
    }

    pub(super) fn load_desk(&mut self, table: &NodeTable, at: usize, lives: bool, r: &mut Reader<'_>) {
        let form = Form::of(table, &self.desks[at]);
        let first = r.byte();
        let desk = &mut self.desks[at];
        desk.close();
        desk.set = first & SET != 0;
        desk.phase = match first & (OPEN | ENDED) {
            OPEN => Phase::Open,
            ENDED => Phase::Ended,
            _ => return,
        };
        if desk.phase == Phase::Open {
            desk.deadline = r.left();
            desk.contents = r.contents();
            if form.retries {
                (desk.copies_left, desk.copy_at) = (r.byte(), r.left());
            }
            if form.long {
                desk.parts.load(r);
            }
        }
        if desk.set {
            for i in 0..self.desks[at].asked.len() {
                let answer = match r.byte() {
                    1 => Answer::Open,
                    2 => Answer::Answered,
                    3 => Answer::Refused,
                    4 => Answer::Restarted,
                    _ => continue,
                };
                self.load_asked((at, i), answer, form, lives, r);
            }
        } else {
            let i = usize::from(r.byte());
            self.load_asked((at, i), one(self.desks[at].phase), form, lives, r);
        }
    }

    fn load_asked(
        &mut self,
        (at, i): (usize, usize),
        answer: Answer,
        form: Form,
        lives: bool,
        r: &mut Reader<'_>,
    ) {
        let open = answer == Answer::Open && self.desks[at].phase == Phase::Open;
        let id = open.then(|| self.load_own_id(r, lives));
        let Some(asked) = self.desks[at].asked.get_mut(i) else { return };
        asked.answer = answer;
        asked.contents.begin(crate::ids::MessageId::default());
        if let Some(id) = id {
            asked.id = id;
        }
        if answer == Answer::Open {
            asked.packets_out = u16::from(r.byte());
        }
        if form.long_answers {
            let have = r.word();
            asked.contents.load(have, r);
            asked.contents.expires = Ticks::FAR;
            if have != 0 && answer == Answer::Open {
                asked.by = Some((PortId(u16::from(r.byte())), TaskId(u16::from(r.byte()))));
            }
        } else if answer == Answer::Answered {
            let contents = r.contents();
            if let Some(slot) = asked.contents.contents.first_mut() {
                *slot = contents;
                asked.contents.have = 1;
            }
        }
    }
}
