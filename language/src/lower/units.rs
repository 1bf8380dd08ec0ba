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
    /// Of the model: the cell's `tick`. `takes`, `delay`s and the cell's own timers are multiples of its `model tick`,
    /// rounded outward; what must come in time is rounded down, what may take time is rounded up (D42).
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
    /// Microseconds per tick of the machine.
    tick: u64,
    /// Ticks per granule of `takes`, delays and timers.
    granule: u64,
    pub notes: Vec<Diagnostic>,
}

impl Clock {
    pub fn new(hir: &Hir, unit: Unit) -> Self {
        let tick = unit.usec(hir);
        let granule = match (unit, hir.model_tick) {
            (Unit::Ticks, Some(model)) => (model.usec / tick).max(1),
            _ => 1,
        };
        Self { tick, granule, notes: Vec::new() }
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

    /// A delay or a timer of the cell: rounded up to the model's granularity.
    pub fn delay(&self, length: Duration) -> Ticks {
        let granule = self.tick.saturating_mul(self.granule);
        Ticks(length.usec.div_ceil(granule).saturating_mul(self.granule))
    }

    /// How long an action takes: outward to the model's granularity.
    pub fn takes(&self, (least, most): (Duration, Duration)) -> (Ticks, Ticks) {
        let granule = self.tick.saturating_mul(self.granule);
        (Ticks((least.usec / granule).saturating_mul(self.granule)), self.delay(most))
    }
}
