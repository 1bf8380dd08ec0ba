//! The results as tables for a terminal.

use super::{place, ratio, time, unit, verdict};
use crate::harness::Results;
use crate::suite::Stat;

/// The rows of a suite: goal, ratio, verdict.
#[must_use]
pub fn rows(results: &Results, slack: f64) -> String {
    let header = ["goal", "what", "of", "bound", "measured: median (range)", "", "processors", "verdict"]
        .map(String::from);
    let of = |outcome: &crate::judge::Outcome| {
        let row = &outcome.row;
        let (bound, stat) = (row.goal.to_string(), row.stat.name().to_owned());
        let verdict = verdict(outcome, slack);
        [
            row.id.into(),
            row.what.clone(),
            stat,
            bound,
            ratio(outcome),
            unit(outcome).into(),
            place(outcome),
            verdict,
        ]
    };
    table(&std::iter::once(header).chain(results.rows.iter().map(of)).collect::<Vec<_>>())
}

/// The cases of a suite with their times, each a median over the rounds.
#[must_use]
pub fn cases(results: &Results) -> String {
    let header = ["case", "p50", "p99", "p99.9", "mean", "count"].map(String::from);
    let of = |case: &crate::harness::Measured| {
        let took = |stat| case.median(stat).filter(|nanos| *nanos > 0.0).map_or_else(String::new, time);
        let count = case.median(Stat::Count).map_or_else(String::new, super::short);
        [case.name.clone(), took(Stat::P50), took(Stat::P99), took(Stat::P999), took(Stat::Mean), count]
    };
    table(&std::iter::once(header).chain(results.cases.iter().map(of)).collect::<Vec<_>>())
}

fn table<const N: usize>(lines: &[[String; N]]) -> String {
    let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
    let widths: [usize; N] = std::array::from_fn(width);
    let line = |cells: &[String; N]| {
        let padded = cells.iter().zip(widths).map(|(cell, width)| format!("{cell:width$}"));
        padded.collect::<Vec<_>>().join("  ").trim_end().to_owned() + "\n"
    };
    lines.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    #[test]
    fn columns_stand_below_each_other() {
        let lines = [["a", "b"], ["long", "c"]].map(|line| line.map(String::from));
        assert_eq!(super::table(&lines), "a     b\nlong  c\n");
    }
}
