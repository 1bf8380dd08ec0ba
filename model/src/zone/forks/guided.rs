//! Runs code on the variables of a zone along one point of it: each comparison has the answer that this point gives. The zone of
//! the run ends with all points that give the same answers.

use super::Cut;
use crate::zone::dbm::Dbm;
use imrs_protocol::symbolic::{self, Symbol, Zone};
use std::cell::RefCell;
use std::rc::Rc;

/// A zone and a point of it.
struct Guided {
    cut: Cut,
    /// The values of the variables.
    point: Vec<i64>,
}

/// A handle on the zone of the run, which the running code uses.
pub(crate) struct Guide(Rc<RefCell<Guided>>);

/// Runs `run` along a point, whose values `run` itself gives as it [adds](Guide::add) variables.
pub(crate) fn along<R>(run: impl FnOnce(&Guide) -> R) -> R {
    let cut = Cut::new(Dbm::zero(), Vec::new());
    let guide = Guide(Rc::new(RefCell::new(Guided { cut, point: vec![0] })));
    symbolic::within(Rc::<RefCell<Guided>>::clone(&guide.0), || run(&guide))
}

impl Guide {
    /// Adds a variable without bounds, and its value at the point.
    ///
    /// # Panics
    /// If there are more variables than a symbolic time can name (255).
    pub fn add(&self, value: i64) -> u8 {
        let mut guided = self.0.borrow_mut();
        guided.point.push(value);
        guided.cut.add()
    }

    /// Keeps the points at which a symbolic time is not negative. Returns false if it is negative at the point of this run; then
    /// nothing changes.
    pub fn keep(&self, symbol: Symbol) -> bool {
        let mut guided = self.0.borrow_mut();
        let is_kept = guided.value(symbol) >= 0;
        if is_kept {
            guided.restrict(symbol);
        }
        is_kept
    }

    /// Keeps the points at which `one` is at most `other`. Returns false if this would need more than two variables, or if it
    /// does not hold at the point of this run.
    pub fn keep_at_most(&self, one: Symbol, other: Symbol) -> bool {
        let difference = Cut::between(other, one);
        difference.is_some_and(|(first, second, offset)| self.keep(Symbol { first, second, offset }))
    }

    /// The least and the greatest value of a symbolic time in the zone of the run; `None` where there is no bound.
    pub fn bounds(&self, symbol: Symbol) -> [Option<i64>; 2] {
        let Symbol { first, second, offset } = symbol;
        let (first, second, guided) = (usize::from(first), usize::from(second), self.0.borrow());
        let bound = |i, j| guided.cut.zone.bound(i, j);
        [bound(second, first).map(|bound| offset - bound), bound(first, second).map(|bound| offset + bound)]
    }

    /// The zone of the run: its points give the same answers.
    pub fn zone(&self) -> Dbm {
        self.0.borrow().cut.zone.clone()
    }

    /// Whether each point of the zone is possible: no time that stands for more values than it can have has decided an answer.
    pub fn is_exact(&self) -> bool {
        self.0.borrow().cut.is_exact()
    }
}

impl Guided {
    fn value(&self, Symbol { first, second, offset }: Symbol) -> i64 {
        self.point[usize::from(first)] - self.point[usize::from(second)] + offset
    }

    /// Keeps the points at which a symbolic time is not negative, as it is not at the point of this run.
    fn restrict(&mut self, symbol: Symbol) {
        let (i, j) = (usize::from(symbol.second), usize::from(symbol.first));
        if !self.cut.zone.entails(i, j, symbol.offset) {
            self.cut.keep(symbol).expect("the zone has the point");
        }
    }
}

impl Zone for Guided {
    fn is_negative(&mut self, symbol: Symbol) -> bool {
        let is_negative = self.value(symbol) < 0;
        let Symbol { first, second, offset } = symbol;
        let less = Symbol { first: second, second: first, offset: -offset - 1 };
        self.restrict(if is_negative { less } else { symbol });
        is_negative
    }

    fn sum(&mut self, one: Symbol, other: Symbol) -> Symbol {
        let value = [one, other].map(|symbol| self.value(Symbol { offset: 0, ..symbol })).iter().sum();
        let sum = self.cut.sum(one, other);
        if self.cut.zone.len() > self.point.len() {
            self.point.push(value);
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use imrs_protocol::{Instant, Ticks};

    #[test]
    fn a_run_ends_with_all_points_that_answer_as_its_point_does() {
        let facts = |a: Instant, b: Instant, c: Instant| {
            let (first, last) = (a.min(b), a.max(b) + Ticks(2));
            [a < b, last <= c, first + Ticks(4) < c, (c - a) < Ticks(7), a > Instant(1)]
        };
        let all = || (0..5).flat_map(|a| (0..5).flat_map(move |b| (0..9).map(move |c| [a, b, c])));
        for [a, b, c] in all() {
            let (facts_here, kept) = along(|guide| {
                let names = [a, b, c].map(|value: i64| {
                    let new = guide.add(value);
                    assert!(guide.keep(Symbol { first: new, second: 0, offset: 0 }));
                    symbolic::instant(new)
                });
                let facts_here = facts(names[0], names[1], names[2]);
                assert!(guide.is_exact());
                (facts_here, guide.zone())
            });
            let instants = |point: [i64; 3]| point.map(|value| Instant(value.unsigned_abs()));
            for point in all() {
                let [x, y, z] = instants(point);
                let is_in = kept.has(&[0, point[0], point[1], point[2]]);
                assert!(!is_in || facts(x, y, z) == facts_here, "{a} {b} {c} has {point:?}");
            }
            let [x, y, z] = instants([a, b, c]);
            assert!(kept.has(&[0, a, b, c]) && facts(x, y, z) == facts_here);
        }
    }

    #[test]
    fn a_condition_that_does_not_hold_at_the_point_is_not_kept() {
        along(|guide| {
            let new = guide.add(5);
            let at_least = |least: i64| Symbol { first: new, second: 0, offset: -least };
            assert!(guide.keep(at_least(3)) && !guide.keep(at_least(6)));
            assert_eq!(guide.bounds(at_least(0)), [Some(3), None]);
            let ten = Symbol { first: 0, second: 0, offset: 10 };
            assert!(guide.keep_at_most(at_least(0), ten) && !guide.keep_at_most(ten, at_least(0)));
            assert_eq!(guide.bounds(at_least(0)), [Some(3), Some(10)]);
        });
    }
}
