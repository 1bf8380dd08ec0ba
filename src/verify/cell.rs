//! `imrs verify CELL`: checks the cell's own scripts and communication tasks, with the faults that the cell declares.

use super::covered;
use super::save::save;
use super::search_lines::SearchLines;
use super::subject::Subject;
use super::tell::{self, Telling};
use crate::args::{CellFaultArgs, Format, VerifyVerb};
use crate::exit::Exit;
use crate::failure::Failure;
use crate::kept;
use crate::output::{Output, complain, harmless};
use imrs_model::cell::{CellPlan, Coverage, Folding, Verdicts, chart, check_cell_and_tell, drawn, svg};
use std::path::Path;
use std::sync::Arc;

/// Checks a cell.
///
/// # Errors
/// [`Failure`].
pub fn run(path: &Path, args: &VerifyVerb, out: &mut Output) -> Result<Exit, Failure> {
    let format = args.verify.format.unwrap_or_default();
    let subject = match Subject::open(path, args.faults.paper, format, out)? {
        Ok(subject) => subject,
        Err(exit) => return Ok(exit),
    };
    let plan = Arc::new(subject.plan(args)?);
    for file in [&args.faults.trace, &args.faults.save].into_iter().flatten() {
        kept::check(file, args.faults.force)?;
    }
    let lines = SearchLines::new(&subject, &plan, format);
    let verdicts = check_cell_and_tell(&plan, &lines);
    lines.clear();
    // The findings are shown even if saving them fails.
    let kept = keep(&subject, &plan, &verdicts, &args.faults);
    let saved = kept.as_ref().map_or(None, |saved| *saved);
    match format {
        Format::Json => {
            if kept.is_ok() {
                tell::unkept(&args.faults, &verdicts, saved).into_iter().for_each(complain);
            }
            out.json(&subject.answer(&plan, &verdicts, saved))?;
        }
        Format::Text => {
            let (subject, failed) = (&subject, kept.is_err());
            Telling { subject, plan: &plan, verdicts: &verdicts, args, saved, failed }.show(out)?;
        }
    }
    kept?;
    Ok(match (verdicts.findings.is_empty(), verdicts.is_complete()) {
        (false, _) => Exit::Finding,
        (true, true) => Exit::Well,
        (true, false) => Exit::Budget,
    })
}

/// Draws and saves the selected finding. Returns its number if it was saved.
fn keep(
    subject: &Subject,
    plan: &Arc<CellPlan>,
    verdicts: &Verdicts,
    args: &CellFaultArgs,
) -> Result<Option<usize>, Failure> {
    let all = &verdicts.findings;
    let at = match args.finding {
        Some(number) => usize::from(number) - 1,
        None => all.iter().position(|finding| !finding.moves.is_empty()).unwrap_or(0),
    };
    let Some(finding) = all.get(at) else {
        // If there are no findings, there is nothing to save, and that is no error.
        let missed = args.finding.filter(|_| !all.is_empty());
        let missed = missed.map(|number| format!("--finding {number}: there are {}", all.len()));
        return missed.map_or(Ok(None), |missed| Err(Failure::Usage(missed)));
    };
    if let Some(path) = &args.trace {
        let notes = finding.steps.iter().flat_map(|step| step.notes.clone()).collect();
        let (names, notes) = drawn(plan, finding.part, notes);
        let drawn = if path.extension().is_some_and(|of| of == "txt") {
            chart(&names, &notes, &finding.cause, Folding::Nothing) + "\n"
        } else {
            svg(&names, &notes, &finding.cause)
        };
        kept::keep_text(path, args.force, &harmless(&drawn))?;
    }
    let Some(path) = &args.save else { return Ok(None) };
    let searched = |phase: &&Coverage| (phase.phase, phase.hypothesis) == (finding.phase, finding.hypothesis);
    let bounds = verdicts.phases.iter().find(searched);
    let bounds = bounds
        .map(|phase| covered::bounds(plan, (phase.phase, phase.hypothesis), phase.times))
        .unwrap_or_default();
    let saved = save(path, subject, plan, finding, bounds, args.force)?;
    Ok(saved.then_some(at + 1))
}
