//! Calls with typed messages: every message and answer is a [`Message`].

use super::Context;
use super::answers::decoded;
use super::calls::{Calls, at_once};
use super::outcome::{Asked, Received, TaskError};
use crate::api::message::Message;
use imrs_protocol::{Delivery, PortId, ReplyTo, Target, TaskId};
use std::time::Duration;

impl<S> Context<S> {
    /// Sends a message to all tasks at the other end of a class-1 port. Returns how many copies were accepted.
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

    /// As [`query`](Self::query), to one of several tasks at the other end of the port, or with a shorter TTL than the
    /// port's.
    ///
    /// # Errors
    /// The errors of [`query`](Self::query).
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
    /// The errors of [`query`](Self::query).
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

    /// Reads the message that the task took last, with all its fragments.
    ///
    /// # Errors
    /// [`TaskError::NotThisType`]; [`TaskError::Gone`] if the message has several packets and the task has taken
    /// another message since.
    pub fn read<M: Message>(&mut self, delivery: &Delivery) -> Result<M, TaskError> {
        decoded(&self.caller.whole(delivery)?)
    }

    /// Answers a received query or command. Does not wait.
    ///
    /// # Errors
    /// The errors of [`reply`](Self::reply).
    pub fn answer<R: Message>(&mut self, to: &ReplyTo, answer: &R) -> Result<(), TaskError> {
        at_once(self.answered(to, answer))
    }

    /// Answers a received query or command, and then waits for the next message of a port, as [`take`](Self::take) does: see
    /// [`reply_and_receive`](Self::reply_and_receive).
    ///
    /// # Errors
    /// If the reply fails, the errors of [`reply`](Self::reply), and nothing is received; otherwise those of
    /// [`take`](Self::take).
    pub fn answer_and_take<R: Message, M: Message>(
        &mut self,
        to: &ReplyTo,
        answer: &R,
        port: PortId,
        time_out: Option<Duration>,
    ) -> Result<Option<Received<M>>, TaskError> {
        at_once(self.answered_and_taken((to, answer), port, time_out))
    }
}
