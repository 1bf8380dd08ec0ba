//! Decides when the Timer thread must wake: at the earliest deadline for which no task's thread sleeps (D40).
//!
//! Every state machine of the node publishes its next expiry in a slot of its own. The Timer thread sleeps until the
//! earliest slot. Only a still earlier expiry wakes that thread, so a stream of messages with equal time_outs never
//! wakes it.

use crate::clock::{FAR, Micros, nanos_of};
use crate::sync::handoff::Rest;
use crate::sync::plant::{Plants, Sound};
use crate::sync::{AtomicU64, Line, Ordering, Word, fence};

#[derive(Debug)]
pub(crate) struct Alarm<P = Sound> {
    /// Each slot is in a cache line of its own, because the threads of two tasks publish in turn.
    slots: Box<[Line<AtomicU64>]>,
    /// The instant until which the Timer thread sleeps; `FAR` while it reads the slots.
    target: AtomicU64,
    rung: Word,
    plant: P,
}

/// The bugs that the explorers of schedules (loom and shuttle) must find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plant {
    /// While the Timer thread reads the slots, the target stays at its old value, so that a new expiry does not wake
    /// the thread.
    NoOpenTarget,
    /// No fence orders the accesses to a slot and to the target.
    NoFence,
    /// `closing` is checked before `rung` is read.
    EndBeforeRung,
}

/// The earliest published expiry, and the value of `rung` from before the slots were read.
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

    /// Publishes when the state machine of `slot` next expires. Called under the lock of that machine, so the last
    /// store is the newest value.
    pub fn publish(&self, slot: usize, at: Micros) {
        let slot = &self.slots[slot].0;
        if slot.load(Ordering::Relaxed) == at {
            return;
        }
        slot.store(at, Ordering::Relaxed);
        if at == FAR {
            return;
        }
        // This fence pairs with the fence in `earliest`: either the loads there see this slot, or the load here sees
        // the target `FAR` or a later target.
        self.fence();
        if at < self.target.load(Ordering::Relaxed) {
            self.ring();
        }
    }

    /// The instant that was last published in `slot`.
    pub fn slot(&self, slot: usize) -> Micros {
        self.slots[slot].0.load(Ordering::Relaxed)
    }

    /// The earliest expiry of all slots when the Timer thread last read them.
    pub fn target(&self) -> Micros {
        self.target.load(Ordering::Relaxed)
    }

    /// Wakes the Timer thread.
    pub fn ring(&self) {
        self.rung.increment();
        self.rung.wake();
    }

    /// Returns the earliest expiry of all slots; only the Timer thread calls this. From here on, publishing any earlier
    /// expiry wakes that thread.
    pub fn earliest(&self) -> Earliest {
        let rung = self.rung.load();
        // While the slots are read, the target is `FAR`, so publishing any expiry increments `rung`.
        if !self.plant.has(Plant::NoOpenTarget) {
            self.target.store(FAR, Ordering::Relaxed);
        }
        self.fence();
        let at = self.slots.iter().map(|slot| slot.0.load(Ordering::Relaxed)).min().unwrap_or(FAR);
        self.target.store(at, Ordering::Relaxed);
        Earliest { at, rung }
    }

    /// Sleeps until the next published expiry, and returns the time then. Only the Timer thread calls this. It wakes
    /// `tail` before the expiry and spins until it. If the first expiry is nearer than `tail`, it sleeps until that
    /// expiry, so that it gives up its core between any two expiries. Returns `None` once `closing` is true; the
    /// thread that sets `closing` calls `ring` then.
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

    /// Spins until the given expiry, or until `ring` is called. This does not read the slots, because publishing an
    /// earlier expiry calls `ring`.
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

    /// Sleeps until the given expiry, or until `ring` is called. Without an expiry it sleeps until `ring` is called.
    pub fn sleep(&self, until: Earliest) {
        self.rung.wait(until.rung, nanos_of(until.at));
    }
}

/// Which thread serves the expiries of one state machine: its task's thread if that wakes by the next expiry,
/// otherwise the Timer thread. Changed only under the lock of that machine.
#[derive(Debug)]
pub(crate) struct Cover {
    slot: usize,
    /// The instant until which the task's thread sleeps.
    until: Option<Micros>,
    /// A planted bug that a test must find: the task's thread counts as awake by every expiry, whenever it wakes.
    #[cfg(test)]
    pub covers_all: bool,
    /// A planted bug that tests must find: the published expiry is kept too often, in the cases that [`Keeps`] names.
    #[cfg(test)]
    pub keeps: Option<Keeps>,
}

/// Which published expiry a [`Cover`] with a planted bug keeps.
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

    /// As [`settle`](Self::settle), for a state machine whose expiries only the Timer thread serves. `now` is the
    /// machine's time. The published expiry is kept if it is still to come and not later than `due`. So requests that
    /// are answered in time publish only once in each time_out, and wake the Timer thread no more often. If the Timer
    /// thread wakes too early, it advances the machine, which then publishes `due`.
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

    /// Publishes `due`, the state machine's next expiry, unless the task's thread wakes by then. `rest` says what
    /// that thread does next.
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
