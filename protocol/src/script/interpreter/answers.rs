//! What a script reads from its communication task: answers and other data.

use super::{Inbound, Interpreter, ScriptFault, ScriptOutbox, Wait};
use crate::ids::{PortId, TaskId};
use crate::packet::{Class, Contents};
use crate::request::{Delivery, Fault, Outcome, ReplyTo, Signal};
use crate::script::program::{Op, StatementOutcome};

impl<'a, O: ScriptOutbox> Interpreter<'a, O> {
    /// Records a message as the one that the running activation received last.
    pub(super) fn take(&mut self, delivery: &Delivery) {
        self.outcome = StatementOutcome::Message;
        self.inbound = Some(Inbound {
            contents: delivery.contents,
            port: delivery.from.port,
            task: Some(delivery.from.source),
            is_answer: false,
        });
        let answerable = match delivery.class {
            Class::Command => Some(delivery.from),
            Class::Status => None,
        };
        if let Some(forgotten) = core::mem::replace(&mut self.frame().message, answerable) {
            self.out.unanswered(forgotten);
        }
    }

    /// Records the results of the answer to the operation in which the running activation waits.
    pub(super) fn answered(&mut self, signal: &'a Signal) -> Result<(), ScriptFault> {
        let op = self.op()?;
        if let Wait::Part(_) = self.frame().wait {
            self.drop_fields(op)?;
        }
        let blocked = !matches!(signal, Signal::Accepted(_) | Signal::Fault(_));
        self.fresh = blocked || matches!(op, Op::Order(_) | Op::Atomic(_) | Op::Start { .. });
        self.outcome = StatementOutcome::Done;
        match (op, signal) {
            (Op::Send { .. }, Signal::Accepted(copies)) => self.value = i64::from(*copies),
            (Op::Send { port, .. }, Signal::Outcome(outcome)) => {
                self.outcome = match *outcome {
                    Outcome::Reply(contents) => {
                        self.inbound = Some(Inbound { contents, port: *port, task: None, is_answer: true });
                        StatementOutcome::Reply
                    }
                    Outcome::Refused => StatementOutcome::Refused,
                    Outcome::TimedOutUnsent => StatementOutcome::TimedOutUnsent,
                    Outcome::TimedOutUnknown => StatementOutcome::TimedOutUnknown,
                    Outcome::PeerRestarted => StatementOutcome::PeerRestarted,
                };
            }
            (Op::Send { .. }, Signal::Answers { answers, .. }) => {
                self.answers = Some(answers);
                let all = answers.answered == answers.asked;
                self.outcome = if all { StatementOutcome::Reply } else { StatementOutcome::Incomplete };
            }
            (Op::Get { .. }, Signal::Message(delivery)) => self.take(delivery),
            (Op::Get { .. }, Signal::Nothing) => self.outcome = StatementOutcome::Nothing,
            (Op::Arrive { .. }, Signal::Released { .. }) => self.outcome = StatementOutcome::Released,
            (Op::Arrive { .. }, Signal::GaveUp { missing, .. }) => {
                self.value = missing.cast_signed();
                self.outcome = StatementOutcome::GaveUp;
            }
            (Op::Delay(_), Signal::TimeOut(id)) if *id == self.delay_id() => {}
            (
                Op::Reply { .. }
                | Op::ReplyFor { .. }
                | Op::ReplyOwed { .. }
                | Op::Order(_)
                | Op::Start { .. }
                | Op::Stop(_)
                | Op::Atomic(_)
                | Op::Publish { .. },
                Signal::Accepted(_),
            ) => {}
            (_, Signal::Fault(Fault::Fenced)) => self.outcome = StatementOutcome::Fenced,
            (Op::ReplyFor { .. }, Signal::Fault(Fault::NotAPeer))
            | (_, Signal::Fault(Fault::NothingToAnswer | Fault::Late)) => {
                self.outcome = StatementOutcome::Unanswerable;
            }
            (_, Signal::Fault(fault)) => return Err(ScriptFault::Request(*fault)),
            _ => return Err(ScriptFault::Unexpected),
        }
        Ok(())
    }

    /// What the partner of the task's couple published last.
    pub(super) fn published(&self) -> Option<Contents> {
        self.out.communication()?.0.partner_published().copied()
    }

    /// The arguments of a member's arrival at a waitfor.
    pub(super) fn arrival(&self, port: PortId, task: TaskId) -> Option<[u8; 8]> {
        let (machine, table) = self.out.communication()?;
        machine.meeting_arguments(table, port, task)
    }

    /// The id of the message of `task` that the script received on `port` and has not answered.
    pub(super) fn owed(&self, port: PortId, task: TaskId) -> Option<ReplyTo> {
        self.out.communication()?.0.owed(port, task)
    }
}
