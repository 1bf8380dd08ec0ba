//! Tests of the language from outside: texts go in; syntax trees, diagnostics and formatted texts come out.

mod bytes;
mod cascades;
mod examples;
mod explanations;
mod faulty;
mod format;
mod generated;
mod limits;

use crate::support::{bytes::plain, source};
use imrs_language::{Diagnostic, parse, render};

const BEAM_LIFT: &str = include_str!("../cells/beam_lift.cell");
const WELD: &str = include_str!("../cells/weld.cell");
const PAPER: &str = include_str!("../cells/paper.cell");

fn diagnostics(text: &str) -> Vec<Diagnostic> {
    parse(&source(text)).diagnostics
}

fn codes(text: &str) -> Vec<&'static str> {
    diagnostics(text).iter().map(|found| found.code).collect()
}

fn rendered(text: &str) -> String {
    let source = source(text);
    render::text(&parse(&source).diagnostics, "test.cell", Some(&source), render::Style::Plain)
}

/// The syntax tree of a text, without spans.
fn tree(text: &str) -> String {
    plain(&parse(&source(text)).file)
}
