//! Handlers, which interrupt a task's waits (D15, D46).

use super::Context;
use super::calls::{Calls, at_once, ticks};
use super::outcome::{RequestFault, TaskError};
use crate::api::message::Message;
use imrs_protocol::{Call, Delivery, Fault, PortId, Request, Ticks, TimeId};
use std::rc::Rc;
use std::time::Duration;

type OnMessage<S> = Rc<dyn Fn(&mut Context<S>, Delivery) -> Result<(), TaskError>>;
type OnTimer<S> = Rc<dyn Fn(&mut Context<S>) -> Result<(), TaskError>>;
type OnTakeover<S> = Rc<dyn Fn(&mut Context<S>, u8) -> Result<(), TaskError>>;

/// The handlers of a task. Each is reference-counted while it runs, because a message that outranks a running handler
/// may call the same handler again.
pub(super) struct Handlers<S> {
    messages: Vec<(PortId, OnMessage<S>)>,
    timers: Vec<(TimeId, OnTimer<S>)>,
    fence: Option<OnTimer<S>>,
    takeover: Option<OnTakeover<S>>,
}

impl<S> Default for Handlers<S> {
    fn default() -> Self {
        Self { messages: Vec::new(), timers: Vec::new(), fence: None, takeover: None }
    }
}

/// # Handlers
///
/// A handler runs on the task's own thread, inside a call that waits, or in [`boundary`](Context::boundary): a Rust
/// program cannot be interrupted between two calls. The communication task decides by [`order`](Context::order)
/// whether a message or the end of a timer interrupts. Without an order, `self` ranks first: a handler then runs only
/// while the task waits in a [`receive`](Context::receive), or after its message was rejected as often as the rules
/// allow. Afterwards the interrupted wait goes on with its remaining time.
///
/// If a handler fails, its task fails: every later call of the program returns the handler's error.
///
/// ```
/// use imrs_protocol::{Cell, CellTable, PortDecl, Ranked, Ticks, Usage};
/// use imrs_runtime::{Asked, Context, Runtime};
/// use std::{sync::Arc, time::Duration};
///
/// let mut cell = Cell::new("pose", Ticks(1_000));
/// let here = cell.node("here");
/// let (arm, eye) = (cell.task("arm", here), cell.task("eye", here));
/// cell.port(PortDecl::new("pose", eye, Usage::Query, &[arm], Ticks(500_000)).command());
/// let table = Arc::new(CellTable::new(cell).expect("a sound cell"));
///
/// let node = Runtime::builder(table, here)
///     .task("arm", Context::with_state((120_i16, false), |ctx| {
///         let pose = ctx.port("pose")?;
///         ctx.order(&[Ranked::Port(pose), Ranked::Own])?;
///         ctx.on_query(pose, |ctx, ()| {
///             ctx.state.1 = true;
///             Ok(ctx.state.0)
///         })?;
///         while !ctx.state.1 {
///             ctx.delay(Duration::from_millis(20))?; // interrupted by the query
///         }
///         Ok(())
///     }))
///     .task("eye", |ctx| {
///         let pose = ctx.port("pose")?;
///         match ctx.query::<(), i16>(pose, &())? {
///             Asked::Reply(x) => assert_eq!(x, 120),
///             Asked::Refused | Asked::TimedOutUnsent => panic!("the arm was not asked"),
///             Asked::TimedOutUnknown | Asked::PeerRestarted => panic!("the arm may have answered"),
///         }
///         Ok(())
///     })
///     .start()
///     .expect("a node that starts");
/// assert!(node.wait(Duration::from_secs(10)));
/// # let ends = node.stop(Duration::from_secs(10));
/// # assert!(ends.iter().all(|(_, end)| *end == imrs_runtime::TaskEnd::Returned), "{ends:?}");
/// ```
impl<S> Context<S> {
    /// From this call on, the handler takes the messages of this port. [`receive`](Context::receive) without a port
    /// then skips this port.
    ///
    /// # Errors
    /// [`Fault::WrongUsage`] if the task does not receive on this port.
    pub fn on_message(
        &mut self,
        port: PortId,
        handler: impl Fn(&mut Self, Delivery) -> Result<(), TaskError> + 'static,
    ) -> Result<(), TaskError> {
        at_once(self.accepted(Request::Handle { port, handled: true }))?;
        self.handlers.messages.retain(|(of, _)| *of != port);
        self.handlers.messages.push((port, Rc::new(handler)));
        Ok(())
    }

