//! Converts messages and answers between a program's types and the bytes of the task's communication task.

use super::caller::Caller;
use super::outcome::{Asked, Received, RequestFault, TaskError};
use crate::api::message::{Bytes, LONGEST, Message};
use imrs_protocol::{Answers, Class, Delivery, Fault, Outcome, PortId, Target, TaskId};
use std::any::type_name;
use std::sync::Arc;

impl Caller {
    /// Checks that messages of the port are of this class. An unknown port passes, because the request itself reports it.
    pub(super) fn expect_class(&self, port: PortId, class: Class) -> Result<(), TaskError> {
        let decl = self.node.table.port(port);
        if decl.is_some_and(|port| port.decl.class != class) { Err(wrong_usage()) } else { Ok(()) }
    }

    /// The one task that `to` selects; an error if `to` selects no task or several.
    pub(super) fn peer(&self, port: PortId, to: Target) -> Result<TaskId, TaskError> {
        let port = self.node.table.port(port).ok_or_else(|| fault(Fault::NotYourPort))?;
        let meant = |task: &TaskId| match to {
            Target::All => true,
            Target::One(one) => *task == one,
            Target::Some(bits) => port.party_index(*task).is_some_and(|at| at < 64 && bits >> at & 1 == 1),
        };
        let mut all = port.peers(self.task()).filter(meant);
        match (all.next(), all.next()) {
            (Some(peer), None) => Ok(peer),
            (None, _) => Err(fault(Fault::NotAPeer)),
            (Some(_), Some(_)) => Err(wrong_usage()),
        }
    }

    /// Calls `each` with the outcome of every task that got the message.
    pub(super) fn each_answer<R: Message>(
        &mut self,
        port: PortId,
        answers: &Answers,
        mut each: impl FnMut(TaskId, Asked<R>),
    ) -> Result<(), TaskError> {
        let cell = Arc::clone(&self.node.table.cell);
        let parties = cell.port(port).map(|port| &port.parties[..]).unwrap_or_default();
        for (at, party) in parties.iter().enumerate().take(64) {
            let bit = 1 << at;
            if answers.asked & bit == 0 {
                continue;
            }
            each(
                party.task,
                if answers.answered & bit != 0 {
                    Asked::Reply(decoded(&self.whole_answer(port, party.task, None))?)
                } else if answers.refused & bit != 0 {
                    Asked::Refused
                } else if answers.restarted & bit != 0 {
                    Asked::PeerRestarted
                } else if answers.unsent & bit != 0 {
                    Asked::TimedOutUnsent
                } else {
                    Asked::TimedOutUnknown
                },
            );
        }
        Ok(())
    }

    /// Decodes a message from all its fragments.
    pub(super) fn decoded<M: Message>(&mut self, delivery: &Delivery) -> Result<Received<M>, TaskError> {
        let message = decoded(&self.whole(delivery)?)?;
        Ok(Received { message, from: delivery.from, budget: delivery.budget })
    }

    /// Converts the outcome, and decodes the answer from all its fragments.
    pub(super) fn asked<R: Message>(
        &mut self,
        port: PortId,
        peer: TaskId,
        outcome: Outcome,
    ) -> Result<Asked<R>, TaskError> {
        Ok(match outcome {
            Outcome::Reply(first) => Asked::Reply(decoded(&self.whole_answer(port, peer, Some(&first)))?),
            Outcome::Refused => Asked::Refused,
            Outcome::TimedOutUnsent => Asked::TimedOutUnsent,
            Outcome::TimedOutUnknown => Asked::TimedOutUnknown,
            Outcome::PeerRestarted => Asked::PeerRestarted,
        })
    }
}

pub(super) fn fault(fault: Fault) -> TaskError {
    RequestFault(fault).into()
}

pub(super) fn wrong_usage() -> TaskError {
    fault(Fault::WrongUsage)
}

pub(super) fn encoded<'a, M: Message>(
    message: &M,
    room: &'a mut [u8; LONGEST],
) -> Result<&'a [u8], TaskError> {
    let length = message.encode(room).ok_or_else(|| TaskError::NotSendable(type_name::<M>()))?;
    room.get(..length).ok_or(TaskError::TooLong(length))
}

pub(super) fn decoded<M: Message>(bytes: &Bytes) -> Result<M, TaskError> {
    M::decode(bytes).ok_or_else(|| TaskError::NotThisType(bytes.len(), type_name::<M>()))
}
