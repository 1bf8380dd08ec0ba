//! Runs code on the variables of a zone, once for each feasible sequence of answers to its comparisons.
//!
//! A run is not copied at a fork. Instead, the code runs again from the start with the same answers up to the fork (as loom
//! does with schedules). So the code must depend on nothing but the answers.

pub(crate) mod guided;

use super::dbm::{Dbm, Empty};
use super::times::{Times, symbol_of};
use imrs_protocol::Ticks;
use imrs_protocol::symbolic::{self, Symbol, Time, Zone};
use std::cell::{RefCell, RefMut};
use std::rc::Rc;

/// One of several answers to a comparison: its number, and how many answers there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Answer {
    taken: u16,
    among: u16,
}

/// The zone of a run, restricted by the answers so far.
#[derive(Debug)]
pub(crate) struct Cut {
    zone: Dbm,
    answers: Vec<Answer>,
    /// How many of the given answers the run has used.
    used: usize,
    /// The variables whose bounds in the zone may allow values that cannot occur.
    loose: Vec<u8>,
    /// Whether the run is exact: no variable of `loose` has decided an answer, and none is among the times of the
    /// packed state.
    is_exact: bool,
    /// The times of the state that is being read or packed.
    pub(super) times: Times,
}

/// A handle on the zone of the run, which the running code uses.
#[derive(Clone, Debug)]
pub(crate) struct Forks(Rc<RefCell<Cut>>);

/// Runs `run` for each sequence of answers that some point of the zone gives, and passes each result to `found`, together
/// with the part of the zone that gives these answers.
pub(crate) fn each<R>(zone: &Dbm, mut run: impl FnMut(&Forks) -> R, mut found: impl FnMut(R, &Cut)) {
    let mut answers = Vec::new();
    loop {
        let forks = Forks::new(zone.clone(), answers);
        let result = forks.within(|| run(&forks));
        let mut cut = forks.0.borrow_mut();
        found(result, &cut);
        answers = std::mem::take(&mut cut.answers);
        // An answer of an earlier run for which this run did not ask would be a lost choice.
        answers.truncate(cut.used);
        while answers.last().is_some_and(|last| last.taken + 1 == last.among) {
            answers.pop();
        }
        match answers.last_mut() {
            Some(last) => last.taken += 1,
            None => return,
        }
    }
}

/// Runs `run` once, with the answers of an earlier run.
pub(crate) fn again<R>(zone: &Dbm, answers: &[u16], run: impl FnOnce(&Forks) -> R) -> (R, Dbm) {
    let answers = answers.iter().map(|&taken| Answer { taken, among: u16::MAX }).collect();
    let forks = Forks::new(zone.clone(), answers);
    let result = forks.within(|| run(&forks));
    let zone = forks.0.borrow().zone.clone();
    (result, zone)
}

/// Runs `run` if the zone decides all its comparisons, and if nothing in the run is inexact. Also returns the zone at the
/// end, which holds the times of the state that `run` packs.
pub(crate) fn decided<R>(zone: &Dbm, run: impl FnOnce() -> R) -> Option<(R, Forks)> {
    let forks = Forks::new(zone.clone(), Vec::new());
    let result = forks.within(run);
    let is_decided = {
        let cut = forks.cut();
        cut.used == 0 && cut.is_exact
    };
    is_decided.then_some((result, forks))
}

impl Forks {
    fn new(zone: Dbm, answers: Vec<Answer>) -> Self {
        Self(Rc::new(RefCell::new(Cut::new(zone, answers))))
    }

    fn within<R>(&self, run: impl FnOnce() -> R) -> R {
        symbolic::within(Rc::<RefCell<Cut>>::clone(&self.0), run)
    }

    /// The zone of the run, restricted by the answers so far. While it is borrowed, no symbolic times may be compared.
    pub fn cut(&self) -> RefMut<'_, Cut> {
        self.0.borrow_mut()
    }

    /// Chooses one of `among` alternatives (at least one). Each alternative is taken in some run.
    pub fn choose(&self, among: usize) -> usize {
        self.cut().answer(u16::try_from(among).unwrap_or(u16::MAX)).into()
    }
}

