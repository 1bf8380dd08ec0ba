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
    /// The next request to the communication task.
    next: Option<Request>,
    stage: Stage,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    New,
    Waits,
    Over,
}

impl<'a, S> Asking<'a, S> {
    pub const fn new(context: &'a mut AsyncContext<S>, request: Request) -> Self {
        Self { context, next: Some(request), stage: Stage::New }
    }
}

impl<S> Future for Asking<'_, S> {
    type Output = Result<(Signal, Ticks), TaskError>;

    fn poll(self: Pin<&mut Self>, poller: &mut Poller<'_>) -> Poll<Self::Output> {
        let Self { context, next, stage } = self.get_mut();
        *stage = Stage::Waits;
        loop {
            let answer = context.caller.call_now(next.as_ref());
            *next = None;
            match answer {
                Ok(Some((Signal::Interrupt(call), age))) => match context.interrupted(call, age) {
                    Ok(()) => *next = Some(Request::Return),
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
