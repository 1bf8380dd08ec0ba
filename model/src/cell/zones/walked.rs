//! Checks the search by zones against random walks at plain ticks: looks up the states of each walk among the kept
//! zones.
//!
//! Between two instants of a walk, a kept zone of the state's control must contain the state's times. One difference is
//! allowed: zones count how long ago the least time of an action has passed, and plain ticks do not. So a least time of
//! zero on plain ticks is looked up as any least time that has passed.

use super::runner::{QUIET, Runner};
use super::search::{Search, core};
use super::store::Widening;
use crate::Silent;
use crate::cell::guard::{Agreement, Disagreement};
use crate::cell::outside::with_programs;
use crate::cell::plan::{CellFaults, CellPlan, Times};
use crate::cell::run_state::CellMove;
use crate::cell::unpacked::Unpacked;
use crate::cell::verdict::Phase;
use crate::cell::waiting::for_ever;
use crate::zone::dbm::Dbm;
use crate::zone::forks::again;
use std::sync::Arc;
use std::time::Instant;

/// Searches a cell by zones, and looks up the states of random walks through it. `draw` returns a number below its argument.
///
/// # Errors
/// [`Disagreement`]: a state of a walk that is in no kept zone.
pub fn compare_zones_with_walks(
    plan: &Arc<CellPlan>,
    (walks, length): (u32, u32),
    draw: &mut dyn FnMut(usize) -> usize,
) -> Result<Agreement, Disagreement> {
    let plan = with_programs(plan).timed(Times::Zones);
    let mut agreement = Agreement::default();
    let hypotheses = plan.faults.iter().filter(|faults| !faults.are_none());
    let phases = std::iter::once((Phase::FaultFree, CellFaults::default()));
    for (phase, faults) in phases.chain(hypotheses.map(|faults| (Phase::Faults, faults.clone()))) {
        let mut search = Search::new(vec![Runner::new(&plan, phase, &faults)], Widening::of(&plan));
        let ended_by = search.run(&plan, (Instant::now(), &Silent));
        agreement.searches += 1;
        agreement.states += search.store.len() as u64;
        if ended_by.is_some() || search.outgrown || faults.hide_covered_states() {
            continue;
        }
        agreement.complete += 1;
        for _ in 0..walks {
            walk(&search, Unpacked::new(&plan, phase, &faults), length, draw, &mut agreement)?;
        }
    }
    Ok(agreement)
}

fn walk(
    search: &Search,
    mut cell: Unpacked,
    length: u32,
    draw: &mut dyn FnMut(usize) -> usize,
    agreement: &mut Agreement,
) -> Result<(), Disagreement> {
    let mut taken = Vec::new();
    let mut moves = Vec::new();
    for _ in 0..length {
        if cell.shown().iter().any(|shown| shown.last) {
            return Ok(());
        }
        moves.clear();
        cell.run_state.moves(&mut moves);
        // The search does not go on behind a deadlock, which only a crash can end.
        let goes_on = moves.iter().any(|step| !matches!(step, CellMove::Crash(_) | CellMove::Restart(_)));
        if !goes_on && for_ever(&cell.run_state, false).is_some_and(|shown| shown.last) {
            return Ok(());
        }
        if moves.contains(&CellMove::Pass) {
            agreement.looked_up += 1;
            if !is_kept(search, &cell) {
                return Err(Disagreement { what: "no kept zone has this state".into(), moves: taken });
            }
        }
        let Some(&step) = moves.get(draw(moves.len().max(1))) else { return Ok(()) };
        agreement.steps += 1;
        taken.push(step);
        cell.take(step);
    }
    Ok(())
}

/// Whether a kept zone has the state between two instants.
fn is_kept(search: &Search, cell: &Unpacked) -> bool {
    let mut between = cell.clone().without_history().run_state;
    let ((control, over, point), _) = again(&Dbm::zero(), &[], |forks| {
        between.cell.is_symbolic = true;
        between.end_instant();
        between.next_step();
        forks.cut().begin_to_pack((0, 0));
        let control = between.pack().map(|()| [&[QUIET], between.packed()].concat());
        let cut = forks.cut();
        (control, cut.times().over().to_vec(), cut.state())
    });
    let Ok(control) = control else { return true };
    let (left, core) = core(&search.runners[0], &control);
    search.store.zones(left, &core).any(|zone| zone.reaches(&point.point(), &over))
}
