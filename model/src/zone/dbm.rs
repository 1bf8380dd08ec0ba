//! Difference-bound matrices over integers: each describes a set of points by bounds on differences of variables.

mod bounds;
mod growth;
mod minimal;

use bounds::Bounds;
use minimal::Bound;
pub(crate) use minimal::KeptZones;
use std::fmt;

/// The value that stands for no bound.
const FREE: i32 = i32::MAX;

/// The greatest difference of two variables that a matrix can describe: 35 minutes with ticks of a microsecond. A bound
/// beyond it is replaced by a weaker one ([`Dbm::is_weakened`]), so the set may have more points, and never fewer.
const FAR: i64 = (1 << 31) - 1;

/// A non-empty set of integer points. For each pair of variables the matrix holds the least `c` with `x_i - x_j <= c` at
/// all points (closed), so two matrices are equal exactly if their sets are. The first variable is zero.
///
/// Copies share their bounds until one of them changes. A search keeps most sets several times: as the times of a state, and
/// as the times with which the state was reached.
#[derive(Clone, PartialEq, Eq, Hash)]
pub(crate) struct Dbm {
    len: usize,
    bounds: Bounds,
}

/// The error that a constraint would make the set empty.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Empty;

/// A bound as the matrix holds it.
fn held(bound: i64) -> i32 {
    if bound >= FAR { FREE } else { i32::try_from(bound.max(-FAR)).unwrap_or(FREE) }
}

/// A sum of two bounds.
fn plus(a: i32, b: i64) -> i64 {
    let free = i64::from(FREE);
    if a == FREE || b >= free { free } else { i64::from(a) + b }
}

impl Dbm {
    /// The set that has only the variable zero.
    pub fn zero() -> Self {
        Self { len: 1, bounds: std::iter::once(0).collect() }
    }

    /// The number of variables, including the variable zero.
    pub const fn len(&self) -> usize {
        self.len
    }

    /// Whether a difference that is surely greater than the matrix can describe has become a weaker bound.
    pub fn is_weakened(&self) -> bool {
        self.bounds.iter().any(|&bound| bound == held(-FAR))
    }

    fn at(&self, i: usize, j: usize) -> i32 {
        self.bounds[i * self.len + j]
    }

    /// The least `c` with `x_i - x_j <= c` at all points; `None` if there is no such bound.
    pub fn bound(&self, i: usize, j: usize) -> Option<i64> {
        Some(self.at(i, j)).filter(|&bound| bound != FREE).map(i64::from)
    }

    /// The difference of two variables, if it is the same at all points.
    pub fn difference(&self, i: usize, j: usize) -> Option<i64> {
        let (bound, back) = (self.at(i, j), self.at(j, i));
        (bound != FREE && back == -bound).then_some(bound.into())
    }

    /// Whether `x_i - x_j <= c` at all points.
    pub fn entails(&self, i: usize, j: usize, c: i64) -> bool {
        let bound = self.at(i, j);
        bound != FREE && i64::from(bound) <= c
    }

    /// Whether `x_i - x_j <= c` at some point.
    pub fn intersects(&self, i: usize, j: usize, c: i64) -> bool {
        plus(self.at(j, i), c) >= 0
    }

    /// Adds a variable without bounds, and returns its number.
    pub fn add(&mut self) -> usize {
        let (old, len) = (self.len, self.len + 1);
        let bounds = self.bounds.own();
        bounds.resize(len * len, FREE);
        // The last row moves first, so that no bound is overwritten before it has moved.
        for row in (1..old).rev() {
            bounds.copy_within(row * old..(row + 1) * old, row * len);
        }
        for row in 0..old {
            bounds[row * len + old] = FREE;
        }
        bounds[old * len..].fill(FREE);
        bounds[len * len - 1] = 0;
        self.len = len;
        old
    }

    /// Keeps only the points with `x_i - x_j <= c`.
    ///
    /// # Errors
    /// [`Empty`] if there is no such point. Then the matrix does not change.
    pub fn constrain(&mut self, i: usize, j: usize, c: i64) -> Result<(), Empty> {
        if self.entails(i, j, c) {
            return Ok(());
        }
        if !self.intersects(i, j, c) {
            return Err(Empty);
        }
        // Only paths over the new bound can be shorter than before.
        let (len, bounds) = (self.len, self.bounds.own());
        for from in 0..len {
            let over = plus(bounds[from * len + i], c);
            // A path that is no shorter to `j` is no shorter to any other variable.
            if over >= bounds[from * len + j].into() {
                continue;
            }
            for to in 0..len {
                let path = held(plus(bounds[j * len + to], over));
                let bound = &mut bounds[from * len + to];
                *bound = path.min(*bound);
            }
        }
        Ok(())
    }

