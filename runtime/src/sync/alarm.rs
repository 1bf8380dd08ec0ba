//! Decides when the Timer thread must wake: at the earliest expiry that no task's thread waits for (D40).
//!
//! Every machine of the node publishes its next expiry in a slot of its own. The Timer thread sleeps until the earliest slot.
//! Only an earlier expiry wakes it, so a stream of messages with equal time_outs never does.

use crate::clock::{FAR, Micros, nanos_of};
use crate::sync::handoff::Rest;
use crate::sync::plant::{Plants, Sound};
use crate::sync::{AtomicU64, Line, Ordering, Word, fence};

#[derive(Debug)]
pub(crate) struct Alarm<P = Sound> {
    /// Each in a cache line of its own, because the threads of two tasks publish in turn.
    slots: Box<[Line<AtomicU64>]>,
    /// The instant until which the Timer thread sleeps.
    target: AtomicU64,
    rung: Word,
    plant: P,
}

/// The bugs that the explorers must find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plant {
    /// While the Timer thread reads the slots, the old target stays in force, so that a new expiry does not
    /// call the thread.
    NoOpenTarget,
    /// No fence orders a slot and the target.
    NoFence,
    /// `closing` is checked before `rung` is read.
    EndBeforeRung,
}

/// The earliest expiry, and the value of `rung` before the slots were read.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Earliest {
    pub at: Micros,
    rung: u32,
}

impl Alarm {
    pub fn new(slots: usize) -> Self {
        Self::planted(slots, Sound)
    }
}

impl<P: Plants<Plant>> Alarm<P> {
    /// As [`new`](Alarm::new), with a bug planted for a test.
    pub fn planted(slots: usize, plant: P) -> Self {
        let slots = (0..slots).map(|_| Line(AtomicU64::new(FAR))).collect();
        Self { slots, target: AtomicU64::new(FAR), rung: Word::new(0), plant }
    }

    /// Publishes when `slot` next expires. Called under the lock of that machine, so the last store is the newest value.
    pub fn publish(&self, slot: usize, at: Micros) {
        let slot = &self.slots[slot].0;
        if slot.load(Ordering::Relaxed) == at {
            return;
        }
        slot.store(at, Ordering::Relaxed);
        if at == FAR {
            return;
        }
        // Pairs with the fence in `earliest`: either its loads see this slot, or this load sees its `FAR` or a later target.
        self.fence();
        if at < self.target.load(Ordering::Relaxed) {
            self.ring();
        }
    }

    /// The instant that was last published in `slot`.
    pub fn slot(&self, slot: usize) -> Micros {
        self.slots[slot].0.load(Ordering::Relaxed)
    }

    /// The earliest of all slots, as the Timer thread last saw them.
    pub fn target(&self) -> Micros {
        self.target.load(Ordering::Relaxed)
    }

    /// Wakes the Timer thread.
    pub fn ring(&self) {
        self.rung.increment();
        self.rung.wake();
    }

    /// The earliest of all slots; only the Timer thread calls this. From here on, any earlier expiry wakes that thread.
    pub fn earliest(&self) -> Earliest {
        let rung = self.rung.load();
        // While the slots are read, the target is `FAR`, so whatever is published rings.
        if !self.plant.has(Plant::NoOpenTarget) {
            self.target.store(FAR, Ordering::Relaxed);
        }
        self.fence();
        let at = self.slots.iter().map(|slot| slot.0.load(Ordering::Relaxed)).min().unwrap_or(FAR);
        self.target.store(at, Ordering::Relaxed);
        Earliest { at, rung }
    }

