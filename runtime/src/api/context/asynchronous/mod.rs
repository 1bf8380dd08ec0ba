//! The calls that a task's program makes to its communication task if the program is a future (D113).

mod asking;
mod handlers;
mod typed;

use super::Caller;
use super::calls::{Calls, at_once};
use super::outcome::{Rendezvous, Sent, TaskError};
use crate::clock::{self, Micros};
use asking::Asking;
use imrs_protocol::{
    Contents, Delivery, PortId, Ranked, ReplyTo, Request, Signal, Target, TaskId, Ticks, TimeId,
};
use std::future::Future;
use std::rc::Rc;
use std::time::Duration;

type OnMessage<S> = Rc<dyn Fn(&mut AsyncContext<S>, &Delivery) -> Result<(), TaskError>>;
type OnTimer<S> = Rc<dyn Fn(&mut S) -> Result<(), TaskError>>;

/// A task's access to its communication task if its program is a future: see [`Builder::async_task`](crate::Builder::async_task).
/// Calls that wait are `async` functions, and mean the same as those of [`Context`](crate::Context) with the same name. Calls
/// that never wait are plain functions.
///
/// ```
/// use imrs_protocol::{Cell, CellTable, PortDecl, Ticks, Usage};
/// use imrs_runtime::{AsyncContext, Rendezvous, Runtime, TaskEnd, TaskError};
/// use std::{sync::Arc, time::Duration};
///
/// /// Starts together with the other arm, or not at all.
/// async fn arm(mut ctx: AsyncContext) -> Result<(), TaskError> {
///     let lift = ctx.port("lift")?;
///     let meeting = ctx.waitfor(lift).await?;
///     assert!(matches!(meeting, Rendezvous::Released { .. }), "both arms are here");
///     Ok(())
/// }
///
/// let mut cell = Cell::new("lift", Ticks(1_000));
/// let here = cell.node("here");
/// let (left, right) = (cell.task("left", here), cell.task("right", here));
/// cell.port(PortDecl::new("lift", left, Usage::Waitfor, &[right], Ticks(5_000_000)));
/// let table = Arc::new(CellTable::new(cell).expect("a sound cell"));
///
/// let node = Runtime::builder(table, here)
///     .async_task("left", arm)
///     .async_task("right", arm)
///     .start()
///     .expect("a node that starts");
/// assert!(node.wait(Duration::from_secs(10)));
/// assert!(node.stop(Duration::from_secs(10)).iter().all(|(_, end)| *end == TaskEnd::Returned));
/// ```
///
/// # Dropped futures
///
/// A call makes its request when its future is first polled. The future of a call that waits may be dropped before it
/// is ready, as `select!` does. The communication task then cancels the wait ([`Request::Cancel`]):
///
/// - a `receive` is cancelled. If the task already has its message, the message is kept for the next `receive` that
///   accepts it, unless it expires before that;
/// - a `delay`, or a wait for the `lease`, ends;
/// - a task that leaves a `waitfor` sends the other members an ABORT, as after a time_out;
/// - the answer to a command or a query is lost: the other task may have acted.
///
/// # Handlers
///
/// A handler runs where the program waits in a call of this type, as [`order`](Self::order) ranks it. A handler is a
/// plain function, not a future, and gets only the state. A handler that must wait belongs into a task with a thread,
/// or into a script. If a handler fails, every later call of the program returns the handler's error.
pub struct AsyncContext<S = ()> {
    /// The state that the program and its handlers share.
    pub state: S,
    caller: Caller,
    messages: Vec<(PortId, OnMessage<S>)>,
    timers: Vec<(TimeId, OnTimer<S>)>,
    /// Received messages whose `receive` was dropped, each with the instant of its arrival. A later `receive` takes
    /// them.
    kept: Vec<(Delivery, Micros)>,
}

impl AsyncContext {
    /// Gives a program a state that it shares with its handlers: `async_task("a", AsyncContext::with_state(0, program))`.
    pub fn with_state<S, F: Future<Output = Result<(), TaskError>>>(
        state: S,
        program: impl FnOnce(AsyncContext<S>) -> F,
    ) -> impl FnOnce(Self) -> F {
        move |ctx| program(AsyncContext::new(ctx.caller, state))
    }
}

impl<S> AsyncContext<S> {
    pub(crate) const fn new(caller: Caller, state: S) -> Self {
        Self { state, caller, messages: Vec::new(), timers: Vec::new(), kept: Vec::new() }
    }

    /// The task's number in the cell.
    #[must_use]
    pub fn id(&self) -> TaskId {
        self.caller.task()
    }

