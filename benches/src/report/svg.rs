//! Draws the rows as a picture: one bar for each row on a logarithmic scale, with 1 at the bound. A bar that ends
//! further left is better.

use super::{ratio, verdict};
use crate::harness::Results;
use crate::judge::Outcome;
use crate::machine::Facts;
use crate::suite::Goal;
use std::fmt::Write;

const WIDTH: f64 = 960.0;
const LABEL: f64 = 470.0;
const STEP: f64 = 22.0;
const TOP: f64 = 56.0;
/// How many powers of ten the scale has on either side of the bound: from a thousandth of it to a thousand times it.
const DECADES: f64 = 3.0;

/// The picture of all measured rows.
#[must_use]
pub fn plot(facts: &Facts, slack: f64, all: &[Results]) -> String {
    let rows: Vec<&Outcome> =
        all.iter().flat_map(|results| &results.rows).filter(|row| row.ratio.is_some()).collect();
    let height = TOP + STEP * rows.len() as f64 + 24.0;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" font-family=\"sans-serif\" \
         font-size=\"11\">\n<title>Measured ratios against their bounds</title>\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
    );
    let text = |x: f64, y: f64, words: &str, rest: &str| {
        format!("<text x=\"{x:.0}\" y=\"{y:.1}\"{rest}>{}</text>\n", escape(words))
    };
    svg += &text(8.0, 18.0, "Ratio to the bound of each goal (log scale; left of the line is better)", "");
    svg += &text(8.0, 34.0, &facts.line(), " fill=\"#666\"");
    let line = x_of(1.0);
    // Writing to a string does not fail.
    let _ = writeln!(
        svg,
        "<path d=\"M{line:.1} {:.0}V{height}\" stroke=\"#333\" stroke-dasharray=\"3 3\"/>",
        TOP - 8.0
    );
    for (at, outcome) in rows.into_iter().enumerate() {
        svg += &bar(outcome, slack, TOP + STEP * at as f64, &text);
    }
    svg + "</svg>\n"
}

fn bar(outcome: &Outcome, slack: f64, y: f64, text: &impl Fn(f64, f64, &str, &str) -> String) -> String {
    let Some(found) = outcome.ratio else { return String::new() };
    // The part of its bound that a row uses up. For both kinds of goals, 1 is exactly at the bound.
    let share = |value: f64| match outcome.row.goal {
        Goal::AtMost(bound) => value / bound,
        Goal::AtLeast(bound) => bound / value,
    };
    let ends = [share(found.least), share(found.most)].map(x_of);
    let (left, right) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
    let (met, middle) = (outcome.met(slack) == Some(true), x_of(share(found.median)));
    let colour = if met { "#2a7" } else { "#c33" };
    let words = format!("{} {}", outcome.row.id, outcome.row.what);
    let shape = if met { "M-4 4L0 -4L4 4Z" } else { "M-4 -4L4 4M4 -4L-4 4" };
    let value = format!("{} {} {}", ratio(outcome), outcome.row.goal, verdict(outcome, slack));
    format!(
        "<g><title>{}</title>{}<path d=\"M{left:.1} {cy:.1}H{right:.1}\" stroke=\"{colour}\" stroke-width=\"3\"/>\
         <path transform=\"translate({middle:.1} {cy:.1})\" d=\"{shape}\" fill=\"{colour}\" stroke=\"{colour}\" \
         stroke-width=\"1.5\"/></g>\n",
        escape(&value),
        text(8.0, y + 4.0, &words, "").trim_end(),
        cy = y,
    )
}

fn x_of(share: f64) -> f64 {
    let decades = share.max(1e-9).log10().clamp(-DECADES, DECADES);
    LABEL + (decades + DECADES) / (2.0 * DECADES) * (WIDTH - LABEL - 16.0)
}

fn escape(words: &str) -> String {
    words.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_has_its_middle_at_the_bound() {
        assert!((x_of(1.0) - (x_of(1e-9) + x_of(1e9)) / 2.0).abs() < 1e-6);
        assert!(x_of(0.5) < x_of(1.0) && x_of(1.0) < x_of(2.0));
        assert_eq!(escape("a<b & c"), "a&lt;b &amp; c");
    }
}
