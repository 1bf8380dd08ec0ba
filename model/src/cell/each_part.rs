//! Searches each independent part of a cell by itself.

use super::done::{Done, take_checks};
use super::judge::nothing_reached;
use super::parts::only;
use super::plan::{CellFaults, CellPlan, Part};
use super::run_state::RunState;
use std::sync::Arc;

/// Searches each independent part by itself and joins the results. If no fault of the hypothesis can happen in a part, the
/// part's result is taken from `plain`, the search without faults.
///
/// A clock drifts between two events, and a pause ends after an event. Between two events of one part lie events of other
/// parts, so a cell with drift or pauses is searched as a whole.
pub(super) fn look_at_each(
    plan: &Arc<CellPlan>,
    parts: &[Part],
    faults: &CellFaults,
    plain: Option<&Done>,
    look: impl Fn(&Arc<CellPlan>) -> Done,
) -> Done {
    if parts.is_empty() || !faults.may_be_apart() {
        return look(plan);
    }
    // A search without faults stops at an `abort`, and a search with faults goes on. So the search without faults can
    // replace one with faults only if it was not stopped in this way.
    let is_seen = plain.is_some_and(|plain| !plain.coverage.pruned);
    let touched = |part: &&Part| !is_seen || part.is_touched_by(plan, faults);
    let mut searched: Vec<&Part> = parts.iter().filter(touched).collect();
    if searched.is_empty() {
        searched.push(&parts[0]);
    }
    let done = searched.iter().map(|part| (part.number, look(&only(plan, Some(part)))));
    let Some((_, mut all)) =
        done.reduce(|(at, mine), (number, other)| (at, mine.beside(other, &parts[number])))
    else {
        return look(plan);
    };
    for part in parts.iter().filter(|part| !searched.contains(part)) {
        let still = match plain {
            Some(plain) => plain.reached.still.clone(),
            None => nothing_reached(&RunState::new(&only(plan, Some(part)), faults)).still,
        };
        take_checks(&mut all.reached.still, still, part);
    }
    all.coverage.parts = u32::try_from(parts.len()).unwrap_or(u32::MAX);
    all
}
