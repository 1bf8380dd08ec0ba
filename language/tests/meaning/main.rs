//! What cells mean: names and types, lowered scripts, and how those run.

mod exits;
mod faults;
mod floor;
mod lowered;
mod random;
mod runs;

use imrs_language::{Compiled, Diagnostic, Source, compile, render};

const BEAM_LIFT: &str = include_str!("../../../examples/beam_lift.cell");
const WELD: &str = include_str!("../../../examples/weld_cell.cell");

fn source(text: &str) -> Source {
    Source::new(text.as_bytes()).expect("a text")
}

/// The cell of a text that must have no fault.
fn whole(text: &str) -> Compiled {
    let source = source(text);
    let compiled = compile(&source);
    let shown = render::text(&compiled.diagnostics, "test.cell", Some(&source), render::Style::Plain);
    assert!(compiled.hir.is_some(), "{shown}");
    compiled
}

/// Each finding as `E101 `what stands there``.
fn found(text: &str) -> Vec<String> {
    let source = source(text);
    let shown = |found: &Diagnostic| format!("{} `{}`", found.code, source.slice(found.primary.span));
    compile(&source).diagnostics.iter().map(shown).collect()
}
