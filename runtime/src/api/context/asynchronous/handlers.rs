//! Handlers of a task that is a future: they interrupt its waits, run at once, and wait for nothing themselves.

use super::AsyncContext;
use crate::api::context::calls::{Calls, at_once, ticks};
use crate::api::context::outcome::{RequestFault, TaskError};
use crate::api::message::Message;
use imrs_protocol::{Call, Delivery, Fault, PortId, Request, Ticks, TimeId};
use std::rc::Rc;
use std::time::Duration;

impl<S> AsyncContext<S> {
    /// From this call on, the handler takes the messages of this port. [`receive`](Self::receive) without a port then
    /// skips this port.
    ///
    /// # Errors
    /// [`Fault::WrongUsage`] if the task does not receive on this port; when the handler runs, [`TaskError::NotThisType`].
    pub fn on_message<M: Message>(
        &mut self,
        port: PortId,
        handler: impl Fn(&mut S, M) -> Result<(), TaskError> + 'static,
    ) -> Result<(), TaskError> {
        self.handle(port, move |ctx, delivery| {
            let message = ctx.read(delivery)?;
            handler(&mut ctx.state, message)
        })
    }

    /// Answers each query or command of this port with what the handler returns. An answer that comes too late is
    /// dropped: the sender of the request has its outcome already.
    ///
    /// # Errors
    /// The errors of [`on_message`](Self::on_message).
    pub fn on_query<M: Message, R: Message>(
        &mut self,
        port: PortId,
        handler: impl Fn(&mut S, M) -> Result<R, TaskError> + 'static,
    ) -> Result<(), TaskError> {
        self.handle(port, move |ctx, delivery| {
            let question = ctx.read(delivery)?;
            let answer = handler(&mut ctx.state, question)?;
            match ctx.answer(&delivery.from, &answer) {
                Err(TaskError::Fault(RequestFault(Fault::Late))) => Ok(()),
                other => other,
            }
        })
    }

    /// From this call on, messages of this port wait for [`receive`](Self::receive) again, and no handler takes them.
    ///
    /// # Errors
    /// The errors of [`on_message`](Self::on_message).
    pub fn unhandle(&mut self, port: PortId) -> Result<(), TaskError> {
        at_once(self.accepted(Request::Handle { port, handled: false }))?;
        self.messages.retain(|(of, _)| *of != port);
        Ok(())
    }

    /// Sets the handler that runs each time this timer of the task expires (Figure 3).
    pub fn on_timer(&mut self, timer: TimeId, handler: impl Fn(&mut S) -> Result<(), TaskError> + 'static) {
        self.timers.retain(|(of, _)| *of != timer);
        self.timers.push((timer, Rc::new(handler)));
    }

    /// Starts a timer, or restarts it if it runs.
    ///
    /// # Errors
    /// [`TaskError::NoHandler`]; [`Fault::TooManyTimers`].
    pub fn start_timer(&mut self, timer: TimeId, length: Duration) -> Result<(), TaskError> {
        if !self.timers.iter().any(|(of, _)| *of == timer) {
            return Err(TaskError::NoHandler(timer));
        }
        at_once(self.accepted(Request::Start { id: timer, length: ticks(length) })).map(|_| ())
    }

    /// Stops a timer; its handler does not run any more.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn stop_timer(&mut self, timer: TimeId) -> Result<(), TaskError> {
        at_once(self.accepted(Request::Stop { id: timer })).map(|_| ())
    }

    fn handle(
        &mut self,
        port: PortId,
        handler: impl Fn(&mut Self, &Delivery) -> Result<(), TaskError> + 'static,
    ) -> Result<(), TaskError> {
        at_once(self.accepted(Request::Handle { port, handled: true }))?;
        self.messages.retain(|(of, _)| *of != port);
        self.messages.push((port, Rc::new(handler)));
        Ok(())
    }

    /// Runs the handler for `call`. `age` is the time since the communication task asked for this.
    pub(super) fn interrupted(&mut self, call: Call, age: Ticks) -> Result<(), TaskError> {
        let done = match call {
            Call::Message(message) => {
                let of_port = self.messages.iter().find(|(port, _)| *port == message.from.port);
                let handler = of_port.map(|(_, handler)| Rc::clone(handler));
                match (handler, self.caller.in_hand(&message, age)) {
                    (Some(handler), Some(message)) => handler(self, &message),
                    (None, _) | (_, None) => Ok(()),
                }
            }
            Call::Timer(timer) => {
                let of_timer = self.timers.iter().find(|(of, _)| *of == timer);
                let handler = of_timer.map(|(_, handler)| Rc::clone(handler));
                handler.map_or(Ok(()), |handler| handler(&mut self.state))
            }
            // A lost lease and a take-over do not interrupt a future: a task that must react to them has a thread or a
            // script. Messages that the future sends under the lost lease are refused.
            Call::Fenced | Call::TakeOver(_) => Ok(()),
        };
        if let Err(error) = &done {
            self.caller.fail(error.clone());
        }
        done
    }
}
