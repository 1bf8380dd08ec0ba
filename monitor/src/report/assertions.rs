//! The results of assertions, as JSON or text.

use super::VERSION;
use crate::name::shown_line;
use crate::query::{Assertion, Held};
use imrs_wire::text;
use serde::Serialize;
use std::fmt::Write as _;

#[derive(Serialize)]
struct Asserted<'a> {
    version: u32,
    holds: bool,
    assertions: Vec<One<'a>>,
}

#[derive(Serialize)]
struct One<'a> {
    assertion: &'a str,
    holds: bool,
    values: &'a [String],
}

/// The results of assertions, as one line of JSON without the newline.
///
/// # Panics
/// Never: every key is a string, so the encoding can only run out of memory.
#[must_use]
pub fn json_of_assertions(assertions: &[Assertion], held: &[Held]) -> String {
    let all = assertions.iter().zip(held);
    let report = Asserted {
        version: VERSION,
        holds: held.iter().all(|held| held.holds),
        assertions: all
            .map(|(assertion, held)| One {
                assertion: assertion.text(),
                holds: held.holds,
                values: &held.values,
            })
            .collect(),
    };
    text::json(&serde_json::to_string(&report).expect("strings and numbers")).into_owned()
}

/// The results of assertions, one line each.
#[must_use]
pub fn text_of_assertions(assertions: &[Assertion], held: &[Held]) -> String {
    let mut out = String::new();
    for (assertion, held) in assertions.iter().zip(held) {
        let word = if held.holds { "holds" } else { "FALSE" };
        let values = held.values.join(", ");
        let _ = writeln!(out, "{word}: {}  ({})", shown_line(assertion.text()), shown_line(&values));
    }
    out
}
