//! The invariants of the activations and timers between two inputs.

use super::offer::What;
use super::{DEPTH, Interrupts};
use crate::table::NodeTable;
use crate::task::own::Own;
use crate::task::violation::Violation;
use crate::task::wait::Pending;

impl Interrupts {
    /// Checks that activations interrupt each other by rank, and that timers have different names.
    ///
    /// # Errors
    /// The first violation found.
    pub(in crate::task) fn check(&self, table: &NodeTable, own: &Own, called: bool) -> Result<(), Violation> {
        self.check_levels(own)?;
        self.check_timers(table, own, called)
    }

    fn check_levels(&self, own: &Own) -> Result<(), Violation> {
        if usize::from(self.depth) > DEPTH {
            return Err(Violation::Levels(self.depth));
        }
        if let Pending::Get { deadline, .. } = self.pending()
            && deadline < own.now
        {
            return Err(Violation::Overdue(deadline));
        }
        let mut below = None;
        for (i, activation) in (0_u8..).zip(self.threads()) {
            let top = i == self.depth;
            let suspended = activation.finished.is_some() != (activation.pending != Pending::Nothing);
            let ranks = below.is_none_or(|rank| i < 2 || activation.rank <= rank);
            let between = top && activation.pending == Pending::Boundary;
            if (!top && (!suspended || activation.atomic))
                || (top && activation.finished.is_some())
                || !ranks
                || between
            {
                return Err(Violation::Levels(i));
            }
            below = Some(activation.rank);
        }
        Ok(())
    }

    fn check_timers(&self, table: &NodeTable, own: &Own, called: bool) -> Result<(), Violation> {
        let delays = self.threads();
        let delays =
            delays.filter_map(
                |activation| if let Pending::Delay(id, _) = activation.pending { Some(id) } else { None },
            );
        let mut names = [0_u64; 4];
        for id in delays.chain(self.timers.slots.iter().flatten().map(|started| started.id)) {
            let (word, bit) = (usize::from(id.0 / 64), 1 << (id.0 % 64));
            if names[word] & bit != 0 {
                return Err(Violation::Timers(id));
            }
            names[word] |= bit;
        }
        // A timer that has ended and outranks an interruptible activation should already have begun its handler.
        let kept = self.first_timer(table, own).filter(|_| self.is_interruptible(false, called));
        let Some(What::Timer(at)) = kept.map(|offer| offer.what) else { return Ok(()) };
        let kept = self.timers.slots[at];
        kept.map_or(Ok(()), |started| Err(Violation::TimerNotOffered(started.id)))
    }
}