    /// The set of the values of these terms, each a variable and an offset. The first term is subtracted from all terms,
    /// and becomes the variable zero of the result. Variables that are not among the terms are forgotten.
    pub fn project(&self, terms: &[(usize, i64)]) -> Self {
        let len = terms.len();
        let (mut row, mut column) = (0, 0);
        // An iterator of known length fills the shared bounds in place.
        let bounds = (0..len * len).map(|_| {
            let ((i, a), (j, b)) = (terms[row], terms[column]);
            column += 1;
            if column == len {
                (row, column) = (row + 1, 0);
            }
            held(plus(self.at(i, j), a - b))
        });
        Self { len, bounds: bounds.collect() }
    }

    /// Whether all points of this set are also in `other`.
    pub fn is_in(&self, other: &Self) -> bool {
        // Without an early exit in each row, a row is compared by few instructions.
        let rows = self.bounds.chunks(self.len).zip(other.bounds.chunks(self.len));
        self.len == other.len
            && rows.into_iter().all(|(mine, others)| {
                mine.iter().zip(others).fold(true, |all, (mine, others)| all & (mine <= others))
            })
    }

    /// The least set of this kind that contains all points of both sets.
    pub fn hull(&self, other: &Self) -> Self {
        let bounds = self.bounds.iter().zip(&*other.bounds).map(|(&a, &b)| a.max(b)).collect();
        Self { len: self.len, bounds }
    }

    /// The points of this set whose first values form a point of the set `first`.
    ///
    /// # Errors
    /// [`Empty`] if there is none.
    pub fn within(&self, first: &Self) -> Result<Self, Empty> {
        let mut both = self.clone();
        for (at, &bound) in first.bounds.iter().enumerate().filter(|(_, bound)| **bound != FREE) {
            both.constrain(at / first.len, at % first.len, bound.into())?;
        }
        Ok(both)
    }

    /// The union of two sets over the same variables, if a matrix can describe it: if it equals the [hull](Self::hull).
    pub fn merged(&self, other: &Self) -> Option<Self> {
        // Each point of the hull outside the first set breaks a bound of the first set that is tighter than the hull's.
        // For each such bound, all points of the hull that break it must be in the second set. Among these points, the
        // bound for a pair is the lesser of the hull's bound and the path over the broken bound.
        fn is_outside(hull: impl Fn(usize, usize) -> i32, (i, j, mine): Bound, (k, l, bound): Bound) -> bool {
            plus(hull(k, j), plus(hull(i, l), -mine - 1)) > bound
        }
        // Most pairs of sets fail at the first two bounds, before there is a hull.
        let first = self.tighter(other).next().zip(other.tighter(self).next());
        let of_both = |i, j| self.at(i, j).max(other.at(i, j));
        if first.is_some_and(|(mine, others)| is_outside(of_both, mine, others)) {
            return None;
        }
        let hull = self.hull(other);
        let others: Vec<_> = other.tighter(self).collect();
        let is_exact = self
            .tighter(other)
            .all(|mine| !others.iter().any(|&other| is_outside(|i, j| hull.at(i, j), mine, other)));
        is_exact.then_some(hull)
    }

    /// The bounds that are less than those of another set over the same variables.
    fn tighter(&self, than: &Self) -> impl Iterator<Item = Bound> {
        let both = self.bounds.iter().zip(&*than.bounds).enumerate();
        let less = both.filter(|(_, (mine, others))| mine < others);
        less.map(|(at, (&mine, _))| (at / self.len, at % self.len, mine.into()))
    }

    /// A point of the set. Its first value is that of the variable zero.
    pub fn point(&self) -> Vec<i64> {
        self.point_by(|least, most| least.or(most).unwrap_or(0))
    }

