//! The future of one wait of a program, and what happens when this future is dropped.

use super::AsyncContext;
use crate::api::context::outcome::TaskError;
use imrs_protocol::{Request, Signal, Ticks};
use std::future::Future;
use std::pin::Pin;
use std::task::{Context as Poller, Poll};

/// One request and its answer: the only outstanding communication of the task (R93).
pub(super) struct Asking<'a, S> {
    context: &'a mut AsyncContext<S>,
    /// The request to be made next, and a second request, which is made once the first is accepted.
    next: [Option<Request>; 2],
    stage: Stage,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    New,
    Waits,
    Over,
}

impl<'a, S> Asking<'a, S> {
    /// A future that makes `request`. If there is a `reply`, the future makes the reply first.
    pub const fn new(context: &'a mut AsyncContext<S>, reply: Option<Request>, request: Request) -> Self {
        let next = if reply.is_some() { [reply, Some(request)] } else { [Some(request), None] };
        Self { context, next, stage: Stage::New }
    }
}

impl<S> Future for Asking<'_, S> {
    type Output = Result<(Signal, Ticks), TaskError>;

    fn poll(self: Pin<&mut Self>, poller: &mut Poller<'_>) -> Poll<Self::Output> {
        let Self { context, next, stage } = self.get_mut();
        *stage = Stage::Waits;
        loop {
            let answer = context.caller.call_now([next[0].as_ref(), next[1].as_ref()]);
            *next = [None, None];
            match answer {
                Ok(Some((Signal::Interrupt(call), age))) => match context.interrupted(call, age) {
                    Ok(()) => next[0] = Some(Request::Return),
                    Err(error) => {
                        *stage = Stage::Over;
                        return Poll::Ready(Err(error));
                    }
                },
                Ok(Some(answer)) => {
                    *stage = Stage::Over;
                    return Poll::Ready(Ok(answer));
                }
                Err(error) => {
                    *stage = Stage::Over;
                    return Poll::Ready(Err(error));
                }
                Ok(None) if context.caller.listens(poller.waker()) => return Poll::Pending,
                Ok(None) => {}
            }
        }
    }
}

impl<S> Drop for Asking<'_, S> {
    fn drop(&mut self) {
        if self.stage != Stage::Waits {
            return;
        }
        if std::thread::panicking() {
            // No handler may run during a panic: the task has crashed, and cancels all its requests.
            return self.context.caller.give_up();
        }
        self.context.withdraw();
    }
}
