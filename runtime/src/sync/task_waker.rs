//! Wakes the future of a task, from any thread, by the waker with which it was last polled.

use crate::sync::{Mutex, lock};
use std::task::Waker;

pub(crate) struct TaskWaker(Mutex<Option<Waker>>);

impl TaskWaker {
    pub fn new() -> Self {
        Self(Mutex::new(None))
    }

    /// From here on, waking the task calls `waker`.
    pub fn listen(&self, waker: &Waker) {
        // The old waker is dropped without the lock: it may own a future, and dropping that future may call
        // this function.
        let old = lock(&self.0).replace(waker.clone());
        drop(old);
    }

    pub fn wake(&self) {
        // The waker is called without the lock, because it may run any code.
        let waker = lock(&self.0).clone();
        waker.iter().for_each(Waker::wake_by_ref);
    }
}
