//! Durations of a cell in the unit of who reads them.

use crate::codes::ROUNDED;
use crate::diagnostic::Diagnostic;
use crate::hir::{Duration, Hir};
use imrs_protocol::Ticks;

/// The unit of all durations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Unit {
    /// Of the runtime.
    Microseconds,
    /// Of the model: the cell's `tick`. What must come in time is rounded down to it, what may take time is rounded up
    /// (D42). The `model tick` rounds nothing: it says which times between the ends of an interval are looked at.
    Ticks,
}

impl Unit {
    /// How many microseconds one is.
    #[must_use]
    pub fn usec(self, hir: &Hir) -> u64 {
        match self {
            Self::Microseconds => 1,
            Self::Ticks => hir.tick.map_or(1, |tick| tick.usec.max(1)),
        }
    }
}

/// Turns durations into ticks, and notes what it rounded.
pub(super) struct Clock {
    /// Microseconds per tick.
    tick: u64,
    pub notes: Vec<Diagnostic>,
}

impl Clock {
    pub fn new(hir: &Hir, unit: Unit) -> Self {
        Self { tick: unit.usec(hir), notes: Vec::new() }
    }

    fn note(&mut self, length: Duration, rounded: u64) {
        if !length.usec.is_multiple_of(self.tick) && length.usec > 0 {
            let usec = rounded.saturating_mul(self.tick);
            let message = format!("the model counts {} usec as {usec} usec", length.usec);
            let note = Diagnostic::note(ROUNDED, length.span, message).label("no multiple of the tick");
            if !self.notes.contains(&note) {
                self.notes.push(note);
            }
        }
    }

    /// What must be over in time: rounded down, but not to nothing.
    pub fn time_out(&mut self, length: Duration) -> Ticks {
        let ticks = (length.usec / self.tick).max(u64::from(length.usec > 0));
        self.note(length, ticks);
        Ticks(ticks)
    }

    /// What passes at most: rounded up.
    pub fn bound(&mut self, length: Duration) -> Ticks {
        let ticks = length.usec.div_ceil(self.tick);
        self.note(length, ticks);
        Ticks(ticks)
    }

    /// How often something comes: rounded down, so that it comes no less often.
    pub fn period(&mut self, length: Duration) -> Ticks {
        self.time_out(length)
    }

    /// How long an action takes: outward.
    pub fn takes(&mut self, (least, most): (Duration, Duration)) -> (Ticks, Ticks) {
        let ticks = least.usec / self.tick;
        self.note(least, ticks);
        (Ticks(ticks), self.bound(most))
    }
}
