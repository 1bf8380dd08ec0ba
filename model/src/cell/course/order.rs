//! What nodes show to a check in one tick. Nothing orders two nodes within a tick, and the search lets one act after the other:
//! so a check that reads several of them must hold for every mixture of what each of them showed in that tick (D161).

use super::Course;
use crate::cell::plan::{CellPlan, Holds, about};
use crate::floor::Floor;
use imrs_protocol::script::{Term, eval};
use imrs_protocol::{NodeId, TaskId};

/// A check that reads several nodes: what it reads of each.
#[derive(Clone, Debug)]
pub(in crate::cell) struct Spread {
    pub check: usize,
    nodes: Vec<Vec<Term>>,
}

/// What a node showed: the value of each term, as far as it has one.
pub(in crate::cell) type Sight = Vec<Option<i64>>;

/// One sight of each node: what a check read then.
pub(in crate::cell) type Mixture = Vec<(Term, Option<i64>)>;

/// Of one check.
#[derive(Clone, Debug, Default)]
pub(in crate::cell) struct Sights {
    /// For each of its nodes, what it showed in this tick before what it shows now, each once, in order.
    pub earlier: Vec<Vec<Sight>>,
    /// What each of them shows. In no packed state: it follows from the rest.
    now: Vec<Sight>,
}

impl Sights {
    /// How many values a sight of each node has.
    pub fn widths(&self) -> impl Iterator<Item = usize> {
        self.now.iter().map(Vec::len)
    }
}

impl Course {
    /// The checks of this search that read several nodes.
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

    /// A tick begins: what nodes show now they show at its begin, too.
    pub(in crate::cell) fn begin_tick(&mut self) {
        for sights in &mut self.sights {
            sights.earlier.iter_mut().for_each(Vec::clear);
        }
    }

    /// Nodes showed nothing before in this tick.
    pub(in crate::cell) fn first_sights(floor: &Floor, spread: &[Spread]) -> Vec<Sights> {
        let first = |spread: &Spread| Sights {
            earlier: vec![Vec::new(); spread.nodes.len()],
            now: spread.nodes.iter().map(|terms| sight_of(floor, terms)).collect(),
        };
        spread.iter().map(first).collect()
    }

    /// Takes what a state that was read back shows.
    pub(in crate::cell) fn see_anew(&mut self) {
        for (spread, sights) in self.spread.iter().zip(&mut self.sights) {
            for (terms, now) in spread.nodes.iter().zip(&mut sights.now) {
                now.iter_mut().zip(terms).for_each(|(value, &term)| *value = self.floor.look_up(term));
            }
        }
    }

    /// Looks at what nodes show after a move, in every mixture with what they showed before in this tick.
    pub(in crate::cell) fn mix(&mut self) {
        self.mixed.clear();
        for (spread, sights) in self.spread.iter().zip(&mut self.sights) {
            let mut is_new = false;
            for ((terms, now), earlier) in spread.nodes.iter().zip(&mut sights.now).zip(&mut sights.earlier) {
                if terms.iter().zip(&*now).all(|(&term, value)| self.floor.look_up(term) == *value) {
                    continue;
                }
                is_new = true;
                let before = std::mem::replace(now, sight_of(&self.floor, terms));
                if let Err(at) = earlier.binary_search(&before) {
                    earlier.insert(at, before);
                }
                earlier.retain(|sight| sight != now);
            }
            if !is_new {
                continue;
            }
            let Holds::Always(holds) = &self.plan.checks[spread.check].holds else { continue };
            if self.broken.contains(&spread.check) {
                continue;
            }
            if let Some(mixture) = broken_mixture(spread, sights, holds) {
                self.broken.push(spread.check);
                self.mixed.push((spread.check, mixture));
            }
        }
    }
}

fn sight_of(floor: &Floor, terms: &[Term]) -> Sight {
    terms.iter().map(|&term| floor.look_up(term)).collect()
}

/// A mixture of what the nodes showed in this tick for which the check does not hold.
fn broken_mixture(spread: &Spread, sights: &Sights, holds: &[Term]) -> Option<Mixture> {
    let choices: Vec<Vec<&Sight>> = sights
        .earlier
        .iter()
        .zip(&sights.now)
        .map(|(earlier, now)| std::iter::once(now).chain(earlier).collect())
        .collect();
    let mut picked = vec![0; choices.len()];
    loop {
        let seen = spread
            .nodes
            .iter()
            .zip(&choices)
            .zip(&picked)
            .flat_map(|((terms, sights), &at)| terms.iter().copied().zip(sights[at].iter().copied()));
        let seen: Mixture = seen.collect();
        let look = |term: Term| seen.iter().find(|(of, _)| *of == term).and_then(|(_, value)| *value);
        if !eval(holds, look).is_ok_and(|value| value != 0) {
            return Some(seen);
        }
        // The next mixture: as a number whose digits are the nodes' choices.
        let next = picked.iter_mut().zip(&choices).find_map(|(at, choices)| {
            *at = (*at + 1) % choices.len();
            (*at > 0).then_some(())
        });
        next?;
    }
}
