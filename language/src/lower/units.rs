//! Converts durations into the unit of the runtime or of the model.

use crate::codes::ROUNDED;
use crate::diagnostic::Diagnostic;
use crate::hir::{Duration, Hir};
use imrs_protocol::Ticks;

/// The unit of all durations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Unit {
    /// Microseconds, for the runtime.
    Microseconds,
    /// The cell's `tick`, for the model. A limit is rounded down to whole ticks, a time that may pass is rounded up (D42).
    /// The `model tick` rounds nothing: it sets which durations between the ends of an interval the checker tries (D133).
    Ticks,
}

impl Unit {
    /// How many microseconds one of this unit has.
    #[must_use]
    pub fn usec(self, hir: &Hir) -> u64 {
        match self {
            Self::Microseconds => 1,
            Self::Ticks => hir.tick.map_or(1, |tick| tick.usec.max(1)),
        }
    }
}

/// Converts durations into ticks, and notes the durations that it rounded.
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

    /// Converts a limit: rounds down, but not to zero.
    pub fn time_out(&mut self, length: Duration) -> Ticks {
        let ticks = (length.usec / self.tick).max(u64::from(length.usec > 0));
        self.note(length, ticks);
        Ticks(ticks)
    }

    /// Converts a time that may pass: rounds up.
    pub fn bound(&mut self, length: Duration) -> Ticks {
        let ticks = length.usec.div_ceil(self.tick);
        self.note(length, ticks);
        Ticks(ticks)
    }

    /// Converts a period: rounds down, so that events do not become rarer.
    pub fn period(&mut self, length: Duration) -> Ticks {
        self.time_out(length)
    }

    /// Converts the duration of an action: rounds the least down and the most up.
    pub fn takes(&mut self, (least, most): (Duration, Duration)) -> (Ticks, Ticks) {
        let ticks = least.usec / self.tick;
        self.note(least, ticks);
        (Ticks(ticks), self.bound(most))
    }
}
