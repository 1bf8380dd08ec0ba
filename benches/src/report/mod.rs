//! Reports of the results: text, JSON, a page and a picture.

mod json;
mod page;
mod svg;
mod text;

pub use json::json;
pub use page::{PageError, renew, renew_page};
pub use svg::plot;
pub use text::{cases, rows};

use crate::judge::Outcome;
use crate::suite::{Against, Goal};

/// A row's ratio with its spread, as text for tables.
pub(crate) fn ratio(outcome: &Outcome) -> String {
    let Some(ratio) = outcome.ratio else { return "not measured".into() };
    let (median, least, most) = (short(ratio.median), short(ratio.least), short(ratio.most));
    format!("{median} ({least} to {most})")
}

/// The unit of the number that is compared with the bound.
pub(crate) fn unit(outcome: &Outcome) -> &'static str {
    match (&outcome.row.against, outcome.row.goal) {
        (Against::Nothing, _) => "the number itself",
        (Against::Above(..), _) => "nanoseconds more",
        (_, Goal::AtMost(_)) => "times its time",
        (_, Goal::AtLeast(_)) => "times faster",
    }
}

/// The verdict on a row in one or two words.
pub(crate) fn verdict(outcome: &Outcome, slack: f64) -> String {
    match (outcome.undecided, outcome.met(slack)) {
        (Some(why), _) => format!("not decided: {}", why.text()),
        (None, Some(true)) => "met".into(),
        (None, Some(false)) => "NOT MET".into(),
        (None, None) => "not measured".into(),
    }
}

/// For a row that compares cases on two processors: how far apart the processors were, and in how many rounds.
pub(crate) fn place(outcome: &Outcome) -> String {
    outcome.apart.map_or_else(String::new, |apart| format!("{}, {}", apart.name(), outcome.rounds))
}

/// A number with about three significant digits.
pub(crate) fn short(value: f64) -> String {
    match value.abs() {
        size if size >= 100.0 => format!("{value:.0}"),
        size if size >= 10.0 => format!("{value:.1}"),
        size if size >= 0.1 || size == 0.0 => format!("{value:.2}"),
        _ => format!("{value:.4}"),
    }
}

/// A time as text, in the most readable unit.
pub(crate) fn time(nanos: f64) -> String {
    match nanos {
        n if n >= 1e6 => format!("{} ms", short(n / 1e6)),
        n if n >= 1e3 => format!("{} us", short(n / 1e3)),
        n => format!("{} ns", short(n)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        let found = [0.0, 0.0123, 0.5, 12.34, 1_234.5].map(short);
        assert_eq!(found, ["0.00", "0.0123", "0.50", "12.3", "1234"]);
        assert_eq!([9.0, 2_500.0, 4e6].map(time), ["9.00 ns", "2.50 us", "4.00 ms"]);
    }
}
