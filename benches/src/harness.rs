//! Measures in rounds: each round runs every case once. A ratio compares two cases of one round, so that other load on
//! the machine affects both. The result is the median of the rounds' ratios.
//!
//! The result of a case on two processors depends on their distance: two threads of one core share a cache, two cores
//! do not. A round of such a case counts only if the distance was the same before and after it.
//!
//! A row is decided only if its rounds agree ([`judge`](crate::judge)). Otherwise the row is measured again, at most
//! [`AGAIN`] times.

use crate::judge::{Outcome, judge};
use crate::sample::Sample;
use crate::suite::{Case, Effort, Row, Stat, Suite};
use crate::surroundings::{Apart, Surroundings};

/// How many times the rows that are not decided are measured again, at most.
pub const AGAIN: u32 = 2;
/// How many times a case on two processors is tried in a round, at most, until their distance is the same before and
/// after it.
pub const TRIES: u32 = 3;

/// One round of one case.
#[derive(Clone, Copy, Debug, Default, serde::Serialize)]
pub struct Round {
    /// The measured values.
    #[serde(flatten)]
    pub sample: Sample,
    /// How far apart the two processors were during the whole round. `None` if the case runs on one processor, or if
    /// the distance changed in every attempt.
    pub apart: Option<Apart>,
    /// The share of the processors that other programs took during the round, 0 to 1.
    pub others: f64,
}

/// The results of one case.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Measured {
    /// The name of the case.
    pub name: String,
    /// What the case measures.
    pub about: &'static str,
    /// Whether threads of the case run on two processors at once.
    pub on_two: bool,
    /// All rounds. If the case was measured again, only the rounds of the last measurement.
    pub rounds: Vec<Round>,
}

impl Measured {
    /// The median of one statistic over the rounds.
    #[must_use]
    pub fn median(&self, stat: Stat) -> Option<f64> {
        self.spread(stat).map(|spread| spread.median)
    }

    /// The median of one statistic over the rounds, with the least and the greatest value.
    #[must_use]
    pub fn spread(&self, stat: Stat) -> Option<Spread> {
        let values: Option<Vec<f64>> = self.rounds.iter().map(|round| stat.of(&round.sample)).collect();
        Spread::of(values?)
    }
}

/// The median of some numbers, with the least and the greatest of them.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Spread {
    /// The median of the numbers.
    pub median: f64,
    /// The least of the numbers.
    pub least: f64,
    /// The greatest of the numbers.
    pub most: f64,
}

impl Spread {
    /// The spread of these numbers; `None` if there are none.
    #[must_use]
    pub fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_unstable_by(f64::total_cmp);
        let (least, most) = (*values.first()?, *values.last()?);
        let middle = values.len() / 2;
        let median = if values.len() % 2 == 1 {
            values[middle]
        } else {
            f64::midpoint(values[middle - 1], values[middle])
        };
        Some(Self { median, least, most })
    }
}

/// The results of a suite.
#[derive(Clone, Debug)]
pub struct Results {
    /// The suite's name.
    pub suite: &'static str,
    /// The results of the suite's cases.
    pub cases: Vec<Measured>,
    /// The outcomes of the suite's goals.
    pub rows: Vec<Outcome>,
}

