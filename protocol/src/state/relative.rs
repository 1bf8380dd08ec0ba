//! Everything relative in a state: instants, rounds, sequences, epochs. One pass looks at them, one changes them.

use super::Walk;
use crate::ids::{Incarnation, PortId, Round, Seq24, TaskId};
use crate::packet::Contents;
use crate::ticks::Ticks;

/// Looks at everything relative in a state.
pub trait Visit {
    /// An instant on the task's own counter.
    fn instant(&mut self, instant: Ticks);
    /// A round of a port.
    fn round(&mut self, port: PortId, round: Round);
    /// A sequence number of a source.
    fn sequence(&mut self, source: TaskId, sequence: Seq24);
    /// An epoch of the couple at this position in the cell.
    fn epoch(&mut self, couple: u8, epoch: u8) {
        let _ = (couple, epoch);
    }
}

/// Changes everything relative in a state.
pub trait VisitMut {
    /// An instant on the task's own counter.
    fn instant(&mut self, instant: &mut Ticks);
    /// A round of a port.
    fn round(&mut self, port: PortId, round: &mut Round);
    /// A sequence number of a source.
    fn sequence(&mut self, source: TaskId, sequence: &mut Seq24);
    /// An epoch of the couple at this position in the cell. Those of the primary are odd, so only an even shift
    /// changes nothing.
    fn epoch(&mut self, couple: u8, epoch: &mut u8) {
        let _ = (couple, epoch);
    }
}

/// The pass that looks.
pub(crate) struct Look<'a, V>(pub &'a mut V);

/// The pass that changes.
pub(crate) struct Change<'a, V>(pub &'a mut V);

/// What both leave as it is.
macro_rules! untouched {
    () => {
        const LOADS: bool = false;
        const WRITES: bool = false;

        fn lives(&self) -> bool {
            true
        }
        fn bits(&mut self, _: u32, value: u8) -> u8 {
            value
        }
        fn align(&mut self) {}
        fn code(&mut self, value: u8) -> u8 {
            value
        }
        fn count(&mut self, value: usize) -> usize {
            value
        }
        fn word(&mut self, value: u16) -> u16 {
            value
        }
        fn long(&mut self, value: u64) -> u64 {
            value
        }
        fn derived(&mut self, instant: &mut Ticks, _: impl FnOnce() -> Ticks) {
            self.instant(instant);
        }
        fn next_sequence(&mut self, source: TaskId, sequence: &mut Seq24) {
            self.sequence(source, sequence);
        }
        fn life(&mut self, _: &mut Incarnation) {}
        fn contents(&mut self, _: &mut Contents) {}
        fn arguments(&mut self, _: &mut [u8; 8]) {}
    };
}

impl<V: Visit> Walk for Look<'_, V> {
    const CHANGES: bool = false;
    untouched!();

    fn instant(&mut self, instant: &mut Ticks) {
        self.0.instant(*instant);
    }
    fn round(&mut self, port: PortId, round: &mut Round) {
        self.0.round(port, *round);
    }
    fn sequence(&mut self, source: TaskId, sequence: &mut Seq24) {
        self.0.sequence(source, *sequence);
    }
    fn epoch(&mut self, couple: u8, epoch: &mut u8) {
        self.0.epoch(couple, *epoch);
    }
}

impl<V: VisitMut> Walk for Change<'_, V> {
    const CHANGES: bool = true;
    untouched!();

    fn instant(&mut self, instant: &mut Ticks) {
        self.0.instant(instant);
    }
    fn round(&mut self, port: PortId, round: &mut Round) {
        self.0.round(port, round);
    }
    fn sequence(&mut self, source: TaskId, sequence: &mut Seq24) {
        self.0.sequence(source, sequence);
    }
    fn epoch(&mut self, couple: u8, epoch: &mut u8) {
        self.0.epoch(couple, epoch);
    }
}
