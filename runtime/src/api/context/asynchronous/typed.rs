//! Calls with typed messages, awaited by a future.

use super::AsyncContext;
use crate::api::context::outcome::{Asked, Received, Sent, TaskError};
use crate::api::context::typed::{decoded, encoded, wrong_usage};
use crate::api::message::{LONGEST, Message};
use imrs_protocol::{Class, Delivery, PortId, ReplyTo, Request, Target, TaskId};
use std::time::Duration;

impl<S> AsyncContext<S> {
    /// Tells all tasks at the other end of a class-1 port. Returns how many copies were accepted.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn tell<M: Message>(&mut self, port: PortId, message: &M) -> Result<u16, TaskError> {
        self.caller.expect_class(port, Class::Status)?;
        let mut room = [0; LONGEST];
        let packets = self.caller.node.table.port(port).map_or(1, |port| port.decl.fragments);
        let contents = self.staged(port, encoded(message, &mut room)?, packets)?;
        self.at_once(Request::Send { port, to: Target::All, contents, time_out: None })
    }

    /// Asks the task at the other end of a port: a query, or a command if the port's usage is `send` and its class is 2.
    /// Waits for the answer, at most for the port's time_out.
    ///
    /// # Errors
    /// [`TaskError`]; [`TaskError::NotThisType`] if the answer is no `R`.
    pub async fn query<M: Message, R: Message>(
        &mut self,
        port: PortId,
        question: &M,
    ) -> Result<Asked<R>, TaskError> {
        self.query_with(port, Target::All, question, None).await
    }

    /// As [`query`](Self::query), to one of several tasks at the other end, or with a shorter TTL than the port's.
    ///
    /// # Errors
    /// As [`query`](Self::query).
    pub async fn query_with<M: Message, R: Message>(
        &mut self,
        port: PortId,
        to: Target,
        question: &M,
        time_out: Option<Duration>,
    ) -> Result<Asked<R>, TaskError> {
        self.caller.expect_class(port, Class::Command)?;
        let peer = self.caller.peer(port, to)?;
        let mut room = [0; LONGEST];
        let bytes = encoded(question, &mut room)?;
        match self.send_with(port, Target::One(peer), bytes, time_out).await? {
            Sent::Outcome(outcome) => self.caller.asked(port, peer, outcome),
            Sent::Copies(_) | Sent::Several(_) => Err(wrong_usage()),
        }
    }

    /// Asks several tasks at once, and calls `each` with the outcome of every asked task. Waits until all have answered or
    /// refused, at most for the port's time_out.
    ///
    /// # Errors
    /// As [`query`](Self::query).
    pub async fn query_all<M: Message, R: Message>(
        &mut self,
        port: PortId,
        to: Target,
        question: &M,
        mut each: impl FnMut(TaskId, Asked<R>),
    ) -> Result<(), TaskError> {
        self.caller.expect_class(port, Class::Command)?;
        let mut room = [0; LONGEST];
        let bytes = encoded(question, &mut room)?;
        match self.send_with(port, to, bytes, None).await? {
            Sent::Copies(_) => Err(wrong_usage()),
            Sent::Outcome(outcome) => {
                let peer = self.caller.peer(port, to)?;
                each(peer, self.caller.asked(port, peer, outcome)?);
                Ok(())
            }
            Sent::Several(answers) => self.caller.each_answer(port, &answers, each),
        }
    }

    /// Waits for the most urgent message of a port and reads it. `None` says that the time_out ended first.
    ///
    /// # Errors
    /// [`TaskError`]; [`TaskError::NotThisType`]: the message is lost then.
    pub async fn take<M: Message>(
        &mut self,
        port: PortId,
        time_out: Option<Duration>,
    ) -> Result<Option<Received<M>>, TaskError> {
        let Some(delivery) = self.receive(Some(port), time_out).await? else { return Ok(None) };
        let message = self.read(&delivery)?;
        Ok(Some(Received { message, from: delivery.from, budget: delivery.budget }))
    }

    /// Reads the message that was taken last, with all its fragments.
    ///
    /// # Errors
    /// [`TaskError::NotThisType`]; [`TaskError::Gone`] if a message of several packets is read after another was taken.
    pub fn read<M: Message>(&mut self, delivery: &Delivery) -> Result<M, TaskError> {
        decoded(&self.caller.whole(delivery)?)
    }

    /// Answers a received query or command with a message.
    ///
    /// # Errors
    /// As [`reply`](Self::reply).
    pub fn answer<R: Message>(&mut self, to: &ReplyTo, answer: &R) -> Result<(), TaskError> {
        let mut room = [0; LONGEST];
        self.reply(to, encoded(answer, &mut room)?)
    }
}
