//! Judges a row by its rounds: which of the rounds count, which ratio they give, and whether they are enough for a decision.

use crate::harness::{Measured, Round, Spread};
use crate::sample::Sample;
use crate::suite::{Against, Goal, Row};
use crate::surroundings::Apart;

/// If some rounds of a row meet the bound and others do not, the row is decided only if the greatest ratio is less
/// than this many times the least.
pub const SPAN: f64 = 3.0;
/// A round is quiet if other programs took at most this share of the processors.
pub const QUIET: f64 = 0.05;

/// Why a row is not decided. It counts as not met.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Why {
    /// The distance of the two processors was not the same in more than half of the rounds.
    Processors,
    /// In half of the rounds or more, other programs took more than [`QUIET`].
    Busy,
    /// The ratios of the rounds differ by a factor of [`SPAN`] or more, and are not all on one side of the bound.
    Range,
}

impl Why {
    /// The reason in one or two words, for tables.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::Processors => "the processors moved",
            Self::Busy => "others ran",
            Self::Range => "its range",
        }
    }
}

/// The result of a row.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The row that was judged.
    pub row: Row,
    /// The ratios of the two cases, one for each round in which the processors had the distance that this row uses.
    /// `None` if a case was not measured, or if there was no such round.
    pub ratio: Option<Spread>,
    /// How far apart the two processors were in these rounds, if the row compares cases on two processors.
    pub apart: Option<Apart>,
    /// How many rounds gave the ratios.
    pub rounds: usize,
    /// How often the row was measured again.
    pub again: u32,
    /// Why the row is not decided. `None` if the row is decided, or was not measured.
    pub undecided: Option<Why>,
}

impl Outcome {
    /// Whether the goal is met. An undecided row does not meet its goal. `None` if the row was not measured.
    #[must_use]
    pub fn met(&self, slack: f64) -> Option<bool> {
        if self.undecided.is_some() {
            return Some(false);
        }
        self.ratio.map(|ratio| self.row.goal.met(ratio.median, slack))
    }
}

