//! Searches a cell at every time inside of its intervals, by zones: sets of times.
//!
//! ```text
//!   runner    runs the moves of a cell on symbolic times, from one kept state to the next, once for each way that its times allow
//!   reduce    what these runs leave out, and how the zones that are kept grow (D194)
//!   store     the kept states: for each control, the zones that were reached
//!   growth    accelerates a zone that grows and grows (D221)
//!   origins   how the kept states were reached
//!   search    expands kept states
//!   still     finds standstills among the kept states
//!   concrete  picks times for a path, and replays it on plain ticks
//!   fixed     runs a cell with a fixed time for each action and packet
//!   found     what a path at other times must show, too
//!   path      makes the path to a finding again on symbolic times
//!   ranges    computes for which times a finding happens
//!   explore   tells what a search found
//!   within    makes runs at times within the ranges of a finding, for tests
//!   walked    looks up the states of random walks among the kept zones, for tests
//! ```
//!
//! A state consists of a *control* and a *zone*. The control is everything but the state's times. The zone is the set of
//! times with which the control was reached. The moves, their order within an instant and their checks are those of the
//! search at every tick ([`Times::Every`](super::Times)), because the same code makes them. Only the passing of time
//! differs. Before time passes, all ticks in which nothing happens pass at once: their number becomes a variable, and no
//! deadline, bound of a packet, or most time of an action may come meanwhile. Then one tick passes, in which something may
//! happen. Zones are sets of integers, so this search covers exactly what the search at every tick covers.
//!
//! A finding is reported only if it is found again on plain ticks.

mod concrete;
mod explore;
mod fixed;
mod found;
mod growth;
mod origins;
mod path;
mod ranges;
mod reduce;
mod runner;
mod search;
mod still;
mod store;
mod walked;
mod within;

pub(super) use explore::explore;
pub(super) use ranges::ranges;
pub use walked::compare_zones_with_walks;
pub use within::compare_ranges_with_runs;

use super::plan::{CellFaults, CellPlan};
use imrs_protocol::rules::Rules;

/// What a search by zones does not cover of this plan with these faults; `None` if it covers everything.
pub(super) fn uncovered(plan: &CellPlan, faults: &CellFaults) -> Option<&'static str> {
    let found = [
        (!faults.pause.is_empty(), "pauses"),
        (faults.drift > 0, "drift"),
        (plan.table.cell().rules != Rules::default(), "variants of the rules"),
    ];
    found.into_iter().find(|(is, _)| *is).map(|(_, what)| what)
}
