//! `imrs export`: converts recordings for other tools.

use crate::args::{ExportArgs, ExportForm};
use crate::exit::Exit;
use crate::failure::Failure;
use crate::kept;
use crate::output::Output;
use imrs_monitor::MonitorError;
use imrs_monitor::export::{Form, Wanted, export};
use imrs_monitor::record::free_name;
use imrs_monitor::replay::Film;
use std::io::{BufWriter, Cursor, Write};
use std::path::Path;
use std::sync::Arc;

/// Exports a recording to the form that the user chose.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &ExportArgs, out: &mut Output) -> Result<Exit, Failure> {
    let film = Arc::new(Film::open(&args.file)?);
    let wanted = Wanted {
        size: args.size,
        keys: args.keys.clone(),
        frames: args.fps,
        most: usize::try_from(args.last).unwrap_or(usize::MAX),
        ..Wanted::new(match args.to {
            ExportForm::Mcap => Form::Mcap,
            ExportForm::Jsonl => Form::Jsonl,
            ExportForm::Svg => Form::Svg,
            ExportForm::Asciicast => Form::Asciicast,
        })
    };
    let failed = |path: &Path, why: String| MonitorError::Recording { path: path.to_owned(), why };
    if args.out.as_deref() == Some(Path::new("-")) {
        let mut whole = Cursor::new(Vec::new());
        export(&film, &wanted, &mut whole).map_err(|error| failed(&args.file, error.to_string()))?;
        std::io::stdout().lock().write_all(whole.get_ref()).map_err(Failure::Output)?;
        return Ok(Exit::Well);
    }
    let path = args.out.clone().unwrap_or_else(|| free_name(&args.file.with_extension(args.to.ending())));
    kept::check(&path, args.force)?;
    // A reader could take a partial export for a complete one, so an export gets its name only when it is complete.
    let done = kept::keep_or(&path, args.force, |file| {
        export(&film, &wanted, BufWriter::new(file))
            .map_err(|error| Failure::from(failed(&path, error.to_string())))
    })?;
    if let Some(notice) = &film.notice {
        crate::output::complain(format_args!("{}: {notice}", args.file.display()));
    }
    out.line(format!("{}: {} {}", path.display(), done.count, done.what))?;
    Ok(Exit::Well)
}
