//! The reductions that only a search by zones makes, besides the reductions of every search of a cell.

use super::runner::{LeftOut, Run, Runner};
use crate::cell::run_state::CellMove;
use crate::cell_state::script::Running;
use crate::state::Violation;
use crate::zone::dbm::Dbm;
use crate::zone::forks::{Forks, decided};
use crate::zone::times::symbol_of;
use imrs_protocol::Ticks;
use imrs_protocol::symbolic::{self, START, Symbol};
use std::panic::{AssertUnwindSafe, catch_unwind};

impl Runner {
    /// Drops the moves that lose a packet whose arrival changes nothing, as the search at every tick does: the arrival leads to the
    /// same control and the same times, with more faults left. Where the times decide what an arrival does, the moves stay.
    /// `may_choose`: whether the run goes on if several moves remain.
    ///
    /// # Errors
    /// The state has no packed form.
    pub(super) fn leave_out(
        &mut self,
        forks: &Forks,
        run: &Run,
        moves: &mut Vec<CellMove>,
        may_choose: bool,
    ) -> Result<(), Violation> {
        let mut taken: Vec<u8> = moves.iter().filter_map(|&step| takes_away(step)).collect();
        taken.dedup();
        if self.is_plain || taken.is_empty() {
            return Ok(());
        }
        // A kept state in which the run has not moved yet is as it was packed.
        let is_new = self.packed_at != Some(run.moves.len());
        if is_new {
            self.loosen(forks, START);
            forks.cut().begin_to_pack((START, run.now));
            self.run_state.pack()?;
            self.packed_at = Some(run.moves.len());
        }
        self.leave_out_of(forks, run, &taken, moves);
        if is_new && (may_choose || moves.len() == 1) {
            // Packing clears the dead parts of a state, but not the values that were computed from them. So the run goes on
            // with the state that was packed.
            forks.cut().begin_to_read();
            self.run_state.load_packed();
        }
        Ok(())
    }

    /// Drops the moves that lose one of the packets `taken` from the state that was packed last.
    fn leave_out_of(&mut self, forks: &Forks, run: &Run, taken: &[u8], moves: &mut Vec<CellMove>) {
        // An earlier run from the same state, with the same answers, may have come to this point already.
        let answers = forks.cut().answers();
        let known = self.left.iter().find(|left| left.made == run.moves.len() && left.answers == answers);
        if let Some(known) = known {
            moves.clone_from(&known.moves);
            return;
        }
        let zone = forks.cut().state();
        let beside = &self.run_state.beside;
        let waits = !beside.stays.is_empty() || beside.slow != 0 || !beside.crashed.is_empty();
        for &i in taken {
            if !self.changes_nothing(&zone, i, moves) {
                continue;
            }
            let cut = moves.contains(&CellMove::Vanish(i));
            moves.retain(|&step| match step {
                CellMove::Lose(at) | CellMove::Cut(at, _) => at != i,
                CellMove::Mend(at, _) => at != i || !cut || waits,
                _ => true,
            });
        }
        self.left.push(LeftOut { answers, made: run.moves.len(), moves: moves.clone() });
    }

    /// Whether the arrival of a packet leads to the same state, at the same times, as a removal of the packet. Assumes
    /// that the state before the arrival is the one that was packed last.
    fn changes_nothing(&mut self, zone: &Dbm, packet: u8, moves: &[CellMove]) -> bool {
        let comes = |step: &&CellMove| matches!(**step, CellMove::Deliver(at) | CellMove::Mend(at, _) if at == packet);
        let Some(&arrives) = moves.iter().find(comes) else { return false };
        let Self { run_state, other, start, .. } = self;
        let control = run_state.packed();
        other.cell.is_sampled = false;
        // Most arrivals are answered, which the first of the two runs shows.
        let with = decided(zone, || catch_unwind(AssertUnwindSafe(|| other.after(control, arrives))));
        let (with, after) = match with {
            Some((Ok(Some(with)), after)) => (with, after),
            // A step that panics may leave anything behind.
            Some((Err(_), _)) => {
                other.clone_from(start);
                return false;
            }
            Some((Ok(None), _)) | None => return false,
        };
        let without = decided(zone, || {
            other.load(control);
            other.without(packet)
        });
        without.is_some_and(|(without, times)| with == without && after.cut().state() == times.cut().state())
    }

    /// Widens the zone of the present state: adds states in which an action must end earlier than in this state. Such
    /// states allow nothing that this state does not allow. Then one zone covers what would otherwise be one zone for
    /// each time since the action began. `now` is the variable of the present instant.
    pub(super) fn loosen(&mut self, forks: &Forks, now: u8) {
        for task in 0..self.run_state.cell.bodies.len() {
            let Some(actor) = &mut self.run_state.cell.bodies[task].actor else { continue };
            for action in &mut actor.running {
                loosen(forks, now, action);
            }
        }
    }
}

/// Replaces the most time of an action by a variable: any time that is at least a tick, at least the action's least
/// time, and at most its most time.
fn loosen(forks: &Forks, now: u8, action: &mut Running) {
    if action.most == Running::FOREVER {
        return;
    }
    let mut cut = forks.cut();
    if cut.is_surely_at_most(action.least, Ticks::ZERO) {
        // If the least time has passed, it makes no difference how long ago.
        action.least = Ticks::ZERO;
    }
    if !cut.is_surely_at_most(Ticks(1), action.most) || cut.is_surely_at_most(action.most, action.least) {
        return;
    }
    let [least, most] = [action.least, action.most].map(symbol_of);
    let (Some(least), Some(most)) = (least, most) else { return };
    let new = cut.add();
    let left = Symbol { first: new, second: now, offset: 0 };
    let tick = Symbol { first: START, second: START, offset: 1 };
    for (one, other) in [(tick, left), (least, left), (left, most)] {
        if cut.keep_at_most(one, other) != Ok(true) {
            return;
        }
    }
    action.most = symbolic::between(new, now);
}

/// The packet that a move removes from its link without delivering it.
const fn takes_away(step: CellMove) -> Option<u8> {
    match step {
        CellMove::Lose(_) | CellMove::Cut(..) | CellMove::Vanish(_) => step.packet(),
        _ => None,
    }
}
