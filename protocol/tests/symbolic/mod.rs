//! Tests of symbolic times: a run on symbols has the same effects as the runs on all numbers that lead to the same
//! behaviour.
//!
//! Each random run is made twice, on numbers and on symbols. The run on symbols makes the same decisions as the numbers, and
//! the zone records each question and its answer. A run on any other numbers for which all answers are the same must then
//! have the same effects.

mod nodes;
mod numbers;
mod tasks;

use crate::support::Effects;
use crate::support::plan::plans;
use crate::support::world::{Op, World, lively, ops};
use imrs_protocol::symbolic::{self, Symbol, Zone};
use imrs_protocol::*;
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use std::cell::{self, RefCell};
use std::ops::Range;
use std::rc::Rc;

/// The most steps of a run. More steps would need more variables than symbols can name.
const MOST: usize = 100;

/// Runs `run` on symbols of these times, with the decisions that the times themselves lead to.
fn on_symbols<R>(times: &[i64], run: impl FnOnce() -> R) -> (R, Example) {
    let zone = Rc::new(RefCell::new(Example::new(times)));
    let result = symbolic::within(Rc::<RefCell<Example>>::clone(&zone), run);
    (result, zone.take())
}

/// A function from the number of a step's variable to its instant: a symbol, or the time itself.
type Clock<'a> = &'a dyn Fn(u8) -> Instant;

/// The clock that shows these numbers at the steps of a run.
fn showing(times: &[i64]) -> impl Fn(u8) -> Instant {
    |step| Instant(times[usize::from(step) - 1].unsigned_abs())
}

/// Instants that never run backwards, with these gaps between them.
fn times(gaps: &[u8], count: usize) -> Vec<i64> {
    let gaps = gaps.iter().cycle().take(count);
    gaps.scan(1_000, |at, &gap| {
        *at += i64::from(gap);
        Some(*at)
    })
    .collect()
}

/// Other times: from each of these steps on, all times are later or earlier, unless that would change the order of the
/// steps.
fn moved<'a>(times: &'a [i64], by: &'a [(usize, i64)]) -> impl Iterator<Item = Vec<i64>> + 'a {
    let moved = |&(from, more): &(usize, i64)| {
        let from = from % times.len().max(1);
        times
            .iter()
            .enumerate()
            .map(|(step, &at)| if step >= from { at + more } else { at })
            .collect::<Vec<_>>()
    };
    by.iter().map(moved).filter(|times| times.is_sorted())
}

/// A zone that knows a value of each variable, answers by these values, and records the questions.
#[derive(Debug, Default)]
struct Example {
    values: Vec<i64>,
    /// The symbols about which the run asked, and whether each was negative.
    asked: Vec<(Symbol, bool)>,
    /// How many variables the zone had to make, for times that have more than two variables.
    named: usize,
}

impl Example {
    fn new(values: &[i64]) -> Self {
        let values = [0].iter().chain(values).copied().collect();
        Self { values, ..Self::default() }
    }

    fn value(&self, symbol: Symbol) -> i64 {
        let of = |variable: u8| self.values[usize::from(variable)];
        of(symbol.first) - of(symbol.second) + symbol.offset
    }

    /// Whether both variables of the symbol have the same value.
    fn is_zero(&mut self, symbol: Symbol) -> bool {
        let symbol = Symbol { offset: 0, ..symbol };
        let is_zero = self.value(symbol) == 0;
        if is_zero {
            let back = Symbol { first: symbol.second, second: symbol.first, offset: 0 };
            self.asked.extend([(symbol, false), (back, false)]);
        }
        is_zero
    }

    /// Whether these values of the variables give the same answers to all questions that the run asked.
    fn covers(&self, values: &[i64]) -> bool {
        let other = Self::new(values);
        self.asked.iter().all(|&(symbol, answer)| (other.value(symbol) < 0) == answer)
    }
}

impl Zone for Example {
    fn is_negative(&mut self, symbol: Symbol) -> bool {
        let answer = self.value(symbol) < 0;
        self.asked.push((symbol, answer));
        answer
    }

    fn sum(&mut self, one: Symbol, other: Symbol) -> Symbol {
        // If two inputs come at the same time, the later one does not move the clock, so the variables of both stand
        // for the same instant.
        for (one, other) in [(one, other), (other, one)] {
            let same = Symbol { second: other.second, ..one };
            if self.is_zero(same) {
                return Symbol { first: other.first, second: one.second, offset: 0 };
            }
            if self.is_zero(one) {
                return Symbol { offset: 0, ..other };
            }
        }
        self.named += 1;
        let value = [one, other].map(|symbol| self.value(Symbol { offset: 0, ..symbol })).iter().sum();
        let variable = self.values.iter().position(|&known| known == value).unwrap_or(self.values.len());
        if variable == self.values.len() {
            self.values.push(value);
        }
        let first = u8::try_from(variable).expect("few variables");
        Symbol { first, second: symbolic::START, offset: 0 }
    }
}

