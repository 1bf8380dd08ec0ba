//! Leader and followers (D40). One thread at a time, of a task or of the futures, waits in the link's socket itself
//! and receives for the node. This thread, the leader, finds its own answer without a wake-up; the other threads
//! sleep on their futex words. A leader that stops need not inform another thread: while no thread leads, the kernel
//! reports every datagram to the node's receiving thread.
//!
//! While a thread leads, the kernel reports a datagram to that thread alone. So the leader receives a reported datagram
//! before it checks whether its own wait is over.

use crate::sync::plant::{Plants, Sound};
use crate::sync::{AtomicBool, Ordering};

/// How another thread wakes the leader from its wait in the link's socket.
pub(crate) trait Away {
    /// Notes that the thread is about to wait in the link's socket: from now on a call wakes it there. Returns false
    /// if the thread was called already.
    fn go_away(&self) -> bool;

    /// Notes that the thread no longer waits in the link's socket. Returns false if the thread was called during the
    /// wait.
    fn come_home(&self) -> bool;
}

/// Why a wait in the link's socket ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Came {
    /// A datagram arrived, or the link has another event.
    Something,
    /// The leader was called, or only a part of the wait's time is over.
    Nothing,
    /// The time of the wait is over.
    Time,
}

/// How a task's wait went.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Led {
    /// The thread led until its wait was over.
    ToTheEnd,
    /// The thread led, and another thread ended its wait.
    Called,
    /// The thread did not lead, or lost the lead before its wait was over: other threads receive, and this thread
    /// must sleep.
    No,
}

#[derive(Debug)]
pub(crate) struct Lead<P = Sound> {
    taken: AtomicBool,
    plant: P,
}

/// The bug that the explorers of schedules (loom and shuttle) must find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plant {
    /// A leader whose own wait is over leaves the datagram that the kernel reported to it in the socket.
    LeavesBlindly,
}

impl Lead {
    pub fn new() -> Self {
        Self::planted(Sound)
    }
}

impl<P: Plants<Plant>> Lead<P> {
    /// As [`new`](Lead::new), with a bug planted for a test.
    pub fn planted(plant: P) -> Self {
        Self { taken: AtomicBool::new(false), plant }
    }

    /// Waits in the link's socket until `away` is called, unless another thread leads. `take_in` receives the
    /// datagrams that `wait` reported. It returns false if another thread is receiving already; that thread then
    /// receives these datagrams, too.
    pub fn wait(
        &self,
        away: &impl Away,
        mut wait: impl FnMut() -> Came,
        mut take_in: impl FnMut() -> bool,
    ) -> Led {
        if self.taken.swap(true, Ordering::AcqRel) {
            return Led::No;
        }
        let mut led = Led::ToTheEnd;
        while away.go_away() {
            let came = wait();
            // From here on, another thread that brings the leader's answer does not wake the leader, because the
            // leader runs.
            let called = !away.come_home();
            if called && self.plant.has(Plant::LeavesBlindly) {
                led = Led::Called;
                break;
            }
            if called {
                led = Led::Called;
            }
            match came {
                Came::Something if take_in() => {}
                Came::Something => {
                    led = Led::No;
                    break;
                }
                Came::Nothing => {}
                Came::Time => break,
            }
        }
        self.taken.store(false, Ordering::Release);
        led
    }
}
