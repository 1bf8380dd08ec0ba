//! The calls that a task's program makes to its communication task (§II, §5.2.1).

mod answers;
mod asynchronous;
mod caller;
mod calls;
mod handlers;
mod many;
mod outcome;
mod typed;

pub use asynchronous::AsyncContext;
pub use many::MANY;
pub use outcome::{Asked, Received, Rendezvous, RequestFault, Sent, TaskError};

pub(crate) use caller::Caller;

use crate::clock::{self, Micros};
use crate::node::comm::Completion;
use crate::node::{More, Node};
use calls::{Calls, at_once};
use handlers::Handlers;
use imrs_protocol::{Contents, Delivery, PortId, Ranked, ReplyTo, Request, Signal, Target, TaskId, Ticks};
use std::future::{Future, ready};
use std::sync::Arc;
use std::time::Duration;

/// A task's access to its communication task. Every call that waits ends by its time_out, or with [`TaskError::Stopped`] when the
/// node stops.
///
/// `S` is the state that the program and its handlers share: see [`with_state`](Self::with_state).
///
/// ```
/// use imrs_protocol::{Cell, CellTable, PortDecl, Ticks, Usage};
/// use imrs_runtime::{Context, Runtime, TaskEnd, TaskError};
/// use std::{sync::Arc, time::Duration};
///
/// /// Waits for a part, at most 5 s, and answers with its number.
/// fn press(ctx: &mut Context) -> Result<(), TaskError> {
///     let part = ctx.port("part")?;
///     match ctx.receive(Some(part), Some(Duration::from_secs(5)))? {
///         Some(message) => ctx.reply(&message.from, message.contents.as_bytes()),
///         None => Ok(()),
///     }
/// }
///
/// let mut cell = Cell::new("line", Ticks(1_000));
/// let here = cell.node("here");
/// let (robot, machine) = (cell.task("robot", here), cell.task("press", here));
/// cell.port(PortDecl::new("part", robot, Usage::Send, &[machine], Ticks(5_000_000)).command());
/// let table = Arc::new(CellTable::new(cell).expect("a sound cell"));
///
/// let node = Runtime::builder(table, here)
///     .task("press", press)
///     .task("robot", |ctx| {
///         let part = ctx.port("part")?;
///         let sent = ctx.send(part, &[7])?;
///         assert_eq!(sent.reply().expect("the press answers in time").as_bytes(), [7]);
///         Ok(())
///     })
///     .start()
///     .expect("a node that starts");
/// assert!(node.wait(Duration::from_secs(10)));
/// assert!(node.stop(Duration::from_secs(10)).iter().all(|(_, end)| *end == TaskEnd::Returned));
/// ```
pub struct Context<S = ()> {
    /// The state that the program and its handlers share.
    pub state: S,
    caller: Caller,
    handlers: Handlers<S>,
    /// Messages that one call of `receive_many` takes, each with the instant at which it was taken. Empty between
    /// calls.
    taken: Vec<(Micros, Delivery)>,
}

impl Context {
    /// Gives a program a state that it shares with its handlers.
    ///
    /// ```no_run
    /// # use imrs_runtime::{Builder, Context, protocol::PortId};
    /// # fn tasks(builder: Builder, count: PortId) -> Builder {
    /// builder.task("counter", Context::with_state(0, move |ctx| {
    ///     ctx.on_query(count, |ctx, ()| {
    ///         ctx.state += 1;
    ///         Ok(ctx.state)
    ///     })?;
    ///     ctx.receive(None, None).map(|_| ())
    /// }))
    /// # }
    /// ```
    pub fn with_state<S>(
        state: S,
        program: impl FnOnce(&mut Context<S>) -> Result<(), TaskError>,
    ) -> impl FnOnce(&mut Self) -> Result<(), TaskError> {
        move |ctx| {
            let (node, place) = ctx.caller.location();
            program(&mut Context::new(node, place, state))
        }
    }
}

impl<S> Context<S> {
    pub(crate) fn new(node: Arc<Node>, place: usize, state: S) -> Self {
        Self { state, caller: Caller::new(node, place), handlers: Handlers::default(), taken: Vec::new() }
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

    /// Sends to all tasks at the other end of the port. A class-1 send returns at once; a class-2 send waits for the
    /// answers. A message may be as long as the port's format: up to 16 packets of 12 bytes.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn send(&mut self, port: PortId, contents: &[u8]) -> Result<Sent, TaskError> {
        at_once(self.sent(port, Target::All, contents, None))
    }

