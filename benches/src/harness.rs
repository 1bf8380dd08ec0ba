//! Measures in rounds: every case once, then every case again. A ratio compares two cases of one round, so that other load on
//! the machine affects both. The result is the median of the rounds' ratios.

use crate::sample::Sample;
use crate::suite::{Against, Case, Effort, Goal, Row, Stat, Suite};

/// The results of one case.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Measured {
    /// The name of the case.
    pub name: String,
    /// What it measures.
    pub about: &'static str,
    /// One sample a round.
    pub rounds: Vec<Sample>,
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
        let values: Option<Vec<f64>> = self.rounds.iter().map(|sample| stat.of(sample)).collect();
        Spread::of(values?)
    }
}

/// The median of some numbers, and their range.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Spread {
    /// The median.
    pub median: f64,
    /// The least.
    pub least: f64,
    /// The greatest.
    pub most: f64,
}

impl Spread {
    /// The spread of these numbers; none if there are none.
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

/// The result of a row.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The row.
    pub row: Row,
    /// The ratios of the rounds; `None` if one of the two cases was not measured.
    pub ratio: Option<Spread>,
}

impl Outcome {
    /// Whether the goal is met; `None` if it was not measured.
    #[must_use]
    pub fn met(&self, slack: f64) -> Option<bool> {
        self.ratio.map(|ratio| self.row.goal.met(ratio.median, slack))
    }
}

/// The results of a suite.
#[derive(Clone, Debug)]
pub struct Results {
    /// Its name.
    pub suite: &'static str,
    /// Its cases.
    pub cases: Vec<Measured>,
    /// Its rows.
    pub rows: Vec<Outcome>,
}

/// Measures a suite in `rounds` rounds. Calls `tell` before each measurement of a case.
pub fn measure(
    suite: Suite,
    rounds: u32,
    effort: Effort,
    mut tell: impl FnMut(&'static str, u32, &str),
) -> Results {
    let Suite { name, cases, rows } = suite;
    let mut measured: Vec<Measured> = cases
        .iter()
        .map(|case| Measured { name: case.name.clone(), about: case.about, rounds: Vec::new() })
        .collect();
    for round in 0..rounds {
        for (Case { name: case, run, .. }, measured) in cases.iter().zip(&mut measured) {
            tell(name, round, case);
            measured.rounds.push(run(effort));
        }
    }
    let rows = rows.into_iter().map(|row| Outcome { ratio: ratio(&row, &measured), row }).collect();
    Results { suite: name, cases: measured, rows }
}

fn ratio(row: &Row, measured: &[Measured]) -> Option<Spread> {
    let named = |name: &str| measured.iter().find(|measured| measured.name == name);
    let subject = named(&row.subject)?;
    let other = match &row.against {
        Against::Case(name) => named(name)?,
        Against::Itself(_) | Against::Nothing => subject,
    };
    let rounds = subject.rounds.iter().zip(&other.rounds);
    let ratios: Option<Vec<f64>> = rounds.map(|(subject, other)| of_round(row, subject, other)).collect();
    Spread::of(ratios?)
}

fn of_round(row: &Row, subject: &Sample, other: &Sample) -> Option<f64> {
    let value = row.stat.of(subject)?;
    match (&row.against, row.goal) {
        (Against::Nothing, Goal::AtMost(_) | Goal::AtLeast(_)) => Some(value),
        (Against::Case(_), goal) => goal.ratio(value, row.stat.of(other)?),
        (Against::Itself(stat), goal) => goal.ratio(value, stat.of(other)?),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::{Cell, RefCell};
    use std::rc::Rc;

    fn suite(order: &Rc<RefCell<Vec<char>>>) -> Suite {
        let mut suite = Suite::new("test");
        // `b` takes twice the time of `a` in every round, although the machine gets slower.
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
        let results = measure(suite(&order), 3, Effort::FULL, |_, _, _| {});
        assert_eq!(order.borrow().iter().collect::<String>(), "ababab");
        let same = Some(Spread { median: 2.0, least: 2.0, most: 2.0 });
        assert_eq!((results.rows[0].ratio, results.rows[0].met(1.0)), (same, Some(true)));
        assert_eq!((results.rows[1].ratio, results.rows[1].met(1.0)), (same, Some(false)));
        assert_eq!(results.rows[1].met(1.3), Some(true), "with slack");
        assert_eq!(results.rows[2].met(1.0), None, "not measured");
        assert_eq!(results.rows[3].met(1.0), None, "nobody counted");
        assert_eq!(results.cases[0].median(Stat::Mean), Some(9.0));
    }

    #[test]
    fn the_middle_of_an_even_number_lies_between() {
        assert_eq!(Spread::of(vec![4.0, 1.0]).map(|s| s.median), Some(2.5));
        assert_eq!(Spread::of(Vec::new()), None);
    }
}