    /// A point of the set. `pick` chooses each value between the least and the greatest one that the earlier values leave; `None`
    /// stands for no such bound.
    pub fn point_by(&self, mut pick: impl FnMut(Option<i64>, Option<i64>) -> i64) -> Vec<i64> {
        let mut values = vec![0];
        for i in 1..self.len {
            let known = || values.iter().enumerate();
            let least = known().filter_map(|(j, &value)| Some(value - self.bound(j, i)?)).max();
            let most = known().filter_map(|(j, &value)| Some(value + self.bound(i, j)?)).min();
            // Any value within the bounds that the earlier values leave can be completed to a point, because the matrix is
            // closed.
            values.push(pick(least, most));
        }
        values
    }

    /// Whether the set has a point with the values of `point`, except that each variable in `over` may also be less than
    /// its value there. A variable in `over` stands for an instant that has passed: `point` has zero for it, however
    /// long ago that instant was.
    pub fn reaches(&self, point: &[i64], over: &[usize]) -> bool {
        let mut left = self.clone();
        point.len() == self.len
            && point.iter().enumerate().all(|(i, &value)| {
                let at_least = over.contains(&i) || left.constrain(0, i, -value).is_ok();
                at_least && left.constrain(i, 0, value).is_ok()
            })
    }

    /// Whether a point is in the set. The first value of a point is that of the variable zero.
    #[cfg(test)]
    pub fn has(&self, point: &[i64]) -> bool {
        let holds = |i: usize, j: usize| self.bound(i, j).is_none_or(|bound| point[i] - point[j] <= bound);
        point.len() == self.len && (0..self.len).all(|i| (0..self.len).all(|j| holds(i, j)))
    }
}

