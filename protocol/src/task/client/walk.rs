//! Visits the fields of a client, for the checker's packed states.

use super::outstanding::{Answer, Outstanding, Phase, Recipient};
use super::{Client, Overdue};
use crate::ids::{Incarnation, MessageId, PortId, TaskId};
use crate::state::{Walk, mark, same_variant};
use crate::table::NodeTable;

/// Layout of a request's first byte: its phase, and whether several tasks were asked.
const PHASE: u8 = 3;
const SET: u8 = 4;

const PHASES: [Phase; 3] = [Phase::Closed, Phase::Open, Phase::Ended];
const ANSWERS: [Answer; 5] =
    [Answer::NotAsked, Answer::Open, Answer::Answered, Answer::Refused, Answer::Restarted];

/// Which fields the packed bytes contain, because the port's declaration needs them.
#[derive(Clone, Copy)]
struct Form {
    retries: bool,
    long: bool,
    long_answers: bool,
}

impl Form {
    fn of(table: &NodeTable, port: PortId) -> Self {
        table.port(port).map_or(Self { retries: false, long: false, long_answers: false }, |port| Self {
            retries: port.parties.iter().any(|party| party.retry > 0),
            long: port.decl.fragments > 1,
            long_answers: port.decl.answer_fragments > 1,
        })
    }
}

/// The state of the request towards its only recipient. The phase of a request that is not closed implies this state.
const fn one(phase: Phase) -> Answer {
    match phase {
        Phase::Closed | Phase::Open => Answer::Open,
        Phase::Ended => Answer::Answered,
    }
}

impl Client {
    pub(in crate::task) fn walk<W: Walk>(
        &mut self,
        table: &NodeTable,
        own: (TaskId, Incarnation),
        w: &mut W,
    ) {
        // `walk_overdue` visits the field `overdue`.
        let Self { requests, overdue: _ } = self;
        requests.iter_mut().for_each(|request| request.walk(table, own, w));
    }

    pub(in crate::task) fn walk_overdue<W: Walk>(
        &mut self,
        table: &NodeTable,
        own: (TaskId, Incarnation),
        w: &mut W,
    ) {
        let overdue = &mut self.overdue;
        if !table.rules().refuse_late_replies {
            let is = w.put(u8::from(overdue.is_some())) == 1;
            if let Some(overdue) = w.some(overdue, is, Overdue::BLANK) {
                let Overdue { port, to, id } = overdue;
                w.small(&mut port.0);
                w.small(&mut to.0);
                w.id(own.0, own.1, id);
            }
        } else if W::READS {
            *overdue = None;
        }
    }
}

impl Overdue {
    const BLANK: Self = Self { port: PortId(0), to: TaskId(0), id: MessageId::BLANK };
}

impl Outstanding {
    fn walk<W: Walk>(&mut self, table: &NodeTable, own: (TaskId, Incarnation), w: &mut W) {
        let form = Form::of(table, self.port);
        if W::READS {
            self.close();
        }
        let Self {
            port: _,
            endpoint: _,
            phase,
            set,
            deadline,
            copies_left,
            copy_at,
            contents,
            parts,
            recipients,
        } = self;
        let closed = *phase == Phase::Closed;
        let first = w.put(if closed { 0 } else { *phase as u8 | mark(*set, SET) });
        if W::READS {
            *phase = PHASES.get(usize::from(first & PHASE)).copied().unwrap_or_default();
            *set = first & SET != 0;
        }
        if *phase == Phase::Closed {
            return;
        }
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
            for recipient in recipients {
                w.one_of(&ANSWERS, &mut recipient.answer, same_variant);
                recipient.walk(*phase, form, own, w);
            }
            return;
        }
        // If the request has one recipient, the recipient's state is not packed, because the phase implies it.
        let at = recipients.iter().position(|recipient| recipient.answer == one(*phase));
        if !W::READS && at.is_none() {
            return;
        }
        let at = w.count(at.unwrap_or(0));
        if let Some(recipient) = recipients.get_mut(at) {
            if W::READS {
                recipient.answer = one(*phase);
            }
            recipient.walk(*phase, form, own, w);
        }
    }
}

impl Recipient {
    fn walk<W: Walk>(
        &mut self,
        phase: Phase,
        form: Form,
        (own, incarnation): (TaskId, Incarnation),
        w: &mut W,
    ) {
        let Self { task: _, party: _, id, answer, packets_out, contents, by } = self;
        let open = *answer == Answer::Open;
        if *answer == Answer::NotAsked {
            return;
        }
        // Once the request has ended, no answer is compared with this id.
        if open && phase == Phase::Open {
            w.id(own, incarnation, id);
        }
        if open {
            w.small(packets_out);
        }
        if form.long_answers {
            contents.walk_answer(w);
            // The next lines visit the sender of an incomplete answer.
            let missing = open && contents.is_open() && (W::READS || by.is_some());
            if let Some((port, task)) = w.some(by, missing, (PortId(0), TaskId(0))) {
                w.small(&mut port.0);
                w.small(&mut task.0);
            }
        } else if *answer == Answer::Answered
            && let Some(answer) = contents.contents.first_mut()
        {
            w.contents(answer);
            if W::READS {
                contents.have = 1;
            }
        }
    }
}
