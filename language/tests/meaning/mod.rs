//! The meaning of cells: names and types, lowered scripts, and how the scripts run.

mod answers;
mod checks;
mod deadlines;
mod exits;
mod faults;
mod load;
mod lowered;
mod random;
mod runs;

use crate::support::source;
use imrs_language::lower::Behaviour;
use imrs_language::{Compiled, Diagnostic, Lowered, Unit, compile, render};
use imrs_protocol::TaskId;
use imrs_testkit::VirtualCell;
use std::sync::Arc;

const BEAM_LIFT: &str = include_str!("cells/beam_lift.cell");
const WELD: &str = include_str!("cells/weld_cell.cell");

/// Compiles a text that must have no errors.
fn whole(text: &str) -> Compiled {
    let source = source(text);
    let compiled = compile(&source);
    let shown = render::text(&compiled.diagnostics, "test.cell", Some(&source), render::Style::Plain);
    assert!(compiled.hir.is_some(), "{shown}");
    compiled
}

/// The cell of a text in virtual time, before its first step.
fn virtual_cell(text: &str) -> VirtualCell {
    begun(&whole(text).lower(Unit::Ticks).expect("a whole cell"))
}

/// A cell in virtual time whose scripts have begun. The scripts choose the first alternative.
fn begun(lowered: &Lowered) -> VirtualCell {
    let scripts = lowered.tasks.iter().enumerate().map(|(at, behaviour)| {
        let Behaviour::Script(script) = behaviour else { panic!("T{at} is extern") };
        (TaskId::from_index(at), Arc::clone(&script.program))
    });
    VirtualCell::new(lowered.cell.clone()).choosing(0).begin(scripts)
}

/// The errors of names, types and tables, each as "E101 `source text`". The static checks are left out, because these cells
/// do little.
fn found(text: &str) -> Vec<String> {
    let behaviour = ["E104", "E202", "E203", "E204", "E206", "E208", "E209", "E211"];
    let is = |found: &String| {
        !found.starts_with('W') && !found.starts_with("N2") && !behaviour.contains(&&found[..4])
    };
    all_found(text).into_iter().filter(is).collect()
}

/// All findings, each as "E101 `source text`".
fn all_found(text: &str) -> Vec<String> {
    let source = source(text);
    let shown = |found: &Diagnostic| format!("{} `{}`", found.code, source.slice(found.primary.span));
    compile(&source).diagnostics.iter().map(shown).collect()
}
