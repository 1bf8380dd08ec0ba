//! Calls with typed messages: what is sent, asked and answered is a [`Message`].

use super::calls::{Calls, at_once};
use super::outcome::{Asked, Received, RequestFault, TaskError};
use super::{Caller, Context};
use crate::api::message::{Bytes, LONGEST, Message};
use imrs_protocol::{Answers, Class, Delivery, Fault, Outcome, PortId, ReplyTo, Target, TaskId};
use std::any::type_name;
use std::sync::Arc;
use std::time::Duration;

impl<S> Context<S> {
    /// Tells all tasks at the other end of a class-1 port. Returns how many copies were accepted.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn tell<M: Message>(&mut self, port: PortId, message: &M) -> Result<u16, TaskError> {
        at_once(self.told(port, message))
    }

    /// Asks the task at the other end of a port: a query, or a command if the port's usage is `send` and its class is 2.
    /// Waits for the answer, at most for the port's time_out.
    ///
    /// # Errors
    /// [`TaskError`]; [`TaskError::NotThisType`] if the answer is no `R`.
    pub fn query<M: Message, R: Message>(
        &mut self,
        port: PortId,
        question: &M,
    ) -> Result<Asked<R>, TaskError> {
        at_once(self.asked(port, Target::All, question, None))
    }

    /// As [`query`](Self::query), to one of several tasks at the other end, or with a shorter TTL than the port's.
    ///
    /// # Errors
    /// As [`query`](Self::query).
    pub fn query_with<M: Message, R: Message>(
        &mut self,
        port: PortId,
        to: Target,
        question: &M,
        time_out: Option<Duration>,
    ) -> Result<Asked<R>, TaskError> {
        at_once(self.asked(port, to, question, time_out))
    }

    /// Asks several tasks at once, and calls `each` with the outcome of every asked task. Waits until all have answered or
    /// refused, at most for the port's time_out.
    ///
    /// # Errors
    /// As [`query`](Self::query).
    pub fn query_all<M: Message, R: Message>(
        &mut self,
        port: PortId,
        to: Target,
        question: &M,
        each: impl FnMut(TaskId, Asked<R>),
    ) -> Result<(), TaskError> {
        at_once(self.asked_all(port, to, question, each))
    }

    /// Waits for the most urgent message of a port and reads it. `None` says that the time_out ended first.
    ///
    /// # Errors
    /// [`TaskError`]; [`TaskError::NotThisType`]: the message is lost then.
    pub fn take<M: Message>(
        &mut self,
        port: PortId,
        time_out: Option<Duration>,
    ) -> Result<Option<Received<M>>, TaskError> {
        at_once(self.taken(port, time_out))
    }

    /// Reads the message that was taken last, with all its fragments.
    ///
    /// # Errors
    /// [`TaskError::NotThisType`]; [`TaskError::Gone`] if a message of several packets is read after another was taken.
    pub fn read<M: Message>(&mut self, delivery: &Delivery) -> Result<M, TaskError> {
        decoded(&self.caller.whole(delivery)?)
    }

    /// Answers a received query or command. Does not wait.
    ///
    /// # Errors
    /// As [`reply`](Self::reply).
    pub fn answer<R: Message>(&mut self, to: &ReplyTo, answer: &R) -> Result<(), TaskError> {
        at_once(self.answered(to, answer))
    }
}

impl Caller {
    /// Checks that messages of the port are of this class. An unknown port passes, because the request itself reports it.
    pub(super) fn expect_class(&self, port: PortId, class: Class) -> Result<(), TaskError> {
        let decl = self.node.table.port(port);
        if decl.is_some_and(|port| port.decl.class != class) { Err(wrong_usage()) } else { Ok(()) }
    }

    /// The only task that `to` names; an error if it names none or several.
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

    /// Calls `each` with the outcome of every asked task.
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

    /// The outcome, with the whole answer.
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
