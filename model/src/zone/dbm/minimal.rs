//! Keeps zones in few bytes: of each zone only the bounds that do not follow from others.

use super::bounds::Bounds;
use super::{Dbm, held};

/// A bound `c` with `x_i - x_j <= c`: `i`, `j` and `c`.
pub(super) type Bound = (usize, usize, i64);

/// The greatest bound of a zone that is kept without the bounds that follow from others. Sums of such bounds along a path
/// through all variables stay far below the greatest difference that a matrix can describe, so no order of additions
/// weakens a bound.
const MOST: i64 = 1 << 22;

/// The forms of a kept zone, its second byte: which bounds it has, and the bytes of each.
const SHORT: u8 = 2;
const LONG: u8 = 4;
const ALL: u8 = 5;

/// Zones that no longer change, one after another in one buffer.
///
/// A search keeps most zones only to make the path to a finding again. Of the bounds of a zone with 14 variables, about 14
/// do not follow from others (Larsen, Larsson, Pettersson and Yi, 1997), and with ticks of a millisecond most fit into 16
/// bits.
#[derive(Default)]
pub(crate) struct KeptZones {
    bytes: Vec<u8>,
}

impl KeptZones {
    /// Keeps a zone. Returns its place.
    pub fn keep(&mut self, zone: &Dbm) -> usize {
        let at = self.bytes.len();
        let len = zone.len();
        let is_near = zone.bounds().all(|(.., bound)| bound.abs() <= MOST);
        let kept: Vec<Bound> = if is_near { minimal(zone) } else { zone.bounds().collect() };
        let is_short = kept.iter().all(|&(.., bound)| i16::try_from(bound).is_ok());
        let form = match (is_near, is_short) {
            (false, _) => ALL,
            (true, true) => SHORT,
            (true, false) => LONG,
        };
        // A matrix has at most 256 variables, because a variable is a byte.
        let count = u16::try_from(kept.len()).expect("fewer than 2^16 bounds");
        self.bytes.extend([u8::try_from(len - 1).expect("at most 256 variables"), form]);
        self.bytes.extend(count.to_le_bytes());
        for (i, j, bound) in kept {
            self.bytes.extend([i, j].map(|variable| u8::try_from(variable).expect("at most 256 variables")));
            let bound = i32::try_from(bound).expect("a bound of a matrix").to_le_bytes();
            self.bytes.extend(&bound[..if form == SHORT { 2 } else { 4 }]);
        }
        at
    }

    /// The zone at a place that [`keep`](Self::keep) returned.
    pub fn zone(&self, at: usize) -> Dbm {
        let bytes = &self.bytes[at..];
        let count = usize::from(u16::from_le_bytes([bytes[2], bytes[3]]));
        let width = if bytes[1] == SHORT { 2 } else { 4 };
        let bounds = bytes[4..].chunks_exact(2 + width).take(count).map(|bound| {
            let value = match bound[2..] {
                [a, b] => i16::from_le_bytes([a, b]).into(),
                [a, b, c, d] => i32::from_le_bytes([a, b, c, d]).into(),
                _ => unreachable!("a bound has two or four bytes"),
            };
            (usize::from(bound[0]), usize::from(bound[1]), value)
        });
        let len = usize::from(bytes[0]) + 1;
        if bytes[1] == ALL { Dbm::with_all(len, bounds) } else { Dbm::with(len, bounds) }
    }
}

impl Dbm {
    /// The set of the points over `len` variables with these bounds. At least one point must have them.
    pub(super) fn with(len: usize, bounds: impl Iterator<Item = Bound>) -> Self {
        let mut dbm = Self { len, bounds: Bounds::of(len, std::iter::empty()) };
        bounds.for_each(|(i, j, c)| dbm.constrain(i, j, c).expect("some point is left"));
        dbm
    }

    /// The matrix with these bounds, which must be all bounds of a matrix ([`bounds`](Self::bounds)).
    fn with_all(len: usize, bounds: impl Iterator<Item = Bound>) -> Self {
        Self { len, bounds: Bounds::of(len, bounds.map(|(i, j, c)| (i * len + j, held(c)))) }
    }

