//! Prints the verdicts on the protocol's claims, for people.

use crate::failure::Failure;
use crate::output::{BAD, FAINT, GOOD, HEAD, NOTE, Output, Styled, count, grouped};
use imrs_model::{Compared, Outcome, Report, Verdict, compared};
use std::collections::BTreeSet;
use std::time::Duration;

/// The claim whose results are shown in a table of their own.
const UNDER_LOSS: &str = "rendezvous-under-loss";
/// How many lines of a counterexample are shown from its beginning, unless the user named its claim.
const CHART_HEAD: usize = 6;
/// How many lines are shown from the end of a counterexample, where the fault is.
const CHART_TAIL: usize = 3;

/// Prints a report. With `in_full` the counterexamples are printed completely.
pub fn show(report: &Report, in_full: bool, took: Duration, out: &mut Output) -> Result<(), Failure> {
    table(report, out)?;
    rules_under_loss(report, out)?;
    margins(report, out)?;
    counterexamples(report, in_full, out)?;
    surprises(report, out)?;
    last_line(report, took, out)
}

fn word(outcome: Outcome) -> &'static str {
    match outcome {
        Outcome::Holds => "holds",
        Outcome::Fails => "fails",
        Outcome::Unknown => "unknown",
    }
}

fn table(report: &Report, out: &mut Output) -> Result<(), Failure> {
    let name = widest(report.claims.iter().map(|v| &v.name), "claim");
    let rule = widest(report.claims.iter().map(|v| &v.rule), "rule");
    let bound = report.claims.iter().map(|v| bounds(v).len()).chain([6]).max().unwrap_or(0);
    let head = format!(
        "{:<name$}  {:<rule$}  n  {:<bound$}  {:<VERDICT$}  {:>11}  {:>8}",
        "claim", "rule", "bounds", "verdict", "states", "time"
    );
    out.line(Styled(HEAD, head))?;
    let mut last = "";
    for v in &report.claims {
        let shown = if v.name == last { "" } else { &v.name };
        last = &v.name;
        out.line(format!(
            "{shown:<name$}  {:<rule$}  {}  {:<bound$}  {}  {:>11}  {:>8}",
            v.rule,
            v.parties,
            bounds(v),
            verdict_cell(v),
            grouped(v.states),
            format!("{:.2} s", v.seconds)
        ))?;
    }
    out.line(Styled(
        FAINT,
        "bounds: L packets lost, U repeated, C crashes, D longest link delay in ticks, R rounds or messages, - without end",
    ))?;
    out.line("")
}

/// The bounds of a verdict in short form: `L1 D1 R-`.
fn bounds(v: &Verdict) -> String {
    let b = &v.bounds;
    let mut parts = vec![format!("L{}", b.loss)];
    for (letter, count) in [("U", b.dup), ("C", b.crash)] {
        if count > 0 {
            parts.push(format!("{letter}{count}"));
        }
    }
    for (letter, count) in [("D", b.delay), ("R", b.rounds)] {
        parts.push(count.map_or_else(|| format!("{letter}-"), |n| format!("{letter}{n}")));
    }
    parts.join(" ")
}

/// The width of the verdict column.
const VERDICT: usize = 20;

/// The text of the verdict, compared with the expectation.
fn verdict_cell(v: &Verdict) -> String {
    let text = match (v.as_expected, v.outcome) {
        (true, Outcome::Holds) => "holds",
        (true, Outcome::Fails) => "fails, as it must",
        (true, Outcome::Unknown) => "unknown, as expected",
        (false, Outcome::Unknown) => "UNKNOWN: cut short",
        (false, Outcome::Holds) => "HOLDS: should fail",
        (false, Outcome::Fails) => "FAILS: should hold",
    };
    let style = match (v.as_expected, v.outcome) {
        (true, Outcome::Holds) => GOOD,
        (true, _) => FAINT,
        (false, Outcome::Unknown) => NOTE,
        (false, _) => BAD,
    };
    Styled(style, format!("{text:<VERDICT$}")).to_string()
}

fn widest<'a>(names: impl Iterator<Item = &'a String>, head: &str) -> usize {
    names.map(String::len).chain([head.len()]).max().unwrap_or(0)
}

