//! Runs all phases of the compiler, one after another.

use crate::ast::File;
use crate::checks;
use crate::codes::{DEADLINE, SHORT_TIME_OUT, SOON, TOO_MANY};
use crate::diagnostic::{Diagnostic, Severity};
use crate::hir::Hir;
use crate::lost::Doubts;
use crate::lower::{Lowered, Unit, lower, table_errors};
use crate::parser::parse;
use crate::resolve::resolve_rest;
use crate::source::Source;
use crate::span::Span;
use imrs_protocol::CellTable;

/// The result of all phases.
#[derive(Clone, Debug)]
pub struct Compiled {
    /// The cell; `None` if some diagnostic is an error.
    pub hir: Option<Hir>,
    /// The diagnostics. Without errors they come in the order of the phases, and within a phase in the order of the file.
    /// With errors they come in the order of the file.
    pub diagnostics: Vec<Diagnostic>,
    /// If some parts were not checked because of errors: a sentence that says so.
    pub unchecked: Option<&'static str>,
}

impl Compiled {
    /// The lowered cell, with durations in this unit; `None` if some diagnostic is an error.
    #[must_use]
    pub fn lower(&self, unit: Unit) -> Option<Lowered> {
        lower(self.hir.as_ref()?, unit).ok()
    }
}

/// Options of a compilation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// Whether only the words of the paper are allowed, and the paper's own rules apply (D92).
    pub paper: bool,
}

/// Compiles a file: [`compile_with`] without options.
#[must_use]
pub fn compile(source: &Source) -> Compiled {
    compile_with(source, Options::default())
}

/// Compiles a file: syntax, names and types, then the behaviour of the cell and the tables of the protocol. After errors in
/// one phase, the later phases check the other parts of the file, and report only faults that do not follow from these
/// errors. So each fault is reported once.
#[must_use]
pub fn compile_with(source: &Source, options: Options) -> Compiled {
    let parsed = parse(source);
    let mut diagnostics = parsed.diagnostics;
    if parsed.lost.all {
        return Compiled { hir: None, diagnostics, unchecked: Some(NOTHING_ELSE) };
    }
    let syntax = has_error(&diagnostics);
    let mut resolved = resolve_rest(&parsed.file, source.text(), &parsed.lost);
    resolved.hir.paper = options.paper;
    let mut doubts = Doubts::new(&parsed.lost, source, &diagnostics);
    if syntax {
        resolved.diagnostics.retain(|found| doubts.keeps_name(found));
    }
    let types = has_error(&resolved.diagnostics);
    if !(syntax || types) {
        diagnostics.extend(resolved.diagnostics);
        diagnostics.extend(behaviour((&parsed.file, source), &resolved.hir, options));
        let whole = !has_error(&diagnostics);
        return Compiled { hir: whole.then_some(resolved.hir), diagnostics, unchecked: None };
    }
    doubts.add(&resolved.diagnostics);
    diagnostics.extend(resolved.diagnostics);
    let found = behaviour((&parsed.file, source), &resolved.hir, options).into_iter();
    diagnostics.extend(found.filter(|found| doubts.keeps_behaviour(found)));
    diagnostics.sort_by_key(|found| found.primary.span.start);
    Compiled { hir: None, diagnostics, unchecked: Some(if syntax { NAMES_AND_TIMES } else { TIMES }) }
}

const NOTHING_ELSE: &str = "names, types, behaviour and times were not checked: correct this first";
const NAMES_AND_TIMES: &str = "names, types, behaviour and times were checked only where these errors leave no doubt: correct them first";
const TIMES: &str =
    "behaviour and times were checked only where these errors leave no doubt: correct them first";

fn has_error(diagnostics: &[Diagnostic]) -> bool {
    diagnostics.iter().any(|found| found.severity == Severity::Error)
}

/// The diagnostics of the static checks and of the protocol's table, in the order of the text.
fn behaviour((file, source): (&File, &Source), hir: &Hir, options: Options) -> Vec<Diagnostic> {
    let mut found = machine(hir);
    if found.iter().any(|found| found.code == TOO_MANY) {
        return found;
    }
    let checked = checks::all(hir, options.paper);
    // The checks and the cell's table may both find the same deadline too short; both findings mark the deadline's port.
    // The finding of the checks explains more, so only this finding stays. A time_out that cannot cover its route is not
    // reported a second time as short.
    let port = |found: &Diagnostic| found.secondary.first().map(|label| label.span);
    let of = |all: &[Diagnostic], code| -> Vec<Option<Span>> {
        all.iter().filter(|found| found.code == code).map(port).collect()
    };
    let known = of(&checked, DEADLINE);
    found.retain(|found| found.code != DEADLINE || !known.contains(&port(found)));
    let deadlines = [known, of(&found, DEADLINE)].concat();
    let soon = found.iter().chain(&checked).filter(|found| found.code == DEADLINE);
    let soon: Vec<Span> = soon.map(|found| found.primary.span).collect();
    let again = |found: &Diagnostic| match found.code {
        SHORT_TIME_OUT => deadlines.contains(&port(found)),
        SOON => soon.contains(&found.primary.span),
        _ => false,
    };
    found.extend(checked.into_iter().filter(|found| !again(found)));
    if options.paper {
        found.extend(checks::paper(file, source));
    }
    found.sort_by_key(|found| found.primary.span.start);
    found
}

/// The errors that only lowering and the protocol's table can find.
fn machine(hir: &Hir) -> Vec<Diagnostic> {
    match lower(hir, Unit::Microseconds) {
        Err(found) => found,
        Ok(lowered) => match CellTable::new(lowered.cell) {
            Err(errors) => table_errors(hir, Unit::Microseconds, &errors),
            Ok(_) => Vec::new(),
        },
    }
}
