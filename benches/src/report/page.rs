//! Writes the tables in `specs/performance.md` and `specs/duel.md`, each between two marks. Do not edit these parts by
//! hand.

use super::{place, ratio, unit, verdict};
use crate::cases::floors::LINE;
use crate::harness::Results;
use crate::machine::Facts;
use crate::suite::Stat;
use std::fmt::Write;
use std::io;
use std::path::{Path, PathBuf};

const BEGIN: &str = "<!-- measured: begin -->";
const END: &str = "<!-- measured: end -->";

/// Why the page with the table was not updated.
#[derive(Debug, thiserror::Error)]
pub enum PageError {
    /// The page cannot be read or written.
    #[error("cannot renew {path}: {source}")]
    File {
        /// The path of the page.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The page has no marks for the table.
    #[error("{0} has no lines `{BEGIN}` and `{END}`")]
    NoMarks(PathBuf),
}

/// Replaces the table in the page by the rows of these suites.
///
/// # Errors
/// [`PageError`].
pub fn renew(path: &Path, facts: &Facts, rounds: u32, slack: f64, all: &[Results]) -> Result<(), PageError> {
    renew_page(path, &table(facts, rounds, slack, all))
}

/// Replaces the text between the marks of a page.
///
/// # Errors
/// [`PageError`].
pub fn renew_page(path: &Path, text: &str) -> Result<(), PageError> {
    let failed = |source| PageError::File { path: path.into(), source };
    let page = std::fs::read_to_string(path).map_err(failed)?;
    let renewed = between(&page, text);
    let renewed = renewed.ok_or_else(|| PageError::NoMarks(path.into()))?;
    std::fs::write(path, renewed).map_err(failed)
}

fn between(page: &str, table: &str) -> Option<String> {
    let (before, rest) = page.split_once(BEGIN)?;
    let (_, after) = rest.split_once(END)?;
    Some(format!("{before}{BEGIN}\n{table}{END}{after}"))
}

fn table(facts: &Facts, rounds: u32, slack: f64, all: &[Results]) -> String {
    let mut text = format!("Measured {}; {rounds} rounds.{}\n\n", facts.line(), lines(all));
    text +=
        "| goal | what | of | first bound | bound | measured: median (range) | | processors, rounds | |\n";
    text += "|---|---|---|---|---|---|---|---|---|\n";
    for outcome in all.iter().flat_map(|results| &results.rows) {
        let row = &outcome.row;
        let (bound, measured) = (row.goal.to_string(), ratio(outcome));
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {bound} | {measured} | {} | {} | {} |",
            row.id,
            row.what,
            row.stat.name(),
            row.was.unwrap_or_default(),
            unit(outcome),
            place(outcome),
            verdict(outcome, slack)
        );
    }
    text
}

/// How long a cache line takes between the two cores, on which most rows of two cores depend.
fn lines(all: &[Results]) -> String {
    let line = |results: &Results| {
        let case = results.cases.iter().find(|case| case.name == LINE)?;
        let spread = case.spread(Stat::P50)?;
        let [median, least, most] = [spread.median, spread.least, spread.most].map(super::time);
        Some(format!("{}: {median} ({least} to {most})", results.suite))
    };
    let told: Vec<_> = all.iter().filter_map(line).collect();
    if told.is_empty() {
        return String::new();
    }
    format!("\nA line of the cache from one core to the other and back, by suite: {}.", told.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_stands_between_the_marks_is_replaced() {
        let page = format!("before\n{BEGIN}\nold\n{END}\nafter\n");
        let renewed = between(&page, "new\n").expect("marks");
        assert_eq!(renewed, format!("before\n{BEGIN}\nnew\n{END}\nafter\n"));
        assert_eq!(between("no marks", "new\n"), None);
    }
}