/// The outcome of a row. `again` says how many times it was measured again.
#[must_use]
pub fn judge(row: &Row, measured: &[Measured], again: u32) -> Outcome {
    let none = Outcome { row: row.clone(), ratio: None, apart: None, rounds: 0, again, undecided: None };
    let named = |name: &str| measured.iter().find(|measured| measured.name == name);
    let Some(subject) = named(&row.subject) else { return none };
    let Some(other) = row.other().map_or(Some(subject), named) else { return none };
    let mut pairs: Vec<Pair<'_>> = subject.rounds.iter().zip(&other.rounds).collect();
    // If a sample lacks the number that the row compares, the row is not measured, however far apart the processors were.
    if pairs.iter().any(|(subject, other)| ratio(row, &subject.sample, &other.sample).is_none()) {
        return none;
    }
    let all = pairs.len();
    let few = |left: &[Pair<'_>]| left.len() * 2 <= all;
    let mut outcome = none;
    if subject.on_two || other.on_two {
        let place = |pair: &Pair<'_>| place(*pair, subject.on_two, other.on_two);
        let of = |apart| pairs.iter().filter(|pair| place(pair) == Some(apart)).count();
        let most = if of(Apart::Far) > of(Apart::Near) { Apart::Far } else { Apart::Near };
        pairs.retain(|pair| place(pair) == Some(most));
        outcome.apart = (!pairs.is_empty()).then_some(most);
        outcome.undecided = few(&pairs).then_some(Why::Processors);
    }
    if row.quiet {
        pairs.retain(|(subject, other)| subject.others.max(other.others) <= QUIET);
        outcome.undecided = outcome.undecided.or(few(&pairs).then_some(Why::Busy));
    }
    outcome.rounds = pairs.len();
    let ratios = pairs.iter().filter_map(|(subject, other)| ratio(row, &subject.sample, &other.sample));
    outcome.ratio = Spread::of(ratios.collect());
    let wide = outcome.ratio.is_some_and(|ratio| is_wide(ratio) && !agree(row.goal, ratio));
    outcome.undecided = outcome.undecided.or(wide.then_some(Why::Range));
    outcome
}

type Pair<'a> = (&'a Round, &'a Round);

/// The distance of the processors that both cases of a round had. A case on one processor has no distance and needs none.
fn place((subject, other): Pair<'_>, subject_on_two: bool, other_on_two: bool) -> Option<Apart> {
    match (subject_on_two, other_on_two) {
        (true, true) => subject.apart.filter(|apart| other.apart == Some(*apart)),
        (true, false) => subject.apart,
        (false, _) => other.apart,
    }
}

/// Whether every round meets the goal, or none does.
fn agree(goal: Goal, ratio: Spread) -> bool {
    goal.met(ratio.least, 1.0) == goal.met(ratio.most, 1.0)
}

fn is_wide(ratio: Spread) -> bool {
    ratio.most > ratio.least && ratio.most >= SPAN * ratio.least
}

fn ratio(row: &Row, subject: &Sample, other: &Sample) -> Option<f64> {
    let value = row.stat.of(subject)?;
    match &row.against {
        Against::Nothing => Some(value),
        Against::Case(_) => {
            let [parts, others] = row.parts.map(f64::from);
            row.goal.ratio(value / parts, row.stat.of(other)? / others)
        }
        Against::Itself(stat) => row.goal.ratio(value, stat.of(other)?),
        Against::Above(_, steps) => Some((value - row.stat.of(other)?) / f64::from(*steps)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::suite::Stat;

    fn case(name: &str, on_two: bool, rounds: &[(f64, Option<Apart>, f64)]) -> Measured {
        let round =
            |&(p50, apart, others)| Round { sample: Sample { p50, ..Sample::default() }, apart, others };
        Measured { name: name.into(), about: "", on_two, rounds: rounds.iter().map(round).collect() }
    }

    const NEAR: Option<Apart> = Some(Apart::Near);
    const FAR: Option<Apart> = Some(Apart::Far);

    #[test]
    fn only_rounds_of_one_distance_are_compared_and_most_of_them_decide() {
        let row = Row::new("G", "a", "b", Stat::P50, Goal::AtMost(2.0));
        let a = case(
            "a",
            true,
            &[(9.0, NEAR, 0.0), (2.0, FAR, 0.0), (2.2, FAR, 0.0), (8.0, None, 0.0), (2.0, FAR, 0.0)],
        );
        let b = case(
            "b",
            true,
            &[(1.0, FAR, 0.0), (1.0, FAR, 0.0), (1.0, FAR, 0.0), (1.0, FAR, 0.0), (1.0, FAR, 0.0)],
        );
        let found = judge(&row, &[a.clone(), b], 0);
        assert_eq!((found.apart, found.rounds, found.undecided), (FAR, 3, None));
        assert_eq!((found.ratio.map(|ratio| ratio.median), found.met(1.0)), (Some(2.0), Some(true)));
        let b = case(
            "b",
            true,
            &[(1.0, NEAR, 0.0), (1.0, NEAR, 0.0), (1.0, FAR, 0.0), (1.0, FAR, 0.0), (1.0, FAR, 0.0)],
        );
        let found = judge(&row, &[a.clone(), b], 0);
        assert_eq!((found.rounds, found.undecided, found.met(1.0)), (2, Some(Why::Processors), Some(false)));
        let one = case("b", false, &[(1.0, None, 0.0); 5]);
        assert_eq!(
            judge(&row, &[a, one], 0).rounds,
            3,
            "a case on one processor is compared with each distance"
        );
    }

    #[test]
    fn a_row_of_the_tail_is_decided_by_quiet_rounds_alone() {
        let row = Row::bounded("G", "", "a", Stat::P50, Goal::AtMost(2.0)).when_quiet();
        let busy = QUIET * 2.0;
        let a = case("a", false, &[(9.0, None, busy), (1.0, None, QUIET), (1.5, None, 0.0)]);
        assert_eq!(judge(&row, &[a], 0).met(1.0), Some(true));
        let a = case("a", false, &[(1.0, None, busy), (1.0, None, busy), (1.0, None, 0.0)]);
        assert_eq!(judge(&row, &[a], 0).undecided, Some(Why::Busy));
    }

    #[test]
    fn what_is_above_another_case_is_shared_by_the_steps() {
        let row = Row::above("G", "", ["a", "b"], 5, Stat::P50, Goal::AtMost(20.0));
        let (a, b) = (case("a", false, &[(190.0, None, 0.0)]), case("b", false, &[(100.0, None, 0.0)]));
        let found = judge(&row, &[a, b], 0);
        assert_eq!((found.ratio.map(|ratio| ratio.median), found.met(1.0)), (Some(18.0), Some(true)));
    }

    #[test]
    fn a_row_for_each_part_divides_each_case_by_its_own_number_of_parts() {
        let row = |goal| Row::new("G", "a", "b", Stat::P50, goal).for_each("part", [20, 2]);
        let (a, b) = (case("a", false, &[(60.0, None, 0.0)]), case("b", false, &[(4.0, None, 0.0)]));
        let measured = [a, b];
        let found = |goal| judge(&row(goal), &measured, 0).ratio.map(|ratio| ratio.median);
        assert_eq!(found(Goal::AtMost(1.0)), Some(1.5));
        assert_eq!(found(Goal::AtLeast(1.0)), Some(2.0 / 3.0));
        assert_eq!(row(Goal::AtMost(1.0)).what, "a : b, for each part");
    }

    #[test]
    fn a_range_is_wide_from_a_factor_of_three_on() {
        let of = |least, most| is_wide(Spread { median: least, least, most });
        assert_eq!(
            [of(1.0, 2.9), of(1.0, 3.0), of(0.0, 0.0), of(0.0, 1.0), of(-1.0, 1.0)],
            [false, true, false, true, true]
        );
    }
    #[test]
    fn a_wide_range_on_one_side_of_the_bound_decides() {
        let judged = |least, most| {
            let row = Row::bounded("G", "a", "a", Stat::P50, Goal::AtMost(2.0));
            let rounds = [(least, None, 0.0), (most, None, 0.0), (most, None, 0.0)];
            let outcome = judge(&row, &[case("a", false, &rounds)], 0);
            (outcome.undecided, outcome.met(1.0))
        };
        assert_eq!(judged(0.0, 0.5), (None, Some(true)));
        assert_eq!(judged(3.0, 30.0), (None, Some(false)));
        assert_eq!(judged(0.5, 3.0), (Some(Why::Range), Some(false)));
    }
}