impl Cut {
    fn new(zone: Dbm, answers: Vec<Answer>) -> Self {
        let times = Times::of_zone(zone.len());
        Self { zone, answers, used: 0, loose: Vec::new(), is_exact: true, times }
    }

    /// The times of the state that was packed last.
    pub const fn times(&self) -> &Times {
        &self.times
    }

    /// The times of the state that was packed last, as a zone of its own.
    pub fn state(&self) -> Dbm {
        self.zone.project(&self.times.terms())
    }

    /// Whether `one` is at most `other` at all points. Also false if the comparison needs more than two variables.
    pub fn is_surely_at_most(&self, one: Ticks, other: Ticks) -> bool {
        let [one, other] = [one, other].map(symbol_of);
        match (one, other) {
            (_, None) => true,
            (None, Some(_)) => false,
            (Some(one), Some(other)) => Self::between(one, other)
                .is_some_and(|(i, j, offset)| self.zone.entails(i.into(), j.into(), -offset)),
        }
    }

    /// The two variables and the offset that make the difference of two symbolic times; `None` if more variables are needed.
    const fn between(one: Symbol, other: Symbol) -> Option<(u8, u8, i64)> {
        let offset = one.offset - other.offset;
        match (one, other) {
            _ if one.second == other.second => Some((one.first, other.first, offset)),
            _ if one.first == other.first => Some((other.second, one.second, offset)),
            _ if one.first == one.second => Some((other.second, other.first, offset)),
            _ if other.first == other.second => Some((one.first, one.second, offset)),
            _ => None,
        }
    }

    /// Keeps the points at which `one` is at most `other`. Returns false if this would need more than two variables.
    pub fn keep_at_most(&mut self, one: Symbol, other: Symbol) -> Result<bool, Empty> {
        let Some((i, j, offset)) = Self::between(one, other) else { return Ok(false) };
        self.decides(i);
        self.decides(j);
        self.zone.constrain(i.into(), j.into(), -offset).map(|()| true)
    }

    /// The answers so far. With these answers, [`again`] makes the same run.
    pub fn answers(&self) -> Vec<u16> {
        self.answers[..self.used].iter().map(|answer| answer.taken).collect()
    }

    /// Whether everything that the run did, and each point of the zone at its end, is really possible.
    pub const fn is_exact(&self) -> bool {
        self.is_exact
    }

    /// Notes that the values of a variable have decided an answer.
    pub(super) fn decides(&mut self, variable: u8) {
        self.is_exact &= !self.loose.contains(&variable);
    }

    /// A new variable, without bounds.
    ///
    /// # Panics
    /// If there are more variables than a symbolic time can name (255).
    pub fn add(&mut self) -> u8 {
        u8::try_from(self.zone.add()).expect("at most 255 variables")
    }

    /// Keeps the points at which this symbolic time is not negative.
    pub fn keep(&mut self, symbol: Symbol) -> Result<(), Empty> {
        [symbol.first, symbol.second].into_iter().for_each(|variable| self.decides(variable));
        self.zone.constrain(usize::from(symbol.second), usize::from(symbol.first), symbol.offset)
    }

    fn answer(&mut self, among: u16) -> u16 {
        let at = self.used;
        self.used += 1;
        if at == self.answers.len() {
            self.answers.push(Answer { taken: 0, among });
        }
        self.answers[at].taken
    }

    fn difference(&self, first: u8, second: u8) -> Option<i64> {
        self.zone.difference(first.into(), second.into())
    }

    /// A variable and an offset from it that together stand for `first - second` plus a third variable.
    pub fn moved(&mut self, by: u8, first: u8, second: u8) -> (u8, i64) {
        if let Some(value) = self.difference(by, second) {
            return (first, value);
        }
        if let Some(value) = self.difference(first, second) {
            return (by, value);
        }
        (self.named([by, first], [second, symbolic::START]), 0)
    }