/// Measures a suite in `rounds` rounds, and then measures the cases of undecided rows again. Calls `tell` before each
/// measurement of a case.
pub fn measure(
    suite: Suite,
    rounds: u32,
    effort: Effort,
    here: &mut impl Surroundings,
    mut tell: impl FnMut(&'static str, u32, &str),
) -> Results {
    let Suite { name, cases, rows } = suite;
    let mut measured: Vec<Measured> = cases
        .iter()
        .map(|case| Measured {
            name: case.name.clone(),
            about: case.about,
            on_two: case.on_two,
            rounds: Vec::new(),
        })
        .collect();
    let mut open: Vec<Option<Outcome>> = rows.iter().map(|_| None).collect();
    for again in 0..=AGAIN {
        let left = |(row, outcome): (&Row, &Option<Outcome>)| {
            let decided = outcome.as_ref().is_some_and(|outcome| outcome.undecided.is_none());
            (!decided).then(|| row.clone())
        };
        let left: Vec<Row> = rows.iter().zip(&open).filter_map(left).collect();
        if again > 0 && left.is_empty() {
            break;
        }
        let wanted = |case: &Case| again == 0 || left.iter().any(|row| row.has(&case.name));
        let mut turn: Vec<_> = cases.iter().zip(&mut measured).filter(|(case, _)| wanted(case)).collect();
        turn.iter_mut().for_each(|(_, measured)| measured.rounds.clear());
        for round in 0..rounds {
            one_round(&mut turn, effort, here, |case| tell(name, round, case));
        }
        for (row, outcome) in rows.iter().zip(&mut open) {
            if outcome.as_ref().is_none_or(|outcome| outcome.undecided.is_some()) {
                *outcome = Some(judge(row, &measured, again));
            }
        }
    }
    Results { suite: name, cases: measured, rows: open.into_iter().flatten().collect() }
}

fn one_round(
    turn: &mut [(&Case, &mut Measured)],
    effort: Effort,
    here: &mut impl Surroundings,
    mut tell: impl FnMut(&str),
) {
    here.others();
    for (case, measured) in turn.iter_mut() {
        tell(&case.name);
        measured.rounds.push(once(case, effort, here));
    }
    let others = here.others();
    for round in turn.iter_mut().filter_map(|(_, measured)| measured.rounds.last_mut()) {
        round.others = others;
    }
}

/// Runs a case. A case on two processors runs again if their distance changed during the run.
fn once(case: &Case, effort: Effort, here: &mut impl Surroundings) -> Round {
    if !case.on_two {
        return Round { sample: (case.run)(effort), ..Round::default() };
    }
    let mut before = here.apart();
    let mut tries = 1;
    loop {
        let sample = (case.run)(effort);
        let after = here.apart();
        if before == after || tries == TRIES {
            return Round { sample, apart: before.filter(|_| before == after), others: 0.0 };
        }
        (before, tries) = (after, tries + 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::judge::Why;
    use crate::suite::Goal;
    use std::cell::{Cell, RefCell};
    use std::rc::Rc;

    /// A simulated machine on which no other program runs. The list has the distances of its two processors, in the
    /// order in which they are read.
    struct Given(Vec<Apart>);

    impl Surroundings for Given {
        fn apart(&mut self) -> Option<Apart> {
            if self.0.len() > 1 { Some(self.0.remove(0)) } else { self.0.first().copied() }
        }
        fn others(&mut self) -> f64 {
            0.0
        }
    }

    fn suite(order: &Rc<RefCell<Vec<char>>>) -> Suite {
        let mut suite = Suite::new("test");
        // Case `b` takes twice the time of case `a` in every round, although the machine gets slower.
        let noise = Rc::new(Cell::new(1.0));
        for (name, factor) in [("a", 1.0), ("b", 2.0)] {
            let (order, noise) = (Rc::clone(order), Rc::clone(&noise));
            suite.case(name, "", move |_| {
                order.borrow_mut().push(name.chars().next().expect("a letter"));
                if name == "a" {
                    noise.set(noise.get() * 3.0);
                }
                let mean = factor * noise.get();
                Sample { p50: mean, mean, ..Sample::default() }
            });
        }
        suite.row(Row::new("G1", "b", "a", Stat::Mean, Goal::AtMost(2.0)));
        suite.row(Row::new("G2", "a", "b", Stat::P50, Goal::AtLeast(2.1)));
        suite.row(Row::new("G3", "a", "missing", Stat::P50, Goal::AtLeast(2.1)));
        suite.row(Row::bounded("G4", "", "a", Stat::Count, Goal::AtMost(1.0)));
        suite
    }

    #[test]
    fn rounds_alternate_and_ratios_are_of_one_round() {
        let order = Rc::default();
        let results = measure(suite(&order), 3, Effort::FULL, &mut Given(Vec::new()), |_, _, _| {});
        assert_eq!(order.borrow().iter().collect::<String>(), "ababab");
        let same = Some(Spread { median: 2.0, least: 2.0, most: 2.0 });
        assert_eq!((results.rows[0].ratio, results.rows[0].met(1.0)), (same, Some(true)));
        assert_eq!((results.rows[1].ratio, results.rows[1].met(1.0)), (same, Some(false)));
        assert_eq!(results.rows[1].met(1.3), Some(true), "with slack");
        assert_eq!(results.rows[2].met(1.0), None, "not measured");
        assert_eq!(results.rows[3].met(1.0), None, "nobody counted");
        assert_eq!(results.cases[0].median(Stat::Mean), Some(9.0));
    }

    /// A suite of one case on two processors. The runs of the case take these times, one after the other. After the end
    /// of the list every run takes the last time.
    fn varies(times: &[f64]) -> (Suite, Rc<Cell<usize>>) {
        let (mut suite, ran) = (Suite::new("varies"), Rc::new(Cell::new(0)));
        let (times, counted) = (times.to_vec(), Rc::clone(&ran));
        suite.case("a", "", move |_| {
            let p50 = times[counted.get().min(times.len() - 1)];
            counted.set(counted.get() + 1);
            Sample { p50, ..Sample::default() }
        });
        suite.cases[0].on_two = true;
        suite.row(Row::bounded("G1", "", "a", Stat::P50, Goal::AtMost(10.0)));
        (suite, ran)
    }

    #[test]
    fn a_row_that_spans_a_factor_of_three_is_measured_again_and_in_the_end_not_decided() {
        let near = || Given(vec![Apart::Near]);
        let (suite, ran) = varies(&[4.0, 12.0, 8.0, 8.0, 8.5, 9.0]);
        let results = measure(suite, 3, Effort::FULL, &mut near(), |_, _, _| {});
        let row = &results.rows[0];
        assert_eq!((ran.get(), row.again, row.met(1.0)), (6, 1, Some(true)));
        assert_eq!(
            row.ratio.map(|ratio| (ratio.least, ratio.most)),
            Some((8.0, 9.0)),
            "the last rounds alone"
        );

        let (suite, ran) = varies(&[4.0, 12.0, 8.0, 4.0, 8.0, 16.0, 4.0, 4.0, 36.0, 4.0]);
        let results = measure(suite, 3, Effort::FULL, &mut near(), |_, _, _| {});
        let row = &results.rows[0];
        assert_eq!((ran.get(), row.again), (9, AGAIN));
        assert_eq!((row.undecided, row.met(1.0)), (Some(Why::Range), Some(false)), "no row is met by luck");
    }

    #[test]
    fn a_case_is_run_again_where_the_processors_moved_under_it() {
        use Apart::{Far, Near};
        let (suite, ran) = varies(&[7.0, 2.0]);
        let mut moves = Given(vec![Near, Far, Far, Far, Far, Far, Far]);
        let results = measure(suite, 3, Effort::FULL, &mut moves, |_, _, _| {});
        let row = &results.rows[0];
        assert_eq!((ran.get(), row.again), (4, 0));
        assert_eq!((row.apart, row.rounds, row.ratio.map(|ratio| ratio.most)), (Some(Far), 3, Some(2.0)));

        let (suite, ran) = varies(&[2.0]);
        let mut always = Given([Near, Far].repeat(100));
        let results = measure(suite, 2, Effort::FULL, &mut always, |_, _, _| {});
        assert_eq!(ran.get() as u32, 2 * TRIES * (1 + AGAIN));
        assert_eq!((results.rows[0].undecided, results.rows[0].ratio), (Some(Why::Processors), None));
    }

    #[test]
    fn the_middle_of_an_even_number_lies_between() {
        assert_eq!(Spread::of(vec![4.0, 1.0]).map(|s| s.median), Some(2.5));
        assert_eq!(Spread::of(Vec::new()), None);
    }
}
