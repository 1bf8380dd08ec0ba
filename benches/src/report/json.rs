//! The results as JSON, for programs.

use crate::harness::Results;
use crate::machine::Facts;
use crate::suite::{Against, Goal};
use serde_json::{Value, json};

/// The facts about the machine, the cases with every round, and the rows with their ratios. Times are in nanoseconds.
#[must_use]
pub fn json(facts: &Facts, rounds: u32, slack: f64, all: &[Results]) -> Value {
    let suites: Vec<Value> = all.iter().map(|results| suite(results, slack)).collect();
    json!({ "format": 1, "machine": facts, "rounds": rounds, "slack": slack, "suites": suites })
}

fn suite(results: &Results, slack: f64) -> Value {
    let row = |outcome: &crate::judge::Outcome| {
        let row = &outcome.row;
        let against = match &row.against {
            Against::Case(name) | Against::Above(name, _) => json!(name),
            Against::Itself(stat) => json!(stat),
            Against::Nothing => Value::Null,
        };
        let (sort, bound) = match row.goal {
            Goal::AtMost(bound) => ("at_most", bound),
            Goal::AtLeast(bound) => ("at_least", bound),
        };
        json!({
            "goal": row.id, "what": row.what, "subject": row.subject, "against": against, "of": row.stat,
            "bound": { "sort": sort, "ratio": bound }, "first_bound": row.was,
            "ratio": outcome.ratio, "met": outcome.met(slack), "undecided": outcome.undecided,
            "apart": outcome.apart, "rounds": outcome.rounds, "again": outcome.again,
        })
    };
    let rows: Vec<Value> = results.rows.iter().map(row).collect();
    json!({ "suite": results.suite, "cases": results.cases, "rows": rows })
}