    /// Answers each query or command of this port with what the handler returns. An answer that comes too late is
    /// dropped: the sender of the request has its outcome already.
    ///
    /// # Errors
    /// As [`on_message`](Self::on_message); when the handler runs, [`TaskError::NotThisType`].
    pub fn on_query<M: Message, R: Message>(
        &mut self,
        port: PortId,
        handler: impl Fn(&mut Self, M) -> Result<R, TaskError> + 'static,
    ) -> Result<(), TaskError> {
        self.on_message(port, move |ctx, delivery| {
            let question = ctx.read(&delivery)?;
            let answer = handler(ctx, question)?;
            match ctx.answer(&delivery.from, &answer) {
                Err(TaskError::Fault(RequestFault(Fault::Late))) => Ok(()),
                other => other,
            }
        })
    }

    /// From this call on, messages of this port wait for [`receive`](Context::receive) again, and no handler takes
    /// them.
    ///
    /// # Errors
    /// The errors of [`on_message`](Self::on_message).
    pub fn unhandle(&mut self, port: PortId) -> Result<(), TaskError> {
        at_once(self.accepted(Request::Handle { port, handled: false }))?;
        self.handlers.messages.retain(|(of, _)| *of != port);
        Ok(())
    }

    /// Sets the handler that runs each time this timer of the task expires (Figure 3).
    pub fn on_timer(
        &mut self,
        timer: TimeId,
        handler: impl Fn(&mut Self) -> Result<(), TaskError> + 'static,
    ) {
        self.handlers.timers.retain(|(of, _)| *of != timer);
        self.handlers.timers.push((timer, Rc::new(handler)));
    }

    /// Starts a timer, or restarts it if it runs.
    ///
    /// # Errors
    /// [`TaskError::NoHandler`]; [`Fault::TooManyTimers`].
    pub fn start_timer(&mut self, timer: TimeId, length: Duration) -> Result<(), TaskError> {
        if !self.handlers.timers.iter().any(|(of, _)| *of == timer) {
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

    /// Sets the handler that runs when the task loses its lease. The handler outranks everything, `atomic` sections
    /// too. A message that the program then sends on a port under the lease is refused with [`Fault::Fenced`], even
    /// without a handler.
    pub fn on_fence(&mut self, handler: impl Fn(&mut Self) -> Result<(), TaskError> + 'static) {
        self.handlers.fence = Some(Rc::new(handler));
    }

    /// Sets the handler that runs when a standby takes over. The handler gets the new epoch.
    pub fn on_takeover(&mut self, handler: impl Fn(&mut Self, u8) -> Result<(), TaskError> + 'static) {
        self.handlers.takeover = Some(Rc::new(handler));
    }

    /// A statement boundary: handlers that outrank the task's thread run here. Call this in loops that compute without
    /// waiting.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn boundary(&mut self) -> Result<(), TaskError> {
        at_once(self.accepted(Request::Boundary)).map(|_| ())
    }

    /// Runs a section that no handler interrupts, even while it waits; only the loss of the lease does.
    ///
    /// # Errors
    /// [`TaskError`], of the section too.
    pub fn atomic<R>(
        &mut self,
        section: impl FnOnce(&mut Self) -> Result<R, TaskError>,
    ) -> Result<R, TaskError> {
        if self.caller.atomic {
            return section(self);
        }
        at_once(self.accepted(Request::Atomic(true)))?;
        self.caller.atomic = true;
        let done = section(self);
        self.caller.atomic = false;
        at_once(self.accepted(Request::Atomic(false)))?;
        done
    }

    /// Runs the handler for `call`. `age` is the time since the communication task asked for this.
    pub(super) fn interrupted(&mut self, call: Call, age: Ticks) -> Result<(), TaskError> {
        let atomic = std::mem::take(&mut self.caller.atomic);
        self.caller.depth += 1;
        let done = self.handle(call, age);
        self.caller.depth -= 1;
        self.caller.atomic = atomic;
        if let Err(error) = &done {
            self.caller.fail(error.clone());
        }
        done
    }

    fn handle(&mut self, call: Call, age: Ticks) -> Result<(), TaskError> {
        match call {
            Call::Message(message) => {
                let Some(message) = self.caller.in_hand(&message, age) else { return Ok(()) };
                let of_port = self.handlers.messages.iter().find(|(port, _)| *port == message.from.port);
                let handler = of_port.map(|(_, handler)| Rc::clone(handler));
                handler.map_or(Ok(()), |handler| handler(self, message))
            }
            Call::Timer(timer) => {
                let of_timer = self.handlers.timers.iter().find(|(of, _)| *of == timer);
                let handler = of_timer.map(|(_, handler)| Rc::clone(handler));
                handler.map_or(Ok(()), |handler| handler(self))
            }
            Call::Fenced => self.handlers.fence.clone().map_or(Ok(()), |handler| handler(self)),
            Call::TakeOver(epoch) => {
                self.handlers.takeover.clone().map_or(Ok(()), |handler| handler(self, epoch))
            }
        }
    }
}