    /// Sends to one of the tasks at the other end of the port.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn send_to(&mut self, port: PortId, to: TaskId, contents: &[u8]) -> Result<Sent, TaskError> {
        at_once(self.sent(port, Target::One(to), contents, None))
    }

    /// Sends with another TTL than the port's time_out.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn send_with(
        &mut self,
        port: PortId,
        to: Target,
        contents: &[u8],
        time_out: Option<Duration>,
    ) -> Result<Sent, TaskError> {
        at_once(self.sent(port, to, contents, time_out))
    }

    /// Lets the messages that `work` sends leave together: all packets for one neighbour in one datagram, the most
    /// urgent first, or in one call that the kernel cuts into datagrams. The packets leave when `work` ends, before
    /// any call in `work` waits, or once there are as many as the link takes at once. Outside of `together` every
    /// message leaves at once. No time_out makes packets leave earlier, so `work` should do nothing but send.
    ///
    /// ```no_run
    /// # use imrs_runtime::{Context, TaskError, protocol::PortId};
    /// # fn tell(ctx: &mut Context, joints: &[PortId; 12], angles: &[[u8; 8]; 12]) -> Result<(), TaskError> {
    /// ctx.together(|ctx| {
    ///     joints.iter().zip(angles).try_for_each(|(port, angle)| ctx.send(*port, angle).map(|_| ()))
    /// })
    /// # }
    /// ```
    pub fn together<R>(&mut self, work: impl FnOnce(&mut Self) -> R) -> R {
        let before = self.caller.hold(true);
        let done = work(self);
        self.caller.hold(before);
        done
    }

    /// Waits for the most urgent message of a port or, without a port, of all the task's ports. `None` says that the time_out
    /// ended first; without a time_out the wait has no end.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn receive(
        &mut self,
        port: Option<PortId>,
        time_out: Option<Duration>,
    ) -> Result<Option<Delivery>, TaskError> {
        at_once(self.received(port, None, time_out))
    }

    /// As [`receive`](Self::receive), but takes only messages of one source.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn receive_from(
        &mut self,
        port: Option<PortId>,
        source: TaskId,
        time_out: Option<Duration>,
    ) -> Result<Option<Delivery>, TaskError> {
        at_once(self.received(port, Some(source), time_out))
    }

    /// Takes the most urgent message if there is one, without waiting.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn poll(&mut self, port: Option<PortId>) -> Result<Option<Delivery>, TaskError> {
        at_once(self.received(port, None, Some(Duration::ZERO)))
    }

    /// Answers a received class-2 message. Does not wait.
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
    /// # use imrs_runtime::{Context, TaskError, protocol::PortId};
    /// # fn serve(ctx: &mut Context, ask: PortId) -> Result<(), TaskError> {
    /// let mut next = ctx.receive(Some(ask), None)?;
    /// while let Some(message) = next {
    ///     let answer = message.contents;
    ///     next = ctx.reply_and_receive(&message.from, answer.as_bytes(), Some(ask), None)?;
    /// }
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// The errors of [`reply`](Self::reply); then nothing is received.
    pub fn reply_and_receive(
        &mut self,
        to: &ReplyTo,
        contents: &[u8],
        port: Option<PortId>,
        time_out: Option<Duration>,
    ) -> Result<Option<Delivery>, TaskError> {
        at_once(self.replied_and_received(to, contents, port, time_out))
    }

    /// Waits until all tasks of the port have reached this point (§4.3), at most for the port's time_out.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn waitfor(&mut self, port: PortId) -> Result<Rendezvous, TaskError> {
        at_once(self.met(port, [0; 8], None))
    }

    /// As [`waitfor`](Self::waitfor), with arguments for the other members, or with a shorter time_out than the port's.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn waitfor_with(
        &mut self,
        port: PortId,
        arguments: [u8; 8],
        time_out: Option<Duration>,
    ) -> Result<Rendezvous, TaskError> {
        at_once(self.met(port, arguments, time_out))
    }

    /// Ranks ports, sources, timers and the current thread from here on (§5.1.1). Of two messages with equal
    /// time_outs the one with the higher rank is served first. Anything that is not in `named` ranks last.
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
    pub fn delay(&mut self, length: Duration) -> Result<(), TaskError> {
        at_once(self.delayed(length))
    }

    /// Waits until the task holds the lease of its couple. Returns the epoch under which it acts.
    ///
    /// # Errors
    /// [`Fault::WrongUsage`](imrs_protocol::Fault::WrongUsage) if the task is not the primary of a couple.
    pub fn lease(&mut self) -> Result<u8, TaskError> {
        at_once(self.leased())
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

    /// Makes a request and waits for its answer. Handlers run during the wait. Returns the answer and its age. Passes
    /// each answer to `more`, too.
    fn call_with(&mut self, request: Request, more: More<'_>) -> Result<(Signal, Ticks), TaskError> {
        let asked = clock::next();
        let over = match request {
            Request::Delay { length, .. } => asked.saturating_add(length.0),
            _ => clock::FAR,
        };
        let (mut signal, mut age) = self.caller.call(asked, request, over, more)?;
        while let Signal::Interrupt(call) = signal {
            self.interrupted(call, age)?;
            (signal, age) = self.caller.call(clock::next(), Request::Return, over, more)?;
        }
        Ok((signal, age))
    }
}

impl<S> Calls for Context<S> {
    fn caller(&mut self) -> &mut Caller {
        &mut self.caller
    }

    fn ask_after(
        &mut self,
        reply: Option<Request>,
        request: Request,
    ) -> impl Future<Output = Result<(Signal, Ticks), TaskError>> {
        let Some(reply) = reply else { return ready(self.call_with(request, &mut |_| None)) };
        let mut after = Some(request);
        // Both requests are made under one lock.
        let mut more = |completion: &Completion| match completion.signal {
            Signal::Accepted(_) => after.take(),
            _ => None,
        };
        ready(self.call_with(reply, &mut more))
    }
}
