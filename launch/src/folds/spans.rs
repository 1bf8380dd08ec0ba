//! Sets of rounds, as ranges without gaps.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A set of rounds. Most rounds in it are successive, so a few ranges hold many rounds.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "Vec<(i64, i64)>", into = "Vec<(i64, i64)>")]
pub struct Spans(BTreeMap<i64, i64>);

impl From<Vec<(i64, i64)>> for Spans {
    fn from(ranges: Vec<(i64, i64)>) -> Self {
        Self(ranges.into_iter().filter(|(first, last)| first <= last).collect())
    }
}

impl From<Spans> for Vec<(i64, i64)> {
    fn from(Spans(ranges): Spans) -> Self {
        ranges.into_iter().collect()
    }
}

impl Spans {
    /// Whether the set has this round.
    pub fn has(&self, round: i64) -> bool {
        self.0.range(..=round).next_back().is_some_and(|(_, &last)| round <= last)
    }

    /// Adds a round.
    pub fn add(&mut self, round: i64) {
        if self.has(round) {
            return;
        }
        let (mut first, mut last) = (round, round);
        if let Some((&before, &end)) = self.0.range(..round).next_back()
            && end + 1 == round
        {
            first = before;
        }
        if let Some(end) = self.0.remove(&(round + 1)) {
            last = end;
        }
        self.0.insert(first, last);
    }

    /// How many ranges the set has.
    pub fn pieces(&self) -> usize {
        self.0.len()
    }

    /// Adds the rounds between the oldest two ranges, so that they become one.
    pub fn close_oldest_gap(&mut self) {
        if let Some((first, _)) = self.0.pop_first()
            && let Some((_, last)) = self.0.pop_first()
        {
            self.0.insert(first, last);
        }
    }

    /// Removes this round and all earlier ones.
    pub fn forget(&mut self, upto: i64) {
        let rest = self.0.split_off(&(upto + 1));
        let end_of_rest = self.0.last_key_value().map(|(_, &last)| last).filter(|&last| last > upto);
        self.0 = rest;
        if let Some(last) = end_of_rest {
            self.0.insert(upto + 1, last);
        }
    }

    /// The lowest round and the highest one.
    pub fn ends(&self) -> Option<(i64, i64)> {
        Some((*self.0.first_key_value()?.0, *self.0.last_key_value()?.1))
    }

    /// The last round of the oldest range.
    pub fn end_of_the_oldest(&self) -> Option<i64> {
        self.0.first_key_value().map(|(_, &last)| last)
    }

    /// The ranges, each from its first round to its last one.
    pub fn ranges(&self) -> impl Iterator<Item = (i64, i64)> {
        self.0.iter().map(|(&first, &last)| (first, last))
    }

    /// Adds `by` to the number of each round.
    pub fn shifted(&self, by: i64) -> Self {
        let shifted = |(first, last): (i64, i64)| Some((first.checked_add(by)?, last.checked_add(by)?));
        Self(self.ranges().filter_map(shifted).collect())
    }

    /// How many rounds both sets have.
    pub fn common(&self, other: &Self) -> i64 {
        let both = |(first, last): (i64, i64)| {
            let of_other = other.0.range(..=last).rev().take_while(move |(_, end)| **end >= first);
            of_other.map(move |(&from, &to)| last.min(to) - first.max(from) + 1).sum::<i64>()
        };
        self.ranges().map(both).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_that_follow_each_other_are_one_range_in_whatever_order_they_come() {
        let mut set = Spans::default();
        for round in [5, 3, 4, 9, 3] {
            set.add(round);
        }
        assert_eq!(Vec::from(set.clone()), [(3, 5), (9, 9)]);
        assert!(set.has(4) && !set.has(6) && set.ends() == Some((3, 9)));
        set.close_oldest_gap();
        assert_eq!(Vec::from(set.clone()), [(3, 9)]);
        set.forget(6);
        assert_eq!(Vec::from(set.clone()), [(7, 9)]);
        assert_eq!(Vec::from(set.shifted(-10)), [(-3, -1)]);
    }

    #[test]
    fn what_two_sets_have_in_common_is_what_each_round_says() {
        let sets = [vec![(0, 3), (6, 6), (8, 20)], vec![(2, 6), (10, 11), (19, 30)], vec![], vec![(-4, 40)]];
        for one in &sets {
            for other in &sets {
                let (one, other) = (Spans::from(one.clone()), Spans::from(other.clone()));
                let counted = (-10..50).filter(|&round| one.has(round) && other.has(round)).count();
                assert_eq!(one.common(&other), counted as i64, "{one:?} {other:?}");
            }
        }
    }
}
