//! How a set grows, and the set to which it would grow.

use super::Dbm;

impl Dbm {
    /// Whether each bound changed from `second` to this set by as much as it changed from `first` to `second`.
    pub fn grows_on(&self, second: &Self, first: &Self) -> bool {
        let by = |now: i32, before: i32| i64::from(now) - i64::from(before);
        let bounds = self.bounds.iter().zip(&*second.bounds).zip(&*first.bounds);
        self.len == first.len
            && bounds.into_iter().all(|((&now, &second), &first)| by(now, second) == by(second, first))
    }

    /// The set that this one becomes if each bound grows on by as much as it grew since `before`, for as long as the order of any
    /// two variables that is certain now stays certain. `before` must be a subset. `None` if the set grows in this way for
    /// fewer than two steps, or without end, or if the bounds that grow follow from the others.
    pub fn ahead(&self, before: &Self) -> Option<Self> {
        let growth = || self.bounds().filter_map(|(i, j, now)| Some((i, j, now, now - before.bound(i, j)?)));
        // `x_i - x_j <= c` with a negative `c` says that `x_j` is surely greater.
        let steps = growth().filter(|&(.., now, by)| now < 0 && by > 0).map(|(.., now, by)| -now / by);
        let steps = steps.min().filter(|steps| *steps > 1)?;
        let ahead = Self::with(self.len, growth().map(|(i, j, now, by)| (i, j, now + by * steps)));
        (ahead != *self).then_some(ahead)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The set of a heartbeat that comes within 20, and an action that ends between `least` and 3000, and never before the
    /// heartbeat.
    fn beside_a_heartbeat(least: i64) -> Dbm {
        let mut zone = Dbm::zero();
        for (least, most) in [(0, 20), (least, 3000)] {
            let new = zone.add();
            zone.constrain(0, new, -least).unwrap();
            zone.constrain(new, 0, most).unwrap();
        }
        zone
    }

    #[test]
    fn a_set_that_grew_steadily_grows_on_until_an_order_becomes_open() {
        let zones: Vec<Dbm> = (0..=100).map(|k| beside_a_heartbeat(990 - 10 * k)).collect();
        assert!(zones[2].grows_on(&zones[1], &zones[0]) && !zones[3].grows_on(&zones[1], &zones[0]));
        // The heartbeat surely comes first as long as the action ends after 20.
        assert_eq!(zones[2].ahead(&zones[1]), Some(zones[97].clone()));
        assert_eq!(zones[2].ahead(&zones[0]), Some(zones[96].clone()), "by 20 each");
        assert_eq!(zones[96].ahead(&zones[95]), None, "one step is left");
        assert_eq!(zones[2].ahead(&zones[2]), None, "it does not grow");
    }

    #[test]
    fn a_set_ahead_is_closed_and_has_all_points() {
        let mut rng = fastrand::Rng::with_seed(3);
        let mut found = 0;
        for _ in 0..20_000 {
            let mut zone = Dbm::zero();
            for _ in 0..3 {
                zone.add();
            }
            for _ in 0..8 {
                let (i, j) = (rng.usize(0..4), rng.usize(0..4));
                if i != j {
                    let _ = zone.constrain(i, j, rng.i64(-40..30));
                }
            }
            let mut before = zone.clone();
            if before.constrain(rng.usize(0..4), 0, rng.i64(-20..20)).is_err() {
                continue;
            }
            let Some(ahead) = zone.ahead(&before) else { continue };
            found += 1;
            assert!(zone.is_in(&ahead) && zone != ahead, "{zone:?} {before:?} {ahead:?}");
            assert_eq!(Dbm::with(4, ahead.bounds()), ahead);
        }
        assert!(found > 200, "{found}");
    }
}
