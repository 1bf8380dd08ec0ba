//! Evaluates checks that read several nodes, whatever the order of these nodes within a tick. The search lets nodes act one
//! after the other, but nothing orders them. So such a check must hold for every combination of the values that each node
//! showed in that tick (D161).

use super::RunState;
use crate::cell::plan::{CellPlan, Holds, about};
use crate::cell_state::CellState;
use imrs_protocol::script::{Term, eval};
use imrs_protocol::{NodeId, TaskId};

/// A check that reads several nodes, with the terms that it reads of each node.
#[derive(Clone, Debug)]
pub(in crate::cell) struct Spread {
    pub check: usize,
    nodes: Vec<Vec<Term>>,
}

/// The values that a node shows to a check, one for each term; `None` for a term without a value.
pub(in crate::cell) type ShownValues = Vec<Option<i64>>;

/// One combination of values that the nodes showed in this tick, and that the check might have read.
pub(in crate::cell) type Mixture = Vec<(Term, Option<i64>)>;

/// What the nodes of one check have shown in this tick.
#[derive(Clone, Debug, Default)]
pub(in crate::cell) struct TickValues {
    /// For each node, the other values that it has shown since the tick began, sorted and without duplicates.
    pub earlier: Vec<Vec<ShownValues>>,
    /// For each node, the values that it shows now. They are not packed, because they follow from the rest of the state.
    now: Vec<ShownValues>,
}

impl TickValues {
    /// For each node, the number of values that it shows.
    pub fn widths(&self) -> impl Iterator<Item = usize> {
        self.now.iter().map(Vec::len)
    }
}

impl RunState {
    /// The `always` checks of this search that read several nodes.
    pub(in crate::cell) fn spread(plan: &CellPlan) -> Vec<Spread> {
        let of_check = |check: usize| {
            let node = |term: &Term| {
                about(term).and_then(|task| plan.table.location(TaskId::from_index(task))).map(NodeId::index)
            };
            let all = plan.terms(check);
            let mut numbers: Vec<usize> = all.iter().filter_map(node).collect();
            numbers.sort_unstable();
            numbers.dedup();
            let of_node = |number: usize| -> Vec<Term> {
                all.iter().copied().filter(|term| node(term) == Some(number)).collect()
            };
            let nodes: Vec<Vec<Term>> = numbers.into_iter().map(of_node).collect();
            (nodes.len() > 1).then_some(Spread { check, nodes })
        };
        let always = |check: &usize| matches!(plan.checks[*check].holds, Holds::Always(_));
        (0..plan.checks.len()).filter(|&at| plan.has_check(at)).filter(always).filter_map(of_check).collect()
    }

    /// Forgets the shown values of the previous tick. The new tick begins with what the nodes show now.
    pub(in crate::cell) fn begin_tick(&mut self) {
        for tick_values in &mut self.tick_values {
            tick_values.earlier.iter_mut().for_each(Vec::clear);
        }
    }

    /// The shown values in the first state: no node has shown anything else in this tick.
    pub(in crate::cell) fn first_tick_values(cell_state: &CellState, spread: &[Spread]) -> Vec<TickValues> {
        let first = |spread: &Spread| TickValues {
            earlier: vec![Vec::new(); spread.nodes.len()],
            now: spread.nodes.iter().map(|terms| shown_values_of(cell_state, terms)).collect(),
        };
        spread.iter().map(first).collect()
    }

    /// Recomputes the present shown values after a state was loaded.
    pub(in crate::cell) fn see_anew(&mut self) {
        for (spread, tick_values) in self.spread.iter().zip(&mut self.tick_values) {
            for (terms, now) in spread.nodes.iter().zip(&mut tick_values.now) {
                now.iter_mut().zip(terms).for_each(|(value, &term)| *value = self.cell.look_up(term));
            }
        }
    }

    /// Updates the shown values after a move, and evaluates the checks for every combination with earlier values of this tick.
    pub(in crate::cell) fn mix(&mut self) {
        self.mixed.clear();
        for (spread, tick_values) in self.spread.iter().zip(&mut self.tick_values) {
            let mut is_new = false;
            for ((terms, now), earlier) in
                spread.nodes.iter().zip(&mut tick_values.now).zip(&mut tick_values.earlier)
            {
                let differs = |(&term, value): (&Term, &Option<i64>)| {
                    self.checks.touches(term) && self.cell.look_up(term) != *value
                };
                if !terms.iter().zip(&*now).any(differs) {
                    continue;
                }
                is_new = true;
                let before = std::mem::replace(now, shown_values_of(&self.cell, terms));
                if let Err(at) = earlier.binary_search(&before) {
                    earlier.insert(at, before);
                }
                earlier.retain(|shown_values| shown_values != now);
            }
            if !is_new {
                continue;
            }
            let Holds::Always(holds) = &self.plan.checks[spread.check].holds else { continue };
            if self.broken.contains(&spread.check) {
                continue;
            }
            if let Some(mixture) = broken_mixture(spread, tick_values, holds) {
                self.broken.push(spread.check);
                self.mixed.push((spread.check, mixture));
            }
        }
    }
}

fn shown_values_of(cell_state: &CellState, terms: &[Term]) -> ShownValues {
    terms.iter().map(|&term| cell_state.look_up(term)).collect()
}

/// The first combination of this tick's values that breaks the check.
fn broken_mixture(spread: &Spread, tick_values: &TickValues, holds: &[Term]) -> Option<Mixture> {
    let choices: Vec<Vec<&ShownValues>> = tick_values
        .earlier
        .iter()
        .zip(&tick_values.now)
        .map(|(earlier, now)| std::iter::once(now).chain(earlier).collect())
        .collect();
    let mut picked = vec![0; choices.len()];
    loop {
        let seen = spread.nodes.iter().zip(&choices).zip(&picked).flat_map(|((terms, tick_values), &at)| {
            terms.iter().copied().zip(tick_values[at].iter().copied())
        });
        let seen: Mixture = seen.collect();
        let look = |term: Term| seen.iter().find(|(of, _)| *of == term).and_then(|(_, value)| *value);
        if !eval(holds, look).is_ok_and(|value| value != 0) {
            return Some(seen);
        }
        // Counts up to the next combination: the choices of the nodes are the digits of a number.
        let next = picked.iter_mut().zip(&choices).find_map(|(at, choices)| {
            *at = (*at + 1) % choices.len();
            (*at > 0).then_some(())
        });
        next?;
    }
}