    /// A new variable for the sum of two variables less two others. The bounds of the new variable follow from the
    /// bounds on pairs of these variables, so they may allow values that the sum cannot have.
    fn named(&mut self, plus: [u8; 2], less: [u8; 2]) -> u8 {
        let [plus, less] = [plus, less].map(|pair| pair.map(usize::from));
        let bounds = |other: usize| {
            let (plus, less) = ([plus[0], plus[1], 0], [less[0], less[1], other]);
            [self.most(plus, less), self.most(less, plus)]
        };
        let bounds: Vec<_> = (0..self.zone.len()).map(bounds).collect();
        let new = self.add();
        let at = usize::from(new);
        for (other, [above, below]) in bounds.into_iter().enumerate() {
            for (i, j, bound) in [(at, other, above), (other, at, below)] {
                if let Some(bound) = bound {
                    self.zone.constrain(i, j, bound).expect("the sum has a value at each point");
                }
            }
        }
        self.loose.push(new);
        new
    }

    /// A bound on the sum of three variables less three others: the least of the bounds that follow from pairs.
    fn most(&self, plus: [usize; 3], less: [usize; 3]) -> Option<i64> {
        const WAYS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
        let by = |way: [usize; 3]| plus.iter().zip(way).map(|(&i, j)| self.zone.bound(i, less[j])).sum();
        WAYS.into_iter().filter_map(by).min()
    }
}

impl Cut {
    /// Whether a symbolic time is negative. If the zone allows both, the answer becomes one more answer of the run.
    pub(super) fn asks_negative(&mut self, symbol: Symbol) -> bool {
        let Symbol { first, second, offset } = symbol;
        let (i, j) = (usize::from(first), usize::from(second));
        let (yes, no) = ((i, j, -offset - 1), (j, i, offset));
        let may = |(i, j, bound)| self.zone.intersects(i, j, bound);
        let is_negative = match (may(yes), may(no)) {
            (true, true) => {
                [first, second].into_iter().for_each(|variable| self.decides(variable));
                self.answer(2) == 0
            }
            (is_negative, _) => is_negative,
        };
        let (i, j, bound) = if is_negative { yes } else { no };
        self.zone.constrain(i, j, bound).expect("the answer is possible");
        is_negative
    }
}

impl Zone for Cut {
    fn is_negative(&mut self, symbol: Symbol) -> bool {
        self.asks_negative(symbol)
    }

    fn pack(&mut self, time: Time, symbol: Option<Symbol>) -> u8 {
        self.pack_time(time, symbol)
    }

    fn unpack(&mut self, time: Time, packed: u8) -> Option<Symbol> {
        self.unpack_time(time, packed)
    }

