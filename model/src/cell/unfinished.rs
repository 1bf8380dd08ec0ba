//! If a budget ended a search: finds in what the states of the search differ, which shows what makes the cell large.

use super::judge::program;
use super::plan::{CellFaults, CellPlan};
use super::run_state::RunState;
use super::verdict::{ManyValues, Unfinished};
use imrs_protocol::TaskId;
use imrs_protocol::symbolic::{self, Symbol, Time, Zone};
use std::cell::RefCell;
use std::collections::HashSet;
use std::rc::Rc;
use std::sync::Arc;

/// The greatest number of states in the sample.
pub(super) const SAMPLE: usize = 8_192;
/// A variable with fewer different values than this does not make a cell large.
const MANY: usize = 8;
/// The greatest number of variables that are named.
const NAMED: usize = 3;

/// Packs all times alike, so that states are compared without their times.
struct Timeless;

impl Zone for Timeless {
    fn is_negative(&mut self, symbol: Symbol) -> bool {
        symbol.offset < 0
    }
    fn sum(&mut self, one: Symbol, _: Symbol) -> Symbol {
        one
    }
    fn pack(&mut self, _: Time, symbol: Option<Symbol>) -> u8 {
        u8::from(symbol.is_some())
    }
}

/// A sample of the states that a search keeps, chosen by their fingerprints, so that the sample is the same for any number
/// of threads.
pub(super) struct Sample {
    /// A state is in the sample if the high half of its fingerprint is a multiple of this number. The low half is not
    /// used, because it decides which states the search keeps on a chain: a row of states that each have one successor
    /// only.
    stride: u64,
    states: Vec<(u64, Box<[u8]>)>,
}

impl Default for Sample {
    fn default() -> Self {
        Self { stride: 1, states: Vec::new() }
    }
}

impl Sample {
    /// Takes a kept state into the sample, if it belongs there. A sample that has grown too large drops every other state.
    pub fn take_in(&mut self, fingerprint: u64, state: &[u8]) {
        let high = fingerprint >> 32;
        if !high.is_multiple_of(self.stride) {
            return;
        }
        self.states.push((high, state.into()));
        if self.states.len() > SAMPLE {
            self.stride *= 2;
            let stride = self.stride;
            self.states.retain(|(high, _)| high.is_multiple_of(stride));
        }
    }
}

/// Describes a search that left `open` states unexpanded; `None` if it left none, because it ended by itself.
pub(super) fn of(
    plan: &Arc<CellPlan>,
    faults: &CellFaults,
    sample: &Sample,
    open: usize,
) -> Option<Unfinished> {
    if open == 0 {
        return None;
    }
    let mut run_state = RunState::new(plan, faults);
    let mut values = Values::new(&run_state);
    let mut controls: HashSet<Box<[u8]>> = HashSet::new();
    for (_, state) in &sample.states {
        run_state.load(state);
        values.note(&run_state);
        let timeless = Rc::new(RefCell::new(Timeless));
        controls.extend(symbolic::within(timeless, || run_state.store()).ok());
    }
    let (sampled, apart_from_times) = (sample.states.len() as u64, controls.len() as u64);
    Some(Unfinished { open: open as u64, sampled, apart_from_times, variables: values.named(&run_state) })
}

/// The values that the variables of each task have in some states.
pub(super) struct Values(Vec<Vec<HashSet<i64>>>);

impl Values {
    pub fn new(run_state: &RunState) -> Self {
        let variables = |task| program(run_state, task).map_or(0, |of| of.variables.len());
        Self((0..run_state.plan.tasks.len()).map(|task| vec![HashSet::new(); variables(task)]).collect())
    }

    /// Adds the values of a state.
    pub fn note(&mut self, run_state: &RunState) {
        for (body, variables) in run_state.cell.bodies.iter().zip(&mut self.0) {
            let Some(actor) = &body.actor else { continue };
            for (at, values) in (0..).zip(variables) {
                values.extend(actor.host.script.var(at));
            }
        }
    }

    /// The variables with the most values, if they have many.
    pub fn named(&self, run_state: &RunState) -> Vec<ManyValues> {
        let mut variables: Vec<ManyValues> = Vec::new();
        for (task, found) in self.0.iter().enumerate() {
            let Some(program) = program(run_state, task) else { continue };
            for (variable, values) in
                program.variables.iter().zip(found).filter(|(_, values)| values.len() >= MANY)
            {
                let (task, name) = (TaskId::from_index(task), variable.name.clone());
                variables.push(ManyValues { task, name, values: values.len() as u64 });
            }
        }
        variables.sort_by_key(|variable| std::cmp::Reverse(variable.values));
        variables.truncate(NAMED);
        variables
    }
}