impl fmt::Debug for Dbm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let bounds = self.bounds().map(|(i, j, bound)| format!("x{i} - x{j} <= {bound}"));
        f.debug_list().entries(bounds.map(|bound| fmt::from_fn(move |f| f.write_str(&bound)))).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    type Points = BTreeSet<[i64; 4]>;

    /// The values over which the test enumerates points. No drawn bound excludes all of them.
    const VALUES: std::ops::RangeInclusive<i64> = -4..=4;

    fn all() -> impl Iterator<Item = [i64; 4]> {
        VALUES.flat_map(|a| VALUES.flat_map(move |b| VALUES.map(move |c| [0, a, b, c])))
    }

    /// A set in which all variables are within `VALUES` and some random bounds hold, with its points; `None` if no point is
    /// left.
    fn drawn(rng: &mut fastrand::Rng) -> Option<(Dbm, Points)> {
        let mut dbm = Dbm::zero();
        let mut points: Points = all().collect();
        for _ in 0..3 {
            let new = dbm.add();
            dbm.constrain(new, 0, *VALUES.end()).unwrap();
            dbm.constrain(0, new, -VALUES.start()).unwrap();
        }
        for _ in 0..rng.usize(0..7) {
            let (i, j, c) = (rng.usize(0..4), rng.usize(0..4), rng.i64(-3..6));
            if i == j {
                continue;
            }
            points.retain(|point| point[i] - point[j] <= c);
            let result = dbm.constrain(i, j, c);
            assert_eq!(result.is_err(), points.is_empty(), "x{i} - x{j} <= {c}");
            result.ok()?;
        }
        Some((dbm, points))
    }

    fn pairs(count: usize) -> impl Iterator<Item = ((Dbm, Points), (Dbm, Points))> {
        let mut rng = fastrand::Rng::with_seed(7);
        std::iter::repeat_with(move || drawn(&mut rng).zip(drawn(&mut rng))).flatten().take(count)
    }

    #[test]
    fn bounds_are_the_tightest_of_the_points() {
        for ((dbm, points), _) in pairs(2_000) {
            for (i, j) in (0..4).flat_map(|i| (0..4).map(move |j| (i, j))) {
                let most = points.iter().map(|point| point[i] - point[j]).max();
                assert_eq!(dbm.bound(i, j), most, "{dbm:?}");
                let [least, most] = [-dbm.bound(j, i).unwrap(), most.unwrap()];
                assert_eq!(dbm.difference(i, j), (least == most).then_some(most));
                for c in -9..9 {
                    assert_eq!(dbm.entails(i, j, c), points.iter().all(|point| point[i] - point[j] <= c));
                    assert_eq!(dbm.intersects(i, j, c), points.iter().any(|point| point[i] - point[j] <= c));
                }
            }
            assert!(all().all(|point| dbm.has(&point) == points.contains(&point)));
            assert!(dbm.has(&dbm.point()));
        }
    }

    #[test]
    fn a_projection_has_the_values_of_its_terms() {
        let mut rng = fastrand::Rng::with_seed(8);
        for ((dbm, points), _) in pairs(1_000) {
            let mut term = || (rng.usize(0..4), rng.i64(-3..4));
            let terms = [term(), term(), term()];
            let projected = dbm.project(&terms);
            let value = |point: &[i64; 4], (variable, offset): (usize, i64)| point[variable] + offset;
            let values = |point| terms.map(|term| value(point, term) - value(point, terms[0]));
            let shadows: BTreeSet<[i64; 3]> = points.iter().map(values).collect();
            let near = (-15..15).flat_map(|a| (-15..15).map(move |b| [0, a, b]));
            assert!(
                near.into_iter().all(|point| projected.has(&point) == shadows.contains(&point)),
                "{dbm:?}"
            );
        }
    }

    #[test]
    fn inclusion_and_hull_are_those_of_the_points() {
        for ((one, mine), (other, others)) in pairs(3_000) {
            assert_eq!(one.is_in(&other), mine.is_subset(&others));
            let hull = one.hull(&other);
            assert!(one.is_in(&hull) && other.is_in(&hull));
            for (i, j) in (0..4).flat_map(|i| (0..4).map(move |j| (i, j))) {
                let most = mine.union(&others).map(|point| point[i] - point[j]).max();
                assert_eq!(hull.bound(i, j), most);
            }
        }
    }

    #[test]
    fn two_sets_merge_exactly_if_no_other_point_comes_in() {
        let (mut merges, mut stay) = (0, 0);
        for ((one, mine), (other, others)) in pairs(6_000) {
            let hull = one.hull(&other);
            let is_exact =
                all().all(|point| !hull.has(&point) || mine.contains(&point) || others.contains(&point));
            assert_eq!(one.merged(&other), is_exact.then_some(hull), "{one:?}\n{other:?}");
            let nested = one.is_in(&other) || other.is_in(&one);
            merges += usize::from(is_exact && !nested);
            stay += usize::from(!is_exact);
        }
        assert!(merges > 50 && stay > 50, "{merges} merge, {stay} stay");
    }

    #[test]
    fn the_points_within_another_set_are_those_with_its_first_values() {
        let mut rng = fastrand::Rng::with_seed(9);
        let mut empty = 0;
        for ((one, mine), (other, _)) in pairs(1_000) {
            let first = other.project(&[(0, 0), (1, 0), (2, 0)]);
            let is_in = |point: &&[i64; 4]| first.has(&point[..3]);
            let within: Points = mine.iter().filter(is_in).copied().collect();
            match one.within(&first) {
                Ok(both) => assert!(all().all(|point| both.has(&point) == within.contains(&point))),
                Err(Empty) => assert!(within.is_empty()),
            }
            empty += usize::from(within.is_empty());
            let point = [0, rng.i64(-1..3), rng.i64(-1..3), 0];
            let is_like = |p: &&[i64; 4]| p[1] == point[1] && p[2] == point[2] && p[3] <= 0;
            assert_eq!(one.reaches(&point, &[3]), mine.iter().any(|p| is_like(&p)), "{one:?} {point:?}");
        }
        assert!(empty > 10, "{empty}");
    }

    #[test]
    fn a_bound_beyond_the_limit_becomes_weaker() {
        let mut dbm = Dbm::zero();
        let new = dbm.add();
        dbm.constrain(0, new, -3 * FAR).unwrap();
        assert!(dbm.is_weakened() && dbm.bound(0, new) == Some(-FAR) && dbm.bound(new, 0).is_none());
    }

    #[test]
    fn a_new_variable_has_no_bounds() {
        let mut dbm = Dbm::zero();
        let new = dbm.add();
        assert_eq!((dbm.bound(new, 0), dbm.bound(0, new), dbm.bound(new, new)), (None, None, Some(0)));
        assert!(dbm.intersects(new, 0, -1_000) && !dbm.entails(new, 0, 1_000));
        assert_eq!(dbm.constrain(new, 0, 5), Ok(()));
        assert_eq!(dbm.constrain(0, new, -6), Err(Empty));
        assert_eq!(dbm.point(), [0, 5]);
    }
}
