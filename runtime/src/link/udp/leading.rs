//! How a task's thread waits in the link's socket, while no other thread polls for it.

use super::UdpLink;
use super::watch::Seen;
use crate::link::{Came, Leading, Sink};
use crate::lock::lock;
use std::time::Duration;

impl Leading for UdpLink {
    fn wait(&self, left: Option<Duration>) -> Came {
        match self.leader.wait_some(left) {
            Ok(Some(Seen::Readable(told))) => {
                *lock(&self.told) = told;
                Came::Something
            }
            Ok(Some(Seen::TimedOut)) => Came::Time,
            Ok(Some(Seen::Woken) | None) => Came::Nothing,
            Err(_) => {
                self.wait_failed();
                Came::Nothing
            }
        }
    }

    fn take_in(&self, sink: &dyn Sink) -> bool {
        let told = std::mem::take(&mut *lock(&self.told));
        let told = if told.is_empty() { self.leader.look() } else { told };
        told.is_empty() || self.take_told(&told, sink)
    }

    fn call(&self) {
        self.leader.wake().wake();
    }
}