/// A pass that replaces symbols by the numbers of an example.
struct Evaluate<'a>(&'a Example);

impl Evaluate<'_> {
    fn value_of(&self, number: u64) -> u64 {
        symbolic::symbol(number).map_or(number, |symbol| u64::try_from(self.0.value(symbol)).unwrap_or(0))
    }

    fn ticks(&self, ticks: &mut Ticks) {
        *ticks = Ticks(self.value_of(ticks.0));
    }

    fn effects(&self, effects: &Effects) -> Effects {
        let mut effects = effects.clone();
        effects.packets.iter_mut().for_each(|packet| self.ticks(&mut packet.remaining));
        effects
            .timers
            .iter_mut()
            .filter_map(|(_, length)| length.as_mut())
            .for_each(|ticks| self.ticks(ticks));
        effects.observations.iter_mut().for_each(|seen| self.ticks(&mut seen.remaining));
        for signal in &mut effects.signals {
            if let Signal::Message(delivery) | Signal::Interrupt(Call::Message(delivery)) = signal {
                self.ticks(&mut delivery.budget);
            }
        }
        effects
    }
}

impl Walk for Evaluate<'_> {
    const PASS: Pass = Pass::Change;

    fn clock(&mut self, now: &mut Instant) {
        *now = Instant(self.value_of(now.0));
    }

    fn instant(&mut self, instant: &mut Instant) {
        *instant = Instant(self.value_of(instant.0));
    }

    fn length(&mut self, length: &mut Ticks) {
        self.ticks(length);
    }
}

/// The state at the end of a run.
trait State: Clone {
    /// The packed form of the state, with its symbols replaced by numbers.
    fn bytes(self, evaluate: &mut Evaluate<'_>) -> Vec<Result<Vec<u8>, Overflow>>;
}

/// The effects of each step of a run, and the states at the end of the run.
struct Run<S> {
    effects: Vec<Effects>,
    end: S,
}

/// The parts of a run that are compared with another run.
type Outcome = (Vec<Effects>, Vec<Result<Vec<u8>, Overflow>>);

impl<S: State> Run<S> {
    /// The outcome of the run, with its symbols replaced by the times of an example. The outcome of a run on numbers stays
    /// the same.
    fn at(&self, example: &Example) -> Outcome {
        let mut evaluate = Evaluate(example);
        let effects = self.effects.iter().map(|effects| evaluate.effects(effects)).collect();
        (effects, self.end.clone().bytes(&mut evaluate))
    }
}

/// Compares a run on symbols, decided by the times `first`, with the runs on these times and on each of the other times
/// that give the same answers. Returns how many such other times there were. With `exact`, no time may depend on three
/// instants.
fn runs_alike<S: State>(
    (first, others): (&[i64], &[(usize, i64)]),
    exact: bool,
    run: impl Fn(Clock<'_>) -> Run<S>,
) -> Result<usize, TestCaseError> {
    let (symbols, zone) = on_symbols(first, || run(&symbolic::instant));
    prop_assert!(zone.named == 0 || !exact, "{} times are made of three instants", zone.named);
    let on_numbers = |times: &[i64]| run(&showing(times)).at(&zone);
    prop_assert_eq!(symbols.at(&zone), on_numbers(first), "at {:?}", first);
    let mut alike = 0;
    for other in moved(first, others).filter(|other| zone.named == 0 && zone.covers(other)) {
        prop_assert_eq!(
            symbols.at(&Example::new(&other)),
            on_numbers(&other),
            "at {:?}, as at {:?}",
            &other,
            first
        );
        alike += 1;
    }
    Ok(alike)
}

/// Compares random runs of random cells, whose steps are at most as far apart as `gaps` says, and demands that the same
/// answers came for more other times than there are runs.
fn random_runs_are_alike<S: State>(
    (cases, gaps): (u32, Range<u8>),
    start: impl Fn(World) -> S,
    run: impl Fn(&S, &[Op], Clock<'_>) -> Run<S>,
) {
    let runs = (
        plans(),
        prop_oneof![ops(), lively()],
        proptest::collection::vec(gaps, 1..20),
        proptest::collection::vec((any::<usize>(), -4..5_i64), 12),
    );
    let config = ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() };
    let alike = cell::Cell::new(0);
    let result = TestRunner::new(config).run(&runs, |(plan, ops, gaps, others)| {
        let world = World::new(&plan.build(), false);
        // Under this variant of the rules time in a buffer is not charged, so a deadline is moved by the difference of two
        // instants, and a time may depend on three instants.
        let exact = world.tables[0].rules().charge_residence;
        let (start, ops) = (start(world), &ops[..ops.len().min(MOST)]);
        let times = times(&gaps, ops.len());
        alike.set(alike.get() + runs_alike((&times, &others), exact, |clock| run(&start, ops, clock))?);
        Ok(())
    });
    result.unwrap_or_else(|error| panic!("{error}"));
    assert!(alike.get() > cases as usize, "only {} other times were answered alike", alike.get());
}