/// Prints how many lost packets suffice to strand a member, for each rule of confirmation and number of members.
fn rules_under_loss(report: &Report, out: &mut Output) -> Result<(), Failure> {
    let of: Vec<&Verdict> = report.claims.iter().filter(|v| v.name == UNDER_LOSS).collect();
    let sizes: BTreeSet<u32> = of.iter().map(|v| v.parties).collect();
    let mut rules: Vec<&str> = Vec::new();
    for v in &of {
        if !rules.contains(&v.rule.as_str()) {
            rules.push(&v.rule);
        }
    }
    if rules.is_empty() {
        return Ok(());
    }
    let width = widest(of.iter().map(|v| &v.rule), "rule");
    let number = |n: Option<u32>| n.map_or_else(|| "-".to_owned(), |n| n.to_string());
    out.line("Least number of lost packets that leaves a member waiting after all have arrived:")?;
    let columns =
        |what: &str| sizes.iter().map(|n| format!("{:>8}", format!("{what}{n}"))).collect::<String>();
    let head = format!("  {:<width$}  {}   re-sending:{}", "rule", columns("n="), columns("n="));
    out.line(Styled(HEAD, head))?;
    for rule in rules {
        let found = |n: u32| of.iter().find(|v| v.rule == rule && v.parties == n).map(|v| &v.found);
        let cells = |pick: fn(&imrs_model::Found) -> Option<u32>| {
            sizes.iter().map(|&n| format!("{:>8}", number(found(n).and_then(pick)))).collect::<String>()
        };
        let once = cells(|f| f.least_losses_to_strand);
        let again = cells(|f| f.least_losses_with_resending);
        out.line(format!("  {rule:<width$}  {once}              {again}"))?;
    }
    out.line("")
}

fn margins(report: &Report, out: &mut Output) -> Result<(), Failure> {
    let mut any = false;
    for v in &report.claims {
        let f = &v.found;
        let mut parts = Vec::new();
        if let Some(least) = f.least_safe_margin {
            let closed = f.closed_form_margin.map_or_else(String::new, |c| {
                format!("; the closed form gives {c}, so {} more than needed", c.saturating_sub(least))
            });
            parts.push(format!("least margin that holds: {least} ticks{closed}"));
        }
        if let Some(bound) = f.bound_ticks {
            parts.push(format!("bound: {bound} ticks"));
        }
        if let Some(attempts) = f.attempts {
            parts.push(format!("within {attempts} attempts"));
        }
        if !parts.is_empty() {
            any = true;
            out.line(format!("{} ({}, n={}): {}", v.name, v.rule, v.parties, parts.join("; ")))?;
        }
    }
    if any { out.line("") } else { Ok(()) }
}

/// Prints the shortest counterexample of each failing variant.
fn counterexamples(report: &Report, in_full: bool, out: &mut Output) -> Result<(), Failure> {
    for v in &report.claims {
        let Some(counterexample) = &v.counterexample else { continue };
        // The table of rules says the same as this counterexample, so the counterexample is shown only if the user
        // named the claim.
        if v.name == UNDER_LOSS && !in_full && v.as_expected {
            continue;
        }
        let title = format!(
            "{} fails with {} (n={}), in {} steps:",
            v.name, v.rule, v.parties, counterexample.length
        );
        out.line(Styled(if v.as_expected { HEAD } else { BAD }, title))?;
        if !v.about.is_empty() {
            out.line(format!("  {}", v.about))?;
        }
        let chart: Vec<&str> = counterexample.chart.lines().collect();
        let (head, tail) = if in_full || chart.len() <= CHART_HEAD + CHART_TAIL + 1 {
            (chart.len(), 0)
        } else {
            (CHART_HEAD, CHART_TAIL)
        };
        for line in &chart[..head] {
            out.line(format!("  {line}"))?;
        }
        if head < chart.len() {
            let more = chart.len() - head - tail;
            out.line(Styled(FAINT, format!("  ... {more} more lines: imrs verify --claim {}", v.name)))?;
        }
        for line in &chart[chart.len() - tail..] {
            out.line(format!("  {line}"))?;
        }
        out.line("")?;
    }
    Ok(())
}

fn surprises(report: &Report, out: &mut Output) -> Result<(), Failure> {
    for v in report.claims.iter().filter(|v| !v.as_expected) {
        let what = format!(
            "{} ({}, n={}): expected {}, found {}",
            v.name,
            v.rule,
            v.parties,
            word(v.expect),
            word(v.outcome)
        );
        let why = if v.complete { "" } else { "; the search was cut short, raise --memory" };
        out.line(format!("{} {what}{why}", Styled(BAD, "NOT AS EXPECTED:")))?;
    }
    Ok(())
}

fn last_line(report: &Report, took: Duration, out: &mut Output) -> Result<(), Failure> {
    let (all, good) = (report.claims.len(), report.claims.iter().filter(|v| v.as_expected).count());
    let states: u64 = report.claims.iter().map(|v| v.states).sum();
    let style = if good == all { GOOD } else { BAD };
    let what = Styled(style, format!("{good} of {all} as expected"));
    let Compared { messages, answers, arrivals, meetings, gets, pairs, .. } = compared();
    if messages + answers + arrivals + gets > 0 {
        let [messages, answers] = [count(messages, "message"), count(answers, "answer")];
        let [arrivals, meetings] = [count(arrivals, "arrival"), count(meetings, "meeting")];
        let [gets, pairs] = [count(gets, "GET"), count(pairs, "pair")];
        let what =
            format!("{messages}, {answers}, {gets}, {pairs} of answer and GET, and {arrivals} ({meetings})");
        out.line(format!("fused steps: {what} had the same effects as their small steps"))?;
    }
    out.line(format!("{what}, {} in {:.1} s", count(states, "state"), took.as_secs_f64()))
}