    /// The task's name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.caller.node.table.cell().tasks[self.id().index()].name
    }

    /// Looks up a port of this task. Do it once, before the work begins.
    ///
    /// # Errors
    /// [`TaskError::NoPort`].
    pub fn port(&self, name: &str) -> Result<PortId, TaskError> {
        self.caller.port(name)
    }

    /// Looks up a task of the cell.
    ///
    /// # Errors
    /// [`TaskError::NoTask`].
    pub fn task(&self, name: &str) -> Result<TaskId, TaskError> {
        self.caller.named(name)
    }

    /// Sends to all tasks at the other end of the port. A class-1 send completes at once; a class-2 send waits for
    /// the answers.
    ///
    /// # Errors
    /// [`TaskError`].
    pub async fn send(&mut self, port: PortId, contents: &[u8]) -> Result<Sent, TaskError> {
        self.sent(port, Target::All, contents, None).await
    }

    /// Sends to one of the tasks at the other end of the port.
    ///
    /// # Errors
    /// [`TaskError`].
    pub async fn send_to(&mut self, port: PortId, to: TaskId, contents: &[u8]) -> Result<Sent, TaskError> {
        self.sent(port, Target::One(to), contents, None).await
    }

    /// Sends with another TTL than the port's time_out.
    ///
    /// # Errors
    /// [`TaskError`].
    pub async fn send_with(
        &mut self,
        port: PortId,
        to: Target,
        contents: &[u8],
        time_out: Option<Duration>,
    ) -> Result<Sent, TaskError> {
        self.sent(port, to, contents, time_out).await
    }

    /// Waits for the most urgent message of a port or, without a port, of all the task's ports. `None` says that the time_out
    /// ended first; without a time_out the wait has no end.
    ///
    /// # Errors
    /// [`TaskError`].
    pub async fn receive(
        &mut self,
        port: Option<PortId>,
        time_out: Option<Duration>,
    ) -> Result<Option<Delivery>, TaskError> {
        self.received(port, None, time_out).await
    }

    /// As [`receive`](Self::receive), but takes only messages of one source.
    ///
    /// # Errors
    /// [`TaskError`].
    pub async fn receive_from(
        &mut self,
        port: Option<PortId>,
        source: TaskId,
        time_out: Option<Duration>,
    ) -> Result<Option<Delivery>, TaskError> {
        self.received(port, Some(source), time_out).await
    }

    /// Takes the most urgent message if there is one. Does not wait, but first runs the handlers that are due.
    ///
    /// # Errors
    /// [`TaskError`].
    pub async fn poll(&mut self, port: Option<PortId>) -> Result<Option<Delivery>, TaskError> {
        self.received(port, None, Some(Duration::ZERO)).await
    }

    /// Lets the messages that `work` sends leave together: see [`Context::together`](crate::Context::together).
    /// `work` is not a future, so it cannot wait for answers.
    pub fn together<R>(&mut self, work: impl FnOnce(&mut Self) -> R) -> R {
        let before = self.caller.hold(true);
        let done = work(self);
        self.caller.hold(before);
        done
    }

    /// Answers a received class-2 message.
    ///
    /// # Errors
    /// `Fault::Late` if the sender no longer waits: it will not get this answer.
    pub fn reply(&mut self, to: &ReplyTo, contents: &[u8]) -> Result<(), TaskError> {
        at_once(self.replied(to, contents))
    }

    /// Answers a received class-2 message, and then waits for the next message as [`receive`](Self::receive) does.
    /// This costs less than two calls, because the communication task's lock is taken only once.
    ///
    /// ```no_run
    /// # use imrs_runtime::{AsyncContext, TaskError, protocol::PortId};
    /// # async fn serve(mut ctx: AsyncContext, ask: PortId) -> Result<(), TaskError> {
    /// let mut next = ctx.receive(Some(ask), None).await?;
    /// while let Some(message) = next {
    ///     let answer = message.contents;
    ///     next = ctx.reply_and_receive(&message.from, answer.as_bytes(), Some(ask), None).await?;
    /// }
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// The errors of [`reply`](Self::reply); then nothing is received.
    pub async fn reply_and_receive(
        &mut self,
        to: &ReplyTo,
        contents: &[u8],
        port: Option<PortId>,
        time_out: Option<Duration>,
    ) -> Result<Option<Delivery>, TaskError> {
        self.replied_and_received(to, contents, port, time_out).await
    }

    /// Waits until all tasks of the port have reached this point (§4.3), at most for the port's time_out.
    ///
    /// # Errors
    /// [`TaskError`].
    pub async fn waitfor(&mut self, port: PortId) -> Result<Rendezvous, TaskError> {
        self.met(port, [0; 8], None).await
    }

    /// As [`waitfor`](Self::waitfor), with arguments for the other members, or with a shorter time_out than the port's.
    ///
    /// # Errors
    /// [`TaskError`].
    pub async fn waitfor_with(
        &mut self,
        port: PortId,
        arguments: [u8; 8],
        time_out: Option<Duration>,
    ) -> Result<Rendezvous, TaskError> {
        self.met(port, arguments, time_out).await
    }

    /// Ranks ports, sources, timers and the task's own thread from here on (§5.1.1).
    ///
    /// # Errors
    /// [`TaskError::TooManyLevels`].
    pub fn order(&mut self, named: &[Ranked]) -> Result<(), TaskError> {
        at_once(self.ordered(named))
    }

    /// Waits for at least `length` (§5.1.2).
    ///
    /// # Errors
    /// [`TaskError::Stopped`].
    pub async fn delay(&mut self, length: Duration) -> Result<(), TaskError> {
        self.delayed(length).await
    }

    /// Waits until the task holds the lease of its couple. Returns the epoch under which it acts.
    ///
    /// # Errors
    /// [`WrongUsage`](imrs_protocol::Fault::WrongUsage) if the task is not the primary of a couple.
    pub async fn lease(&mut self) -> Result<u8, TaskError> {
        self.leased().await
    }

    /// Sets the data that every later answer to the partner's heartbeats carries: at most 8 bytes.
    ///
    /// # Errors
    /// [`TaskError::TooLong`].
    pub fn publish(&mut self, bytes: &[u8]) -> Result<(), TaskError> {
        at_once(self.publishes(bytes))
    }

    /// The data that the partner's last answer to a heartbeat carried; `None` before the first answer.
    #[must_use]
    pub fn published(&mut self) -> Option<Contents> {
        self.caller.look(|comm| comm.machine().partner_published().copied())
    }

    /// A statement boundary: runs the handlers that are due.
    ///
    /// # Errors
    /// [`TaskError`], of the handlers too.
    pub async fn boundary(&mut self) -> Result<(), TaskError> {
        self.accepted(Request::Boundary).await.map(|_| ())
    }

    /// Runs a section that no handler interrupts, even while it waits. Dropping the section's future ends it.
    ///
    /// # Errors
    /// [`TaskError`], of the section too.
    pub async fn atomic<R>(
        &mut self,
        section: impl AsyncFnOnce(&mut Self) -> Result<R, TaskError>,
    ) -> Result<R, TaskError> {
        if self.caller.atomic {
            return section(self).await;
        }
        at_once(self.accepted(Request::Atomic(true)))?;
        self.caller.atomic = true;
        let open = Section(self);
        let done = section(&mut *open.0).await;
        drop(open);
        done
    }

    /// Cancels the wait of a dropped future. Runs the handlers that are due first. Keeps a message that the task
    /// already has.
    fn withdraw(&mut self) {
        let mut next = Request::Cancel;
        loop {
            match self.caller.call_now([Some(&next), None]) {
                Ok(Some((Signal::Interrupt(call), age))) => {
                    if self.interrupted(call, age).is_err() {
                        return;
                    }
                    next = Request::Return;
                }
                Ok(Some((Signal::Message(message), age))) => {
                    self.caller.taken = Some(message.from);
                    return self.kept.push((message, clock::now().saturating_sub(age.0)));
                }
                Ok(None) => next = Request::Cancel,
                Ok(Some(_)) | Err(_) => return,
            }
        }
    }
}

