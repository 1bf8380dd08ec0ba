//! `imrs summary`: makes one summary from the reports of all machines of a cell.

use crate::args::{Format, SummaryArgs};
use crate::cell_file::shown;
use crate::exit::Exit;
use crate::failure::Failure;
use crate::output::Output;
use crate::run::report;
use imrs_launch::{Report, Verdict, cells, join};
use imrs_wire::files;
use std::path::Path;

/// The size limit of a report: more than the longest run writes.
const MOST_BYTES: u64 = 64 << 20;

/// Prints the summary of all machines.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &SummaryArgs, out: &mut Output) -> Result<Exit, Failure> {
    let (_, loaded) = cells::open(&args.cell, args.paper)?;
    let read = |path: &Path| -> Result<Report, String> {
        let text = files::text(path, MOST_BYTES).map_err(|error| error.to_string())?;
        Report::read(&text, &loaded).map_err(|error| error.to_string())
    };
    let read = |path| read(path).map_err(|error| Failure::Usage(format!("{}: {error}", shown(path))));
    let reports = args.files.iter().map(|path| read(path)).collect::<Result<Vec<_>, _>>()?;
    let (summary, trouble) = join(&loaded, &reports);
    match args.format {
        Format::Json => out.json(&summary)?,
        Format::Text => report::summary(&summary, &loaded.table, None, out)?,
    }
    report::complain_of(&trouble, &summary);
    Ok(Verdict::of(&summary, &trouble).into())
}