    /// Sleeps until something expires that no task's thread waits for, and returns the time then. Only the Timer thread calls
    /// this. It wakes `tail` early and spins from there on. If the first expiry is nearer than that, it sleeps for it, so that it
    /// gives up its core between any two. `None` as soon as `closing` is true; the thread that makes it true rings afterwards.
    pub fn next(
        &self,
        tail: Micros,
        closing: impl Fn() -> bool,
        clock: impl Fn() -> Micros,
    ) -> Option<Micros> {
        let mut slept = false;
        loop {
            if self.plant.has(Plant::EndBeforeRung) {
                if closing() {
                    return None;
                }
                self.sleep(self.earliest());
                continue;
            }
            let earliest = self.earliest();
            if closing() {
                return None;
            }
            let now = clock();
            if earliest.at <= now {
                return Some(now);
            }
            if now.saturating_add(tail) < earliest.at {
                self.sleep(Earliest { at: earliest.at - tail, ..earliest });
                slept = true;
            } else if slept {
                self.look(earliest, &clock);
            } else {
                self.sleep(earliest);
            }
        }
    }

    /// Spins until then, or until rung. It does not read the slots, because publishing an earlier expiry rings.
    fn look(&self, until: Earliest, clock: impl Fn() -> Micros) {
        while self.rung.load() == until.rung && clock() < until.at {
            std::hint::spin_loop();
        }
    }

    fn fence(&self) {
        if !self.plant.has(Plant::NoFence) {
            fence(Ordering::SeqCst);
        }
    }

    /// Sleeps until then, or until rung. Without an expiry it sleeps until rung.
    pub fn sleep(&self, until: Earliest) {
        self.rung.wait(until.rung, nanos_of(until.at));
    }
}

/// Which thread covers the deadlines of one machine: its task's thread if that sleeps at most until the next expiry, else the
/// Timer thread. Changed only under the lock of that machine.
#[derive(Debug)]
pub(crate) struct Cover {
    slot: usize,
    /// Until when the task's thread sleeps.
    until: Option<Micros>,
    /// For the test that must fail: any sleep covers any expiry.
    #[cfg(test)]
    pub covers_all: bool,
    /// For the tests that must fail: whatever stands published stays, or all that is not yet over.
    #[cfg(test)]
    pub keeps: Option<Keeps>,
}

/// What a [`Cover`] with a bug keeps.
#[cfg(test)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Keeps {
    WhatIsOver,
    WhatIsLater,
}

impl Cover {
    pub const fn new(slot: usize) -> Self {
        Self {
            slot,
            until: None,
            #[cfg(test)]
            covers_all: false,
            #[cfg(test)]
            keeps: None,
        }
    }

    /// As [`settle`](Self::settle), for a machine whose expiries only the Timer thread covers, and which stands at `now`. What is
    /// published stays if it is still to come and no later than `due`. So requests that are answered in time publish once in a
    /// time_out, and call the Timer thread no more often. That thread may then come too early; the machine, which it advances,
    /// publishes `due`.
    pub fn keep<P: Plants<Plant>>(&self, alarm: &Alarm<P>, now: Micros, due: Micros) {
        let published = alarm.slot(self.slot);
        let (comes, serves) = (now < published, published <= due);
        #[cfg(test)]
        let comes = comes || self.keeps == Some(Keeps::WhatIsOver);
        #[cfg(test)]
        let serves = serves || self.keeps == Some(Keeps::WhatIsLater);
        if !(comes && serves) {
            alarm.publish(self.slot, due);
        }
    }

    /// The machine next expires at `due`, and its task's thread does `rest`. Publishes `due`, unless the thread's sleep covers
    /// it.
    pub fn settle<P: Plants<Plant>>(&mut self, alarm: &Alarm<P>, rest: Rest, due: Micros) {
        match rest {
            Rest::No => self.until = None,
            Rest::Begins => self.until = Some(due),
            Rest::GoesOn => {}
        }
        #[cfg(test)]
        let due = if self.covers_all && self.until.is_some() { FAR } else { due };
        let covered = self.until.is_some_and(|until| until <= due);
        alarm.publish(self.slot, if covered { FAR } else { due });
    }
}