impl<S> Calls for AsyncContext<S> {
    fn caller(&mut self) -> &mut Caller {
        &mut self.caller
    }

    fn ask_after(
        &mut self,
        reply: Option<Request>,
        request: Request,
    ) -> impl Future<Output = Result<(Signal, Ticks), TaskError>> {
        Asking::new(self, reply, request)
    }

    fn keeps(&self) -> bool {
        !self.kept.is_empty()
    }

    /// Takes a kept message that suits this call and has not expired: it was received for a call that was then
    /// dropped.
    fn kept(&mut self, port: Option<PortId>, source: Option<TaskId>) -> Option<Delivery> {
        let suits = |delivery: &Delivery| {
            port.is_none_or(|port| port == delivery.from.port)
                && source.is_none_or(|source| source == delivery.from.source)
        };
        while let Some(at) = self.kept.iter().position(|(delivery, _)| suits(delivery)) {
            let (delivery, since) = self.kept.remove(at);
            let message = self.caller.still_alive(&delivery, Ticks(clock::now().saturating_sub(since)));
            if message.is_some() {
                return message;
            }
        }
        None
    }
}

/// An open atomic section. Dropping it closes it.
struct Section<'a, S>(&'a mut AsyncContext<S>);

impl<S> Drop for Section<'_, S> {
    fn drop(&mut self) {
        self.0.caller.atomic = false;
        // The communication task refuses this only if the task has ended; then no handler interrupts the task any more.
        let _ = at_once(self.0.accepted(Request::Atomic(false)));
    }
}