    /// All bounds on differences of two variables.
    pub(super) fn bounds(&self) -> impl Iterator<Item = Bound> {
        let pairs = (0..self.len).flat_map(|i| (0..self.len).map(move |j| (i, j)));
        pairs.filter(|(i, j)| i != j).filter_map(|(i, j)| Some((i, j, self.bound(i, j)?)))
    }
}

/// The bounds of a zone from which all others follow.
///
/// Variables at a fixed distance form a class, of which the first one stands for all. Between the first variables of two
/// classes, a bound follows from others if a path over a third class is no longer.
fn minimal(zone: &Dbm) -> Vec<Bound> {
    let mut kept = Vec::new();
    let mut firsts: Vec<usize> = Vec::new();
    for i in 0..zone.len() {
        let fixed = firsts.iter().find_map(|&first| Some((first, zone.difference(i, first)?)));
        match fixed {
            Some((first, apart)) => kept.extend([(i, first, apart), (first, i, -apart)]),
            None => firsts.push(i),
        }
    }
    for (&i, &j) in firsts.iter().flat_map(|i| firsts.iter().map(move |j| (i, j))).filter(|(i, j)| i != j) {
        let Some(bound) = zone.bound(i, j) else { continue };
        let over = |k: usize| Some(zone.bound(i, k)? + zone.bound(k, j)?);
        let others = firsts.iter().filter(|&&k| k != i && k != j);
        if !others.into_iter().any(|&k| over(k).is_some_and(|path| path <= bound)) {
            kept.push((i, j, bound));
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A zone of some variables, with random bounds that differ by at most about `spread`.
    fn drawn(rng: &mut fastrand::Rng, spread: i64) -> Dbm {
        let mut zone = Dbm::zero();
        for _ in 0..rng.usize(0..9) {
            zone.add();
        }
        for _ in 0..rng.usize(0..30) {
            let (i, j) = (rng.usize(0..zone.len()), rng.usize(0..zone.len()));
            let bound = rng.i64(-spread / 4..spread);
            if i != j && zone.constrain(i, j, bound).is_ok() && rng.u8(0..4) == 0 {
                // Some variables stay at a fixed distance from each other.
                let _ = zone.constrain(j, i, -bound);
            }
        }
        zone
    }

    #[test]
    fn a_kept_zone_has_all_bounds_of_the_zone() {
        let mut rng = fastrand::Rng::with_seed(11);
        let (mut kept, mut all, mut fixed) = (KeptZones::default(), Vec::new(), 0);
        // With nine variables, the sums of the greatest bounds stay below the greatest difference.
        for spread in [40, 1 << 14, 1 << 17, MOST, 4 * MOST, 1 << 27] {
            for _ in 0..2_000 {
                let zone = drawn(&mut rng, spread);
                fixed += usize::from((1..zone.len()).any(|i| zone.difference(i, 0).is_some()));
                all.push((kept.keep(&zone), zone));
            }
        }
        for (at, zone) in &all {
            assert!(kept.zone(*at) == *zone, "{zone:?} became {:?}", kept.zone(*at));
        }
        assert!(fixed > 1_000, "{fixed} zones with a fixed variable");
    }

    #[test]
    fn no_kept_bound_follows_from_the_others() {
        let mut rng = fastrand::Rng::with_seed(12);
        let mut dropped = 0;
        for _ in 0..2_000 {
            let zone = drawn(&mut rng, 40);
            let bounds = minimal(&zone);
            dropped += zone.bounds().count() - bounds.len();
            for left_out in 0..bounds.len() {
                let others = bounds.iter().enumerate().filter(|&(at, _)| at != left_out);
                assert!(Dbm::with(zone.len(), others.map(|(_, &bound)| bound)) != zone, "{zone:?}");
            }
        }
        assert!(dropped > 1_000, "{dropped}");
    }
}
