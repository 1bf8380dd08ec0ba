//! Leader and followers (D40): one thread at a time, of a task or of the futures, waits in the link itself, takes in what
//! comes, and so finds its own answer with nobody to wake it; the others sleep on their words. Nothing has to be handed on
//! when it leaves: the thread that receives for the node is told by the kernel of whatever comes while nobody leads.
//!
//! What the leader was told of, nobody else was. So it takes that in before it looks whether its own wait is over.

use crate::sync::plant::{Plants, Sound};
use crate::sync::{AtomicBool, Ordering};

/// What a thread that leads is called back from the link by.
pub(crate) trait Away {
    /// It goes to wait where the bell calls it. False where it was called already.
    fn go_away(&self) -> bool;

    /// It is back from there. False where it was called.
    fn come_home(&self) -> bool;
}

/// Why a wait in the link ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Came {
    /// Something came in.
    Something,
    /// The leader was called, or a part of the wait is over.
    Nothing,
    /// The time is over.
    Time,
}

/// How a task's wait went.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Led {
    /// It led, and its wait is over.
    ToTheEnd,
    /// It led, and its wait was ended by another thread.
    Called,
    /// It did not lead, or not to the end: others do what there is to do, and it sleeps.
    No,
}

#[derive(Debug)]
pub(crate) struct Lead<P = Sound> {
    taken: AtomicBool,
    plant: P,
}

/// The bug that the explorers must find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plant {
    /// Whoever finds its own wait over leaves what it was told of.
    LeavesBlindly,
}

impl Lead {
    pub fn new() -> Self {
        Self::planted(Sound)
    }
}

impl<P: Plants<Plant>> Lead<P> {
    /// As [`new`](Lead::new), with a bug.
    pub fn planted(plant: P) -> Self {
        Self { taken: AtomicBool::new(false), plant }
    }

    /// Waits in the link for what `away` is called for, unless another thread leads. `take_in` takes in what `wait` told of;
    /// false where another thread is at it and will.
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
            // From here on its own mail wakes nobody.
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
