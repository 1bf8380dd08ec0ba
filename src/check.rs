//! `imrs check`: compiles a cell file and shows the compiler's diagnostics.

mod load;

use crate::args::{CheckArgs, Format};
use crate::cell_file::{read, shown};
use crate::exit::{Exit, turned_down};
use crate::failure::Failure;
use crate::output::{BAD, GOOD, NOTE, Output, Styled, count};
use imrs_language::render::{self, Located};
use imrs_language::{Compiled, Diagnostic, Options, Severity, Source, compile_with};
use serde::Serialize;

/// The answer of `imrs check --format json`.
#[derive(Debug, Serialize)]
struct Checked<'a> {
    version: u32,
    /// The name of the cell; `None` if the file has errors.
    cell: Option<&'a str>,
    file: &'a str,
    errors: usize,
    warnings: usize,
    notes: usize,
    diagnostics: Vec<Located<'a>>,
    /// A sentence about what was not checked because of errors; `None` if everything was checked.
    unchecked: Option<&'a str>,
    /// The traffic on the links, if it was asked for and the cell has no errors.
    #[serde(skip_serializing_if = "Option::is_none")]
    load: Option<load::Shown>,
}

/// Checks a cell file.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &CheckArgs, out: &mut Output) -> Result<Exit, Failure> {
    let source = read(&args.cell)?;
    let compiled = compile_with(&source, Options { paper: args.paper });
    let (file, found) = (shown(&args.cell), &compiled.diagnostics);
    match args.format {
        Format::Json => answer(&file, &source, &compiled, args.load, out)?,
        Format::Text => {
            out.text(&render::text(found, &file, Some(&source), render::Style::Coloured))?;
            if let Some(unchecked) = compiled.unchecked {
                out.line(format!("\n{}: {unchecked}", Styled(NOTE, "note".to_owned())))?;
            }
            verdict(&file, &compiled, out)?;
            if let Some(hir) = compiled.hir.as_ref().filter(|_| args.load) {
                load::table(hir, out)?;
            }
        }
    }
    Ok(if of(found, Severity::Error) == 0 { Exit::Well } else { turned_down(found) })
}

/// Prints the answer as JSON. Other verbs use this, too, if a cell does not compile.
///
/// # Errors
/// [`Failure::Output`].
pub fn json(file: &str, source: &Source, compiled: &Compiled, out: &mut Output) -> Result<(), Failure> {
    answer(file, source, compiled, false, out)
}

fn answer(
    file: &str,
    source: &Source,
    compiled: &Compiled,
    load: bool,
    out: &mut Output,
) -> Result<(), Failure> {
    let found = &compiled.diagnostics;
    out.json(&Checked {
        version: 1,
        cell: compiled.hir.as_ref().map(|hir| hir.name.as_str()),
        file,
        errors: of(found, Severity::Error),
        warnings: of(found, Severity::Warning),
        notes: of(found, Severity::Note),
        diagnostics: render::located(found, file, Some(source)),
        unchecked: compiled.unchecked,
        load: compiled.hir.as_ref().filter(|_| load).map(load::Shown::of),
    })
}

fn of(found: &[Diagnostic], severity: Severity) -> usize {
    found.iter().filter(|found| found.severity == severity).count()
}

fn verdict(file: &str, compiled: &Compiled, out: &mut Output) -> Result<(), Failure> {
    let number = |severity, word| match of(&compiled.diagnostics, severity) {
        0 => None,
        number => Some(count(number as u64, word)),
    };
    let counts = [
        number(Severity::Error, "error"),
        number(Severity::Warning, "warning"),
        number(Severity::Note, "note"),
    ];
    let counts: Vec<String> = counts.into_iter().flatten().collect();
    if !compiled.diagnostics.is_empty() {
        out.line("")?;
    }
    match &compiled.hir {
        None => out.line(format!("{file}: {}", Styled(BAD, counts.join(", ")))),
        Some(hir) => {
            let size = [(hir.nodes.len(), "node"), (hir.tasks.len(), "task"), (hir.ports.len(), "port")];
            let size = size.map(|(number, word)| count(number as u64, word)).join(", ");
            let said = match counts.is_empty() {
                true => Styled(GOOD, "no findings".to_owned()),
                false => Styled(NOTE, counts.join(", ")),
            };
            out.line(format!("{file}: cell `{}` with {size}: {said}", hir.name))
        }
    }
}
