//! Makes one run of a cell: to its end, to a finding, or to a limit.

use super::driver::{Driver, Source};
use super::schedule::{Fault, Tape};
use crate::cell::judge::{Reached, Shown};
use crate::cell::plan::{CellFaults, CellPlan};
use crate::cell::run_state::CellMove;
use crate::cell::starve::decided;
use crate::cell::unpacked::Unpacked;
use crate::cell::verdict::Phase;
use crate::cell::waiting::deadlock;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// The run ended because nothing can happen any more.
    Over,
    /// The run ended at a finding that ends a run.
    Found,
    /// The run ended at the limit of its steps.
    Steps,
    /// The run ended because more packets were in flight than moves have numbers for.
    Crowded,
}

/// The greatest number of packets in flight: moves number them in a byte.
const MOST_PACKETS: usize = 255;

/// The result of a run.
pub(super) struct Run {
    pub phase: Phase,
    /// The budgets of the run's faults.
    pub faults: CellFaults,
    pub moves: Vec<CellMove>,
    pub ended: Ended,
    /// Whether the run was stopped before its end.
    pub stopped: bool,
    /// Each different finding once, with the number of moves before it.
    pub shown: Vec<(usize, Shown)>,
    pub ticks: u64,
    pub reached: Reached,
    pub tape: Tape,
    /// For each fault, in the order of [`in_order`](super::schedule::in_order), whether it happened.
    pub happened: Vec<bool>,
    /// For each directed link, the number of packets that arrived; for each task, the number of actions that ended.
    pub counts: (Vec<u32>, Vec<u32>),
}

/// The limits of a run.
#[derive(Clone, Copy)]
pub(super) struct Limit<'a> {
    /// The greatest number of steps.
    pub steps: u32,
    /// The flag that stops the run.
    pub stop: Option<&'a AtomicBool>,
}

impl Limit<'_> {
    pub fn is_stopped(self) -> bool {
        self.stop.is_some_and(|stop| stop.load(Ordering::Relaxed))
    }
}

/// Runs a cell. If `faults` is empty, a request that ends badly is a finding, too.
pub(super) fn run(plan: &Arc<CellPlan>, faults: &[Fault], source: Source<'_>, limit: Limit<'_>) -> Run {
    let phase = if faults.is_empty() { Phase::FaultFree } else { Phase::Faults };
    let budgets = super::schedule::budgets(&super::schedule::in_order(faults));
    let mut cell = Unpacked::new(plan, phase, &budgets);
    let mut driver = Driver::new(faults, source, &cell.run_state);
    let (mut taken, mut next) = (Vec::new(), Vec::new());
    let mut judged: Vec<Shown> = Vec::new();
    let mut shown: Vec<(usize, Shown)> = Vec::new();
    let mut stopped = false;
    let ended = loop {
        let mut found = cell.shown();
        next.clear();
        if !found.iter().any(|one| one.last) {
            cell.run_state.moves(&mut next);
            if next.iter().all(|step| matches!(step, CellMove::Crash(_) | CellMove::Restart(_))) {
                found.extend(deadlock(&cell.run_state, false));
            } else {
                found.extend(deadlock(&cell.run_state, true));
            }
        }
        let mut last = false;
        for one in found {
            last |= one.last;
            if !judged.iter().any(|known| known.is_same(&one)) {
                judged.push(one.clone());
                // Whether the finding is a time_out or starvation is decided before shrinking. After shrinking, the
                // shorter run may look like starvation where the whole run was a plain time_out, or the reverse.
                shown.push((taken.len(), decided(plan, &taken, one)));
            }
        }
        if last {
            break Ended::Found;
        }
        stopped = limit.is_stopped();
        if stopped || taken.len() >= limit.steps as usize {
            break Ended::Steps;
        }
        if cell.run_state.cell.in_flight.len() > MOST_PACKETS {
            break Ended::Crowded;
        }
        let Some(step) = driver.next(&cell.run_state, &next) else { break Ended::Over };
        cell.take(step);
        taken.push(step);
    };
    Run {
        phase,
        faults: budgets,
        moves: taken,
        ended,
        stopped,
        shown,
        ticks: cell.run_state.passed,
        reached: cell.reached,
        tape: driver.tape(),
        counts: driver.counts(),
        happened: driver.happened(),
    }
}