    fn sum(&mut self, one: Symbol, other: Symbol) -> Symbol {
        for (one, other) in [(one, other), (other, one)] {
            if let Some(offset) = self.difference(one.first, one.second) {
                return Symbol { offset, ..other };
            }
            if let Some(offset) = self.difference(one.first, other.second) {
                return Symbol { first: other.first, second: one.second, offset };
            }
        }
        let first = self.named([one.first, other.first], [one.second, other.second]);
        Symbol { first, second: symbolic::START, offset: 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use imrs_protocol::{Instant, Ticks};
    use std::collections::BTreeMap;

    /// A zone of three variables, each from 1 to its bound.
    fn boxed(bounds: [i64; 3]) -> Dbm {
        let mut zone = Dbm::zero();
        for bound in bounds {
            let new = zone.add();
            zone.constrain(new, 0, bound).unwrap();
            zone.constrain(0, new, -1).unwrap();
        }
        zone
    }

    /// The order of three instants, and some sums, differences and quotients of them.
    fn compared(at: [Instant; 3]) -> Vec<u64> {
        let [a, b, c] = at;
        let mut sorted = vec![(a, 0_u64), (b, 1), (c, 2)];
        sorted.sort_unstable();
        let later = a.max(b) + Ticks(2);
        let facts = [b < a, later <= c, (c - a) < Ticks(2), (b - a) == (c - b), (a + (c - b)) > b];
        sorted
            .into_iter()
            .map(|(_, name)| name)
            .chain(facts.map(u64::from))
            .chain([(c - a).whole(Ticks(2))])
            .collect()
    }

    #[test]
    fn each_point_is_in_the_run_that_answers_as_it_does() {
        let (most, mut runs) = ([3, 5, 4], 0);
        let mut parts: Vec<(Dbm, Vec<u64>)> = Vec::new();
        let names = [1, 2, 3].map(symbolic::instant);
        each(
            &boxed(most),
            |_| compared(names),
            |facts, cut| {
                runs += 1;
                // The zone's first four variables are zero and the three instants. Later variables stand for sums of
                // three variables.
                let only = cut.zone.project(&[(0, 0), (1, 0), (2, 0), (3, 0)]);
                assert!(cut.is_exact() || cut.zone.len() > 4);
                parts.push((only, facts));
            },
        );
        let mut seen = BTreeMap::new();
        for (a, b, c) in (1..=3).flat_map(|a| (1..=5).flat_map(move |b| (1..=4).map(move |c| (a, b, c)))) {
            let expected = compared([a, b, c].map(|at: i64| Instant(at.unsigned_abs())));
            let found: Vec<_> = parts.iter().filter(|(zone, _)| zone.has(&[0, a, b, c])).collect();
            assert!(
                found.iter().any(|(_, facts)| *facts == expected),
                "{a} {b} {c}: {expected:?} of {found:?}"
            );
            seen.insert(expected, ());
        }
        assert!(runs >= seen.len() && runs < 60, "{runs} runs for {} outcomes", seen.len());
    }

    #[test]
    fn choices_and_answers_are_taken_in_all_combinations_once() {
        let mut all = Vec::new();
        let run = |forks: &Forks| {
            let first = forks.choose(3);
            let early = symbolic::instant(1) < Instant(3);
            // The run does not fork again over a comparison whose answer follows from an earlier one.
            assert_eq!(early, symbolic::instant(1) <= Instant(2));
            (first, early, if early { forks.choose(2) } else { 9 })
        };
        each(&boxed([4, 1, 1]), run, |result, cut| {
            let (same, zone) = again(&boxed([4, 1, 1]), &cut.answers(), run);
            assert_eq!((same, &zone), (result, &cut.zone));
            assert!(cut.is_exact());
            all.push(result);
        });
        let of = |first| [(first, true, 0), (first, true, 1), (first, false, 9)];
        assert_eq!(all, [0, 1, 2].map(of).concat());
    }

    #[test]
    fn a_variable_for_three_has_all_values_of_their_sum() {
        // `y` is `x` or `x + 1`. The bounds on pairs of variables do not determine the sums of three.
        let mut zone = boxed([9, 9, 9]);
        zone.constrain(2, 1, 1).unwrap();
        zone.constrain(1, 2, 0).unwrap();
        zone.constrain(3, 2, 4).unwrap();
        let mut cut = Cut::new(zone.clone(), Vec::new());
        let sum =
            cut.sum(Symbol { first: 1, second: 2, offset: 0 }, Symbol { first: 3, second: 0, offset: 0 });
        assert_eq!(
            (sum, &cut.loose[..], cut.is_exact()),
            (Symbol { first: 4, second: 0, offset: 0 }, &[4][..], true)
        );
        let values = || (1..=9).flat_map(|x| (1..=9).flat_map(move |y| (1..=9).map(move |z| [0, x, y, z])));
        for [zero, x, y, z] in values().filter(|point| zone.has(point)) {
            assert!(cut.zone.has(&[zero, x, y, z, x - y + z]), "{x} {y} {z}");
            assert!(!cut.zone.has(&[zero, x, y, z, x - y + z + 2]), "{x} {y} {z}");
        }
        assert!(!cut.is_negative(Symbol { offset: 9, ..sum }) && cut.is_exact(), "that was known");
        cut.is_negative(Symbol { offset: -3, ..sum });
        assert!(!cut.is_exact());
    }

    #[test]
    fn variables_at_a_fixed_distance_need_no_other_one() {
        let mut zone = boxed([9, 9, 9]);
        zone.constrain(2, 1, 3).unwrap();
        zone.constrain(1, 2, -3).unwrap();
        let mut cut = Cut::new(zone, Vec::new());
        let of = |first, second| Symbol { first, second, offset: 0 };
        assert_eq!(cut.sum(of(2, 1), of(3, 0)), Symbol { offset: 3, ..of(3, 0) });
        assert_eq!(cut.sum(of(2, 3), of(0, 1)), Symbol { offset: 3, ..of(0, 3) });
        assert_eq!((cut.moved(1, 3, 2), cut.moved(3, 2, 1), cut.is_exact()), ((3, -3), (3, 3), true));
        assert_eq!((cut.moved(1, 2, 3), &cut.loose[..]), ((4, 0), &[4][..]));
    }
}
